"""The Diagram drawn block by block, as SVG."""
