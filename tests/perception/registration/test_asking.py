"""A name where two things touch: a strip of the one behind that counts as the front one's does not make it larger."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.asking import asked, set_apart
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.naming import TUNING, Naming
from twin_diagram.perception.registration.naming_evidence import naming
from twin_diagram.perception.registration.outline import own_points
from twin_diagram.perception.registration.registration import RegisteredPose, register
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario.resources import models_dir

Array = npt.NDArray[np.float64]
PARAMS = scenario.Registration()
ROOM = scenario.Perception(workspace=[[-1.0, -1.0, -0.02], [1.2, 1.0, 1.0]])
STRIP = 21
"""So wide is what is cut out of the thing behind [px], half of it on each side of the front one's edge."""


@pytest.fixture(scope="module")
def library() -> list[Known]:
    return [Known.of(ModelCloud.of(Asset.load(models_dir() / "objects" / name), 400)) for name in NAMES]


NAMES = ("sugar_box", "cracker_box")


def scene(library: list[Known]) -> tuple[View, list[RegisteredPose]]:
    """Return an image of a grey box before another one, cut some pixels within the latter, and where both are."""
    things = [
        Thing(one.model.asset, 7 + k, yawed(0.3), np.array([*xy, one.model.asset.size[2] / 2]))
        for k, (one, xy) in enumerate(zip(library, [(0.5, 0.0), (0.41, 0.0)], strict=True))
    ]
    rgb, depth, labels = picture(camera(), things, np.random.default_rng(1901))
    segments = segment(np.full_like(rgb, 128), depth, 1.0, Grid.of(camera(), 2), ROOM)
    view = View(segments, Frame.of(segments), PARAMS, 60)
    poses = [
        register(one.model, view.frame, thing.R, thing.p, PARAMS, points_W=segments.points_W[::10])
        for one, thing in zip(library, things, strict=True)
    ]
    stride = segments.stride
    front, behind = (labels[::stride, ::stride] == 7 + k for k in range(2))
    wide = cv2.dilate(front.astype(np.uint8), np.ones((STRIP // stride, STRIP // stride)))
    shown = segments.label_image.ravel()[segments.cells]
    told = np.where(front.ravel()[segments.cells], 0, 1 + shown)
    told[(wide.astype(bool) & behind).ravel()[segments.cells]] = 0
    return replace(view, segments=replace(segments, labels=told.astype(np.int64), count=int(told.max()) + 1)), poses


@pytest.mark.parametrize("sure", [True, False])
def test_what_a_thing_behind_shows_makes_none_larger_where_its_name_is_sure(library: list[Known], sure: bool) -> None:
    view, poses = scene(library)
    slots = [Slot(known=True, named=Naming(0.0, 1)), Slot(known=True, named=Naming(TUNING.enough - (not sure), 9))]
    assert naming(library[0], view, poses[0]).probability < 0.2
    found = dict(enumerate(poses))
    apart = set_apart(library, slots, found, view, but=0)
    told = naming(library[0], apart, poses[0])
    assert told.probability > 0.7 if sure else told.probability < 0.2
    again = asked(library, slots, found, view)
    assert again[1] is poses[1] and again[0].named == slots[0].named.after(told)
    assert (apart is view) == (not sure)


def test_what_is_its_own_stays_so_where_another_is_near(library: list[Known]) -> None:
    view, poses = scene(library)
    slots = [Slot(known=True, named=Naming(0.0, 1)), Slot(known=True)]
    apart = set_apart(library, slots, dict(enumerate(poses)), view, but=0)
    near, own = own_points(library[0].model, view.segments, poses[0])
    still, less = own_points(library[0].model, apart.segments, poses[0])
    assert np.array_equal(near, still) and np.all(less[near]) and less.sum() < own.sum()
