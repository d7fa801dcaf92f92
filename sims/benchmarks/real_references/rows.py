"""Which measured logs are fitted and which are held out; cut logs are written beside each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

Span = tuple[float, float]
WHOLE: Span = (-np.inf, np.inf)

KR300_GEARS = (1798 / 7, 1872 / 7, 757 / 3, 221.0, 5032 / 21, 206793 / 1340)


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        name: short, for `--only`.
        model, fit, holdout: files below the data folder.
        fit_span, holdout_span: of the logs' own time that count [s].
        side: of the gear that the torque was measured on.
        scale: (n,) joint-side torques are shown over this; empty: as they are.
        told: whether the references know all that such an arm has (the KR300's counterbalance is a curve).
    """

    name: str
    model: str
    fit: str
    holdout: str
    fit_span: Span = WHOLE
    holdout_span: Span = WHOLE
    side: str = "motor"
    scale: tuple[float, ...] = field(default=())
    told: bool = True


LWR, PANDA = "real_arms/lwr4", "real_arms/panda"
LWR_RUNS = (f"{LWR}/run_1.csv", f"{LWR}/run_2.csv")
PANDA_RUNS = (f"{PANDA}/first.csv", f"{PANDA}/last.csv")
KR300_RUNS = ("kuka_kr300/trajectory_A.csv", "kuka_kr300/trajectory_B.csv")
LATE, EARLY = (12.5, np.inf), (-np.inf, 12.5)

ROWS = (
    Row("kr300", "kuka_kr300/kr300.urdf", *KR300_RUNS, scale=KR300_GEARS, told=False),
    Row("lwr4", f"{LWR}/lwr4.urdf", *LWR_RUNS, side="link"),
    Row("lwr4-cut", f"{LWR}/lwr4.urdf", *LWR_RUNS, LATE, EARLY, "link"),
    Row("lwr4-published", f"{LWR}/lwr4_as_published.urdf", *LWR_RUNS, side="link"),
    Row("lwr4-published-cut", f"{LWR}/lwr4_as_published.urdf", *LWR_RUNS, LATE, EARLY, "link"),
    Row("panda", f"{PANDA}/panda.urdf", *PANDA_RUNS, side="link"),
    Row("panda-cut", f"{PANDA}/panda.urdf", *PANDA_RUNS, (7.0, np.inf), (-np.inf, 3.5), "link"),
)
"""Seconds of the cut rows count from the logs' first samples."""


def _short(name: str, logs: tuple[str, str], spans: tuple[Span, Span]) -> Row:
    """A row of a few seconds of a log behind the gears."""
    model = f"{LWR}/lwr4.urdf" if name.startswith("lwr4") else f"{PANDA}/panda.urdf"
    return Row(name, model, *logs, *spans, "link")


SHORT_ROWS = (
    _short("lwr4-1-8", LWR_RUNS, ((1.0, 8.0), (9.0, np.inf))),
    _short("lwr4-8-16", LWR_RUNS[::-1], ((8.0, 16.0), (17.0, np.inf))),
    _short("lwr4-5-11", LWR_RUNS[::-1], ((5.0, 11.0), (12.0, np.inf))),
    _short("lwr4-14-19", LWR_RUNS, ((14.0, 19.0), (1.0, 12.0))),
    _short("panda-7-12", PANDA_RUNS, ((7.0, 12.0), (0.0, 3.5))),
    _short("panda-1-6", (PANDA_RUNS[0], PANDA_RUNS[0]), ((1.0, 6.0), (7.5, np.inf))),
    _short("panda-9-13.9", PANDA_RUNS, ((9.0, 13.9), (0.0, np.inf))),
    Row("kr300-0-5", ROWS[0].model, *KR300_RUNS, (0.0, 5.0), scale=KR300_GEARS, told=False),
    Row("kr300-4-9", ROWS[0].model, *KR300_RUNS, (4.0, 9.0), scale=KR300_GEARS, told=False),
)
"""Fits of a few seconds, held out on other motion. From 5 to 11 s two joints of the LWR4+ never turn."""


def cut(path: Path, span: Span, out: Path) -> Path:
    """Writes the part of a log that lies within a span of its time, counted from its begin; answers where.

    A log that counts whole is answered as it is.
    """
    if span == WHOLE:
        return path
    lines = path.read_text(encoding="utf-8").splitlines()
    times = [float(line.split(",", 1)[0]) for line in lines[1:]]
    kept = [line for line, t in zip(lines[1:], times, strict=True) if span[0] <= t - times[0] <= span[1]]
    out.write_text("\n".join([lines[0], *kept]) + "\n", encoding="utf-8")
    return out


def chosen(names: list[str] | None, short: bool = False) -> Iterator[Row]:
    """The rows of these names; all long ones, or short ones, where none is given."""
    if names:
        yield from (row for row in (*ROWS, *SHORT_ROWS) if row.name in names)
    else:
        yield from SHORT_ROWS if short else ROWS
