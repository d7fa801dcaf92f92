"""What is told by shape alone: each turn that shape leaves alike is a hypothesis, and counts in its probability."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.runs.tracking.object_tracker import ObjectTracker
from twin_diagram.runs.tracking.picture_content import PictureContent
from twin_diagram.scenario.resources import models_dir

ROOM = scenario.Perception(workspace=[[-1.0, -1.0, -0.02], [1.2, 1.0, 1.0]])


def test_a_grey_box_has_four_hypotheses_of_which_one_is_right_and_keeps_them() -> None:
    asset = Asset.load(models_dir() / "objects" / "sugar_box")
    thing = Thing(asset, 7, yawed(0.3), np.array([0.5, 0.0, asset.size[2] / 2]))
    tracker = ObjectTracker({"sugar_box": asset}, ROOM)
    for k in range(3):
        rgb, depth, _ = picture(camera(), [thing], np.random.default_rng(1910 + k))
        found = tracker.observe(segment(np.full_like(rgb, 128), depth, k / 15.0, Grid.of(camera(), 2), ROOM))
        (box,) = [one for one in found if one.asset is not None]
        assert box.by_shape and box.found and box.named > 0.7
        assert box.probability < 0.3 and box.probability == pytest.approx(0.25 * box.named, rel=0.1)
        off = [np.arccos(np.clip(0.5 * np.trace(way.R.T @ thing.R) - 0.5, -1.0, 1.0)) for way in box.hypotheses]
        assert len(off) >= 4 and min(off) < 0.03 and np.linalg.norm(box.p - thing.p) < 0.003
        assert sum(way.probability for way in box.hypotheses) == pytest.approx(1.0)


def test_colours_that_are_seen_later_tell_which_way_round_it_stands() -> None:
    asset = Asset.load(models_dir() / "objects" / "sugar_box")
    thing = Thing(asset, 7, yawed(2.6), np.array([0.5, 0.0, asset.size[2] / 2]))
    tracker = ObjectTracker({"sugar_box": asset}, ROOM)
    by_shape = []
    for k in range(6):
        rgb, depth, _ = picture(camera(), [thing], np.random.default_rng(1920 + k))
        shown = np.full_like(rgb, 128) if k < 2 else rgb
        found = tracker.observe(segment(shown, depth, k / 15.0, Grid.of(camera(), 2), ROOM))
        (box,) = [one for one in found if one.asset is not None]
        by_shape.append(box.by_shape)
    assert by_shape[0] and not by_shape[-1]
    turn = np.arccos(np.clip(0.5 * np.trace(box.R.T @ thing.R) - 0.5, -1.0, 1.0))
    assert turn < 0.03 and box.probability > 0.7 and np.linalg.norm(box.p - thing.p) < 0.003


@pytest.mark.parametrize("yaw", [0.3, 2.6])
def test_pictures_of_shades_tell_which_way_round_it_stands(yaw: float) -> None:
    """An infrared camera's: beside its own colours it stood upside down, at 0.96."""
    asset = Asset.load(models_dir() / "objects" / "sugar_box")
    thing = Thing(asset, 7, yawed(yaw), np.array([0.5, 0.0, asset.size[2] / 2]))
    tracker = ObjectTracker({"sugar_box": asset}, ROOM)
    tracker.before_pictures_of(PictureContent.SHADES)
    for k in range(2):
        rgb, depth, _ = picture(camera(), [thing], np.random.default_rng(1930 + k))
        shades = cv2.cvtColor(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
        found = tracker.observe(segment(shades, depth, k / 15.0, Grid.of(camera(), 2), ROOM))
    (box,) = [one for one in found if one.asset is not None]
    turn = np.arccos(np.clip(0.5 * np.trace(box.R.T @ thing.R) - 0.5, -1.0, 1.0))
    assert not box.by_shape and turn < 0.03 and box.probability > 0.7 and np.linalg.norm(box.p - thing.p) < 0.003


def test_pictures_of_shape_alone_tell_no_way_round() -> None:
    asset = Asset.load(models_dir() / "objects" / "sugar_box")
    thing = Thing(asset, 7, yawed(0.3), np.array([0.5, 0.0, asset.size[2] / 2]))
    tracker = ObjectTracker({"sugar_box": asset}, ROOM)
    tracker.before_pictures_of(PictureContent.SHAPE)
    for k in range(2):
        rgb, depth, _ = picture(camera(), [thing], np.random.default_rng(1940 + k))
        found = tracker.observe(segment(np.full_like(rgb, 128), depth, k / 15.0, Grid.of(camera(), 2), ROOM))
    (box,) = [one for one in found if one.asset is not None]
    off = [np.arccos(np.clip(0.5 * np.trace(way.R.T @ thing.R) - 0.5, -1.0, 1.0)) for way in box.hypotheses]
    assert box.found and box.probability <= 0.5 and min(off) < 0.03 and np.linalg.norm(box.p - thing.p) < 0.003
