"""What is seen too steeply, and what reflects."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.scenario import CameraDefects
from twin_diagram.signals.lens import Lens, unit_rays
from twin_diagram.station.sim.camera_materials import Reflections, incidence_cosine
from twin_diagram.station.sim.camera_profiles import faults

LENS = Lens(256, 192, 240.0, 220.0, 120.0, 100.0)


@pytest.mark.parametrize("normal", [[0.0, 0.0, -1.0], [0.8, 0.1, -0.6], [-0.3, -0.9, -0.3], [0.1, -0.97, -0.2]])
def test_the_angle_is_that_between_normal_and_line_of_sight(normal: list[float]) -> None:
    n = np.array(normal) / np.linalg.norm(normal)
    rays = unit_rays(LENS)
    depth = -1.2 / (rays @ n - 1e-12)
    seen = (depth > 0.05) & (depth < 20.0)
    wanted = -(rays @ n) / np.linalg.norm(rays, axis=-1)
    found = incidence_cosine(np.where(seen, depth, 0.0).astype(np.float32), LENS)
    inner = (
        seen & np.roll(seen, 1, 0) & np.roll(seen, -1, 0) & np.roll(seen, 1, 1) & np.roll(seen, -1, 1) & (depth < 4.0)
    )
    assert inner.sum() > 200
    # Slopes over a whole pixel are flatter than those at its middle.
    np.testing.assert_allclose(found[inner], wanted[inner], atol=0.02)
    assert np.median(np.abs(found - wanted)[inner]) < 0.004


def test_an_edge_is_not_a_steep_surface() -> None:
    depth = np.where(np.arange(256) < 120, 1.0, 2.0)[None, :].repeat(192, 0).astype(np.float32)
    assert incidence_cosine(depth, LENS)[80:120, 116:124].min() > 0.95


def test_patches_of_what_reflects_are_lost_or_too_deep() -> None:
    shape = (240, 320)
    patches = Reflections(shape, faults(CameraDefects("d435", reflective_lost=0.2, reflective_deep=0.4)), 3)
    depth = np.full(shape, 1.0, np.float32)
    shining = np.zeros(shape, bool)
    shining[:, 100:] = True
    found = patches.on(depth, shining)
    np.testing.assert_array_equal(found[:, :100], depth[:, :100])
    lost, deep = found == 0.0, found > 1.0
    assert lost[shining].mean() == pytest.approx(0.2, abs=0.08) and deep[shining].mean() == pytest.approx(0.4, abs=0.1)
    assert (found[deep] >= 1.005 - 1e-6).all() and (found[deep] <= 1.03 + 1e-6).all()
    assert found[deep].max() - found[deep].min() > 0.02
    # Patches, not single pixels: most neighbours of a lost pixel are lost.
    assert lost[:, 101:][lost[:, 100:-1]].mean() > 0.8
    usual = [Reflections(shape, faults(CameraDefects("d435")), seed).lost for seed in (3, 3, 4)]
    np.testing.assert_array_equal(usual[0], usual[1])
    assert (usual[0] != usual[2]).any()
    assert (depth == 1.0).all()


def test_patches_are_as_large_in_finer_images() -> None:
    """σ of 8 px at 640 pixels a row: twice as many pixels at 1280, as large on the surface."""
    width = []
    for shape in ((240, 320), (960, 1280)):
        lost = Reflections(shape, faults(CameraDefects("d435", reflective_lost=0.5)), 3).lost
        width.append(shape[1] * shape[0] / np.count_nonzero(lost[:, 1:] != lost[:, :-1]) / shape[1])
    assert width[1] / width[0] == pytest.approx(1.0, abs=0.3)
