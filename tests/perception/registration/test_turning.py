"""Turns that shape does not tell, and colours that lie aside: what colours say of them is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.colour_shift import ALIGNED, ColourShift
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import Found, judged, with_colours_aligned
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import register
from twin_diagram.perception.registration.rotation import log
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.registration.where_expected import (
    TUNING,
    likeliest,
    register_where_expected,
    turned_back,
    turns,
)
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario.resources import models_dir

PARAMS = scenario.Registration()
YAW = 0.5
TEXTURE = 5
"""Of the can's asset."""


@pytest.fixture(scope="module")
def can() -> Known:
    """A can of which nobody said that its turn does not matter: colours tell it, and nothing else does."""
    asset = Asset.load(models_dir() / "objects" / "can")
    return Known.of(ModelCloud.of(Asset(**{**vars(asset), "symmetric_axis": None}), 600))


@pytest.fixture(scope="module")
def seen(can: Known) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], View]:
    view = camera()
    R, p = yawed(YAW), np.array([0.5, 0.0, can.model.asset.size[2] / 2])
    rgb, depth, _ = picture(view, [Thing(can.model.asset, TEXTURE, R, p)])
    segments = segment(rgb, depth, 1.0, Grid.of(view, 2), scenario.Perception())
    return R, p, View(segments, Frame.of(segments, ALIGNED), PARAMS, 60)


def off(R: npt.NDArray[np.float64], other: npt.NDArray[np.float64]) -> float:
    return float(np.linalg.norm(log((R @ other.T)[None])))


@pytest.mark.parametrize("turned", [-0.4, -0.3, 0.3, 0.4])
def test_a_turn_from_rest_that_the_shape_does_not_tell_is_found_by_colours(
    can: Known, seen: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], View], turned: float
) -> None:
    R, p, view = seen
    found = register_where_expected(can, Slot(True, yawed(YAW - turned), p, np.zeros(6), 0.93), view)
    assert found is not None and off(found.R, R) < 0.03


@pytest.mark.parametrize("spin", [-4.0, 4.0])
def test_a_spin_that_has_ended_does_not_go_on(
    can: Known, seen: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], View], spin: float
) -> None:
    R, p, view = seen
    velocity = np.array([0.0, 0.0, spin, 0.0, 0.0, 0.0])
    found = register_where_expected(can, Slot(True, R, p, velocity, 0.93), view)
    assert found is not None and off(found.R, R) < 0.03


@pytest.mark.parametrize("jump", [-0.6, 0.6])
def test_a_turn_of_which_neither_shape_nor_colours_tell_is_taken_back_if_it_is_large(
    can: Known, seen: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], View], jump: float
) -> None:
    R, p, view = seen
    grey = can.bare
    for turned, before, left in ((jump, 0.0, 0.0), (0.5 * jump, 0.0, 0.5 * jump), (jump, jump / 0.07, jump)):
        slot = Slot(True, R, p, np.array([0.0, 0.0, before, 0.0, 0.0, 0.0]), 0.93)
        one = register(grey.model, view.frame, yawed(YAW + turned), p, PARAMS)
        back = turned_back(grey, slot, view, one)
        assert off(back.R, yawed(YAW + left)) < 0.1, "it is expected where it was, or where its spin leads to"


@pytest.mark.parametrize("jump", [-0.6, 0.6])
def test_a_large_turn_that_colours_tell_is_kept_and_one_that_they_deny_is_taken_back(
    can: Known, seen: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], View], jump: float
) -> None:
    R, p, view = seen
    right = register(can.model, view.frame, R, p, PARAMS)
    turned = yawed(YAW + jump)
    assert turned_back(can, Slot(True, turned, p, np.zeros(6), 0.93), view, right) is right
    wrong = replace(right, R=turned)
    assert off(turned_back(can, Slot(True, R, p, np.zeros(6), 0.93), view, wrong).R, R) < 0.05
    assert abs(jump) > TUNING.jumps * TUNING.moves[0]


def test_turns_are_about_the_axis_that_the_shape_tells_least_of(
    can: Known, seen: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], View]
) -> None:
    R, p, view = seen
    one = register(can.model, view.frame, R, p, PARAMS)
    made = turns(can, view, one)
    assert len(made) == 4
    for turned, _ in made:
        way = log((turned @ one.R.T)[None])[0]
        assert abs(way[2]) > 0.95 * np.linalg.norm(way) and 0.15 < np.linalg.norm(way) < 0.45
    assert likeliest(can, view, []) is None and likeliest(can, view, [one]) is one


def test_colours_four_pixels_aside_are_aligned_before_an_object_is_judged(
    can: Known, seen: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], View]
) -> None:
    R, p, view = seen
    segments = view.segments
    rgb = np.roll(segments.rgb, (1, 4), axis=(0, 1))
    frame = Frame.of(segment(rgb, segments.depth, 1.0, Grid.of(segments.camera, 2), scenario.Perception()))
    told = Frame(**{**vars(frame), "shift": ColourShift.told(2.0)})
    own = segments.points_W[::10]
    before = register(can.model, told, R, p, PARAMS, points_W=own)
    start = Found(before, before.quality * judged(can.model, own, before), before.likeness)
    after = with_colours_aligned(can.model, told, start, own, PARAMS)
    assert after.score > start.score + 0.1 and off(after.registration.R, R) < 0.03
    certain = register(can.model, frame, R, p, PARAMS, points_W=own)
    same = Found(certain, 0.5, 0.5)
    assert with_colours_aligned(can.model, frame, same, own, PARAMS) is same, "where nothing is to be learnt"
