"""Alikes have room beside a library of any size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.synthetic_scene import Thing, camera, picture
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.runs.tracking.object_tracker import ObjectTracker
from twin_diagram.runs.tracking.room import FURTHER, slots_for
from twin_diagram.scenario.resources import models_dir


@pytest.mark.parametrize("objects", [0, 3, 12, 16, 21, 200])
def test_there_is_room_for_alikes_beside_any_library(objects: int) -> None:
    room = slots_for(objects)
    assert room.further(objects) >= FURTHER
    assert objects > FURTHER or room == scenario.Slots()


def test_the_second_of_two_alikes_is_found_though_the_library_is_large() -> None:
    asset, room = Asset.load(models_dir() / "objects" / "sugar_box"), scenario.Perception()
    things = [Thing(asset, k + 7, np.eye(3), np.array([0.5, y, asset.size[2] / 2])) for k, y in enumerate((-0.1, 0.12))]
    many = {f"other_{k}": replace(asset, colours=1.0 - asset.colours) for k in range(scenario.Slots().instances)}
    tracker = ObjectTracker({asset.name: asset} | many, room)
    for thing in things:
        tracker.start(asset.name, thing.R, thing.p, 0.95)
    rgb, depth, _ = picture(camera(), things, np.random.default_rng(3))
    found = tracker.observe(segment(rgb, depth, 1.0, Grid.of(camera(), 2), room))
    places = [one.p for one in found if one.asset == asset.name and one.found]
    assert len(places) == 2 and np.linalg.norm(places[0] - places[1]) == pytest.approx(0.22, abs=0.01)
