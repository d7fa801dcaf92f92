"""The camera's defects held against figures that are worked out by hand, without a renderer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Camera, CameraDefects
from twin_diagram.station.sim.camera_defects import CameraDefectsSystem, edges, spoil_colour, spoil_depth
from twin_diagram.station.sim.noise import Stream, generator

SMALL = Camera(width=12, height=8, focal=10.0, rate=10.0, latency=0.05)
CLEAN = CameraDefects(depth_noise=0.0, colour_noise=0.0, edge_dropout=0.0, depth_unit=1e-4)


@pytest.mark.parametrize("depth", [0.5, 2.0])
def test_a_step_of_one_and_a_half_percent_is_an_edge(depth: float) -> None:
    """Against the depth of the pixel further right, or further down."""
    for share, edge in ((0.013, False), (0.017, True), (-0.013, False), (-0.017, True)):
        row = np.array([[depth * (1.0 + share), depth, depth, depth]], dtype=np.float32)
        wanted = [edge, edge, False, False]
        np.testing.assert_array_equal(edges(row), [wanted])
        np.testing.assert_array_equal(edges(row.T), np.array([wanted]).T)
        both = np.tile(row, (3, 1))
        np.testing.assert_array_equal(edges(both), [wanted] * 3)


def test_depth_noise_is_that_of_the_frame_and_grows_with_depth_squared() -> None:
    defects = CameraDefects(depth_noise=0.002, edge_dropout=0.0, depth_unit=1e-4)
    truth = np.linspace(0.5, 2.5, 600, dtype=np.float32).reshape(20, 30)
    spoilt = spoil_depth(truth, defects, [0.2, 3.0], np.random.default_rng(5))
    noise = np.random.default_rng(5).standard_normal((20, 30), dtype=np.float32)
    np.testing.assert_allclose(spoilt, truth + 0.002 * truth**2 * noise, atol=0.6e-4)


def test_depth_without_defects_is_depth() -> None:
    truth = np.array([[0.3, 1.0, 2.9]], dtype=np.float32)
    found = spoil_depth(truth, CLEAN, [0.2, 3.0], np.random.default_rng(5))
    np.testing.assert_allclose(found, truth, atol=0.51e-4)


def test_the_ends_of_the_range_are_measured_and_what_lies_beyond_is_not() -> None:
    one, two = np.float32(0.5), np.float32(2.0)
    line = np.array([[np.nextafter(one, np.float32(0)), one, two, np.nextafter(two, np.float32(9))]])
    found = spoil_depth(line, CLEAN, [0.5, 2.0], np.random.default_rng(5))
    np.testing.assert_array_equal(found > 0.0, [[False, True, True, False]])


def test_edges_are_dropped_as_often_as_told_and_nothing_else() -> None:
    step = np.where(np.arange(200) % 20 < 10, 1.0, 1.4)[None, :].repeat(50, 0).astype(np.float32)
    for share in (0.3, 1.0):
        defects = CameraDefects(depth_noise=0.0, edge_dropout=share, depth_unit=1e-4)
        lost = spoil_depth(step, defects, [0.2, 3.0], np.random.default_rng(6)) == 0.0
        assert not lost[~edges(step)].any()
        assert np.mean(lost[edges(step)]) == pytest.approx(share, abs=0.04)
    kept = CameraDefects(depth_noise=0.0, edge_dropout=0.0, depth_unit=1e-4)
    assert (spoil_depth(step, kept, [0.2, 3.0], np.random.default_rng(6)) > 0.0).all()


def test_colour_noise_is_taken_from_the_table_at_the_frames_place() -> None:
    table = np.arange(-40, 40, dtype=np.int16)
    grey = np.full((2, 3, 4), 100, np.uint8)
    found = spoil_colour(grey, table, 10)
    wanted = (100 + table[10:34]).reshape(2, 3, 4)
    np.testing.assert_array_equal(found[..., :3], wanted[..., :3])
    assert (found[..., 3] == 255).all()


# The system.


def delivered(defects: CameraDefects, time: float, camera: Camera = SMALL, seed: int = 3) -> tuple[Any, Any, float]:
    system = CameraDefectsSystem(camera, defects, seed)
    context = system.CreateDefaultContext()
    rgb, depth = ImageRgba8U(camera.width, camera.height), ImageDepth32F(camera.width, camera.height)
    rgb.mutable_data[:], depth.mutable_data[:] = 100, 1.0
    system.GetInputPort("rgb_rendered").FixValue(context, Value(rgb))
    system.GetInputPort("depth_rendered").FixValue(context, Value(depth))
    system.GetInputPort("time_rendered").FixValue(context, [time])
    ports = [system.GetOutputPort(name).Eval(context) for name in ("rgb_image", "depth_image", "image_time")]
    return ports[0].data.copy(), ports[1].data[..., 0].copy(), float(ports[2][0])


def dark(defects: CameraDefects, time: float) -> bool:
    rgb, depth, taken = delivered(defects, time)
    assert taken == time and rgb.shape == (8, 12, 4) and depth.shape == (8, 12) and (rgb[..., 3] == 255).all()
    assert (rgb[..., :3].max() == 0) == (depth.max() == 0.0)
    return bool(depth.max() == 0.0)


def test_before_the_first_image_all_is_black_and_the_one_at_zero_is_one() -> None:
    assert dark(CLEAN, -1.0) and not dark(CLEAN, 0.0) and not dark(CLEAN, 0.1)


def test_a_covered_lens_is_dark_from_start_to_end_of_each_interval() -> None:
    covered = CameraDefects(covered=[[0.5, 0.7], [1.0, 1.0], [2.0, 3.0]])
    for time in (0.5, 0.6, 0.7, 1.0, 2.5):
        assert dark(covered, time), time
    for time in (0.4, 0.8, 0.99, 1.01, 3.1):
        assert not dark(covered, time), time


def test_noise_is_a_function_of_seed_and_frame() -> None:
    noisy = CameraDefects(depth_noise=0.01, colour_noise=5.0, edge_dropout=0.0, depth_unit=1e-4)
    for time, frame in ((0.2, 2), (0.7, 7)):
        rgb, depth, _ = delivered(noisy, time)
        noise = generator(3, Stream.CAMERA, frame).standard_normal((8, 12), dtype=np.float32)
        np.testing.assert_allclose(depth, 1.0 + 0.01 * noise, atol=0.6e-4)
        size = 12 * 8 * 4
        rng = generator(3, Stream.CAMERA_TABLE, 0)
        table = np.rint(5.0 * rng.standard_normal(size + 2**18, dtype=np.float32)).astype(int)
        offset = int(generator(3, Stream.CAMERA_TABLE, 1 + frame).integers(2**18))
        wanted = (100 + table[offset : offset + size]).reshape(8, 12, 4)
        np.testing.assert_array_equal(rgb[..., :3], wanted[..., :3])


def test_colour_noise_has_its_table_for_every_frame() -> None:
    """An image of one pixel and one of many have numbers at the last place that a frame may begin."""
    for camera in (Camera(width=1, height=1, rate=10.0), Camera(width=64, height=48, rate=10.0)):
        table = CameraDefectsSystem(camera, CameraDefects(colour_noise=2.0), 4)._table
        assert len(table) == camera.width * camera.height * 4 + 262144
        assert np.std(table) == pytest.approx(np.sqrt(2.0**2 + 1.0 / 12.0), rel=0.01)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"depth_noise": -1e-9}, "depth_noise"),
        ({"colour_noise": -1e-9}, "colour_noise"),
        ({"edge_dropout": -1e-9}, "edge_dropout"),
        ({"edge_dropout": float("nan")}, "edge_dropout"),
        ({"depth_unit": 0.0}, "depth_unit"),
        ({"depth_unit": -0.001}, "depth_unit"),
        ({"depth_unit": 2.9 / 65535}, "depth_unit"),
        ({"covered": [[1.0, 0.9]]}, r"covered\[0\]"),
        ({"covered": [[0.0, 1.0], [1.0]]}, r"covered\[1\]"),
        ({"covered": [[0.0, 1.0, 2.0]]}, r"covered\[0\]"),
    ],
)
def test_what_cannot_be_is_refused(change: dict[str, Any], field: str) -> None:
    with pytest.raises(ScenarioError, match=rf"world\.camera_defects\.{field}"):
        CameraDefectsSystem(SMALL, CameraDefects(**change), 1)


def test_what_just_can_be_is_allowed() -> None:
    CameraDefectsSystem(SMALL, CLEAN, 1)
    CameraDefectsSystem(SMALL, CameraDefects(depth_unit=3.0 / 65535 * (1.0 + 1e-12), covered=[[1.0, 1.0]]), 1)
    exact = Camera(width=2, height=2, depth_range=[0.2, 65535.0 * 2.0**-14])
    CameraDefectsSystem(exact, CameraDefects(depth_unit=2.0**-14), 1)
