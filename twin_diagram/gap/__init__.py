"""Where simulation and measurement part ways, and which effect of the catalogue is missing.

`run_gap` is the whole workflow on files; its steps `prepare`, `locate`, `name`, `add` and `show` are usable one by one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.gap.correction.add_effects import Added, add
    from twin_diagram.gap.findings import Alternative, Estimate, Finding, Moment, Place, Separation, Verdict
    from twin_diagram.gap.naming import investigate, name
    from twin_diagram.gap.report.comparison import Shown, show
    from twin_diagram.gap.residuals.prepared_logs import Record, Records, prepare
    from twin_diagram.gap.verdict.locating import locate
    from twin_diagram.gap.workflow import Gap, run_gap

__all__ = [
    "Added",
    "Alternative",
    "Estimate",
    "Finding",
    "Gap",
    "Moment",
    "Place",
    "Record",
    "Records",
    "Separation",
    "Shown",
    "Verdict",
    "add",
    "investigate",
    "locate",
    "name",
    "prepare",
    "run_gap",
    "show",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
