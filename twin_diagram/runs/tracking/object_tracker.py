"""Follows a library's objects, and the unknown things beside them, from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.alternatives import PoseHypothesis, each_once, share_of_first
from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.colour_shift import ColourShift
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.instances import TUNING as INSTANCES
from twin_diagram.perception.registration.instances import Instance
from twin_diagram.perception.registration.light import WHITE, common_tint, in_white, tint_on
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import RegisteredPose, claimed, label_of
from twin_diagram.perception.registration.settling import settle
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.torn_depth import past_what_is_torn
from twin_diagram.perception.registration.turned_alike import TUNING as TURNED
from twin_diagram.perception.registration.turned_alike import probability, turned
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.registration.whole_image import ImageSettings, OtherMemory, introduced
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things.clusters import Placed
from twin_diagram.perception.things.growing import GrowingThing, grown_on, shown
from twin_diagram.perception.things.memory import Life
from twin_diagram.runs.tracking.claimed_share import claimed_share
from twin_diagram.runs.tracking.frame_views import FrameViews
from twin_diagram.runs.tracking.individual import TUNING as BELIEF
from twin_diagram.runs.tracking.individual import Individual, PoseShown, along_the_way, expected
from twin_diagram.runs.tracking.picture_content import PictureContent, as_pictured
from twin_diagram.runs.tracking.room import slots_for
from twin_diagram.runs.tracking.tracked_object import TrackedObject
from twin_diagram.scene import object_filter, object_update
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, ObjectStatus, PoseMeasurement
from twin_diagram.signals.things import FURTHER_MEASUREMENT_SIZE, OWNER_SIZE, things_of


@dataclass(frozen=True)
class Tuning:
    """Constants of what is believed, chosen by hand for objects of a hand's size."""

    owned: float = 0.015
    """Points this near to a known object's surface are its own [m]."""

    least_points: int = 30
    """Fewer points weigh no poses against one another."""

    around: float = 0.025
    """Points this near to an object's surface, in the segment that is its own, should be explained by it [m]."""

    aside: float = 2.0
    """How far off depth colours may lie, RMS, of images 640 wide [px]: as cheap cameras' do, where nothing is told."""

    late: float = 0.5
    """Depth may be so many frames older than its time tells, as `segmentation_system` has it: along its way what moves
    is known no better than that."""

    longest: float = 0.1
    """Of two frames farther apart in time the second says no more [s]: a folder may not tell times."""

    growing: int = 4
    """Unknown things that are followed at a time, where they may become assets: each takes some 10 ms a frame."""


TUNING = Tuning()


