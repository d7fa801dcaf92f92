"""Keeps the twin's scene in step with what is seen."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from twin_diagram import scenario
from twin_diagram.runtime import timing
from twin_diagram.scenario.lenses import calibration_error, colour_lens
from twin_diagram.scenario.poses import pose
from twin_diagram.scene import object_filter, object_update
from twin_diagram.scene.object_filter import FilterLayout
from twin_diagram.scene.twin_scene import TwinScene, parked_poses
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import CalibrationError, shared_covariances
from twin_diagram.signals.layouts import MEASUREMENT_SIZE, NEVER, TRACK_SIZE, ObjectStatus, PoseMeasurement


class SceneGraphUpdater(LeafSystem):
    """Filters the objects' measured poses and writes them, with the arm's, into the positions of the twin's plant.

    .. pydrake_system::

        name: SceneGraphUpdater
        input_ports:
        - object_poses
        - arm_state
        - image_time
        - gripper_state (optional)
        output_ports:
        - positions
        - tracks

    Ports:
        object_poses: (K · MEASUREMENT_SIZE) a `layouts.PoseMeasurement` per library object, in the library's order.
        arm_state: (2n) joint angles [rad] and speeds of the arm.
        image_time: (1) capture time of the newest image [s], `NEVER` before the first. Measurements are not used before
            the first image.
        gripper_state: (2g) finger positions [m] and speeds; the fingers stay as described where it is not connected.
        positions: (nq) of `TwinScene.plant` at the present time; objects not yet seen wait out of sight.
        tracks: (K · TRACK_SIZE) a `layouts.Track` per library object, at the present time.

    Rate: measurements are taken in at `scene.rate` [1/s]. Latency: a measurement waits for the next tick and counts for
    its capture time; what comes out is predicted to the moment at which it is asked for.

    State: one filter per object (see `scene.object_update`), in a discrete vector.
    """

    def __init__(self, scene: TwinScene, params: scenario.SceneUpdater, camera: scenario.Camera | None = None) -> None:
        """Size the ports for a scene.

        Args:
            scene: says which position belongs to what.
            params: tuning.
            camera: that sees the objects; None, or one with an exact calibration, adds nothing to covariances.
        """
        super().__init__()
        self.set_name("scene_graph_updater")
        self._tuning: Final = object_filter.FilterSettings.of(params)
        self._scene: Final = scene
        self._camera: Final = camera
        self._doubt: Final = calibration_error(camera) if camera is not None else CalibrationError()
        self._symmetric: Final[npt.NDArray[np.bool_]] = scene.symmetry_axes_O[:, 2] != 0
        self._count: Final = len(scene.object_names)
        self._parked: Final = parked_poses(self._count)

        n, g = len(scene.arm_position_index), len(scene.gripper_position_index)
        self._poses_in = self.DeclareVectorInputPort("object_poses", self._count * MEASUREMENT_SIZE)
        self._arm_in = self.DeclareVectorInputPort("arm_state", 2 * n)
        self._image_time_in = self.DeclareVectorInputPort("image_time", 1)
        self._gripper_in = self.DeclareVectorInputPort("gripper_state", 2 * g)
        self._filters = self.DeclareDiscreteState(cast(Any, object_filter.initial_filters(self._count).ravel()))
        now = {self.time_ticket(), self.xd_ticket()}
        joints = {self.input_port_ticket(port.get_index()) for port in (self._arm_in, self._gripper_in)}
        self.DeclareVectorOutputPort("positions", scene.plant.num_positions(), self._calc_positions, now | joints)
        self._tracks_out = self.DeclareVectorOutputPort("tracks", self._count * TRACK_SIZE, self._calc_tracks, now)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / params.rate, 0.0, self._tick)

    @timing.timed("SceneGraphUpdater")
    def _tick(self, context: Context, discrete: DiscreteValues) -> None:
        if float(cast(Array, self._image_time_in.Eval(context))[0]) == NEVER:
            return
        filters = self._filters_of(context)
        measured = cast(Array, self._poses_in.Eval(context)).reshape(self._count, MEASUREMENT_SIZE)
        used = np.maximum(filters[:, FilterLayout.LAST_SEEN], filters[:, FilterLayout.REMEMBERED_TIME])
        fresh = np.flatnonzero((measured[:, 0] > 0) & (measured[:, 1] > used))
        if fresh.size == 0:
            return
        filters = filters.copy()
        for k in fresh:
            measurement = PoseMeasurement.unpack(measured[k])
            filters[k] = object_update.update(
                filters[k], measurement, context.get_time(), self._tuning, bool(self._symmetric[k])
            )
        discrete.set_value(int(self._filters), cast(Any, filters.ravel()))

    @timing.timed("SceneGraphUpdater")
    def _calc_tracks(self, context: Context, output: BasicVector) -> None:
        filters, now = self._filters_of(context), context.get_time()
        belief = object_filter.propagate(filters, now, self._tuning)
        tracks = np.empty((self._count, TRACK_SIZE))
        tracks[:, 0] = object_filter.statuses(filters, now, self._tuning)
        tracks[:, 1] = filters[:, FilterLayout.LAST_SEEN]
        unseen = tracks[:, 0] == ObjectStatus.UNSEEN
        tracks[:, 2:9] = np.where(unseen[:, None], self._parked, belief.poses)
        tracks[:, 9:15] = belief.velocities
        covariances = object_filter.pose_covariances(
            belief, self._scene.symmetry_axes_O, self._tuning, self._shared(belief)
        )
        tracks[:, 15:] = covariances.reshape(self._count, 36)
        output.SetFromVector(cast(Any, tracks.ravel()))

    def _shared(self, belief: object_filter.ObjectBelief) -> Array | None:
        """Return (K, 6, 6) what the camera's calibration leaves open; None where that is told to be nothing."""
        if self._camera is None or not self._doubt.variances.any():
            return None
        lens, X_WC = colour_lens(self._camera), pose(self._camera.X_WC)
        R_WC = X_WC.rotation().matrix()
        seen_C = (belief.poses[:, 4:] - X_WC.translation()) @ R_WC
        return shared_covariances(self._doubt, seen_C, R_WC, lens.fx, lens.fy)

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
        tracks = cast(Array, self._tracks_out.Eval(context)).reshape(self._count, TRACK_SIZE)
        positions[scene.object_position_index] = tracks[:, 2:9]
        output.SetFromVector(cast(Any, positions))

    def _filters_of(self, context: Context) -> Array:
        """Return (K, FILTER_SIZE), not to be written to."""
        return np.asarray(context.get_discrete_state(int(self._filters)).value()).reshape(-1, object_filter.FILTER_SIZE)
