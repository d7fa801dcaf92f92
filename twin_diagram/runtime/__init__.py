"""What any run stands on: timing, progress, files written whole, lazy faces."""
