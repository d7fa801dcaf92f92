"""Recordings: written while a run goes on, and shown again as a station."""
