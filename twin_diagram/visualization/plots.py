"""A finished run in plots: errors against truth, payload, clearance, computing time."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar, cast

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from twin_diagram.runtime import atomic_file
from twin_diagram.signals import units
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.stretches import stretches

INK: Final = "#1f2933"
"""Of text and axes."""
LINES: Final = ("#1864ab", "#c2410c", "#0b7285", "#5f3dc4", "#a61e4d", "#5c940d", "#846358", "#495057")
"""Colours of lines, in order."""
STYLE: Final = {
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 10,
    "axes.edgecolor": "#9aa5b1",
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e7eb",
    "grid.linewidth": 0.8,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "savefig.dpi": 150,
    "font.family": ["DejaVu Sans"],
}
"""Matplotlib's settings while a plot is drawn."""
SHADES: Final = {
    ObjectStatus.STALE: ("#ffc9c9", "stale"),
    ObjectStatus.LOST: ("#dee2e6", "lost"),
    ObjectStatus.MOVING: ("#fff3bf", "moving"),
}
"""Colour and word for the times at which an object is not simply tracked."""
HIDDEN_SHARE: Final = 0.3
"""An object that shows less of its camera-facing surface than this counts as hidden."""

Plot = TypeVar("Plot", bound=Callable[..., Path])


def _styled(plot: Plot) -> Plot:
    """Draw in this module's style, whatever the process has set."""

    @functools.wraps(plot)
    def wrapper(*args: Any, **kwargs: Any) -> Path:
        with matplotlib.rc_context(dict(STYLE)):
            return plot(*args, **kwargs)

    return cast(Plot, wrapper)


class Run(Protocol):
    """What of a finished run is plotted, see `score.RunRecord`; the leading axis is time, K objects, n joints."""

    time: Array
    seen: Array
    poses_true: Array
    poses_estimated: Array
    status: npt.NDArray[np.int64]
    arm_true: Array
    arm_estimated: Array
    mass: Array
    mass_std: Array
    clearance: Array
    goal_error: Array
    objects: Sequence[str]
    symmetric_axis: Mapping[str, str | None]
    prismatic: Collection[str]

    def joint_names(self) -> list[str]:
        """Return the joints' names."""

    def rotation_error(self, index: int) -> Array:
        """Return (T,) how far an object's estimated orientation is off, up to symmetries [rad]."""


def write_plots(run: Run, summary: Mapping[str, Any], folder: str | Path) -> list[Path]:
    """Write ``objects.png``, ``arm.png``, ``payload.png``, ``clearance.png`` and ``timing.png``.

    Args:
        run: the samples.
        summary: as in ``summary.json``; gives the true payload, the alarms and the shares of computing time.
        folder: where they go.

    Returns:
        The files; what a run has no figures for (objects, payload, timing) is left out.
    """
    folder = Path(folder)
    alarms = [(float(alarm["time"]), str(alarm["kind"])) for alarm in summary["alarms"]]
    written = []
    if len(run.objects) > 0:
        written.append(objects(run, folder / "objects.png"))
    written.append(arm(run, alarms, folder / "arm.png"))
    if np.isfinite(run.mass).any():
        written.append(payload(run, summary["payload"]["mass_true"], folder / "payload.png"))
    written.append(clearance(run, folder / "clearance.png"))
    shares = summary["timing"].get("systems", {})
    if shares:
        written.append(timing(shares, float(summary["timing"]["real_time_factor"]), folder / "timing.png"))
    return written


