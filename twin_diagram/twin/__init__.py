"""The twin and the closed loop: the only place where systems meet."""
