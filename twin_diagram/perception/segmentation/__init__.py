"""From an RGB-D image to segments: the table and the robot taken away, the rest parted."""
