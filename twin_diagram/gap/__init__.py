"""Where simulation and measurement part ways, and which effect of the catalogue is missing.

The steps are usable one by one, on arrays: `prepare`, `locate`, `name` here, then `correction.add_effects.add` and
`report.comparison.show`.
"""

from __future__ import annotations

from twin_diagram.gap.findings import Alternative, Estimate, Finding, Moment, Place, Separation, Verdict
from twin_diagram.gap.naming import investigate, name
from twin_diagram.gap.residuals.prepared_logs import Record, Records, prepare
from twin_diagram.gap.verdict.locating import Map, locate, maps

__all__ = [
    "Alternative",
    "Estimate",
    "Finding",
    "Map",
    "Moment",
    "Place",
    "Record",
    "Records",
    "Separation",
    "Verdict",
    "investigate",
    "locate",
    "maps",
    "name",
    "prepare",
]
