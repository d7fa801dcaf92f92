"""Tracks the objects of a library through a folder of RGB-D frames."""
