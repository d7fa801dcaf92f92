"""Truth of things and frames that are least like the project's own; the tracker reads none of it."""
