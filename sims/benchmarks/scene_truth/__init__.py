"""Truth of scenes in which things are carried, taken away, brought back and hidden; the twin reads none of it."""
