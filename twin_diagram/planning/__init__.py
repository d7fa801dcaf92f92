"""Plans the arm's motion in the twin's scene: distances, goals, a global planner and a receding-horizon optimiser."""
