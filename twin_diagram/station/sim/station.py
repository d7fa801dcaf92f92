"""The simulated station: a world that holds the truth, seen through imperfect sensors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort

from twin_diagram.model.effects import Motors, connect
from twin_diagram.scenario import Scenario
from twin_diagram.station import ports
from twin_diagram.station.sim.arm_sensors import ArmSensors
from twin_diagram.station.sim.camera import add_cameras
from twin_diagram.station.sim.driver import ArmDriver, NominalGravity
from twin_diagram.station.sim.lidar import add_lidar
from twin_diagram.station.sim.link_sensors import add_link_sensors
from twin_diagram.station.sim.link_torque import LinkTorque
from twin_diagram.station.sim.movers import MoverDriver
from twin_diagram.station.sim.real_camera import RealCamera
from twin_diagram.station.sim.truth import TruePoses, TrueState
from twin_diagram.station.sim.world_plant import WorldPlant, build_world


class SimStation(Diagram):
    """A world with an arm, fixtures, objects and a camera, behind the ports of every station and `truth.*`.

    .. pydrake_system::

        name: SimStation
        input_ports:
        - arm.position_commanded
        - arm.torque_commanded
        - gripper.position_commanded
        - gripper.force_limit
        output_ports:
        - arm.position_measured
        - arm.velocity_estimated
        - arm.torque_measured
        - arm.measurement_time
        - gripper.state_measured
        - <camera>.rgb_image
        - <camera>.depth_image
        - <camera>.image_time
        - <body>.imu
        - <body>.imu_time
        - wrist.wrench_measured
        - wrist.wrench_time
        - <lidar>.lidar
        - <lidar>.lidar_time
        - truth.arm_state
        - truth.object_poses
        - truth.query_object
        - truth.contact_results

    Torques are the motors', or, where ``twin.driver.torque_side`` is `link`, what the gears pass on. Commands may stay
    unconnected: the arm then holds its pose. The arm's messages come at ``twin.driver.rate``; images
    are captured at k / rate and delivered `latency` later, of each camera that the twin looks through
    (``twin.perceiving``); one is rendered only where somebody asks for it. IMU and wrench are there where
    ``twin.sensors`` names them, the lidar's ranges where there is a ``twin.lidar``.

    Attributes:
        world: what the world consists of. For scores, plots and tests alone; no part of a twin may hold it.
    """

    world: WorldPlant

    def __init__(self, scenario: Scenario) -> None:
        """Build the world of a scenario.

        Raises:
            ScenarioError, ModelError, AssetError: what it is to be built from is missing or malformed.
            NativeLibraryError: there is a camera and EGL is missing.
        """
        super().__init__()
        builder = DiagramBuilder()
        world = build_world(builder, scenario)
        self.world = world
        plant, arm = world.plant, world.arm
        n, g = len(arm.joints), len(arm.fingers)

        state = builder.AddNamedSystem("true_state", TrueState(plant, arm))
        builder.Connect(plant.get_state_output_port(), state.get_input_port())
        driver = builder.AddNamedSystem("arm_driver", ArmDriver(arm, NominalGravity(scenario), plant.time_step()))
        motors = connect(builder, plant, arm.arm, arm.effects)
        builder.Connect(state.GetOutputPort("motor_state"), driver.GetInputPort("motor_state"))
        builder.Connect(driver.GetOutputPort("torque"), motors.torque)
        builder.Connect(driver.GetOutputPort("desired_state"), motors.desired_state)
        builder.Connect(driver.GetOutputPort("gripper_desired_state"), motors.gripper_desired_state)
        defects, rate = scenario.world.arm_defects, scenario.twin.driver.rate
        sensors = builder.AddNamedSystem("arm_sensors", ArmSensors(n, g, defects, rate, scenario.seed))
        builder.Connect(state.GetOutputPort("motor_state"), sensors.GetInputPort("motor_state"))
        builder.Connect(_torque(builder, scenario, world, motors), sensors.GetInputPort("torque"))
        if world.carriages is not None:
            movers = builder.AddNamedSystem("movers", MoverDriver(world.paths))
            builder.Connect(movers.get_output_port(), plant.get_desired_state_input_port(world.carriages))

        builder.ExportInput(driver.GetInputPort("position_commanded"), ports.POSITION_COMMANDED)
        builder.ExportInput(driver.GetInputPort("torque_commanded"), ports.TORQUE_COMMANDED)
        builder.ExportOutput(sensors.GetOutputPort("position_measured"), ports.POSITION_MEASURED)
        builder.ExportOutput(sensors.GetOutputPort("velocity_estimated"), ports.VELOCITY_ESTIMATED)
        builder.ExportOutput(sensors.GetOutputPort("torque_measured"), ports.TORQUE_MEASURED)
        builder.ExportOutput(sensors.GetOutputPort("measurement_time"), ports.MEASUREMENT_TIME)
        if g:
            builder.ExportInput(driver.GetInputPort("gripper_commanded"), ports.GRIPPER_COMMANDED)
            builder.ExportInput(driver.GetInputPort("gripper_force_limit"), ports.GRIPPER_FORCE_LIMIT)
            builder.ExportOutput(sensors.GetOutputPort("gripper_measured"), ports.GRIPPER_MEASURED)
        cameras = self._cameras = add_cameras(builder, scenario, world)
        for name, images in cameras.items():
            builder.ExportOutput(images.GetOutputPort("rgb_image"), ports.rgb_image(name))
            builder.ExportOutput(images.GetOutputPort("depth_image"), ports.depth_image(name))
            builder.ExportOutput(images.GetOutputPort("image_time"), ports.image_time(name))
        further = add_link_sensors(builder, plant, arm, scenario) | add_lidar(builder, world, scenario)
        poses = builder.AddNamedSystem("true_poses", TruePoses(list(world.objects.values())))
        builder.Connect(plant.get_body_poses_output_port(), poses.get_input_port())
        builder.ExportOutput(state.GetOutputPort("arm_state"), ports.ARM_STATE)
        builder.ExportOutput(poses.GetOutputPort("object_poses"), ports.OBJECT_POSES)
        builder.ExportOutput(world.scene_graph.get_query_output_port(), ports.QUERY_OBJECT)
        builder.ExportOutput(plant.get_contact_results_output_port(), ports.CONTACT_RESULTS)
        builder.BuildInto(self)
        self.set_name("station")
        ports.check(self, n, g, tuple(cameras), further)

    @contextmanager
    def pictures_beside(self) -> Iterator[list[Callable[[], None]]]:
        """Have cameras take their pictures in processes of their own for as long as the `with` statement lasts.

        Yields what waits until each has begun.

        Without it they are taken when somebody looks at them, with the same result to the bit; an ideal camera's always
        are.
        """
        with ExitStack() as stack:
            cameras = [camera for camera in self._cameras.values() if isinstance(camera, RealCamera)]
            yield [stack.enter_context(camera.taken_beside()) for camera in cameras]


def _torque(builder: DiagramBuilder, scenario: Scenario, world: WorldPlant, motors: Motors) -> OutputPort:
    """Return the port of the torques that the arm's sensors measure, on the side of the gears that is told."""
    if scenario.twin.driver.torque_side == "motor":
        return motors.torque_logged
    picked = builder.AddNamedSystem("link_torque", LinkTorque(world.plant, world.arm.joints))
    builder.Connect(world.plant.get_reaction_forces_output_port(), picked.get_input_port())
    return picked.get_output_port()
