"""A name told by shape: a grey box is the box, one a tenth longer is another, whatever it is painted like."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.assets.procedural import write_box
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.registration import naming_evidence
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.naming import NAMING_SIZE, TUNING, Naming
from twin_diagram.perception.registration.naming_evidence import is_another, naming, told_by_colours
from twin_diagram.perception.registration.outline import moves
from twin_diagram.perception.registration.registration import RegisteredPose, register
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.perception.registration.shape_evidence import odds_of, shape_evidence
from twin_diagram.perception.registration.shape_search import search_by_shape
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.registration.without_colours import without_colours
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario.resources import models_dir

Array = npt.NDArray[np.float64]
PARAMS = scenario.Registration()
ROOM = scenario.Perception(workspace=[[-1.0, -1.0, -0.02], [1.2, 1.0, 1.0]])
STRETCH = np.array([1.12, 0.9, 1.1])


@pytest.fixture(scope="module")
def box() -> Known:
    return Known.of(ModelCloud.of(Asset.load(models_dir() / "objects" / "sugar_box"), 400))


def standing(known: Known, stretch: Array, x: float = 0.5) -> Thing:
    asset = known.model.asset
    pieces = tuple(piece * stretch for piece in asset.convex_pieces)
    other = replace(asset, size=asset.size * stretch, convex_pieces=pieces)
    return Thing(other, 7, yawed(0.3), np.array([x, 0.0, other.size[2] / 2]))


def seen(thing: Thing, grey: bool) -> View:
    rgb, depth, _ = picture(camera(), [thing], np.random.default_rng(1901))
    segments = segment(np.full_like(rgb, 128) if grey else rgb, depth, 1.0, Grid.of(camera(), 2), ROOM)
    return View(segments, Frame.of(segments), PARAMS, 60)


def at(known: Known, thing: Thing, view: View) -> RegisteredPose:
    R, p = thing.R, thing.p
    return register(known.model, view.frame, R, p, PARAMS, points_W=view.segments.points_W[::10])


def test_a_grey_box_is_told_by_its_shape_and_a_stretched_one_is_another_in_any_colours(box: Known) -> None:
    told: dict[tuple[bool, bool], Naming] = {}
    for stretched in (False, True):
        thing = standing(box, STRETCH if stretched else np.ones(3))
        for grey in (False, True):
            view = seen(thing, grey)
            told[stretched, grey] = naming(box, view, at(box, thing, view))
    assert told[False, True].probability > 0.7 and told[False, True].looks == 1
    assert told[False, False].probability > 0.95
    assert told[True, True].probability < 0.1 and told[True, False].probability < 0.5
    assert is_another(told[True, True]) or told[True, True].odds < -1.0


@pytest.mark.parametrize("stretched", [False, True])
def test_holes_of_depth_along_a_things_edges_hide_none_of_its_size(box: Known, stretched: bool) -> None:
    """Where what lies flat meets the table depth has no holes: those edges tell nothing of the others."""
    upright = standing(box, STRETCH if stretched else np.ones(3))
    flat = yawed(1.2) @ np.roll(np.eye(3), -1 - int(np.argmin(upright.asset.size)), axis=0)
    thing = replace(upright, R=flat, p=np.array([0.5, 0.0, upright.asset.size.min() / 2]))
    rgb, depth, _ = picture(camera(), [thing], np.random.default_rng(1901))
    square = np.ones((3, 3))
    edge = cv2.dilate(depth, square) - cv2.erode(depth, square) > 0.02
    segments = segment(np.full_like(rgb, 128), np.where(edge, 0.0, depth), 1.0, Grid.of(camera(), 2), ROOM)
    view = View(segments, Frame.of(segments), PARAMS, 60)
    told = naming(box, view, at(box, thing, view))
    assert told.looks == 1
    assert told.probability < 0.3 if stretched else told.probability > 0.7


@pytest.mark.parametrize("grey", [False, True])
def test_what_shape_denies_where_colours_speak_is_settled_and_asked_again(
    box: Known, monkeypatch: pytest.MonkeyPatch, grey: bool
) -> None:
    """A search was 5 mm off along what depth leaves open, and shape tells of another size there."""
    thing = standing(box, np.ones(3))
    view = seen(thing, grey)
    one = at(box, thing, view)
    aside = replace(one, p=one.p + [0.0, 0.003, 0.004])
    asked: list[RegisteredPose] = []

    def told(known: Known, view: View, found: RegisteredPose) -> Naming:
        asked.append(found)
        return Naming(-4.0, 1) if found is aside else naming(known, view, found)

    def settled(model: ModelCloud, frame: Frame, candidates: list[RegisteredPose], points_W: Array, params: Any) -> Any:
        assert candidates == [aside] and 100 <= len(points_W) < 300
        return SimpleNamespace(registration=one)

    monkeypatch.setattr(naming_evidence, "naming", told)
    monkeypatch.setattr(naming_evidence, "settle", settled)
    found = naming_evidence.with_name(box, view, aside)
    assert found.named is not None and not found.by_shape
    if grey:
        assert asked == [aside] and found.named == Naming(-4.0, 1), "its colours say nothing: shape has the word"
    else:
        assert asked == [aside, one] and found.named.probability > 0.95 and found.p is one.p


def test_colours_that_fit_one_way_round_alone_speak_beside_those_of_which_many_fit(
    box: Known, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cup 2° off of which colours spoke a little was refused, where none of which they did not would have been."""
    thing = standing(box, np.ones(3))
    view = seen(thing, grey=False)
    one = at(box, thing, view)
    little = replace(one, likeness=0.5 * one.shape, quality=0.8 * one.shape)
    monkeypatch.setattr(naming_evidence, "turn_speaks", lambda model, frame, found: 2.5)
    asked = replace(view, params=replace(PARAMS, told_by_shape=True))
    assert 0.0 < told_by_colours(box, view, little) < 1.5
    assert told_by_colours(box, asked, little) == 2.5
    assert told_by_colours(box, asked, replace(little, likeness=one.shape, quality=one.shape)) == 3.0


