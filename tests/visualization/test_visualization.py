"""Pictures of a run: the block picture of a Diagram, plots, ghosts, Meldis."""

from __future__ import annotations

import itertools
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drake import lcmt_viewer_draw, lcmt_viewer_load_robot
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from pydrake.geometry import IllustrationProperties, Role
from pydrake.lcm import DrakeLcm, Subscriber
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from twin_diagram import scenario
from twin_diagram.runs.score import RunRecord
from twin_diagram.runtime import atomic_file
from twin_diagram.scene.twin_scene import add_twin_scene
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.visualization import meldis, plots
from twin_diagram.visualization.diagram_svg.channels import crossings, order_tracks
from twin_diagram.visualization.diagram_svg.columns import columns
from twin_diagram.visualization.diagram_svg.graph import Block, BlockGraph
from twin_diagram.visualization.diagram_svg.routes import layout
from twin_diagram.visualization.diagram_svg.svg import draw, write_diagram_svg
from twin_diagram.visualization.ellipsoids import DEVIATIONS, ellipsoid
from twin_diagram.visualization.ghost import OBJECT_COLOUR, _swollen_mesh, make_ghost

SVG = "{http://www.w3.org/2000/svg}"


def system(kind: str, inputs: list[str], outputs: list[str]) -> LeafSystem:
    def init(self) -> None:
        LeafSystem.__init__(self)
        for name in inputs:
            self.DeclareVectorInputPort(name, 1)
        for name in outputs:
            self.DeclareVectorOutputPort(name, 1, lambda context, value: None, {self.nothing_ticket()})

    return type(kind, (LeafSystem,), {"__init__": init})()


def small_loop() -> Diagram:
    """A station and a twin of three systems, with a viewer of each scene."""
    inner = DiagramBuilder()
    see = inner.AddNamedSystem("see", system("PerceptionSystem", ["image", "belief"], ["poses"]))
    think = inner.AddNamedSystem("think", system("AdaptiveEkf", ["measured"], ["belief"]))
    act = inner.AddNamedSystem("act", system("Mpc", ["poses", "belief"], ["command", "query"]))
    inner.Connect(see.GetOutputPort("poses"), act.GetInputPort("poses"))
    inner.Connect(think.GetOutputPort("belief"), act.GetInputPort("belief"))
    inner.Connect(think.GetOutputPort("belief"), see.GetInputPort("belief"))
    inner.ExportInput(see.GetInputPort("image"), "image")
    inner.ExportInput(think.GetInputPort("measured"), "measured")
    inner.ExportOutput(act.GetOutputPort("command"), "command")
    inner.ExportOutput(act.GetOutputPort("query"), "query")
    twin = inner.Build()
    builder = DiagramBuilder()
    station = builder.AddNamedSystem("station", system("Sim", ["command"], ["image", "measured", "truth.query"]))
    builder.AddNamedSystem("twin", twin)
    for name in ("image", "measured"):
        builder.Connect(station.GetOutputPort(name), twin.GetInputPort(name))
    builder.Connect(twin.GetOutputPort("command"), station.GetInputPort("command"))
    for name, port in (("real_view", station.GetOutputPort("truth.query")), ("twin_view", twin.GetOutputPort("query"))):
        builder.Connect(port, builder.AddNamedSystem(name, system("View", ["query"], [])).get_input_port())
    return builder.Build()


@pytest.fixture(scope="module")
def loop() -> Diagram:
    return small_loop()


def test_the_graph_looks_into_opened_diagrams(loop: Diagram) -> None:
    closed = BlockGraph.of(loop)
    assert {b.key for b in closed.blocks} == {"station", "twin", "real_view", "twin_view"}
    assert (("twin", "command"), ("station", "command")) in closed.wires
    opened = BlockGraph.of(loop, ["twin"])
    assert {b.key for b in opened.blocks if b.parent} == {"twin/see", "twin/think", "twin/act"}
    assert set(opened.wires) == {
        (("station", "image"), ("twin/see", "image")),
        (("station", "measured"), ("twin/think", "measured")),
        (("station", "truth.query"), ("real_view", "query")),
        (("twin/act", "command"), ("station", "command")),
        (("twin/act", "query"), ("twin_view", "query")),
        (("twin/see", "poses"), ("twin/act", "poses")),
        (("twin/think", "belief"), ("twin/act", "belief")),
        (("twin/think", "belief"), ("twin/see", "belief")),
    }


