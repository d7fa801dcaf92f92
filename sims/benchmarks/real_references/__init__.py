"""References for measured logs of real arms: least squares that are told the structure, and the rows they are for.

They share no code with `twin_diagram.gap`: of the twin they use the readers, the rigid-body regressor and the
contract's band.
"""
