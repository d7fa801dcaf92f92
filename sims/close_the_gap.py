"""Drives a robot that the twin does not know, finds what its model lacks, corrects it, and drives again.

The robot is an iiwa 7 in MuJoCo (`twin_diagram/station/mujoco.py`): another integrator, another law of friction, its
own drive and sensors, behind the ports of every station. A payload and dry friction are hidden in it. The twin has the
published description alone.

    1. two runs with the description's model: one to find the gap in, one held out
    2. `twin-diagram gap` on their logs: names, corrected model, report
    3. a task, driven with the torques that each model asks for: how far off is the twin's prediction, and the arm?

    python sims/close_the_gap.py --out out/close_the_gap
    python sims/close_the_gap.py --hide friction
"""

from __future__ import annotations

import argparse
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from twin_diagram.errors import TwinError
from twin_diagram.gap.correction.named_effects import sentence_of
from twin_diagram.gap.report.words import headline
from twin_diagram.gap.workflow import run_gap
from twin_diagram.logs import Log, write_log
from twin_diagram.logs.differentiation import inner
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import position_predicted, torque_residual_rms
from twin_diagram.scenario.resources import resolve
from twin_diagram.station import ports
from twin_diagram.station.mujoco import TUNING as MUJOCO
from twin_diagram.station.mujoco import MujocoStation, Secret

Array = npt.NDArray[np.float64]

HOME = np.array([0.0, 0.6, 0.0, -1.3, 0.0, 0.9, 0.0])
REACH = np.array([0.9, 0.5, 0.8, 0.6, 1.0, 0.8, 1.0])
"""Of motions about it [rad]."""

LOG_PERIOD = 0.002
SECRETS = {
    "payload": Secret(payload=2.2, payload_at=(0.03, 0.02, 0.09)),
    "friction": Secret(friction={"iiwa_joint_4": 6.0}),
    "both": Secret(payload=2.2, payload_at=(0.03, 0.02, 0.09), friction={"iiwa_joint_4": 6.0}),
    "nothing": Secret(),
}


class Commands(LeafSystem):
    """What the arm is asked: positions, and the torques that a model says they take.

    .. pydrake_system::

        name: Commands
        output_ports:
        - position
        - torque
    """

    def __init__(self, position: Array, torque: Array) -> None:
        """`position`, `torque`: (N, n), one row every `PERIOD`."""
        super().__init__()
        for name, table in (("position", position), ("torque", torque)):
            self.DeclareVectorOutputPort(name, table.shape[1], self._reader(table), {self.time_ticket()})

    @staticmethod
    def _reader(table: Array):  # type: ignore[no-untyped-def]
        def read(context: Context, output: BasicVector) -> None:
            output.SetFromVector(table[min(round(context.get_time() / MUJOCO.period), len(table) - 1)])

        return read


def exploring(duration: float, seed: int) -> Array:
    """A sum of sines about the home pose (N, n), at rest at both ends [rad]."""
    rng = np.random.default_rng([seed, 1])
    time = np.arange(0.0, duration, MUJOCO.period)
    harmonics = np.arange(1, 7)
    size = rng.uniform(0.3, 1.0, (6, 7)) / harmonics[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, 7))
    wave = np.einsum("thn,hn->tn", np.sin(0.75 * harmonics[None, :, None] * time[:, None, None] + phase), size)
    wave *= REACH / np.abs(wave).max(axis=0)
    return HOME + wave * (ease(time / 1.5) * ease((time[-1] - time) / 1.5))[:, None]


def task(seed: int) -> Array:
    """Moves between poses with short rests (N, n) [rad]."""
    rng = np.random.default_rng([seed, 2])
    poses = [HOME, *(HOME + rng.uniform(-1.0, 1.0, (5, 7)) * REACH), HOME]
    moving, still = np.arange(0.0, 1.6, MUJOCO.period), round(0.3 / MUJOCO.period)
    parts = [np.repeat(HOME[None], still, axis=0)]
    for a, b in pairwise(poses):
        parts += [a + (b - a) * ease(moving / 1.6)[:, None], np.repeat(b[None], still, axis=0)]
    return np.concatenate(parts)


