"""The drift monitor: its statistics, their thresholds, and the alarms that they raise."""
