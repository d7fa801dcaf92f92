"""Estimates how far the camera is from its calibration while the twin runs, from arm and table as it shows them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, DiscreteValues, LeafSystem
from pydrake.systems.sensors import ImageDepth32F

from twin_diagram import scenario
from twin_diagram.perception.alignment import Alignment
from twin_diagram.perception.calibration import calibrate, corrected
from twin_diagram.runtime.timing import timed
from twin_diagram.scenario.lenses import calibration_error
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import CALIBRATION_SIZE, SIZE
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station import ports
from twin_diagram.twin.arm_sensing.known_surfaces import TUNING as SURFACES
from twin_diagram.twin.arm_sensing.known_surfaces import ArmParts, ArmView


@dataclass(frozen=True)
class Tuning:
    """Which images count, chosen by hand: those that tell something new, of an arm at rest."""

    images: int = 14
    """So many are kept."""

    alike: int = 6
    """So many are taken of one place of the arm: what of their noise does not last averages."""

    turned: float = 0.15
    """The arm is in another place where a joint is so far from where it was [rad]."""

    rests: float = 0.003
    """None counts in which a joint has turned by more since the image before [rad]: depth comes half a frame late."""

    before_poses: float = 0.0005
    """The update comes this long after an image is delivered [s], half as long as that of the objects' poses."""


TUNING = Tuning()

_POINTS: Final = sum(SURFACES.most)
"""Points of an image that are kept, at most."""


