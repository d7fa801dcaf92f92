"""Arms in MuJoCo that lack everything at once, as real ones do: drawn, run, and scored against what is true of them.

They share no code with `twin_diagram.gap`; of `gap_truth` they use arms, motions and the simulated world.
"""
