"""The LCM station: Drake's own messages from Drake's own systems; the same run on `sim` and over a bus in memory."""

from __future__ import annotations

import zlib

import cv2
import numpy as np
import pytest
from drake import (
    lcmt_iiwa_command,
    lcmt_image,
    lcmt_image_array,
    lcmt_panda_command,
    lcmt_panda_status,
)
from pydrake.common.value import Value
from pydrake.lcm import DrakeLcm, Subscriber
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, DiscreteValues, LeafSystem, PortDataType
from pydrake.systems.lcm import LcmPublisherSystem, LcmSubscriberSystem
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource
from pydrake.systems.sensors import (
    ImageDepth16U,
    ImageDepth32F,
    ImageRgba8U,
    ImageToLcmImageArrayT,
    PixelType,
)

from twin_diagram.errors import ScenarioError, StationError
from twin_diagram.scenario import ArmModel, Camera, Fixture, Pose, Scenario, WorldObject
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.layouts import TRACK_SIZE
from twin_diagram.station import make_station, ports
from twin_diagram.station.lcm.fake_arm import LcmArm
from twin_diagram.station.lcm.messages import PROTOCOLS, read_images, write_images
from twin_diagram.station.lcm.station import LcmArmStation
from twin_diagram.station.lcm.systems import TUNING as SYSTEMS
from twin_diagram.station.lcm.systems import next_clock
from twin_diagram.twin.closed_loop import make_closed_loop

HOME = [0.3, 0.2, -0.1, -2.0, 0.1, 2.2, 0.9]
UNIT = 0.00025


def scenario(station: str = "lcm", arm: str = "panda", camera: bool = False) -> Scenario:
    plan = Scenario(seed=2, station=station)
    plan.lcm.url, plan.lcm.arm, plan.lcm.control = "memq://", arm, "position_and_torque"
    if arm == "iiwa":
        plan.world.arm = plan.twin.arm = ArmModel(model="arms/iiwa7.urdf", tool_frame="")
    plan.world.fixtures = [Fixture("scenes/table.sdf")]
    plan.world.objects = {"can": WorldObject("objects/can", Pose([0.5, 0.2, 0.051]))} if camera else {}
    plan.twin.home = list(HOME)
    pose = Pose([1.4, 0.0, 0.85], [-2.2689, 0.0, 1.5708])
    plan.twin.camera = Camera(X_WC=pose, width=80, height=60, focal=75.0) if camera else None
    return plan


