"""What a newcomer does, from an empty folder, by public commands and imports alone: how long it takes, and is it right?

An arm that does not come along (a URDF written here) gets its first scenario, runs, is recorded and replayed, is moved
by a controller of one's own and weighed; `gap` finds dry friction in a log with columns of its own, and an effect of
one's own; the filter follows a pendulum. Prints the time of each step; status 1 where one ends wrongly. Aim: 4 minutes
in all on two idle cores.

    python sims/benchmarks/newcomer.py
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from twin_diagram import Ekf, Filter, Model, Monitor, load_scenario, make_closed_loop
from twin_diagram.estimation import ArmTerms

AIM = 240.0
"""For all steps [s]."""

JOINTS = ("turn", "lean", "bend")

ARM = """<robot name="picker">
  <link name="stand"/>
  <link name="turret"><inertial><origin xyz="0 0 0.06"/><mass value="6"/>
    <inertia ixx="0.03" iyy="0.03" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 0.05"/><geometry><cylinder radius="0.07" length="0.12"/></geometry></collision></link>
  <link name="upper"><inertial><origin xyz="0 0 0.18"/><mass value="3.2"/>
    <inertia ixx="0.04" iyy="0.04" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 0.2"/><geometry><box size="0.08 0.08 0.36"/></geometry></collision></link>
  <link name="fore"><inertial><origin xyz="0 0 0.14"/><mass value="1.7"/>
    <inertia ixx="0.015" iyy="0.015" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 0.16"/><geometry><cylinder radius="0.035" length="0.28"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="stand"/><child link="turret"/><origin xyz="0 0 0.1"/>
    <axis xyz="0 0 1"/><limit lower="-2.8" upper="2.8" velocity="2.5" effort="40"/></joint>
  <joint name="lean" type="revolute"><parent link="turret"/><child link="upper"/><origin xyz="0 0 0.15"/>
    <axis xyz="0 1 0"/><limit lower="-1.8" upper="1.8" velocity="2.5" effort="60"/></joint>
  <joint name="bend" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.4"/>
    <axis xyz="0 1 0"/><limit lower="-2.4" upper="2.4" velocity="3" effort="30"/></joint>
</robot>
"""

COLUMNS = """joints: [turn, lean, bend]
time: {column: stamp, unit: ms}
position_measured: {column: "angle_{i}", first: 1, unit: deg}
torque_measured: {column: "moment_{i}", first: 1, unit: N·m}
"""

DRAG = '''"""Drag that grows with the square of the speed."""
from twin_diagram import Effect, ParameterKind, register


@register
class QuadraticDrag(Effect):
    """Drag that grows with the square of the speed."""

    name = "quadratic_drag"
    kinds = {"drag": ParameterKind("N·m·s²/rad²", lower=0.0)}

    def torque(self, model, q, v, a, tau):
        return self.spread(model.joints, self.value("drag")) * v * abs(v)
'''

PENDULUM = """<robot name="pendulum"><link name="rod"><inertial><origin xyz="0 0 -0.4"/><mass value="1.5"/>
  <inertia ixx="0.01" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="pin" type="continuous"><parent link="world"/><child link="rod"/><axis xyz="0 1 0"/></joint></robot>"""


class WrongError(Exception):
    """A step ended otherwise than it should."""


def right(good: bool, what: object) -> None:
    """Goes on where a result is right."""
    if not good:
        raise WrongError(str(what))


def command(*argv: str) -> str:
    """Runs ``twin-diagram`` in the folder; what it printed."""
    done = subprocess.run([sys.executable, "-m", "twin_diagram", *argv], capture_output=True, text=True)
    right(done.returncode == 0, f"twin-diagram {argv[0]}: status {done.returncode}: {done.stderr[-500:]}")
    return done.stdout


def first_scenario() -> str:
    """One's own description becomes a scenario."""
    Path("my.urdf").write_text(ARM)
    command("init", "--arm", "my.urdf", "--out", "my.yaml")
    scenario = load_scenario("my.yaml")
    right(scenario.twin.camera is not None and len(scenario.twin.home) == 3, "no camera or home")
    return f"{len(Path('my.yaml').read_text().splitlines())} lines"


