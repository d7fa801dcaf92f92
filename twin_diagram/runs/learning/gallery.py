"""The page of a run: one HTML file that needs no network, each learned object to turn, its figures, what failed."""

from __future__ import annotations

import base64
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from twin_diagram.runs.learning.display_strips import strips_of
from twin_diagram.runs.learning.gallery_page import SCRIPT, STYLE
from twin_diagram.runs.learning.record import GALLERY, Learned, LearningRecord, RunState
from twin_diagram.runs.learning.shape_worker import FRAMES
from twin_diagram.runtime import atomic_file
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    points: int = 3000
    """Of an object that are drawn, as many as an asset's cloud has: few enough to turn smoothly."""

    neighbours: int = 6
    """So many fall under a point's disc, itself among them: where they lie at random hardly a gap is left."""


TUNING = Tuning()


@dataclass(frozen=True)
class TrueCloud:
    """The true object beside a learned one, where somebody knows it.

    Attributes:
        points: (N, 3) in the learned asset's O [m], with colours and normals (N, 3).
        colours: of them.
        normals: of them.
        mass: of it [kg].
        centre: (3,) of mass in the learned asset's O [m]; with the mass alone.
        moments: (3,) principal ones, the least first [kg·m²]; with the mass alone.
        off: mean distance from the learned surface to the true one [m]; None: nobody says.
    """

    points: Array
    colours: Array
    normals: Array
    mass: float | None = None
    centre: Array | None = None
    moments: Array | None = None
    off: float | None = None


def write_gallery(record: LearningRecord, state: RunState, true: Mapping[str, TrueCloud] | None = None) -> None:
    """Write `gallery.html` of a run.

    Args:
        record: its files.
        state: what it knows.
        true: the true objects by name, for those who know them; None: nobody does.
    """
    data: dict[str, list[dict[str, Any]]] = {}
    cards = []
    for one in state.learned:
        file = record.library / one.name / "cloud.npz"
        if one.state == "finished" and file.is_file():
            with np.load(file, allow_pickle=False) as cloud:
                clouds = [_packed(cloud["points"], cloud["colours"], cloud["normals"])]
            if true and (beside := true.get(one.name)) is not None:
                clouds.append(_packed(beside.points, beside.colours, beside.normals))
            data[one.name] = clouds
        beside = true.get(one.name) if true else None
        cards.append(_card(record, one, len(data.get(one.name, ())), beside))
    # Within <script> no text may end it, whatever an object is called.
    packed = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    atomic_file.write(
        record.folder / GALLERY,
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Learned objects</title><style>{STYLE}</style></head><body><main><h1>Learned objects</h1>"
        f"{_summary(state)}<div class='grid'>{''.join(cards)}</div></main>"
        f'<script type="application/json" id="data">{packed}</script><script>{SCRIPT}</script></body></html>\n',
    )


def _summary(state: RunState) -> str:
    """Return what stands above the cards: how many of each, how long, and how the page is read."""
    counts = Counter(one.state for one in state.learned)
    order = sorted(counts, key=lambda name: (name != "finished", name))
    tags = "".join(f'<span class="tag {escape(name)}">{counts[name]} {escape(name)}</span>' for name in order)
    end = "the bin is done with" if state.finished else "things are still to be taken"
    return (
        f'<div class="counts">{tags}<span class="tag end">{len(state.learned)} in all</span>'
        f'<span class="tag end">{state.sim_time:.0f} s simulated</span><span class="tag end">{end}</span></div>'
        "<p>Drag an object to turn it, wheel to zoom. ± holds 95 % of what may be. "
        "<span class='by'>measured</span> torques told it; <span class='by partly'>partly</span> shape and torques "
        "together; <span class='by guess'>from shape alone</span> torques did not tell it: of even density.</p>"
    )