class Wave(LeafSystem):
    """A command that begins after a while."""

    def __init__(self, size: int = 7) -> None:
        super().__init__()
        self.DeclareVectorOutputPort("command", size, self._calc, {self.time_ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        t = context.get_time() - 0.05
        output.SetFromVector(np.array(HOME) + 0.2 * np.sin(2 * t) ** 2 if t > 0 else np.full(7, np.nan))


class Consumer(LeafSystem):
    """Looks at a station's ports at 200 Hz, and at its camera 1 ms after each delivery."""

    def __init__(self, station) -> None:  # type: ignore[no-untyped-def]
        super().__init__()
        self.names = [n for n in ports.output_names(station) if not n.startswith(ports.TRUTH)]
        for name in self.names:
            port = station.GetOutputPort(name)
            if port.get_data_type() == PortDataType.kVectorValued:
                self.DeclareVectorInputPort(name, port.size())
            else:
                self.DeclareAbstractInputPort(name, port.Allocate())
        self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(0.005, 0.0, self._look)
        self.DeclarePeriodicDiscreteUpdateEvent(1 / 15, 0.036, self._see)
        self.rows: dict[str, list[np.ndarray]] = {}

    def _keep(self, context: Context, image: bool) -> None:
        for name in self.names:
            if name.startswith("camera") == image:
                value = self.GetInputPort(name).Eval(context)
                self.rows.setdefault(name, []).append(np.array(value if isinstance(value, np.ndarray) else value.data))

    def _look(self, context: Context, discrete: DiscreteValues) -> None:
        self._keep(context, False)

    def _see(self, context: Context, discrete: DiscreteValues) -> None:
        self._keep(context, True)


def run(plan: Scenario, duration: float) -> dict[str, np.ndarray]:
    builder = DiagramBuilder()
    station = make_station(plan)
    builder.AddNamedSystem("station", station)
    if isinstance(station, LcmArmStation):
        builder.AddNamedSystem("arm", LcmArm(plan, station.bus))
    wave, consumer = builder.AddSystem(Wave()), Consumer(station)
    builder.AddSystem(consumer)
    builder.Connect(wave.get_output_port(), station.GetInputPort(ports.POSITION_COMMANDED))
    for name in consumer.names:
        builder.Connect(station.GetOutputPort(name), consumer.GetInputPort(name))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(duration)
    return {name: np.array(rows) for name, rows in consumer.rows.items()}


def test_all_stations_have_the_same_ports(tmp_path) -> None:
    stations = [make_station(scenario("sim")), make_station(scenario("lcm"))]
    log = tmp_path / "log.csv"
    names = [f"{signal}.panda_joint{k}" for signal in ("position_measured", "torque_measured") for k in range(1, 8)]
    log.write_text("\n".join([",".join(["time", *names]), *(f"{0.1 * k}" + ",0.5" * 14 for k in range(12))]))
    plan = scenario("replay")
    plan.replay.log = str(log)
    stations.append(make_station(plan))
    for station in stations:
        ports.check(station, 7, 2, ())
    assert not any(name.startswith(ports.TRUTH) for s in stations[1:] for name in ports.output_names(s))


@pytest.mark.parametrize("arm", ["panda", "iiwa"])
def test_the_bus_shows_what_the_simulation_shows(arm: str) -> None:
    """Messages as fresh as in the simulation; commands come a period of the driver later."""
    live, bus = run(scenario("sim", arm), 0.8), run(scenario("lcm", arm), 0.8)
    time, other = live[ports.MEASUREMENT_TIME][:, 0], bus[ports.MEASUREMENT_TIME][:, 0]
    assert time[0] < 0 and other[0] < 0
    assert np.allclose(other[1:] - time[1:], SYSTEMS.send_offset, atol=2e-6)
    before = time < 0.05
    for name in (ports.POSITION_MEASURED, ports.VELOCITY_ESTIMATED, ports.TORQUE_MEASURED):
        assert np.array_equal(live[name][before], bus[name][before])
    lag = 0.0026  # a period of the driver and the offset of sending
    speed = 0.2 * 2
    assert np.abs(live[ports.POSITION_MEASURED] - bus[ports.POSITION_MEASURED]).max() < 1.3 * lag * speed
    assert np.abs(live[ports.POSITION_MEASURED] - bus[ports.POSITION_MEASURED]).max() > 1e-4
    assert np.abs(live[ports.TORQUE_MEASURED] - bus[ports.TORQUE_MEASURED]).max() < 2.5


def test_images_over_the_bus(egl) -> None:
    plan = scenario("lcm", camera=True)
    plan.lcm.control = "position"
    live, bus = run(scenario("sim", camera=True), 0.3), run(plan, 0.3)
    assert np.allclose(live["camera.image_time"], bus["camera.image_time"], atol=1e-6)
    assert np.array_equal(live["camera.rgb_image"][0], bus["camera.rgb_image"][0])
    assert np.array_equal(live["camera.depth_image"][0], bus["camera.depth_image"][0])
    assert (live["camera.rgb_image"] == bus["camera.rgb_image"]).mean() > 0.97  # the arm moves a little later


def test_nothing_is_valid_without_messages() -> None:
    plan = scenario(camera=True)
    station = make_station(plan)
    simulator = Simulator(station)
    simulator.AdvanceTo(0.1)
    context = simulator.get_context()
    assert station.GetOutputPort(ports.MEASUREMENT_TIME).Eval(context)[0] < 0
    assert station.GetOutputPort("camera.image_time").Eval(context)[0] < 0
    assert not station.GetOutputPort(ports.POSITION_MEASURED).Eval(context).any()
    assert not station.GetOutputPort("camera.depth_image").Eval(context).data.any()


class Bus:
    """A station on a bus that the test itself speaks and listens on."""

    def __init__(self, plan: Scenario, command: np.ndarray | None = None) -> None:
        self.station = make_station(plan)
        self.lcm = self.station.bus
        protocol = PROTOCOLS[plan.lcm.arm]
        self.status_channel = plan.lcm.status_channel or protocol.status_channel
        builder = DiagramBuilder()
        builder.AddNamedSystem("station", self.station)
        # A subscriber in Python would be called from within the simulator, which Drake 1.58 runs without Python's lock.
        channel = plan.lcm.command_channel or protocol.command_channel
        self._commands = LcmSubscriberSystem.Make(channel, protocol.command_type, self.lcm)
        builder.AddSystem(self._commands)
        for port, value in ((ports.POSITION_COMMANDED, command), (ports.TORQUE_COMMANDED, command)):
            if value is not None:
                source = builder.AddSystem(ConstantVectorSource(value * (10 if "torque" in port else 1)))
                builder.Connect(source.get_output_port(), self.station.GetInputPort(port))
        self.simulator = Simulator(builder.Build())
        self.simulator.Initialize()
        self.context = self.station.GetMyContextFromRoot(self.simulator.get_context())

    @property
    def command(self):  # type: ignore[no-untyped-def]
        """The last one sent; all zero before."""
        context = self._commands.GetMyContextFromRoot(self.simulator.get_context())
        return self._commands.get_output_port().Eval(context)

    def status(self, utime: int, n: int = 7, position: float = 0.2) -> None:
        message = lcmt_panda_status()
        message.utime, message.num_joints = utime, n
        for name in message.__slots__:
            if name.startswith("joint_"):
                setattr(message, name, [0.1] * n)
        message.joint_position, message.joint_torque = [position] * n, [3.0] * n
        self.lcm.Publish(self.status_channel, message.encode())

    def __getitem__(self, name: str):  # type: ignore[no-untyped-def]
        return self.station.GetOutputPort(name).Eval(self.context)


def test_time_starts_where_the_first_message_arrives() -> None:
    """A driver's clock counts from 1970; commands carry its time, which drivers check."""
    epoch = 1_700_000_000_000_000
    bus = Bus(scenario(), command=np.full(7, 0.5))
    bus.simulator.AdvanceTo(0.5)
    assert bus.command.num_joint_position == 0  # none before the first status
    bus.status(epoch)
    bus.simulator.AdvanceTo(0.51)
    assert abs(bus[ports.MEASUREMENT_TIME][0] - 0.5) < 1e-9
    bus.status(epoch + 200_000)
    bus.simulator.AdvanceTo(0.7)
    assert abs(bus[ports.MEASUREMENT_TIME][0] - 0.7) < 1e-9
    assert np.allclose(bus[ports.POSITION_MEASURED], 0.2) and np.allclose(bus[ports.TORQUE_MEASURED], 3.0)
    command = bus.command
    assert abs(command.utime - (epoch + 200_000)) < 3000
    assert command.joint_position == (0.5,) * 7 and command.joint_torque == (5.0,) * 7
    assert command.control_mode_expected == 5


@pytest.mark.parametrize("begins", [0, 3_000_000, 2_000_000_000_000_000])
def test_time_goes_on_where_a_driver_begins_anew(begins: int) -> None:
    """Its clock starts again, or was set: counted from the first message, times would be before all time."""
    bus, epoch = Bus(scenario(), command=np.full(7, 0.5)), 1_700_000_000_000_000
    for k in range(4):
        bus.status(epoch + 5000 * k)
        bus.simulator.AdvanceTo(0.005 * (k + 1))
    bus.simulator.AdvanceTo(0.1)
    times = []
    for k, stamp in enumerate([0, 5000, 15000, 10000, 20000]):  # two overtake one another
        bus.status(begins + stamp)
        bus.simulator.AdvanceTo(0.105 + 0.005 * k)
        times.append(bus[ports.MEASUREMENT_TIME][0])
    np.testing.assert_allclose(np.diff(times), [0.005, 0.01, -0.005, 0.01], atol=1e-9)
    assert abs(times[0] - 0.1) < 0.003
    assert abs(bus.command.utime - (begins + 20000)) < 11000  # drivers check it


@pytest.mark.parametrize("pace", [0.99, 0.9999, 1.0, 1.01])
def test_a_clock_that_parts_from_the_loops_is_held_to_it(pace: float) -> None:
    """Its stamps grew older than the stop monitor bears, in two seconds at 1 %, in eight minutes at a real one's."""
    clock, usual = np.array([0.0, 7.0, 0.0]), 0.0
    ages, steps = [], []
    for k in range(1, 4000):
        now = 7.0 + 0.005 * k + 0.002 * (k % 7 == 0)  # one in seven is held up on the bus
        before = clock[1]
        clock = next_clock(clock, round(5000 * k * pace), now)
        ages.append(now - usual - clock[1])
        steps.append((clock[1] - before) / (0.005 * pace))
    assert np.abs(ages).max() < 0.018
    assert np.abs(np.array(steps) - 1.0).max() < SYSTEMS.drift
    if abs(pace - 1.0) < 1e-3:
        assert np.std(steps) < 1e-3


@pytest.mark.parametrize("pace", [0.99, 1.01])
def test_a_slow_senders_clock_is_held_as_well(pace: float) -> None:
    """A camera's: what parts in ten images is more than a bus's jitter, though less than two images are apart."""
    clock = np.array([0.0, 7.0, 0.0])
    for k in range(1, 600):
        now = 7.0 + k / 15
        clock = next_clock(clock, round(1e6 * k / 15 * pace), now)
        assert abs(now - clock[1]) < 0.02


def test_a_loop_that_is_slower_than_the_arm_is_no_drift() -> None:
    clock = np.array([0.0, 0.0, 0.0])
    for k in range(1, 1000):
        clock = next_clock(clock, 5000 * k, 0.0025 * k)
    assert clock[1] > 0.99 * 0.005 * 999, "it is told as slower than real time"


def test_messages_that_overtake_one_another_or_come_late_set_no_clock() -> None:
    bus, epoch = Bus(scenario()), 1_700_000_000_000_000
    for stamp in (0, 900_000, 100_000, 30_000_000, 29_500_000):
        bus.status(epoch + stamp)
        bus.simulator.AdvanceTo(bus.context.get_time() + 0.005)
        assert abs(bus[ports.MEASUREMENT_TIME][0] - 1e-6 * stamp) < 0.006


def test_angles_that_jump_by_a_turn_go_on_and_commands_go_out_in_the_drivers_turn() -> None:
    """A driver whose encoders count one turn only: a joint that goes on beyond pi comes back at -pi."""
    bus, turn = Bus(scenario(), command=np.full(7, 3.3)), 2.0 * np.pi
    for k, angle in enumerate([3.0, 3.1, 3.2, np.nan, 3.3, 3.1, 3.0]):
        sent = (angle + np.pi) % turn - np.pi
        bus.status(1 + 5000 * k, position=sent)
        bus.simulator.AdvanceTo(0.005 * (k + 1))
        measured, commanded = bus[ports.POSITION_MEASURED], bus.command.joint_position
        if np.isfinite(angle):
            assert np.allclose(measured, angle) and np.allclose(commanded, 3.3 + sent - angle), f"message {k}"


def test_a_driver_in_position_mode_gets_positions_alone() -> None:
    plan = scenario()
    plan.lcm.control = "position"
    bus = Bus(plan, command=np.full(7, 0.5))
    bus.status(1)
    bus.simulator.AdvanceTo(0.01)
    command = bus.command
    assert command.num_joint_torque == 0 and command.num_joint_velocity == 0 and command.control_mode_expected == 1


@pytest.mark.parametrize("command", [None, np.full(7, np.nan)])
def test_nothing_is_commanded_without_a_command(command: np.ndarray | None) -> None:
    bus = Bus(scenario(), command)
    bus.status(1)
    bus.simulator.AdvanceTo(0.05)
    assert bus.command.num_joint_position == 0


def test_channels_can_be_named() -> None:
    plan = scenario()
    plan.lcm.status_channel, plan.lcm.command_channel = "LEFT_STATUS", "LEFT_COMMAND"
    bus = Bus(plan, command=np.zeros(7))
    bus.status(5)
    bus.simulator.AdvanceTo(0.01)
    assert bus[ports.MEASUREMENT_TIME][0] >= 0 and bus.command.num_joint_position == 7


def test_an_arm_of_another_size_is_refused() -> None:
    bus = Bus(scenario())
    bus.status(1, n=9)
    bus.simulator.AdvanceTo(0.01)
    with pytest.raises(StationError, match=r"PANDA_STATUS tells of 9 joints; the twin's arm has 7"):
        bus[ports.POSITION_MEASURED]


@pytest.mark.parametrize("noise", [b"hello, I am no message", b"", lcmt_image_array().encode()])
def test_bytes_that_are_no_message_are_left_out_and_said_once(noise: bytes, caplog: pytest.LogCaptureFixture) -> None:
    """They ended the run in a traceback."""
    bus = Bus(scenario())
    bus.status(1_000)
    bus.simulator.AdvanceTo(0.01)
    for until in (0.02, 0.03):
        bus.lcm.Publish(bus.status_channel, noise)
        bus.simulator.AdvanceTo(until)
    assert np.allclose(bus[ports.POSITION_MEASURED], 0.2)
    (said,) = caplog.messages
    assert said.startswith(f"PANDA_STATUS: {len(noise)} bytes that are no lcmt_panda_status")
    bus.status(30_000, position=0.3)
    bus.simulator.AdvanceTo(0.04)
    assert np.allclose(bus[ports.POSITION_MEASURED], 0.3)


def test_a_status_of_no_joints_is_no_message() -> None:
    """In the middle of a run it ended it."""
    bus = Bus(scenario())
    bus.status(1_000)
    bus.simulator.AdvanceTo(0.01)
    heard = bus[ports.MEASUREMENT_TIME][0]
    bus.status(20_000, n=0)
    bus.simulator.AdvanceTo(0.03)
    assert bus[ports.MEASUREMENT_TIME][0] == heard and np.allclose(bus[ports.POSITION_MEASURED], 0.2)


def test_an_iiwas_torques_have_the_other_sign() -> None:
    from drake import lcmt_iiwa_status

    message = lcmt_iiwa_status()
    message.num_joints = 7
    message.joint_torque_measured = [1.0, -2.0, 0, 0, 0, 0, 0]
    message.joint_position_measured = message.joint_velocity_estimated = [0.0] * 7
    assert PROTOCOLS["iiwa"].read_status(message).torque[:2].tolist() == [-1.0, 2.0]
    command = PROTOCOLS["iiwa"].write_command(7, np.zeros(7), None)
    assert isinstance(command, lcmt_iiwa_command) and command.num_torques == 0
    lcmt_iiwa_command.decode(command.encode())
    panda = PROTOCOLS["panda"].write_command(7, np.zeros(7), np.ones(7))
    assert lcmt_panda_command.decode(panda.encode()).joint_torque == tuple([1.0] * 7)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: setattr(p.lcm, "arm", "ur5"), r"lcm\.arm: 'ur5' is none of panda, iiwa"),
        (lambda p: setattr(p.lcm, "control", "torque"), r"lcm\.control: 'torque'"),
        (lambda p: setattr(p.lcm, "depth_unit", 0.0), r"lcm\.depth_unit"),
        (lambda p: setattr(p.lcm, "url", "bogus://x"), r"lcm\.url: 'bogus://x'"),
        (lambda p: setattr(p.twin.driver, "rate", -1.0), r"twin\.driver\.rate"),
        (lambda p: setattr(p.twin.arm, "model", "arms/none.urdf"), r"twin\.arm"),
    ],
)
def test_what_is_wrong_is_said_with_its_field(change, words: str) -> None:
    plan = scenario()
    change(plan)
    with pytest.raises(ScenarioError, match=words):
        make_station(plan)


