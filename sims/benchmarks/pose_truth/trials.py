"""Trials of one registration from a wrong start: a thing on the table, open or hidden in part, seen from any side."""

from __future__ import annotations

from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np
import numpy.typing as npt

from pose_truth import raycast, spoil
from pose_truth.things import Thing
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.pinhole import Pinhole, surface_at
from twin_diagram.perception.registration.resting import resting
from twin_diagram.perception.registration.rotation import exp, log
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.scenario.depth_sheets import SHEETS

Array = npt.NDArray[np.float64]
DISTANCE = 0.9
STRIDE = 2
FEW = 20
"""Fewer pixels tell no turn: facets of a mug's mesh alone change up to a dozen, a handle in view 30 and more."""


@dataclass(frozen=True)
class Trial:
    """One registration to be done.

    Attributes:
        thing: what is to be registered.
        R, p: its true pose; for the score alone.
        R0, p0: the start.
        camera, depth, rgb, mask: what a method is given; the mask is the true one.
        rays: where pixels look, which segmentation knows before the image comes.
        telling: pixels of the clean picture that tell the turn; for the score alone. See `telling`.
    """

    thing: Thing
    R: Array
    p: Array
    R0: Array
    p0: Array
    camera: Pinhole
    depth: npt.NDArray[np.float32]
    rgb: npt.NDArray[np.uint8]
    mask: npt.NDArray[np.bool_]
    rays: Array
    telling: int


def _unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def screen(
    camera: Pinhole, picture: raycast.Picture, share: float, angle: float
) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return a plate before the camera that hides `share` of the thing from one side, at an angle in the picture."""
    row, column = np.nonzero(picture.label == 0)
    way, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    pixels = np.column_stack([column, row]).astype(float)
    edge, middle = np.quantile(pixels @ way, share), np.median(pixels @ across)
    far = np.ptp(pixels @ way) * share + 30.0
    wide = np.ptp(pixels @ across) / 2 + 40.0
    corners = [(edge, -wide), (edge, wide), (edge - far, wide), (edge - far, -wide)]
    z = float(picture.depth[row, column].min()) - 0.12
    uv = np.array([w * way + (a + middle) * across for w, a in corners])
    cu, cv = camera.centre
    p_C = np.column_stack([(uv[:, 0] - cu) / camera.focal, (uv[:, 1] - cv) / camera.focal, np.ones(4)]) * z
    return p_C @ camera.R_WC.T + camera.p_WC, np.array([[0, 1, 2], [0, 2, 3]])


def draw(
    thing: Thing, profile: str, hidden: float, number: int, *, metres: float = 0.02, degrees: float = 10.0
) -> Trial:
    """Draw one trial; the same arguments give the same one."""
    rng = np.random.default_rng([crc32(thing.asset.name.encode()), crc32(profile.encode()), int(hidden * 100), number])
    rests = resting(thing.asset)
    R_rest, height = rests[0] if number % 2 == 0 else rests[int(rng.integers(len(rests)))]
    R = exp(np.array([[0.0, 0.0, rng.uniform(-np.pi, np.pi)]]))[0] @ R_rest
    p = np.array([*rng.uniform(-0.05, 0.05, 2), height])
    azimuth, elevation = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(25.0, 60.0))
    eye = DISTANCE * np.array(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    )
    camera = raycast.look_at(eye + [*p[:2], 0.0], np.array([*p[:2], 0.05]) + rng.normal(0.0, 0.05, 3) * [1, 1, 0])
    camera = replace(camera, depth_noise=DepthSigma(*SHEETS[profile]))
    picture = raycast.take(camera, [(thing, R, p)])
    plate = screen(camera, picture, hidden, rng.uniform(0, 2 * np.pi)) if hidden > 0 else None
    if plate is not None:
        picture = raycast.take(camera, [(thing, R, p)], plate)
    seen = telling(thing, (R, p), camera, plate, picture, float(np.radians(degrees)))
    depth, rgb = spoil.spoiled(picture, profile, rng)
    R0 = exp((np.radians(degrees) * _unit(rng))[None])[0] @ R
    mask = (picture.label == 0) & (depth > 0)
    return Trial(thing, R, p, R0, p + metres * _unit(rng), camera, depth, rgb, mask, camera.rays(STRIDE), seen)


def telling(
    thing: Thing,
    pose: tuple[Array, Array],
    camera: Pinhole,
    plate: tuple[Array, npt.NDArray[np.int64]] | None,
    picture: raycast.Picture,
    angle: float,
) -> int:
    """Return how many pixels change beyond noise where a thing is turned in place by as much as the start is off.

    It is the fewest of turns both ways about its own axes, but that of what looks the same all round. Where it is none,
    the picture is that of the turned thing, too, and no method can decide (`FEW`).
    """
    R, p = pose
    fewest = picture.label.size
    for axis in np.eye(3)[: 2 if thing.symmetric == "z" else 3]:
        for way in (-angle, angle):
            other = raycast.take(camera, [(thing, R @ exp((way * axis)[None])[0], p)], plate)
            off = np.abs(other.depth - picture.depth) > 3.0 * camera.depth_noise(picture.depth)
            colour = np.abs(other.rgb.astype(int) - picture.rgb).max(axis=2) > 3.0 * spoil.COLOUR
            fewest = min(fewest, int(np.count_nonzero(off | colour | (other.label != picture.label))))
    return fewest


def miss(trial: Trial, R: Array, p: Array) -> tuple[float, float]:
    """Return position error [m] and angle [rad] up to the thing's symmetry."""
    if trial.thing.symmetric == "z":
        angle = float(np.arccos(np.clip(R[:, 2] @ trial.R[:, 2], -1.0, 1.0)))
    else:
        angle = float(np.linalg.norm(log((R @ trial.R.T)[None])))
    return float(np.linalg.norm(p - trial.p)), angle


def squared(trial: Trial, R: Array, p: Array, covariance: Array) -> float:
    """Return the squared error over what is claimed, per degree of freedom; turns that cannot be told do not count."""
    error = np.concatenate([log((trial.R @ R.T)[None])[0], trial.p - p])
    if trial.thing.symmetric == "z":
        axis = np.cross(R[:, 2], trial.R[:, 2])
        angle = np.arccos(np.clip(R[:, 2] @ trial.R[:, 2], -1.0, 1.0))
        error[:3] = angle * axis / max(float(np.linalg.norm(axis)), 1e-12)
    return float(error @ np.linalg.solve(covariance, error)) / (5 if trial.thing.symmetric == "z" else 6)


def segments(trial: Trial) -> Segments:
    """Return the picture taken apart by the true mask, as segmentation hands it on."""
    camera, depth = trial.camera, trial.depth
    coarse = depth[::STRIDE, ::STRIDE]
    valid = coarse > 0
    mask = trial.mask[::STRIDE, ::STRIDE] & valid
    row, column = np.nonzero(mask)
    points, normals = surface_at(coarse, trial.rays, (row, column), camera.p_WC)
    label_image = np.full(coarse.shape, -1, dtype=np.int16)
    label_image[~valid] = -3
    label_image[mask] = 0
    return Segments(
        time=0.0,
        points_W=points,
        normals_W=normals,
        colours=trial.rgb[row * STRIDE, column * STRIDE] / 255.0,
        labels=np.zeros(len(row), dtype=np.int64),
        count=1,
        label_image=label_image,
        stride=STRIDE,
        depth=depth.copy(),
        rgb=trial.rgb.copy(),
        camera=camera,
        table=np.zeros(3),
    )
