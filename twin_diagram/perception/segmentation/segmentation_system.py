"""The system that takes the camera's images apart."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram import scenario
from twin_diagram.perception.alignment import Alignment
from twin_diagram.perception.segmentation.robot_shape import RobotShape
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.runtime.timing import timed


class PerceptionSystem(LeafSystem):
    """Segments of the newest image: what stands on the table and is not the robot.

    .. pydrake_system::

        name: PerceptionSystem
        input_ports:
        - rgb_image
        - depth_image
        - image_time
        - arm_state
        output_ports:
        - segments

    Ports:
        rgb_image: (ImageRgba8U) of the camera that the twin was told of, on the grid that it was told of.
        depth_image: (ImageDepth32F) of the same capture [m], 0 where there is none, on its own grid where it has one.
        image_time: (1) capture time [s], `NEVER` before the first.
        arm_state: (2n) x̂ = (q, v) now [rad, rad/s].
        segments: (`Segments`) in W.

    Computed when asked for, and cached: no state, no rate, no latency of its own. The image is older than x̂, so the
    robot is posed at q - v·(t - image_time).
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
        self._robot = RobotShape(arm, packages, base_dir)
        self._arm_joints = self._robot.joint_count
        self._rgb = self.DeclareAbstractInputPort("rgb_image", Value[ImageRgba8U]())
        self._depth = self.DeclareAbstractInputPort("depth_image", Value[ImageDepth32F]())
        self._time = self.DeclareVectorInputPort("image_time", 1)
        self._arm = self.DeclareVectorInputPort("arm_state", 2 * self._arm_joints)
        empty = Segments.empty(self._grid.camera, params.stride, params.table_height)
        self.DeclareAbstractOutputPort(
            "segments",
            lambda: AbstractValue.Make(empty),
            self._calc_segments,
            prerequisites_of_calc={
                self._rgb.ticket(),
                self._depth.ticket(),
                self._time.ticket(),
                self._arm.ticket(),
                self.time_ticket(),
            },
        )
        self._empty = empty

    @timed("Perception")
    def _calc_segments(self, context: Context, output: AbstractValue) -> None:
        image_time = float(self._time.Eval(context)[0])
        if image_time < 0.0:
            output.set_value(self._empty)
            return
        rgb = cast(ImageRgba8U, self._rgb.Eval(context))
        depth = cast(ImageDepth32F, self._depth.Eval(context))
        state = np.array(self._arm.Eval(context))
        n = self._arm_joints
        q = state[:n] - state[n:] * (context.get_time() - image_time)
        output.set_value(
            segment(
                self._alignment.colours(rgb.data[..., :3]),
                self._alignment.depth(depth.data[..., 0]),
                image_time,
                self._grid,
                self._params,
                lambda points, margin: self._robot.near(points, q, margin),
            )
        )
