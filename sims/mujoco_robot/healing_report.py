"""What a run of `self_healing.py` showed: as a table, as a picture, in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mujoco_robot.comparison import dress
from twin_diagram.model import Model
from twin_diagram.signals.arrays import Array

AHEAD = 0.2
"""How far is looked ahead [s]."""
LOOK = 0.05
"""Between two looks [s]; between two steps of the run."""
RECENT = 0.5
"""Over which the picture's thick lines are averaged [s]."""


@dataclass(frozen=True)
class Plan:
    """When what happens [s].

    Attributes:
        change: the robot changes.
        gather: log since the alarm in which the gap is looked for.
        answer: the verdict is taken this long after the search began.
        after: the run goes on after that.
    """

    change: float = 10.0
    gather: float = 16.0
    answer: float = 10.0
    after: float = 10.0

    @property
    def duration(self) -> float:
        """Of the run; the alarm and its settling take up to a second."""
        return self.change + self.gather + self.answer + self.after + 1.0


@dataclass
class Run:
    """What was seen.

    Attributes:
        joints: names.
        plan: when what was meant to happen.
        swaps: when a corrected model was taken over [s].
        events: as in ``events.jsonl``.
        time: (K,) of each prediction's end [s].
        error: (K, n) of position 0.2 s ahead, for the twin and for the filter left alone [rad].
        hand: (K,) the same of the hand [m].
        model: that was in use at the end.
    """

    joints: tuple[str, ...]
    plan: Plan
    swaps: list[float]
    events: list[dict[str, Any]]
    time: Array
    error: dict[str, Array]
    hand: dict[str, Array]
    model: Model
    spans: dict[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        end = self.swaps[0] if self.swaps else self.time[-1]
        # A prediction counts where all of it lies within a phase, and the filter has had its first second.
        self.spans = {
            "before": (1.0 + AHEAD, self.plan.change),
            "during": (self.plan.change + AHEAD, end),
            "after": (end + AHEAD, self.time[-1] + LOOK),
        }

    def rms(self, who: str, phase: str) -> tuple[float, Array]:
        """Of the hand [m] and per joint (n,) [rad]; NaN where the phase never came."""
        start, end = self.spans[phase]
        inside = (self.time >= start) & (self.time < end)
        if not inside.any():
            return np.nan, np.full(len(self.joints), np.nan)
        return (
            float(np.sqrt(np.mean(self.hand[who][inside] ** 2))),
            np.sqrt(np.mean(self.error[who][inside] ** 2, axis=0)),
        )

    def table(self) -> str:
        """For the terminal."""
        lines = [
            f"error of the prediction {AHEAD:g} s ahead, RMS",
            f"{'':<28}" + "".join(f"{p:>10}" for p in self.spans),
        ]
        for who in self.error:
            found = [self.rms(who, phase) for phase in self.spans]
            lines.append(f"{who:<18}{'hand mm':>10}" + "".join(f"{1e3 * hand:10.2f}" for hand, _ in found))
            for k, joint in enumerate(self.joints):
                name = joint.removeprefix("iiwa_").replace("_", " ")
                lines.append(f"{'':<18}{name:>10}" + "".join(f"{1e3 * each[k]:10.2f}" for _, each in found) + "  mrad")
        return "\n".join(lines)

    def picture(self, path: Path) -> None:
        """The hand's error over time, with what happened when."""
        figure = Figure(figsize=(11, 5.0), layout="constrained", facecolor="white")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        # The other one lies below: before the swap both are the same to the bit.
        colours = {"twin": "#2463a6", "left alone": "#d9772b"}
        names = {"twin": "the twin, which mends its model", "left alone": "the same filter, its model as it was"}
        width = max(1, round(RECENT / LOOK))
        top = 0.0
        for who in reversed(self.hand):
            squares = np.concatenate([np.zeros(width - 1), self.hand[who] ** 2])
            recent = np.sqrt(np.convolve(squares, np.ones(width) / width, mode="valid"))
            top = max(top, 1.1e3 * float(recent.max()))  # single peaks may leave the picture
            thick = 1.8 if who == "twin" else 3.4
            axes.plot(self.time, 1e3 * self.hand[who], color=colours[who], lw=0.5, alpha=0.4)
            axes.plot(self.time, 1e3 * recent, color=colours[who], lw=thick, label=names[who])
        for at, text in self.marks():
            axes.axvline(at, color="#5b6675", lw=0.9, ls="--")
            axes.text(at + 0.1, 1.29 * top, text, fontsize=8.5, color="#384250", va="top")
        for phase, (start, end) in self.spans.items():
            figures = {who: 1e3 * self.rms(who, phase)[0] for who in self.hand}
            if not np.isfinite(figures["twin"]):
                continue
            for row, (who, value) in enumerate(figures.items()):
                if row == 0 or abs(value - figures["twin"]) > 1e-6:
                    place = (0.5 * (start + min(end, self.time[-1])), (1.14 - 0.07 * row) * top)
                    axes.text(*place, f"{value:.2g} mm RMS", color=colours[who], fontsize=11, ha="center", va="top")
        axes.set_ylim(0.0, 1.32 * top)
        axes.set_xlim(0.0, self.time[-1])
        axes.set_xlabel("time [s]", fontsize=9)
        axes.set_ylabel("mm", fontsize=9)
        title = (
            f"Where will the hand be in {AHEAD:g} s? Error of the prediction (thin), its RMS over {RECENT:g} s (thick)"
        )
        axes.set_title(title, fontsize=11.5, loc="left")
        figure.legend(*axes.get_legend_handles_labels(), frameon=False, fontsize=9, loc="outside lower center", ncols=2)
        dress(axes)
        figure.savefig(path, dpi=130)

    def marks(self) -> list[tuple[float, str]]:
        """What happened when [s], in words for the picture."""
        alarms = [e["time"] for e in self.events if e["event"] == "alarm" and e["time"] >= self.plan.change]
        noticed = f",\nalarm after {1e3 * (alarms[0] - self.plan.change):.0f} ms" if alarms else ""
        words = {"gap_started": "the search\nbegins", "model_swapped": "the model\nis mended"}
        marks = [(self.plan.change, f"the robot changes{noticed}")]
        return marks + [(e["time"], words[e["event"]]) for e in self.events if e["event"] in words]
