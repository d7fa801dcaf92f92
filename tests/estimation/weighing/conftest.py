"""An iiwa with a gripper, a box in it and a short excitation, shared by the tests of weighing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from twin_diagram import scenario
from twin_diagram.estimation.weighing import Excitation, ExcitationPlan, Shape, optimise_excitation
from twin_diagram.estimation.weighing.harmonics import Harmonics
from twin_diagram.estimation.weighing.held import Held
from twin_diagram.logs.measured_log import Log
from twin_diagram.model import Model
from twin_diagram.model.rigid_body.mass_properties import parameters_of

MODEL = Path(__file__).resolve().parents[3] / "models" / "arms" / "iiwa7_wsg.urdf"
POSTURE = np.array([0.0, 0.6, 0.0, -1.4, 0.0, 1.0, 0.0])
EDGES = np.array([0.06, 0.09, 0.175])
Recorder = Callable[..., Log]


@pytest.fixture(scope="session")
def iiwa() -> Model:
    """Motor side."""
    return Model.load(scenario.ArmModel(model=str(MODEL), tool_frame="wsg_tcp"))


@pytest.fixture(scope="session")
def iiwa_link() -> Model:
    """Link side."""
    return Model.load(scenario.ArmModel(model=str(MODEL), tool_frame="wsg_tcp"), torque_side="link")


@pytest.fixture(scope="session")
def box() -> Shape:
    return Shape.box(EDGES)


@pytest.fixture(scope="session")
def X_TO() -> RigidTransform:
    """The thin side between the fingers, a little off the middle."""
    return RigidTransform(RollPitchYaw(0.2, 0.1, np.pi / 2), [0.01, 0.0, 0.02])


@pytest.fixture(scope="session")
def off_centre(box: Shape) -> np.ndarray:
    """A box of 0.8 kg of which 40 % lie in one point."""
    p = np.array([0.01, -0.02, 0.05])
    second = 0.6 * box.second + 0.4 * 0.6 * np.outer(p, p)
    return parameters_of(np.array(0.8), 0.4 * p, 0.8 * second)


@pytest.fixture(scope="session")
def excitation(iiwa: Model, X_TO: RigidTransform, box: Shape) -> Excitation:
    """Looked for not for long."""
    plan = ExcitationPlan(starts=1, steps=30)
    return optimise_excitation(iiwa, X_TO, box.even(0.5), POSTURE, plan=plan)


@pytest.fixture(scope="session")
def plain(iiwa: Model) -> Excitation:
    """A random motion of few harmonics, within no limits: for tests that do not optimise."""
    harmonics = Harmonics(10.0, 8)
    coefficients = 0.4 * np.random.default_rng(0).normal(size=(harmonics.size, 7))
    return Excitation(iiwa.joints, POSTURE, np.arange(7), harmonics, coefficients)


@pytest.fixture(scope="session")
def recorder() -> Recorder:
    """Makes logs: the arm's torques with or without an object, through sensors with gains, offsets and noise."""

    def record(
        model: Model,
        motion: Excitation,
        X_TO: RigidTransform | None = None,
        parameters: np.ndarray | None = None,
        *,
        gain: np.ndarray | float = 0.0,
        bias: np.ndarray | float = 0.0,
        viscous: np.ndarray | float = 0.0,
        dry: np.ndarray | float = 0.0,
        noise: float = 0.0,
        seed: int = 0,
    ) -> Log:
        time, (q, v, a) = motion.sampled(200.0)
        torque = model.inverse_dynamics(q, v, a)
        if X_TO is not None:
            torque = torque + Held.in_tool(model, X_TO).regressor(model, q, v, a) @ parameters
        torque = (1.0 + np.asarray(gain)) * (torque + viscous * v + dry * np.tanh(v / 0.02)) + bias
        torque = torque + noise * np.random.default_rng(seed).normal(size=torque.shape)
        return Log(time, model.joints, q, torque=torque)

    return record
