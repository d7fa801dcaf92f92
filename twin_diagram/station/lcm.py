"""The LCM station: a real arm's driver and a camera on a bus, in Drake's own messages."""

from __future__ import annotations

import numpy as np
from drake import lcmt_image_array  # type: ignore[import-untyped]
from pydrake.common.value import Value
from pydrake.lcm import DrakeLcm, DrakeLcmInterface
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
    LeafSystem,
)
from pydrake.systems.lcm import LcmInterfaceSystem, LcmSubscriberSystem
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram.errors import ScenarioError, StationError
from twin_diagram.scenario import Camera, Scenario
from twin_diagram.signals import NEVER
from twin_diagram.station import ports
from twin_diagram.station.camera import check_camera
from twin_diagram.station.ignored import IgnoredCommands
from twin_diagram.station.lcm_messages import PROTOCOLS, Protocol, read_images
from twin_diagram.station.parsing import twin_arm

SEND_OFFSET = 1e-4
"""Commands are sent this long after a multiple of the driver's period [s]: after the systems that run at that time."""
CLOCK_TOLERANCE = 1.0
"""A camera whose clock is off the arm's by more than this is taken to have a clock of its own [s]."""
PROVIDERS = ("udpm", "mpudpm", "tcpq", "memq", "file")
"""What LCM's URLs begin with."""


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

    Units and sizes as on any station; zeros and `NEVER` before the first message. `measurement_time` is the message's
    own time stamp, on a clock that starts where the first message arrives: a constant delay of the bus is not seen,
    its jitter is. `clock` (2): the first message's utime [µs] and when it came [s], `NEVER` before. Latency: the
    bus's.
    """

    def __init__(self, protocol: Protocol, n: int, channel: str) -> None:
        """`n` arm joints; `channel` for messages about errors."""
        super().__init__()
        self._protocol, self._n, self._channel = protocol, n, channel
        self._message = self.DeclareAbstractInputPort("message", Value(protocol.status_type()))
        state = self.DeclareDiscreteState(np.array([0.0, NEVER]))
        # A message changes the state by an update of its own at some time or other; this one follows it at the same
        # time.
        self.DeclarePerStepDiscreteUpdateEvent(self._start_clock)
        message, clock = self._message.ticket(), self.discrete_state_ticket(state)
        for name in ("position", "velocity", "torque"):

            def calc(context: Context, output: BasicVector, name: str = name) -> None:
                if context.get_discrete_state_vector().value()[1] < 0:
                    output.SetFromVector(np.zeros(n))
                else:
                    output.SetFromVector(getattr(self._status(context), name))

            port = {"velocity": "velocity_estimated"}.get(name, f"{name}_measured")
            self.DeclareVectorOutputPort(port, n, calc, {message, clock})
        self.DeclareVectorOutputPort("measurement_time", 1, self._calc_time, {message, clock})
        self.DeclareVectorOutputPort("clock", 2, self._calc_clock, {clock})

    def _status(self, context: Context):  # type: ignore[no-untyped-def]
        status = self._protocol.read_status(self._message.Eval(context))
        if not len(status.position) == len(status.velocity) == len(status.torque) == self._n:
            raise StationError(
                f"{self._channel} tells of {len(status.position)} joints; the twin's arm has {self._n}: "
                "name the arm's own joints under twin.arm.joints"
            )
        return status

    def _start_clock(self, context: Context, discrete: DiscreteValues) -> None:
        clock = context.get_discrete_state_vector().value()
        if clock[1] < 0 and self._message.Eval(context).num_joints > 0:
            clock = np.array([self._message.Eval(context).utime, context.get_time()])
        discrete.set_value(clock)

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        utime, start = context.get_discrete_state_vector().value()
        output[0] = NEVER if start < 0 else start + (self._message.Eval(context).utime - utime) * 1e-6

    def _calc_clock(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value())


class CommandSender(LeafSystem):
    """Sends commands to an arm's driver.

    .. pydrake_system::

        name: CommandSender
        input_ports:
        - position_commanded
        - torque_commanded
        - clock

    Sent `SEND_OFFSET` after each period of the driver, with the driver's own time, which drivers check. Nothing is sent
    before the first status message, nor while there is no command (unconnected, or a NaN in it).
    """

    def __init__(
        self, bus: DrakeLcmInterface, channel: str, protocol: Protocol, n: int, rate: float, with_torque: bool
    ) -> None:
        """Builds a sender.

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
        self.DeclarePeriodicPublishEvent(1.0 / rate, SEND_OFFSET, self._send)

    def _send(self, context: Context) -> EventStatus:
        utime, start = self._clock.Eval(context)
        if start < 0 or not self._position.HasValue(context):
            return EventStatus.DidNothing()
        position = self._position.Eval(context)
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
    came. Latency: the camera's and the bus's.
    """

    def __init__(self, camera: Camera, depth_unit: float, channel: str) -> None:
        """Builds a receiver.

        Args:
            camera: that the twin was told of.
            depth_unit: depths are rounded to a whole number of these [m].
            channel: for messages about errors.
        """
        super().__init__()
        self._camera, self._unit, self._channel = camera, depth_unit, channel
        self._message = self.DeclareAbstractInputPort("message", Value(lcmt_image_array()))
        self._clock = self.DeclareVectorInputPort("clock", 2)
        state = self.DeclareDiscreteState(np.array([0.0, NEVER]))
        self.DeclarePerStepDiscreteUpdateEvent(self._start_clock)
        tickets = {self._message.ticket(), self.discrete_state_ticket(state)}
        rgb, depth = ImageRgba8U(camera.width, camera.height), ImageDepth32F(camera.width, camera.height)
        self.DeclareAbstractOutputPort("rgb_image", Value(rgb).Clone, self._calc_rgb, tickets)
        self.DeclareAbstractOutputPort("depth_image", Value(depth).Clone, self._calc_depth, tickets)
        self.DeclareVectorOutputPort("image_time", 1, self._calc_time, tickets)

    def _start_clock(self, context: Context, discrete: DiscreteValues) -> None:
        clock = context.get_discrete_state_vector().value()
        message = self._message.Eval(context)
        if clock[1] < 0 and message.num_images > 0:
            now, utime = context.get_time(), message.header.utime
            arm_utime, arm_start = self._clock.Eval(context)
            capture = arm_start + (utime - arm_utime) * 1e-6
            if arm_start < 0 or abs(now - capture) > CLOCK_TOLERANCE:
                capture = now - self._camera.latency
            clock = np.array([utime, max(capture, 0.0)])
        discrete.set_value(clock)

    def _images(self, context: Context):  # type: ignore[no-untyped-def]
        """Colour and depth, None before the first."""
        if context.get_discrete_state_vector().value()[1] < 0:
            return None
        colour, depth = read_images(self._message.Eval(context), self._unit)
        wanted = (self._camera.height, self._camera.width)
        for kind, image in (("colour", colour), ("depth", depth)):
            if image is None:
                raise StationError(
                    f"{self._channel}: a message without a {kind} image; the twin needs both in one message"
                )
            if image.shape[:2] != wanted:
                raise StationError(
                    f"{self._channel}: a {kind} image of {image.shape[1]}×{image.shape[0]} pixels; "
                    f"twin.camera says {wanted[1]}×{wanted[0]}"
                )
        return colour, depth

    def _calc_rgb(self, context: Context, output: Value) -> None:
        image = ImageRgba8U(self._camera.width, self._camera.height)
        images = self._images(context)
        image.mutable_data[:] = (0, 0, 0, 255) if images is None else images[0]
        output.set_value(image)

    def _calc_depth(self, context: Context, output: Value) -> None:
        image = ImageDepth32F(self._camera.width, self._camera.height)
        images = self._images(context)
        image.mutable_data[..., 0] = 0.0 if images is None else images[1]
        output.set_value(image)

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        utime, start = context.get_discrete_state_vector().value()
        output[0] = NEVER if start < 0 else start + (self._message.Eval(context).header.utime - utime) * 1e-6


class LcmStation(Diagram):
    """A real arm behind the ports of every station: its driver and a camera, on an LCM bus.

    .. pydrake_system::

        name: LcmStation
        input_ports:
        - arm.position_commanded
        - arm.torque_commanded
        - gripper.position_commanded
        output_ports:
        - arm.position_measured
        - arm.velocity_estimated
        - arm.torque_measured
        - arm.measurement_time
        - gripper.state_measured
        - <camera>.rgb_image
        - <camera>.depth_image
        - <camera>.image_time

    Works with the public drivers for Franka arms (``lcmt_panda_status``, ``lcmt_panda_command``) and KUKA iiwa arms
    (``lcmt_iiwa_status``, ``lcmt_iiwa_command``), and with anything that sends ``lcmt_image_array``. Torques on the
    port are positive along the joint and hold gravity's part; a Panda's are its sensors' (tau_J), an iiwa's messages
    have the other sign. With ``lcm.control`` at ``position``, torque commands are dropped, which is what a driver in
    position mode wants. The gripper has a bus protocol of its own: its port shows zeros, its commands go nowhere.

    The simulator that runs this must keep to real time on a real bus.

    Attributes:
        bus: shared by all that is on it.
    """

    bus: DrakeLcmInterface

    def __init__(self, scenario: Scenario, bus: DrakeLcmInterface | None = None) -> None:
        """Joins the bus.

        Args:
            scenario: of which `twin` and `lcm` are read.
            bus: to join; None: a new one at ``lcm.url``.

        Raises:
            ScenarioError: an unknown arm or control, or a camera that cannot be.
        """
        super().__init__()
        spec = scenario.lcm
        if spec.arm not in PROTOCOLS:
            raise ScenarioError("lcm.arm", f"{spec.arm!r} is none of {', '.join(PROTOCOLS)}")
        if spec.control not in ("position", "position_and_torque"):
            raise ScenarioError("lcm.control", f"{spec.control!r} is neither position nor position_and_torque")
        if not spec.depth_unit > 0:
            raise ScenarioError("lcm.depth_unit", f"{spec.depth_unit} is not positive")
        if not scenario.twin.driver.rate > 0:
            raise ScenarioError("twin.driver.rate", f"{scenario.twin.driver.rate} is not positive")
        protocol = PROTOCOLS[spec.arm]
        arm = twin_arm(scenario)
        n, g = len(arm.joints), len(arm.gripper_joints)
        camera = scenario.twin.camera
        if camera is not None:
            check_camera(camera)
        self.bus = bus if bus is not None else open_bus(spec.url)

        builder = DiagramBuilder()
        interface = builder.AddNamedSystem("lcm", LcmInterfaceSystem(self.bus))
        status_channel = spec.status_channel or protocol.status_channel
        status = LcmSubscriberSystem.Make(status_channel, protocol.status_type, interface)
        builder.AddNamedSystem("status_subscriber", status)
        receiver = builder.AddNamedSystem("arm_receiver", ArmReceiver(protocol, n, status_channel))
        builder.Connect(status.get_output_port(), receiver.get_input_port())
        command_channel = spec.command_channel or protocol.command_channel
        with_torque = spec.control == "position_and_torque"
        sender = CommandSender(self.bus, command_channel, protocol, n, scenario.twin.driver.rate, with_torque)
        builder.AddNamedSystem("command_sender", sender)
        builder.Connect(receiver.GetOutputPort("clock"), sender.GetInputPort("clock"))
        builder.ExportInput(sender.GetInputPort("position_commanded"), ports.POSITION_COMMANDED)
        builder.ExportInput(sender.GetInputPort("torque_commanded"), ports.TORQUE_COMMANDED)
        builder.ExportOutput(receiver.GetOutputPort("position_measured"), ports.POSITION_MEASURED)
        builder.ExportOutput(receiver.GetOutputPort("velocity_estimated"), ports.VELOCITY_ESTIMATED)
        builder.ExportOutput(receiver.GetOutputPort("torque_measured"), ports.TORQUE_MEASURED)
        builder.ExportOutput(receiver.GetOutputPort("measurement_time"), ports.MEASUREMENT_TIME)
        if g:
            gripper = builder.AddNamedSystem("no_gripper", IgnoredCommands({ports.GRIPPER_COMMANDED: g}))
            still = builder.AddNamedSystem("gripper_state", ConstantVectorSource(np.zeros(2 * g)))
            builder.ExportInput(gripper.get_input_port(), ports.GRIPPER_COMMANDED)
            builder.ExportOutput(still.get_output_port(), ports.GRIPPER_MEASURED)
        if camera is not None:
            images = LcmSubscriberSystem.Make(spec.image_channel, lcmt_image_array, interface)
            builder.AddNamedSystem("image_subscriber", images)
            eye = builder.AddNamedSystem("image_receiver", ImageReceiver(camera, spec.depth_unit, spec.image_channel))
            builder.Connect(images.get_output_port(), eye.GetInputPort("message"))
            builder.Connect(receiver.GetOutputPort("clock"), eye.GetInputPort("clock"))
            builder.ExportOutput(eye.GetOutputPort("rgb_image"), ports.rgb_image(camera.name))
            builder.ExportOutput(eye.GetOutputPort("depth_image"), ports.depth_image(camera.name))
            builder.ExportOutput(eye.GetOutputPort("image_time"), ports.image_time(camera.name))
        builder.BuildInto(self)
        self.set_name("station")
        ports.check(self, n, g, camera.name if camera else None)


def open_bus(url: str) -> DrakeLcm:
    """A bus at an LCM URL; empty: LCM's default.

    Raises:
        ScenarioError: LCM does not take it.
    """
    # LCM itself only prints a line where it knows no such provider, and then stays silent for ever.
    if url and url.partition("://")[0] not in PROVIDERS:
        raise ScenarioError("lcm.url", f"{url!r} begins with none of {', '.join(f'{p}://' for p in PROVIDERS)}")
    return DrakeLcm(url) if url else DrakeLcm()