def _packed(points: Array, colours: Array, normals: Array) -> dict[str, Any]:
    points, colours, normals = (np.asarray(rows)[: TUNING.points] for rows in (points, colours, normals))
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    own = (points - middle).astype("<f4")
    shades = np.clip(np.rint(255 * colours), 0, 255).astype(np.uint8)
    return {
        "points": base64.b64encode(own.tobytes()).decode(),
        "colours": base64.b64encode(shades.tobytes()).decode(),
        "normals": base64.b64encode(np.rint(np.clip(127 * normals, -127, 127)).astype(np.int8).tobytes()).decode(),
        "disc": float(np.quantile(cKDTree(own).query(own, k=min(TUNING.neighbours, len(own)))[0][:, -1], 0.8)),
        "radius": float(np.linalg.norm(own, axis=1).max()),
    }


def _card(record: LearningRecord, one: Learned, clouds: int, true: TrueCloud | None) -> str:
    view = ""
    if clouds:
        labels = (
            '<span class="of whole">learned</span>',
            '<span class="of">learned</span><span class="of right">true</span>',
        )
        view = f'<figure>{labels[clouds - 1]}<canvas data-name="{escape(one.name)}"></canvas></figure>'
    file = record.folder / one.picture if one.picture else None
    if file is not None and file.is_file():
        data = base64.b64encode(file.read_bytes()).decode()
        view += f'<img alt="where {escape(one.name)} was left" src="data:image/png;base64,{data}">'
    rows = _rows(one, true)
    with_truth = any(row.true for row in rows)
    head = "<thead><tr><th></th><th>learned</th><th>true</th></tr></thead>" if with_truth else ""
    table = f"<table>{head}<tbody>{''.join(row.html(with_truth) for row in rows)}</tbody></table>"
    return (
        f'<div class="card {escape(one.state)}"><span class="tag {escape(one.state)}">{escape(one.state)}</span>'
        f"<h2>{escape(one.name)}</h2>{view}{table}{_shown(record, one)}</div>"
    )


def _shown(record: LearningRecord, one: Learned) -> str:
    """Return pictures of how an object was displayed, a strip a grasp."""
    counts, shares = one.figures.get("pictures_by_grasp", []), one.figures.get("seen_after_grasps", [])
    found = []
    for k, strip in enumerate(strips_of(record.of(one.name) / FRAMES, counts) if counts else []):
        if not strip:
            continue
        seen = f", {100 * shares[k]:.1f} % of the surface seen by its end" if k < len(shares) else ""
        images = "".join(f'<img alt="" src="data:image/jpeg;base64,{text}">' for text in strip)
        found.append(f"<p>grasp {k + 1}: {counts[k]} pictures{seen}</p><div class='strip'>{images}</div>")
    return f'<div class="shown">{"".join(found)}</div>' if found else ""


@dataclass(frozen=True)
class TableLine:
    """One line of an object's table: its name, what was learned, where that came from, the truth; "": not known."""

    name: str
    text: str
    by: str = ""
    true: str = ""
    kind: str = ""

    def html(self, with_truth: bool) -> str:
        """Return it as HTML, with a cell for the truth or without."""
        guess = "from shape alone" in self.by
        marks = {"measured": "by", "partly": "by partly"}
        tag = f' <span class="{marks.get(self.by, "by guess")}">{escape(self.by)}</span>' if self.by else ""
        text = f"<code>{escape(self.text)}</code>" if self.kind == "command" else escape(self.text)
        kind = ' class="guess"' if guess else ' class="why"' if self.kind == "why" else ""
        wide = ' colspan="2"' if with_truth and not self.true else ""
        last = f'<td class="true">{escape(self.true)}</td>' if self.true else ""
        return f"<tr><th>{escape(self.name)}</th><td{kind}{wide}>{text}{tag}</td>{last}</tr>"


def _rows(one: Learned, true: TrueCloud | None) -> list[TableLine]:
    """Return what the table of an object says."""
    rows = [TableLine("what failed", one.told, kind="why")] if one.told else []
    if one.no_asset:
        rows.append(TableLine("a second try", f"twin-diagram learn … --again {one.name}", kind="command"))
    if one.state == "handled":
        rows.append(TableLine("asset", "its shape is still being made"))
    return rows + _inertial(one, true) + _surface(one, true)


