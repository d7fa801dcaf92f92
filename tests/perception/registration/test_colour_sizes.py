"""What stands on or against something unknown has its edges joined with that: its paint tells its size."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from tests.perception.registration.test_naming import PARAMS, ROOM, STRETCH, at, standing
from tests.synthetic_scene import Thing, camera, picture
from twin_diagram.assets import Asset
from twin_diagram.assets.procedural import write_box
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.registration.colour_shift import ColourShift
from twin_diagram.perception.registration.colour_sizes import colour_sizes, own_edges
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.naming_evidence import naming
from twin_diagram.perception.registration.outline import Outline, outline, own_points
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.shape_evidence import TUNING as SHAPE
from twin_diagram.perception.registration.shape_evidence import shape_evidence
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario.resources import models_dir

Array = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def box() -> Known:
    return Known.of(ModelCloud.of(Asset.load(models_dir() / "objects" / "sugar_box"), 400))


def beside(box: Known, stretch: Array, tmp: Path, parted: bool) -> tuple[Thing, View]:
    """A box, or another in such a stretched print, against which a block stands that nobody knows; in one segment, or
    parted.
    """
    block = Asset.load(write_box(tmp / "block", "block", (0.12, 0.06, 0.1), 40))
    thing = standing(box, stretch)
    aside = thing.R @ np.array([0.01, 0.5 * (thing.asset.size[1] + 0.06), 0.0])
    other = Thing(block, 40, thing.R, np.array([*(thing.p + aside)[:2], 0.05]))
    rgb, depth, owner = picture(camera(), [thing, other], np.random.default_rng(1907))
    found = segment(rgb, depth, 1.0, Grid.of(camera(), 2), ROOM)
    own = np.where(owner[::2, ::2] == 1, 1 if parted else 0, 0)
    told = np.where(found.label_image >= 0, own, found.label_image).astype(found.label_image.dtype)
    labels = told[told >= 0].astype(found.labels.dtype)
    one = replace(found, labels=labels, label_image=told, count=1 + int(parted))
    return thing, View(one, Frame.of(one), PARAMS, 60)


@pytest.mark.parametrize("parted", [False, True])
def test_what_stands_against_an_unknown_thing_is_told_by_its_paint(box: Known, tmp_path: Path, parted: bool) -> None:
    thing, view = beside(box, np.ones(3), tmp_path, parted)
    one = at(box, thing, view)
    alone = shape_evidence(box.model, view.frame, view.segments, one)
    assert alone is not None and (parted or alone.odds < -2.0), "by shape alone both are another, larger thing"
    assert naming(box, view, one).probability > 0.8


@pytest.mark.parametrize("parted", [False, True])
def test_another_in_a_stretched_print_is_another_there_too(box: Known, tmp_path: Path, parted: bool) -> None:
    thing, view = beside(box, STRETCH, tmp_path, parted)
    assert naming(box, view, at(box, thing, view)).probability < 0.3


def test_what_bears_a_thing_is_near_it_and_not_its_edge(box: Known, tmp_path: Path) -> None:
    """On a book, points of its top are as near a bottle's foot as the bottle's own."""
    slab = Asset.load(write_box(tmp_path / "slab", "slab", (0.25, 0.2, 0.03), 40))
    thing = standing(box, np.ones(3))
    thing = replace(thing, p=thing.p + [0.0, 0.0, 0.03])
    below = Thing(slab, 40, np.eye(3), np.array([0.5, 0.0, 0.015]))
    rgb, depth, owner = picture(camera(), [thing, below], np.random.default_rng(1909))
    noisy = replace(camera(), depth_noise=DepthSigma(0.0015, 0.001))
    found = segment(rgb, depth, 1.0, Grid.of(noisy, 2), ROOM)
    there = (found.label_image >= 0) & (owner[::2, ::2] >= 0)
    told = np.where(found.label_image >= 0, np.where(there, owner[::2, ::2], 1), found.label_image)
    labels = told[told >= 0].astype(found.labels.dtype)
    segments = replace(found, labels=labels, label_image=told.astype(found.label_image.dtype), count=2)
    one = replace(at(box, thing, View(segments, Frame.of(segments), PARAMS, 60)), R=thing.R, p=thing.p)
    seen = outline(box.model, Frame.of(segments), segments, one, own_points(box.model, segments, one)[1])
    assert seen is not None and 0.05 < seen.touched.mean() < 0.7
    assert seen.apart[seen.touched].min() > 0.5 and np.abs(seen.apart[~seen.touched]).max() < 2.5


@pytest.mark.parametrize("aside", [0, 2])
def test_a_print_tells_the_height_of_what_it_is_on_wherever_all_colours_lie(box: Known, aside: int) -> None:
    for higher in (0.0, 0.08):
        thing = standing(box, np.array([1.0, 1.0, 1.0 + higher]))
        rgb, depth, _ = picture(camera(), [thing], np.random.default_rng(1908))
        segments = segment(np.roll(rgb, aside, axis=1), depth, 1.0, Grid.of(camera(), 2), ROOM)
        frame = Frame.of(segments, ColourShift.told(2.0))
        looked = look(box.model, frame, Poses(thing.R[None], thing.p[None]), box.model.views.shape[1], FINE)
        one = replace(at(box, thing, View(segments, frame, PARAMS, 60)), R=thing.R, p=thing.p)
        H, b = colour_sizes(looked, frame, one, SHAPE.cut)
        spread = np.linalg.inv(H + np.diag(np.repeat([0.02, 0.003, 0.25], 3) ** -2.0))
        std = float(np.sqrt(spread[8, 8]))
        assert std < 0.05, "of 0.25 without"
        assert abs((spread @ b)[8] - higher) < (2.0 if higher == 0.0 else 3.0) * std


def test_edges_far_outside_of_where_most_are_belong_to_something_else() -> None:
    J, none = np.zeros((40, 10)), np.zeros(40, dtype=bool)
    J[np.arange(40), 6 + np.arange(40) // 20] = 15.0  # cells for all of a size along two axes
    J[:, 9] = 1.0
    H, b = np.diag(np.repeat([400.0, 1.0, 4.0], [6, 3, 1])), np.zeros(10)
    stretched = Outline(J, J @ np.array([0, 0, 0, 0, 0, 0, 0.1, 0.1, 0, 0]), 0.0, 0.0, none)
    assert own_edges(stretched, H, b, 0.65, 4.0).all(), "a tenth larger all over is no other thing beside it"
    apart = np.zeros(40)
    apart[30:] = np.linspace(4.0, 13.0, 10)
    np.testing.assert_array_equal(own_edges(Outline(J, apart, 0.3, 0.0, none), H, b, 0.65, 4.0), np.arange(40) < 30)
    apart[:10] = 13.0
    assert not own_edges(Outline(J, apart, 0.5, 0.0, none), H, b, 0.65, 4.0)[apart > 3.5].any()
