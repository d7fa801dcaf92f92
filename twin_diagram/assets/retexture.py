"""The same shape with another texture: an asset written anew from an asset."""

from __future__ import annotations

from pathlib import Path

from twin_diagram.assets.description import read_spec
from twin_diagram.assets.procedural import write_bottle, write_box, write_can, write_mug
from twin_diagram.errors import AssetError


def retexture(source: str | Path, folder: str | Path, texture_seed: int) -> Path:
    """Write the procedural asset in `source` to `folder` with a texture drawn from `texture_seed`. Returns `folder`.

    Raises:
        AssetError: `source` is no asset, or not one of the procedural shapes.
    """
    spec = read_spec(Path(source))
    length, width, height = spec.size
    if spec.shape == "box":
        return write_box(folder, spec.name, (length, width, height), texture_seed, spec.mass)
    writers = {"can": write_can, "bottle": write_bottle, "mug": write_mug}
    if spec.shape not in writers:
        raise AssetError(f"{source}: shape {spec.shape!r} has no procedural texture; shapes: box, {', '.join(writers)}")
    # The width: a mug's length includes its handle.
    return writers[spec.shape](folder, spec.name, width / 2, height, texture_seed, spec.mass)
