"""Named effects added to a model, their parameters refined on torques and on motion."""