class ObjectTracker:
    """Remembers poses from frame to frame, by the twin's own means: alikes and unknown things keep their numbers.

    Args:
        library: assets by name.
        perception: tuning of segmentation; of it the smallest segment.
        grows: unknown things are followed, so that they may become assets: see `growing` and `take_in`.

    Attributes:
        names: of the assets, those that were taken in later after the library's.
        growing: what was seen of unknown things, by identity.
    """

    def __init__(self, library: Mapping[str, Asset], perception: scenario.Perception, grows: bool = False) -> None:
        self.names = tuple(library)
        self._params = scenario.Registration(told_by_shape=True)
        models = [ModelCloud.of(asset, self._params.model_points) for asset in library.values()]
        self._slots = [Slot() for _ in models]
        scene = scenario.SceneUpdater()
        self._told = ImageSettings(
            tuple(Known.of(model) for model in models),
            self._params,
            perception.smallest,
            slots_for(len(models)),
            Life(scene.stale_after, scene.lost_after),
            TUNING.aside,
        )
        self._beside, self._views = OtherMemory.empty(self._told), FrameViews()
        self._settings = object_filter.FilterSettings.of(scene)
        self._first = [self._individual(k, k) for k in range(len(models))]
        self._further: dict[int, Individual] = {}
        """By identity."""
        self._things: dict[int, int] = {}
        """Tracks of unknown things, by identity."""
        self.growing: dict[int, GrowingThing] = {}
        self._grows = grows
        self._tint = WHITE
        """By how much more red and blue than green the light has, as the objects found showed it."""
        self._last, self._seen_any = NEVER, False
        self._next = len(models)

    def before_pictures_of(self, content: PictureContent) -> None:
        """Compare the library's objects with pictures of such content: to be told before the first frame."""
        library = as_pictured(self._told.library, content, self._params.model_points)
        self._told = replace(self._told, library=library)

    def start(self, name: str, R: Array, p: Array, time: float) -> None:
        """Tell where an object is before the first frame: R (3, 3), p (3,) [m] in T; of alikes one after the other.

        One that lies where its like is was told already.
        """
        asset = self.names.index(name)
        slot = Slot(True, R, p, np.zeros(6), time)
        if not self._slots[asset].known:
            self._slots[asset] = slot
            self._first[asset].followed = True
            return
        alikes = [
            self._slots[asset],
            *(one.slot for one in self._beside.further if one.identity and one.asset == asset),
        ]
        least = INSTANCES.same_place * self._told.library[asset].model.radius
        free = next((k for k, one in enumerate(self._beside.further) if not one.identity), None)
        if free is None or min(float(np.linalg.norm(one.p - p)) for one in alikes) < least:
            return
        identity, thing = self._beside.identities
        further = list(self._beside.further)
        further[free] = Instance(identity, asset, NEVER, slot)
        self._beside = replace(self._beside, further=tuple(further), identities=(identity + 1, thing))
        self._further[identity] = self._individual(self._numbered(), asset)
        self._further[identity].followed = True

    def take_in(self, identity: int, name: str, asset: Asset, R_TO: Array, p_TO: Array) -> None:
        """Go on with an unknown thing as an asset; it keeps its track.

        Args:
            identity: of the thing, among `growing`.
            name: of the asset.
            asset: it.
            R_TO: (3, 3) of it in the thing's frame.
            p_TO: (3,) [m].

        Raises:
            TwinError: no slot is free; all stays as it was.
        """
        thing = self.growing[identity]
        R, p = thing.placed(R_TO, p_TO, thing.slot.seen)
        number = len(self._told.every)
        slot = replace(thing.slot, R=R, p=p, velocity=np.zeros(6))
        self._beside = introduced(self._beside, number, slot)
        own = next(one.identity for one in self._beside.further if one.own and one.asset == number)
        known = Known.of(ModelCloud.of(asset, self._params.model_points))
        self._told = replace(self._told, added=(*self._told.added, known))
        self.names = (*self.names, name)
        track = self._things.get(identity)
        self._further[own] = self._individual(self._numbered() if track is None else track, number)
        self._further[own].followed = True
        del self.growing[identity]

    def observe(self, segments: Segments) -> list[TrackedObject]:
        """Return what is known of all objects after a frame; those never seen are left out.

        Where the first one tells of a coloured light, it is looked at anew without: things were taken for others in it.
        """
        if self._seen_any:
            return self._observed(segments)
        before = deepcopy({name: value for name, value in vars(self).items() if name != "_told"})
        found = self._observed(segments)
        if not self._tint.any():
            return found
        vars(self).update(before | {"_tint": self._tint})
        return self._observed(segments)

    def _observed(self, segments: Segments) -> list[TrackedObject]:
        """Look at a frame, in white light as far as it is known."""
        if not self._seen_any:
            aside = TUNING.aside * segments.camera.width / 640
            self._beside = replace(self._beside, shift=ColourShift.told(aside))
            self._seen_any = True
        segments = in_white(segments, self._tint)
        after = self._views.advance(self._slots, self._beside, segments, self._told)
        self._slots, self._beside = after.slots, after.beside
        rows = after.further.reshape(-1, FURTHER_MEASUREMENT_SIZE)
        further = {int(row[0]): PoseMeasurement.unpack(row[OWNER_SIZE:]) for row in rows if row[0] > 0}
        held = {one.identity: one.asset for one in self._beside.further if one.identity}
        before = self._further
        self._further = {i: before.get(i) or self._individual(self._numbered(), asset) for i, asset in held.items()}
        pairs = [*zip(self._first, after.poses, strict=True), *((self._further[i], further[i]) for i in held)]
        frame = Frame.of(segments, self._beside.shift)
        views = [
            self._seen(one, measured, View(segments, frame, self._params, self._told.smallest))
            for one, measured in pairs
        ]
        settled = [
            self._settled(one, measured, view) if measured.quality > 0 else None
            for (one, measured), view in zip(pairs, views, strict=True)
        ]
        for (one, measured), found in zip(pairs, settled, strict=True):
            if found is not None:
                told, symmetric = found.told(measured), bool(self._axis(one)[2])
                one.filter = object_update.update(one.filter, told, segments.time, self._settings, symmetric)
        at = [(one, shown) for (one, _), shown in zip(pairs, settled, strict=True) if shown is not None]
        tints = [tint_on(self._told.every[one.asset].model, frame, shown.R, shown.p) for one, shown in at]
        self._tint = self._tint + common_tint([tint for tint in tints if tint is not None])
        if self._grows:
            self._grow(segments, after.things, pairs)
        individuals = [one for one, _ in pairs]
        return [*self._objects(views, individuals, settled), *self._unknown(after.things, segments)]

    def _grow(self, segments: Segments, things: Array, pairs: Sequence[tuple[Individual, PoseMeasurement]]) -> None:
        """Follow unknown things by what was seen of them."""
        known: list[Placed] = []
        for one, measured in pairs:
            if measured.quality > 0:
                R, p = rotations.matrix(measured.pose[None, :4])[0], measured.pose[4:]
                known.append((self._told.every[one.asset].model, R, p))
        standing = things_of(things)
        there = {thing.identity for thing in standing if thing.stands}
        before = {identity: one for identity, one in self.growing.items() if identity in there}
        view = View(segments, Frame.of(segments, self._beside.shift), self._params, self._told.smallest)
        self.growing = grown_on(before, shown(standing, segments, known), view, TUNING.growing)

    def _individual(self, track: int, asset: int) -> Individual:
        return Individual(track, asset, object_filter.initial_filters(1)[0])

    def _numbered(self) -> int:
        self._next += 1
        return self._next - 1

    def _objects(
        self, views: Sequence[View], individuals: Sequence[Individual], settled: Sequence[PoseShown | None]
    ) -> list[TrackedObject]:
        """Return the objects that were seen at some time; `settled` those that this frame shows, each in its view."""
        if not individuals:
            return []
        now = views[0].segments.time
        filters = np.stack([one.filter for one in individuals])
        axes = np.stack([self._axis(one) for one in individuals])
        belief = object_filter.propagate(filters, now, self._settings)
        status = object_filter.statuses(filters, now, self._settings)
        covariance = object_filter.pose_covariances(belief, axes, self._settings)
        since = min(now - self._last, TUNING.longest) if self._last >= 0.0 else TUNING.longest
        self._last = now
        result = []
        for k, (one, found, view) in enumerate(zip(individuals, settled, views, strict=True)):
            one.followed = found is not None
            if status[k] == ObjectStatus.UNSEEN:
                continue
            slot = self._slot_of(one)
            # In view, the picture has the say; what the filter makes of it lags behind what is pushed.
            shown = found or expected(slot, one.filter, belief.poses[k], covariance[k], now)
            R, p = shown.R, shown.p
            model = self._model(one)
            at = Poses(R[None], p[None])
            fit = assess(model, view.frame, at, self._params.model_points)
            shape, whole = float(min(fit.shape[0], 1.0)), float(np.clip(fit.visible_share[0], 0.0, 1.0))
            usual = slot.alike if found is not None else 0.0
            fits = min(shape, float(fit.likeness[0]) / (BELIEF.alike * usual)) if usual > 0.0 else shape
            speed = float(np.linalg.norm(slot.velocity[3:]))
            there = one.believed(found is not None, fits, whole, since, slot.aloft, speed)
            about = tuple(pair for pair in self._symmetries(one) if not pair[1])
            possible = each_once(shown.hypotheses, about)
            posed = one.posed
            if possible:
                one.posed = share_of_first(possible, self._symmetries(one))
                posed = one.posed
                if not slot.aloft:  # in the air, what fits in many ways may be a part of what carries things
                    posed = claimed_share(possible, shown.spread, model.radius, self._symmetries(one))
            named = one.named(slot.named, model, view.frame, at if found is not None else None)
            sure = there * named * min(posed, probability(slot.odds))
            life = ObjectStatus(int(status[k])).name.lower()
            if found is None and there < 0.5:
                life = ObjectStatus.LOST.name.lower()
            if found is not None and status[k] == ObjectStatus.STALE:
                life = ObjectStatus.TRACKED.name.lower()  # to the filter the first pose elsewhere is an outlier
            visible = whole if found is not None else whole * shape
            only = possible or (PoseHypothesis(R, p, shown.spread, 1.0),)
            name = self.names[one.asset]
            free = tuple(sorted({axis for axis, _ in about}))
            how = (found is not None, named, slot.by_shape, free)
            spread = shown.spread if found is None else along_the_way(shown.spread, slot.velocity, TUNING.late * since)
            result.append(TrackedObject(one.track, name, life, sure, visible, R, p, spread, only, (), *how))
        return result

    def _seen(self, one: Individual, measured: PoseMeasurement, view: View) -> View:
        """Return a frame as it shows an object that was found: past what its surface tears of depth."""
        R, p = rotations.matrix(measured.pose[None, :4])[0], measured.pose[4:]
        return past_what_is_torn(self._model(one), view, R, p) if measured.quality > 0 else view

    def _settled(self, one: Individual, measured: PoseMeasurement, view: View) -> PoseShown:
        """Return the likeliest pose of an object found, near where tracking found it; tracking goes on from there."""
        R, p = rotations.matrix(measured.pose[None, :4])[0], measured.pose[4:]
        model, segments, frame = self._model(one), view.segments, view.frame
        own = claimed(model, segments, R, p, TUNING.owned)
        near = claimed(model, segments, R, p, TUNING.around)
        if len(own):
            near = near[segments.labels[near] == label_of(segments, own)]
        points = segments.points_W[near]
        start = RegisteredPose(R, p, measured.covariance, measured.quality, measured.quality, 1.0, float(len(near)))
        axis = R @ self._axis(one)
        free = np.zeros((6, 6))
        free[:3, :3] = object_filter.TUNING.unknown_variance[0] * np.outer(axis, axis)
        if len(points) < TUNING.least_points:
            return PoseShown(R, p, measured.covariance + free, ())
        new = not one.followed
        after = settle(model, frame, [start], points, self._params, turns=new)
        result = after.registration
        if after.moved:
            self._go_on_from(one, result.R, result.p)
        if new:
            one.rivals = tuple(
                (result.R.T @ other.R, result.R.T @ (other.p - result.p), other.probability)
                for other in after.hypotheses[1:]
                if np.trace(result.R.T @ other.R) < 1.0
            )
        slot = self._slot_of(one)
        if slot.by_shape:
            one.rivals = tuple((turn, model.middle - turn @ model.middle, 1.0) for turn in model.mistaken)
        hypotheses = after.hypotheses if new and not slot.by_shape else one.with_rivals(after, probability(slot.odds))
        return PoseShown(result.R, result.p, result.covariance + free, hypotheses)

    def _model(self, one: Individual) -> ModelCloud:
        """Return what an object is compared with: its model without colours, where shape alone tells it."""
        known = self._told.every[one.asset]
        return known.bare.model if self._slot_of(one).by_shape else known.model

    def _axis(self, one: Individual) -> Array:
        """Return the axis in O about which no turn is told; 0 where there is none."""
        return np.array([0.0, 0.0, float(self._model(one).asset.symmetric_axis == "z")])

    def _symmetries(self, one: Individual) -> tuple[tuple[int, int], ...]:
        """Return the turns of an object that do not count, about axes of O; see `assets.symmetry`."""
        asset = self._model(one).asset
        return (*asset.symmetries, (2, 0)) if asset.symmetric_axis == "z" else asset.symmetries

    def _slot_of(self, one: Individual) -> Slot:
        """Return what tracking remembers of an object."""
        if one.asset < len(self._first) and one is self._first[one.asset]:
            return self._slots[one.asset]
        identity = next(i for i, other in self._further.items() if other is one)
        return next(each.slot for each in self._beside.further if each.identity == identity)

    def _go_on_from(self, one: Individual, R: Array, p: Array) -> None:
        """Track an object from another pose on than the one that tracking found."""

        def moved(slot: Slot) -> Slot:
            turns = 0 if slot.by_shape else len(self._told.every[one.asset].model.mistaken)
            doubted = turns and turned(R, slot.R) > TURNED.other
            return replace(slot, R=R, p=p, odds=0.0 if doubted else slot.odds)

        if one.asset < len(self._first) and one is self._first[one.asset]:
            self._slots[one.asset] = moved(self._slots[one.asset])
            return
        identity = next(i for i, other in self._further.items() if other is one)
        further = tuple(
            replace(each, slot=moved(each.slot)) if each.identity == identity else each for each in self._beside.further
        )
        self._beside = replace(self._beside, further=further)

    def _unknown(self, things: Array, segments: Segments) -> list[TrackedObject]:
        """Return what stands there, or did when it was last seen, and is none of the objects, as convex pieces."""
        result = []
        for thing in things_of(things):
            if not thing.identity or thing.status == ObjectStatus.GONE or not thing.pieces:
                continue
            track = self._things.get(thing.identity)
            if track is None:
                track = self._things[thing.identity] = self._numbered()
            seen = thing.last_seen >= segments.time
            once = thing.status == ObjectStatus.UNSEEN
            status = (ObjectStatus.TRACKED if once else thing.status).name.lower()
            extent = np.concatenate(thing.pieces)
            spread = np.diag([*object_filter.TUNING.unknown_variance[:3], *np.maximum(np.var(extent, axis=0), 1e-8)])
            sure, shown = 0.5 if once else 1.0, 1.0 if seen else 0.0
            place = (np.eye(3), thing.middle, spread, ())
            result.append(TrackedObject(track, None, status, sure, shown, *place, thing.pieces, seen))
        return result
