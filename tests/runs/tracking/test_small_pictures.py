"""Small pictures are looked at pixel by pixel: with every second one a box before a camera of 160 × 120 was nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.synthetic_scene import Thing, camera, picture
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.runs.tracking.object_tracker import ObjectTracker
from twin_diagram.runs.tracking.track_frames import stride_of
from twin_diagram.scenario.resources import models_dir

ROOM = scenario.Perception(workspace=[[-1.0, -1.0, -0.02], [1.2, 1.0, 1.0]])


@pytest.mark.parametrize(("width", "stride"), [(80, 1), (160, 1), (319, 1), (320, 2), (640, 2), (1280, 2)])
def test_small_pictures_are_looked_at_pixel_by_pixel(width: int, stride: int) -> None:
    assert stride_of(width) == stride


def test_a_box_in_a_picture_of_160_by_120_is_found() -> None:
    asset, view = Asset.load(models_dir() / "objects" / "sugar_box"), camera(160, 120, 150.0)
    thing = Thing(asset, 7, np.eye(3), np.array([0.5, 0.0, asset.size[2] / 2]))
    rgb, depth, _ = picture(view, [thing], np.random.default_rng(5))
    told = replace(ROOM, stride=stride_of(160))
    found = ObjectTracker({asset.name: asset}, ROOM).observe(segment(rgb, depth, 1.0, Grid.of(view, told.stride), told))
    assert [one.asset for one in found] == ["sugar_box"]
    assert np.linalg.norm(found[0].p - thing.p) < 0.01
