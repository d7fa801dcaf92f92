"""Where a weight pulls is felt by the last joint as it turns, whatever bias, friction and gravity of the arm do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydrake.math import RigidTransform
from scipy.spatial.transform import Rotation

from tests.estimation.weighing.conftest import MODEL, POSTURE
from twin_diagram import scenario
from twin_diagram.estimation.weighing.held import Held
from twin_diagram.model import Model
from twin_diagram.runs.learning.bearing import Borne, holding
from twin_diagram.runs.learning.cell import Recording
from twin_diagram.runs.learning.felt_weight import Centre, Felt, centre_felt
from twin_diagram.runs.learning.following import Followed
from twin_diagram.runs.learning.handling import feel
from twin_diagram.runs.learning.shown_object import ShownObject
from twin_diagram.signals.arrays import Array

MASS = 1.37
CENTRE_T = np.array([0.035, -0.012, 0.05])
X_TS = np.eye(4)
X_TS[:3, :3], X_TS[:3, 3] = Rotation.from_rotvec([0.4, -0.2, 0.7]).as_matrix(), [0.01, 0.0, 0.03]


def arm() -> Model:
    return Model.load(scenario.ArmModel(model=str(MODEL), tool_frame="wsg_tcp"))


def turned(model: Model, leaning: tuple[float, ...], noise: float) -> Felt:
    """What the arm feels in a full turn at each leaning, the last joint's dry friction against the motion."""
    held, point = Held.in_tool(model, RigidTransform()), np.array([MASS, *(MASS * CENTRE_T), *[0.0] * 6])
    felt, rng = Felt(), np.random.default_rng(3)
    for number, lean in enumerate(leaning):
        way = 1.0 if number % 2 else -1.0
        q = np.tile(POSTURE, (300, 1))
        q[:, 5] += lean
        q[:, 6] = way * np.linspace(-2.95, 2.95, 300)
        still = np.zeros_like(q)
        torque = model.inverse_dynamics(q, still, still)
        torque[:, held.rows] += held.regressor(model, q, still, still) @ point
        torque[:, 6] += 0.25 + 0.4 * way
        torque += noise * rng.standard_normal(q.shape)
        for k in range(len(q)):
            felt.note(cell_at(q[k], torque[k]), 0.02 * k)
    return felt


def cell_at(q: Array, torque: Array) -> Any:
    return SimpleNamespace(q=q, torque=torque)


def box_S(size: tuple[float, float, float]) -> Array:
    """Corners (8, 3) in S of a box about the middle of the pads."""
    corners_T = 0.5 * np.array(size) * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    return np.asarray((corners_T - X_TS[:3, 3]) @ X_TS[:3, :3])


@pytest.mark.parametrize("noise", [0.05, 0.2])
def test_what_pulls_beside_the_axis_is_felt(noise: float) -> None:
    model, before = arm(), Centre.within(box_S((0.16, 0.06, 0.2)))
    found = centre_felt(model, turned(model, (0.7, 0.2, -0.4), noise), MASS, X_TS, before)
    centre_T = X_TS[:3, :3] @ found.mean + X_TS[:3, 3]
    told = np.sqrt(np.diag(X_TS[:3, :3] @ found.covariance @ X_TS[:3, :3].T))
    assert np.abs(centre_T - CENTRE_T)[:2].max() < 0.004, "its middle is 35 mm off"
    assert (np.abs(centre_T - CENTRE_T) < 3.0 * told).all() and told[:2].max() < 0.005
    assert told[2] > 0.03, "along the axis nothing is felt"


def test_what_was_felt_in_one_grasp_holds_in_the_next() -> None:
    model, before = arm(), Centre.within(box_S((0.16, 0.06, 0.2)))
    once = centre_felt(model, turned(model, (0.7,), 0.05), MASS, X_TS, before)
    again = centre_felt(model, turned(model, (0.7, 0.2), 0.05), MASS, X_TS, once)
    assert np.trace(again.covariance) < np.trace(once.covariance)


@pytest.mark.parametrize("opening", [0.05, 0.001])
def test_handling_notes_what_it_felt_of_what_it_still_holds(opening: float) -> None:
    model, felt = arm(), turned(arm(), (0.7, 0.2, -0.4), 0.05)
    torque = felt.torque[-1].copy()
    torque[6] -= 0.65  # what is measured at rest, but for the last joint's bias and friction

    @contextmanager
    def recording() -> Iterator[Recording]:
        yield Recording(torque=[torque])

    cell = SimpleNamespace(opening=opening, q=felt.q[-1], recording=recording, wait=lambda seconds: None)
    cell.borne, cell.time = Borne(), 0.0
    tools: Any = SimpleNamespace(cell=cell, model=model, driven=model)
    shown = ShownObject(Followed(points=box_S((0.16, 0.06, 0.2))), [np.linalg.inv(X_TS)])
    feel(tools, shown, felt)
    if opening < 0.004:
        assert shown.centre is None and shown.mass_at_rest is None and not cell.borne.torque(cell.q, 1.0).any()
        return
    assert shown.centre is not None and shown.mass_at_rest == pytest.approx(MASS, rel=0.15)
    off = X_TS[:3, :3] @ shown.centre.mean + X_TS[:3, 3] - CENTRE_T * MASS / shown.mass_at_rest
    assert np.abs(off)[:2].max() < 0.004
    borne = holding(model, MASS, CENTRE_T)(cell.q)
    assert cell.borne.torque(cell.q, 1.0) == pytest.approx(borne, rel=0.15, abs=0.05), "the driver bears it there"


def test_where_nothing_was_felt_the_middle_of_its_shape_stands() -> None:
    before = Centre.within(box_S((0.16, 0.06, 0.2)))
    assert centre_felt(arm(), Felt(), MASS, X_TS, before) is before
    hanging = centre_felt(arm(), turned(arm(), (-float(np.sum(POSTURE[[1, 3, 5]])),), 0.2), 0.05, X_TS, before)
    assert np.sqrt(np.diag(hanging.covariance)).max() > 0.02, "of what is light little is felt"
