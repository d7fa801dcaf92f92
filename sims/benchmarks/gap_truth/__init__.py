"""The truth of the gap benchmark: arms in MuJoCo with one physical effect hidden in them.

Nothing here imports `twin_diagram`, and `twin_diagram` imports nothing from here: the two share the log format and the
catalogue's names and conventions, and no line of code.
"""
