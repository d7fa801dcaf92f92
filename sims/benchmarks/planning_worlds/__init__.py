"""Drawn worlds for the planner alone, without physics or pictures."""
