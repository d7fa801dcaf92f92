"""Small faults put into the maths, one at a time, to see whether the fast tests notice: `make mutants`."""
