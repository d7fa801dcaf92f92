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

from twin_diagram.runs.learning.record import GALLERY, Learned, LearningRecord, RunState
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

STYLE = """
body { margin:0; font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif; color:#1d2735;
  background:#f4f6f9; }
main { max-width:1120px; margin:0 auto; padding:20px; }
h1 { font-size:24px; margin:0 0 4px; } h2 { font-size:17px; margin:0 0 6px; } p { margin:4px 0; color:#566173; }
.grid { display:grid; grid-template-columns:repeat(auto-fill,minmax(340px,1fr)); gap:16px; margin-top:16px; }
.card { background:#fff; border:1px solid #e1e6ed; border-radius:12px; padding:14px; }
canvas { width:100%; height:260px; border-radius:8px; background:#eef2f7; touch-action:none; cursor:grab; }
img { max-width:100%; border-radius:8px; }
table { border-collapse:collapse; width:100%; font-variant-numeric:tabular-nums; margin-top:8px; }
th, td { text-align:left; padding:3px 6px; border-bottom:1px solid #eef1f5; vertical-align:top; }
th { color:#566173; font-weight:500; width:38%; }
.guess { background:#faf0da; }
.failed { border-color:#d98b8b; } .reported { border-color:#d9b36b; }
.tag { font-size:12px; padding:1px 8px; border-radius:9px; background:#e3f1e6; color:#23683a; float:right; }
.failed .tag { background:#f8e2e2; color:#8f2525; } .reported .tag { background:#faf0da; color:#7a5510; }
"""
"""CSS of the page."""

SCRIPT = """
const D = JSON.parse(document.getElementById('data').textContent);
document.querySelectorAll('canvas').forEach(canvas => {
  const c = canvas.getContext('2d'), clouds = D[canvas.dataset.name];
  const decode = (text, kind) => new kind(Uint8Array.from(atob(text), s => s.charCodeAt(0)).buffer);
  const parts = clouds.map(k => ({p: decode(k.points, Float32Array), c: decode(k.colours, Uint8Array),
    n: decode(k.normals, Int8Array), disc: k.disc}));
  let yaw = 0.6, pitch = 0.45, zoom = 1;
  function draw() {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = canvas.clientWidth*ratio; canvas.height = canvas.clientHeight*ratio;
    c.clearRect(0, 0, canvas.width, canvas.height);
    const wide = canvas.width / parts.length, radius = clouds[0].radius;
    parts.forEach((part, k) => {
      const s = zoom*0.42*Math.min(wide, canvas.height)/radius, n = part.p.length/3, seen = [];
      const cy = Math.cos(yaw), sy = Math.sin(yaw), cp = Math.cos(pitch), sp = Math.sin(pitch);
      // Right, up and away from who looks.
      const turned = (x, y, z) => { const v = cy*y - sy*x; return [cy*x + sy*y, cp*z + sp*v, cp*v - sp*z]; };
      for (let i = 0; i < 3*n; i += 3) {
        const m = turned(part.n[i]/127, part.n[i+1]/127, part.n[i+2]/127);
        if (m[2] < 0) seen.push([turned(part.p[i], part.p[i+1], part.p[i+2]), m, i]);
      }
      seen.sort((a, b) => b[0][2]-a[0][2]);
      const size = Math.max(1.5*ratio, s*part.disc);
      for (const [q, m, i] of seen) {
        const lit = 0.6 + 0.4*Math.max(0, 0.6*m[1] - 0.35*m[0] - 0.72*m[2]);
        c.fillStyle = `rgb(${lit*part.c[i]},${lit*part.c[i+1]},${lit*part.c[i+2]})`;
        c.beginPath();
        c.ellipse(wide*(k+0.5) + s*q[0], canvas.height/2 - s*q[1], size*Math.max(0.2, -m[2]), size,
          Math.atan2(-m[1], m[0]), 0, 2*Math.PI);
        c.fill(); }
    });
  }
  canvas.addEventListener('pointermove', e => { if (e.buttons) { yaw += e.movementX*0.01;
    pitch = Math.max(-1.57, Math.min(1.57, pitch + e.movementY*0.01)); draw(); } });
  canvas.addEventListener('wheel', e => { e.preventDefault(); zoom *= Math.exp(-e.deltaY*0.001); draw(); });
  window.addEventListener('resize', draw); draw();
});
"""
"""What draws: coloured discs along the surface, lit from above, projected in parallel; a second cloud stands beside the
first."""


