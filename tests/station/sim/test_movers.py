"""Carriages by Newton's law over one step of the plant, paths in closed form, and what cannot be pushed."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.math import RotationMatrix
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import System

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Pose, WayPoint
from twin_diagram.signals.arrays import Array
from twin_diagram.station.sim.movers import MoverDriver, Path, add_carriage

STEP = 1e-3


def way(time: float, x: float, y: float = 0.0, yaw: float = 0.0, z: float = 0.1, roll: float = 0.0) -> WayPoint:
    return WayPoint(time, Pose([x, y, z], [roll, 0.2, yaw]))


# Paths.


def test_between_two_way_points_the_motion_is_the_cubic_that_rests_at_both() -> None:
    path = Path([way(1.0, 0.2, -0.4, 0.5), way(3.0, 0.6, 0.4, -0.5)], "p")
    moved = np.array([0.4, 0.8, -1.0])
    for share in (0.0, 0.25, 0.5, 0.9, 1.0):
        at, rate = path.state(1.0 + 2.0 * share)
        np.testing.assert_allclose(at, [0.2, -0.4, 0.5] + (3.0 * share**2 - 2.0 * share**3) * moved, atol=1e-12)
        np.testing.assert_allclose(rate, 0.5 * 6.0 * share * (1.0 - share) * moved, atol=1e-12)


def test_it_rests_before_the_first_and_after_the_last() -> None:
    for points in ([way(1.0, 0.2)], [way(1.0, 0.2), way(2.0, 0.5)], [way(1.0, 0.2), way(2.0, 0.5), way(2.5, 0.9)]):
        path = Path(points, "p")
        for time, x in ((-5.0, 0.2), (1.0, 0.2), (points[-1].time, points[-1].X_WO.translation[0]), (9.0, None)):
            at, rate = path.state(time)
            assert at[0] == pytest.approx(points[-1].X_WO.translation[0] if x is None else x)
            np.testing.assert_allclose(rate, 0.0, atol=1e-12)


def test_the_rate_is_the_derivative_of_the_place() -> None:
    path = Path([way(0.0, 0.0), way(0.7, 0.3, 0.2, 0.5), way(1.5, 0.4, 0.1, 0.9), way(2.0, 0.9, 0.1, 0.2)], "p")
    for time in np.linspace(0.05, 1.95, 20):
        step = (path.state(time + 1e-5)[0] - path.state(time - 1e-5)[0]) / 2e-5
        np.testing.assert_allclose(path.state(time)[1], step, atol=1e-4)


def test_yaw_takes_the_shorter_way_round() -> None:
    path = Path([way(0.0, 0.0, yaw=3.0), way(1.0, 0.0, yaw=-3.0)], "p")
    assert path.points[2, 1] == pytest.approx(2.0 * np.pi - 3.0)


def test_way_points_lie_in_one_plane_to_a_micrometre() -> None:
    for off in (0.7e-6, -0.7e-6):
        Path([way(0.0, 0.0), way(1.0, 0.1, z=0.1 + off, roll=off)], "p")
    for bad in (way(1.0, 0.1, z=0.1 + 1.4e-6), way(1.0, 0.1, roll=-1.4e-6)):
        with pytest.raises(ScenarioError, match=r"p\[1\]\.X_WO: .*x, y and yaw alone"):
            Path([way(0.0, 0.0), bad], "p")


def test_times_increase() -> None:
    for later in (1.0, 0.5):
        with pytest.raises(ScenarioError, match=r"p\[1\]\.time: .* is not after 1\.0"):
            Path([way(1.0, 0.0), way(later, 0.1)], "p")


# Carriages.


def pushed(mass: float, off: Array, inertia: float = 1e-9, push: float | None = None) -> Array:
    """Speeds of x, y and yaw after one step, from rest, where the goal is `off` away."""
    plant = MultibodyPlant(STEP)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    radius = np.sqrt(2.5 * inertia / mass)
    body = plant.AddRigidBody("object", SpatialInertia.SolidSphereWithMass(mass, radius))
    instance = plant.AddModelInstance("carriages")
    path = Path([way(0.0, 0.3, -0.2, 0.4)], "p")
    actuators = add_carriage(plant, instance, "thing", path, body, push)
    plant.Finalize()
    assert len(actuators) == 3 and plant.num_positions() == 3
    simulator = Simulator(plant)
    context = simulator.get_mutable_context()
    np.testing.assert_allclose(plant.GetPositions(context), [0.3, -0.2, 0.4])
    X_WO = plant.EvalBodyPoseInWorld(context, body)
    np.testing.assert_allclose(X_WO.translation(), [0.3, -0.2, 0.1])
    wanted = RotationMatrix.MakeZRotation(0.4) @ RotationMatrix.MakeYRotation(0.2)
    np.testing.assert_allclose(X_WO.rotation().matrix(), wanted.matrix(), atol=1e-12)
    goal = np.concatenate([[0.3, -0.2, 0.4] + off, np.zeros(3)])
    plant.get_desired_state_input_port(instance).FixValue(context, goal)
    simulator.AdvanceTo(0.5 * STEP)
    return np.array(plant.GetVelocities(context))


def test_a_carriage_is_a_stiff_damped_spring_that_is_solved_implicitly() -> None:
    """M v = h (k (e − h v) − d v), with three carriages of a gram under the object, two of which turn not."""
    k, d = 2e4, 4e2
    for axis, mass in ((0, 0.103), (1, 0.102)):
        off = 0.004 * np.eye(3)[axis]
        v = pushed(0.1, off)
        assert v[axis] == pytest.approx(STEP * k * 0.004 / (mass + STEP * d + STEP**2 * k), rel=1e-3)
    v = pushed(0.1, np.array([0.0, 0.0, 0.004]), inertia=0.2)
    assert v[2] == pytest.approx(STEP * k * 0.004 / (0.2 + STEP * d + STEP**2 * k), rel=1e-3)


def test_it_pushes_with_two_hundred_newtons_at_most_and_weighs_a_gram() -> None:
    assert pushed(0.5, np.array([5.0, 0.0, 0.0]))[0] == pytest.approx(STEP * 200.0 / 0.503, rel=1e-3)
    assert pushed(1e-3, np.array([50.0, 0.0, 0.0]))[0] == pytest.approx(STEP * 200.0 / 4e-3, rel=1e-3)
    # A ball of a gram and a centimetre: 2/5 m r² = 4e-8 kg·m².
    v = pushed(1e-3, np.array([0.0, 0.0, 1e7]), inertia=1e-9)
    assert v[2] == pytest.approx(STEP * 200.0 / (4e-8 + 1e-9), rel=1e-2)


def test_what_gives_way_is_pushed_with_what_is_told_and_turned_with_a_tenth() -> None:
    assert pushed(0.5, np.array([0.0, 5.0, 0.0]), push=15.0)[1] == pytest.approx(STEP * 15.0 / 0.502, rel=1e-3)
    v = pushed(1e-3, np.array([0.0, 0.0, 1e7]), inertia=1e-9, push=15.0)
    assert v[2] == pytest.approx(STEP * 1.5 / (4e-8 + 1e-9), rel=1e-2)


def test_the_driver_says_all_places_then_all_speeds() -> None:
    paths = {"a": Path([way(0.0, 0.1), way(1.0, 0.5)], "a"), "b": Path([way(0.0, 0.0, 0.3), way(2.0, 0.0, 0.9)], "b")}
    driver: System = MoverDriver(paths)
    context = driver.CreateDefaultContext()
    context.SetTime(0.5)
    found = driver.get_output_port().Eval(context)
    (x1, v1), (x2, v2) = (path.state(0.5) for path in paths.values())
    np.testing.assert_array_equal(found, np.concatenate([x1, x2, v1, v2]))
    assert found.shape == (12,) and v1[0] > 0.0 and v2[1] > 0.0
