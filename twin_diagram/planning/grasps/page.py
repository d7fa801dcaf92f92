"""The page that shows grasps: one HTML file that needs no network; the cloud and the gripper turn under the mouse."""

from __future__ import annotations

import json
from html import escape
from typing import Any

import numpy as np

from twin_diagram.planning.grasps.gripper import Gripper
from twin_diagram.planning.grasps.known_object import KnownObject
from twin_diagram.planning.grasps.proposal import Grasps
from twin_diagram.planning.grasps.triangles import surface_cloud
from twin_diagram.signals.arrays import Array

POINTS = 2500
"""Of the object that are drawn: enough to see its shape, few enough to turn smoothly."""

STYLE = """
body { margin:0; font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif; color:#1d2735;
  background:#f4f6f9; }
main { max-width:1080px; margin:0 auto; padding:20px; display:grid; grid-template-columns:1fr 330px; gap:18px; }
h1 { font-size:22px; margin:0; grid-column:1/-1; } p { margin:4px 0; color:#566173; grid-column:1/-1; }
canvas { width:100%; height:560px; background:#fff; border:1px solid #e1e6ed; border-radius:12px; touch-action:none; }
table { border-collapse:collapse; width:100%; font-variant-numeric:tabular-nums; background:#fff; }
th, td { text-align:right; padding:4px 8px; white-space:nowrap; border-bottom:1px solid #e1e6ed; } th { color:#566173; }
tbody tr { cursor:pointer; } tbody tr.on { background:#dbe9f8; }
@media (max-width:780px) { main { grid-template-columns:1fr; } }
"""
"""CSS of the page."""

SCRIPT = """
const D = JSON.parse(document.getElementById('data').textContent);
const canvas = document.getElementById('view'), c = canvas.getContext('2d');
let yaw = 0.7, pitch = 0.5, zoom = 1, shown = 0;
const edges = [[0,1],[2,3],[4,5],[6,7],[0,2],[1,3],[4,6],[5,7],[0,4],[1,5],[2,6],[3,7]];
function project(p) {
  const x = p[0]-D.middle[0], y = p[1]-D.middle[1], z = p[2]-D.middle[2];
  const u = Math.cos(yaw)*x + Math.sin(yaw)*y, v = -Math.sin(yaw)*x + Math.cos(yaw)*y;
  const s = zoom * 0.36 * Math.min(canvas.width, canvas.height) / D.radius;
  return [canvas.width/2 + s*u, canvas.height/2 - s*(Math.cos(pitch)*z + Math.sin(pitch)*v),
    Math.cos(pitch)*v - Math.sin(pitch)*z];
}
function line(a, b) { c.beginPath(); c.moveTo(a[0], a[1]); c.lineTo(b[0], b[1]); c.stroke(); }
function draw() {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = canvas.clientWidth*ratio; canvas.height = canvas.clientHeight*ratio;
  c.clearRect(0, 0, canvas.width, canvas.height);
  const seen = D.points.map(project).sort((a, b) => b[2]-a[2]);
  for (const p of seen) {
    const grey = Math.round(120 + 90*Math.max(-1, Math.min(1, p[2]/D.radius)));
    c.fillStyle = `rgb(${grey},${grey},${grey+10})`; c.fillRect(p[0]-ratio, p[1]-ratio, 2.4*ratio, 2.4*ratio);
  }
  D.grasps.forEach((g, k) => {
    c.strokeStyle = k == shown ? '#2463a6' : 'rgba(217,119,43,.35)'; c.lineWidth = (k == shown ? 1.6 : 1)*ratio;
    if (k == shown) for (const box of g.boxes) {
      const q = box.map(project); for (const [i, j] of edges) line(q[i], q[j]); }
    const s = g.stick.map(project); for (let i = 1; i < s.length; i++) line(s[i-1], s[i]);
    if (k == shown) for (const p of g.contacts) { const q = project(p); c.fillStyle = '#a3312b';
      c.beginPath(); c.arc(q[0], q[1], 4*ratio, 0, 7); c.fill(); }
  });
}
function show(k) { shown = k; document.querySelectorAll('tbody tr').forEach((r, i) => r.classList.toggle('on', i == k));
  draw(); }
document.querySelectorAll('tbody tr').forEach((r, k) => r.addEventListener('click', () => show(k)));
canvas.addEventListener('pointermove', e => { if (e.buttons) { yaw += e.movementX*0.008;
  pitch = Math.max(-1.57, Math.min(1.57, pitch + e.movementY*0.008)); draw(); } });
canvas.addEventListener('wheel', e => { e.preventDefault(); zoom *= Math.exp(-e.deltaY*0.001); draw(); });
window.addEventListener('resize', draw); show(0);
"""
"""What draws: points and boxes, projected in parallel."""


def page(known: KnownObject, gripper: Gripper, grasps: Grasps) -> str:
    """Return the whole file."""
    rows = "".join(
        f"<tr><td>{k + 1}</td><td>{grasps.score[k]:.3f}</td><td>{1e3 * grasps.width[k]:.1f}</td>"
        f"<td>{' '.join(f'{x:.2f}' for x in grasps.approach[k].round(2) + 0.0)}</td></tr>"
        for k in range(len(grasps))
    )
    head = "<tr><th>rank</th><th>score</th><th>width [mm]</th><th>approach</th></tr>"
    empty = grasps.why_empty()
    told = f"No grasp: {escape(empty)}." if empty else "Lower is better. Click a row; drag to turn; wheel to zoom."
    left = ", ".join(f"{escape(reason)}: {number}" for reason, number in grasps.reasons.items())
    # Within <script> no text may end it, whatever an object is called.
    data = json.dumps(_drawn(known, gripper, grasps), separators=(",", ":")).replace("<", "\\u003c")
    name = f"{escape(known.name)}, {escape(gripper.name)}"
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Grasps: {name}</title><style>{STYLE}</style></head><body><main><h1>Grasps of {name}</h1>"
        f'<p>{told}</p><canvas id="view"></canvas><div><table><thead>{head}</thead><tbody>{rows}</tbody></table></div>'
        f"<p>Candidates left out: {left or 'none'}.</p></main>"
        f'<script type="application/json" id="data">{data}</script><script>{SCRIPT}</script></body></html>\n'
    )


def _drawn(known: KnownObject, gripper: Gripper, grasps: Grasps) -> dict[str, Any]:
    """Return places in O [m], to a tenth of a millimetre."""
    points, _ = surface_cloud(known.triangles, POINTS, 0)
    low, high = gripper.boxes()
    corners = np.stack([np.where([i & 4, i & 2, i & 1], high, low) for i in range(8)], axis=1)
    half = gripper.opening_most / 2
    back, front, wrist = gripper.palm_front, gripper.finger_front, gripper.palm_front - gripper.palm_size[2]
    stick = np.array([[0, half, front], [0, half, back], [0, 0, back], [0, 0, wrist], [0, 0, back], [0, -half, back]])
    stick = np.concatenate([stick, [[0, -half, front]]])

    def placed(k: int, places: Array) -> list[Any]:
        return np.round(places @ grasps.R[k].T + grasps.poses[k, 4:], 4).tolist()

    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return {
        "points": np.round(points, 4).tolist(),
        "middle": np.round(middle, 4).tolist(),
        "radius": round(float(np.linalg.norm(points - middle, axis=1).max()) + 0.06, 4),
        "grasps": [
            {
                "boxes": [placed(k, box) for box in corners],
                "stick": placed(k, stick),
                "contacts": np.round(grasps.contacts[k][grasps.seen[k]], 4).tolist(),
            }
            for k in range(len(grasps))
        ],
    }
