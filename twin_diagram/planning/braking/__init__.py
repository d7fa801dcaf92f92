"""Stops the arm in time whatever the planner does: between planner and station, with Drake's own distance queries."""