def _inertial(one: Learned, true: TrueCloud | None) -> list[TableLine]:
    """Return what is told of mass, centre and moments, beside the truth where it is known."""
    rows, f = list[TableLine](), one.figures
    by = f.get("by", {})
    known = true if true is not None and true.mass is not None else None
    if "mass" in f:
        even = " as if of water" if f.get("mass_std") is None else ""
        mass = f"{1e3 * known.mass:.4g} g" if known and known.mass is not None else ""
        text = f"{_values([f['mass']], [f.get('mass_std')], 1e3)} g"
        rows.append(TableLine("mass", text, f"{by.get('mass', '')}{even}".strip(), mass))
    if f.get("centre_std"):
        centre = ""
        if "centre" in f:  # runs of before have none
            text = f"{_values(f['centre'], f['centre_std'], 1e3)} mm off the middle of its box"
            if known and known.centre is not None:
                centre = f"{_plain(np.array(f['centre']) + known.centre, 1e3)} mm"
        else:
            text = ", ".join(f"± {_short(1.96e3 * x)}" for x in f["centre_std"]) + " mm"
        rows.append(TableLine("centre of mass", text, by.get("centre", ""), centre))
    if "moments" in f:
        moments = _values(f["moments"], f.get("moments_std") or [None] * 3, 1e6)
        told = f"{_plain(known.moments, 1e6)} kg·mm²" if known and known.moments is not None else ""
        rows.append(TableLine("principal moments", f"{moments} kg·mm²", by.get("inertia", ""), told))
    if "not weighed" in f:
        rows.append(TableLine("not weighed", f["not weighed"], kind="why"))
    return rows


def _surface(one: Learned, true: TrueCloud | None) -> list[TableLine]:
    """Return what is told of an object's surface, how it was displayed, and notes."""
    rows, f = list[TableLine](), one.figures
    if "size" in f:
        rows.append(
            TableLine("box about it", " × ".join(f"{1e3 * x:.0f}" for x in f["size"]) + " mm, as it lay in the bin")
        )
    if true is not None and true.off is not None:
        rows.append(TableLine("surface", f"{1e3 * true.off:.2f} mm off the true one on average"))
    if "seen_share" in f:
        after = ", ".join(f"{100 * share:.1f}" for share in f.get("seen_after_grasps", []))
        text = f"{100 * f['seen_share']:.1f} % of what some pose shows (by grasps: {after})"
        rows.append(TableLine("surface seen", text))
    if "unseen" in f:
        rows.append(TableLine("guessed surface", f"{100 * f['unseen']:.1f} % of the mesh, which no picture shows"))
    if f.get("pictures"):
        slips = ", ".join(f"{1e3 * off:.0f} mm and {np.rad2deg(turn):.0f}°" for _, off, turn in f.get("slips", []))
        grasps = f"{one.grasps} grasp{'s' if one.grasps != 1 else ''}"
        slipped = f"slipped by {slips}" if slips else "no slip"
        rows.append(TableLine("displayed", f"{f['pictures']} pictures in {grasps}; {slipped}"))
    return rows + [TableLine("note", text) for text in dict.fromkeys([*f.get("notes", []), *f.get("asset_notes", [])])]


def _plain(values: Array, scale: float) -> str:
    """Return values with four places that count."""
    return ", ".join(f"{scale * float(value):.4g}" for value in values)


def _values(values: Sequence[float], stds: Sequence[float | None], scale: float) -> str:
    """Return values, each with half of its 95 % interval where that is known, and no more places than that has."""
    return ", ".join(
        f"{scale * value:.4g}" if std is None else _with_error(scale * value, 1.96 * scale * std)
        for value, std in zip(values, stds, strict=True)
    )


def _with_error(value: float, error: float) -> str:
    """Return a value and what it may be off by: two places of that count, and what is less than these says nothing."""
    places = 1 - int(np.floor(np.log10(error))) if error > 0.0 else 6
    return f"{round(value, places) + 0.0:.6g} ± {_short(error)}"


def _short(value: float) -> str:
    """Return a number with two places that count, and without an exponent if it is of a usual size."""
    return f"{float(f'{value:.2g}'):g}"
