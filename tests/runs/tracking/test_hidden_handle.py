"""What tells one way round from another and is hidden cannot be claimed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.synthetic_scene import Thing, camera, picture
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.runs.tracking.object_tracker import ObjectTracker
from twin_diagram.scenario.resources import models_dir

ROOM = scenario.Perception(workspace=[[-1.0, -1.0, -0.02], [1.2, 1.0, 1.0]])


def handled(can: Asset) -> Asset:
    """Return a grey can with a handle along -x."""
    y, z = np.meshgrid(np.linspace(-0.006, 0.006, 9), np.linspace(-0.03, 0.03, 40))
    sides = [np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1) for x in np.linspace(-0.065, -0.035, 20)]
    handle = np.concatenate(sides)
    normals = np.where(handle[:, 1:2] > 0.0, 1.0, -1.0) * np.array([[0.0, 1.0, 0.0]])
    points, grey = np.concatenate([can.points_O, handle]), np.full((len(can.points_O) + len(handle), 3), 0.5)
    alone = replace(can, points_O=points, normals_O=np.concatenate([can.normals_O, normals]), colours=grey)
    return replace(alone, name="mug", symmetric_axis=None, symmetries=())


def test_a_handle_that_is_hidden_is_not_claimed_to_be_somewhere() -> None:
    can = Asset.load(models_dir() / "objects" / "can")
    thing = Thing(can, 7, np.eye(3), np.array([0.5, 0.0, can.size[2] / 2]))
    grey = np.full_like(can.colours, 0.5)
    for asset, certain in ((handled(can), False), (replace(can, colours=grey), True)):
        tracker = ObjectTracker({asset.name: asset}, ROOM)
        tracker.start(asset.name, thing.R, thing.p, 0.95)
        for k in range(3):
            rgb, depth, _ = picture(camera(), [thing], np.random.default_rng(1930 + k))
            found = tracker.observe(segment(np.full_like(rgb, 128), depth, 1.0 + k / 15.0, Grid.of(camera(), 2), ROOM))
            (one,) = [each for each in found if each.asset is not None]
            assert one.found and (one.probability > 0.9) == certain
