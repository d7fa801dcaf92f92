"""The system that finds and follows the known objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.slots import SLOT_SIZE, Slot, measurement
from twin_diagram.perception.registration.tracking import Known, step
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.runtime.timing import timed
from twin_diagram.signals.layouts import MEASUREMENT_SIZE, NEVER


@dataclass(frozen=True)
class Tuning:
    """When the system updates, chosen by hand: any time after the delivery that is short beside an image's period."""

    after_delivery: float = 0.001
    """The update comes this long after an image is delivered [s]."""


TUNING = Tuning()


class IcpPoseEstimator(LeafSystem):
    """Poses of the library's objects, by coloured registration of their clouds to each image.

    .. pydrake_system::

        name: IcpPoseEstimator
        input_ports:
        - segments
        output_ports:
        - object_poses

    Ports:
        segments: (`Segments`) of the newest image.
        object_poses: (K · MEASUREMENT_SIZE) a `PoseMeasurement` per object, in the library's order: X_WO at the image's
            capture time, covariance, quality; quality 0 with the last pose where an object was not found in the image,
            time `NEVER` before the first image.

    Updated at k / rate + latency + 1 ms, k = 0, 1, …: the poses are those of the image delivered just before, so they
    are `latency` + 1 ms old when they come out. All memory is discrete vector state.
    """

    def __init__(
        self,
        library: Mapping[str, Asset],
        camera: scenario.Camera,
        params: scenario.Registration,
        perception: scenario.Perception | None = None,
    ) -> None:
        """Build the system.

        Args:
            library: assets by the object's name.
            camera: the twin's camera: rate and latency.
            params: tuning.
            perception: of it the smallest size of a segment and the stride.
        """
        super().__init__()
        tuning = perception or scenario.Perception()
        self.names = tuple(library)
        """The objects, in the order of `object_poses`."""
        self._library = tuple(Known.of(ModelCloud.of(asset, params.model_points)) for asset in library.values())
        self._params = params
        self._smallest = tuning.smallest
        none = Segments.empty(Pinhole.from_scenario(camera).straight, tuning.stride, tuning.table_height)
        self._input = self.DeclareAbstractInputPort("segments", AbstractValue.Make(none))
        count = len(library)
        empty = np.concatenate([measurement(Slot(), None, NEVER).pack() for _ in range(count)] or [np.zeros(0)])
        slots = np.concatenate([Slot().pack() for _ in range(count)] or [np.zeros(0)])
        self._memory = self.DeclareDiscreteState(slots)
        self._out = self.DeclareDiscreteState(empty)
        self._last = self.DeclareDiscreteState(np.array([NEVER]))
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=1.0 / camera.rate, offset_sec=camera.latency + TUNING.after_delivery, update=self._update
        )
        self.DeclareVectorOutputPort(
            "object_poses",
            count * MEASUREMENT_SIZE,
            self._calc_poses,
            prerequisites_of_calc={self.discrete_state_ticket(self._out)},
        )

    @timed("IcpPoseEstimator")
    def _update(self, context: Context, discrete: DiscreteValues) -> None:
        segments = cast(Segments, self._input.Eval(context))
        last = float(context.get_discrete_state(self._last).value()[0])
        # The same image again says nothing new.
        if segments.time < 0.0 or segments.time <= last:
            return
        vector = context.get_discrete_state(self._memory).value()
        slots = [Slot.unpack(part) for part in vector.reshape(-1, SLOT_SIZE)]
        after, found = step(self._library, slots, segments, self._params, self._smallest)
        if after:
            discrete.get_mutable_vector(self._memory).SetFromVector(np.concatenate([slot.pack() for slot in after]))
            discrete.get_mutable_vector(self._out).SetFromVector(np.concatenate([one.pack() for one in found]))
        discrete.get_mutable_vector(self._last).SetFromVector([segments.time])

    def _calc_poses(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(self._out).value())
