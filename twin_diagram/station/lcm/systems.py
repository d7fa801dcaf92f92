"""The systems between an LCM bus and a station's ports: an arm's messages, its commands, a camera's images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from drake import lcmt_image_array  # type: ignore[import-untyped]
from pydrake.common.value import Value
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram.errors import StationError
from twin_diagram.logs.unwrapping import turns_of
from twin_diagram.scenario import Camera
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station.lcm.messages import Protocol, read_images


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    send_offset: float = 1e-4
    """Commands are sent this long after a multiple of the driver's period [s]: after the systems that run at that
    time."""

    clock_tolerance: float = 1.0
    """A camera whose clock is off the arm's by more than this is taken to have a clock of its own [s]."""

    back: float = 1.0
    """Messages overtake one another; a sender whose stamps go back by more than this began anew [s]."""

    leap: float = 60.0
    """Stamps that go on by more than this from one message to the next are of a clock that was set [s]: loops that are
    slow or pause for a while, and arms that are silent, stay far below."""

    drift: float = 0.02
    """Clocks that part no faster than this are held together [s/s]: real ones part by 1e-4, simulated ones by more."""

    settle: float = 0.5
    """What has parted is taken out within about this [s]: slow beside a bus's jitter."""

    jitter: float = 0.01
    """What is late or early by less, or by less than two messages are apart, is the bus's [s]: a tick of a slow one."""

    parted: float = 0.05
    """What is early or late by more is no drift but a loop that is slow or a bus that is held up [s]."""


TUNING = Tuning()


def next_clock(clock: Array, utime: int, now: float) -> Array:
    """Return a clock once a message has come: it goes on with the sender's, and is held to the loop's.

    Clocks part slowly: counted by the sender's alone, messages would one day be old, or of the future. Where the
    sender's was set anew, time goes on from now.

    Args:
        clock: (3,) a stamp [µs], the time that it stands for [s], and how long messages usually are on the way [s].
        utime: of the message [µs].
        now: when it came [s].
    """
    stamp, time, usual = clock
    ahead = (utime - stamp) * 1e-6
    if time < 0.0 or -TUNING.back <= ahead <= 0.0:
        return clock
    if not 0.0 < ahead <= TUNING.leap:
        return np.array([utime, max(now - usual, time), usual])
    late = now - usual - (time + ahead)
    beyond = np.sign(late) * max(abs(late) - min(TUNING.jitter, 2.0 * ahead), 0.0)
    rate = np.clip(beyond / TUNING.settle, -TUNING.drift, TUNING.drift) if abs(late) <= TUNING.parted else 0.0
    return np.array([utime, time + ahead * (1.0 + rate), usual])