@_styled
def objects(run: Run, path: Path) -> Path:
    """Draw the position and rotation error of each object over time.

    Shaded where it moves, is stale, lost or hidden.
    """
    count = len(run.objects)
    figure = _figure(10, 1.0 + 1.5 * count)
    grid = figure.subplots(count, 2, sharex=True, squeeze=False)
    position, rotation = object_errors(run)
    for k, name in enumerate(run.objects):
        tracked = run.status[:, k] != ObjectStatus.UNSEEN
        for axes, errors, unit in ((grid[k, 0], position[:, k], "mm"), (grid[k, 1], rotation[:, k], "°")):
            _shade(axes, run, k)
            shown = np.where(tracked, errors, np.nan)
            axes.plot(run.time, shown, color=LINES[0])
            high = np.nanmax(shown) if np.isfinite(shown).any() else 0.0
            axes.set_ylim(0, max(1.15 * high, 0.5))
            axes.set_ylabel(f"[{unit}]")
            axes.axhline(5.0, color="#868e96", linewidth=0.9, linestyle=(0, (4, 3)))
        free = run.symmetric_axis.get(name)
        grid[k, 0].set_title(f"{name}: position error")
        grid[k, 1].set_title(f"{name}: rotation error" + (f" (tilt; turn about {free} is free)" if free else ""))
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    patches = [Patch(color=colour, label=label) for colour, label in SHADES.values()]
    patches.append(Patch(facecolor="#ffffff", edgecolor="#adb5bd", hatch="////", label="hidden"))
    line = Line2D([], [], color="#868e96", linewidth=0.9, linestyle=(0, (4, 3)), label="5 mm, 5°")
    figure.legend(handles=[*patches, line], loc="outside lower center", ncols=5)
    return _save(figure, path)


def object_errors(run: Run) -> tuple[Array, Array]:
    """Return (T, K) position errors [mm] and rotation errors up to symmetries [°]."""
    position = 1e3 * np.linalg.norm(run.poses_estimated[..., 4:] - run.poses_true[..., 4:], axis=-1)
    rotation = np.array([run.rotation_error(k) for k in range(len(run.objects))]).reshape(position.T.shape).T
    return position, np.degrees(rotation)


@_styled
def arm(run: Run, alarms: Sequence[tuple[float, str]], path: Path) -> Path:
    """Draw the error of each joint's position and speed over time, and the drift monitor's alarms."""
    figure = _figure(10, 5.5)
    upper, lower = figure.subplots(2, 1, sharex=True)
    names = run.joint_names()
    n = len(names)
    error = run.arm_estimated - run.arm_true
    slide = [name in run.prismatic for name in names]
    # A thousandth of either unit: mrad, and mm where the joint is prismatic.
    several = any(slide) and not all(slide)
    for joint, name in enumerate(names):
        colour = LINES[joint % len(LINES)]
        label = f"{name} [{units.on_joint('mrad', slide[joint])}]" if several else name
        upper.plot(run.time, 1e3 * error[:, joint], color=colour, label=label, linewidth=1.2)
        lower.plot(run.time, 1e3 * error[:, n + joint], color=colour, linewidth=1.2)
    for k, (time, kind) in enumerate(alarms):
        for axes in (upper, lower):
            axes.axvline(
                time, color="#e03131", linewidth=1.0, label=f"alarm: {kind}" if k == 0 and axes is upper else None
            )
    both = [each for each, there in ((False, not all(slide)), (True, any(slide))) if there]
    upper.set_title("Joint position: estimated − true")
    upper.set_ylabel(", ".join(f"[{units.on_joint('mrad', each)}]" for each in both))
    lower.set_title("Joint speed: estimated − true")
    lower.set_ylabel(", ".join(f"[{units.on_joint('mrad/s', each)}]" for each in both))
    lower.set_xlabel("time [s]")
    figure.legend(loc="outside lower center", ncols=min(n + 1, 5))
    return _save(figure, path)


