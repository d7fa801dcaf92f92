"""What the simulated world knows of a thing that grows in the twin."""
