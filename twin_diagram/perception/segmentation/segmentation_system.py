"""The system that takes the camera's images apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import numpy.typing as npt
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram import scenario
from twin_diagram.perception.alignment import Alignment
from twin_diagram.perception.calibration import corrected
from twin_diagram.perception.segmentation.learned import Segmenter, segment_with
from twin_diagram.perception.segmentation.robot_shape import RobotShape
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import HeldPlaces, Segments
from twin_diagram.runtime.timing import timed
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import CALIBRATION_SIZE, SIZE
from twin_diagram.signals.hand import HAND_SIZE, NOTHING, Hand
from twin_diagram.signals.layouts import NEVER
from twin_diagram.signals.pose_vectors import as_matrix


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

    places: int = 3
    """Of what is held in that time: at 1.2 m/s 20 mm apart, within what is explained about each."""


TUNING = Tuning()


@dataclass(frozen=True)
class DeliveredImage:
    """An image as delivered, and what was believed of arm and camera when it came.

    Attributes:
        time: capture time [s]; `NEVER` before the first.
        rgb: (H, W, ≥ 3) colours, on the camera's own grid.
        depth: (H', W') [m], 0 where there is none, on its own grid.
        q: (n,) joint angles at the capture [rad].
        back: (n,) how far they turn in half a frame [rad].
        errors: (10,) of the calibration, see `signals.calibration_error`.
        fingers: (g,) where they are [m]; empty: not told.
        hand: (HAND_SIZE) what it holds, a packed `Hand`.
    """

    time: float
    rgb: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]
    q: Array
    back: Array
    errors: Array
    fingers: Array = field(default_factory=lambda: np.zeros(0))
    hand: Array = field(default_factory=lambda: Hand().pack())


class ImageParting:
    """Takes images apart: a function of the image and of what goes with it alone, to be worked out anywhere."""

    def __init__(
        self,
        arm: scenario.ArmModel,
        camera: scenario.Camera,
        params: scenario.Perception,
        packages: Mapping[str, str | Path] | None = None,
        base_dir: str | Path | None = None,
        segmenter: Segmenter | None = None,
    ) -> None:
        """Load the arm; arguments as of `PerceptionSystem`."""
        self._made_of = (arm, camera, params, packages, base_dir, segmenter)
        self._params, self._segmenter = params, segmenter
        self._alignment = Alignment.of(camera)
        self._grid = Grid.of(self._alignment.camera, params.stride)
        # Rays take as long as a segmentation, and hold for many images.
        self._corrected = lru_cache(maxsize=2)(self._corrected_grid)
        self.robot = RobotShape(arm, packages, base_dir)
        """The arm's collision shapes."""
        self.empty = Segments.empty(self._grid.camera, params.stride, params.table_height)
        """What there is before the first image."""

    def __reduce__(self) -> tuple[type[ImageParting], tuple[object, ...]]:
        """Copy what it is made of: plants cannot be."""
        return ImageParting, self._made_of

    def apart(self, picture: DeliveredImage) -> Segments:
        """Return what stands on the table and is not the robot."""
        if picture.time < 0.0:
            return self.empty
        grid, metres = self._grid, self._alignment.depth(picture.depth)
        if picture.errors.any():
            grid, factor = self._corrected(picture.errors.tobytes())
            metres = metres * np.float32(factor)
        apart = segment if self._segmenter is None else partial(segment_with, self._segmenter)
        segments = apart(
            # Three channels of four as a view would be walked pixel by pixel at each copy: 1.5 ms.
            self._alignment.colours(np.asarray(cv2.cvtColor(picture.rgb, cv2.COLOR_RGBA2RGB))),
            metres,
            picture.time,
            grid,
            self._params,
            lambda points, margin: self._near(points, margin, picture),
        )
        return replace(segments, held=self._held(picture))

    def _held(self, picture: DeliveredImage) -> HeldPlaces | None:
        """Return where the hand had what it holds when a picture was taken, and back to when its depth may be of."""
        hand = Hand.unpack(picture.hand)
        if hand.held == NOTHING:
            return None
        back = picture.back * np.linspace(0.0, 1.0, TUNING.places)[:, None]
        X_WO = np.stack([self.robot.tool(q) @ as_matrix(hand.X_TO) for q in picture.q - back])
        return HeldPlaces(hand.held, X_WO[:, :3, :3].copy(), X_WO[:, :3, 3].copy())

    def _corrected_grid(self, errors: bytes) -> tuple[Grid, float]:
        """Return the grid, and the factor on depth, of the camera with errors (10,), packed, taken out."""
        camera, factor = corrected(self._alignment.camera, np.frombuffer(errors))
        return Grid.of(camera, self._params.stride), factor

    def _near(self, points: Array, margin: float, picture: DeliveredImage) -> npt.NDArray[np.bool_]:
        """Return which points (N, 3) are within a margin [m] of a picture's robot, or of where it was `back` before."""
        q, back, fingers = picture.q, picture.back, picture.fingers if picture.fingers.size else None
        near = self.robot.near(points, q, margin, fingers)
        if np.abs(back).max(initial=0.0) > TUNING.still:
            others = np.flatnonzero(~near)
            near[others] = self.robot.near(points[others], q - back, margin, fingers)
        return near


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
        - gripper_state (optional)
        - hand (optional)
        output_ports:
        - segments
        - picture (with a latency)

    Ports:
        rgb_image: (ImageRgba8U) of the camera that the twin was told of, on the grid that it was told of.
        depth_image: (ImageDepth32F) of the same capture [m], 0 where there is none, on its own grid where it has one.
        image_time: (1) capture time [s], `NEVER` before the first.
        arm_state: (2n) x̂ = (q, v) now [rad, rad/s].
        calibration: (10 + 100) errors of the calibration, which are taken out; see `signals.calibration_error`.
            Not connected: the camera is as told.
        gripper_state: (2g) positions of the fingers [m], then speeds [m/s]. Not connected: they are taken to be half
            open, and those of a wide hand may pass for things.
        hand: (HAND_SIZE) what it holds, see `signals.hand`: expected where the hand has it. Not connected: nothing.
        segments: (`Segments`) in W.
        picture: (`DeliveredImage`) of which they are, for whoever takes it apart elsewhere.

    Computed when asked for, and cached: no rate, no latency of its own. The image is older than x̂, so the robot is
    posed at q - v·(t - image_time); where it moves also where it was half a frame before, for depth may be late.
    Where ``params.latency`` gives time to whoever looks at the segments, x̂, calibration and fingers are of 0.75 ms
    after the image's delivery, kept as discrete state, and an image's segments stay the same until the next.
    """

    def __init__(
        self,
        arm: scenario.ArmModel,
        camera: scenario.Camera,
        params: scenario.Perception,
        packages: Mapping[str, str | Path] | None = None,
        base_dir: str | Path | None = None,
        segmenter: Segmenter | None = None,
    ) -> None:
        """Build the system.

        Args:
            arm: the twin's arm; its collision shapes say what in the image is the robot.
            camera: the twin's calibration.
            params: tuning.
            packages: local folders by package name.
            base_dir: folder that relative paths are looked up in first.
            segmenter: says which thing each pixel shows, in the place of hollow edges; see `learned.Segmenter`.
        """
        super().__init__()
        self.parting = ImageParting(arm, camera, params, packages, base_dir, segmenter)
        """What takes images apart, here or elsewhere."""
        self._robot = self.parting.robot
        self._arm_joints = self._robot.joint_count
        self._late = TUNING.late / camera.rate
        self._rgb = self.DeclareAbstractInputPort("rgb_image", Value[ImageRgba8U]())
        self._depth = self.DeclareAbstractInputPort("depth_image", Value[ImageDepth32F]())
        self._time = self.DeclareVectorInputPort("image_time", 1)
        self._arm = self.DeclareVectorInputPort("arm_state", 2 * self._arm_joints)
        self._calibration = self.DeclareVectorInputPort("calibration", CALIBRATION_SIZE)
        self._fingers = self.DeclareVectorInputPort("gripper_state", 2 * self._robot.finger_count)
        tickets = {self._rgb.ticket(), self._depth.ticket(), self._time.ticket()}
        self._hand = self.DeclareVectorInputPort("hand", HAND_SIZE)
        self._kept: int | None = None
        if params.latency > 0.0:
            index = self.DeclareDiscreteState(
                np.r_[NEVER, np.zeros(2 * self._arm_joints + SIZE + self._robot.finger_count), Hand().pack()]
            )
            self._kept = int(index)
            when = camera.latency + TUNING.after_delivery
            self.DeclarePeriodicDiscreteUpdateEvent(1.0 / camera.rate, when, self._keep)
            tickets |= {self.discrete_state_ticket(index)}
        else:
            beside = (self._arm, self._calibration, self._fingers, self._hand)
            tickets |= {port.ticket() for port in beside} | {self.time_ticket()}
        empty = self.parting.empty
        self.DeclareAbstractOutputPort("segments", lambda: AbstractValue.Make(empty), self._calc_segments, tickets)
        if self._kept is not None:
            none = self._none()
            self.DeclareAbstractOutputPort("picture", lambda: AbstractValue.Make(none), self._calc_picture, tickets)

    def _now(self, context: Context) -> Array:
        """Return time, x̂, errors of the calibration, fingers, NaN where not told, and hand, now, one after another."""
        errors = np.zeros(SIZE)
        if self._calibration.HasValue(context):
            errors = np.array(self._calibration.Eval(context))[:SIZE]
        fingers = np.full(self._robot.finger_count, np.nan)
        if self._fingers.HasValue(context):
            fingers = np.array(self._fingers.Eval(context))[: len(fingers)]
        hand = np.array(self._hand.Eval(context)) if self._hand.HasValue(context) else Hand().pack()
        return np.concatenate([[context.get_time()], np.array(self._arm.Eval(context)), errors, fingers, hand])

    def _keep(self, context: Context, discrete: DiscreteValues) -> None:
        discrete.set_value(self._kept, self._now(context))

    def _none(self) -> DeliveredImage:
        """Return what there is before the first image."""
        still = np.zeros(self._arm_joints)
        return DeliveredImage(
            NEVER, np.zeros((0, 0, 4), np.uint8), np.zeros((0, 0), np.float32), still, still, np.zeros(SIZE)
        )

    def _picture(self, context: Context) -> DeliveredImage:
        """Return the newest image with what goes with it; its arrays are views of what the ports hold."""
        image_time = float(self._time.Eval(context)[0])
        if image_time < 0.0:
            return self._none()
        rgb = cast(ImageRgba8U, self._rgb.Eval(context))
        depth = cast(ImageDepth32F, self._depth.Eval(context))
        n = self._arm_joints
        kept = self._now(context) if self._kept is None else np.array(context.get_discrete_state(self._kept).value())
        time, state, errors, fingers, hand = np.split(kept, [1, 1 + 2 * n, 1 + 2 * n + SIZE, len(kept) - HAND_SIZE])
        q = state[:n] - state[n:] * (time - image_time)
        told = fingers if np.isfinite(fingers).all() else np.zeros(0)
        return DeliveredImage(image_time, rgb.data, depth.data[..., 0], q, self._late * state[n:], errors, told, hand)

    @timed("Perception")
    def _calc_segments(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self.parting.apart(self._picture(context)))

    def _calc_picture(self, context: Context, output: AbstractValue) -> None:
        seen = self._picture(context)
        output.set_value(replace(seen, rgb=np.array(seen.rgb), depth=np.array(seen.depth)))
