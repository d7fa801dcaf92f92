"""Which effects may explain a gap: a file for each of the catalogue, with its candidates and its record; a user's own.

Importing this package registers the catalogue's records, in the order in which their candidates are made.
"""

# ruff: noqa: F401, I001 (the imports register; their order counts)
from twin_diagram.gap.candidates import (
    viscous_friction,
    coulomb_friction,
    load_dependent_friction,
    stribeck_friction,
    reflected_inertia,
    joint_spring,
    torque_constant,
    torque_bias,
    torque_saturation,
    coupled_friction,
    payload,
    gravity_tilt,
    time_delay,
    inertial_parameters,
    encoder_offset,
    joint_elasticity,
    backlash,
    torque_ripple,
    actuator_fault,
    external_force,
)
