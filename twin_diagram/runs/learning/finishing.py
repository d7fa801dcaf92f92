"""From an object's shape and what was weighed of it to its asset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin_diagram.assets.building.backends import ColouredSurface
from twin_diagram.assets.building.from_mesh import TUNING as FROM_MESH
from twin_diagram.assets.building.from_mesh import AssetPlace, build_from_triangles
from twin_diagram.assets.building.inertia import solid_of
from twin_diagram.assets.building.measured import MeasuredInertia, from_shape_alone
from twin_diagram.assets.building.surface import weld
from twin_diagram.errors import TwinError
from twin_diagram.model.model import Model
from twin_diagram.runs.learning.coverage import well_followed
from twin_diagram.runs.learning.felt_weight import Centre
from twin_diagram.runs.learning.record import SWUNG, Learned, LearningRecord, plain
from twin_diagram.runs.learning.shape_worker import SHAPE, read_shape
from twin_diagram.runs.learning.shown_object import ShownObject
from twin_diagram.runs.learning.swung_log import TUNING as SLID
from twin_diagram.runs.learning.swung_log import read_swung, slid_by
from twin_diagram.runs.learning.taken_again import note_taken_again
from twin_diagram.runs.learning.weighing import inertia_of
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    at_rest: float = 0.05
    """Standard error of a mass by the torques at rest alone [kg]: of eleven in three bins, with biases of 0.2 N·m that
    nobody told, it was off by 39 g RMS, by 77 at the most."""


TUNING = Tuning()


def finish(record: LearningRecord, one: Learned, model: Model, learned: Sequence[Learned] = ()) -> None:
    """Write an object's asset from shape and torques in its folder; what is wrong is noted in `one`, whatever it is.

    Of `learned`, all objects so far, those that were lost and are this one are noted as taken again.
    """
    folder: Path = record.of(one.name)
    try:
        if not (folder / SHAPE).is_file():
            raise TwinError("it has no shape yet")
        for gone in ("not weighed", "mass_swung"):
            one.figures.pop(gone, None)
        shape, measured = read_shape(folder), None
        if (folder / SWUNG).is_file():
            empty = record.folder / SWUNG
            try:
                swung = read_swung(folder / SWUNG)
                measured = inertia_of(model, swung, read_swung(empty) if empty.is_file() else None, shape)
                if slid_by(swung, SLID.too_far) >= 1.0:
                    one.figures["mass_swung"] = [measured.mass, measured.mass_std]
                    one.figures["not weighed"] = (
                        f"it slid by {1e3 * swung.slip[0]:.0f} mm and {np.rad2deg(swung.slip[1]):.0f}° in the fingers "
                        "while it was swung: that tells its mass alone"
                    )
                    measured = None
            except Exception as error:  # of logs, files, solvers: its shape is still worth an asset
                one.figures["not weighed"] = in_words(error)
        felt: dict[str, Any] = {
            name: one.figures[name] for name in ("mass_at_rest", "mass_swung", "centre_felt") if name in one.figures
        }
        figures = write_learned(one.name, record.library, shape, np.array(one.R_WS), measured, felt)
        one.figures = {**one.figures, **plain(figures)}
        one.state, one.no_asset, one.taken_again = "finished", "", ""
    except Exception as error:  # of meshes, textures, files: the other objects go on
        one.state, one.no_asset = "failed", in_words(error)
    note_taken_again(record, learned, one)


def in_words(error: Exception) -> str:
    """Return what went wrong in a line; what is no `TwinError` says little without its kind."""
    told = " ".join(str(error).split())
    return told if isinstance(error, TwinError) else f"{type(error).__name__}: {told}".removesuffix(": ")


def write_learned(
    name: str,
    library: Path,
    shape: ColouredSurface,
    R_WS: Array,
    measured: MeasuredInertia | None,
    felt: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write an object's asset, whole or not at all, and return figures of it.

    Args:
        name: of the asset; one of that name is replaced.
        library: folder of the assets.
        shape: its surface in S.
        R_WS: (3, 3) axes of S in those of W when it lay in the bin: the asset's z is upwards then.
        measured: its inertia in S; None: from the shape alone.
        felt: of `figures_of`, what was then told before it was swung; without a mass it is taken to be of water.

    Raises:
        AssetError: what cannot be written, or no body.
    """
    turned = shape.corners @ R_WS.T
    low, high = turned.reshape(-1, 3).min(axis=0), turned.reshape(-1, 3).max(axis=0)
    middle = 0.5 * (low + high)
    corners = turned - middle
    if measured is None:
        own = by_shape(corners, shape, R_WS, middle, felt or {})
    else:
        found = measured.turned(R_WS)
        own = replace(found, centre=found.centre - middle)
    told = AssetPlace(name, library, replace_it=True, measured=own)
    moments, axes = np.linalg.eigh(own.inertia)
    moments_std = own.turned(axes.T).inertia_std[:3]
    unseen, blank = shape.unseen, shape.blank
    notes = [f"{100 * unseen:.0f} % of the surface was never seen"]
    built = build_from_triangles(corners, shape.uv, shape.texture, told, name, unseen=unseen, notes=notes, blank=blank)
    return {
        "mass": own.mass,
        "mass_std": own.mass_std if np.isfinite(own.mass_std) else None,
        # From the middle of the box about it, along the asset's axes.
        "centre": own.centre,
        "centre_std": own.centre_std if np.isfinite(own.centre_std).all() else None,
        "moments": moments,
        "moments_std": moments_std if np.isfinite(moments_std).all() else None,
        "by": own.by,
        "volume": built.volume,
        "size": built.size,
        "unseen": unseen,
        "noise": shape.noise,
        "asset_notes": [note for note in built.notes if note not in notes],
        # X_OS as rows: the frame of the pictures in the asset's.
        "R_OS": R_WS,
        "p_OS": -(middle + own.centre),
    }


