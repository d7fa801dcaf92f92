"""What flows between systems: the layouts of their vectors, units, and rotations."""
