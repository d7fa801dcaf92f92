"""The benchmark's results as one HTML file: figures against targets, calibration, separations, simpler methods."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from html import escape

import numpy as np

from gap_scoring import table
from gap_scoring.table import Record, Row

STYLE = """
body { margin:0; background:#f4f6f9; color:#1d2735;
  font:15px/1.5 system-ui,"Segoe UI",Roboto,"DejaVu Sans",sans-serif; }
main { max-width:1080px; margin:0 auto; padding:26px 20px 60px; }
h1 { font-size:25px; margin:0 0 4px; } h2 { font-size:18px; margin:0 0 4px; } p { color:#566173; margin:2px 0 12px; }
section { background:#fff; border:1px solid #e1e6ed; border-radius:12px; padding:20px 24px; margin-top:16px; }
.two { display:grid; grid-template-columns:repeat(auto-fit,minmax(420px,1fr)); gap:16px; } .two section { min-width:0; }
table { border-collapse:collapse; width:100%; font-variant-numeric:tabular-nums; font-size:14px; }
th { text-align:left; color:#566173; font-weight:600; font-size:13px; border-bottom:1px solid #e1e6ed; }
th, td { padding:5px 14px 5px 0; vertical-align:top; } td { border-bottom:1px solid #eef1f5; }
tr:last-child td { border-bottom:0; } td.n, th.n { text-align:right; white-space:nowrap; }
td.soft { color:#566173; white-space:nowrap; }
.met { color:#1f7a4d; font-weight:650; } .missed { color:#a3312b; font-weight:650; }
.scroll { overflow-x:auto; } svg { width:100%; height:auto; display:block; }
svg text { font-size:12px; fill:#1d2735; } svg .soft { fill:#566173; } svg .end { text-anchor:end; }
svg .middle { text-anchor:middle; } svg .grid { stroke:#e6ebf1; } svg .bound { stroke:#2463a6; stroke-width:1.6; }
svg .exact { stroke:#8a94a3; stroke-dasharray:4 3; } svg .dot { fill:#2463a6; }
svg .told { stroke:#d9772b; stroke-width:3; }
svg .right { fill:#2463a6; } svg .wrong { fill:#d9772b; }
.legend i { display:inline-block; width:12px; height:12px; border-radius:3px; margin:0 6px 0 14px;
  vertical-align:-1px; } .legend i:first-child { margin-left:0; } .legend .right { background:#2463a6; }
.legend .wrong { background:#d9772b; }
"""

EDGES = (0.0, 2.0, 4.0, 6.0, 8.0, 12.0, 20.0, 50.0, 100.0, np.inf)
WIDE, HIGH, LEFT, BELOW = 460.0, 300.0, 46.0, 44.0


def page(records: Sequence[Record], ablated: Sequence[Record] = ()) -> str:
    """The whole file.

    Args:
        records: results of the workflow.
        ablated: of simpler methods on some of the same cases.
    """
    records = list(records)
    versions = ", ".join(sorted({f"{r['version']} ({r['code']})" for r in records}))
    ran = [r for r in records if "error" not in r]
    claims = sum(len(r["claims"]) for r in ran)
    parts = [
        f"<h1>Does the workflow name what is hidden?</h1><p>{len(records)} cases whose truth was made in MuJoCo and "
        f"kept behind a wall; twin_diagram {escape(versions)}</p>",
        _section("Figures", "95 % bounds by Clopper and Pearson; one-sided where all or none hit.", _figures(records)),
        '<div class="two">',
        _section(
            "Calibration",
            f"{claims} names by the confidence that they were told with. "
            '<span class="legend"><br><i class="right"></i>share right, 95 % bounds'
            '<i class="wrong"></i>confidence told</span>',
            calibration(records),
        ),
        _section(
            "Separation",
            "How far each case's truth is from its nearest other explanation, in units of the log's noise. "
            '<span class="legend"><br><i class="right"></i>exactly right<i class="wrong"></i>not</span>',
            separations(records),
        ),
        "</div>",
        _section("By what was hidden", "Right: of the cases with separation ≥ 8.", _by_name(records)),
    ]
    if ablated:
        chosen = {(r["kind"], r["seed"]) for r in ablated}
        own = [r for r in records if (r["kind"], r["seed"]) in chosen]
        text = "Each on the same fixed tenth of the cases, from the same logs; none of them can abstain."
        parts.append(_section("Simpler methods", text, _grid(*table.ablation_rows(list(ablated), own))))
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Benchmark of twin-diagram gap</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{STYLE}</style></head><body><main>{''.join(parts)}</main></body></html>\n"
    )


def _section(title: str, lead: str, content: str) -> str:
    return f'<section><h2>{title}</h2><p>{lead}</p><div class="scroll">{content}</div></section>'


def _figures(records: list[Record]) -> str:
    def line(row: Row) -> str:
        word = {True: "met", False: "missed", None: ""}[row.met]
        cells = f'<td>{escape(row.figure.replace("`", ""))}</td><td class="n">{escape(row.value)}</td>'
        cells += f'<td class="n soft">{escape(row.bounds)}</td><td class="soft">{escape(row.target)}</td>'
        return f'<tr>{cells}<td class="{word}">{word}</td></tr>'

    head = '<tr><th></th><th class="n">result</th><th class="n">bounds</th><th>target</th><th></th></tr>'
    return f"<table>{head}{''.join(line(row) for row in table.rows(records))}</table>"


def _grid(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    top = "".join(f'<th class="{"n" if k else ""}">{escape(word)}</th>' for k, word in enumerate(head))
    body = "".join(
        "<tr>" + "".join(f'<td class="{"n" if k else ""}">{escape(word)}</td>' for k, word in enumerate(line)) + "</tr>"
        for line in lines
    )
    return f"<table><tr>{top}</tr>{body}</table>"


def _by_name(records: list[Record]) -> str:
    lines = "".join(
        f'<tr><td>{escape(name)}</td><td class="n">{count}</td><td class="n">{far}</td><td class="n">{right}</td>'
        f"<td>{escape(instead)}</td></tr>"
        for name, count, far, right, instead in table.name_rows(records)
    )
    head = '<tr><th>hidden</th><th class="n">cases</th><th class="n">≥ 8</th><th class="n">right</th>'
    return f"<table>{head}<th>said instead</th></tr>{lines}</table>"


def calibration(records: list[Record]) -> str:
    """Per range of confidences: what was told on average, and the share that was right."""
    bins = table.calibration(records)
    width, height = WIDE - LEFT - 12.0, HIGH - BELOW - 30.0
    step, base = width / max(1, len(bins)), 12.0 + height

    def high(share: float) -> float:
        return base - height * share

    parts = []
    for tick in np.linspace(0.0, 1.0, 6):
        y = high(float(tick))
        parts.append(f'<line x1="{LEFT}" x2="{LEFT + width}" y1="{y:.1f}" y2="{y:.1f}" class="grid"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" class="soft end">{100 * tick:.0f}</text>')
    for k, (mean, good, count) in enumerate(bins):
        bottom, top = table.proportion(round(good * count), count)
        x = LEFT + (k + 0.5) * step
        tip = f"{count} names told with {100 * mean:.1f} %: {100 * good:.0f} % right"
        parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{high(top):.1f}" y2="{high(bottom):.1f}" class="bound"/>')
        parts.append(
            f'<line x1="{x - 16:.1f}" x2="{x + 16:.1f}" y1="{high(mean):.1f}" y2="{high(mean):.1f}" class="told"/>'
        )
        parts.append(f'<circle cx="{x:.1f}" cy="{high(good):.1f}" r="5.5" class="dot"><title>{tip}</title></circle>')
        parts.append(f'<text x="{x:.1f}" y="{base + 18:.1f}" class="middle">{100 * mean:.0f} %</text>')
        parts.append(f'<text x="{x:.1f}" y="{base + 34:.1f}" class="soft middle">{count}</text>')
    parts.append(f'<text x="{LEFT - 8}" y="{base + 34:.1f}" class="soft end">n</text>')
    parts.append(f'<text x="{LEFT + width / 2}" y="{HIGH - 6}" class="middle">confidence told</text>')
    parts.append(f'<text transform="rotate(-90)" x="{-12 - height / 2}" y="12" class="middle">right [%]</text>')
    return _svg(parts, "confidence against the share that was right")


def separations(records: list[Record]) -> str:
    """Cases by separation, those exactly right below the others."""
    scored = [r for r in records if "error" not in r and r["kind"] not in ("clean", "outside")]
    width, height = WIDE - LEFT - 12.0, HIGH - BELOW - 26.0
    spans = list(itertools.pairwise(EDGES))
    counts = [
        [sum(low <= r["separation"] < high and bool(r["exact"]) is right for r in scored) for right in (True, False)]
        for low, high in spans
    ]
    most = max(1, *(sum(pair) for pair in counts))
    step, base = width / len(spans), 26.0 + height
    parts = []
    for k, ((low, high), (right, wrong)) in enumerate(zip(spans, counts, strict=True)):
        x, top = LEFT + k * step + 3.0, base
        for count, kind in ((right, "right"), (wrong, "wrong")):
            tall = height * count / most
            top -= tall
            if count:
                parts.append(
                    f'<rect x="{x:.1f}" y="{top:.1f}" width="{step - 6:.1f}" height="{tall:.1f}" class="{kind}"/>'
                )
        middle, said = x + step / 2 - 3.0, f"{right}/{right + wrong}" if right + wrong else ""
        parts.append(f'<text x="{middle:.1f}" y="{top - 6:.1f}" class="middle">{said}</text>')
        span = f"{low:g}–{high:g}" if np.isfinite(high) else f"{low:g}+"
        parts.append(f'<text x="{middle:.1f}" y="{base + 18:.1f}" class="soft middle">{span}</text>')
    parts.append(f'<line x1="{LEFT}" x2="{LEFT + width}" y1="{base}" y2="{base}" class="exact"/>')
    parts.append(f'<text x="{LEFT + width / 2}" y="{HIGH - 6}" class="middle">separation [noise units]</text>')
    parts.append(
        f'<text transform="rotate(-90)" x="{-26 - height / 2}" y="24" class="middle">right of all cases</text>'
    )
    return _svg(parts, "cases by separation")


def _svg(parts: Sequence[str], label: str) -> str:
    return f'<svg viewBox="0 0 {WIDE:g} {HIGH:g}" role="img" aria-label="{label}">{"".join(parts)}</svg>'
