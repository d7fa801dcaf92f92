"""Distances between the arm and what stands about it, with gradients."""
