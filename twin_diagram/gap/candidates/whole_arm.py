"""What candidates of several joints are made with: sizes of the arm, and torque per inertial parameter of a link."""

from __future__ import annotations

import numpy as np

from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.rigid_body import rigid_tree
from twin_diagram.signals.arrays import Array


def reach(terms: Terms) -> float:
    """Return the length of the arm [m]."""
    return float(np.sum(np.linalg.norm(terms.records.model.tree.p_PF, axis=1))) + 0.1


def mass_scale(terms: Terms) -> float:
    """Return what a mass that is missing may weigh [kg]."""
    return 0.3 * float(np.max(terms.records.model.tree.inertia[:, 0])) + 0.5


def inertia_spread(terms: Terms) -> Array:
    """Return (10,) prior of inertial parameters."""
    m, length = mass_scale(terms), reach(terms)
    return np.concatenate([[m], np.full(3, 0.1 * m * length), np.full(6, m * (0.12 * length) ** 2)])


def link_spread(terms: Terms, body: int) -> Array:
    """Return (10,) prior of what is wrong with one link's inertia: of the order of that inertia."""
    own = np.array(terms.records.model.tree.inertia[body], dtype=float)
    mass = 0.5 * own[0] + 0.02 * mass_scale(terms)
    size = float(np.sqrt(max(float(np.sum(own[4:7])), 0.0) / max(own[0], 1e-9)))
    length = max(size, 0.05 * reach(terms))
    return np.concatenate([[mass], np.full(3, mass * length), np.full(6, mass * length**2)])


def in_link_frame(terms: Terms, body: int) -> Array:
    """Return (ΣD, n, 10) torque per inertial parameter in the frame of the body's own link."""
    model = terms.records.model
    _, X_ML = model.bodies.body_of(model.tree.link[body])
    return terms.rigid(body) @ rigid_tree.transform_inertia(X_ML)


def last_body(terms: Terms) -> int:
    """Return which body carries the last link."""
    return int(terms.records.model.bodies.body_of(terms.records.model.last_link)[0])