class CameraCalibrator(LeafSystem):
    """Estimates the errors of the camera's calibration and what of them is left.

    .. pydrake_system::

        name: CameraCalibrator
        input_ports:
        - depth_image
        - image_time
        - arm_state
        output_ports:
        - calibration

    Ports:
        depth_image: (ImageDepth32F) of the twin's camera [m], 0 where there is none.
        image_time: (1) its capture time [s], `NEVER` before the first.
        arm_state: (2n) x̂ = (q, v) now [rad, rad/s].
        calibration: (10 + 100) errors, see `signals.calibration_error`, and their covariance row by row; before the
            first image none, and what the data sheet says.

    Rate: the camera's; half a millisecond after an image's delivery, so that the objects' poses, found right after, are
    of the camera as corrected. State: what a few images showed of arm and table, and the estimate; discrete vectors.
    """

    def __init__(
        self,
        arm: scenario.ArmModel,
        camera: scenario.Camera,
        perception: scenario.Perception,
        packages: Mapping[str, str | Path] | None = None,
    ) -> None:
        """Build the system.

        Args:
            arm: the twin's; its visible shapes are looked for.
            camera: as told, with what is told of its errors.
            perception: of it the table's height.
            packages: local folders for `package://` names.
        """
        super().__init__()
        self._alignment: Final = Alignment.of(camera)
        self._told: Final = calibration_error(camera)
        self._table: Final = perception.table_height
        self._parts: Final = ArmParts(arm, packages)
        n = self._parts.joints
        self._depth = self.DeclareAbstractInputPort("depth_image", Value[ImageDepth32F]())
        self._time = self.DeclareVectorInputPort("image_time", 1)
        self._arm = self.DeclareVectorInputPort("arm_state", 2 * n)
        self._row: Final = 3 + 2 * n + 4 * _POINTS
        self._kept = self.DeclareDiscreteState(cast(Any, np.zeros(1 + TUNING.images * self._row)))
        start = np.concatenate([np.zeros(SIZE), np.diag(self._told.variances).ravel()])
        self._estimate = self.DeclareDiscreteState(cast(Any, start))
        self._last = self.DeclareDiscreteState(cast(Any, np.r_[NEVER, np.full(n, np.inf)]))
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / camera.rate, camera.latency + TUNING.before_poses, self._update)

        def calc(context: Context, output: BasicVector) -> None:
            output.SetFromVector(context.get_discrete_state(int(self._estimate)).value())

        ticket = self.discrete_state_ticket(self._estimate)
        self.DeclareVectorOutputPort("calibration", CALIBRATION_SIZE, calc, prerequisites_of_calc={ticket})

    @timed("CameraCalibrator")
    def _update(self, context: Context, discrete: DiscreteValues) -> None:
        taken = float(cast(Array, self._time.Eval(context))[0])
        state = np.array(self._arm.Eval(context))
        before = np.array(context.get_discrete_state(int(self._last)).value())
        if taken <= before[0] or not np.isfinite(state).all():
            return
        n = self._parts.joints
        q, v = state[:n] - state[n:] * (context.get_time() - taken), state[n:]
        discrete.set_value(int(self._last), cast(Any, np.r_[taken, q]))
        # Before the first image the arm has not moved that anyone knows of.
        if before[0] >= 0.0 and np.abs(q - before[1:]).max(initial=0.0) > TUNING.rests:
            return
        kept = np.array(context.get_discrete_state(int(self._kept)).value())
        samples = self.samples(kept)
        if not tells_more(samples, q):
            return
        errors = np.array(context.get_discrete_state(int(self._estimate)).value())[:SIZE]
        camera, factor = corrected(self._alignment.camera, errors)
        depth = self._alignment.depth(cast(ImageDepth32F, self._depth.Eval(context)).data[..., 0])
        samples.append(self._parts.sample(depth, camera, factor, self._table, q, v))
        surfaces = self._parts.surfaces(samples, self._table)
        found = calibrate(surfaces, self._alignment.camera, self._told, errors if len(samples) > 1 else None)
        kept[0] = len(samples)
        start = 1 + (len(samples) - 1) * self._row
        kept[start : start + self._row] = self._packed(samples[-1])
        discrete.set_value(int(self._kept), cast(Any, kept))
        discrete.set_value(int(self._estimate), cast(Any, np.concatenate([found.errors, found.covariance.ravel()])))

    def recount(self, context: Context, change: Array) -> None:
        """Count angles anew: the arm was elsewhere in all images kept, by `change` (n,) [rad], in this Context.

        What they say of the camera is worked out anew from them.
        """
        n = self._parts.joints
        last = np.array(context.get_discrete_state(int(self._last)).value())
        kept = np.array(context.get_discrete_state(int(self._kept)).value())
        last[1:] += change
        kept[1:].reshape(-1, self._row)[:, 3 : 3 + n] += change
        context.SetDiscreteState(int(self._last), cast(Any, last))
        context.SetDiscreteState(int(self._kept), cast(Any, kept))
        if samples := self.samples(kept):
            found = calibrate(self._parts.surfaces(samples, self._table), self._alignment.camera, self._told)
            estimate = np.concatenate([found.errors, found.covariance.ravel()])
            context.SetDiscreteState(int(self._estimate), cast(Any, estimate))

    def samples(self, kept: Array) -> list[ArmView]:
        """Return what is kept of images, from its vector."""
        n = self._parts.joints
        found = []
        for row in kept[1:].reshape(-1, self._row)[: int(kept[0])]:
            count, arm, table = (int(x) for x in row[:3])
            points = row[3 + 2 * n :].reshape(_POINTS, 4)[:count]
            q, v = row[3 : 3 + n], row[3 + n : 3 + 2 * n]
            found.append(ArmView(q, v, points[:, :2], points[:, 2], points[:, 3], (arm, table)))
        return found

    def _packed(self, sample: ArmView) -> Array:
        points = np.zeros((_POINTS, 4))
        points[: len(sample.depth)] = np.column_stack([sample.pixels, sample.depth, sample.parts])
        return np.concatenate([[len(sample.depth), *sample.strides], sample.q, sample.v, points.ravel()])


def tells_more(samples: list[ArmView], q: Array) -> bool:
    """Return whether an image of the arm at q (n,) is worth being kept beside others."""
    if len(samples) >= TUNING.images:
        return False
    return sum(np.abs(q - other.q).max() <= TUNING.turned for other in samples) < TUNING.alike


def add_calibrator(
    builder: DiagramBuilder,
    arm: scenario.ArmModel,
    camera: scenario.Camera,
    perception: scenario.Perception,
    packages: Mapping[str, str | Path] | None = None,
    *,
    beside: bool = False,
) -> CameraCalibrator:
    """Add a calibrator to the twin, with the camera's images; `arm_state` is left to be connected.

    Where there are others `beside` it, it and its output have the camera's name, too.
    """
    own = f"camera_calibrator_{camera.name}" if beside else "camera_calibrator"
    calibrator = builder.AddNamedSystem(own, CameraCalibrator(arm, camera, perception, packages))
    for port, name in (("depth_image", ports.depth_image), ("image_time", ports.image_time)):
        builder.ConnectInput(name(camera.name), calibrator.GetInputPort(port))
    told = f"{camera.name}.calibration" if beside else "calibration"
    builder.ExportOutput(calibrator.GetOutputPort("calibration"), told)
    return calibrator