def test_the_picture_shows_every_block_port_and_wire(loop: Diagram, tmp_path: Path) -> None:
    path = write_diagram_svg(loop, tmp_path / "new" / "diagram.svg")
    root = ElementTree.parse(path).getroot()
    texts = [element.text for element in root.iter(f"{SVG}text")]
    for block in BlockGraph.of(loop, ["twin"]).blocks:
        for text in (block.name, *block.inputs, *block.outputs):
            assert text in texts
    titles = [element.text for element in root.iter(f"{SVG}title")]
    graph = BlockGraph.of(loop, ["twin"])
    assert {" ".join(source) for source, _ in graph.wires} <= set(titles)
    dashed = [element for element in root.iter(f"{SVG}path") if element.get("stroke-dasharray")]
    assert [e.find(f"{SVG}title").text for e in dashed if e.find(f"{SVG}title") is not None] == ["station truth.query"]
    assert len(root.findall(f".//{SVG}path[@d]")) >= len(graph.wires)
    heads = re.findall(r'd="M[\d.]+ [\d.]+l-8 -4v8z"', path.read_text())
    assert len(heads) == len(graph.wires)


def test_the_picture_is_the_same_each_time(loop: Diagram) -> None:
    assert draw(BlockGraph.of(loop, ["twin"])) == draw(BlockGraph.of(small_loop(), ["twin"]))


def test_columns_follow_the_data(loop: Diagram) -> None:
    column = columns(BlockGraph.of(loop, ["twin"]))
    assert column == {"station": 0, "twin/think": 1, "twin/see": 2, "twin/act": 3, "real_view": 4, "twin_view": 4}


graphs = st.integers(1, 9).flatmap(
    lambda n: st.lists(st.tuples(st.integers(0, n - 1), st.integers(0, 2), st.integers(0, n - 1)), max_size=22).map(
        lambda wires: (n, wires)
    )
)


@settings(max_examples=80, deadline=None)
@given(graphs)
def test_any_graph_can_be_drawn_at_right_angles_without_overlap(drawn) -> None:
    count, triples = drawn
    into: dict[int, int] = {}
    wires = []
    for source, port, sink in triples:
        into[sink] = into.get(sink, 0) + 1
        wires.append(((f"b{source}", f"o{port}"), (f"b{sink}", f"i{into[sink] - 1}")))
    blocks = tuple(
        Block(
            f"b{k}",
            f"b{k}" if k else "station",
            "Kind",
            "",
            tuple(f"i{j}" for j in range(into.get(k, 0))),
            ("o0", "o1", "o2"),
        )
        for k in range(count)
    )
    picture = layout(BlockGraph(blocks, tuple(wires)), lambda block: 100.0)
    for a, b in itertools.combinations(picture.blocks, 2):
        apart_x = a.x + a.width <= b.x or b.x + b.width <= a.x
        assert apart_x or a.y + a.height <= b.y or b.y + b.height <= a.y
    segments = []
    for number, wire in enumerate(picture.wires):
        for line in wire.lines:
            for (x0, y0), (x1, y1) in itertools.pairwise(line):
                assert x0 == x1 or y0 == y1
                assert 0 <= min(x0, x1) and max(x0, x1) <= picture.width and max(y0, y1) <= picture.height
                if x0 == x1 and y0 != y1:
                    segments.append((number, x0, min(y0, y1), max(y0, y1)))
    for (m, x, low, high), (n, other_x, other_low, other_high) in itertools.combinations(segments, 2):
        assert m == n or x != other_x or high <= other_low or other_high <= low, "two nets on one line"
    assert sum(len(wire.arrows) for wire in picture.wires) == len(wires)


def test_tracks_are_ordered_so_that_few_wires_cross() -> None:
    down = [([10.0 * k], [10.0 * k + 100]) for k in range(5)]
    assert order_tracks(down) == [4, 3, 2, 1, 0]
    rng = np.random.default_rng(0)
    for _ in range(20):
        wires = [([a], [b]) for a, b in zip(rng.permutation(5) * 10.0, rng.permutation(5) * 10.0 + 5, strict=True)]

        def total(tracks, wires=wires) -> int:
            order = sorted(range(5), key=lambda k: tracks[k])
            return sum(crossings(wires[a], wires[b]) for a, b in itertools.combinations(order, 2))

        best = min(total(p) for p in itertools.permutations(range(5)))
        assert total(order_tracks(wires)) <= best + 1


# Plots.


def samples(objects: int = 2, count: int = 60) -> RunRecord:
    time = np.arange(count) / 60
    poses = np.tile([1.0, 0, 0, 0, 0.5, 0, 0.1], (count, objects, 1))
    turned = poses.copy()
    turned[:, :, :4] = [np.cos(0.05), 0, 0, np.sin(0.05)]
    turned[:, :, 4] += 0.003
    status = np.full((count, objects), int(ObjectStatus.TRACKED))
    status[:5] = ObjectStatus.UNSEEN
    status[20:30] = ObjectStatus.STALE
    return RunRecord(
        time, np.ones((count, objects)), poses, turned, status, np.zeros((count, 14)), np.full((count, 14), 1e-4),
        0.8 * np.ones(count), 0.1 * np.ones(count), 0.1 + 0 * time, np.zeros(count, dtype=np.int64), 0.5 - 0.4 * time,
        0 * time, np.zeros((32, 3)), ["mug", "can"][:objects], {"mug": None, "can": "z"}, {},
        [f"axis_{k}" for k in range(7)],
    )  # fmt: skip


