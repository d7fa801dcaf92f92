"""Measured logs as columns: residual torques, regressors, and noise made white."""