def by_shape(
    corners: Array, shape: ColouredSurface, R_WS: Array, middle: Array, felt: Mapping[str, Any]
) -> MeasuredInertia:
    """Return what a shape says of what was not swung, or slid too far, with what was felt of it.

    Args:
        corners: (F, 3, 3) of its surface about `middle`, in axes of W.
        shape: the same in S.
        R_WS: (3, 3) axes of S in those of W.
        middle: (3,) of that surface in these axes [m].
        felt: see `write_learned`.
    """
    solid = solid_of(weld(corners))
    mass, std, by = felt.get("mass_at_rest"), TUNING.at_rest, "partly"
    if "mass_swung" in felt:
        (mass, std), by = felt["mass_swung"], "measured"
    own = from_shape_alone(solid, FROM_MESH.density if mass is None else mass / solid.volume)
    if mass is not None:
        own = replace(own, mass_std=std, by={**own.by, "mass": by})
    if "centre_felt" in felt:
        own = pulled(own, Centre(*(np.array(part) for part in felt["centre_felt"])), shape, R_WS, middle)
    return own


def pulled(own: MeasuredInertia, felt: Centre, shape: ColouredSurface, R_WS: Array, middle: Array) -> MeasuredInertia:
    """Return what its shape says of an object with its centre of mass where its weight was felt to pull.

    Args:
        own: by its shape, in axes of W about `middle`.
        felt: where it pulls, in S; along what torques left open, the middle of the box about it stands there.
        shape: its surface in S.
        R_WS: (3, 3) axes of S in those of W.
        middle: (3,) of that surface in these axes [m].
    """
    taken, covariance = Centre.within(shape.corners.reshape(-1, 3)), R_WS @ felt.covariance @ R_WS.T
    # Along what torques left open its shape's own centre is better than the middle of a box.
    better = own.centre - (R_WS @ taken.mean - middle)
    open_ = covariance @ R_WS @ np.linalg.inv(taken.covariance) @ R_WS.T
    centre, std = R_WS @ felt.mean - middle + open_ @ better, np.sqrt(np.diag(covariance))
    by = {**own.by, "centre": "partly"}
    return replace(own, centre=centre, centre_std=std, centre_covariance=covariance, by=by)


def seen_so_far(shown: ShownObject) -> dict[str, float]:
    """Return figures of what was shown of an object, for the events."""
    so_far = {"pictures": len(shown.followed.shown), "slips": len(shown.followed.slips)}
    return so_far | ({"seen_share": shown.seen_shares[-1]} if shown.seen_shares else {})


def figures_of(shown: ShownObject) -> dict[str, Any]:
    """Return figures of how an object was shown, for people and tables."""
    slips = [[slip.picture, slip.distance, slip.angle] for slip in shown.followed.slips]
    weighed: dict[str, Any] = {} if shown.mass_at_rest is None else {"mass_at_rest": shown.mass_at_rest}
    weighed |= {} if shown.centre is None else {"centre_felt": [shown.centre.mean, shown.centre.covariance]}
    figures = {"pictures": len(shown.followed.shown), "slips": slips, "notes": shown.notes}
    kept = Counter(shown.followed.shown[k].grasp for k in well_followed(shown.followed))
    figures["pictures_by_grasp"] = [kept[grasp] for grasp in range(len(shown.X_ST))]
    seen = {"seen_share": shown.seen_shares[-1], "seen_after_grasps": shown.seen_shares} if shown.seen_shares else {}
    return figures | seen | weighed
