"""The simulated station: a plant that holds the truth, its sensors and their defects."""
