"""Joint goals, and ways around obstacles towards them."""
