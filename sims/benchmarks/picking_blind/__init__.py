"""Picks and places by what the first image showed, and by nothing that comes after it."""