# Images.


COLOUR = np.random.default_rng(0).integers(0, 255, (6, 8, 4)).astype(np.uint8)
COLOUR[..., 3] = 255
DEPTH = (np.random.default_rng(1).integers(0, 8000, (6, 8)) * UNIT).astype(np.float32)


def drakes(compress: bool, millimetres: bool) -> lcmt_image_array:
    """A message as Drake's own system writes it."""
    bus = DrakeLcm("memq://")
    heard = Subscriber(bus, "X", lcmt_image_array)
    builder = DiagramBuilder()
    array = ImageToLcmImageArrayT(do_compress=compress)
    builder.AddSystem(array)
    rgb = ImageRgba8U(8, 6)
    rgb.mutable_data[:] = COLOUR
    depth: ImageDepth16U | ImageDepth32F
    if millimetres:
        depth = ImageDepth16U(8, 6)
        depth.mutable_data[..., 0] = np.rint(DEPTH * 1000)
    else:
        depth = ImageDepth32F(8, 6)
        depth.mutable_data[..., 0] = DEPTH
    kinds = (PixelType.kRgba8U, PixelType.kDepth16U if millimetres else PixelType.kDepth32F)
    for name, kind, image in zip(("colour", "depth"), kinds, (rgb, depth), strict=True):
        port = array.DeclareImageInputPort[kind](name)
        builder.Connect(builder.AddSystem(ConstantValueSource(Value(image))).get_output_port(), port)
    publisher = LcmPublisherSystem.Make("X", lcmt_image_array, bus, publish_period=0.1, use_cpp_serializer=True)
    builder.AddSystem(publisher)
    builder.Connect(array.image_array_t_msg_output_port(), publisher.get_input_port())
    Simulator(builder.Build()).AdvanceTo(0.05)
    bus.HandleSubscriptions(0)
    assert heard.count == 1
    return heard.message


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("millimetres", [False, True])
def test_images_that_drake_writes_are_read(compress: bool, millimetres: bool) -> None:
    colour, depth = read_images(drakes(compress, millimetres), UNIT)
    assert np.array_equal(colour, COLOUR)
    assert np.abs(depth - DEPTH).max() < (6e-4 if millimetres else 1e-9)


