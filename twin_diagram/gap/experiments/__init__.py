"""Motions that would tell apart what the measured runs could not."""
