"""What a claim covers does not make it doubtful a second time."""

from __future__ import annotations

import numpy as np
import pytest

from tests.synthetic_scene import Thing, camera, picture
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.alternatives import PoseHypothesis, share_of_first
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.runs.tracking.claimed_share import TUNING, claimed_share
from twin_diagram.runs.tracking.individual import PoseShown
from twin_diagram.runs.tracking.object_tracker import ObjectTracker
from twin_diagram.scenario.resources import models_dir

SPREAD = np.diag(np.square([*np.radians([5.5, 2.6, 4.2]), 0.0025, 0.0076, 0.004]))
"""Of a mug 1.3 m off before a D435."""
RADIUS = 0.07


def _told(shares: list[float], shifts: list[float], turns: list[float]) -> list[PoseHypothesis]:
    """Return hypotheses shifted along y [m] and turned about x [rad]."""
    R = exp(np.array([[turn, 0.0, 0.0] for turn in turns]))
    return [
        PoseHypothesis(one, np.array([0.0, shift, 0.0]), SPREAD, share)
        for one, shift, share in zip(R, shifts, shares, strict=True)
    ]


def test_poses_within_the_claim_do_not_make_it_doubtful() -> None:
    told = _told([0.57, 0.28, 0.15], [0.0, 0.009, -0.009], [0.0, 0.05, -0.05])
    assert share_of_first(told, ()) == pytest.approx(0.57)
    assert claimed_share(told, SPREAD, RADIUS, ()) == pytest.approx(TUNING.most)
    assert claimed_share(_told([0.3, 0.2, 0.5], [0.0, 0.009, 0.06], [0.0] * 3), SPREAD, RADIUS, ()) == pytest.approx(
        0.5
    )


def test_what_is_turned_or_elsewhere_is_another_pose() -> None:
    turned = _told([0.3, 0.4, 0.3], [0.0, 0.0, 0.0], [0.0, 0.6, 3.1])
    moved = _told([0.3, 0.7], [0.0, 0.04], [0.0, 0.0])
    wide = np.diag(np.square([0.24, 0.24, 0.24, 0.017, 0.017, 0.017]))
    for told in (turned, moved):
        assert claimed_share(told, wide, RADIUS, ()) == pytest.approx(0.3)
    assert claimed_share(turned, wide, RADIUS, ((0, 0),)) == pytest.approx(1.0)


def test_a_claim_of_any_pose_is_of_none() -> None:
    """A gelatin box on a forearm was shown 40° off, with a deviation of 30° and eight hypotheses 20° about it."""
    told = _told([0.3, 0.4, 0.3], [0.0, 0.007, -0.007], [0.0, 0.3, -0.3])
    spread = np.diag(np.square([*np.radians([14.0, 1.5, 14.0]), 0.008, 0.013, 0.014]))
    assert claimed_share(told, spread, RADIUS, ()) == pytest.approx(TUNING.most)
    for k, wider in ((0, np.radians(30.0)), (4, 0.02)):
        more = spread.copy()
        more[k, k] = wider**2
        assert claimed_share(told, more, RADIUS, ()) == pytest.approx(0.3)
    round_ = spread.copy()
    round_[0, 0] = 9.0
    assert claimed_share(told, round_, RADIUS, ((0, 0),)) == pytest.approx(1.0)


def test_a_pose_that_is_told_from_all_others_is_as_sure_as_ever() -> None:
    told = _told([0.96, 0.04], [0.0, 0.009], [0.0, 0.0])
    assert claimed_share(told, SPREAD, RADIUS, ()) == pytest.approx(0.96)
    assert claimed_share(told[:1], SPREAD, RADIUS, ()) == pytest.approx(0.96)


def test_the_tracker_tells_so_of_what_a_frame_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    asset, room = Asset.load(models_dir() / "objects" / "sugar_box"), scenario.Perception()
    thing = Thing(asset, 7, np.eye(3), np.array([0.5, 0.0, asset.size[2] / 2]))
    told = [
        PoseHypothesis(one.R, thing.p + one.p, SPREAD, one.probability)
        for one in _told([0.57, 0.28, 0.15], [0.0, 0.009, -0.009], [0.0, 0.05, -0.05])
    ]
    shown = PoseShown(thing.R, thing.p, SPREAD, tuple(told))
    monkeypatch.setattr(ObjectTracker, "_settled", lambda *_: shown)
    tracker = ObjectTracker({asset.name: asset}, room)
    tracker.start(asset.name, thing.R, thing.p, 0.95)
    rgb, depth, _ = picture(camera(), [thing], np.random.default_rng(3))
    (one, *_) = tracker.observe(segment(rgb, depth, 1.0, Grid.of(camera(), 2), room))
    assert one.found and 0.7 < one.probability <= TUNING.most
