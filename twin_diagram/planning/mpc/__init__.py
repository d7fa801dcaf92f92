"""The motion that follows a path and keeps clear, planned anew at each tick."""
