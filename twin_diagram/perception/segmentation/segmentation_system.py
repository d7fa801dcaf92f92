"""The system that takes the camera's images apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import cast

import numpy as np
import numpy.typing as npt
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram import scenario
from twin_diagram.perception.alignment import Alignment
from twin_diagram.perception.calibration import corrected
from twin_diagram.perception.segmentation.robot_shape import RobotShape
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.runtime.timing import timed
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import CALIBRATION_SIZE, SIZE
from twin_diagram.signals.layouts import NEVER


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    late: float = 0.5
    """Depth may be older than its image's time by so much of a frame's period: two sensors expose in turn."""

    after_delivery: float = 0.00075
    """x̂ and calibration are kept this long after an image's delivery [s]: the calibration is then of that image, and
    whoever looks at the segments does so later."""

    still: float = 0.002
    """A joint that turned by less since then did not move [rad]: 2 mm of an arm 1 m long, a fifth of its clearance."""


TUNING = Tuning()


class PerceptionSystem(LeafSystem):
    """Segments of the newest image: what stands on the table and is not the robot.

    .. pydrake_system::

        name: PerceptionSystem
        input_ports:
        - rgb_image
        - depth_image
        - image_time
        - arm_state
        - calibration (optional)
        output_ports:
        - segments

    Ports:
        rgb_image: (ImageRgba8U) of the camera that the twin was told of, on the grid that it was told of.
        depth_image: (ImageDepth32F) of the same capture [m], 0 where there is none, on its own grid where it has one.
        image_time: (1) capture time [s], `NEVER` before the first.
        arm_state: (2n) x̂ = (q, v) now [rad, rad/s].
        calibration: (10 + 100) errors of the calibration, which are taken out; see `signals.calibration_error`.
            Not connected: the camera is as told.
        segments: (`Segments`) in W.

    Computed when asked for, and cached: no rate, no latency of its own. The image is older than x̂, so the robot is
    posed at q - v·(t - image_time); where it moves also where it was half a frame before, for depth may be late.
    Where ``params.latency`` gives time to whoever looks at the segments, x̂ and calibration are those of 0.75 ms after
    the image's delivery, kept as discrete state, and an image's segments stay the same until the next.
    """

    def __init__(
        self,
        arm: scenario.ArmModel,
        camera: scenario.Camera,
        params: scenario.Perception,
        packages: Mapping[str, str | Path] | None = None,
        base_dir: str | Path | None = None,
    ) -> None:
        """Build the system.

        Args:
            arm: the twin's arm; its collision shapes say what in the image is the robot.
            camera: the twin's calibration.
            params: tuning.
            packages: local folders by package name.
            base_dir: folder that relative paths are looked up in first.
        """
        super().__init__()
        self._params = params
        self._alignment = Alignment.of(camera)
        self._grid = Grid.of(self._alignment.camera, params.stride)
        # Rays take as long as a segmentation, and hold for many images.
        self._corrected = lru_cache(maxsize=2)(self._corrected_grid)
        self._robot = RobotShape(arm, packages, base_dir)
        self._arm_joints = self._robot.joint_count
        self._late = TUNING.late / camera.rate
        self._rgb = self.DeclareAbstractInputPort("rgb_image", Value[ImageRgba8U]())
        self._depth = self.DeclareAbstractInputPort("depth_image", Value[ImageDepth32F]())
        self._time = self.DeclareVectorInputPort("image_time", 1)
        self._arm = self.DeclareVectorInputPort("arm_state", 2 * self._arm_joints)
        self._calibration = self.DeclareVectorInputPort("calibration", CALIBRATION_SIZE)
        empty = Segments.empty(self._grid.camera, params.stride, params.table_height)
        tickets = {self._rgb.ticket(), self._depth.ticket(), self._time.ticket()}
        self._kept: int | None = None
        if params.latency > 0.0:
            index = self.DeclareDiscreteState(np.r_[NEVER, np.zeros(2 * self._arm_joints + SIZE)])
            self._kept = int(index)
            when = camera.latency + TUNING.after_delivery
            self.DeclarePeriodicDiscreteUpdateEvent(1.0 / camera.rate, when, self._keep)
            tickets |= {self.discrete_state_ticket(index)}
        else:
            tickets |= {self._arm.ticket(), self._calibration.ticket(), self.time_ticket()}
        self.DeclareAbstractOutputPort("segments", lambda: AbstractValue.Make(empty), self._calc_segments, tickets)
        self._empty = empty

    def _now(self, context: Context) -> Array:
        """Return time, x̂ and errors of the calibration now: (1 + 2n + SIZE)."""
        errors = np.zeros(SIZE)
        if self._calibration.HasValue(context):
            errors = np.array(self._calibration.Eval(context))[:SIZE]
        return np.concatenate([[context.get_time()], np.array(self._arm.Eval(context)), errors])

    def _keep(self, context: Context, discrete: DiscreteValues) -> None:
        discrete.set_value(self._kept, self._now(context))

    def _corrected_grid(self, errors: bytes) -> tuple[Grid, float]:
        """Return the grid, and the factor on depth, of the camera with errors (10,), packed, taken out."""
        camera, factor = corrected(self._alignment.camera, np.frombuffer(errors))
        return Grid.of(camera, self._params.stride), factor

    @timed("Perception")
    def _calc_segments(self, context: Context, output: AbstractValue) -> None:
        image_time = float(self._time.Eval(context)[0])
        if image_time < 0.0:
            output.set_value(self._empty)
            return
        rgb = cast(ImageRgba8U, self._rgb.Eval(context))
        depth = cast(ImageDepth32F, self._depth.Eval(context))
        n = self._arm_joints
        kept = self._now(context) if self._kept is None else np.array(context.get_discrete_state(self._kept).value())
        time, state, errors = kept[0], kept[1 : 1 + 2 * n], kept[1 + 2 * n :]
        q = state[:n] - state[n:] * (time - image_time)
        grid, metres = self._grid, self._alignment.depth(depth.data[..., 0])
        if errors.any():
            grid, factor = self._corrected(errors.tobytes())
            metres = metres * np.float32(factor)
        output.set_value(
            segment(
                self._alignment.colours(rgb.data[..., :3]),
                metres,
                image_time,
                grid,
                self._params,
                lambda points, margin: self._near(points, margin, q, self._late * state[n:]),
            )
        )

    def _near(self, points: Array, margin: float, q: Array, back: Array) -> npt.NDArray[np.bool_]:
        """Return which points (N, 3) are within a margin [m] of the robot at q (n,), or before it moved by `back`."""
        near = self._robot.near(points, q, margin)
        if np.abs(back).max(initial=0.0) > TUNING.still:
            others = np.flatnonzero(~near)
            near[others] = self._robot.near(points[others], q - back, margin)
        return near