@pytest.mark.parametrize("around", ["alone", "held", "goes on"])
def test_colours_say_nothing_of_a_patch_in_the_air_that_goes_on_where_the_object_ends(box: Known, around: str) -> None:
    """A forearm's end beside a box's paint was named a second box by its colours."""
    thing = replace(standing(box, np.ones(3)), R=np.eye(3), p=np.array([0.5, 0.0, 0.35]))
    _, across, up = np.diag(thing.asset.size)
    sides = {"alone": (), "held": (up,), "goes on": (up, -up, across, -across, up + across, up - across)}[around]
    beside = [replace(thing, seed=8, p=thing.p + side) for side in sides]
    rgb, depth, _ = picture(camera(), [thing, *beside], np.random.default_rng(1901))
    segments = segment(rgb, depth, 1.0, Grid.of(camera(), 2), ROOM)
    view = View(segments, Frame.of(segments), PARAMS, 60)
    one = at(box, thing, view)
    assert told_by_colours(box, view, one) > 2.0, "of which much fits"
    told = naming(box, view, one)
    assert told.looks == 0
    assert told.probability < 0.5 if around == "goes on" else told.probability > 0.8


def test_in_the_air_colours_say_nothing_of_a_grey_patch(box: Known) -> None:
    """The half of a carton's white side that a plate left of it fitted a forearm, and named it one, at 0.92."""
    thing = replace(standing(box, np.ones(3)), p=np.array([0.5, 0.0, 0.35]))
    rgb, depth, _ = picture(camera(), [thing], np.random.default_rng(1901))
    facing = box.model.normals @ (thing.R.T @ (camera().p_WC - thing.p)) > 0.0
    for tint, named in (([0.6, 0.6, 0.6], False), ([0.8, 0.4, 0.2], True)):
        painted = np.broadcast_to(np.round(255 * np.array(tint)).astype(np.uint8), rgb.shape)
        segments = segment(painted, depth, 1.0, Grid.of(camera(), 2), ROOM)
        view = View(segments, Frame.of(segments), PARAMS, 60)
        colours = np.where(facing[:, None], tint, [0.2, 0.1, 0.9])
        plain = replace(box.model, colours=np.broadcast_to(colours, box.model.colours.shape).copy())
        one = at(replace(box, model=plain), thing, view)
        assert told_by_colours(replace(box, model=plain), view, one) == 3.0, "all of them fit"
        told = naming(replace(box, model=plain), view, one)
        assert told.looks == 0
        assert told.probability > 0.8 if named else told.probability < 0.5