def summary(**fields) -> dict:
    whole = {
        "alarms": [{"time": 0.5, "kind": "rollout"}],
        "payload": {"mass_true": 0.8},
        "timing": {"real_time_factor": 0.9, "systems": {"Mpc": 0.5, "Station": 0.5}},
    }
    return {**whole, **fields}


@pytest.mark.long
def test_plots_are_written_and_not_empty(tmp_path: Path) -> None:
    files = plots.write_plots(samples(), summary(), tmp_path)
    assert [f.name for f in files] == ["objects.png", "arm.png", "payload.png", "clearance.png", "timing.png"]
    for file in files:
        image = np.asarray(Image.open(file).convert("L"), dtype=float)
        assert image.shape[1] == 1500 and image.std() > 5
    again = plots.write_plots(samples(), summary(), tmp_path / "again")
    assert [f.read_bytes() for f in again] == [f.read_bytes() for f in files]


@pytest.mark.long
def test_plots_of_a_run_that_saw_weighed_and_wanted_nothing(tmp_path: Path) -> None:
    run = samples(objects=0)
    run.mass = run.mass_std = np.full(60, np.nan)
    run.goal_error = np.full(60, np.nan)
    files = plots.write_plots(run, summary(alarms=[], timing={}), tmp_path)
    assert [f.name for f in files] == ["arm.png", "clearance.png"]
    run = samples()
    run.status[:] = ObjectStatus.UNSEEN
    assert len(plots.write_plots(run, summary(payload={"mass_true": None}), tmp_path)) == 5


def test_the_arms_plot_names_joints_and_shows_prismatic_ones_in_millimetres(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []
    monkeypatch.setattr(plots, "_save", lambda figure, path: drawn.append(figure) or path)

    def words(prismatic: tuple[str, ...]) -> tuple[list[str], list[str]]:
        run = samples()
        run.prismatic = prismatic
        plots.arm(run, [], tmp_path / "arm.png")
        legend = [text.get_text() for text in drawn[-1].legends[0].get_texts()]
        return legend, [axes.get_ylabel() for axes in drawn[-1].axes]

    names = samples().joint_names()
    assert words(()) == (names, ["[mrad]", "[mrad/s]"])
    legend, units = words(("axis_2",))
    assert legend[1:3] == ["axis_1 [mrad]", "axis_2 [mm]"]
    assert units == ["[mrad], [mm]", "[mrad/s], [mm/s]"]
    assert words(tuple(names)) == (names, ["[mm]", "[mm/s]"])


def test_errors_leave_out_the_turn_about_an_axis_of_symmetry() -> None:
    position, rotation = plots.object_errors(samples())
    np.testing.assert_allclose(position, 3.0, atol=1e-9)
    np.testing.assert_allclose(rotation[:, 0], np.degrees(0.1), atol=1e-9)
    np.testing.assert_allclose(rotation[:, 1], 0.0, atol=1e-6)


# Ghosts, ellipsoids, Meldis, files.

TWIN = scenario.Twin(fixtures=[scenario.Fixture()], library={"can": "objects/can", "box": "objects/cracker_box"})


def test_ghosts_are_blue_and_fixtures_hidden() -> None:
    builder = DiagramBuilder()
    scene = add_twin_scene(builder, TWIN)
    inspector = scene.scene_graph.model_inspector()
    plant = scene.plant

    def shown() -> dict[str, int]:
        counts: dict[str, int] = {}
        for geometry_id in inspector.GetAllGeometryIds(Role.kIllustration):
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(geometry_id))
            name = plant.GetModelInstanceName(body.model_instance())
            counts[name] = counts.get(name, 0) + 1
        return counts

    before, collisions = shown(), inspector.NumGeometriesWithRole(Role.kProximity)
    make_ghost(scene)
    after = shown()
    assert "table" in before and after == {name: n for name, n in before.items() if name != "table"}
    assert inspector.NumGeometriesWithRole(Role.kProximity) == collisions
    for geometry_id in inspector.GetAllGeometryIds(Role.kIllustration):
        properties: IllustrationProperties = inspector.GetIllustrationProperties(geometry_id)
        colour = properties.GetProperty("phong", "diffuse")
        assert colour.b() == OBJECT_COLOUR.b() and 0 < colour.a() < 1


