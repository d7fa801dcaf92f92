"""The other end of the bus: a simulated world that speaks as a real arm's driver and a camera do.

For tests and demonstrations. The arm's side is made of Drake's own status senders and command receivers.
"""

from __future__ import annotations

from typing import Any

from pydrake.common.value import Value
from pydrake.lcm import DrakeLcmInterface
from pydrake.manipulation import (
    IiwaCommandReceiver,
    IiwaControlMode,
    IiwaStatusSender,
    PandaCommandReceiver,
    PandaControlMode,
    PandaStatusSender,
)
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, InputPort, LeafSystem, TriggerType
from pydrake.systems.lcm import LcmInterfaceSystem, LcmPublisherSystem, LcmSubscriberSystem
from pydrake.systems.primitives import Demultiplexer, Gain
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Camera, Scenario
from twin_diagram.station import ports
from twin_diagram.station.lcm.messages import PROTOCOLS, write_images
from twin_diagram.station.lcm.systems import TUNING as SYSTEMS
from twin_diagram.station.sim.station import SimStation


class ImageSender(LeafSystem):
    """Sends a camera's images.

    .. pydrake_system::

        name: ImageSender
        input_ports:
        - rgb_image
        - depth_image
        - image_time

    Sent `systems.Tuning.send_offset` after each delivery, stamped with the capture time.
    """

    def __init__(self, bus: DrakeLcmInterface, channel: str, camera: Camera) -> None:
        """Build a sender on a channel of a bus."""
        super().__init__()
        self._bus, self._channel, self._name = bus, channel, camera.name
        self._rgb = self.DeclareAbstractInputPort("rgb_image", Value(ImageRgba8U()))
        self._depth = self.DeclareAbstractInputPort("depth_image", Value(ImageDepth32F()))
        self._time = self.DeclareVectorInputPort("image_time", 1)
        self.DeclarePeriodicPublishEvent(1.0 / camera.rate, camera.latency + SYSTEMS.send_offset, self._send)

    def _send(self, context: Context) -> EventStatus:
        time = float(self._time.Eval(context)[0])
        if time < 0:
            return EventStatus.DidNothing()
        colour, depth = self._rgb.Eval(context).data, self._depth.Eval(context).data[..., 0]
        message = write_images(round(time * 1e6), self._name, colour, depth)
        self._bus.Publish(self._channel, message.encode())
        return EventStatus.Succeeded()


class LcmArm(Diagram):
    """A simulated station turned into an arm's driver and a camera on a bus; it has only the ports of `truth.*`.

    Status messages carry what the station measured at each period of the driver and go out `Tuning.send_offset` later;
    their time stamps are of the sending, as a real driver's. Commands act from the driver's next period on.

    Attributes:
        station: the simulated world.
    """

    station: SimStation

    def __init__(self, scenario: Scenario, bus: DrakeLcmInterface) -> None:
        """Build the world of `scenario` and join `bus`.

        Raises:
            ScenarioError: as `SimStation`, or an unknown kind of arm.
        """
        super().__init__()
        spec = scenario.lcm
        if spec.arm not in PROTOCOLS:
            raise ScenarioError("lcm.arm", f"{spec.arm!r} is none of {', '.join(PROTOCOLS)}")
        protocol = PROTOCOLS[spec.arm]
        builder = DiagramBuilder()
        station = SimStation(scenario)
        self.station = station
        builder.AddNamedSystem("world", station)
        interface = builder.AddNamedSystem("lcm", LcmInterfaceSystem(bus))
        n = station.GetInputPort(ports.POSITION_COMMANDED).size()
        period = 1.0 / scenario.twin.driver.rate
        with_torque = spec.control == "position_and_torque"

        command = LcmSubscriberSystem.Make(
            spec.command_channel or protocol.command_channel, protocol.command_type, interface, use_cpp_serializer=True
        )
        builder.AddNamedSystem("command_subscriber", command)
        state = builder.AddNamedSystem("true_position", Demultiplexer([n, n]))
        builder.Connect(station.GetOutputPort(ports.ARM_STATE), state.get_input_port())
        receiver, sender, velocity, sign = _translators(spec.arm, n, with_torque)
        builder.AddNamedSystem("command_receiver", receiver)
        builder.AddNamedSystem("status_sender", sender)
        builder.Connect(command.get_output_port(), receiver.get_message_input_port())
        # Before the first command the receiver passes on where the arm is.
        builder.Connect(state.get_output_port(0), receiver.get_position_measured_input_port())
        position = receiver.get_commanded_position_output_port()
        builder.Connect(position, station.GetInputPort(ports.POSITION_COMMANDED))
        if with_torque:
            torque = receiver.get_commanded_torque_output_port()
            builder.Connect(torque, station.GetInputPort(ports.TORQUE_COMMANDED))
        signed = builder.AddNamedSystem("torque_sign", Gain(sign, n))
        builder.Connect(station.GetOutputPort(ports.TORQUE_MEASURED), signed.get_input_port())
        builder.Connect(station.GetOutputPort(ports.POSITION_MEASURED), sender.get_position_measured_input_port())
        builder.Connect(station.GetOutputPort(ports.VELOCITY_ESTIMATED), velocity)
        builder.Connect(signed.get_output_port(), sender.get_torque_measured_input_port())
        builder.Connect(position, sender.get_position_commanded_input_port())
        builder.Connect(signed.get_output_port(), sender.get_torque_commanded_input_port())
        status = LcmPublisherSystem.Make(
            spec.status_channel or protocol.status_channel,
            protocol.status_type,
            interface,
            use_cpp_serializer=True,
            publish_triggers={TriggerType.kPeriodic},
            publish_period=period,
            publish_offset=SYSTEMS.send_offset,
        )
        builder.AddNamedSystem("status_publisher", status)
        builder.Connect(sender.get_output_port(), status.get_input_port())

        self._export(builder, bus, scenario)
        builder.BuildInto(self)
        self.set_name("lcm_arm")

    def _export(self, builder: DiagramBuilder, bus: DrakeLcmInterface, scenario: Scenario) -> None:
        """Send the camera's images over the bus, and show what is true."""
        station, camera = self.station, ports.only_camera(scenario.twin, "the arm behind LCM sends")
        if camera is not None:
            images = builder.AddNamedSystem("image_sender", ImageSender(bus, scenario.lcm.image_channel, camera))
            builder.Connect(station.GetOutputPort(ports.rgb_image(camera.name)), images.GetInputPort("rgb_image"))
            builder.Connect(station.GetOutputPort(ports.depth_image(camera.name)), images.GetInputPort("depth_image"))
            builder.Connect(station.GetOutputPort(ports.image_time(camera.name)), images.GetInputPort("image_time"))
        for name in ports.output_names(station):
            if name.startswith(ports.TRUTH):
                builder.ExportOutput(station.GetOutputPort(name), name)


def _translators(arm: str, joints: int, with_torque: bool) -> tuple[Any, Any, InputPort, float]:
    """Return Drake's systems between messages and ports: of commands, of status; its input of speeds, torque's sign."""
    if arm == "panda":
        mode = PandaControlMode.kPosition | (PandaControlMode.kTorque if with_torque else PandaControlMode.kNone)
        status = PandaStatusSender(joints)
        return PandaCommandReceiver(joints, mode), status, status.get_velocity_measured_input_port(), 1.0
    both = IiwaControlMode.kPositionAndTorque
    receiver = IiwaCommandReceiver(joints, both if with_torque else IiwaControlMode.kPositionOnly)
    sender = IiwaStatusSender(joints)
    return receiver, sender, sender.get_velocity_estimated_input_port(), -1.0
