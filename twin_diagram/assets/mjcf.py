"""Writes an asset's model as MJCF, which MuJoCo reads: the same link, surface, pieces and inertia as its SDF."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin_diagram.assets.description import AssetSpec
from twin_diagram.signals.arrays import Array


def mjcf(spec: AssetSpec, com: Array, inertia: Array, pieces: Sequence[str], friction: float = 0.6) -> str:
    """Return the model: one free body `object`, its visual in group 2, its pieces in group 3.

    Args:
        spec: of the asset.
        com: (3,) centre of mass in O [m].
        inertia: (3, 3) about it [kg·m²].
        pieces: files of the convex pieces.
        friction: of all pieces.
    """
    i = np.asarray(inertia)
    full = " ".join(f"{x:.9g}" for x in (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]))
    place = " ".join(f"{x:.9g}" for x in com)
    # The surface is only seen: MuJoCo need not find volume and inertia of it, which it refuses for thin ones.
    meshes = f'    <mesh name="surface" file="{spec.visual}" inertia="shell"/>\n'
    meshes += "".join(f'    <mesh name="piece{k}" file="{name}"/>\n' for k, name in enumerate(pieces))
    geoms = '      <geom type="mesh" mesh="surface" material="surface" group="2" contype="0" conaffinity="0" '
    geoms += 'mass="0"/>\n'
    geoms += "".join(
        f'      <geom type="mesh" mesh="piece{k}" group="3" friction="{friction:g} 0.005 0.0001" mass="0"/>\n'
        for k in range(len(pieces))
    )
    return (
        f'<mujoco model="{spec.name}">\n  <compiler angle="radian" meshdir="." texturedir="."/>\n  <asset>\n'
        f'    <texture name="surface" type="2d" file="{spec.visual.rsplit(".", 1)[0]}.png"/>\n'
        f'    <material name="surface" texture="surface"/>\n{meshes}  </asset>\n  <worldbody>\n'
        f'    <body name="object">\n      <freejoint/>\n'
        f'      <inertial pos="{place}" mass="{spec.mass:.9g}" fullinertia="{full}"/>\n{geoms}'
        f"    </body>\n  </worldbody>\n</mujoco>\n"
    )
