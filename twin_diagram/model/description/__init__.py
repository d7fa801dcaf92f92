"""Descriptions of arms: read into a plant, and written with what was corrected."""
