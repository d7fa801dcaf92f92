"""Checks axes, lines and clouds of the report's pictures."""

from __future__ import annotations

import base64
import io
import re
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_diagram.gap.report import dots, panel
from twin_diagram.gap.report.comparison import Comparison
from twin_diagram.gap.report.panel import Panel
from twin_diagram.gap.report.pictures import residual_pictures
from twin_diagram.signals.arrays import Array


def run(position: Array) -> Comparison:
    """A made run of one joint: its residual is its speed's sign."""
    time = 0.002 * np.arange(len(position))
    v = np.gradient(position, time)
    left = np.sign(v)[:, None]
    parts = (position[:, None], v[:, None], np.gradient(v, time)[:, None], left, left, 0.1 * left)
    return Comparison("made", True, ("elbow",), time, *parts)


def test_the_report_loads_no_plotting_library() -> None:
    """Loading one, and its first picture, took longer than most of the search."""
    code = "import sys; import twin_diagram.gap.report.page; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@given(st.floats(-1e7, 1e7), st.floats(1e-7, 1e7), st.floats(3.0, 12.0))
def test_numbers_on_axes_are_where_and_what_they_say(low: float, wide: float, most: float) -> None:
    """A few of them, all different, and each written to where it stands."""
    wide = max(wide, 1e-3 * abs(low))  # as pictures have it
    told = panel.labelled((low, low + wide), most)
    assert 1 <= len(told) <= most + 2
    assert len({word for _, word in told}) == len(told)
    for value, word in told:
        assert low - 1e-6 * wide <= value <= low + wide * (1.0 + 1e-6)
        assert float(word.replace("−", "-")) == pytest.approx(value, abs=1e-6 * wide + 1e-9 * abs(value))
        assert word != "−0" and len(word) <= 14


def test_a_line_keeps_what_sticks_out() -> None:
    """One sample of 100 000 that leaps is drawn, and the line is a few thousand points."""
    rng = np.random.default_rng(0)
    x, y = np.linspace(0.0, 970.0, 100_000), rng.normal(size=100_000)
    y[[31_234, 80_000]] = 40.0, -50.0
    kept = panel.telling(x, y)
    assert {31_234, 80_000} <= set(kept.tolist()) and np.all(np.diff(kept) > 0)
    assert len(kept) <= 2 * 970 / panel.FINE
    assert np.array_equal(panel.telling(x[:50], y[:50], 0.001), np.arange(50))


def test_dots_lie_where_they_belong_and_are_darker_together() -> None:
    """As an image reader has it: colour, place and how much of the ground is covered."""
    from PIL import Image

    x, y = np.array([10.0, *[60.0] * 20, -50.0]), np.array([5.0, *[20.0] * 20, 5.0])
    image = re.search(r"base64,([^\"]+)", dots.cloud(x, y, 80.0, 30.0, "#2463a6"))
    assert image is not None
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(image[1]))).convert("RGBA"))
    assert pixels.shape == (60, 160, 4) and set(map(tuple, pixels[..., :3].reshape(-1, 3))) == {(0x24, 0x63, 0xA6)}
    share = pixels[..., 3] / 255.0
    assert share[10, 20] == pytest.approx(dots.SHARE, abs=1.0 / dots.LEVELS)
    assert share[40, 120] > 0.95
    share[8:13, 18:23] = share[38:43, 118:123] = 0.0  # all of it lies about the two places
    assert not np.any(share)


def test_axes_measure_from_the_frame() -> None:
    axes = Panel(50.0, 20.0, 100.0, 40.0, (-1.0, 1.0), (0.0, 4.0))
    assert axes.across(0.0) == 50.0 and axes.down(4.0) == 0.0 and axes.down(0.0) == 40.0
    assert 'text-anchor="end"' in axes.mark(0.9, "starts") and 'text-anchor="start"' in axes.mark(-0.9, "starts")


@pytest.mark.parametrize("size", [1.0, 0.0, 1e-5])
def test_joints_that_hardly_move_have_pictures(size: float) -> None:
    picture = residual_pictures(run(1.3 + size * np.sin(0.01 * np.arange(3000.0))), 0, 0.01, True)
    assert "nan" not in picture and "inf" not in picture
    assert picture.count("<image") == 6  # before and after, over speed, angle and acceleration