class ArmReceiver(LeafSystem):
    """Reads an arm's status messages.

    .. pydrake_system::

        name: ArmReceiver
        input_ports:
        - message
        output_ports:
        - position_measured
        - velocity_estimated
        - torque_measured
        - measurement_time
        - clock
        - turns

    Units and sizes as on any station; zeros and `NEVER` before the first message. Angles that jump by a turn from one
    message to the next are taken to go on; `turns` (n) [rad] is what was added to the newest for that.
    `measurement_time` is the message's own time stamp, on a clock that starts where the first message arrives: a
    constant delay of the bus is not seen, its jitter is. A driver's clock that runs slower or faster than the loop's is
    followed; where it is set anew, as when it is started again, time goes on. `clock` (2): a utime [µs] and the time
    that it stands for [s], `NEVER` before the first message. Latency: the bus's.
    """

    def __init__(self, protocol: Protocol, revolute: npt.NDArray[np.bool_], channel: str) -> None:
        """Build a receiver.

        Args:
            protocol: of the arm.
            revolute: (n,) which of its joints turn.
            channel: for messages about errors.
        """
        super().__init__()
        n = len(revolute)
        self._protocol, self._n, self._channel = protocol, n, channel
        self._turn = np.where(revolute, 2.0 * np.pi, 0.0)
        self._message = self.DeclareAbstractInputPort("message", Value(protocol.status_type()))
        # Clock, see `next_clock`; the newest angles as they came, and what was added to them [rad].
        state = self.DeclareDiscreteState(np.concatenate([[0.0, NEVER, 0.0], np.full(n, np.nan), np.zeros(n)]))
        # A message changes the state by an update of its own at some time or other; this one follows it at the same
        # time.
        self.DeclarePerStepDiscreteUpdateEvent(self._keep)
        message, clock = self._message.ticket(), self.discrete_state_ticket(state)
        self.DeclareVectorOutputPort("position_measured", n, self._calc_position, {message, clock})
        self.DeclareVectorOutputPort("turns", n, self._calc_turns, {message, clock})
        for name in ("velocity", "torque"):

            def calc(context: Context, output: BasicVector, name: str = name) -> None:
                if context.get_discrete_state_vector().value()[1] < 0:
                    output.SetFromVector(np.zeros(n))
                else:
                    output.SetFromVector(getattr(self._status(context), name))

            port = {"velocity": "velocity_estimated"}.get(name, f"{name}_measured")
            self.DeclareVectorOutputPort(port, n, calc, {message, clock})
        now = self.time_ticket()
        self.DeclareVectorOutputPort("measurement_time", 1, self._calc_time, {message, clock, now})
        self.DeclareVectorOutputPort("clock", 2, self._calc_clock, {message, clock, now})

    def _status(self, context: Context):  # type: ignore[no-untyped-def]
        status = self._protocol.read_status(self._message.Eval(context))
        if not len(status.position) == len(status.velocity) == len(status.torque) == self._n:
            raise StationError(
                f"{self._channel} tells of {len(status.position)} joints; the twin's arm has {self._n}: "
                "name the arm's own joints under twin.arm.joints"
            )
        return status

    def _keep(self, context: Context, discrete: DiscreteValues) -> None:
        state = np.array(context.get_discrete_state_vector().value())
        message, n = self._message.Eval(context), self._n
        if state[1] < 0 and message.num_joints > 0:
            state[:3] = message.utime, context.get_time(), 0.0
        elif state[1] >= 0:
            state[:3] = self._clock(context)
        if message.num_joints == n:  # what is wrong with others is said where they are used
            state[3 + n :] = self._turns(context)
            came = self._status(context).position
            state[3 : 3 + n] = np.where(np.isfinite(came), came, state[3 : 3 + n])
        discrete.set_value(state)

    def _clock(self, context: Context) -> Array:
        """Return (3,) the clock as it counts for the newest message."""
        clock = context.get_discrete_state_vector().value()[:3]
        return next_clock(clock, self._message.Eval(context).utime, context.get_time())

    def _turns(self, context: Context) -> Array:
        """Return (n,) what is to be added to the angles of the newest message, so that they go on [rad]."""
        last, turns = context.get_discrete_state_vector().value()[3:].reshape(2, self._n)
        result: Array = turns - self._turn * turns_of(self._status(context).position - last)
        return result

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        known = context.get_discrete_state_vector().value()[1] >= 0
        output.SetFromVector(self._status(context).position + self._turns(context) if known else np.zeros(self._n))

    def _calc_turns(self, context: Context, output: BasicVector) -> None:
        known = context.get_discrete_state_vector().value()[1] >= 0
        output.SetFromVector(self._turns(context) if known else np.zeros(self._n))

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        utime, start, _ = self._clock(context)
        output[0] = NEVER if start < 0 else start + (self._message.Eval(context).utime - utime) * 1e-6

    def _calc_clock(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._clock(context)[:2])


class CommandSender(LeafSystem):
    """Sends commands to an arm's driver.

    .. pydrake_system::

        name: CommandSender
        input_ports:
        - position_commanded
        - torque_commanded
        - clock
        - turns

    Positions go out in the turn that the driver counts in: less `turns` (n) [rad], see `ArmReceiver`. Sent
    `Tuning.send_offset` after each period of the driver, with the driver's own time, which drivers check. Nothing is
    sent before the first status message, nor while there is no command (unconnected, or a NaN in it).
    """

    def __init__(
        self, bus: DrakeLcmInterface, channel: str, protocol: Protocol, n: int, rate: float, with_torque: bool
    ) -> None:
        """Build a sender.

        Args:
            bus: where to.
            channel: which.
            protocol: of the arm.
            n: number of arm joints.
            rate: commands per second.
            with_torque: whether the driver takes torques too.
        """
        super().__init__()
        self._bus, self._channel, self._protocol, self._with_torque = bus, channel, protocol, with_torque
        self._position = self.DeclareVectorInputPort("position_commanded", n)
        self._torque = self.DeclareVectorInputPort("torque_commanded", n)
        self._clock = self.DeclareVectorInputPort("clock", 2)
        self._turns = self.DeclareVectorInputPort("turns", n)
        self.DeclarePeriodicPublishEvent(1.0 / rate, TUNING.send_offset, self._send)

    def _send(self, context: Context) -> EventStatus:
        utime, start = self._clock.Eval(context)
        if start < 0 or not self._position.HasValue(context):
            return EventStatus.DidNothing()
        position = self._position.Eval(context) - self._turns.Eval(context)
        if not np.all(np.isfinite(position)):
            return EventStatus.DidNothing()
        torque = None
        if self._with_torque:
            torque = np.zeros(len(position))
            if self._torque.HasValue(context):
                torque = np.nan_to_num(self._torque.Eval(context), nan=0.0, posinf=0.0, neginf=0.0)
        now = int(utime) + round((context.get_time() - start) * 1e6)
        self._bus.Publish(self._channel, self._protocol.write_command(now, position, torque).encode())
        return EventStatus.Succeeded()