def ease(s: Array) -> Array:
    """From 0 to 1 with speed and acceleration zero at both ends."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def drive(station: MujocoStation, model: Model, position: Array) -> Log:
    """Lets the arm follow a motion (N, n) with a model's torques as feed-forward; answers the log."""
    velocity = np.gradient(position, MUJOCO.period, axis=0)
    torque = model.inverse_dynamics(position, velocity, np.gradient(velocity, MUJOCO.period, axis=0))
    builder = DiagramBuilder()
    builder.AddSystem(station)
    commands = builder.AddSystem(Commands(position, torque))
    builder.Connect(commands.GetOutputPort("position"), station.GetInputPort(ports.POSITION_COMMANDED))
    builder.Connect(commands.GetOutputPort("torque"), station.GetInputPort(ports.TORQUE_COMMANDED))
    names = (ports.POSITION_MEASURED, ports.VELOCITY_ESTIMATED, ports.TORQUE_MEASURED, ports.MEASUREMENT_TIME)
    sinks = [LogVectorOutput(station.GetOutputPort(name), builder, LOG_PERIOD) for name in names]
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(MUJOCO.period * (len(position) - 1))
    q, v, tau, at = (sink.FindLog(simulator.get_context()).data().T for sink in sinks)
    fresh = np.flatnonzero(at[:, 0] >= 0.0)
    fresh = fresh[np.append(True, np.diff(at[fresh, 0]) > 0.0)]
    asked = position[np.minimum(np.round(at[fresh, 0] / MUJOCO.period).astype(int), len(position) - 1)]
    return Log(
        at[fresh, 0],
        station.joints,
        position=q[fresh],
        velocity=v[fresh],
        torque=tau[fresh],
        position_commanded=asked,
        source="drive",
    )


class Outcome:
    """How well each model told beforehand what the robot then did.

    Attributes:
        joints: names.
        log: of the task as driven with the corrected model.
        error: (given, corrected), each (M, n): measured less predicted position [rad].
        torque: (given, corrected), each (n,): residual torque, root mean square [N·m].
        tracking: (driven with the given model, with the corrected one), each (M, n): asked less measured [rad].
    """

    def __init__(self, given: Model, corrected: Model, first: Log, again: Log) -> None:
        kept = inner(again.time)
        self.joints, self.log, self.time = given.joints, again, again.time[kept]
        models = (given, corrected)
        self.error = [(again.position - position_predicted(model, again))[kept] for model in models]
        self.torque = [torque_residual_rms(model, again) for model in models]
        runs = (first, again)
        self.tracking = [(run.position_commanded - run.position)[inner(run.time)] for run in runs]  # type: ignore[operator]

    def table(self) -> str:
        """For the terminal."""
        lines = [
            f"{'':<20}{'predicted 0.2 s ahead':>24}{'residual torque':>24}{'tracking':>24}",
            f"{'':<20}{'mrad RMS':>24}{'N·m RMS':>24}{'mrad RMS':>24}",
            f"{'':<20}" + f"{'before':>12}{'after':>12}" * 3,
        ]
        columns = [1e3 * rms(x) for x in self.error] + self.torque + [1e3 * rms(x) for x in self.tracking]
        for k, joint in enumerate(self.joints):
            lines.append(f"{joint:<20}" + "".join(f"{column[k]:12.3f}" for column in columns))
        whole = [float(np.linalg.norm(column)) for column in columns]
        lines.append(f"{'all':<20}" + "".join(f"{value:12.3f}" for value in whole))
        return "\n".join(lines)

    def picture(self, path: Path, title: str) -> None:
        """Bars per joint and the worst joint over time."""
        figure = Figure(figsize=(11, 6.4), layout="constrained", facecolor="white")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.0))
        names = [joint.removeprefix("iiwa_").replace("_", " ") for joint in self.joints]
        where = np.arange(len(names))
        before, after = "#d9772b", "#2463a6"
        for column, (what, unit, pair) in enumerate(
            (
                ("Motion predicted 0.2 s ahead: error", "mrad", [1e3 * rms(x) for x in self.error]),
                ("Torque that the model cannot explain", "N·m", self.torque),
            )
        ):
            axes = figure.add_subplot(grid[0, column])
            for side, values, colour, label in zip(
                (-0.2, 0.2), pair, (before, after), ("description alone", "corrected model"), strict=True
            ):
                bars = axes.bar(where + side, values, 0.38, color=colour, label=label)
                axes.bar_label(bars, [f"{value:.2g}" for value in values], fontsize=7.5, padding=1, color=colour)
            axes.set_xticks(where, names, fontsize=8.5)
            axes.set_title(what, fontsize=11, loc="left")
            axes.set_ylabel(f"{unit} RMS", fontsize=9)
            dress(axes)
        axes.legend(frameon=False, fontsize=9)
        worst = int(np.argmax(rms(self.error[0])))
        axes = figure.add_subplot(grid[1, :])
        for values, colour in zip(self.error, (before, after), strict=True):
            axes.plot(self.time, 1e3 * values[:, worst], color=colour, lw=1.2)
        axes.axhline(0.0, color="#8a94a3", lw=0.8)
        axes.set_title(f"{names[worst]}: measured less predicted position during the task", fontsize=11, loc="left")
        axes.set_xlabel("time [s]", fontsize=9)
        axes.set_ylabel("mrad", fontsize=9)
        axes.set_xlim(self.time[0], self.time[-1])
        dress(axes)
        figure.suptitle(title, fontsize=13, x=0.01, ha="left", fontweight="bold")
        figure.savefig(path, dpi=130)


