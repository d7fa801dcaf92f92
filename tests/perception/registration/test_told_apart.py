"""What an image shows alike at two poses tells nothing of them, however its errors fall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration import turned_alike
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import RegisteredPose, register
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.perception.registration.told_apart import most_told
from twin_diagram.perception.registration.view import View
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array

PARAMS = scenario.Registration()
ROOM = scenario.Perception(workspace=[[-1.0, -1.0, -0.02], [1.2, 1.0, 1.0]])
HALF = [exp(np.pi * way) for way in np.eye(3)]


@pytest.fixture(scope="module")
def labelled() -> ModelCloud:
    """A blue box with a white upper half on its -x side."""
    asset = Asset.load(models_dir() / "objects" / "sugar_box")
    low, high = asset.points_O.min(axis=0), asset.points_O.max(axis=0)
    label = (asset.points_O[:, 0] < low[0] + 0.002) & (asset.points_O[:, 2] > 0.5 * (low[2] + high[2]))
    colours = np.where(label[:, None], 0.95, np.array([0.2, 0.35, 0.6]))
    return ModelCloud.of(replace(asset, colours=colours), 400)


def seen(labelled: ModelCloud, yaw: float) -> tuple[View, RegisteredPose]:
    """Return an image of the box, its label hidden, and its pose."""
    thing = Thing(labelled.asset, 7, yawed(yaw), np.array([0.5, 0.0, labelled.asset.size[2] / 2]))
    _, depth, _ = picture(camera(), [thing], np.random.default_rng(3))
    rgb = np.broadcast_to(np.array([51, 89, 153], dtype=np.uint8), (*depth.shape, 3)).copy()
    segments = segment(rgb, depth, 1.0, Grid.of(camera(), 2), ROOM)
    view = View(segments, Frame.of(segments), PARAMS, 60)
    return view, register(labelled, view.frame, thing.R, thing.p, PARAMS, points_W=segments.points_W[::10])


def turned(labelled: ModelCloud, one: RegisteredPose) -> Poses:
    """Return a pose and its half turns about x, y, z."""
    R = np.stack([one.R, *(one.R @ turn for turn in HALF)])
    return Poses(R, labelled.kept_in_place(one.R, one.p, R))


def test_a_hidden_label_tells_nothing_of_the_turn_that_leaves_it_hidden(labelled: ModelCloud) -> None:
    view, one = seen(labelled, 0.3)
    most = most_told(labelled, view.frame, turned(labelled, one), 150)
    assert most[0] < 1.0 and most[1] < turned_alike.TUNING.tells, "about the label's own axis: it stays behind"
    assert min(most[2:]) > turned_alike.TUNING.most, "it would show in front"


def test_errors_that_speak_for_a_turn_are_not_believed_where_nothing_can(
    labelled: ModelCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    view, one = seen(labelled, 0.3)

    def wrong(model: ModelCloud, frame: Frame, poses: Poses, *_: object) -> Array:
        """Return costs with an error of 5 nat for the first."""
        return np.where(np.arange(len(poses.p)) == 0, 0.0, 5.0)

    monkeypatch.setattr(turned_alike, "colour_costs", wrong)
    rival = replace(one, R=one.R @ HALF[0])
    weighed = turned_alike.weighed(labelled, view, one, 0.0, lambda R, p: rival)
    assert weighed.odds is not None and turned_alike.probability(weighed.odds) < 0.7