def test_images_survive_the_bus() -> None:
    message = lcmt_image_array.decode(write_images(123, "eye", COLOUR, DEPTH).encode())
    colour, depth = read_images(message, UNIT)
    assert message.header.utime == 123 and message.header.frame_name == "eye"
    assert np.array_equal(colour, COLOUR) and np.array_equal(depth, DEPTH)


def image(data: bytes, **fields) -> lcmt_image:  # type: ignore[no-untyped-def]
    result = lcmt_image()
    result.width, result.height, result.data, result.size = 8, 6, data, len(data)
    result.channel_type = lcmt_image.CHANNEL_TYPE_UINT8
    result.compression_method = lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED
    for name, value in fields.items():
        setattr(result, name, value)
    return result


def test_other_pixel_formats_padding_and_png() -> None:
    message = lcmt_image_array()
    bgr = np.ascontiguousarray(COLOUR[..., 2::-1])
    padded = np.zeros((6, 32), np.uint8)
    padded[:, :24] = bgr.reshape(6, 24)
    message.images = [image(padded.tobytes(), row_stride=32, pixel_format=lcmt_image.PIXEL_FORMAT_BGR)]
    assert np.array_equal(read_images(message, UNIT)[0], COLOUR)
    png = cv2.imencode(".png", bgr)[1].tobytes()
    for pixel_format in (lcmt_image.PIXEL_FORMAT_RGB, lcmt_image.PIXEL_FORMAT_BGR):
        fields = {"pixel_format": pixel_format, "compression_method": lcmt_image.COMPRESSION_METHOD_PNG}
        message.images = [image(png, **fields)]
        assert np.array_equal(read_images(message, UNIT)[0], COLOUR)
    big = image(
        zlib.compress(np.rint(DEPTH * 1000).astype(">u2").tobytes()),
        pixel_format=lcmt_image.PIXEL_FORMAT_DEPTH,
        channel_type=lcmt_image.CHANNEL_TYPE_UINT16,
        compression_method=lcmt_image.COMPRESSION_METHOD_ZLIB,
        bigendian=1,
    )
    message.images = [big]
    assert np.abs(read_images(message, UNIT)[1] - DEPTH).max() < 6e-4


