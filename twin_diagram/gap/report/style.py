"""How the report looks."""

from __future__ import annotations

STYLE = """
:root { --ink:#1d2735; --soft:#566173; --line:#e1e6ed; --paper:#ffffff; --ground:#f4f6f9; --before:#d9772b;
  --after:#2463a6; --noise:#8a94a3; --good:#1f7a4d; --warn:#a15c07; --bad:#a3312b; }
* { box-sizing:border-box; }
html { -webkit-text-size-adjust:100%; }
body { margin:0; background:var(--ground); color:var(--ink); line-height:1.55;
  font:16px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,"DejaVu Sans",sans-serif; }
main { max-width:1080px; margin:0 auto; padding:0 20px 64px; }
header.top { background:var(--ink); color:#fff; padding:34px 20px 76px; }
header.top > div { max-width:1040px; margin:0 auto; }
header.top .kicker { color:#aab6c8; font-size:14px; letter-spacing:.02em; margin:0 0 10px; overflow-wrap:anywhere; }
header.top h1 { margin:0; font-size:30px; line-height:1.25; font-weight:650; max-width:26em; }
header.top h1.long { font-size:22px; max-width:38em; }
.badge { display:inline-block; padding:2px 11px; border-radius:99px; font-size:13px; font-weight:650; margin-right:10px;
  color:#fff; vertical-align:1px; }
.badge.named { background:var(--after); } .badge.none { background:var(--good); }
.badge.unknown { background:var(--bad); }
.tiles { display:grid; grid-template-columns:repeat(auto-fit,minmax(215px,1fr)); gap:14px; margin:-48px 0 8px; }
.tile { background:var(--paper); border:1px solid var(--line); border-radius:12px; padding:16px 18px;
  box-shadow:0 2px 10px rgba(20,32,50,.06); }
.tile b { letter-spacing:-.01em; display:block; font-size:22px; line-height:1.35; font-weight:680;
  font-variant-numeric:tabular-nums; }
.tile em { font-style:normal; white-space:nowrap; }
.tile small { font-size:14px; font-weight:600; color:var(--soft); }
.tile span { color:var(--soft); font-size:14px; line-height:1.4; display:block; margin-top:4px; }
section { background:var(--paper); border:1px solid var(--line); border-radius:12px; padding:24px 26px;
  margin-top:18px; }
h2 { margin:0 0 4px; font-size:21px; line-height:1.3; }
h3 { margin:0 0 6px; font-size:17px; line-height:1.35; }
section h3 + ul { margin:4px 0 0; padding-left:22px; } .scroll + h3 { margin-top:20px; }
p { margin:8px 0; } p.lead { color:var(--soft); margin:2px 0 16px; max-width:52em; }
.effect { display:grid; grid-template-columns:1fr 132px; gap:8px 24px; border-top:1px solid var(--line);
  padding:18px 0 14px; }
.effect:first-of-type { border-top:0; padding-top:6px; }
.effect .sentence { font-size:17px; margin:0 0 6px; }
.effect .what { color:var(--soft); font-size:15px; margin:0 0 10px; max-width:46em; }
.effect .sure { text-align:center; font-size:13.5px; color:var(--soft); line-height:1.35; }
.alternatives { font-size:14.5px; color:var(--soft); margin:10px 0 0; }
.ring { width:92px; } .ring-back { fill:none; stroke:#e6ebf1; stroke-width:8; }
.ring-front { fill:none; stroke:var(--after); stroke-width:8; }
.ring-text { font-size:15px; font-weight:680; text-anchor:middle; fill:var(--ink); }
table { border-collapse:collapse; font-size:14.5px; font-variant-numeric:tabular-nums; }
th { text-align:left; font-weight:600; color:var(--soft); font-size:13px; border-bottom:1px solid var(--line); }
th, td { padding:5px 18px 5px 0; vertical-align:top; } td { border-bottom:1px solid #eef1f5; }
td.n, th.n { text-align:right; } tr:last-child td { border-bottom:0; }
.scroll { overflow-x:auto; }
.track { display:inline-block; width:110px; height:9px; border-radius:5px; background:#e9edf2; vertical-align:1px; }
.fill { display:block; height:100%; border-radius:5px; background:var(--before); }
.charts { display:grid; grid-template-columns:1fr 1fr; gap:20px 34px; } .charts h3 { font-size:15.5px; }
.bars { width:100%; height:auto; display:block; } .bars text { font-size:14px; fill:var(--ink); }
.bars .joint { text-anchor:end; font-size:13px; } .bars .value { font-size:12.5px; fill:var(--soft); }
.bars .before { fill:var(--before); } .bars .after { fill:var(--after); }
.bars .noise { stroke:#4b5668; stroke-width:1.6; stroke-dasharray:3 2; }
.legend { font-size:14px; color:var(--soft); margin:0 0 14px; }
.legend i { display:inline-block; width:13px; height:13px;
  border-radius:3px; margin:0 6px 0 16px; vertical-align:-2px; } .legend i:first-child { margin-left:0; }
.legend i.before { background:var(--before); } .legend i.after { background:var(--after); }
.legend i.dash { width:0; border-radius:0; border-left:2px dashed #4b5668; margin-right:10px; }
.legend i.band { background:rgba(138,148,163,.3); }
figure { margin:22px 0 0; } figure svg { width:100%; height:auto; display:block; }
figcaption { font-weight:600; margin-bottom:6px; } figcaption span { font-weight:400; color:var(--soft); }
pre { background:#f6f8fa; border:1px solid var(--line); border-radius:8px; padding:12px 14px; overflow-x:auto;
  margin:10px 0 0;
  font:13px/1.5 ui-monospace,"SF Mono",Menlo,Consolas,"DejaVu Sans Mono",monospace; }
pre .plus { background:#e3f4e9; display:block; } pre .minus { background:#fbe7e6; display:block; }
pre .same { display:block; color:var(--soft); }
a { color:var(--after); }
code { font:13.5px ui-monospace,"SF Mono",Menlo,Consolas,"DejaVu Sans Mono",monospace; overflow-wrap:anywhere; }
.experiment { display:grid; grid-template-columns:1fr 360px; gap:6px 26px; border-top:1px solid var(--line);
  padding:16px 0 12px; align-items:center; } .experiment:first-of-type { border-top:0; }
.experiment p { margin:4px 0; font-size:15px; } .experiment .why { color:var(--soft); font-size:14.5px; }
.spark { width:100%; height:auto; background:#f8fafc; border-radius:6px; }
.spark polyline { fill:none; stroke-width:1.1; }
.spark .still { stroke:#c3cbd6; } .spark .moved { stroke:var(--after); }
.note { border-left:4px solid var(--warn); background:#fdf6ea; padding:10px 14px; border-radius:0 8px 8px 0;
  margin:14px 0 0; }
details { margin-top:12px; } summary { cursor:pointer; color:var(--after); font-weight:600; font-size:15px; }
dl { display:grid; grid-template-columns:max-content 1fr; gap:6px 20px; margin:8px 0 0; font-size:15px; }
dt { font-weight:600; } dd { margin:0; color:var(--soft); }
footer { color:var(--soft); font-size:13.5px; margin-top:22px; }
@media (max-width:780px) { .charts,.experiment { grid-template-columns:1fr; } .effect { grid-template-columns:1fr; }
  .effect .sure { text-align:left; } header.top h1 { font-size:24px; } section { padding:20px 16px; }
  dl { grid-template-columns:1fr; gap:0; } dd { margin-bottom:8px; } }
@media print { body { background:#fff; } section,.tile { break-inside:avoid; box-shadow:none; }
  header.top { color:var(--ink); background:#fff; padding-bottom:20px; } .tiles { margin-top:0; } }
"""
"""CSS of the page; its colours are those of `pictures`, too."""
