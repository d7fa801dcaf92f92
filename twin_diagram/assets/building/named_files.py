"""Files that a mesh names: read where they lie in its folder, or in one that was told."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np

from twin_diagram.assets.mesh import Image
from twin_diagram.errors import AssetError
from twin_diagram.logs.frames.folder_files import image_of

PICTURES: Final = (".png", ".jpg", ".jpeg", ".webp", ".ktx2", ".tga", ".bmp", ".gif", ".tif", ".tiff")
"""Suffixes of what materials name."""


class Beside:
    """Reads the files that a mesh names: only such as lie, links followed, in one folder or below.

    Args:
        mesh: that names them, from its own folder on.
        root: the folder that holds them all; None: the mesh's own.
        pictures: whether they are wanted.
    """

    def __init__(self, mesh: Path, root: Path | None = None, pictures: bool = True) -> None:
        self._mesh, self._folder = mesh, mesh.parent
        self._root, self._pictures = (mesh.parent if root is None else root).resolve(), pictures
        self._where = "the mesh's folder" if root is None else str(root)
        self.notes: list[str] = []
        self.problem: AssetError | None = None

    def get(self, name: str) -> bytes:
        """Return a file's contents.

        Raises:
            AssetError: it lies elsewhere.
            FileNotFoundError: it is not there; noted.
        """
        path = self._place(name.strip())
        if not self._pictures and path.suffix.lower() in PICTURES:
            raise FileNotFoundError(str(path))
        try:
            inside = path.resolve().is_relative_to(self._root)
        except (OSError, ValueError, RuntimeError):  # a circle of links, a name with \0
            inside = False
        if not inside:
            self.problem = AssetError(
                f"{self._mesh}: names {name!r}, which lies outside of {self._where}; copy it there, named by itself, "
                "or tell a folder that holds both, --root"
            )
            raise self.problem
        if not path.is_file():
            self.notes.append(f"{self._mesh}: names {name!r}, which is not there; built without it")
            raise FileNotFoundError(str(path))
        return path.read_bytes()

    __getitem__ = get

    def _place(self, name: str) -> Path:
        """Return where a file is that is named so: there, as Windows writes it, or where Gazebo has its pictures."""
        plain = name.replace("\\", "/")
        places = [self._folder / name, self._folder / plain, self._root / "materials" / "textures" / Path(plain).name]
        return next((place for place in places if place.exists()), places[0])


def decoded(data: bytes, name: str) -> Image:
    """Return an image file's RGB.

    Raises:
        AssetError: not an image.
    """
    bgr = image_of(data, cv2.IMREAD_COLOR)
    if bgr is None:
        raise AssetError(f"{name}: not an image that can be read; save it as PNG or JPEG")
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)