def test_depth_without_a_measurement_is_zero() -> None:
    holes = DEPTH.copy()
    holes[0, :4] = np.inf, np.nan, -1.0, 0.0
    _, depth = read_images(write_images(0, "eye", COLOUR, holes), UNIT)
    assert not depth[0, :4].any() and np.array_equal(depth[1:], DEPTH[1:])


def test_a_damaged_image_is_refused() -> None:
    message = lcmt_image_array()
    message.images = [image(b"short", row_stride=24, pixel_format=lcmt_image.PIXEL_FORMAT_RGB)]
    with pytest.raises(StationError, match="5 bytes for 8×6 pixels"):
        read_images(message, UNIT)
    fields = {"pixel_format": lcmt_image.PIXEL_FORMAT_RGB, "compression_method": lcmt_image.COMPRESSION_METHOD_JPEG}
    message.images = [image(b"no picture", **fields)]
    with pytest.raises(StationError, match="neither a PNG nor a JPEG"):
        read_images(message, UNIT)
    fields = {"pixel_format": lcmt_image.PIXEL_FORMAT_RGB, "compression_method": lcmt_image.COMPRESSION_METHOD_ZLIB}
    message.images = [image(b"no zip", **fields)]
    with pytest.raises(StationError, match="cannot be unpacked"):
        read_images(message, UNIT)
    grey = cv2.imencode(".png", COLOUR[..., 0])[1].tobytes()
    fields["compression_method"] = lcmt_image.COMPRESSION_METHOD_PNG
    message.images = [image(grey, **fields)]
    with pytest.raises(StationError, match="1 channel where 3 are told"):
        read_images(message, UNIT)
    message.images = [image(b"", pixel_format=lcmt_image.PIXEL_FORMAT_DEPTH)]
    with pytest.raises(StationError, match="channel type"):
        read_images(message, UNIT)


