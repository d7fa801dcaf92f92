"""Follows a library's objects, and the unknown things beside them, from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import claimed
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.tracking import Known, step
from twin_diagram.perception.segmentation.pieces import convex_pieces, floor_below
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.scene import object_filter, object_update
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ObjectStatus, PoseMeasurement


@dataclass(frozen=True)
class Tuning:
    """Constants of unknown things, chosen by hand for objects of a hand's size."""

    owned: float = 0.015
    """Points this near to a known object's surface are its own [m]."""

    unknown_points: int = 120
    """Points that nothing explains, of one segment, that make an unknown thing."""

    same: float = 0.05
    """An unknown thing this near to where one was is the same [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class TrackedObject:
    """One object after a frame, in the tracker's frame T.

    Attributes:
        track: number that stays with it.
        asset: name in the library; None: unknown.
        status: see `ObjectStatus`, lower case.
        probability: that it is there and the one that is named: the share of what is seen of it that fits.
        visible: share of its camera-facing surface that this frame shows.
        R, p: pose; of an unknown thing no turn, and the middle of its points.
        covariance: (6, 6), rotation then translation.
        pieces: vertices of convex pieces, of unknown things.
        found: in this very frame.
    """

    track: int
    asset: str | None
    status: str
    probability: float
    visible: float
    R: Array
    p: Array
    covariance: Array
    pieces: tuple[Array, ...]
    found: bool


class ObjectTracker:
    """Remembers poses from frame to frame; each object of the library is there once at most.

    Args:
        library: assets by name.
        perception: tuning of segmentation; of it the smallest segment.
    """

    def __init__(self, library: Mapping[str, Asset], perception: scenario.Perception) -> None:
        self.names = tuple(library)
        self._params = scenario.Registration()
        self._smallest = perception.smallest
        models = [ModelCloud.of(asset, self._params.model_points) for asset in library.values()]
        self._known = [Known.of(model) for model in models]
        self._slots = [Slot() for _ in models]
        self._settings = object_filter.FilterSettings.of(scenario.SceneUpdater())
        self._filters = object_filter.initial_filters(len(models))
        self._axes = np.array([[0.0, 0.0, float(a.symmetric_axis == "z")] for a in library.values()]).reshape(-1, 3)
        self._unknown: list[tuple[int, Array]] = []
        self._next = len(models)

    def start(self, name: str, R: Array, p: Array, time: float) -> None:
        """Tell where an object is before the first frame: R (3, 3), p (3,) [m] in T."""
        self._slots[self.names.index(name)] = Slot(True, R, p, np.zeros(6), time)

    def observe(self, segments: Segments) -> list[TrackedObject]:
        """Return what is known of all objects after a frame; those never seen are left out."""
        self._slots, measured = step(self._known, self._slots, segments, self._params, self._smallest)
        for k, one in enumerate(measured):
            if one.quality > 0:
                self._filters[k] = object_update.update(
                    self._filters[k], one, segments.time, self._settings, bool(self._axes[k, 2])
                )
        return [*self._objects(segments, measured), *self._things(segments, measured)]

    def _objects(self, segments: Segments, measured: Sequence[PoseMeasurement]) -> list[TrackedObject]:
        """Return the library's objects that were seen at some time."""
        now = segments.time
        belief = object_filter.propagate(self._filters, now, self._settings)
        status = object_filter.statuses(self._filters, now, self._settings)
        covariance = object_filter.pose_covariances(belief, self._axes, self._settings)
        frame = Frame.of(segments)
        result = []
        for k, name in enumerate(self.names):
            if status[k] == ObjectStatus.UNSEEN:
                continue
            found = measured[k].quality > 0
            # In view, the picture has the say; what the filter makes of it lags behind what is pushed.
            pose = measured[k].pose if found else belief.poses[k]
            R, p = rotations.matrix(pose[None, :4])[0], pose[4:]
            spread = self._measured(measured[k], R, k) if found else covariance[k]
            fit = assess(self._known[k].model, frame, Poses(R[None], p[None]), self._params.model_points)
            visible = float(np.clip(fit.visible_share[0], 0.0, 1.0))
            sure = float(min(measured[k].quality, 1.0)) if found else float(np.clip(fit.quality[0] * visible, 0.0, 1.0))
            life = ObjectStatus(int(status[k])).name.lower()
            result.append(TrackedObject(k, name, life, sure, visible, R, p, spread, (), found))
        return result

    def _measured(self, one: PoseMeasurement, R: Array, k: int) -> Array:
        """Return a measurement's covariance with what no averaging removes; nothing is known about a free axis."""
        axis = R @ self._axes[k]
        free = np.zeros((6, 6))
        free[:3, :3] = object_filter.TUNING.unknown_variance[0] * np.outer(axis, axis)
        return one.covariance + np.diag(self._settings.floor) + free

    def _things(self, segments: Segments, measured: Sequence[PoseMeasurement]) -> list[TrackedObject]:
        """Return what stands there and is none of the objects, as convex pieces."""
        free = np.ones(len(segments.labels), dtype=bool)
        for k, one in enumerate(measured):
            if one.quality > 0:
                R = rotations.matrix(one.pose[None, :4])[0]
                free[claimed(self._known[k].model, segments, R, one.pose[4:], TUNING.owned)] = False
        before, self._unknown = self._unknown, []
        result = []
        for label in range(segments.count):
            points = segments.points_W[free & (segments.labels == label)]
            if len(points) < TUNING.unknown_points or not segments.planes:
                continue
            pieces = convex_pieces(points, segments.camera.p_WC, floor_below(points, segments.planes))
            if not pieces:
                continue
            middle = points.mean(axis=0)
            track = self._number(middle, before)
            self._unknown.append((track, middle))
            spread = np.diag([*object_filter.TUNING.unknown_variance[:3], *np.var(points, axis=0)])
            result.append(
                TrackedObject(track, None, "tracked", 1.0, 1.0, np.eye(3), middle, spread, tuple(pieces), True)
            )
        return result

    def _number(self, middle: Array, before: list[tuple[int, Array]]) -> int:
        """Return the number of the unknown thing that was nearest, taken out of `before`, or a new one."""
        apart = [float(np.linalg.norm(middle - place)) for _, place in before]
        if apart and min(apart) < TUNING.same:
            return before.pop(int(np.argmin(apart)))[0]
        self._next += 1
        return self._next - 1
