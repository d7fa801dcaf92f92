"""The fleet's page and table: robots by what is wrong with them, and the first day that shows it."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from datetime import datetime, timezone
from html import escape
from typing import Any

from twin_diagram.runs.fleet.work import VisitResult

COLUMNS = ("robot", "date", "verdict", "effects", "headline", "left", "seconds")
"""Of the table."""
UNANSWERED = ("failed", "timeout")
"""Verdicts of visits whose logs tell nothing of the robot: a file that lacks is no fault of an arm."""

DAYS = ("%Y-%m-%d", "%Y/%m/%d", "%d.%m.%Y", "%Y-%m", "%Y-%j", "%Y%m%d", "%Y%m%dT%H%M%S", "%Y-%m-%dT%H:%M:%S")
"""How days are written, where that says which is first; 3/4/2026 is this day here, that one there. With them stand the
forms of ISO 8601 that `datetime.fromisoformat` reads in no Python yet, or not in 3.10."""

STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:70rem;padding:0 1rem;color:#1d2733}"
    "table{border-collapse:collapse;width:100%}th,td{text-align:left;padding:.35rem .7rem;"
    "border-bottom:1px solid #dde3ea;vertical-align:top}th{font-weight:600}.day{white-space:nowrap}.bad{color:#a3341c}"
)
"""Of the page: plain, so that it prints well."""

UNANSWERED_HEAD = (
    "<h2>Without an answer: nothing is known of these robots on these days</h2>"
    "<table><tr><th>robot</th><th>date</th><th></th><th>why</th></tr>"
)
"""Of the page's table of such visits."""

UNSORTED = "<p>Dates of {} are not all of one kind, so the first day there is the first in the table.</p>"
"""Said of robots whose dates cannot be put in order."""


def table(lines: Sequence[VisitResult]) -> str:
    """Return the table as CSV; effects are parted by `;`."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for line in lines:
        left = "" if line.left is None else line.left
        row = [line.robot, line.date, line.verdict, ";".join(line.effects), line.headline, left, line.seconds]
        writer.writerow(row)
    return text.getvalue()


def by_day(lines: Sequence[VisitResult]) -> list[VisitResult]:
    """Return visits as they came: by days, or by numbers, else as they stand in the table.

    Where dates of all robots are of no one kind, each robot's visits are put in order by themselves.
    """
    whole = in_order(lines)
    if whole is not None:
        return whole
    own = ([line for line in lines if line.robot == robot] for robot in dict.fromkeys(line.robot for line in lines))
    return [line for each in own for line in in_order(each) or each]


def unsorted_robots(lines: Sequence[VisitResult]) -> list[str]:
    """Return the robots whose dates do not tell which visit was first."""
    robots = dict.fromkeys(line.robot for line in lines)
    return [robot for robot in robots if in_order([line for line in lines if line.robot == robot]) is None]


def in_order(lines: Sequence[VisitResult]) -> list[VisitResult] | None:
    """Return visits as they came; None where their dates are not all of one kind."""
    readings: tuple[Callable[[str], Any], ...] = (float, _day)
    for read in readings:
        try:
            return sorted(lines, key=lambda line: read(line.date))
        except ValueError:
            continue
    return None


def _day(text: str) -> datetime:
    """Return a day, as ISO 8601 or one of `DAYS` has it, where no zone is told of UTC; ValueError: neither."""
    text = text[:-1] + "+00:00" if text.endswith(("Z", "z")) and "T" in text.upper() else text
    try:
        day = datetime.fromisoformat(text)
    except ValueError:
        day = _written_otherwise(text)
    return day if day.tzinfo is not None else day.replace(tzinfo=timezone.utc)


def _written_otherwise(text: str) -> datetime:
    """Return a day as one of `DAYS` has it; ValueError: none has."""
    for form in DAYS:
        try:
            return datetime.strptime(text, form)
        except ValueError:
            continue
    raise ValueError(text)


def first_days(lines: Sequence[VisitResult]) -> list[tuple[str, str, str]]:
    """Return what is wrong, robot and the first day that shows it: what most robots have first."""
    first: dict[tuple[str, str], str] = {}
    for line in by_day(lines):
        names = [effect.split(" ")[0] for effect in line.effects]
        names += [line.verdict] if line.verdict == "unknown" else []
        for name in names:
            first.setdefault((name, line.robot), line.date)
    count: dict[str, int] = {}
    for name, _ in first:
        count[name] = count.get(name, 0) + 1
    order = sorted(first, key=lambda key: (-count[key[0]], key[0], first[key], key[1]))
    return [(name, robot, first[name, robot]) for name, robot in order]


def page(lines: Sequence[VisitResult], folders: Sequence[str]) -> str:
    """Return the page.

    Args:
        lines: one per visit.
        folders: theirs, relative to the page.
    """
    wrong: dict[str, list[str]] = {}
    for name, robot, day in first_days(lines):
        wrong.setdefault(name, []).append(f"{escape(robot)} since {escape(day)}")
    groups = "".join(
        f"<tr><td>{escape(name.replace('_', ' '))}</td><td>{len(robots)}</td><td>{', '.join(robots)}</td></tr>"
        for name, robots in wrong.items()
    )
    lost = "".join(
        f"<tr><td>{escape(line.robot)}</td><td class='day'>{escape(line.date)}</td><td class='bad'>{line.verdict}</td>"
        f"<td>{escape(line.headline)}</td></tr>"
        for line in by_day(lines)
        if line.verdict in UNANSWERED
    )
    doubtful = ", ".join(escape(robot) for robot in unsorted_robots(lines))
    unsorted = UNSORTED.format(doubtful) if doubtful else ""
    rows = "".join(
        f"<tr><td>{escape(line.robot)}</td><td class='day'>{escape(line.date)}</td>{_verdict(line, folder)}"
        f"<td>{escape(line.headline)}</td><td>{'' if line.left is None else f'{100 * line.left:.0f} %'}</td></tr>"
        for line, folder in zip(lines, folders, strict=True)
    )
    return (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>Fleet</title><style>{STYLE}</style></head>'
        f"<body><h1>{len({line.robot for line in lines})} robots, {len(lines)} visits</h1>"
        "<h2>What is wrong, and the first day that shows it</h2>"
        f"{unsorted}<table><tr><th>what</th><th>robots</th><th>which</th></tr>{groups}</table>"
        f"{UNANSWERED_HEAD + lost + '</table>' if lost else ''}"
        "<h2>All visits</h2><table><tr><th>robot</th><th>date</th><th>verdict</th><th>in short</th>"
        f"<th>held-out residual left</th></tr>{rows}</table></body></html>\n"
    )


def _verdict(line: VisitResult, folder: str) -> str:
    if line.verdict in UNANSWERED:
        return f'<td class="bad">{line.verdict}</td>'
    return f'<td><a href="{escape(folder)}/report.html">{escape(line.verdict)}</a></td>'
