"""What is carried behind something is not told where its speed led for long."""

from __future__ import annotations

import numpy as np

from tests.synthetic_scene import Thing, camera, picture
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.runs.tracking.object_tracker import ObjectTracker
from twin_diagram.scenario.resources import models_dir

ROOM = scenario.Perception(workspace=[[-1.0, -1.0, -0.02], [1.2, 1.0, 1.0]])
PERIOD, SPEED = 1 / 15, 0.6


def test_what_is_carried_behind_something_is_soon_lost() -> None:
    """A box that rests is believed behind a plate; one that is carried there at 0.6 m/s is anywhere."""
    asset, view = Asset.load(models_dir() / "objects" / "sugar_box"), camera()
    grid, told = Grid.of(view, 2), {}
    for speed in (0.0, SPEED):
        tracker = ObjectTracker({asset.name: asset}, ROOM)
        for k in range(8):
            time, place = 1.0 + k * PERIOD, np.array([0.5, -0.1 + speed * k * PERIOD, 0.2])
            thing = Thing(asset, 7, np.eye(3), place)
            if not k:
                tracker.start(asset.name, thing.R, thing.p, time - 1e-3)
            rgb, depth, _ = picture(view, [thing], np.random.default_rng(11 + k))
            if k >= 5:
                depth[:] = 0.2
            found = tracker.observe(segment(rgb, depth, time, grid, ROOM))
            told[speed, k] = next(one for one in found if one.asset is not None)
    assert told[SPEED, 4].found and told[SPEED, 4].probability > 0.9
    assert np.linalg.norm(told[SPEED, 4].p - [0.5, -0.1 + SPEED * 4 * PERIOD, 0.2]) < 0.02
    assert not told[SPEED, 7].found and not told[0.0, 7].found
    assert told[SPEED, 7].probability < 0.3 and told[SPEED, 7].status == "lost"
    assert told[0.0, 7].probability > 0.5