def test_colours_say_nothing_where_the_image_shows_a_plain_thing(box: Known) -> None:
    """A forearm's white end fitted four fifths of a carton's colours, and was named one with 0.9."""
    thing = standing(box, np.ones(3))
    for grey in (False, True):
        view = seen(thing, grey)
        one = at(box, thing, view)
        fitting = replace(one, likeness=0.75 * one.shape, quality=0.9 * one.shape)
        assert told_by_colours(box, view, fitting) == (0.0 if grey else 3.0)


def test_a_grey_box_is_found_by_its_shape_turned_as_may_be_and_a_stretched_one_is_not(box: Known) -> None:
    thing = standing(box, np.ones(3))
    view = seen(thing, grey=True)
    free = np.ones(len(view.segments.labels), dtype=bool)
    found = search_by_shape([box], [0], view, free)[0]
    assert found.by_shape and found.named is not None and found.named.probability > 0.7
    assert np.linalg.norm(found.p - thing.p) < 0.002
    turns = [np.eye(3), *box.bare.model.turns]
    off = [np.arccos(0.5 * np.trace(thing.R.T @ found.R @ turn) - 0.5) for turn in turns]
    assert min(off) < 0.02 and found.odds == pytest.approx(-np.log(3.0)), "one of four half turns"
    other = seen(standing(box, STRETCH), grey=True)
    assert not search_by_shape([box], [0], other, np.ones(len(other.segments.labels), dtype=bool))
    assert not search_by_shape([box], [], view, free), "nobody wants it"
    painted = seen(thing, grey=False)
    assert not search_by_shape([box], [0], painted, free)[0].by_shape, "its colours speak"


def test_shape_leaves_a_boxs_half_turns_alike_a_cans_axis_and_no_turn_of_a_mug(box: Known) -> None:
    turns = box.bare.model.turns
    assert len(turns) == 3 and np.allclose(np.sort(np.trace(turns, axis1=1, axis2=2)), -1.0)
    assert not box.bare.model.coloured and box.bare is box.bare
    mug, can = (ModelCloud.of(Asset.load(models_dir() / "objects" / name), 400) for name in ("mug", "can"))
    assert not len(without_colours(mug).turns)
    bare = without_colours(can)
    assert bare.asset.symmetric_axis == "z" and len(bare.turns) <= 1


def test_sizes_are_told_by_outline_surface_and_table(box: Known) -> None:
    for stretch in (np.ones(3), np.array([1.0, 1.0, 1.06]), np.array([1.0, 1.06, 1.0])):
        thing = standing(box, stretch)
        view = seen(thing, grey=True)
        # Where it stands its own height, as the registered pose has it: the rest is stretch.
        found = at(box, thing, view)
        told = shape_evidence(box.model, view.frame, view.segments, found)
        assert told is not None
        error = told.stretch - (stretch - 1.0)
        assert np.all(np.abs(error) < 3.0 * np.sqrt(np.diag(told.spread)) + 0.01)
        assert told.excess < 1.3


