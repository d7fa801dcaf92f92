"""Takes into account that an object stands: of the poses that an image allows, those on the plane below are likelier.

Depth that is wrong at the same pixels of all images moves an object along the line of sight, into the table or above
it, and leans it. The plane is known far better: hundreds of patches of pixels show it, whose errors average out. Where
a pose, as unsure as it is, may be one of rest, the face that the object rests on is measured to lie in the plane: its
middle's height and two tilts, by Kalman's update. That moves the pose along what the image leaves open, which is mostly
the line of sight, and so mends its place on the table as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.assets import Asset
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.rotation import exp, screw
from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of standing, set on `sims/benchmarks/followed_scenes.py`, seeds 0 and 3, before a D435."""

    rough: float = 0.0008
    """Points so little above the lowest belong to the face that it rests on [m]: scans are that rough; a wider layer
    takes in rounded rims."""

    lowest: float = 0.1
    """Share of a face's corners that lie lower than the plane that it rests on."""

    rounds: int = 3
    """So often a face is fitted to the points near it."""

    narrow: float = 0.004
    """Half a face's width, RMS [m]: on what is narrower nothing stands."""

    alike: float = 0.3
    """Faces whose normals are nearer to each other are one, of which the largest counts [rad]."""

    begun: float = 0.1
    """Facets of the hull whose normals are nearer to each other lead to the same face [rad]."""

    place: float = 0.0005
    """How high the middle of the face may lie above the plane [m]: tables are that even, assets that exact."""

    flat: float = 0.0002
    """How even table and face are over the face's width [m]."""

    shared: float = 0.05
    """Share of a pixel's noise that is left in the plane's height: of some 400 patches."""

    tilted: float = 0.15
    """What leans by more does not stand [rad]."""

    cut: float = 9.0
    """What is farther off than so many squared deviations for each of the three numbers does not stand."""


TUNING = Tuning()


@dataclass(frozen=True)
class Footing:
    """A face that an object may rest on.

    Attributes:
        up: (3,) unit, away from what it rests on, in O.
        contacts: (M, 3) the face's corners in O, in its plane [m].
        uneven: how far they truly lie off it, RMS [m].
        area: [m²]
    """

    up: Array
    contacts: Array
    uneven: float
    area: float


def footings(asset: Asset) -> list[Footing]:
    """Return the faces of an object's hull on which it can rest, the largest first.

    Of what is round about its z axis, one of each inclination to it.
    """
    points = asset.points_O
    try:
        hull = ConvexHull(points)
    except QhullError:
        return []
    corners, middle = points[hull.vertices], points.mean(axis=0)
    faces = [_face(corners, -normal, middle) for normal in _apart(points[hull.simplices], hull.equations[:, :3])]
    found: list[Footing] = []
    for face in sorted((one for one in faces if one is not None), key=lambda one: -one.area):
        if asset.symmetric_axis == "z":
            same = any(abs(np.arccos(face.up[2]) - np.arccos(one.up[2])) < TUNING.alike for one in found)
        else:
            same = any(face.up @ one.up > np.cos(TUNING.alike) for one in found)
        if not same:
            found.append(face)
    return found


def _apart(facets: Array, normals: Array) -> list[Array]:
    """Return normals of a hull (F, 3) that lead to different faces, those of its largest facets (F, 3, 3) first."""
    area = np.linalg.norm(np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0]), axis=1)
    left = normals[np.argsort(-area, kind="stable")]
    found = []
    while len(left):
        found.append(left[0])
        left = left[left @ left[0] < np.cos(TUNING.begun)]
    return found


def _face(corners: Array, up: Array, middle: Array) -> Footing | None:
    """Return the face on which something rests that is about as high along `up` as can be; None: it does not rest.

    Args:
        corners: (N, 3) of its hull in O.
        up: (3,) unit, in O.
        middle: (3,) of its surface, which stands for its centre of mass, in O.
    """
    for _ in range(TUNING.rounds):
        heights = corners @ up
        rim = corners[heights < heights.min() + TUNING.rough]
        if len(rim) < 3:
            return None
        _, spread, axes = np.linalg.svd(rim - rim.mean(axis=0), full_matrices=False)
        if spread[1] < TUNING.narrow * np.sqrt(len(rim)):
            return None
        up = axes[2] * np.sign(axes[2] @ up)
    off = (rim - rim.mean(axis=0)) @ up
    # Rounded rims are above what truly touches.
    flat = rim - np.outer(off - np.quantile(off, TUNING.lowest), up)
    along = axes[:2].T
    outline = ConvexHull(flat @ along)
    if (outline.equations[:, :2] @ (middle @ along) + outline.equations[:, 2]).max() > 0.0:
        return None
    return Footing(up, flat[outline.vertices], float(np.sqrt(np.mean(off**2))), float(outline.volume))


