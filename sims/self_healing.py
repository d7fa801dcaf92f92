"""The twin heals itself: a robot changes while it works, and the twin notices, finds out, and mends its model.

The robot is an iiwa 7 in MuJoCo (`twin_diagram/station/mujoco.py`) behind the ports of every station. It starts as its
description says. After a while it carries a payload and two of its joints go dry; nobody tells the twin.

    1. the drift monitor raises an alarm
    2. when the log since the alarm is long enough, `twin-diagram gap` runs on it, in a process of its own
    3. the corrected model is taken over by filter, monitor and planner; the loop never stops

Beside it run the same filter and monitor on the same messages with the model as it was: what adapting alone can do.
Shown is how far off either is with where each joint, and the hand, will be 0.2 s later, under the torques that were
then measured.

    python sims/self_healing.py --out out/self_healing
    python sims/self_healing.py --quick
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from close_the_gap import HOME, Commands, exploring
from healing_report import AHEAD, LOOK, Plan, Run
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Adder

from twin_diagram.errors import TwinError
from twin_diagram.estimation.drift.alarm_events import append_lines
from twin_diagram.estimation.drift_system import DriftMonitor
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.dynamics.short_rollout import rollout
from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.logs import Log
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel, Filter, Healing, Planner
from twin_diagram.scenario import Twin as Told
from twin_diagram.scenario.resources import resolve
from twin_diagram.station import ports
from twin_diagram.station.mujoco import TUNING as MUJOCO
from twin_diagram.station.mujoco import MujocoStation, Secret
from twin_diagram.twin.healing import Healer, Tape, sentence
from twin_diagram.twin.twin import TwinDiagram, make_twin

Array = npt.NDArray[np.float64]

HIDDEN = Secret(payload=2.2, payload_at=(0.03, 0.02, 0.09), friction={"iiwa_joint_2": 7.0, "iiwa_joint_4": 6.0})
RATE = 500.0
"""Of the messages that are kept [1/s]."""
TUNING = Filter(torque_std=0.5, velocity_std=0.01, noise_time=0.0)
"""By the robot's data sheet: its torques are noisier than most, and its low-passed speeds lag while it accelerates.
Noise that is known is not adapted."""


QUICK = Plan(change=5.0, gather=12.0, answer=4.0, after=5.0)


def told(plan: Plan) -> Told:
    """All that the twin knows: the description."""
    arm = ArmModel(model="arms/iiwa7.urdf", tool_frame="iiwa_link_ee")
    # The simulation waits for the verdict; on a busy machine that may take minutes.
    healing = Healing(seconds=plan.gather, answer_after=plan.answer, patience=1800.0, nice=0)
    planner = Planner(rate=1.0)  # the motion is given: it only adds the torque that its model asks for
    return Told(arm=arm, home=HOME.tolist(), camera=None, planner=planner, healing=healing, filter=TUNING)


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
            q, _ = rollout(arm, parameters, state, theta, at, torques)
            truth = np.array([np.interp(at[-1], log.time, column) for column in log.position.T])
            rows.append(truth - q)
            away = twin.model.tool_pose(truth).translation() - twin.model.tool_pose(q).translation()
            distances.append(float(np.linalg.norm(away)))
        error[who], hand[who] = np.array(rows), np.array(distances)
    return Run(log.joints, plan, healer.swaps, events, ends[kept], error, hand, healer.model)


def main() -> int:
    """Parses the command line and runs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of motion and noise (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="a shorter run")
    parser.add_argument("--out", type=Path, default=Path("out/self_healing"), help="folder (default: %(default)s)")
    arguments = parser.parse_args()
    begin = time.perf_counter()
    try:
        run = heal(QUICK if arguments.quick else Plan(), arguments.seed, arguments.out)
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    run.picture(arguments.out / "self_healing.png")
    figures = {who: {phase: round(1e3 * run.rms(who, phase)[0], 3) for phase in run.spans} for who in run.error}
    (arguments.out / "self_healing.json").write_text(json.dumps({"hand_rms_mm": figures}, indent=2) + "\n")
    print(run.table())
    print(f"see {arguments.out / 'self_healing.png'} and {arguments.out / 'events.jsonl'}")
    print(f"{time.perf_counter() - begin:.0f} s in all")
    return 0


if __name__ == "__main__":
    sys.exit(main())
