"""The wall between world and twin: no wire crosses it, and no value behind it changes an estimate."""

from __future__ import annotations

import dataclasses
import random
import shutil
import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder, PortDataType, System
from pydrake.systems.primitives import Demultiplexer, PassThrough
from pydrake.systems.sensors import ImageLabel16I

from tests.small_loop import BLIND, at, estimates, same, small_scenario
from twin_diagram.runs import run
from twin_diagram.runs.outputs import Looking
from twin_diagram.runs.run import replay_scenario, run_scenario
from twin_diagram.scenario import Scenario, World
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.station import make_station, ports
from twin_diagram.twin.closed_loop import ClosedLoop, connect, make_closed_loop
from twin_diagram.twin.twin import make_twin

# Wires.


@pytest.fixture(scope="module")
def loop(egl: None) -> ClosedLoop:
    """As the demo builds it, visualisers and all."""
    return make_closed_loop(small_scenario(), Looking().add)


def diagrams(system: System) -> Iterator[Diagram]:
    """A Diagram and all those within it."""
    if isinstance(system, Diagram):
        yield system
        for part in system.GetSystems():
            yield from diagrams(part)


def leaves(system: System) -> Iterator[System]:
    if isinstance(system, Diagram):
        for part in system.GetSystems():
            yield from leaves(part)
    else:
        yield system


Edge = tuple[str, str, str, str]


def edges(diagram: Diagram) -> set[Edge]:
    """(from system, output port, to system, input port) of one Diagram, not of those within it."""
    return {
        (source.get_name(), source.get_output_port(out).get_name(), to.get_name(), to.get_input_port(into).get_name())
        for (to, into), (source, out) in diagram.connection_map().items()
    }


def reached(diagram: Diagram, starts: set[str]) -> set[str]:
    """Systems of one Diagram that a signal from any of `starts` comes to, those included."""
    found, wires = set(starts), edges(diagram)
    while more := {to for source, _, to, _ in wires if source in found} - found:
        found |= more
    return found


def leaks(diagram: Diagram) -> set[str]:
    """Ports ``truth.*`` of the station whose signal comes to the twin, by whatever way."""
    return {
        out
        for source, out, to, _ in edges(diagram)
        if source == "station" and out.startswith(ports.TRUTH) and "twin" in reached(diagram, {to})
    }


def test_truth_leads_to_visualisers_alone(loop: ClosedLoop) -> None:
    assert loop.diagram.GetSubsystemByName("twin") is loop.twin.diagram
    assert loop.diagram.GetSubsystemByName("station") is loop.station
    from_truth = {edge for edge in edges(loop.diagram) if edge[1].startswith(ports.TRUTH)}
    assert from_truth, "the real scene is drawn"
    for _, _, to, _ in from_truth:
        system = loop.diagram.GetSubsystemByName(to)
        assert "Visualizer" in system.GetSystemType(), to
        assert reached(loop.diagram, {to}) == {to}
    assert not leaks(loop.diagram)


def test_the_twin_gets_the_stations_sensors_and_nothing_else(loop: ClosedLoop) -> None:
    into_twin = {edge for edge in edges(loop.diagram) if edge[2] == "twin"}
    assert {(source, out) for source, out, _, _ in into_twin} == {("station", into) for _, _, _, into in into_twin}
    sensors = {name for name in ports.output_names(loop.station) if not name.startswith(ports.TRUTH)}
    assert set(ports.input_names(loop.twin.diagram)) == {into for _, _, _, into in into_twin} == sensors


def test_truth_leads_nowhere_within_the_station(loop: ClosedLoop) -> None:
    """So what its sensors show is not made from it."""
    inside = {edge for diagram in diagrams(loop.station) for edge in edges(diagram)}
    assert ("true_state", "motor_state", "arm_sensors", "motor_state") in inside
    assert not [edge for edge in inside if edge[:2] == ("true_state", "arm_state") or edge[0] == "true_poses"]


def test_truth_leads_nowhere_within_the_twin(loop: ClosedLoop) -> None:
    for diagram in diagrams(loop.twin.diagram):
        for edge in edges(diagram):
            assert not any(name.startswith(ports.TRUTH) for name in edge), edge
    for leaf in leaves(loop.twin.diagram):
        names = ports.input_names(leaf) + ports.output_names(leaf)
        assert not any(name.startswith(ports.TRUTH) for name in names), names


def test_the_twins_diagram_holds_no_plant(loop: ClosedLoop) -> None:
    assert not [leaf for leaf in leaves(loop.twin.diagram) if isinstance(leaf, MultibodyPlant)]
    graphs = [leaf for leaf in leaves(loop.twin.diagram) if isinstance(leaf, SceneGraph)]
    assert graphs == [loop.twin.scene.scene_graph]
    assert [leaf for leaf in leaves(loop.station) if isinstance(leaf, MultibodyPlant)], "and the station's does"


