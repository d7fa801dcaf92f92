"""How the page of a run looks and draws: its style, and the script that turns clouds of coloured discs."""

from __future__ import annotations

STYLE = """
body { margin:0; font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif; color:#1d2735;
  background:#f4f6f9; }
main { max-width:1360px; margin:0 auto; padding:20px; }
h1 { font-size:24px; margin:0 0 4px; } h2 { font-size:17px; margin:0 0 8px; } p { margin:4px 0; color:#566173; }
.counts { display:flex; flex-wrap:wrap; gap:8px; margin:10px 0; } .counts span { font-size:14px; padding:3px 12px; }
.grid { display:grid; grid-template-columns:repeat(auto-fill,minmax(min(420px,100%),1fr)); gap:16px; margin-top:16px;
  align-items:start; }
.card { background:#fff; border:1px solid #e1e6ed; border-radius:12px; padding:14px; }
figure { margin:0; position:relative; }
figure .of { position:absolute; top:8px; width:50%; text-align:center; font-size:12px; color:#566173;
  pointer-events:none; } figure .of.whole { width:100%; } figure .right { left:50%; }
canvas { width:100%; height:250px; border-radius:8px; background:#eef2f7; touch-action:none; cursor:grab;
  display:block; }
img { max-width:100%; border-radius:8px; display:block; }
.shown { margin-top:10px; } .shown p { font-size:13px; margin:6px 0 3px; }
.strip { display:grid; grid-template-columns:repeat(6,1fr); gap:4px; } .strip img { border-radius:5px; width:100%; }
table { border-collapse:collapse; width:100%; font-variant-numeric:tabular-nums; margin-top:10px; font-size:14px; }
th, td { text-align:left; padding:4px 6px; border-bottom:1px solid #eef1f5; vertical-align:top; }
th { color:#566173; font-weight:500; } tbody th { width:27%; } thead th { font-size:12px; padding-top:0; }
td.true { color:#566173; } td b { font-weight:600; }
.by { display:inline-block; font-size:12px; padding:0 7px; border-radius:8px; background:#e3f1e6; color:#23683a; }
.by.partly { background:#e8eefb; color:#2b4c8c; } .by.guess { background:#faf0da; color:#7a5510; }
td.guess { background:#fdf8ec; } td.why { color:#8f2525; } .reported td.why { color:#7a5510; }
code { font-size:12.5px; background:#f0f3f7; padding:1px 5px; border-radius:4px; white-space:nowrap; }
.failed { border-color:#d98b8b; } .reported { border-color:#d9b36b; }
.tag { font-size:12px; padding:1px 8px; border-radius:9px; background:#e3f1e6; color:#23683a; }
.card .tag { float:right; } .tag.handled { background:#e8eefb; color:#2b4c8c; }
.tag.failed { background:#f8e2e2; color:#8f2525; } .tag.reported { background:#faf0da; color:#7a5510; }
.tag.end { background:#e9edf2; color:#3b4757; }
@media print { .card { break-inside:avoid; } }
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
      const s = zoom*0.4*Math.min(wide, canvas.height)/radius, n = part.p.length/3, seen = [];
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
