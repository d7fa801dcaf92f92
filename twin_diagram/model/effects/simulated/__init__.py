"""How effects act in a simulator's plant, stable at its step."""