@pytest.mark.parametrize("vertex", ["v ", "v\t", "  v "])
def test_a_mesh_with_names_in_another_encoding_becomes_a_ghost_too(vertex: str, tmp_path: Path) -> None:
    file = tmp_path / "link.obj"
    text = "# Gehäuse\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"
    file.write_bytes(text.replace("v ", vertex).encode("latin-1"))
    contents = _swollen_mesh(file, np.ones(3)).source().in_memory().mesh_file.contents()
    assert b"v -0.0015 -0.0015 -0.0015" in contents and b"f 1 2 4" in contents


def test_a_mesh_swells_alike_on_all_sides_whatever_its_scale(tmp_path: Path) -> None:
    file, scale = tmp_path / "link.obj", np.array([2.0, -0.5, 0.001])
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 100\nf 1 2 3\n")
    contents = _swollen_mesh(file, scale).source().in_memory().mesh_file.contents().decode()
    vertices = np.array([line.split()[1:] for line in contents.splitlines() if line.startswith("v ")], dtype=float)
    np.testing.assert_allclose(np.ptp(vertices, axis=0) * np.abs(scale), [2.003, 0.503, 0.103], rtol=1e-5)


def test_shades_end_where_a_condition_does() -> None:
    time = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    assert plots._spans(time, np.array([False, True, True, False, True])) == [(0.5, 1.5), (2.0, 2.0)]


@given(st.lists(st.floats(-1, 1), min_size=9, max_size=9))
def test_ellipsoids_span_the_covariance(numbers: list[float]) -> None:
    root = np.array(numbers).reshape(3, 3)
    R_WE, half_axes = ellipsoid(root @ root.T + 1e-4 * np.eye(3))
    R = R_WE.matrix()
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-9)
    rebuilt = R @ np.diag((half_axes / DEVIATIONS) ** 2) @ R.T
    np.testing.assert_allclose(rebuilt, root @ root.T + 1e-4 * np.eye(3), atol=1e-9)


def test_meldis_gets_both_scenes_on_channels_of_their_own() -> None:
    lcm = DrakeLcm("memq://")
    builder = DiagramBuilder()
    scene = add_twin_scene(builder, TWIN)
    source = builder.AddSystem(ConstantVectorSource(scene.default_positions))
    builder.Connect(source.get_output_port(), scene.positions_input)
    # One SceneGraph stands in for both scenes here: it is the channels that count.
    meldis.add_meldis(builder, lcm, scene.query_output, scene.query_output)
    loads = [Subscriber(lcm, c[0], lcmt_viewer_load_robot) for c in (meldis.REAL_CHANNELS, meldis.TWIN_CHANNELS)]
    draws = [Subscriber(lcm, c[1], lcmt_viewer_draw) for c in (meldis.REAL_CHANNELS, meldis.TWIN_CHANNELS)]
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    simulator.AdvanceTo(0.1)
    lcm.HandleSubscriptions(0)
    for load, draw_ in zip(loads, draws, strict=True):
        assert load.count == 1 and draw_.count >= 3
        names = [link.name for link in load.message.link]
        assert any("can" in name for name in names) and any("panda_link7" in name for name in names)
        assert draw_.message.num_links == len(draw_.message.link_name) > 10


def test_meldis_itself_shows_both_scenes(monkeypatch: pytest.MonkeyPatch) -> None:
    viewer = pytest.importorskip("pydrake.visualization._meldis", reason="this Drake keeps Meldis elsewhere")
    monkeypatch.setenv("LCM_DEFAULT_URL", "memq://")
    shown = viewer.Meldis()
    builder = DiagramBuilder()
    scene = add_twin_scene(builder, TWIN)
    source = builder.AddSystem(ConstantVectorSource(scene.default_positions))
    builder.Connect(source.get_output_port(), scene.positions_input)
    meldis.add_meldis(builder, shown._lcm, scene.query_output, scene.query_output)
    load = Subscriber(shown._lcm, meldis.TWIN_CHANNELS[0], lcmt_viewer_load_robot)
    Simulator(builder.Build()).Initialize()
    shown._lcm.HandleSubscriptions(0)
    shown._invoke_subscriptions()
    assert len(load.message.link) > 10
    for link in load.message.link:
        path = f"{link.robot_num}/{link.name.replace('::', '/')}"
        for root in ("/DRAKE_VIEWER", "/Visual Geometry"):
            assert shown.meshcat.HasPath(f"{root}/{path}"), path


def test_files_appear_whole_or_not_at_all(tmp_path: Path) -> None:
    path = atomic_file.write(tmp_path / "a" / "b.txt", "first")
    assert path.read_text() == "first"
    with pytest.raises(TypeError):
        atomic_file.write(path, 3)  # type: ignore[arg-type]
    assert path.read_text() == "first" and [p.name for p in path.parent.iterdir()] == ["b.txt"]
