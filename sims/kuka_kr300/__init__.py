"""Measured runs of a KUKA KR300: what is published of the arm, and what its models leave of the torque."""