def held(thing: Any) -> dict[int, Any]:
    """Whatever can be reached from an object by attributes, entries and parts, by id."""
    found: dict[int, Any] = {}
    pending = [thing]
    while pending:
        here = pending.pop()
        if id(here) in found or isinstance(here, (str, bytes, int, float, np.ndarray, type, types.ModuleType)):
            continue
        found[id(here)] = here
        if isinstance(here, dict):
            pending.extend([*here.keys(), *here.values()])
        elif isinstance(here, (list, tuple, set, frozenset)):
            pending.extend(here)
        if isinstance(here, Diagram):
            pending.extend(here.GetSystems())
        if hasattr(here, "__dict__"):
            # Drake's bindings tie the life of a system to that of its Diagram; it is not the system that refers to it.
            pending.extend(value for name, value in vars(here).items() if not name.startswith("_pydrake_internal"))
        pending.extend(getattr(here, name) for name in getattr(type(here), "__slots__", ()) if hasattr(here, name))
        pending.extend(cell.cell_contents for cell in getattr(here, "__closure__", None) or ())
        if hasattr(here, "__self__"):
            pending.append(here.__self__)
    return found


def test_nothing_of_the_twin_refers_to_the_world(loop: ClosedLoop) -> None:
    ours, theirs = held(loop.twin), held(loop.station)
    world = loop.station.world  # type: ignore[attr-defined]
    assert id(loop.twin.scene.plant) in ours and id(world.plant) in theirs
    shared = [ours[i] for i in ours.keys() & theirs.keys()]
    assert not [thing for thing in shared if isinstance(thing, (System, Scenario))]
    everything = [*ours.values()]
    for forbidden in (world.plant, world.scene_graph, loop.scenario, loop.scenario.world, loop.station):
        assert not any(thing is forbidden for thing in everything), forbidden


def test_no_label_image_anywhere(loop: ClosedLoop) -> None:
    for system in [*diagrams(loop.twin.diagram), *leaves(loop.twin.diagram), loop.station]:
        inputs = [system.get_input_port(i) for i in range(system.num_input_ports())]
        outputs = [system.get_output_port(i) for i in range(system.num_output_ports())]
        for port in (*inputs, *outputs):
            assert "label" not in port.get_name(), port.get_name()
            if port.get_data_type() == PortDataType.kAbstractValued:
                value = system.AllocateInputAbstract(port) if port in inputs else port.Allocate()
                assert not isinstance(value.get_value(), ImageLabel16I), port.get_name()
    # The station's renderer offers labels; nothing takes them.
    for diagram in diagrams(loop.diagram):
        assert not any("label" in name for edge in edges(diagram) for name in edge)


def test_the_wall_test_sees_a_hole() -> None:
    """A twin that gets the true joint angles, by a detour, is found out."""
    plan = small_scenario(*BLIND)
    builder = DiagramBuilder()
    twin, station = make_twin(plan.twin), make_station(plan)
    connect(builder, station, twin)
    assert not leaks(builder.Build())

    builder = DiagramBuilder()
    twin, station = make_twin(plan.twin), make_station(plan)
    builder.AddNamedSystem("station", station)
    builder.AddNamedSystem("twin", twin.diagram)
    split = builder.AddNamedSystem("split", Demultiplexer([7, 7]))
    detour = builder.AddNamedSystem("detour", PassThrough(7))
    builder.Connect(station.GetOutputPort(ports.ARM_STATE), split.get_input_port())
    builder.Connect(split.get_output_port(0), detour.get_input_port())
    builder.Connect(detour.get_output_port(), twin.diagram.GetInputPort(ports.POSITION_MEASURED))
    assert leaks(builder.Build()) == {ports.ARM_STATE}


# Values.

DURATION = 1.6
LOOKS = [0.24, 0.8, 1.2, DURATION]
"""Some at the very times at which filter, camera and updater tick."""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, egl: None) -> tuple[Path, list[dict[str, Array]]]:
    """A recording, and what the twin believed while it was made."""
    folder = tmp_path_factory.mktemp("wall") / "recording"
    live: list[dict[str, Array]] = []
    loops: list[ClosedLoop] = []

    def trial(loop: ClosedLoop, simulator: Simulator, duration: float, progress: Any, between: Any) -> Any:
        loops.append(loop)
        wanted = list(LOOKS)

        def look(context: Any) -> None:
            between(context)
            if wanted and context.get_time() >= wanted[0] - 1e-9:
                assert context.get_time() == pytest.approx(wanted.pop(0), abs=1e-9)
                live.append(estimates(loop, context))

        return original(loop, simulator, duration, progress, look)

    original = run.run_trial
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "run_trial", trial)
        scenario = small_scenario(f"duration={DURATION}", "seed=4", objects=("mover", "can"))
        run_scenario(scenario, record=folder, say=lambda text: None)
    assert len(live) == len(LOOKS)
    return folder, live


