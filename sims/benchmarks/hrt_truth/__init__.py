"""The truth of the filter's tables: a UR5e in MuJoCo with parameters of its own, faults, and imperfect sensors.

What a twin may read (`Streams`) and what is true (`Truth`) are written to two files; methods get the first alone, the
scorer alone opens the second.
"""