def run() -> str:
    """It runs as it is, and is recorded."""
    command("run", "my.yaml", "--duration", "2", "--out", "out", "--record", "recording", "--log", "run.csv")
    summary = json.loads(Path("out/summary.json").read_text())
    error = summary["arm"]["joint_error_rad"]["max"]
    right(error < 1e-3 and not summary["alarms"] and not summary["health"], summary)
    right(list(summary["arm"]["joints"]) == list(JOINTS) and Path("out/replay.html").is_file(), "joints, replay.html")
    return f"joint error at most {error:.1e} rad, nothing is lacking"


def replay() -> str:
    """The twin sees in the recording what it saw in the run."""
    belief = json.loads(command("replay", "recording", "--out", "again"))
    log = np.genfromtxt("run.csv", delimiter=",", names=True, deletechars="")
    measured = {joint: float(log[f"position_measured.{joint}"][-1]) for joint in JOINTS}
    far = max(abs(belief["joints"][joint] - measured[joint]) for joint in JOINTS)
    right(far < 1e-3 and belief["time_s"] > 1.9 and not belief["health"], belief)
    return f"to {belief['time_s']:.2f} s, the arm {far:.0e} rad from the log's last row"


class Swing(LeafSystem):
    """A controller of one's own: each joint swings around where it began."""

    def __init__(self, home: list[float]) -> None:
        super().__init__()
        self.home = np.array(home)
        self.DeclareVectorInputPort("arm_state", 6)
        self.DeclareVectorOutputPort("position_commanded", 3, self.calc)

    def calc(self, context: Context, output: BasicVector) -> None:
        """Writes the joints' angles [rad]."""
        output.SetFromVector(self.at(context.get_time()))

    def at(self, t: float) -> Any:
        """Angles at a time [rad]; the swing fades in."""
        return self.home + min(t, 1.0) * np.array([0.3, 0.3, 0.5]) * np.sin([1.7 * t, 2.3 * t, 3.1 * t])


def controller() -> str:
    """It moves the arm, and the twin weighs what it was not told of."""
    hidden = "world.arm.effects=[{name: payload, parameters: {mass: [0.6], com: [0.0, 0.0, 0.3]}}]"
    scenario = load_scenario("my.yaml", ["twin.camera=null", "twin.home=[0.0, 0.5, 0.7]", hidden])
    swing = Swing(scenario.twin.home)
    loop = make_closed_loop(scenario, controller=swing)
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(5.0)
    twin = loop.twin.diagram
    context = twin.GetMyContextFromRoot(simulator.get_context())
    q = np.array(twin.GetOutputPort("arm_state").Eval(context))[:3]
    mass = float(np.array(twin.GetOutputPort("parameters").Eval(context))[0])
    late = float(np.abs(q - swing.at(5.0)).max())
    right(late < 0.1, f"the arm is {late:.3f} rad from what was commanded")
    right(abs(mass - 0.6) < 0.06, f"{mass:.3f} kg of 0.6")
    return f"{late:.3f} rad behind its command, payload {mass:.3f} of 0.6 kg"


