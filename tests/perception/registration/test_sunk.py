"""What lies in the table is unlikely, by as much as it is deep; a plane that is another thing's says nothing."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.perception.registration.sunk import TUNING, sunk_costs
from twin_diagram.perception.segmentation.planes import Plane

LOW, HIGH = -0.068, 0.092
"""A carton's foot is nearer to its middle than its roof [m]."""
CARTON = np.array([[x, y, z] for x in (-0.02, 0.02) for y in (-0.02, 0.02) for z in (LOW, HIGH)])


def tilted(height: float) -> tuple[np.ndarray, Plane]:
    """The rotation of a table's frame, and the table so high above W's origin along its normal."""
    R = exp(np.array([[0.3, -0.2, 0.5]]))[0]
    return R, Plane(R[:, 2], height, 1.0)


def test_upside_down_about_its_middle_it_lies_in_the_table() -> None:
    R, table = tilted(0.4)
    middle = R @ np.array([0.1, -0.2, 0.4 - LOW])
    over = np.diag([1.0, -1.0, -1.0])
    cost = sunk_costs(CARTON, Poses(np.stack([R, R @ over]), np.stack([middle, middle])), [table])
    assert cost[0] == pytest.approx(0.0, abs=1e-12)
    assert cost[1] == pytest.approx(0.5 * ((HIGH + LOW) / TUNING.sigma) ** 2)


def test_what_is_lifted_costs_nothing_and_what_stands_elsewhere_no_more_than_the_most() -> None:
    R, table = tilted(0.0)
    p = R[:, 2] * np.array([[0.5], [-0.5], [-5.0]])
    cost = sunk_costs(CARTON, Poses(np.repeat(R[None], 3, axis=0), p), [table])
    assert cost[0] == 0.0
    assert cost[1] == cost[2] == pytest.approx(0.5 * (TUNING.most / TUNING.sigma) ** 2)


def test_the_plane_of_a_thing_is_no_table() -> None:
    R, table = tilted(0.0)
    here = Poses(R[None], np.zeros((1, 3)))
    lid = Plane(table.normal, table.offset, 0.1, part=3)
    assert sunk_costs(CARTON, here, [lid])[0] == 0.0 and sunk_costs(CARTON, here, [])[0] == 0.0
    shelf = Plane(table.normal, -0.3, 1.0)
    assert sunk_costs(CARTON, here, [shelf, table])[0] == sunk_costs(CARTON, here, [table])[0] > 0.0
