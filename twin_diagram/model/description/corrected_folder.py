"""The folder of a corrected model: the given description, what it lacks, and what is left once that is there."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import yaml
from pydrake.common.yaml import yaml_dump_typed

from twin_diagram.errors import ModelError
from twin_diagram.model.description import named_files
from twin_diagram.model.description.add_arm import EFFECTS_FILE
from twin_diagram.runtime import atomic_file
from twin_diagram.scenario import ArmModel

TORQUE_SIDES = ("motor", "link")
"""Of the gears, on which torques are measured."""
STANDING_FILE = "standing.yaml"
"""Written beside `effects.yaml`, where there is something to say."""


@dataclass
class CorrectedStanding:
    """How well a corrected model stands.

    Attributes:
        torque_side: of the gears, on which the torques were measured that it was corrected with.
        established: whether its effects have earned their names; else it is the best partial explanation.
        remainder: joint → root mean square of the torque that it leaves of motion like that of its logs [N·m].
        links: rows of the triangular factor of the covariance that its links, and after them joints' own terms, were
            found with, in the coordinates that `gap` fits them by; empty where they were not fitted together.
    """

    torque_side: str = "motor"
    established: bool = True
    remainder: dict[str, float] = field(default_factory=dict)
    links: list[list[float]] = field(default_factory=list)


def write(spec: ArmModel, folder: str | Path, standing: CorrectedStanding | None = None) -> None:
    """Write the description, `effects.yaml` and `standing.yaml`; see `Model.save`."""
    description = Path(spec.model)
    # Directives name files by URI alone.
    scheme = b"file://" if description.suffix.lower() in named_files.DIRECTIVES else b""
    with atomic_file.folder(folder) as aside:
        (aside / description.name).write_bytes(named_files.anchored(description.read_bytes(), description, scheme))
        yaml_dump_typed(replace(spec, model=description.name), filename=str(aside / EFFECTS_FILE))
        if standing is not None and standing != CorrectedStanding():
            (aside / STANDING_FILE).write_text(_text(standing), encoding="utf-8")


def _text(standing: CorrectedStanding) -> str:
    said = asdict(standing)
    rows = said.pop("links")
    text = yaml.safe_dump(said, sort_keys=False)
    return text + ("links:\n" + "".join(f"- {row}\n" for row in rows) if rows else "")


def standing_of(model: str | Path) -> CorrectedStanding:
    """Return how a corrected model stands; of what is no such folder, nothing is said.

    Raises:
        ModelError: the file cannot be read, or no such side.
    """
    path = Path(model) / STANDING_FILE
    if not path.is_file():
        return CorrectedStanding()
    try:
        said = yaml.safe_load(path.read_text(encoding="utf-8"))
        remainder = {str(joint): float(value) for joint, value in said.get("remainder", {}).items()}
        links = [[float(x) for x in row] for row in said.get("links", [])]
        side, established = said.get("torque_side", "motor"), bool(said.get("established", True))
        standing = CorrectedStanding(side, established, remainder, links)
        for number in (*remainder.values(), *(x for row in links for x in row)):
            if not math.isfinite(number):
                raise ValueError(f"{number} is not finite")
    except (yaml.YAMLError, AttributeError, ValueError, TypeError, OSError) as error:
        raise ModelError(f"{path}: {str(error).splitlines()[0]}") from error
    if standing.torque_side not in TORQUE_SIDES:
        raise ModelError(f"{path}: torque_side {standing.torque_side!r}: it is one of {', '.join(TORQUE_SIDES)}")
    return standing
