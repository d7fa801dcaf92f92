"""What a noisy picture of a bin shows, and what several in a row make of its noise."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from twin_diagram.errors import StationError
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.runs.learning.bin_view import TUNING, bottom_noise, things_within
from twin_diagram.runs.learning.cell import Picture
from twin_diagram.runs.learning.steady_picture import TUNING as STEADY
from twin_diagram.runs.learning.steady_picture import middle_depth, resting_picture, steady_picture

HEIGHT, LOW, HIGH = 0.95, np.array([-0.15, -0.2, 0.0]), np.array([0.15, 0.2, 0.12])
CAMERA = ViewCamera(
    width=320, height=240, fx=300.0, fy=300.0, cx=159.5, cy=119.5, R_WC=np.diag([1.0, -1.0, -1.0]),
    p_WC=np.array([0.0, 0.0, HEIGHT]),
)  # fmt: skip


def looked(noise: float, seed: int = 0) -> np.ndarray:
    """Depth of a bin's bottom with a box of 6 x 8 x 5 cm on it, noisy in patches as stereo cameras are [m]."""
    rng = np.random.default_rng(seed)
    rays = CAMERA.rays()[..., :2]
    top = (np.abs(rays * (HEIGHT - 0.05)) <= [0.03, 0.04]).all(axis=-1)
    patches = ndimage.gaussian_filter(rng.normal(size=rays.shape[:2]), 1.5)
    return np.asarray(np.where(top, HEIGHT - 0.05, HEIGHT) + noise * patches / patches.std(), dtype=np.float32)


def picture(depth: np.ndarray) -> Picture:
    return Picture(np.zeros((240, 320, 3), dtype=np.uint8), depth, CAMERA, 0.0, np.zeros(7), np.zeros(2))


def test_noise_of_the_bottom_makes_no_things() -> None:
    for noise in (0.0003, 0.0015, 0.003):
        depth = looked(noise)
        heights = picture(depth).points()[..., 2].ravel()
        np.testing.assert_allclose(bottom_noise(heights), max(TUNING.noise, noise), rtol=0.1)
        things = things_within(picture(depth), LOW, HIGH)
        assert len(things) == 1
        np.testing.assert_allclose(things[0].middle[:2], 0.0, atol=0.005)
        np.testing.assert_allclose(things[0].top, 0.05, atol=0.004 + 2.0 * noise)


def test_the_bottom_is_seen_through_holes_alone() -> None:
    """A ring, 3.5 cm high, has a hole of 4 cm; in another one a patch of 4 cm has no depth."""
    rays = CAMERA.rays()[..., :2] * (HEIGHT - 0.035)
    for middle in ([0.0, 0.0], [0.08, -0.1]):
        off = np.hypot(*(rays - middle).transpose(2, 0, 1))
        depth = np.where((off < 0.045) & (off > 0.02), HEIGHT - 0.035, HEIGHT).astype(np.float32)
        (one,) = things_within(picture(depth), LOW, HIGH)
        assert len(one.through) > 100 and np.abs(one.through[:, 2]).max() < 1e-3
        (blind,) = things_within(picture(np.where(off < 0.02, np.float32(0.0), depth)), LOW, HIGH)
        assert len(blind.points) == len(one.points) and not len(blind.through)


def test_where_the_bottom_is_covered_its_noise_is_the_least_one() -> None:
    assert bottom_noise(np.full(5000, 0.03)) == TUNING.noise
    assert bottom_noise(np.full(100, -0.005)) == TUNING.noise


def test_the_middle_of_several_pictures_is_less_noisy_and_has_no_depth_where_most_have_none() -> None:
    depths = np.stack([looked(0.002, seed) for seed in range(5)])
    depths[:2, 0, 0] = 0.0
    depths[:3, 0, 1] = 0.0
    depths[4, 0, 2] = 0.3  # a pixel between two surfaces, once
    middle = middle_depth(depths)
    assert middle.dtype == np.float32
    assert middle[0, 0] == np.sort(depths[:, 0, 0])[3] and middle[0, 1] == 0.0 and middle[0, 2] > 0.9
    assert np.std(middle[1:60] - HEIGHT) < 0.6 * 0.002
    np.testing.assert_array_equal(middle_depth(depths[:1]), depths[0])


def test_a_camera_that_sees_nothing_is_told_of_and_not_taken_for_an_empty_bin() -> None:
    cell: Any = SimpleNamespace(wait=lambda seconds: None, look=lambda name: picture(np.zeros((240, 320), np.float32)))
    with pytest.raises(StationError, match=r"camera 'bin' measures no depth.*--resume") as error:
        steady_picture(cell, "bin")
    assert "\n" not in str(error.value)
    cell.look = lambda name: picture(looked(0.002))
    assert steady_picture(cell, "bin").depth.all()


def test_what_still_moves_is_waited_for_and_noise_is_not() -> None:
    """A ring slid off the bin's rim while the arm was on its way, and the fingers closed where it had been."""
    clock, seed = [0.0], iter(range(1000))

    def wait(seconds: float) -> None:
        clock[0] += seconds

    def cell_of(slides_until: float, speed: float) -> Any:
        def look(name: str) -> Picture:
            depth = looked(0.002, next(seed))
            at = 100 + int(min(clock[0], slides_until) * speed)
            depth[100:130, at : at + 30] -= np.float32(0.05)
            return picture(depth)

        clock[0] = 0.0
        return SimpleNamespace(wait=wait, look=look)

    box = np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 0.2])
    resting_picture(cell_of(0.0, 0.0), "bin", *box)
    once = clock[0]
    assert once < 1.5 * STEADY.rest
    seen = resting_picture(cell_of(2.5, 20.0), "bin", *box)
    assert clock[0] > 2.5 + STEADY.rest and seen.depth[115, 150 + 15] < seen.depth[115, 120] - 0.04
    resting_picture(cell_of(1e9, 5.0), "bin", *box)
    assert clock[0] == pytest.approx(STEADY.looks * once), "what never rests is taken as it is"
    beside = np.array([5.0, 5.0, 0.0]), np.array([6.0, 6.0, 0.2])
    resting_picture(cell_of(1e9, 5.0), "bin", *beside)
    assert clock[0] == pytest.approx(once), "nobody asks what moves elsewhere"
