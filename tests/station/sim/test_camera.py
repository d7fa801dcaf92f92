"""The camera without a renderer: its intrinsics, its light, its shutter, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Camera, Pose, Scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station import make_station
from twin_diagram.station.sim.camera import Shutter, camera_info, check_camera
from twin_diagram.station.sim.render_settings import clipping, lights


def test_the_principal_point_is_the_images_middle_as_the_renderer_counts_pixels() -> None:
    info = camera_info(Camera(width=640, height=482, focal=611.0))
    assert (info.width(), info.height(), info.focal_x(), info.focal_y()) == (640, 482, 611.0, 611.0)
    assert (info.center_x(), info.center_y()) == (320.0, 241.0)


def test_drawn_is_more_than_is_measured() -> None:
    for measured, wanted in (([0.2, 3.0], (0.05, 20.0)), ([0.06, 15.0], (0.03, 30.0))):
        found = clipping(Camera(depth_range=measured))
        assert (found.near(), found.far()) == pytest.approx(wanted)


GOOD = Camera(width=1, height=1, focal=0.1, rate=10.0, latency=0.05, depth_range=[0.1, 0.2])


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"name": ""}, "name"),
        ({"name": "a/b"}, "name"),
        ({"width": 0}, "width"),
        ({"height": -1}, "height"),
        ({"focal": 0.0}, "focal"),
        ({"rate": 0.0}, "rate"),
        ({"latency": 0.0}, "latency"),
        ({"latency": -0.01}, "latency"),
        ({"latency": 0.1}, "latency"),
        ({"latency": 0.11}, "latency"),
        ({"depth_range": [0.0, 1.0]}, "depth_range"),
        ({"depth_range": [1.0, 1.0]}, "depth_range"),
        ({"depth_range": [2.0, 1.0]}, "depth_range"),
        ({"depth_range": [0.5, 1.0, 2.0]}, "depth_range"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(change: dict[str, object], field: str) -> None:
    with pytest.raises(ScenarioError, match=rf"twin\.camera\.{field}"):
        check_camera(replace(GOOD, **change))


def test_what_just_can_be_is_allowed() -> None:
    for latency in (1e-6, 0.06, 0.0999):
        check_camera(replace(GOOD, latency=latency, name="left-eye_2"))


# Light.


def shine(normal: Array) -> float:
    """How bright a white face is that looks along a normal."""
    total = 0.0
    for light in lights():
        direction = np.array(light.direction)
        assert light.type == "directional" and light.frame == "world"
        total += light.intensity * max(0.0, float(-normal @ direction / np.linalg.norm(direction)))
    return total


def test_every_face_that_a_camera_sees_is_lit_and_keeps_its_colour() -> None:
    """Brightness of faces up and to the sides, worked out by hand from the sun and two softer lights."""
    sun, left, right = (np.array(d) for d in ([-0.3, 0.2, -1.0], [-1.0, 0.9, -0.5], [-0.8, -1.0, -0.4]))
    strong = [0.75 / np.sqrt(1.13), 0.45 / np.sqrt(2.06), 0.35 / np.sqrt(1.8)]
    assert np.linalg.norm(sun) ** 2 == pytest.approx(1.13) and np.linalg.norm(left) ** 2 == pytest.approx(2.06)
    faces = {(0, 0, 1): [1.0, 0.5, 0.4], (1, 0, 0): [0.3, 1.0, 0.8], (0, 1, 0): [0.0, 0.0, 1.0]}
    faces |= {(0, -1, 0): [0.2, 0.9, 0.0], (0.6, 0.8, 0): [0.02, 0.0, 1.28], (0.6, 0, 0.8): [0.98, 1.0, 0.8]}
    for normal, shares in faces.items():
        assert shine(np.array(normal)) == pytest.approx(float(np.dot(shares, strong)), rel=1e-6), normal
    rng = np.random.default_rng(2031)
    seen = rng.normal(size=(500, 3))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    bright = [shine(n) for n in seen[(seen[:, 2] > 0.0) & (seen[:, 0] > 0.0)]]  # towards the camera, and up
    assert min(bright) > 0.2 and max(bright) < 1.4 and right[1] < 0.0 < left[1]


# The shutter.


class Clock(LeafSystem):
    """Positions that are functions of time."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareVectorOutputPort("positions", 2, self._calc, {self.time_ticket()})

    @staticmethod
    def _calc(context: Context, output: BasicVector) -> None:
        output.SetFromVector([context.get_time(), 10.0 + context.get_time()])


@pytest.mark.parametrize("latency", [0.03, 0.08])
def test_a_picture_is_of_its_moment_and_is_delivered_later(latency: float) -> None:
    builder = DiagramBuilder()
    clock, shutter = builder.AddSystem(Clock()), builder.AddSystem(Shutter(np.array([7.0, 8.0]), 10.0, latency))
    builder.Connect(clock.get_output_port(), shutter.get_input_port())
    simulator = Simulator(builder.Build())
    context = shutter.GetMyContextFromRoot(simulator.get_context())
    times = np.array([-0.029, -0.001, 0.001, 0.099, 0.101, 0.199, 0.201]) + latency
    for time, taken in zip(times, (NEVER, NEVER, 0.0, 0.0, 0.1, 0.1, 0.2), strict=True):
        simulator.AdvanceTo(time)
        shown = shutter.GetOutputPort("positions_shown").Eval(context)
        assert shutter.GetOutputPort("capture_time").Eval(context)[0] == pytest.approx(taken), time
        np.testing.assert_allclose(shown, [7.0, 8.0] if taken < 0.0 else [taken, 10.0 + taken], atol=1e-9)


def test_where_nothing_stands_the_sky_is_grey(egl: None) -> None:
    plan = Scenario(seed=1)
    plan.world.objects, plan.world.fixtures = {}, []
    plan.world.camera_defects.colour_noise = 0.0
    plan.twin.camera = Camera(X_WC=Pose([3.0, 0.0, 1.0]), width=16, height=12, focal=20.0)  # looks up
    station = make_station(plan)
    simulator = Simulator(station)
    simulator.AdvanceTo(0.04)
    image = station.GetOutputPort("camera.rgb_image").Eval(simulator.get_context())
    colours = image.data.reshape(-1, 4)[:, :3].astype(float) / 255.0
    np.testing.assert_allclose(colours, np.tile([0.72, 0.76, 0.80], (len(colours), 1)), atol=0.01)