def test_a_camera_with_a_clock_of_its_own() -> None:
    plan = scenario(camera=True)
    assert plan.twin.camera is not None
    plan.twin.camera.width, plan.twin.camera.height = 8, 6
    bus = Bus(plan)
    bus.status(1_700_000_000_000_000)
    bus.simulator.AdvanceTo(0.1)
    bus.lcm.Publish("CAMERA_IMAGES", write_images(5_000_000, "eye", COLOUR, DEPTH).encode())
    bus.simulator.AdvanceTo(0.2)
    assert abs(bus["camera.image_time"][0] - (0.1 - 0.035)) < 1e-9
    bus.lcm.Publish("CAMERA_IMAGES", write_images(5_100_000, "eye", COLOUR, DEPTH).encode())
    bus.simulator.AdvanceTo(0.3)
    assert abs(bus["camera.image_time"][0] - (0.2 - 0.035)) < 1e-9
    assert np.array_equal(bus["camera.depth_image"].data[..., 0], DEPTH)
    bus.lcm.Publish("CAMERA_IMAGES", write_images(7, "eye", COLOUR, DEPTH).encode())  # it was started again
    bus.simulator.AdvanceTo(0.305)
    assert abs(bus["camera.image_time"][0] - (0.3 - 0.035)) < 0.006
    small = np.zeros((3, 4, 4), np.uint8)
    bus.lcm.Publish("CAMERA_IMAGES", write_images(5_200_000, "eye", small, DEPTH[:3, :4]).encode())
    bus.simulator.AdvanceTo(0.31)
    with pytest.raises(StationError, match=r"a colour image of 4×3 pixels; twin\.camera says 8×6"):
        bus["camera.rgb_image"]
    message = write_images(5_300_000, "eye", COLOUR, DEPTH)
    message.images, message.num_images = message.images[:1], 1
    bus.lcm.Publish("CAMERA_IMAGES", message.encode())
    bus.simulator.AdvanceTo(0.32)
    with pytest.raises(StationError, match="a message without a depth image"):
        bus["camera.depth_image"]