@dataclass(frozen=True)
class TrueCloud:
    """The true object beside a learned one, where somebody knows it: (N, 3) points in O [m], colours, normals."""

    points: Array
    colours: Array
    normals: Array


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
        cards.append(_card(record, one, one.name in data))
    done = sum(one.state == "finished" for one in state.learned)
    others = Counter(one.state for one in state.learned if one.state != "finished")
    counts = "".join(f", {many} {name}" for name, many in others.items())
    end = "the bin is done with" if state.finished else "things are still to be taken"
    told = f"{done} of {len(state.learned)} finished{counts}; {state.sim_time:.0f} s simulated; {end}"
    two = "; on the left what was learned, on the right the true object" if true else ""
    # Within <script> no text may end it, whatever an object is called.
    packed = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    atomic_file.write(
        record.folder / GALLERY,
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Learned objects</title><style>{STYLE}</style></head><body><main><h1>Learned objects</h1>"
        f"<p>{told}. Drag to turn, wheel to zoom{two}. ± holds 95 % of what may be; what is “from shape alone” "
        f"torques did not tell: it takes an even density.</p><div class='grid'>{''.join(cards)}</div></main>"
        f'<script type="application/json" id="data">{packed}</script><script>{SCRIPT}</script></body></html>\n',
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


def _card(record: LearningRecord, one: Learned, drawn: bool) -> str:
    view = f'<canvas data-name="{escape(one.name)}"></canvas>' if drawn else ""
    file = record.folder / one.picture if one.picture else None
    if file is not None and file.is_file():
        view += f'<img alt="" src="data:image/png;base64,{base64.b64encode(file.read_bytes()).decode()}">'
    rows = "".join(_row(name, text) for name, text in _rows(one))
    return (
        f'<div class="card {escape(one.state)}"><span class="tag">{escape(one.state)}</span>'
        f"<h2>{escape(one.name)}</h2>{view}<table>{rows}</table></div>"
    )


def _row(name: str, text: str) -> str:
    mark = ' class="guess"' if "from shape alone" in text else ""
    return f"<tr><th>{escape(name)}</th><td{mark}>{escape(text)}</td></tr>"


def _rows(one: Learned) -> list[tuple[str, str]]:
    """Return what the table of an object says."""
    rows = [("what failed", one.told)] if one.told else []
    if one.no_asset:
        rows.append(("a second try", f"twin-diagram learn … --again {one.name}"))
    if one.state == "handled":
        rows.append(("asset", "its shape is still being made"))
    f = one.figures
    by = f.get("by", {})
    if "mass" in f:
        even = " as if of water" if f.get("mass_std") is None else ""
        rows.append(("mass", f"{_values([f['mass']], [f.get('mass_std')], 1e3)} g, {by.get('mass', '')}{even}"))
    if f.get("centre_std"):
        if "centre" in f:  # runs of before have none
            known = f"{_values(f['centre'], f['centre_std'], 1e3)} mm off the middle of its box"
        else:
            known = ", ".join(f"± {_short(1.96e3 * x)}" for x in f["centre_std"]) + " mm"
        rows.append(("centre of mass", f"{known}, {by.get('centre', '')}"))
    if "moments" in f:
        moments = _values(f["moments"], f.get("moments_std") or [None] * 3, 1e6)
        rows.append(("principal moments", f"{moments} kg·mm², {by.get('inertia', '')}"))
    if "not weighed" in f:
        rows.append(("not weighed", f["not weighed"]))
    if "size" in f:
        rows.append(("box about it", " × ".join(f"{1e3 * x:.0f}" for x in f["size"]) + " mm, as it lay in the bin"))
    if "seen_share" in f:
        after = ", ".join(f"{100 * share:.1f}" for share in f.get("seen_after_grasps", []))
        rows.append(("surface seen", f"{100 * f['seen_share']:.1f} % of what some pose shows (by grasps: {after})"))
    if "unseen" in f:
        rows.append(("guessed surface", f"{100 * f['unseen']:.1f} % of the mesh, which no picture shows"))
    if f.get("pictures"):
        slips = ", ".join(f"{1e3 * off:.0f} mm and {np.rad2deg(turn):.0f}°" for _, off, turn in f.get("slips", []))
        grasps = f"{one.grasps} grasp{'s' if one.grasps != 1 else ''}"
        rows.append(
            ("displayed", f"{f['pictures']} pictures in {grasps}; " + (f"slipped by {slips}" if slips else "no slip"))
        )
    rows += [("note", text) for text in dict.fromkeys([*f.get("notes", []), *f.get("asset_notes", [])])]
    return rows


def _values(values: Sequence[float], stds: Sequence[float | None], scale: float) -> str:
    """Return values, each with half of its 95 % interval where that is known."""
    return ", ".join(
        f"{scale * value:.4g}" + ("" if std is None else f" ± {_short(1.96 * scale * std)}")
        for value, std in zip(values, stds, strict=True)
    )


def _short(value: float) -> str:
    """Return a number with two places that count, and without an exponent if it is of a usual size."""
    return f"{float(f'{value:.2g}'):g}"
