"""The LCM station: a real arm's driver and a camera on a bus, in Drake's own messages."""

from __future__ import annotations

from typing import Final

import numpy as np
from drake import lcmt_image_array  # type: ignore[import-untyped]
from pydrake.lcm import DrakeLcm, DrakeLcmInterface
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.lcm import LcmInterfaceSystem
from pydrake.systems.primitives import ConstantVectorSource

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Scenario
from twin_diagram.station import ports
from twin_diagram.station.add_models import twin_arm
from twin_diagram.station.ignored_commands import IgnoredCommands
from twin_diagram.station.lcm.messages import PROTOCOLS
from twin_diagram.station.lcm.subscriber import subscriber
from twin_diagram.station.lcm.systems import ArmReceiver, CommandSender, ImageReceiver
from twin_diagram.station.sim.camera import check_camera

PROVIDERS: Final = ("udpm", "mpudpm", "tcpq", "memq", "file")
"""What LCM's URLs begin with."""


class LcmArmStation(Diagram):
    """A real arm behind the ports of every station: its driver and a camera, on an LCM bus.

    .. pydrake_system::

        name: LcmArmStation
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
    position mode wants. The gripper has a bus protocol of its own: its port tells nothing (NaN), its commands go
    nowhere.

    The simulator that runs this must keep to real time on a real bus.

    Attributes:
        bus: shared by all that is on it.
    """

    bus: DrakeLcmInterface

    def __init__(self, scenario: Scenario, bus: DrakeLcmInterface | None = None) -> None:
        """Join the bus.

        Args:
            scenario: of which `twin` and `lcm` are read.
            bus: to join; None: a new one at ``lcm.url``.

        Raises:
            ScenarioError: an unknown arm or control, or a camera that cannot be.
        """
        super().__init__()
        spec = scenario.lcm
        _check(scenario)
        protocol = PROTOCOLS[spec.arm]
        plant = MultibodyPlant(0.0)
        arm = twin_arm(scenario, plant)
        revolute = np.array([joint not in arm.prismatic(plant) for joint in arm.joints])
        n, g = len(arm.joints), len(arm.gripper_joints)
        camera = ports.only_camera(scenario.twin, "the lcm station reads")
        if camera is not None:
            check_camera(camera)
        self.bus = bus if bus is not None else open_bus(spec.url)

        builder = DiagramBuilder()
        interface = builder.AddNamedSystem("lcm", LcmInterfaceSystem(self.bus))
        status_channel = spec.status_channel or protocol.status_channel
        status = subscriber(status_channel, protocol.status_type, interface)
        builder.AddNamedSystem("status_subscriber", status)
        receiver = builder.AddNamedSystem("arm_receiver", ArmReceiver(protocol, revolute, status_channel))
        builder.Connect(status.get_output_port(), receiver.get_input_port())
        command_channel = spec.command_channel or protocol.command_channel
        with_torque = spec.control == "position_and_torque"
        sender = CommandSender(self.bus, command_channel, protocol, n, scenario.twin.driver.rate, with_torque)
        builder.AddNamedSystem("command_sender", sender)
        for name in ("clock", "turns"):
            builder.Connect(receiver.GetOutputPort(name), sender.GetInputPort(name))
        builder.ExportInput(sender.GetInputPort("position_commanded"), ports.POSITION_COMMANDED)
        builder.ExportInput(sender.GetInputPort("torque_commanded"), ports.TORQUE_COMMANDED)
        builder.ExportOutput(receiver.GetOutputPort("position_measured"), ports.POSITION_MEASURED)
        builder.ExportOutput(receiver.GetOutputPort("velocity_estimated"), ports.VELOCITY_ESTIMATED)
        builder.ExportOutput(receiver.GetOutputPort("torque_measured"), ports.TORQUE_MEASURED)
        builder.ExportOutput(receiver.GetOutputPort("measurement_time"), ports.MEASUREMENT_TIME)
        if g:
            gripper = builder.AddNamedSystem("no_gripper", IgnoredCommands({ports.GRIPPER_COMMANDED: g}))
            still = builder.AddNamedSystem("gripper_state", ConstantVectorSource(np.full(2 * g, np.nan)))
            builder.ExportInput(gripper.get_input_port(), ports.GRIPPER_COMMANDED)
            builder.ExportOutput(still.get_output_port(), ports.GRIPPER_MEASURED)
        if camera is not None:
            images = subscriber(spec.image_channel, lcmt_image_array, interface)
            builder.AddNamedSystem("image_subscriber", images)
            eye = builder.AddNamedSystem("image_receiver", ImageReceiver(camera, spec.depth_unit, spec.image_channel))
            builder.Connect(images.get_output_port(), eye.GetInputPort("message"))
            builder.Connect(receiver.GetOutputPort("clock"), eye.GetInputPort("clock"))
            builder.ExportOutput(eye.GetOutputPort("rgb_image"), ports.rgb_image(camera.name))
            builder.ExportOutput(eye.GetOutputPort("depth_image"), ports.depth_image(camera.name))
            builder.ExportOutput(eye.GetOutputPort("image_time"), ports.image_time(camera.name))
        builder.BuildInto(self)
        self.set_name("station")
        ports.check(self, n, g, (camera.name,) if camera else ())


def _check(scenario: Scenario) -> None:
    spec = scenario.lcm
    if spec.arm not in PROTOCOLS:
        raise ScenarioError("lcm.arm", f"{spec.arm!r} is none of {', '.join(PROTOCOLS)}")
    if spec.control not in ("position", "position_and_torque"):
        raise ScenarioError("lcm.control", f"{spec.control!r} is neither position nor position_and_torque")
    if not spec.depth_unit > 0:
        raise ScenarioError("lcm.depth_unit", f"{spec.depth_unit} is not positive")
    if not scenario.twin.driver.rate > 0:
        raise ScenarioError("twin.driver.rate", f"{scenario.twin.driver.rate} is not positive")


def open_bus(url: str) -> DrakeLcm:
    """Return a bus at an LCM URL; empty: LCM's default.

    Raises:
        ScenarioError: LCM does not take it.
    """
    # LCM itself only prints a line where it knows no such provider, and then stays silent for ever.
    if url and url.partition("://")[0] not in PROVIDERS:
        raise ScenarioError("lcm.url", f"{url!r} begins with none of {', '.join(f'{p}://' for p in PROVIDERS)}")
    return DrakeLcm(url) if url else DrakeLcm()
