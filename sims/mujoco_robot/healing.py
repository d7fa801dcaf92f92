"""The robot that changes while it works, the twin that mends its model, and beside it the filter that only adapts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Adder

from mujoco_robot.driving import HOME, Commands, exploring
from mujoco_robot.healing_report import AHEAD, LOOK, Plan, Run
from twin_diagram.estimation import AdaptiveEkf, ArmTerms, DriftMonitor
from twin_diagram.estimation.drift.alarm_events import append_lines
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.dynamics.short_rollout import short_rollout
from twin_diagram.logs import Log
from twin_diagram.model import Model
from twin_diagram.scenario import ArmModel, Filter, Healing, Planner, Twin, resolve
from twin_diagram.signals.arrays import Array
from twin_diagram.station import ports
from twin_diagram.station.mujoco import TUNING as MUJOCO
from twin_diagram.station.mujoco import MujocoStation, Secret
from twin_diagram.twin import TwinDiagram, make_twin
from twin_diagram.twin.healing import Healer, Tape, sentence

HIDDEN = Secret(payload=2.2, payload_at=(0.03, 0.02, 0.09), friction={"iiwa_joint_2": 7.0, "iiwa_joint_4": 6.0})
RATE = 500.0
"""Of the messages that are kept [1/s]."""
TUNING = Filter(torque_std=0.5, velocity_std=0.01, noise_time=0.0)
"""By the robot's data sheet: its torques are noisier than most, and its low-passed speeds lag while it accelerates.
Noise that is known is not adapted."""
QUICK = Plan(change=5.0, gather=12.0, answer=4.0, after=5.0)


def told(plan: Plan) -> Twin:
    """All that the twin knows: the description."""
    arm = ArmModel(model="arms/iiwa7.urdf", tool_frame="iiwa_link_ee")
    # The simulation waits for the verdict; on a busy machine that may take minutes.
    healing = Healing(seconds=plan.gather, answer_after=plan.answer, patience=1800.0, nice=0)
    planner = Planner(rate=1.0)  # the motion is given: it only adds the torque that its model asks for
    return Twin(arm=arm, home=HOME.tolist(), camera=None, planner=planner, healing=healing, filter=TUNING)


def build(plan: Plan, seed: int, hidden: Secret) -> tuple[Diagram, TwinDiagram, AdaptiveEkf, Tape]:
    """The robot, the twin, and beside it the filter that keeps its model."""
    urdf, spec = Path(resolve("arms/iiwa7.urdf")), told(plan)
    builder = DiagramBuilder()
    station = builder.AddNamedSystem("station", MujocoStation(urdf, Secret(), HOME, seed, hidden, plan.change))
    twin = make_twin(spec)
    builder.AddNamedSystem("twin", twin.diagram)
    alone = builder.AddNamedSystem("filter_left_alone", AdaptiveEkf(twin.model, spec.filter, HOME))
    watch = builder.AddNamedSystem("monitor_left_alone", DriftMonitor(twin.model, spec.drift, spec.filter))
    for name in ports.output_names(station):
        builder.Connect(station.GetOutputPort(name), twin.diagram.GetInputPort(name))
        for system in (alone, watch):
            if system.HasInputPort(name.removeprefix("arm.")):
                builder.Connect(station.GetOutputPort(name), system.GetInputPort(name.removeprefix("arm.")))
    for name in ("arm_state", "parameters", "innovation", "nis"):
        builder.Connect(alone.GetOutputPort(name), watch.GetInputPort(name))
    builder.Connect(watch.GetOutputPort("alarm"), alone.GetInputPort("alarm"))
    motion = exploring(plan.duration, 10 * seed)
    velocity = np.gradient(motion, MUJOCO.period, axis=0)
    torque = twin.model.inverse_dynamics(motion, velocity, np.gradient(velocity, MUJOCO.period, axis=0))
    commands = builder.AddNamedSystem("commands", Commands(motion, torque))
    both = builder.AddNamedSystem("feed_forward", Adder(2, motion.shape[1]))
    builder.Connect(commands.GetOutputPort("torque"), both.get_input_port(0))
    builder.Connect(twin.diagram.GetOutputPort(ports.TORQUE_COMMANDED), both.get_input_port(1))
    builder.Connect(commands.GetOutputPort("position"), station.GetInputPort(ports.POSITION_COMMANDED))
    builder.Connect(both.get_output_port(), station.GetInputPort(ports.TORQUE_COMMANDED))
    tape = Tape(
        builder,
        station,
        commands.GetOutputPort("position"),
        twin.model.joints,
        rate=RATE,
        seconds=plan.duration,
    )
    return builder.Build(), twin, alone, tape


def heal(plan: Plan, seed: int, out: Path, hidden: Secret = HIDDEN, say: Any = print) -> Run:
    """The whole run."""
    out.mkdir(parents=True, exist_ok=True)
    diagram, twin, alone, tape = build(plan, seed, hidden)
    events: list[dict[str, Any]] = []
    (out / "events.jsonl").unlink(missing_ok=True)

    def journal(event: dict[str, Any]) -> None:
        events.append(event)
        append_lines(out / "events.jsonl", [event])
        say(f"{event['time']:7.2f} s  {sentence(event)}")

    simulator = Simulator(diagram)
    root = simulator.get_mutable_context()
    looks: dict[str, list[tuple[float, Array, Array, Model]]] = {"twin": [], "left alone": []}
    with Healer(twin, told(plan).healing, journal, tape, out / "healing") as healer:
        for k in range(1, round(plan.duration / LOOK)):
            simulator.AdvanceTo(LOOK * k)
            healer.poll(root)
            now = root.get_time()
            for who, system, model in (("twin", twin.ekf, healer.model), ("left alone", alone, twin.model)):
                own = system.GetMyContextFromRoot(root)
                state = np.array(system.GetOutputPort("arm_state").Eval(own))
                looks[who].append((now, state, np.array(system.GetOutputPort("parameters").Eval(own)), model))
        log = tape.cut(0.0, np.inf)
        return score(plan, healer, events, looks, log, twin)


def score(
    plan: Plan,
    healer: Healer,
    events: list[dict[str, Any]],
    looks: dict[str, list[tuple[float, Array, Array, Model]]],
    log: Log,
    twin: TwinDiagram,
) -> Run:
    """Rolls each look out under the torques that were measured after it, and compares with the encoders then."""
    terms: dict[int, tuple[ArmTerms, ParameterSet]] = {}
    error: dict[str, Array] = {}
    hand: dict[str, Array] = {}
    measured = log.motor_torque
    ends = np.array([t for t, *_ in looks["twin"]]) + AHEAD
    kept = ends <= log.time[-1]
    for who, seen in looks.items():
        rows, distances = [], []
        for t, state, theta, model in (look for look, keep in zip(seen, kept, strict=True) if keep):
            if id(model) not in terms:
                arm = ArmTerms.from_model(model)
                terms[id(model)] = (arm, ParameterSet(arm, TUNING))
            arm, parameters = terms[id(model)]
            at = np.linspace(t, t + AHEAD, round(AHEAD / 0.005) + 1)
            torques = np.stack([np.interp(at, log.time, column) for column in measured.T], axis=1)
            q, _ = short_rollout(arm, parameters, state, theta, at, torques)
            truth = np.array([np.interp(at[-1], log.time, column) for column in log.position.T])
            rows.append(truth - q)
            away = twin.model.tool_pose(truth).translation() - twin.model.tool_pose(q).translation()
            distances.append(float(np.linalg.norm(away)))
        error[who], hand[who] = np.array(rows), np.array(distances)
    return Run(log.joints, plan, healer.swaps, events, ends[kept], error, hand, healer.model)