@pytest.mark.parametrize(("off", "own"), [(-0.05, False), (-1.5, True), (1.5, True)])
def test_a_camera_on_the_arms_clock_is_taken_at_its_word(off: float, own: bool) -> None:
    plan, epoch = scenario(camera=True), 1_700_000_000_000_000
    assert plan.twin.camera is not None
    plan.twin.camera.width, plan.twin.camera.height = 8, 6
    bus = Bus(plan)
    bus.status(epoch)
    bus.simulator.AdvanceTo(0.1)
    bus.lcm.Publish("CAMERA_IMAGES", write_images(epoch + round(1e6 * (0.1 + off)), "eye", COLOUR, DEPTH).encode())
    bus.simulator.AdvanceTo(0.2)
    taken = 0.1 - plan.twin.camera.latency if own else 0.1 + off
    assert bus["camera.image_time"][0] == pytest.approx(taken, abs=0.006)


# The whole twin.


def estimates(plan: Scenario, duration: float) -> dict[str, np.ndarray]:
    """What the twin believes every 20 ms of a closed loop."""

    def add(builder: DiagramBuilder, station, twin) -> None:  # type: ignore[no-untyped-def]
        if isinstance(station, LcmArmStation):
            builder.AddNamedSystem("arm", LcmArm(plan, station.bus))

    loop = make_closed_loop(plan, add)
    simulator = Simulator(loop.diagram)
    twin = loop.twin.diagram
    context = twin.GetMyContextFromRoot(simulator.get_context())
    rows: dict[str, list[np.ndarray]] = {"arm_state": [], "parameters": [], "tracks": []}
    for time in np.arange(0.02, duration, 0.02):
        simulator.AdvanceTo(time)
        for name, values in rows.items():
            values.append(np.array(twin.GetOutputPort(name).Eval(context)))
    return {name: np.array(values) for name, values in rows.items()}


@pytest.mark.slow
def test_the_twin_believes_the_same_on_either_station(egl) -> None:
    plan = load_scenario("tabletop", ["twin.task.start=0.05"])
    plan.lcm.url, plan.lcm.control = "memq://", "position_and_torque"
    live = estimates(plan, 0.6)
    plan.station = "lcm"
    bus = estimates(plan, 0.6)
    lag = 0.0027  # a period of the driver for commands, and what messages take
    speed = np.abs(live["arm_state"][:, 7:]).max()
    assert speed > 0.1
    assert np.abs(live["arm_state"] - bus["arm_state"])[:, :7].max() < 1.5 * lag * speed + 1e-4
    assert np.allclose(live["parameters"], bus["parameters"], atol=0.05)
    first, second = (x["tracks"].reshape(len(x["tracks"]), -1, TRACK_SIZE)[:, :, :9] for x in (live, bus))
    assert np.array_equal(first[:, :, 0], second[:, :, 0])
    assert np.linalg.norm(first[:, :, 6:9] - second[:, :, 6:9], axis=-1).max() < 1e-3