def test_points_move_with_turn_shift_and_stretch() -> None:
    rng = np.random.default_rng(1902)
    r, way, R = rng.normal(size=(5, 3)), rng.normal(size=(5, 3)), exp(np.array([0.3, -0.2, 0.9]))
    J = moves(way, r, R)
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        stretched = (r @ R * (1.0 + step[6:])) @ R.T
        moved = stretched @ exp(step[:3]).T + step[3:6]
        np.testing.assert_allclose(J[:, k], np.einsum("ni,ni->n", way, moved - r) / 1e-6, atol=1e-5)


def test_odds_are_those_of_two_normal_distributions() -> None:
    spread = np.diag([0.02, 0.03, 0.1]) ** 2
    sure, off = odds_of(np.zeros(3), spread), odds_of(np.array([0.12, 0.0, 0.0]), spread)
    assert sure == pytest.approx(0.5 * np.log(np.prod(1.0 + 0.25**2 / np.diag(spread))))
    lost = 0.5 * 0.12**2 * (1.0 / 0.02**2 - 1.0 / (0.02**2 + 0.25**2))
    assert sure - off == pytest.approx(lost)
    assert odds_of(np.full(3, 0.1), 100.0 * np.eye(3)) == pytest.approx(0.0, abs=1e-3), "it tells nothing"


def test_names_are_the_mean_of_what_images_told_and_certain_where_somebody_said_so() -> None:
    assert Naming().settled and Naming().probability > 0.99
    one = Naming(1.0, 1).after(Naming(3.0, 1)).after(Naming(-5.0, 0))
    assert (one.odds, one.looks) == (2.0, 2) and not one.settled
    assert Naming(1.0, TUNING.looks).settled
    assert one.pack().shape == (NAMING_SIZE,) and Naming.unpack(one.pack()) == one and one.asked == 2


def test_names_follow_what_colours_tell_until_shape_has_the_word() -> None:
    """A carton was named by the first image of a forearm's end, and no later one that showed it plain changed that."""
    one = Naming(2.5)
    for _ in range(20):
        one = one.after(Naming(-0.5))
    assert one.odds == pytest.approx(-0.5, abs=0.02) and (one.looks, one.asked) == (0, 20)
    assert one.after(Naming(4.0, 1)) == Naming(4.0, 1, 21), "shape's first word is the mean of one"
    assert Naming().after(Naming(-0.5)).odds == Naming().odds, "somebody said so"


def test_what_hardly_stands_out_of_the_table_has_no_outline_that_speaks_against_its_name(tmp_path: Path) -> None:
    """Of a book 1.4 m off, exact to a millimetre, half was taken for table: it was said to be a tenth as thick."""
    asset = Asset.load(write_box(tmp_path / "book", "book", (0.21, 0.15, 0.024), texture_seed=7))
    known, noise = Known.of(ModelCloud.of(asset, 400)), DepthSigma(0.0, 0.003, 0.0, 0.6, 0.3)
    far = replace(camera(), depth_noise=noise)
    far = replace(far, p_WC=far.p_WC - 0.4 * far.R_WC[:, 2])
    thing = Thing(asset, 7, yawed(0.6), np.array([0.45, 0.0, 0.012]))
    rng = np.random.default_rng(1902)
    rgb, depth, _ = picture(far, [thing], rng)
    blurred = cv2.GaussianBlur(rng.normal(size=depth.shape), (0, 0), 2.5)
    depth = depth + (noise(depth) * blurred / blurred.std()).astype(np.float32) * (depth > 0)
    segments = segment(rgb, depth, 1.0, Grid.of(far, 2), ROOM)
    view = View(segments, Frame.of(segments), PARAMS, 60)
    assert len(segments.points_W) > 200
    told = naming(known, view, register(known.model, view.frame, thing.R, thing.p, PARAMS))
    assert told.looks == 0, "shape says nothing"
    assert not is_another(told), "it was said to be, at odds of -3.7"
