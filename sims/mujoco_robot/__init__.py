"""An iiwa 7 in MuJoCo that is not what its description says: how it is driven, what is hidden, what became of it."""
