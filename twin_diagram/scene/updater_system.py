"""Keeps the twin's scene in step with what is seen."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, Final, cast

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from twin_diagram import scenario
from twin_diagram.runtime import timing
from twin_diagram.scenario.lenses import calibration_error, colour_lens
from twin_diagram.scenario.poses import pose
from twin_diagram.scene import object_events, object_filter, object_life, object_update
from twin_diagram.scene.object_filter import FilterLayout
from twin_diagram.scene.object_life import LifeLayout
from twin_diagram.scene.taken_over import LinearMotion, motion_before
from twin_diagram.scene.twin_scene import TwinScene, parked_poses
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import (
    CALIBRATION_SIZE,
    RESTS_SIZE,
    SIZE,
    CalibrationError,
    pose_shifts,
    shared_covariances,
)
from twin_diagram.signals.hand import HAND_SIZE, NOTHING, Hand
from twin_diagram.signals.layouts import MEASUREMENT_SIZE, NEVER, TRACK_SIZE, ObjectStatus, PoseMeasurement
from twin_diagram.signals.lens import Lens
from twin_diagram.signals.things import (
    FURTHER_MEASUREMENT_SIZE,
    FURTHER_TRACK_SIZE,
    OWNER_SIZE,
    THING_SIZE,
    carried,
    things_of,
)


class SceneGraphUpdater(LeafSystem):
    """Filters the objects' measured poses and writes them, with the arm's, into the positions of the twin's plant.

    .. pydrake_system::

        name: SceneGraphUpdater
        input_ports:
        - object_poses
        - arm_state
        - image_time
        - gripper_state (optional)
        - further_poses (optional)
        - things (optional)
        - calibration (optional)
        - rests (optional)
        - hand (optional)
        output_ports:
        - positions
        - tracks
        - further_tracks
        - things
        - object_events

    Ports:
        object_poses: (K · MEASUREMENT_SIZE) a `layouts.PoseMeasurement` per library object, in the library's order.
        arm_state: (2n) joint angles [rad] and speeds of the arm.
        image_time: (1) capture time of the newest image [s], `NEVER` before the first. Measurements are not used before
            the first image.
        gripper_state: (2g) finger positions [m] and speeds; the fingers stay as described where it is not connected.
        further_poses: (F · FURTHER_MEASUREMENT_SIZE) of further instances of the objects; see `signals.things`.
        things: (T · THING_SIZE) of unknown things, as images showed them; out: at the present time, see
            `signals.things.carried`.
        calibration: (10 + 100) errors of the camera's calibration that are taken out of what it shows, and their
            covariance; see `signals.calibration_error`. Not connected: none are, and what is told of them counts.
        rests: ((K + F) · RESTS_SIZE) the same where several cameras see the objects: of each what is left (6 × 6) and
            the sum of the shifts (6) by which corrections have moved it. It then stands for `calibration`.
        hand: (HAND_SIZE) what the hand holds is held, whatever images show; let go, it rests where the hand left it.
            See `signals.hand`. Not connected: what goes along with the tool is taken for held.
        positions: (nq) of `TwinScene.plant` at the present time; objects not yet seen, and those that are gone, wait
            out of sight.
        tracks: (K · TRACK_SIZE) a `layouts.Track` per library object, at the present time.
        further_tracks: (F · FURTHER_TRACK_SIZE) the same of further instances, with whose they are.
        object_events: (RING · EVENT_FIELDS) the newest events, oldest first; see `scene.object_events`. Rows count the
            library's objects, then further instances, then unknown things.

    Rate: measurements are taken in at `scene.rate` [1/s]. Latency: a measurement waits for the next tick and counts for
    its capture time; what comes out is predicted to the moment at which it is asked for.

    State: per object and further instance a filter (see `scene.object_update`) and a life (`scene.object_life`), in
    discrete vectors; then what was last seen of each row, and the events.
    """

    def __init__(
        self,
        scene: TwinScene,
        params: scenario.SceneUpdater,
        camera: scenario.Camera | None = None,
        forget_after: float = scenario.Slots().forget_after,
    ) -> None:
        """Size the ports for a scene.

        Args:
            scene: says which position belongs to what.
            params: tuning.
            camera: that sees the objects; None, or one with an exact calibration, adds nothing to covariances.
            forget_after: an object whose place has been empty for so long is removed [s].
        """
        super().__init__()
        self.set_name("scene_graph_updater")
        self._tuning: Final = object_filter.FilterSettings.of(params)
        self._scene: Final = scene
        self._camera: Final = camera
        self._doubt: Final = calibration_error(camera) if camera is not None else CalibrationError()
        self._count: Final = len(scene.object_names)
        self._further: Final = len(scene.slots.further)
        self._things: Final = len(scene.slots.things)
        self._parked: Final = parked_poses(self._count + self._further)
        self._forget_after: Final = forget_after
        plant = scene.plant
        self._arm_velocity_index: Final = np.array(
            [plant.get_joint(index).velocity_start() for index in scene.arm.joint_indices], dtype=int
        )
        self._kinematics: Final = scene.plant.CreateDefaultContext()
        """Overwritten before each use."""
        self._declare(params)

    def _declare(self, params: scenario.SceneUpdater) -> None:
        """Declare ports, state and the tick."""
        scene = self._scene
        n, g = len(scene.arm_position_index), len(scene.gripper_position_index)
        self._poses_in = self.DeclareVectorInputPort("object_poses", self._count * MEASUREMENT_SIZE)
        self._arm_in = self.DeclareVectorInputPort("arm_state", 2 * n)
        self._image_time_in = self.DeclareVectorInputPort("image_time", 1)
        self._gripper_in = self.DeclareVectorInputPort("gripper_state", 2 * g)
        self._further_in = self.DeclareVectorInputPort("further_poses", self._further * FURTHER_MEASUREMENT_SIZE)
        self._things_in = self.DeclareVectorInputPort("things", self._things * THING_SIZE)
        self._calibration_in = self.DeclareVectorInputPort("calibration", CALIBRATION_SIZE)
        self._hand_in = self.DeclareVectorInputPort("hand", HAND_SIZE)
        rows = self._count + self._further
        self._rests_in = self.DeclareVectorInputPort("rests", rows * RESTS_SIZE)
        self._filters = self.DeclareDiscreteState(cast(Any, object_filter.initial_filters(rows).ravel()))
        names = np.r_[np.arange(1.0, self._count + 1.0), np.zeros(self._further)]
        self._lives = self.DeclareDiscreteState(cast(Any, object_life.initial_lives(names).ravel()))
        self._assets = self.DeclareDiscreteState(cast(Any, np.r_[np.arange(self._count), np.zeros(self._further)]))
        self._looked = self.DeclareDiscreteState(cast(Any, np.zeros(3 * (rows + self._things))))
        told = np.r_[np.zeros(SIZE), np.diag(self._doubt.variances).ravel()]
        self._corrected = self.DeclareDiscreteState(cast(Any, told))
        self._rests = self.DeclareDiscreteState(cast(Any, np.zeros(rows * RESTS_SIZE)))
        self._events = self.DeclareDiscreteState(cast(Any, object_events.empty_ring()))
        self._grip = self.DeclareDiscreteState(cast(Any, Hand().pack()))
        now = {self.time_ticket(), self.xd_ticket()}
        joints = {self.input_port_ticket(port.get_index()) for port in (self._arm_in, self._gripper_in)}
        self.DeclareVectorOutputPort("positions", scene.plant.num_positions(), self._calc_positions, now | joints)
        size = self._count * TRACK_SIZE
        self._tracks_out = self.DeclareVectorOutputPort("tracks", size, self._calc_tracks, now)
        size = self._further * FURTHER_TRACK_SIZE
        self.DeclareVectorOutputPort("further_tracks", size, self._calc_further, now)
        told = {self.time_ticket(), self.input_port_ticket(self._things_in.get_index())}
        self.DeclareVectorOutputPort("things", self._things * THING_SIZE, self._calc_things, told)
        self.DeclareVectorOutputPort(
            "object_events", object_events.RING * object_events.EVENT_FIELDS, self._calc_events, {self.xd_ticket()}
        )
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / params.rate, 0.0, self._tick)

    @timing.timed("SceneGraphUpdater")
    def _tick(self, context: Context, discrete: DiscreteValues) -> None:
        if float(cast(Array, self._image_time_in.Eval(context))[0]) == NEVER:
            return
        filters, lives, assets = self._filters_of(context), self._lives_of(context), self._assets_of(context)
        measured, whose = self._measured(context)
        filters, lives, assets, now = filters.copy(), lives.copy(), assets.copy(), context.get_time()
        filters = self._follow_calibration(context, discrete, filters)
        # A slot that changed hands begins anew.
        for k in np.flatnonzero(whose[:, 0] != lives[:, LifeLayout.IDENTITY]):
            if k >= self._count:
                filters[k], lives[k] = object_filter.initial_filters(1)[0], object_life.initial_lives(whose[k, :1])[0]
                assets[k] = whose[k, 1]
        used = np.maximum(filters[:, FilterLayout.LAST_SEEN], filters[:, FilterLayout.REMEMBERED_TIME])
        fresh = np.flatnonzero((measured[:, 0] > 0) & (measured[:, 1] > used))
        hand = Hand.unpack(np.array(self._hand_in.Eval(context))) if self._hand_in.HasValue(context) else None
        gripped = hand is not None and hand.held != NOTHING
        tool = self._tool(context) if fresh.size or gripped or lives[:, LifeLayout.HELD].any() else None
        for k in fresh:
            measurement, kind = PoseMeasurement.unpack(measured[k]), int(assets[k])
            if lives[k, LifeLayout.GONE_SINCE] >= 0.0 and object_update.usable(measurement, NEVER, now):
                filters[k] = object_filter.initial_filters(1)[0]  # it is back, wherever it was
            symmetric = bool(self._scene.kinds[kind].axis[2] != 0)
            anew = object_update.begins_anew(filters[k], measurement.time, self._tuning)
            before = self._before(context, measurement, self._scene.kinds[kind].radius) if anew else None
            filters[k] = object_update.update(filters[k], measurement, now, self._tuning, symmetric, before)
            if tool is not None and hand is None:
                lives[k] = object_life.along_with(lives[k], filters[k], tool, self._scene.kinds[kind].radius)
        for k in np.flatnonzero(lives[:, LifeLayout.HELD]) if tool is not None else ():
            lives[k, LifeLayout.X_WO] = object_life.with_tool(lives[k, LifeLayout.X_TO], tool.pose)  # type: ignore[union-attr]
        for k in np.flatnonzero(np.isfinite(measured[:, 0]) & (measured[:, 1] <= now + 1e-9)):
            lives[k] = object_life.after_image(lives[k], float(measured[k, 0]), float(measured[k, 1]))
        if hand is not None and tool is not None:
            self._heed(context, discrete, hand, tool, filters, lives)
        for state, rows in ((self._filters, filters), (self._lives, lives), (self._assets, assets)):
            discrete.set_value(int(state), cast(Any, rows.ravel()))
        self._note(context, discrete, filters, lives, assets)

    def _before(self, context: Context, measurement: PoseMeasurement, radius: float) -> LinearMotion | None:
        """Return how an object went that is found for the first time, while it was an unknown thing."""
        if not self._things_in.HasValue(context):
            return None
        things = things_of(np.array(self._things_in.Eval(context)))
        return motion_before(things, measurement.pose[4:], radius, measurement.time)

    def _heed(
        self,
        context: Context,
        discrete: DiscreteValues,
        hand: Hand,
        tool: object_life.Tool,
        filters: Array,
        lives: Array,
    ) -> None:
        """Take what is told of the hand into filters and lives."""
        before = Hand.unpack(np.asarray(context.get_discrete_state(int(self._grip)).value()))
        now = context.get_time()
        if before.held != NOTHING and before.held != hand.held:
            k = before.held
            pose_, covariance = object_life.with_tool(before.X_TO, tool.pose), before.covariance
            R = np.kron(np.eye(2), rotations.matrix(tool.pose[:4]))
            lives[k, LifeLayout.HELD] = 0.0
            if hand.touched == k:  # let go on purpose; where it went otherwise is for images to tell
                filters[k] = object_update.at_rest(now, pose_, R @ covariance @ R.T)
        if hand.held != NOTHING:
            lives[hand.held] = object_life.gripped(lives[hand.held], hand.X_TO, tool)
        discrete.set_value(int(self._grip), cast(Any, hand.pack()))

    def _follow_calibration(self, context: Context, discrete: DiscreteValues, filters: Array) -> Array:
        """Return filters moved as the calibration was corrected since the tick before: the objects stood still."""
        if self._rests_in.HasValue(context):
            rests = np.array(self._rests_in.Eval(context)).reshape(-1, RESTS_SIZE)
            before = np.asarray(context.get_discrete_state(int(self._rests)).value()).reshape(-1, RESTS_SIZE)
            discrete.set_value(int(self._rests), cast(Any, rests.ravel()))
            steps = rests[:, 36:] - before[:, 36:]
            return self._shifted(filters, lambda _: steps) if steps.any() else filters
        if self._camera is None or not self._calibration_in.HasValue(context):
            return filters
        calibration = np.array(self._calibration_in.Eval(context))
        change = calibration - np.asarray(context.get_discrete_state(int(self._corrected)).value())
        if not change.any():
            return filters
        discrete.set_value(int(self._corrected), cast(Any, calibration))
        return self._shifted(filters, lambda poses: -pose_shifts(*self._sight(poses)) @ change[:SIZE])

    def _shifted(self, filters: Array, by: Callable[[Array], Array]) -> Array:
        """Return filters whose poses (R, 7) are turned and shifted `by` so much (R, 6)."""
        after = filters.copy()
        for part in (FilterLayout.POSE, FilterLayout.REMEMBERED_POSE):
            shifts = by(filters[:, part])
            after[:, part] = [object_update.moved(pose, s) for pose, s in zip(filters[:, part], shifts, strict=True)]
        return after

    def _measured(self, context: Context) -> tuple[Array, Array]:
        """Return (R, MEASUREMENT_SIZE) of objects and further instances, and (R, 2) identity and asset of each."""
        first = cast(Array, self._poses_in.Eval(context)).reshape(self._count, MEASUREMENT_SIZE)
        numbers = np.arange(float(self._count))
        whose = np.column_stack([numbers + 1.0, numbers])
        if not self._further_in.HasValue(context):
            none = np.zeros((self._further, MEASUREMENT_SIZE))
            none[:, 1] = NEVER
            return np.concatenate([first, none]), np.concatenate([whose, np.zeros((self._further, OWNER_SIZE))])
        rows = cast(Array, self._further_in.Eval(context)).reshape(self._further, FURTHER_MEASUREMENT_SIZE)
        return np.concatenate([first, rows[:, OWNER_SIZE:]]), np.concatenate([whose, rows[:, :OWNER_SIZE]])

    def _note(self, context: Context, discrete: DiscreteValues, filters: Array, lives: Array, assets: Array) -> None:
        """Note what has happened to objects and things since the tick before."""
        now = context.get_time()
        status = object_life.statuses(lives, object_filter.statuses(filters, now, self._tuning))
        who = lives[:, LifeLayout.IDENTITY].copy()
        gone = lives[:, LifeLayout.GONE_SINCE]
        # An object of the library keeps its slot, but is removed all the same.
        who[(gone >= 0.0) & (now - gone > self._forget_after)] = 0.0
        looks = [np.column_stack([who, status, assets])]
        if self._things_in.HasValue(context):
            rows = cast(Array, self._things_in.Eval(context)).reshape(self._things, THING_SIZE)
            looks.append(np.column_stack([rows[:, :2], np.full(len(rows), -1.0)]))
        else:
            looks.append(np.zeros((self._things, 3)))
        after = np.concatenate(looks)
        before = np.asarray(context.get_discrete_state(int(self._looked)).value()).reshape(-1, 3)
        happened = object_events.changes(before, after)
        discrete.set_value(int(self._looked), cast(Any, after.ravel()))
        if happened:
            ring = np.asarray(context.get_discrete_state(int(self._events)).value())
            discrete.set_value(int(self._events), cast(Any, object_events.noted(ring, now, happened)))

    def _tool(self, context: Context) -> object_life.Tool | None:
        """Return how the tool moves now; None before the arm's first message."""
        arm_state = cast(Array, self._arm_in.Eval(context))
        if not np.isfinite(arm_state).all():
            return None
        plant, own, scene = self._scene.plant, self._kinematics, self._scene
        n = len(scene.arm_position_index)
        positions, velocities = scene.default_positions.copy(), np.zeros(plant.num_velocities())
        positions[scene.arm_position_index] = arm_state[:n]
        velocities[self._arm_velocity_index] = arm_state[n:]
        plant.SetPositions(own, cast(Any, positions))
        plant.SetVelocities(own, cast(Any, velocities))
        frame = plant.get_frame(scene.arm.tool_frame)
        X_WT, V_WT = frame.CalcPoseInWorld(own), frame.CalcSpatialVelocityInWorld(own)
        pose_ = np.concatenate([X_WT.rotation().ToQuaternion().wxyz(), X_WT.translation()])
        return object_life.Tool(pose_, np.concatenate([V_WT.rotational(), V_WT.translational()]))

    @timing.timed("SceneGraphUpdater")
    def _calc_tracks(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(cast(Any, self._tracks(context, slice(0, self._count)).ravel()))

    def _calc_further(self, context: Context, output: BasicVector) -> None:
        part = slice(self._count, self._count + self._further)
        lives, rows = self._lives_of(context)[part], np.zeros((self._further, FURTHER_TRACK_SIZE))
        rows[:, 0], rows[:, 1] = lives[:, LifeLayout.IDENTITY], self._assets_of(context)[part]
        if rows[:, 0].any():
            rows[:, OWNER_SIZE:] = self._tracks(context, part)
        output.SetFromVector(cast(Any, rows.ravel()))

    def _calc_things(self, context: Context, output: BasicVector) -> None:
        if self._things_in.HasValue(context):
            things = carried(cast(Array, self._things_in.Eval(context)), context.get_time())
            output.SetFromVector(cast(Any, things))

    def _calc_events(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(int(self._events)).value())

    def _tracks(self, context: Context, part: slice) -> Array:
        """Return (R, TRACK_SIZE) the tracks of some rows, at the present time."""
        filters, lives, now = self._filters_of(context)[part], self._lives_of(context)[part], context.get_time()
        belief = object_filter.propagate(filters, now, self._tuning)
        tracks = np.empty((len(filters), TRACK_SIZE))
        tracks[:, 0] = object_life.statuses(lives, object_filter.statuses(filters, now, self._tuning))
        tracks[:, 1] = filters[:, FilterLayout.LAST_SEEN]
        tracks[:, 9:15] = belief.velocities
        held = tracks[:, 0] == ObjectStatus.HELD
        belief.poses[held] = lives[held, LifeLayout.X_WO]
        away = (tracks[:, 0] == ObjectStatus.UNSEEN) | (tracks[:, 0] == ObjectStatus.GONE)
        tracks[:, 2:9] = np.where(away[:, None], self._parked[part], belief.poses)
        kinds = self._scene.kinds
        axes = np.zeros((len(filters), 3))
        if kinds:
            axes[:] = [kinds[int(k)].axis for k in self._assets_of(context)[part]]
        covariances = object_filter.pose_covariances(belief, axes, self._tuning, self._shared(context, belief, part))
        tracks[:, 15:] = covariances.reshape(len(filters), 36)
        return tracks

    def _shared(self, context: Context, belief: object_filter.ObjectBelief, part: slice) -> Array | None:
        """Return (R, 6, 6) what calibration leaves open of some rows; None where that is told to be nothing."""
        if self._rests_in.HasValue(context):
            rests = np.asarray(context.get_discrete_state(int(self._rests)).value())
            return np.array(rests.reshape(-1, RESTS_SIZE)[part, :36].reshape(-1, 6, 6))
        if self._camera is None or not self._doubt.variances.any():
            return None
        covariance = np.array(context.get_discrete_state(int(self._corrected)).value())[SIZE:].reshape(SIZE, SIZE)
        return shared_covariances(covariance, *self._sight(belief.poses))

    def _sight(self, poses: Array) -> tuple[Array, Array, float, float]:
        """Return where poses (R, 7) are in the camera's frame (R, 3), its axes in W, and its focal lengths."""
        lens, p_WC, R_WC = self._told_of_camera
        return (poses[:, 4:] - p_WC) @ R_WC, R_WC, lens.fx, lens.fy

    @cached_property
    def _told_of_camera(self) -> tuple[Lens, Array, Array]:
        """The camera's lens for colours, and where it is told to be and how it is turned in W."""
        assert self._camera is not None
        X_WC = pose(self._camera.X_WC)
        return colour_lens(self._camera), X_WC.translation().copy(), X_WC.rotation().matrix().copy()

    @timing.timed("SceneGraphUpdater")
    def _calc_positions(self, context: Context, output: BasicVector) -> None:
        scene = self._scene
        positions = scene.default_positions.copy()
        arm_state = cast(Array, self._arm_in.Eval(context))
        if np.isfinite(arm_state).all():
            positions[scene.arm_position_index] = arm_state[: len(scene.arm_position_index)]
        if self._gripper_in.HasValue(context):
            gripper = cast(Array, self._gripper_in.Eval(context))
            if np.isfinite(gripper).all():
                positions[scene.gripper_position_index] = gripper[: len(scene.gripper_position_index)]
        scene.followers.follow(positions)
        tracks = cast(Array, self._tracks_out.Eval(context)).reshape(self._count, TRACK_SIZE)
        positions[scene.object_position_index] = tracks[:, 2:9]
        output.SetFromVector(cast(Any, positions))

    def _lives_of(self, context: Context) -> Array:
        """Return (R, LIFE_SIZE), not to be written to."""
        return np.asarray(context.get_discrete_state(int(self._lives)).value()).reshape(-1, object_life.LIFE_SIZE)

    def _assets_of(self, context: Context) -> Array:
        """Return (R,) which of the library's objects each row is like, not to be written to."""
        return np.asarray(context.get_discrete_state(int(self._assets)).value())

    def _filters_of(self, context: Context) -> Array:
        """Return (R, FILTER_SIZE), not to be written to."""
        return np.asarray(context.get_discrete_state(int(self._filters)).value()).reshape(-1, object_filter.FILTER_SIZE)
