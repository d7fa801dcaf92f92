"""The folder of a corrected model: the given description and what it lacks."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

from pydrake.common.yaml import yaml_dump_typed

from twin_diagram.model.description.add_arm import EFFECTS_FILE
from twin_diagram.runtime import atomic_file
from twin_diagram.scenario import ArmModel

_RELATIVE_FILE = re.compile(rb"""(<uri>|filename\s*=\s*["']|\bfile\s*=\s*["'])\s*([^"'<>]+?)\s*(?=["'<])""")
"""Of a URDF, SDF or MJCF: what stands before a file's name, and the name."""
_FOLDER = re.compile(rb"""(\b(?:meshdir|texturedir|assetdir)\s*=\s*["'])\s*([^"']+?)\s*(?=["'])""")
"""Of an MJCF's meshes and pictures, which its files are looked up in."""


def write(spec: ArmModel, folder: str | Path) -> None:
    """Write the description and `effects.yaml`; see `Model.save`."""
    description = Path(spec.model)
    with atomic_file.folder(folder) as aside:
        (aside / description.name).write_bytes(_anchor_files(description))
        yaml_dump_typed(replace(spec, model=description.name), filename=str(aside / EFFECTS_FILE))


def _anchor_files(description: Path) -> bytes:
    """Return the description's text, with the files beside it that it names named by absolute paths."""

    def anchored(match: re.Match[bytes]) -> bytes:
        path = description.parent / os.fsdecode(match[2])
        return match[1] + os.fsencode(path.resolve()) if b"://" not in match[2] and path.is_file() else match[0]

    def anchored_folder(match: re.Match[bytes]) -> bytes:
        path = description.parent / os.fsdecode(match[2])
        return match[1] + os.fsencode(path.resolve()) if path.is_dir() else match[0]

    text = description.read_bytes()
    if description.suffix.lower() == ".xml":
        text = _FOLDER.sub(anchored_folder, text)
    return _RELATIVE_FILE.sub(anchored, text)