@_styled
def payload(run: Run, true: float | None, path: Path) -> Path:
    """Draw the learned payload over time with two standard deviations either side, and the tool's true one."""
    figure = _figure(10, 3.4)
    axes = figure.subplots()
    axes.fill_between(
        run.time, run.mass - 2 * run.mass_std, run.mass + 2 * run.mass_std, color="#d0ebff", label="± 2 std"
    )
    axes.plot(run.time, run.mass, color=LINES[0], label="estimated")
    if true is not None:
        axes.axhline(true, color=INK, linestyle=(0, (5, 3)), linewidth=1.3, label="true, nothing in the hand")
    reach = [*run.mass, *([] if true is None else [true])]
    span = max(np.ptp(reach), 0.1)
    axes.set_ylim(min(reach) - 0.4 * span, max(reach) + 0.4 * span)
    axes.set_title("Payload")
    axes.set_ylabel("mass [kg]")
    axes.set_xlabel("time [s]")
    axes.legend(loc="best", ncols=3)
    return _save(figure, path)


@_styled
def clearance(run: Run, path: Path) -> Path:
    """Draw the true distance from the arm to anything else over time and, with a goal, the tool's distance from it."""
    with_goal = bool(np.isfinite(run.goal_error).any())
    figure = _figure(10, 5.5 if with_goal else 3.2)
    rows = figure.subplots(2 if with_goal else 1, 1, sharex=True, squeeze=False)[:, 0]
    rows[0].plot(run.time, 1e3 * run.clearance, color=LINES[1])
    rows[0].axhline(0, color="#e03131", linewidth=1.2)
    lowest = int(np.argmin(run.clearance))
    rows[0].plot(run.time[lowest], 1e3 * run.clearance[lowest], "o", color=LINES[1])
    rows[0].annotate(
        f"least: {1e3 * run.clearance[lowest]:.0f} mm",
        (run.time[lowest], 1e3 * run.clearance[lowest]),
        xytext=(8, 8),
        textcoords="offset points",
        color=INK,
    )
    rows[0].set_ylim(min(-5.0, 1e3 * run.clearance.min() - 5), 1.2e3 * max(run.clearance.max(), 0.01))
    rows[0].set_title("Clearance: arm to anything else, true")
    rows[0].set_ylabel("[mm]")
    if with_goal:
        rows[1].plot(run.time, 1e3 * run.goal_error, color=LINES[0])
        rows[1].set_ylim(bottom=0)
        rows[1].set_title("Tool to goal, true")
        rows[1].set_ylabel("[mm]")
    rows[-1].set_xlabel("time [s]")
    return _save(figure, path)


@_styled
def timing(shares: Mapping[str, float], real_time_factor: float, path: Path) -> Path:
    """Draw the share of the computing time that each system took."""
    ranked = sorted(shares.items(), key=lambda item: item[1])
    figure = _figure(10, 1.2 + 0.36 * len(ranked))
    axes = figure.subplots()
    bars = axes.barh([name for name, _ in ranked], [100 * share for _, share in ranked], color=LINES[0], height=0.65)
    axes.bar_label(bars, labels=[f"{100 * share:.1f} %" for _, share in ranked], padding=4, color=INK)
    axes.grid(axis="y", visible=False)
    axes.margins(x=0.12)
    axes.set_title(f"Computing time; the whole run went at {real_time_factor:.2f} × real time")
    axes.set_xlabel("share [%]")
    return _save(figure, path)


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, path: Path) -> Path:
    content = BytesIO()
    figure.savefig(content, format=path.suffix.removeprefix("."))
    return atomic_file.write(path, content.getvalue())


def _shade(axes: Axes, run: Run, k: int) -> None:
    """Mark when an object moved, was stale, lost or hidden."""
    for status, (colour, _) in SHADES.items():
        for start, end in _spans(run.time, run.status[:, k] == status):
            axes.axvspan(start, end, color=colour, linewidth=0)
    for start, end in _spans(run.time, run.seen[:, k] < HIDDEN_SHARE):
        axes.axvspan(start, end, facecolor="none", edgecolor="#ced4da", hatch="////", linewidth=0)


def _spans(time: Array, condition: npt.NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Start and end of each run of samples for which a condition holds."""
    return [(float(time[a]), float(time[min(b, len(time) - 1)])) for a, b in stretches(condition)]
