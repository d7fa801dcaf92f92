"""Edges of real depth: where they lie, and what floats between their sides."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.scenario import Camera, CameraDefects
from twin_diagram.scenario.lenses import colour_lens
from twin_diagram.station.sim.camera_defects import edges
from twin_diagram.station.sim.camera_edges import flying, jittered
from twin_diagram.station.sim.camera_profiles import faults
from twin_diagram.station.sim.depth_sensor import DepthSensor

STEP = np.where(np.arange(80) < 40, 1.0, 1.5)[None, :].repeat(400, 0).astype(np.float32)


@pytest.mark.parametrize("jitter", [0.8, 1.6])
def test_an_edge_lies_aside_by_its_jitter(jitter: float) -> None:
    rows = np.concatenate([(jittered(STEP, jitter, 2.5, np.random.default_rng(k)) < 1.2).sum(axis=1) for k in range(8)])
    assert rows.mean() == pytest.approx(40.0, abs=0.25)
    assert rows.std() == pytest.approx(np.sqrt(jitter**2 + 1 / 12), rel=0.1)
    lying = np.ascontiguousarray(STEP.T)
    down = [(jittered(lying, jitter, 2.5, np.random.default_rng(k)) < 1.2).sum(axis=0) for k in range(8)]
    assert np.std(down) == pytest.approx(np.sqrt(jitter**2 + 1 / 12), rel=0.1)


def test_surfaces_stay_as_they_are() -> None:
    slope = (1.0 + 0.003 * np.arange(80) + 0.5 * (np.arange(80) >= 40))[None, :].repeat(60, 0).astype(np.float32)
    found = jittered(slope, 0.8, 2.5, np.random.default_rng(1))
    far = np.abs(np.arange(80) - 39.5) > 5
    np.testing.assert_array_equal(found[:, far], slope[:, far])
    kept = np.abs(found - slope) < 0.1
    np.testing.assert_array_equal(found[kept], slope[kept])
    assert not kept.all()
    assert jittered(slope, 0.0, 2.5, np.random.default_rng(1)) is slope


def test_a_share_of_the_edges_pixels_floats_between_the_sides() -> None:
    at = edges(STEP)
    found = flying(STEP, at, 0.2, np.random.default_rng(4))
    changed = found != STEP
    assert not changed[~at].any()
    assert changed[at].mean() == pytest.approx(0.2, abs=0.05)
    between = found[changed]
    assert between.min() > 1.0 and between.max() < 1.5
    assert between.mean() == pytest.approx(1.25, abs=0.03) and between.std() == pytest.approx(
        0.5 / np.sqrt(12), rel=0.1
    )


def test_nothing_floats_where_there_is_no_depth() -> None:
    step = np.where(STEP > 1.2, np.float32(0.0), STEP)
    found = flying(step, edges(step), 1.0, np.random.default_rng(4))
    np.testing.assert_array_equal(found, step)
    assert flying(STEP, edges(STEP), 0.0, np.random.default_rng(4)) is STEP


@pytest.mark.parametrize("width", [320, 640, 1280])
def test_a_camera_s_edges_jitter_by_figures_of_640_pixels(width: int) -> None:
    """0.8 px at 640 a row, alike over 2.5 px: half of both at 320, twice at 1280."""
    off = faults(CameraDefects(profile="d435", depth_noise=0.0, flying_pixels=0.0))
    camera, share = Camera(width=width, height=480, focal=width), width / 640
    sensor = DepthSensor(colour_lens(camera), camera, off, 0.001, 1.0, 3)
    step = np.where(np.arange(width) < width // 2, 1.0, 1.5)[None, :].repeat(480, 0).astype(np.float32)
    rows = np.array([(sensor.measured(step, k) < 1.2).sum(axis=1) for k in range(8)])
    assert rows.std() == pytest.approx(np.sqrt((0.8 * share) ** 2 + 1 / 12), rel=0.12)
    apart = round(5 * share)  # two sigmas: correlated by 1/e
    away = rows - rows.mean()
    alike = (away[:, apart:] * away[:, :-apart]).mean() / (0.8 * share) ** 2
    assert alike == pytest.approx(np.exp(-((apart / (2.5 * share)) ** 2) / 4.0), abs=0.12)
