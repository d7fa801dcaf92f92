"""Planners that go wrong, and the drawn worlds that they are let loose in: for the stop monitor's benchmark."""
