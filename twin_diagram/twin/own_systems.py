"""A user's own station, controller, perception or segmenter: which ports it may have, and what is wrong with it.

A system takes part by its ports' names: it is fed those inputs that it declares, and must have the outputs that the
twin needs. For an arm of n joints, p learnt parameters and K objects in the library:

- a **controller** may have the inputs `arm_state` (2n) [rad, rad/s], `parameters` (p), `tracks` (K packed `Track`s),
  `goal` (7) X_WG, `position_measured`, `velocity_estimated`, `torque_measured` (n each), `measurement_time` (1) [s]. It
  must have the output `position_commanded` (n) [rad] and may have `torque_commanded` (n) [N·m], which is added to the
  arm's own controller, `plan` (knots · n) [rad], which is drawn, and `reach`, `plan_time` (1) and `position_planned`
  (n), as `Mpc` has them: without `plan_time` nobody notices that it hangs. An input `brake` (1 + n) tells it that the
  arm is held and where, `next_goal` (7) where it goes after `goal`, `next_hand` with what in its hand and
  `next_pause` (1) how long it rests before that. All its positions are true joint angles: offsets of
  encoders that the twin is told of are taken off before, and put back on what it commands. Where one is found while the
  twin runs, any System that has a method `recount(context, change)` is told by how much (n,) its angles count otherwise
  from now on.
- a **perception** may have the inputs `rgb_image` (ImageRgba8U), `depth_image` (ImageDepth32F) [m], `image_time` (1)
  [s], `arm_state` (2n). It must have the output `object_poses` (K packed `PoseMeasurement`s); where `twin.camera` is
  null it has no images, and must also have `image_time` (1) [s]: when the newest poses were measured.
- a **station** must have the outputs `arm.position_measured`, `arm.velocity_estimated`, `arm.torque_measured` (n each)
  and `arm.measurement_time` (1) [s], with a gripper `gripper.state_measured` (2g), and of each camera C that the twin
  looks through `C.rgb_image`, `C.depth_image`, `C.image_time`; times are `NEVER` before the first message. It may have
  further sensors' ports (`station.ports`), others to which nothing is connected, and the inputs
  `arm.position_commanded`, `arm.torque_commanded` (n each), `gripper.position_commanded` (g) and
  `gripper.force_limit` (1).
- a **segmenter** is a function and no system: see `perception.segmentation.learned.Segmenter`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from pydrake.systems.framework import Diagram, DiagramBuilder, PortDataType, System

from twin_diagram import scenario
from twin_diagram.errors import TwinError
from twin_diagram.station import ports

VALUE = 0
"""In the place of a size: the port holds a value, not a vector."""


def check(
    role: str, system: System, inputs: Mapping[str, int], needed: Mapping[str, int], further: Mapping[str, int]
) -> None:
    """Refuse a system that does not fit into its place.

    Args:
        role: of the system, for messages: `controller`, `perception`.
        system: any Drake System.
        inputs: ports that the twin can feed, by name, with their sizes; `VALUE` for what is no vector.
        needed: outputs that it must have.
        further: outputs that are used where it has them.

    Raises:
        TwinError: an input that the twin knows nothing of, an output that is missing, or a wrong size; the message
            names the port. Or it is a part of another Diagram.
    """
    if not isinstance(system, System):  # a mistake that Drake would tell of in other words
        raise TwinError(f"{role}: {system!r} is no Drake System")
    if system.GetSystemPathname() != f"::{system.get_name() or '_'}":  # Drake would refuse it once all is built
        raise TwinError(f"{role}: it is part of another Diagram already; each loop takes a new one")
    for k in range(system.num_input_ports()):
        port = system.get_input_port(k)
        if port.get_name() not in inputs:
            raise TwinError(
                f"{role}: its input port {port.get_name()!r} is none that the twin can feed; those are {_sizes(inputs)}"
            )
        _check_size(role, "input", port.get_name(), _size(port), inputs[port.get_name()])
    for name, size in needed.items():
        if not system.HasOutputPort(name):
            raise TwinError(f"{role}: it has no output port {name!r}; it needs {_sizes(needed)}")
        _check_size(role, "output", name, _size(system.GetOutputPort(name)), size)
    for name, size in further.items():
        if system.HasOutputPort(name):
            _check_size(role, "output", name, _size(system.GetOutputPort(name)), size)


def check_station(station: System, twin: Diagram, may_lack: Collection[str]) -> None:
    """Refuse a station that a twin cannot go with.

    Args:
        station: any Drake System.
        twin: its Diagram.
        may_lack: outputs that need not be there.

    Raises:
        TwinError: it names the port that is missing, that nothing feeds, or whose size is wrong.
    """
    commands = (ports.POSITION_COMMANDED, ports.TORQUE_COMMANDED, ports.GRIPPER_COMMANDED, ports.GRIPPER_FORCE_LIMIT)
    inputs = {name: _size(twin.GetOutputPort(name)) for name in commands if twin.HasOutputPort(name)}
    wanted = {name: _size(twin.GetInputPort(name)) for name in ports.input_names(twin)}
    needed = {name: size for name, size in wanted.items() if name not in may_lack}
    check("station", station, inputs, needed, {name: wanted[name] for name in may_lack})


def check_segmenter(segmenter: object, perception: System | None, twin: scenario.Twin) -> None:
    """Refuse a segmenter that nothing would ask.

    Raises:
        TwinError: it is no function, there is no camera, or a perception of the user's own takes images apart.
    """
    if segmenter is None:
        return
    if not callable(segmenter):
        raise TwinError(f"segmenter: {segmenter!r} is no function of (rgb, depth, K, X_WC, prior_ids)")
    if perception is not None:
        raise TwinError("segmenter: a perception of one's own takes images apart by itself; give one of them")
    if not twin.perceiving:
        raise TwinError("segmenter: the twin looks through no camera: twin.camera is null")


def inputs_of(system: System, names: Sequence[str]) -> list[str]:
    """Return those of the names that are input ports of a system."""
    return [name for name in names if system.HasInputPort(name)]


def _check_size(role: str, kind: str, name: str, has: int, needs: int) -> None:
    if has == needs:
        return
    if VALUE in (has, needs):
        raise TwinError(f"{role}: its {kind} port {name!r} must be {'a value' if needs == VALUE else 'a vector'}")
    raise TwinError(f"{role}: its {kind} port {name!r} has {has} numbers, the twin's has {needs}")


def _size(port: object) -> int:
    vector = port.get_data_type() == PortDataType.kVectorValued  # type: ignore[attr-defined]
    return int(port.size()) if vector else VALUE  # type: ignore[attr-defined]


def _sizes(ports: Mapping[str, int]) -> str:
    return ", ".join(f"{name} (a value)" if size == VALUE else f"{name} ({size})" for name, size in ports.items())


def connect_ports(builder: DiagramBuilder, source: System, to: System, *names: str) -> None:
    """Connect output ports of one system to another's input ports of the same names."""
    for name in names:
        builder.Connect(source.GetOutputPort(name), to.GetInputPort(name))
