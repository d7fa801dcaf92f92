"""From a folder of posed RGB-D frames to an asset.

Example:
    >>> from twin_diagram.assets.building import build_from_frames
    >>> build_from_frames("scans/mug", "mug", "my_objects", mass=0.3).folder  # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from twin_diagram.assets.building.cube_scale import Cube
from twin_diagram.assets.building.from_mesh import AssetPlace, BuiltAsset, build_from_triangles, check_told
from twin_diagram.assets.building.inertia import Hollow, enclosed, less
from twin_diagram.assets.building.predictions import metric, read_predictions
from twin_diagram.assets.building.reconstruct import FrameSource, Reconstruction, reconstruct
from twin_diagram.assets.building.shape_errors import shape_errors
from twin_diagram.assets.building.texture_atlas import lay_out, textured
from twin_diagram.assets.building.write_asset import place_for
from twin_diagram.errors import AssetError, FramesError
from twin_diagram.logs.frames.scene_folder import FrameFolder
from twin_diagram.logs.frames.transforms_folder import FILE as TRANSFORMS
from twin_diagram.logs.frames.transforms_folder import TransformsFolder
from twin_diagram.runtime.threads import one_thread
from twin_diagram.signals.arrays import Array


@one_thread()
def build_from_frames(
    folder: str | Path,
    name: str,
    library: str | Path,
    mass: float | None = None,
    density: float | None = None,
    masks: str | Path | None = None,
    replace_it: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> BuiltAsset:
    """Reconstruct the one object that frames show and put it into a library.

    Its z axis is the normal of the plane that it stands on, or W's where there is none.

    Args:
        folder: a BOP scene with the cameras' poses, or Nerfstudio's `transforms.json` with depth.
        name: of the asset.
        library: the folder of assets; made where there is none.
        mass: [kg]
        density: [kg/m³]; without either: water's.
        masks: a folder of masks; None: the frames' own `mask_visib/`, or else what stands out of its support.
        replace_it: write an asset of that name anew.
        say: is told of each step.

    Raises:
        FramesError: frames that cannot be used.
        AssetError: a name, place, mass or density that cannot; nothing is written.
    """
    check_told(mass, density, "m")
    place_for(name, library, replace_it)
    frames = posed_frames(folder, masks)
    for note in frames.notes if isinstance(frames, FrameFolder) else ():
        say(f"note: {note}")
    return asset_of_frames(frames, AssetPlace(name, library, mass, density, replace_it), str(folder), say)


def posed_frames(folder: str | Path, masks: str | Path | None = None) -> FrameFolder | TransformsFolder:
    """Return a folder's frames: of Nerfstudio where it holds `transforms.json` and no masks are told, else of BOP.

    Raises:
        FramesError: frames that cannot be used, or that do not say where their cameras were.
    """
    if masks is None and (Path(folder) / TRANSFORMS).is_file():
        return TransformsFolder(folder)
    frames = FrameFolder(folder, masks)
    if not frames.posed:
        raise FramesError(
            f"{Path(folder) / 'scene_camera.json'}: no cam_R_w2c and cam_t_w2c: building needs posed views"
        )
    return frames


@one_thread()
def build_from_predictions(
    file: str | Path,
    name: str,
    library: str | Path,
    cube_edge: float,
    mass: float | None = None,
    density: float | None = None,
    masks: str | Path | None = None,
    replace_it: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> BuiltAsset:
    """Reconstruct the one object of VGGT's `predictions.npz` and put it into a library.

    A green cube stands beside it, whose edge tells the scale.

    Args:
        file: the predictions.
        name: of the asset.
        library: the folder of assets; made where there is none.
        cube_edge: of the cube [m].
        mass: [kg]
        density: [kg/m³]; without either: water's.
        masks: a folder of masks, of the predictions' size; None: what stands out beside the cube.
        replace_it: write an asset of that name anew.
        say: is told of each step.

    Raises:
        FramesError: predictions that cannot be used, no cube.
        AssetError: as of `build_from_frames`.
    """
    check_told(mass, density, "m")
    if not (np.isfinite(cube_edge) and cube_edge > 0):
        raise AssetError(f"--cube-edge {cube_edge:g}: must be positive [m]")
    place_for(name, library, replace_it)
    predicted = read_predictions(file)
    frames, cube, factor = metric(predicted if masks is None else predicted.masked(masks), cube_edge, str(file))
    say(f"scale: {factor:.5g} m per unit of the predictions")
    return asset_of_frames(frames, AssetPlace(name, library, mass, density, replace_it), str(file), say, cube)


def asset_of_frames(
    frames: FrameSource,
    told: AssetPlace,
    where: str,
    say: Callable[[str], None] = lambda text: None,
    beside: Cube | None = None,
) -> BuiltAsset:
    """Reconstruct what frames show, colour it, and put it into a library; `beside` is a cube that is none of it.

    Raises:
        FramesError, AssetError: as of `build_from_frames`.
    """
    return asset_of_shape(reconstruct(frames, where, say=say, beside=beside), told, where)


def asset_of_shape(found: Reconstruction, told: AssetPlace, where: str) -> BuiltAsset:
    """Colour what was reconstructed and put it into a library.

    Raises:
        AssetError: as of `build_from_frames`.
    """
    atlas = lay_out(len(found.faces))
    picture, blank = textured(found.views, found.vertices, found.faces, atlas)
    notes = [
        f"{100 * found.unseen:.0f} % of the surface was never seen: there it is closed by what nothing contradicts"
    ]
    corners = upright(found)[found.faces]
    doubt, (R, p) = found.doubt, upright_pose(found)
    empty = doubt.hollow()
    body = less(enclosed(found.vertices, found.faces, "surface"), empty)
    errors = shape_errors(found.vertices, found.faces, found.views, found.noise, doubt, body.centre, R)
    hollow = Hollow((empty.places - p) @ R.T, empty.volumes)
    notes.append(f"by its shape the volume is known to {100 * errors.volume_std / body.volume:.2g} %")
    try:
        return build_from_triangles(
            corners,
            atlas.uv,
            picture,
            told,
            Path(where).name,
            unseen=float(found.unseen),
            notes=notes,
            errors=errors,
            hollow=hollow,
            blank=blank,
        )
    except AssetError as error:
        raise AssetError(f"{where}: {error}") from None


def upright(found: Reconstruction) -> Array:
    """Return the vertices (V, 3) turned the least way that takes the support's normal to z, its plane at z = 0."""
    R, p = upright_pose(found)
    return np.asarray((found.vertices - p) @ R.T)


def upright_pose(found: Reconstruction) -> tuple[Array, Array]:
    """Return R (3, 3) and p (3,) [m] of `upright`: what is at v comes to R (v − p)."""
    if found.plane is None:
        return np.eye(3), np.zeros(3)
    n, d = found.plane[:3], found.plane[3]
    z = np.array([0.0, 0.0, 1.0])
    v, c = np.cross(n, z), float(n @ z)
    if c < -0.999999:
        R = np.diag([1.0, -1.0, -1.0])
    else:
        skew = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        R = np.eye(3) + skew + skew @ skew / (1 + c)
    return np.asarray(R), np.asarray(d * n)