def write_run(path: str, seed: int, dry: float = 0.0, drag: float = 0.0) -> None:
    """Writes a log with columns of its own: ten seconds of motion, friction on `bend` or drag on `lean`, noise."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 10.0, 0.004)
    w, size = 2.0 * np.pi * rng.uniform(0.15, 0.7, (4, 3)), rng.uniform(0.1, 0.3, (4, 3))
    angle = t[:, None, None] * w + rng.uniform(0.0, 6.0, (4, 3))
    q = (size * np.sin(angle)).sum(axis=1) + [0.0, 0.3, -0.4]
    v, a = (size * w * np.cos(angle)).sum(axis=1), -(size * w**2 * np.sin(angle)).sum(axis=1)
    tau = Model.load("my.urdf").inverse_dynamics(q, v, a) + rng.normal(0.0, 0.1, q.shape)
    tau[:, 2] += dry * np.sign(v[:, 2])
    tau[:, 1] += drag * v[:, 1] * np.abs(v[:, 1])
    header = ",".join(["stamp", *(f"{what}_{k}" for what in ("angle", "moment") for k in (1, 2, 3))])
    rows = np.column_stack([1000.0 * t, np.rad2deg(q + rng.normal(0.0, 2e-6, q.shape)), tau])
    np.savetxt(path, rows, "%.10g", ",", header=header, comments="")


def found(out: str, *argv: str) -> dict[str, Any]:
    """Runs `gap` on the logs in the folder; the one effect that it named."""
    Path("columns.yaml").write_text(COLUMNS)
    logs = ("--columns", "columns.yaml", "--fit", "fit.csv", "--holdout", "held.csv")
    command("gap", "--model", "my.urdf", *logs, "--out", out, *argv)
    gap = json.loads(Path(out, "gap.json").read_text())
    right(gap["verdict"] == "named" and len(gap["effects"]) == 1, (gap["verdict"], gap["effects"]))
    effect: dict[str, Any] = gap["effects"][0]
    return effect


def own_log() -> str:
    """`gap` finds dry friction in a log whose columns have names and units of their own."""
    write_run("fit.csv", 1, dry=1.5)
    write_run("held.csv", 2, dry=1.5)
    effect = found("gap")
    torque = effect["parameters"]["torque"]["bend"]["value"]
    right((effect["name"], effect["joints"]) == ("coulomb_friction", ["bend"]) and abs(torque - 1.5) < 0.05, effect)
    return f"coulomb_friction on bend, {torque:.3f} of 1.5 N·m, confidence {effect['confidence']:.2f}"


def own_effect() -> str:
    """`gap` finds an effect that a file of one's own registers."""
    Path("drag.py").write_text(DRAG)
    write_run("fit.csv", 3, drag=1.2)
    write_run("held.csv", 4, drag=1.2)
    effect = found("drag", "--import", "drag.py")
    drag = effect["parameters"]["drag"]["lean"]["value"]
    right((effect["name"], effect["joints"]) == ("quadratic_drag", ["lean"]) and abs(drag - 1.2) < 0.05, effect)
    return f"quadratic_drag on lean, {drag:.4f} of 1.2 N·m·s²/rad²"


def pendulum() -> str:
    """The filter learns a pendulum's damping, and the monitor has nothing to say."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(PENDULUM, "urdf")
    plant.Finalize()
    terms = ArmTerms(plant, ["pin"])
    learning = Filter(parameters=["viscous_friction"])
    ekf, monitor = Ekf(terms, learning), Monitor(terms, tuning=learning)
    q, v, step, damping, rng = 2.0, 0.0, 1e-3, 0.15, np.random.default_rng(0)
    inertia = 0.02 + 1.5 * 0.4**2
    for k in range(10000):
        if k % 5 == 0:
            measured = np.array([q + rng.normal(0.0, 1e-5)])
            ekf.heed(monitor.alarm())
            ekf.observe(measured, np.array([v]), np.zeros(1), k * step)
            monitor.watch(ekf.belief, measured, np.zeros(1))
        v -= step * (1.5 * 9.81 * 0.4 * np.sin(q) + damping * v) / inertia  # symplectic, of 0.1 % of a swing
        q += step * v
    (learnt,) = ekf.standings(("pin",))
    right(abs(learnt.value - damping) < 0.015, learnt)
    right(not monitor.active, "an alarm on the exact model")
    return str(learnt)


STEPS = {
    "init from a foreign URDF": first_scenario,
    "run and record": run,
    "replay": replay,
    "own controller": controller,
    "own log through gap": own_log,
    "own effect (--import)": own_effect,
    "filter on a pendulum": pendulum,
}


def main() -> int:
    """Prints a line for each step; status 1 where one ends wrongly."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    here, wrong, begin = Path.cwd(), 0, time.perf_counter()
    with TemporaryDirectory() as place:
        os.chdir(place)
        for name, step in STEPS.items():
            before = time.perf_counter()
            try:
                said = step()
            except (WrongError, OSError, ValueError, KeyError) as error:
                wrong += 1
                said = f"WRONG: {' '.join(f'{type(error).__name__}: {error}'.split())[:300]}"
            print(f"{name:<26}{time.perf_counter() - before:7.1f} s  {said}", flush=True)
        os.chdir(here)
    took = time.perf_counter() - begin
    print(f"{'in all':<26}{took:7.1f} s  {'within' if took <= AIM else 'above'} the aim of {AIM:g} s; {wrong} wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
