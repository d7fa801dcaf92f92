"""Things before a warm lamp are found in the first frame as they are in white light."""

from __future__ import annotations

import numpy as np
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram.assets import Asset
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.runs.tracking.object_tracker import ObjectTracker
from twin_diagram.runs.tracking.track_frames import PERCEPTION
from twin_diagram.runs.tracking.tracked_object import TrackedObject
from twin_diagram.scenario.resources import models_dir

WARM = np.array([0.95, 0.66, 0.4])
SEEDS = {"sugar_box": 7, "cracker_box": 3, "can": 5}


@pytest.mark.long
def test_a_warm_light_is_known_after_the_first_frame_which_is_looked_at_again() -> None:
    assets = {name: Asset.load(models_dir() / "objects" / name) for name in SEEDS}
    things = [
        Thing(asset, SEEDS[name], yawed(0.3), np.array([0.5, 0.25 * (k - 1), asset.size[2] / 2]))
        for k, (name, asset) in enumerate(assets.items())
    ]
    rgb, depth, _ = picture(camera(), things, np.random.default_rng(1904))
    found: list[dict[str | None, TrackedObject]] = []
    for light in (np.ones(3), WARM):
        lit = np.rint(rgb * light).astype(np.uint8)
        tracker = ObjectTracker(assets, PERCEPTION)
        found.append(
            {one.asset: one for one in tracker.observe(segment(lit, depth, 1.0, Grid.of(camera(), 2), PERCEPTION))}
        )
    white, warm = found
    assert set(white) == set(warm) == set(SEEDS)
    np.testing.assert_allclose(tracker._tint, np.log(WARM[[0, 2]] / WARM[1]), atol=0.08)
    for name, thing in zip(SEEDS, things, strict=True):
        one = warm[name]
        assert np.linalg.norm(one.p - thing.p) < 0.003 and one.found and one.track == white[name].track
        assert abs(one.probability - white[name].probability) < 0.1
