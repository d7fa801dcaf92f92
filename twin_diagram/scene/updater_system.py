"""Keeps the twin's scene in step with what is seen."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from twin_diagram import scenario, timing
from twin_diagram.scene import track
from twin_diagram.scene.twin_scene import TwinScene, parked_poses
from twin_diagram.signals import MEASUREMENT_SIZE, NEVER, TRACK_SIZE, Array, ObjectStatus, PoseMeasurement


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
        object_poses: (K · MEASUREMENT_SIZE) a `signals.PoseMeasurement` per library object, in the library's order.
        arm_state: (2n) joint angles [rad] and speeds of the arm.
        image_time: (1) capture time of the newest image [s], `NEVER` before the first. Measurements are not used before
            the first image.
        gripper_state: (2g) finger positions [m] and speeds; the fingers stay as described where it is not connected.
        positions: (nq) of `TwinScene.plant`; objects not yet seen wait out of sight.
        tracks: (K · TRACK_SIZE) a `signals.Track` per library object, predicted to the time of the tick.

    Rate: `scene.rate` [1/s]; the outputs hold between ticks, so they are at most one period old. Latency: a measurement
    is used at the first tick after it arrives and counts for its capture time.

    State: one filter per object (see `scene.track`), the tracks and the positions; all in discrete vectors.
    """

    def __init__(self, scene: TwinScene, params: scenario.SceneUpdater) -> None:
        """Sizes the ports for a scene.

        Args:
            scene: says which position belongs to what.
            params: tuning.
        """
        super().__init__()
        self.set_name("scene_graph_updater")
        self._tuning: Final = track.Tuning.of(params)
        self._axes_O: Final = scene.symmetry_axes_O
        self._symmetric: Final[npt.NDArray[np.bool_]] = scene.symmetry_axes_O[:, 2] != 0
        self._arm_index: Final = scene.arm_position_index
        self._gripper_index: Final = scene.gripper_position_index
        self._object_index: Final = scene.object_position_index
        self._count: Final = len(scene.object_names)
        self._parked: Final = parked_poses(self._count)

        n = len(self._arm_index)
        self._poses_in = self.DeclareVectorInputPort("object_poses", self._count * MEASUREMENT_SIZE)
        self._arm_in = self.DeclareVectorInputPort("arm_state", 2 * n)
        self._image_time_in = self.DeclareVectorInputPort("image_time", 1)
        self._gripper_in = self.DeclareVectorInputPort("gripper_state", 2 * len(self._gripper_index))

        filters = track.initial_filters(self._count)
        self._filters = self.DeclareDiscreteState(cast(Any, filters.ravel()))
        self._tracks = self.DeclareDiscreteState(cast(Any, self._packed(filters, 0.0).ravel()))
        self._positions = self.DeclareDiscreteState(cast(Any, scene.default_positions))
        self.DeclareStateOutputPort("positions", self._positions)
        self.DeclareStateOutputPort("tracks", self._tracks)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / params.rate, 0.0, self._tick)

    @timing.timed("SceneGraphUpdater")
    def _tick(self, context: Context, discrete: DiscreteValues) -> None:
        now = context.get_time()
        filters = np.array(context.get_discrete_state(int(self._filters)).value()).reshape(self._count, -1)
        if float(cast(Array, self._image_time_in.Eval(context))[0]) != NEVER:
            measured = cast(Array, self._poses_in.Eval(context)).reshape(self._count, MEASUREMENT_SIZE)
            used = np.maximum(filters[:, track.Slot.LAST_SEEN], filters[:, track.Slot.REMEMBERED_TIME])
            for k in np.flatnonzero((measured[:, 0] > 0) & (measured[:, 1] > used)):
                filters[k] = track.update(
                    filters[k], PoseMeasurement.unpack(measured[k]), now, self._tuning, bool(self._symmetric[k])
                )
            discrete.set_value(int(self._filters), cast(Any, filters.ravel()))

        tracks = self._packed(filters, now)
        discrete.set_value(int(self._tracks), cast(Any, tracks.ravel()))

        positions = np.array(context.get_discrete_state(int(self._positions)).value())
        arm_state = cast(Array, self._arm_in.Eval(context))
        if np.isfinite(arm_state).all():
            positions[self._arm_index] = arm_state[: len(self._arm_index)]
        if self._gripper_in.HasValue(context):
            gripper = cast(Array, self._gripper_in.Eval(context))
            if np.isfinite(gripper).all():
                positions[self._gripper_index] = gripper[: len(self._gripper_index)]
        positions[self._object_index] = tracks[:, 2:9]
        discrete.set_value(int(self._positions), cast(Any, positions))

    def _packed(self, filters: Array, now: float) -> Array:
        """(K, TRACK_SIZE) what the filters say now."""
        belief = track.propagate(filters, now, self._tuning)
        tracks = np.empty((self._count, TRACK_SIZE))
        tracks[:, 0] = track.statuses(filters, now, self._tuning)
        tracks[:, 1] = filters[:, track.Slot.LAST_SEEN]
        unseen = tracks[:, 0] == ObjectStatus.UNSEEN
        tracks[:, 2:9] = np.where(unseen[:, None], self._parked, belief.poses)
        tracks[:, 9:15] = belief.velocities
        covariances = track.pose_covariances(belief, self._axes_O, self._tuning)
        tracks[:, 15:] = covariances.reshape(self._count, 36)
        return tracks
