"""Colours in little light."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.scenario import CameraDefects
from twin_diagram.station.sim.camera_light import DimLight, mean_of
from twin_diagram.station.sim.camera_profiles import faults

OFF = faults(CameraDefects("d435", light=0.5, shot_noise=6.0))


@pytest.mark.parametrize("level", [40, 120, 240])
def test_dark_pictures_scatter_with_the_square_root_of_light(level: int) -> None:
    image = np.full((60, 80, 4), level, np.uint8)
    light = DimLight(image.size, 2.0, OFF, 3)
    seen = light.seen(image, 5)
    assert (seen[..., 3] == 255).all() and (image == level).all()
    colours = seen[..., :3].astype(float)
    assert colours.mean() == pytest.approx(0.5 * level, abs=0.2)
    assert colours.std() == pytest.approx(np.sqrt(4.0 + 36.0 * 0.5 * level / 255.0 + 1 / 12), rel=0.04)
    np.testing.assert_array_equal(DimLight(image.size, 2.0, OFF, 3).seen(image, 5), seen)
    assert (light.seen(image, 6) != seen).mean() > 0.4


def test_blur_is_the_mean_of_two_pictures() -> None:
    first, second = np.array([[[0, 255, 200, 255]]], np.uint8), np.array([[[10, 255, 101, 255]]], np.uint8)
    np.testing.assert_array_equal(mean_of(first, second), [[[5, 255, 151, 255]]])