def replayed(folder: Path) -> list[dict[str, Array]]:
    loop = make_closed_loop(replay_scenario(folder))
    simulator = Simulator(loop.diagram)
    simulator.Initialize()
    return [at(loop, simulator, time) for time in LOOKS]


def leaf_values(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    if isinstance(value, dict) and value:
        for key, sub in value.items():
            yield from leaf_values(sub, (*at, key))
    elif isinstance(value, list) and value:
        for index, sub in enumerate(value):
            yield from leaf_values(sub, (*at, index))
    else:
        yield at, value


MODELS = (
    "arms/ur5e.urdf",
    "arms/iiwa7.urdf",
    "scenes/bin_a.sdf",
    "objects/bottle",
    "no/such/thing",
    "",
    "panda_joint3",
)


def scrambled(value: Any, kind: Any, rng: random.Random) -> Any:
    """Data of the same type with every value changed: numbers, texts, names, what lists hold and in which order."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        (kind,) = (a for a in arguments if a is not type(None))
        return scrambled(value, kind, rng)
    if dataclasses.is_dataclass(kind):
        return {f.name: scrambled((value or {}).get(f.name), f.type, rng) for f in dataclasses.fields(kind)}
    if origin is list:
        result = [scrambled(sub, arguments[0], rng) for sub in value or [None, None]]
        order = rng.sample(result, len(result))
        # Shuffled, one of them may be what stood there before.
        return result if any(a == b for a, b in zip(order, value or [], strict=False)) else order
    if origin is dict:
        return {f"thing_{k}": scrambled(sub, arguments[1], rng) for k, sub in enumerate((value or {"": None}).values())}
    if kind is bool:
        return not value
    if kind is int:
        return (value or 0) + rng.choice([-3, 5, 100])
    if kind is float:
        return (value or 0.0) * rng.choice([-2.0, 0.5, 3.0]) + rng.uniform(0.1, 1.0)
    assert kind is str
    return rng.choice([text for text in MODELS if text != value])


def everything_changed(world: dict[str, Any]) -> dict[str, Any]:
    result: dict[str, Any] = scrambled(world, World, random.Random(3))
    before, after = dict(leaf_values(world)), dict(leaf_values(result))
    assert len(before) > 60 and not [path for path in before if path in after and before[path] == after[path]]
    return result


def emptied(world: dict[str, Any]) -> dict[str, Any]:
    """Every list and mapping of entries emptied, every number zero, every text nonsense."""

    def empty(value: Any) -> Any:
        if isinstance(value, list):
            return []
        if isinstance(value, dict):
            return {key: empty(sub) for key, sub in value.items()}
        return {float: 0.0, int: 0, str: "nonsense"}.get(type(value))

    return {**empty(world), "objects": {}}


@pytest.mark.long
def test_a_replay_believes_what_the_twin_believed_live(recorded: tuple[Path, list[dict[str, Array]]]) -> None:
    folder, live = recorded
    assert not same(live, replayed(folder))
    # There was something to believe.
    tracks = live[-1]["tracks"].reshape(2, -1)
    assert list(tracks[:, 0]) == [ObjectStatus.MOVING, ObjectStatus.TRACKED]
    assert not np.array_equal(live[0]["arm_state"], live[-1]["arm_state"])
    assert not np.array_equal(live[0]["parameters"], live[-1]["parameters"])


@pytest.mark.parametrize("change", [everything_changed, pytest.param(emptied, marks=pytest.mark.slow)])
def test_whatever_the_world_says_the_estimates_stay(
    change: Any, recorded: tuple[Path, list[dict[str, Array]]], tmp_path: Path
) -> None:
    folder, live = recorded
    copy = Path(shutil.copytree(folder, tmp_path / "scrambled"))
    file = copy / "scenario.yaml"
    data = yaml.safe_load(file.read_text())
    original = load_scenario(file)
    data["world"] = change(data["world"])
    file.write_text(yaml.safe_dump(data, sort_keys=False))
    changed = load_scenario(file)
    assert changed.world != original.world and changed.twin == original.twin
    assert not same(live, replayed(copy))


def test_the_comparison_sees_a_changed_bit(recorded: tuple[Path, list[dict[str, Array]]]) -> None:
    _, live = recorded
    other = [{name: value.copy() for name, value in sample.items()} for sample in live]
    other[1]["covariance"][3] = np.nextafter(other[1]["covariance"][3], 1.0)
    assert same(live, other) == ["covariance at sample 1"]


def test_what_the_twin_is_told_does_matter(recorded: tuple[Path, list[dict[str, Array]]]) -> None:
    """The same sensors and another calibration give other estimates: the comparison above compares something."""
    folder, live = recorded
    plan = replay_scenario(folder, overrides=["twin.filter.torque_std=0.5"])
    plan.twin.camera = None
    plan.twin.library = {}
    loop = make_closed_loop(plan)
    simulator = Simulator(loop.diagram)
    simulator.Initialize()
    assert same([live[1]], [at(loop, simulator, LOOKS[1])])
