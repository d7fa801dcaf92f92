"""A run from its scenario to its files: trial, score, outputs."""
