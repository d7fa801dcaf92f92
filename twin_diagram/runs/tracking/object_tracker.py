"""Follows a library's objects, and the unknown things beside them, from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.alternatives import PoseHypothesis
from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.colour_shift import ALIGNED, ColourShift
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import RegisteredPose, claimed
from twin_diagram.perception.registration.settling import SettledPose, settle
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.tracking import Known, step
from twin_diagram.perception.segmentation.pieces import convex_pieces, floor_below
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.scene import object_filter, object_update
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, ObjectStatus, PoseMeasurement


@dataclass(frozen=True)
class Tuning:
    """Constants of unknown things, chosen by hand for objects of a hand's size."""

    owned: float = 0.015
    """Points this near to a known object's surface are its own [m]."""

    unknown_points: int = 120
    """Points that nothing explains, of one segment, that make an unknown thing."""

    same: float = 0.05
    """An unknown thing this near to where one was is the same [m]."""

    around: float = 0.025
    """Points this near to an object's surface, in the segment that is its own, should be explained by it [m]."""

    doubt: float = 0.12
    """A pose of which half of the surface seen fits is right as often as wrong; so much more of it makes it e times
    rarer that it is wrong."""

    missed: float = 20.0
    """An object that should be seen whole and is not loses so many nats of its odds in a second: said in 0.3 s."""

    aside: float = 2.0
    """How far off depth colours may lie, RMS, of images 640 wide [px]: as cheap cameras' do, where nothing is told."""

    longest: float = 0.1
    """Of two frames farther apart in time the second says no more [s]: a folder may not tell times."""

    forgotten: float = 60.0
    """An object that nobody sees is as likely to be there as not after so long [s]."""


TUNING = Tuning()


