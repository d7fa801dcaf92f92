"""What any run stands on: system libraries, timing, progress, files written whole."""
