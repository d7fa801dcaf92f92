"""All that a real depth camera does to exact depth comes into its images, each by its profile's figure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_diagram.scenario import Camera
from twin_diagram.signals.lens import Lens
from twin_diagram.station.depth_units import Depth
from twin_diagram.station.sim.camera_profiles import PROFILES, CameraFaults
from twin_diagram.station.sim.depth_sensor import DepthSensor

LENS = Lens(640, 480, 6000.0, 6000.0, 319.5, 239.5)
"""Narrow: lines of sight are parallel to half a degree."""
QUIET = replace(PROFILES["d435"], depth_noise=0.0, edge_jitter=0.0)


def measured(depth: Depth, off: CameraFaults, reflective: np.ndarray | None = None) -> Depth:
    camera = Camera(width=LENS.width, height=LENS.height, focal=LENS.fx)
    return DepthSensor(LENS, camera, off, 1e-4, 1.0, 3).measured(depth, 7, reflective)


def tilted(degrees: float) -> Depth:
    """Depth of a plane whose normal has this angle with the lines of sight, 1 m away."""
    angle, u = np.radians(degrees), (np.arange(LENS.width) - LENS.cx) / LENS.fx
    z = np.cos(angle) / (np.cos(angle) + np.sin(angle) * u)
    return np.broadcast_to(z, (LENS.height, LENS.width)).astype(np.float32)


@pytest.mark.parametrize(("degrees", "seen"), [(71.0, True), (79.0, False)])
def test_no_depth_beyond_75_degrees(degrees: float, seen: bool) -> None:
    assert bool((measured(tilted(degrees), QUIET) > 0.0).all()) == seen
    assert bool((measured(tilted(degrees), QUIET) > 0.0).any()) == seen


def test_a_fifth_of_the_pixels_at_an_edge_float() -> None:
    depth = np.ones((LENS.height, LENS.width), np.float32)
    depth[:, 300:] = 2.0
    found = measured(depth, QUIET)
    between = (found > 1.001) & (found < 1.999)
    assert between[:, 299:301].mean() == pytest.approx(0.2, abs=0.04)
    assert not np.delete(between, (299, 300), axis=1).any()


def test_reflective_surfaces_alone_are_lost_or_too_deep() -> None:
    half = np.zeros((LENS.height, LENS.width), bool)
    half[:, :320] = True
    found = measured(np.ones(half.shape, np.float32), replace(QUIET, flying_pixels=0.0), half)
    np.testing.assert_allclose(found[:, 320:], 1.0, atol=1e-4)
    lost, deep = found[:, :320] == 0.0, found[:, :320] > 1.001
    assert lost.mean() == pytest.approx(0.3, abs=0.08) and deep.mean() == pytest.approx(0.3, abs=0.08)
    assert 1.005 - 1e-4 <= found[:, :320][deep].min() and found.max() <= 1.03 + 1e-4


@pytest.mark.parametrize(("depth", "seen"), [(0.19, False), (0.21, True), (2.99, True), (3.01, False)])
def test_the_range_ends_where_it_is_told(depth: float, seen: bool) -> None:
    found = measured(np.full((LENS.height, LENS.width), depth, np.float32), QUIET)
    assert bool((found > 0.0).all()) == bool((found > 0.0).any()) == seen
