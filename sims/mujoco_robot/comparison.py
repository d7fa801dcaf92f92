"""How well two models told beforehand what the robot then did: as a table and as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twin_diagram.logs import Log
from twin_diagram.logs.differentiation import inner
from twin_diagram.model import Model
from twin_diagram.model.prediction import position_predicted, torque_residual_rms
from twin_diagram.signals.arrays import Array


class Comparison:
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
