"""Steps of a task: what to do next, from what is seen; grasps from above; and the system that runs them."""