class ImageReceiver(LeafSystem):
    """Reads a camera's messages.

    .. pydrake_system::

        name: ImageReceiver
        input_ports:
        - message
        - clock
        output_ports:
        - rgb_image
        - depth_image
        - image_time

    As on any station; black, empty and `NEVER` before the first message. `image_time` is the message's own time stamp
    on the arm's clock; where the camera's clock is not the arm's, the first image counts as taken `latency` before it
    came. A camera's clock that runs slower or faster is followed, and where it is set anew, time goes on. Latency: the
    camera's and the bus's.
    """

    def __init__(self, camera: Camera, depth_unit: float, channel: str) -> None:
        """Build a receiver.

        Args:
            camera: that the twin was told of.
            depth_unit: depths are rounded to a whole number of these [m].
            channel: for messages about errors.
        """
        super().__init__()
        self._camera, self._unit, self._channel = camera, depth_unit, channel
        self._message = self.DeclareAbstractInputPort("message", Value(lcmt_image_array()))
        self._clock = self.DeclareVectorInputPort("clock", 2)
        state = self.DeclareDiscreteState(np.array([0.0, NEVER, 0.0]))  # a clock, see `next_clock`
        self.DeclarePerStepDiscreteUpdateEvent(self._keep_clock)
        tickets = {self._message.ticket(), self.discrete_state_ticket(state)}
        rgb, depth = ImageRgba8U(camera.width, camera.height), ImageDepth32F(*camera.depth_size)
        self.DeclareAbstractOutputPort("rgb_image", Value(rgb).Clone, self._calc_rgb, tickets)
        self.DeclareAbstractOutputPort("depth_image", Value(depth).Clone, self._calc_depth, tickets)
        self.DeclareVectorOutputPort("image_time", 1, self._calc_time, tickets | {self.time_ticket()})

    def _keep_clock(self, context: Context, discrete: DiscreteValues) -> None:
        clock = context.get_discrete_state_vector().value()
        message = self._message.Eval(context)
        if clock[1] < 0 and message.num_images > 0:
            now, utime = context.get_time(), message.header.utime
            arm_utime, arm_start = self._clock.Eval(context)
            capture = arm_start + (utime - arm_utime) * 1e-6
            if arm_start < 0 or abs(now - capture) > TUNING.clock_tolerance:
                capture = now - self._camera.latency
            capture = max(capture, 0.0)
            clock = np.array([utime, capture, now - capture])
        elif clock[1] >= 0.0:
            clock = self._newest_clock(context)
        discrete.set_value(clock)

    def _newest_clock(self, context: Context) -> Array:
        """Return (3,) the clock as it counts for the newest message."""
        clock = np.array(context.get_discrete_state_vector().value())
        return next_clock(clock, self._message.Eval(context).header.utime, context.get_time())

    def _images(self, context: Context):  # type: ignore[no-untyped-def]
        """Colour and depth, None before the first."""
        if context.get_discrete_state_vector().value()[1] < 0:
            return None
        colour, depth = read_images(self._message.Eval(context), self._unit)
        camera = self._camera
        for kind, image, size in (
            ("colour", colour, (camera.width, camera.height)),
            ("depth", depth, camera.depth_size),
        ):
            if image is None:
                raise StationError(
                    f"{self._channel}: a message without a {kind} image; the twin needs both in one message"
                )
            if image.shape[1::-1] != size:
                raise StationError(
                    f"{self._channel}: a {kind} image of {image.shape[1]}×{image.shape[0]} pixels; "
                    f"twin.camera says {size[0]}×{size[1]}"
                )
        return colour, depth

    def _calc_rgb(self, context: Context, output: Value) -> None:
        image = ImageRgba8U(self._camera.width, self._camera.height)
        images = self._images(context)
        image.mutable_data[:] = (0, 0, 0, 255) if images is None else images[0]
        output.set_value(image)

    def _calc_depth(self, context: Context, output: Value) -> None:
        image = ImageDepth32F(*self._camera.depth_size)
        images = self._images(context)
        image.mutable_data[..., 0] = 0.0 if images is None else images[1]
        output.set_value(image)

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        utime, start, _ = self._newest_clock(context)
        output[0] = NEVER if start < 0 else start + (self._message.Eval(context).header.utime - utime) * 1e-6
