"""The system that finds and follows the known objects through several cameras."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, cast

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.errors import TwinError
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.pose_system import TUNING as ONE_CAMERA
from twin_diagram.perception.registration.pose_system import NewestLook
from twin_diagram.perception.registration.rotation import from_quaternion
from twin_diagram.perception.registration.slots import Slot, measurement
from twin_diagram.perception.registration.view import Known
from twin_diagram.perception.registration.whole_image import ImageSettings, OtherMemory, advance, introduced
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.several_views.fusion import FusedPose, SeenBy, fuse
from twin_diagram.perception.several_views.view_memory import (
    ViewMemory,
    all_sides,
    contradicted,
    entering,
    forgotten,
    left,
)
from twin_diagram.perception.things.memory import Life
from twin_diagram.runtime.timing import timed
from twin_diagram.scenario.lenses import calibration_error
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import CALIBRATION_SIZE, RESTS_SIZE, SIZE, pose_shifts, shared_covariances
from twin_diagram.signals.layouts import MEASUREMENT_SIZE, NEVER, PoseMeasurement
from twin_diagram.signals.things import FURTHER_MEASUREMENT_SIZE, OWNER_SIZE, THING_SIZE, Thing


class SeveralCamerasEstimator(LeafSystem):
    """Poses of the library's objects from the images of several cameras, which share one set of slots.

    .. pydrake_system::

        name: SeveralCamerasEstimator
        input_ports:
        - <camera>.segments
        - <camera>.calibration (optional)
        output_ports:
        - object_poses
        - further_poses
        - things
        - turned_away
        - rests

    Ports:
        <camera>.segments: (`Segments`) of that camera's newest image.
        <camera>.calibration: (10 + 100) of that camera, see `signals.calibration_error`. Not connected: as told.
        object_poses, further_poses, things, turned_away: as of `IcpPoseEstimator`, from all cameras together: the time
            is that of the newest image. Found by one camera an object is there; not found by one that cannot see its
            place says nothing; seen to be empty by one, it is.
        rests: ((K + F) · RESTS_SIZE) of each object and further instance what is left of the calibrations (6 × 6), and
            the sum of the shifts (6: turn, then translation) by which calibrations were corrected since the start.

    Each camera's image is taken in when it comes, at k / rate + latency + 1 ms of that camera; of images that come at
    one time, in the cameras' order. All memory is discrete vector state.
    """

    def __init__(
        self,
        library: Mapping[str, Asset],
        cameras: Mapping[str, scenario.Camera],
        twin: scenario.Twin,
    ) -> None:
        """Build the system.

        Args:
            library: assets by the object's name.
            cameras: through which the twin looks, by name.
            twin: of it `registration`, `perception`, `slots` and `scene`.
        """
        super().__init__()
        self.names: Final = tuple(library)
        """The objects, in the order of `object_poses`."""
        self._params: Final = twin.registration
        self._added: Final[list[Known]] = []
        life = Life(twin.scene.stale_after, twin.scene.lost_after)
        known = tuple(Known.of(ModelCloud.of(asset, twin.registration.model_points)) for asset in library.values())
        self._told: Final = ImageSettings(known, twin.registration, twin.perception.smallest, twin.slots, life)
        self._cameras: Final = tuple(cameras.values())
        self._pinholes: Final = tuple(Pinhole.from_scenario(camera).straight for camera in self._cameras)
        self._rows: Final = len(library) + self._told.further
        self._segments, self._calibrations = [], []
        for name, straight in zip(cameras, self._pinholes, strict=True):
            none = Segments.empty(straight, twin.perception.stride, twin.perception.table_height)
            self._segments.append(self.DeclareAbstractInputPort(f"{name}.segments", AbstractValue.Make(none)))
            self._calibrations.append(self.DeclareVectorInputPort(f"{name}.calibration", CALIBRATION_SIZE))
        self._declare()

    def _declare(self) -> None:
        """Declare memory, outputs and the cameras' updates."""
        told, count = self._told, len(self.names)
        start = OtherMemory.empty(told)
        never = np.concatenate([measurement(Slot(), None, NEVER).pack()] * self._rows or [np.zeros(0)])
        self._beside = self.DeclareDiscreteState(cast(Any, start.pack()))
        self._views, self._measured, self._corrected = [], [], []
        for camera in self._cameras:
            view = ViewMemory.empty(told, camera.colour_std)
            self._views.append(self.DeclareDiscreteState(cast(Any, view.pack())))
            self._measured.append(self.DeclareDiscreteState(cast(Any, never)))
            variances = calibration_error(camera).variances
            self._corrected.append(
                self.DeclareDiscreteState(cast(Any, np.r_[np.zeros(SIZE), np.diag(variances).ravel()]))
            )
        sizes = {
            "object_poses": count * MEASUREMENT_SIZE,
            "further_poses": told.further * FURTHER_MEASUREMENT_SIZE,
            "things": told.slots.unknown * THING_SIZE,
            "turned_away": 2,
            "rests": self._rows * RESTS_SIZE,
        }
        self._out = {name: self.DeclareDiscreteState(cast(Any, np.zeros(size))) for name, size in sizes.items()}
        self._first = self.DeclareDiscreteState(cast(Any, never[: count * MEASUREMENT_SIZE]))
        self._out["object_poses"] = self._first
        self._newest = self.DeclareDiscreteState(cast(Any, np.array([NEVER, 0.0])))
        for name, size in sizes.items():
            state = self._out[name]

            def calc(context: Context, output: BasicVector, state: Any = state) -> None:
                output.SetFromVector(context.get_discrete_state(int(state)).value())

            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={self.discrete_state_ticket(state)})
        for v, camera in enumerate(self._cameras):

            def update(context: Context, discrete: DiscreteValues, v: int = v) -> None:
                self._update(context, discrete, v)

            self.DeclarePeriodicDiscreteUpdateEvent(
                1.0 / camera.rate, camera.latency + ONE_CAMERA.after_delivery, update
            )

    # Assets that come later, and growing: as of `IcpPoseEstimator`.

    def check_slots(self) -> None:
        """Refuse, with a TwinError, assets that come later where there are no slots for them at all."""
        if not self._told.further:
            raise TwinError("the twin has no slots for further objects: twin.slots.instances leaves none")

    def add_asset(self, asset: Asset) -> int:
        """Take in an asset that came later; answer its number, which follows the library's. No Context uses it yet."""
        self._added.append(Known.of(ModelCloud.of(asset, self._params.model_points)))
        return len(self._told.library) + len(self._added) - 1

    def use_asset(self, context: Context, number: int, pose: Array | None = None) -> None:
        """Look for an asset that was added from the next image on, and follow it, in this Context.

        Args:
            context: this system's own, at rest: between two steps of a simulator.
            number: as `add_asset` gave it.
            pose: (7) X_WO now, where that is known; None: it is searched for.

        Raises:
            IndexError: there is no such asset.
            TwinError: no slot is free.
        """
        if not 0 <= number - len(self._told.library) < len(self._added):
            raise IndexError(f"asset {number}: {len(self._added)} were added, from {len(self._told.library)} on")
        slot = Slot()
        if pose is not None:
            slot = Slot(True, from_quaternion(pose[:4]), np.array(pose[4:]), np.zeros(6), context.get_time())
        before = self._other(context.get_discrete_state(int(self._beside)).value())
        after = introduced(before, number, slot)
        context.get_mutable_discrete_state(int(self._beside)).SetFromVector(cast(Any, after.pack()))
        new = [k for k, one in enumerate(after.further) if one.identity != before.further[k].identity]
        for state in self._views:
            view = ViewMemory.unpack(np.asarray(context.get_discrete_state(int(state)).value()), self._told)
            slots, identities = list(view.slots), list(view.identities)
            for k in new:
                slots[len(self._told.library) + k], identities[k] = slot, after.further[k].identity
            view = replace(view, slots=tuple(slots), identities=tuple(identities))
            context.get_mutable_discrete_state(int(state)).SetFromVector(cast(Any, view.pack()))

    def own_slots(self, context: Context) -> dict[int, int]:
        """Return the numbers of the added assets that a Context uses, by the identity of the first instance of each."""
        beside = self._other(context.get_discrete_state(int(self._beside)).value())
        return {one.identity: one.asset for one in beside.further if one.identity and one.own}

    def looked_at(self, context: Context) -> float:
        """Return when the newest image that was looked at was taken [s]; `context` is this system's."""
        return float(context.get_discrete_state(int(self._newest)).value()[0])

    def segments(self, context: Context) -> Segments:
        """Return the newest image that was looked at, taken apart; `context` is this system's."""
        which = int(context.get_discrete_state(int(self._newest)).value()[1])
        return cast(Segments, self._segments[which].Eval(context))

    def looked(self, context: Context) -> NewestLook:
        """Return what the newest image showed; `context` is this system's."""
        which = int(context.get_discrete_state(int(self._newest)).value()[1])
        view = ViewMemory.unpack(np.asarray(context.get_discrete_state(int(self._views[which])).value()), self._told)
        beside = self._other(context.get_discrete_state(int(self._beside)).value())
        rows = np.asarray(context.get_discrete_state(int(self._measured[which])).value()).reshape(self._rows, -1)
        every = self._known(beside)
        known = [
            (every[k].model, from_quaternion(row[2:6]), np.array(row[6:9])) for k, row in enumerate(rows) if row[0] > 0
        ]
        return NewestLook(self.looked_at(context), known, view.shift, self._params, self._told.smallest)

    # Details.

    def _other(self, vector: Any) -> OtherMemory:
        return OtherMemory.unpack(np.asarray(vector), self._told)

    def _known(self, beside: OtherMemory) -> list[Known]:
        """Return what is in each slot; what is in free ones does not count."""
        every = (*self._told.library, *self._added)
        return [*self._told.library, *(every[one.asset] for one in beside.further)] if every else []

    @timed("IcpPoseEstimator")
    def _update(self, context: Context, discrete: DiscreteValues, v: int) -> None:
        """Take camera v's newest image in; what cameras before it wrote at this very time is there already."""
        segments = cast(Segments, self._segments[v].Eval(context))

        def now(state: Any) -> Array:
            return np.array(discrete.get_vector(int(state)).value())

        def keep(state: Any, vector: Array) -> None:
            discrete.get_mutable_vector(int(state)).SetFromVector(cast(Any, vector))

        views = [ViewMemory.unpack(now(state), self._told) for state in self._views]
        # The same image again says nothing new.
        if segments.time < 0.0 or segments.time <= views[v].time:
            return
        told = replace(self._told, added=tuple(self._added))
        entry = entering(views, v, self._other(now(self._beside)), told, segments.time)
        after = advance(entry.slots, entry.beside, segments, told, entry.elsewhere)
        views[v], beside = left(views[v], entry.beside, after.slots, after.beside, segments.time)
        measured = [now(state).reshape(self._rows, MEASUREMENT_SIZE) for state in self._measured]
        further = after.further.reshape(-1, FURTHER_MEASUREMENT_SIZE)[:, OWNER_SIZE:]
        first = np.array([one.pack() for one in after.poses]).reshape(-1, MEASUREMENT_SIZE)
        measured[v] = np.concatenate([first, further])
        for other, k in contradicted(views, v, segments, self._known(beside)):
            views[other] = forgotten(views[other], k)
            measured[other][k, 0] = 0.0
        corrected = [now(state) for state in self._corrected]
        before = corrected[v][:SIZE]
        if self._calibrations[v].HasValue(context):
            corrected[v] = np.array(self._calibrations[v].Eval(context))
        fused = self._fused(views, beside, measured, corrected)
        change = corrected[v][:SIZE] - before
        keep(self._out["rests"], self._rested(now(self._out["rests"]), fused, v, change))
        keep(self._beside, beside.pack())
        for w in range(len(views)):
            keep(self._views[w], views[w].pack())
            keep(self._measured[w], measured[w].ravel())
        keep(self._corrected[v], corrected[v])
        keep(self._newest, np.array([segments.time, float(v)]))
        self._tell(keep, fused, beside, all_sides(views, beside.things))

    def _tell(self, keep: Any, fused: list[FusedPose], beside: OtherMemory, things: list[Thing]) -> None:
        """Set what goes out."""
        count = len(self.names)
        if count:
            keep(self._first, np.concatenate([one.measured.pack() for one in fused[:count]]))
        rows = np.zeros((self._told.further, FURTHER_MEASUREMENT_SIZE))
        for row, instance, one in zip(rows, beside.further, fused[count:], strict=True):
            if instance.identity:
                row[:] = [instance.identity, instance.asset, *one.measured.pack()]
        keep(self._out["further_poses"], rows.ravel())
        if things:
            keep(self._out["things"], np.concatenate([one.pack() for one in things]))
        keep(self._out["turned_away"], np.array(beside.turned_away, dtype=float))

    def _fused(
        self, views: list[ViewMemory], beside: OtherMemory, measured: list[Array], corrected: list[Array]
    ) -> list[FusedPose]:
        """Return what the cameras show together of each object and further instance."""
        rests = [self._left_over(v, measured[v], corrected[v]) for v in range(len(views))]
        known, result = self._known(beside), []
        identities = [0] * len(self.names) + [one.identity for one in beside.further]
        for k in range(self._rows):
            seen = []
            for v, view in enumerate(views):
                one = PoseMeasurement.unpack(measured[v][k])
                own = k < len(self.names) or view.identities[k - len(self.names)] == identities[k]
                if not own:  # the slot changed hands since this camera's image
                    one = replace(one, quality=0.0, time=NEVER)
                slot = view.slots[k]
                seen.append(SeenBy(one, rests[v][k], slot.velocity, slot.odds, 1.0 / self._cameras[v].rate))
            symmetric = bool(known) and known[k].model.asset.symmetric_axis == "z"
            result.append(fuse(seen, symmetric))
        return result

    def _sight(self, v: int, places: Array) -> tuple[Array, Array, float, float]:
        """Return where places (R, 3) are in a camera's frame, its axes in W and its focal lengths."""
        pinhole = self._pinholes[v]
        return (places - pinhole.p_WC) @ pinhole.R_WC, pinhole.R_WC, pinhole.fx, pinhole.fy

    def _left_over(self, v: int, measured: Array, corrected: Array) -> Array:
        """Return (R, 6, 6) what is left of a camera's calibration in what it measured (R, MEASUREMENT_SIZE)."""
        covariance = corrected[SIZE:].reshape(SIZE, SIZE)
        if not covariance.any():
            return np.zeros((self._rows, 6, 6))
        return shared_covariances(covariance, *self._sight(v, measured[:, 6:9]))

    def _rested(self, vector: Array, fused: list[FusedPose], v: int, change: Array) -> Array:
        """Return what port `rests` says after an image of camera v, the calibration corrected by a change (10)."""
        rows = vector.reshape(self._rows, RESTS_SIZE).copy()
        for row, one in zip(rows, fused, strict=True):
            if one.rest is not None:
                row[:36] = one.rest.ravel()
        if change.any() and len(fused):
            places = np.array([one.measured.pose[4:] for one in fused])
            shifts = -pose_shifts(*self._sight(v, places)) @ change
            rows[:, 36:] += np.einsum("rij,rj->ri", np.array([one.weights[v] for one in fused]), shifts)
        return np.asarray(rows.ravel())
