"""The search for the few candidates that explain a gap, and what each must earn."""
