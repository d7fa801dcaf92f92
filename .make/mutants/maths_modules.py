"""Which modules of `twin_diagram` count as maths: all but those that are named here.

Patterns are matched against a module's path below `twin_diagram`, without `.py`, and against each folder above it. They
hold the names from before and after the reorganisation; one that matches nothing does no harm.
"""

from __future__ import annotations

from fnmatch import fnmatch
from pathlib import Path

PACKAGE = "twin_diagram"

LEFT_OUT = (
    # Faces of packages, commands, wiring of systems, errors, files.
    *("__init__", "*/__init__", "__main__", "cli", "errors", "resources", "native", "timing", "progress", "runtime"),
    *("run", "attachments", "trial", "runs/run", "runs/outputs", "runs/trial"),
    *("diagram", "twin/twin", "twin/closed_loop", "fused_sensors", "twin/fused_sensors"),
    # Presentation.
    *("looking", "visualization", "gap/report", "gap/report_*", "gap/show", "gap/gap_json"),
    *("healing/words", "twin/healing/event_sentences", "handling/display"),
    # Workflows and processes: what they call is counted, not their order.
    *("gap/command", "gap/workflow", "healing/process", "healing/worker"),
    *("twin/healing/gap_process", "twin/healing/worker", "handling/pipeline"),
    # Readers and writers, descriptions, the scenario's dataclasses.
    *("logs", "scenario", "scenario_file", "scenario_values"),
    *("description", "model_folder", "unread", "model/description"),
    *("assets/command", "assets/library", "assets/building/source_mesh", "assets/building/write_asset"),
    *("assets/building/gltf_file", "assets/building/named_files", "assets/building/mesh_parts"),
    *("planning/grasps/command", "planning/grasps/page", "planning/grasps/kept_grasps"),
    *("assets/building/from_mesh", "assets/building/apart_process"),
    *("assets/asset", "assets/description", "gap/correction/named_effects", "gap/named"),
    # Stations other than the simulated one; what all stations share.
    *("station/lcm", "station/lcm_*", "station/replay", "station/played", "station/recorder", "station/recording"),
    *("station/scan_player", "station/make", "station/make_station", "station/parsing", "station/add_models"),
    *("station/ports", "station/ignored", "station/ignored_commands", "station/mujoco"),
)
KEPT = (
    *("logs/resampling", "logs/wrapping", "logs/unwrapping", "logs/differentiation"),
    *("logs/downsampling", "logs/parting", "logs/spikes", "logs/dejittering"),
)
"""Maths inside a folder that is left out."""


def is_maths(module: str) -> bool:
    """Return true where a module, such as `gap/search`, counts as maths."""
    parts = module.split("/")
    above = ["/".join(parts[: count + 1]) for count in range(len(parts))]
    return module in KEPT or not any(fnmatch(path, pattern) for path in above for pattern in LEFT_OUT)


def maths_modules(root: Path) -> list[str]:
    """Return the paths of the maths modules, relative to the checkout `root`, sorted."""
    package = root / PACKAGE
    modules = {path: path.relative_to(package).with_suffix("").as_posix() for path in package.rglob("*.py")}
    return sorted(path.relative_to(root).as_posix() for path, module in modules.items() if is_maths(module))


def package_of(path: str) -> str:
    """Return the package that a module is counted under: the folder just below `twin_diagram`, or `(top)`."""
    parts = path.split("/")
    return parts[1] if len(parts) > 2 else "(top)"
