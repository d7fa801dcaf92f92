"""A small arm in three formats, runs of it that follow a known law, and fabricated findings, for the tests of `gap`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.experiments import advice
from twin_diagram.gap.findings import Alternative, Estimate, Finding, Moment, Place, Separation, Verdict
from twin_diagram.logs import Log, write_log
from twin_diagram.model.effects import make
from twin_diagram.model.model import Model
from twin_diagram.scenario import EffectSpec

Array = npt.NDArray[np.float64]

JOINTS = ("shoulder", "elbow")

URDF = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="4"/>
    <inertia ixx="0.06" iyy="0.06" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 0.15"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" velocity="3" effort="80"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.4"/>
    <axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" velocity="3" effort="40"/></joint>
</robot>
"""

MJCF = """<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="base"><body name="upper" pos="0 0 0.3">
  <joint name="shoulder" axis="0 1 0" range="-2.5 2.5" limited="true"/>
  <inertial pos="0 0 0.2" mass="4" diaginertia="0.06 0.06 0.01"/>
  <body name="lower" pos="0 0 0.4"><joint name="elbow" axis="0 1 0" range="-2.5 2.5" limited="true"/>
  <inertial pos="0 0 0.15" mass="2" diaginertia="0.02 0.02 0.004"/></body></body></body></worldbody>
  <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator></mujoco>
"""

SDF = """<sdf version="1.7"><model name="arm"><link name="base"/>
  <link name="upper"><pose>0 0 0.3 0 0 0</pose><inertial><pose>0 0 0.2 0 0 0</pose><mass>4</mass>
    <inertia><ixx>0.06</ixx><iyy>0.06</iyy><izz>0.01</izz></inertia></inertial></link>
  <link name="lower"><pose>0 0 0.7 0 0 0</pose><inertial><pose>0 0 0.15 0 0 0</pose><mass>2</mass>
    <inertia><ixx>0.02</ixx><iyy>0.02</iyy><izz>0.004</izz></inertia></inertial></link>
  <joint name="shoulder" type="revolute"><parent>base</parent><child>upper</child><axis><xyz>0 1 0</xyz>
    <limit><lower>-2.5</lower><upper>2.5</upper><velocity>3</velocity><effort>80</effort></limit></axis></joint>
  <joint name="elbow" type="revolute"><parent>upper</parent><child>lower</child><axis><xyz>0 1 0</xyz>
    <limit><lower>-2.5</lower><upper>2.5</upper><velocity>3</velocity><effort>40</effort></limit></axis></joint>
</model></sdf>
"""


def arm(folder: Path, suffix: str = ".urdf") -> Path:
    """Writes the description."""
    path = folder / f"arm{suffix}"
    path.write_text({".urdf": URDF, ".xml": MJCF, ".sdf": SDF}[suffix])
    return path


def run(
    model: Model, effects: Sequence[EffectSpec] = (), seed: int = 0, duration: float = 8.0, start: float = 0.0
) -> Log:
    """A run that follows the model with effects, with a little noise on torques [N·m]."""
    true = model.with_effects([*model.effects, *(make(spec) for spec in effects)])
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, duration, 0.004)
    w = 2.0 * np.pi * rng.uniform(0.15, 0.7, (4, 2))
    size, phase = rng.uniform(0.1, 0.35, (4, 2)), rng.uniform(0.0, 6.0, (4, 2))
    angle = time[:, None, None] * w + phase
    q = np.sum(size * np.sin(angle), axis=1) + [0.4, -0.6]
    v = np.sum(size * w * np.cos(angle), axis=1)
    a = -np.sum(size * w**2 * np.sin(angle), axis=1)
    tau = true.inverse_dynamics(q, v, a) + rng.normal(size=q.shape) * 0.1
    q = q + rng.normal(size=q.shape) * 2e-6
    return Log(time + start, model.joints, q, torque=tau, source=f"run {seed}")


def write_runs(folder: Path, effects: Sequence[EffectSpec] = (), count: int = 2) -> list[Path]:
    """Runs of the arm of `arm` as CSV files."""
    model = Model.load(arm(folder))
    paths = [folder / f"run_{k}.csv" for k in range(count)]
    for k, path in enumerate(paths):
        write_log(run(model, effects, seed=k), path)
    return paths


def dry(torque: float = 3.0) -> EffectSpec:
    """Dry friction on the elbow."""
    return EffectSpec("coulomb_friction", ["elbow"], [], {"torque": [torque]})


def friction_finding(torque: float = 3.0, **changes: object) -> Finding:
    """What ought to be found of `dry`."""
    values: dict[str, object] = {
        "name": "coulomb_friction",
        "joints": ("elbow",),
        "links": (),
        "parameters": {"torque": {"elbow": Estimate(torque, 0.02, "N·m")}},
        "confidence": 0.97,
        "alternatives": (Alternative("torque_constant", ("elbow",), (), 0.02),),
    }
    return Finding(**{**values, **changes})  # type: ignore[arg-type]


def payload_finding() -> Finding:
    """Half a kilogramme at the last link."""
    com = Estimate([0.01, 0.0, 0.3], [0.001, 0.001, 0.004], "m")
    return Finding("payload", (), ("lower",), {"mass": Estimate(0.5, 0.01, "kg"), "com": com}, 0.999)


def verdict(kind: str, findings: Sequence[Finding] = (), remainder: bool = False) -> Verdict:
    """A fabricated one, with everything that it can hold."""
    near = (
        Separation("coulomb_friction on elbow", "viscous_friction on elbow", 4.2, advice.SPEEDS),
        Separation("coulomb_friction on elbow", "torque_constant on elbow", 6.1, advice.LOAD),
    )
    return Verdict(
        verdict=kind,  # type: ignore[arg-type]
        remainder=remainder,
        findings=tuple(findings),
        where=(Place("elbow", 0.9, "at velocity reversals", (0.4, 7.1)),) if kind != "none" else (),
        separation=near if findings else (),
        noise_floor=np.array([0.05, 0.05]),
    )


def begin(log: int, time: float) -> Moment:
    """An onset."""
    return Moment(log, time, 0.01)