def dress(axes: Axes) -> None:
    """No frame, a light grid."""
    axes.grid(color="#e4e8ee", lw=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def rms(values: Array) -> Array:
    """Per column."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def main() -> int:
    """Parses the command line and runs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hide", choices=sorted(SECRETS), default="both", help="what is hidden (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of motions and noise (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/close_the_gap"), help="folder (default: %(default)s)")
    arguments = parser.parse_args()
    begin = time.perf_counter()
    try:
        close(arguments.hide, arguments.seed, arguments.out)
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{time.perf_counter() - begin:.0f} s in all")
    return 0


def close(secret: str, seed: int, out: Path) -> Outcome:
    """The three acts."""
    urdf = Path(resolve("arms/iiwa7.urdf"))
    out.mkdir(parents=True, exist_ok=True)
    given = Model.load(urdf)

    def robot(run: int) -> MujocoStation:
        return MujocoStation(urdf, SECRETS[secret], HOME, seed=100 * seed + run)

    print("driving the robot with the description's model")
    motions = {"fit": exploring(20.0, 10 * seed), "holdout": exploring(12.0, 10 * seed + 1)}
    for run, (name, motion) in enumerate(motions.items()):
        write_log(drive(robot(run), given, motion), out / f"{name}.csv")

    print("looking for what the model lacks")
    gap = run_gap(urdf, [out / "fit.csv"], out / "holdout.csv", out / "gap", lambda text: print(f"  {text}"))
    print(f"{headline(gap.verdict)} See {out / 'gap' / 'report.html'}")
    for finding in gap.verdict.findings:
        print(f"  {sentence_of(finding, gap.given.prismatic)} ({finding.confidence:.0%} sure)")

    print("driving a task with each model")
    corrected = Model.load(out / "gap" / "model")  # as anyone else would load it
    first, again = (drive(robot(k), model, task(seed)) for k, model in ((2, given), (3, corrected)))
    outcome = Outcome(given, corrected, first, again)
    outcome.picture(out / "close_the_gap.png", headline(gap.verdict))
    print(outcome.table())
    print(f"see {out / 'close_the_gap.png'}")
    return outcome


if __name__ == "__main__":
    sys.exit(main())
