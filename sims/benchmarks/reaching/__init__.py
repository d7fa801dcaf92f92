"""Reaching among things that move: how worlds are drawn, and how runs are counted."""