@dataclass(frozen=True)
class TrackedObject:
    """One object after a frame, in the tracker's frame T.

    Attributes:
        track: number that stays with it.
        asset: name in the library; None: unknown.
        status: see `ObjectStatus`, lower case; `lost` once it is improbable.
        probability: that it is there and the one that is named.
        visible: share of its camera-facing surface that this frame shows.
        R, p: pose; of an unknown thing no turn, and the middle of its points.
        covariance: (6, 6), rotation then translation.
        hypotheses: poses that the frame allows, with probabilities that sum to 1; the first is the pose.
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
    hypotheses: tuple[PoseHypothesis, ...]
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
        self._odds = np.zeros(len(models))
        self._shift: ColourShift | None = None
        """Of colours beside depth, from the first frame on."""
        self._rivals: list[tuple[tuple[Array, Array, float], ...]] = [() for _ in models]
        """By object: what it may be mistaken for, as X_OO' (turn, shift) and probability, from when it was found."""
        self._followed = [False for _ in models]
        self._last = NEVER
        self._unknown: list[tuple[int, Array]] = []
        self._next = len(models)

    def start(self, name: str, R: Array, p: Array, time: float) -> None:
        """Tell where an object is before the first frame: R (3, 3), p (3,) [m] in T."""
        self._slots[self.names.index(name)] = Slot(True, R, p, np.zeros(6), time)
        self._followed[self.names.index(name)] = True

    def observe(self, segments: Segments) -> list[TrackedObject]:
        """Return what is known of all objects after a frame; those never seen are left out."""
        if self._shift is None:
            self._shift = ColourShift.told(TUNING.aside * segments.camera.width / 640)
        self._slots, measured, self._shift = step(
            self._known, self._slots, segments, self._params, self._smallest, self._shift
        )
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
        frame = Frame.of(segments, self._shift or ALIGNED)
        since = min(now - self._last, TUNING.longest) if self._last >= 0.0 else TUNING.longest
        self._last = now
        result = []
        for k, name in enumerate(self.names):
            if status[k] == ObjectStatus.UNSEEN:
                continue
            found = measured[k].quality > 0
            # In view, the picture has the say; what the filter makes of it lags behind what is pushed.
            pose = measured[k].pose if found else belief.poses[k]
            R, p = rotations.matrix(pose[None, :4])[0], pose[4:]
            spread, hypotheses = covariance[k], None
            if found:
                R, p, spread, hypotheses = self._settled(k, R, p, measured[k], segments, frame)
            self._followed[k] = found
            fit = assess(self._known[k].model, frame, Poses(R[None], p[None]), self._params.model_points)
            shape, whole = float(min(fit.shape[0], 1.0)), float(np.clip(fit.visible_share[0], 0.0, 1.0))
            sure = self._believed(k, found, shape, whole, since)
            life = ObjectStatus(int(status[k])).name.lower()
            if not found and sure < 0.5:
                life = ObjectStatus.LOST.name.lower()
            visible = whole if found else whole * shape
            only = hypotheses or (PoseHypothesis(R, p, spread, 1.0),)
            result.append(TrackedObject(k, name, life, sure, visible, R, p, spread, only, (), found))
        return result

    def _believed(self, k: int, found: bool, shape: float, whole: float, since: float) -> float:
        """Return how probable an object is after a frame, of which `whole` could be seen, and of that `shape` fits."""
        if found:
            self._odds[k] = np.log(2.0) + (shape - 0.5) / TUNING.doubt
            return float(1.0 - 0.5 * np.exp(-max(shape - 0.5, 0.0) / TUNING.doubt))
        self._odds[k] -= since * (TUNING.missed * whole * (1.0 - shape) + max(self._odds[k], 0.0) / TUNING.forgotten)
        self._odds[k] = float(np.clip(self._odds[k], -20.0, 20.0))
        return float(1.0 / (1.0 + np.exp(-self._odds[k])))

    def _settled(
        self, k: int, R: Array, p: Array, one: PoseMeasurement, segments: Segments, frame: Frame
    ) -> tuple[Array, Array, Array, tuple[PoseHypothesis, ...]]:
        """Return pose, covariance and hypotheses of an object found; tracking goes on from the likeliest."""
        model = self._known[k].model
        own = claimed(model, segments, R, p, TUNING.owned)
        near = claimed(model, segments, R, p, TUNING.around)
        if len(own):
            label = np.bincount(segments.labels[own]).argmax()
            near = near[segments.labels[near] == label]
        points = segments.points_W[near]
        start = RegisteredPose(R, p, one.covariance, one.quality, one.quality, 1.0, float(len(near)))
        axis = R @ self._axes[k]
        free = np.zeros((6, 6))
        free[:3, :3] = object_filter.TUNING.unknown_variance[0] * np.outer(axis, axis)
        if len(points) < TUNING.unknown_points // 4:
            return R, p, one.covariance + free, ()
        new = not self._followed[k]
        after = settle(model, frame, [start], points, self._params, turns=new)
        result = after.registration
        if after.moved:
            self._slots[k] = replace(self._slots[k], R=result.R, p=result.p)
        if new:
            self._rivals[k] = tuple(
                (result.R.T @ other.R, result.R.T @ (other.p - result.p), other.probability)
                for other in after.hypotheses[1:]
                if np.trace(result.R.T @ other.R) < 1.0
            )
        hypotheses = after.hypotheses if new else self._with_rivals(k, after)
        return result.R, result.p, result.covariance + free, hypotheses

    def _with_rivals(self, k: int, after: SettledPose) -> tuple[PoseHypothesis, ...]:
        """Return what a frame allows, and what the object may have been mistaken for when it was found."""
        one, rest = after.registration, 1.0 - sum(probability for _, _, probability in self._rivals[k])
        own = [replace(h, probability=rest * h.probability) for h in after.hypotheses]
        others = [
            PoseHypothesis(one.R @ turn, one.p + one.R @ shift, one.covariance, probability)
            for turn, shift, probability in self._rivals[k]
        ]
        return (*own, *others)

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
                TrackedObject(track, None, "tracked", 1.0, 1.0, np.eye(3), middle, spread, (), tuple(pieces), True)
            )
        return result

    def _number(self, middle: Array, before: list[tuple[int, Array]]) -> int:
        """Return the number of the unknown thing that was nearest, taken out of `before`, or a new one."""
        apart = [float(np.linalg.norm(middle - place)) for _, place in before]
        if apart and min(apart) < TUNING.same:
            return before.pop(int(np.argmin(apart)))[0]
        self._next += 1
        return self._next - 1
