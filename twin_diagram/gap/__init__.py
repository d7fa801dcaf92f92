"""Where simulation and measurement part ways, and which effect of the catalogue is missing.

The steps are usable one by one, on arrays: `prepare`, `locate`, `name` here, then `add.add` and `show.show`.
"""

from __future__ import annotations

from twin_diagram.gap.finding import Alternative, Estimate, Finding, Moment, Place, Separation, Verdict
from twin_diagram.gap.locating import Map, locate, maps
from twin_diagram.gap.naming import investigate, name
from twin_diagram.gap.records import Record, Records, prepare

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
