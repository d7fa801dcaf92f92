"""The system of a camera as bad as real ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram.runtime.timing import timed
from twin_diagram.runtime.work_beside import WorkBeside
from twin_diagram.scenario import Scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.station.depth_units import Colour, Depth
from twin_diagram.station.sim.picture_taker import Exposure, PictureTaker


class RealCamera(LeafSystem):
    """Renders what the camera saw and turns it into what it delivers.

    .. pydrake_system::

        name: RealCamera
        input_ports:
        - colour_state
        - depth_state
        - capture_time
        output_ports:
        - rgb_image
        - depth_image
        - image_time

    `colour_state` and `depth_state` (nq + nv) are those of the world's plant when each was taken. `depth_image` is in
    the camera's units of length, a whole number of depth units, 0 where nothing was measured. `image_time` is the
    capture time of the colours [s], `NEVER` before the first, while images are black and empty. Computed where they are
    asked for, cached, a function of seed, capture time and states alone; adds no latency.
    """

    def __init__(self, scenario: Scenario, states: int) -> None:
        """Build the camera.

        Args:
            scenario: its ``twin.camera`` is not None, and its defects were checked.
            states: of the world's plant, nq + nv.
        """
        super().__init__()
        camera = scenario.twin.camera
        assert camera is not None
        self._camera, self._covered_at = camera, scenario.world.camera_defects.covered
        self._taker = PictureTaker(scenario)
        self._beside: WorkBeside[Exposure, tuple[Colour, Depth]] | None = None
        self._states = [self.DeclareVectorInputPort(name, states) for name in ("colour_state", "depth_state")]
        self._time = self.DeclareVectorInputPort("capture_time", 1)
        rgb, depth = Value(ImageRgba8U(camera.width, camera.height)), Value(ImageDepth32F(*camera.depth_size))
        ticket = {self._time.ticket(), *(port.ticket() for port in self._states)}
        self.DeclareAbstractOutputPort("rgb_image", rgb.Clone, self._calc_rgb, ticket)
        self.DeclareAbstractOutputPort("depth_image", depth.Clone, self._calc_depth, ticket)
        self.DeclareVectorOutputPort("image_time", 1, self._calc_time, {self._time.ticket()})

    @contextmanager
    def taken_beside(self) -> Iterator[Callable[[], None]]:
        """Have pictures be taken in a process of their own, from when they are captured, for as long as `with` lasts.

        Yields what waits until the process has begun.

        Without it they are taken when somebody looks at them, with the same result to the bit.
        """
        with WorkBeside[Exposure, tuple[Colour, Depth]](self._taker, "takes the camera's pictures") as beside:
            self._beside = beside
            try:
                yield beside.wait
            finally:
                self._beside = None

    def expect(self, colour_state: Array, depth_state: Array, time: float) -> None:
        """Tell that a picture will be looked at, as soon as it is captured; changes no result.

        Args:
            colour_state: (nq + nv), as on the input port later.
            depth_state: likewise.
            time: of the capture [s].
        """
        number = self._number(time)
        if number is not None and self._beside is not None:
            self._beside.ask(Exposure(number, colour_state.tobytes(), depth_state.tobytes()))

    def _number(self, time: float) -> int | None:
        """Return the number of a frame; None before the first and while the lens is covered."""
        if time < 0 or any(start <= time <= end for start, end in self._covered_at):
            return None
        return round(time * self._camera.rate)

    def _exposure(self, context: Context) -> Exposure | None:
        """Return what the newest frame is taken of."""
        number = self._number(float(self._time.Eval(context)[0]))
        return None if number is None else Exposure(number, *(port.Eval(context).tobytes() for port in self._states))

    def _taken(self, exposure: Exposure) -> tuple[Colour, Depth] | None:
        """Return the pictures of a frame that were taken beside; None where none were."""
        return None if self._beside is None else self._beside.answer(exposure)

    @timed("Camera")
    def _calc_rgb(self, context: Context, output: Value) -> None:
        image = ImageRgba8U(self._camera.width, self._camera.height)
        exposure = self._exposure(context)
        if exposure is None:
            image.mutable_data[:] = (0, 0, 0, 255)
        else:
            there = self._taken(exposure)
            image.mutable_data[:] = self._taker.colour(exposure) if there is None else there[0]
        output.set_value(image)

    @timed("Camera")
    def _calc_depth(self, context: Context, output: Value) -> None:
        image = ImageDepth32F(*self._camera.depth_size)
        exposure = self._exposure(context)
        if exposure is None:
            image.mutable_data[:] = 0.0
        else:
            there = self._taken(exposure)
            image.mutable_data[..., 0] = self._taker.depth(exposure) if there is None else there[1]
        output.set_value(image)

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        output[0] = self._time.Eval(context)[0]