def standing(feet: Sequence[Footing], turns: bool, one: RegisteredPose, segments: Segments) -> RegisteredPose:
    """Return a pose with what it tells that the object stands on a plane that is seen; the same where it does not.

    Args:
        feet: faces on which it may rest.
        turns: it is round about its z axis.
        one: the pose; its covariance is that of the image's noise alone, without the camera's calibration.
        segments: the image.
    """
    planes = [plane for plane in segments.planes if plane.part < 0]
    if not planes or not feet:
        return one
    plane = min(planes, key=lambda plane: abs(float(plane.height(one.p))))
    _, _, z = segments.camera.project(one.p)
    return stood(feet, turns, one, plane, float(segments.camera.depth_noise(z)))


def stood(feet: Sequence[Footing], turns: bool, one: RegisteredPose, plane: Plane, sigma: float) -> RegisteredPose:
    """Return a pose with what it tells that the object stands on a plane; the same where it does not.

    Args:
        feet: faces on which it may rest.
        turns: it is round about its z axis.
        one: the pose.
        plane: on which it may stand.
        sigma: of a pixel's depth there [m].
    """
    up = one.R.T @ plane.normal
    foot, contacts = _nearest(feet, turns, up)
    if foot is None:
        return one
    arms = contacts @ one.R.T
    off = plane.height(arms + one.p)
    J = np.ascontiguousarray(screw(arms, plane.normal))
    middle = J.mean(axis=0)
    # How far corners are off a level through their middle: two numbers tell it.
    u, s, vt = np.linalg.svd((J - middle) / np.sqrt(len(arms)), full_matrices=False)
    H = np.vstack([middle, s[:2, None] * vt[:2]])
    y = -np.append(off.mean(), u[:, :2].T @ (off - off.mean()) / np.sqrt(len(arms)))
    lean = np.hypot(TUNING.flat, foot.uneven)
    S = H @ one.covariance @ H.T + np.diag(np.square([np.hypot(TUNING.place, TUNING.shared * sigma), lean, lean]))
    if float(y @ np.linalg.solve(S, y)) > TUNING.cut * len(y):
        return one
    gain = np.linalg.solve(S, H @ one.covariance).T
    step = gain @ y
    covariance = one.covariance - gain @ S @ gain.T
    covariance = 0.5 * (covariance + covariance.T)
    return replace(one, R=exp(step[:3]) @ one.R, p=one.p + step[3:], covariance=covariance, alone=one)


def _nearest(feet: Sequence[Footing], turns: bool, up: Array) -> tuple[Footing | None, Array]:
    """Return the face on which an object most likely rests, and its corners (M, 3) in O; None: it leans too far.

    Args:
        feet: faces on which it may rest.
        turns: it is round about its z axis.
        up: (3,) away from the plane, in O, as the pose has it.
    """
    ups = np.stack([foot.up for foot in feet])
    angle = np.zeros(len(feet))
    if turns:
        angle = np.arctan2(up[1], up[0]) - np.arctan2(ups[:, 1], ups[:, 0])
    c, s = np.cos(angle), np.sin(angle)
    turned = np.stack([c * ups[:, 0] - s * ups[:, 1], s * ups[:, 0] + c * ups[:, 1], ups[:, 2]], axis=1)
    k = int(np.argmax(turned @ up))
    if turned[k] @ up < np.cos(TUNING.tilted):
        return None, np.zeros((0, 3))
    about_z = np.array([[c[k], -s[k], 0.0], [s[k], c[k], 0.0], [0.0, 0.0, 1.0]])
    return feet[k], feet[k].contacts @ about_z.T
