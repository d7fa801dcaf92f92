"""Poses that shape mistakes for one another, things inside of the table or on a forearm: none of them is believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration import turned_alike
from twin_diagram.perception.registration.alternatives import compare
from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.colour_margin import colour_margin, turn_speaks
from twin_diagram.perception.registration.colour_votes import TUNING, colour_costs
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.naming import Naming
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.recognition import TUNING as RECOGNITION
from twin_diagram.perception.registration.recognition import looks_like_itself, recognise
from twin_diagram.perception.registration.registration import RegisteredPose, register
from twin_diagram.perception.registration.residuals import colour_terms
from twin_diagram.perception.registration.rotation import exp, log
from twin_diagram.perception.registration.search_aloft import afloat, centred
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.slots import seen as after_image
from twin_diagram.perception.registration.tracking import (
    carried,
    challenger,
    doubted,
    doubtful,
    due,
    orientations,
    search_for,
    step,
)
from twin_diagram.perception.registration.turned_alike import TUNING as TURNED
from twin_diagram.perception.registration.turned_alike import after_image as odds_after
from twin_diagram.perception.registration.turned_alike import probability, weighed
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.registration.where_expected import floats, register_where_expected, stands_out, unmistaken
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.scenario.resources import models_dir

Array = npt.NDArray[np.float64]
PARAMS = scenario.Registration()
YAW = 0.3
AIR = scenario.Perception(workspace=[[-1.0, -1.0, -0.02], [1.2, 1.0, 1.0]])


def model(name: str) -> ModelCloud:
    return ModelCloud.of(Asset.load(models_dir() / "objects" / name), 400)


@pytest.fixture(scope="module")
def box() -> Known:
    return Known.of(model("sugar_box"))


def seen(things: list[Thing], grey: bool = False) -> View:
    view = camera()
    rgb, depth, _ = picture(view, things)
    segments = segment(np.full_like(rgb, 128) if grey else rgb, depth, 1.0, Grid.of(view, 2), AIR)
    return View(segments, Frame.of(segments), PARAMS, 60)


def standing(known: Known, x: float = 0.5, y: float = 0.0, yaw: float = YAW) -> Thing:
    asset = known.model.asset
    return Thing(asset, 7, yawed(yaw), np.array([x, y, asset.size[2] / 2]))


def off(R: Array, other: Array) -> float:
    return float(np.linalg.norm(log((R @ other.T)[None])))


def at(thing: Thing, view: View, known: Known) -> RegisteredPose:
    return register(known.model, view.frame, thing.R, thing.p, PARAMS, points_W=view.segments.points_W[::10])


def test_colours_are_likelier_where_they_are_right_and_say_nothing_where_there_are_none(box: Known) -> None:
    thing = standing(box)
    back = yawed(YAW + np.pi)
    poses = Poses(np.stack([thing.R, back]), np.stack([thing.p, thing.p]))
    right, wrong = colour_costs(box.model, seen([thing]).frame, poses, 400)
    assert wrong - right > 20.0
    plain = replace(box.model, colours=np.full_like(box.model.colours, 0.5), texture=0.0 * box.model.texture)
    grey = colour_costs(plain, seen([thing], grey=True).frame, poses, 400)
    assert abs(grey[1] - grey[0]) < 0.5


def test_colours_that_fit_one_way_round_alone_say_nothing_of_a_plain_thing(box: Known) -> None:
    """A forearm fitted a carton's pale side, and no other of its sides: that named it one, at 0.9."""
    thing = standing(box)
    facing = box.model.normals @ (thing.R.T @ (camera().p_WC - thing.p)) > 0.0
    stripes = np.sign(np.sin(box.model.points / 0.006))
    colours = np.where(facing[:, None], 0.5 + 0.06 * stripes, [0.9, 0.2, 0.1])
    pale = replace(box.model, colours=np.broadcast_to(colours, box.model.colours.shape).copy())
    for grey in (True, False):
        view = seen([thing], grey)
        one = at(thing, view, box)
        if grey:
            assert colour_margin(pale, view.frame, one) > 10.0
            assert turn_speaks(pale, view.frame, one) == 0.0
        else:
            assert turn_speaks(box.model, view.frame, one) == 3.0, "of its own paint they speak"


@pytest.mark.parametrize(("aside", "speaks"), [(5, True), (0, True), (None, False)])
def test_paint_that_lies_aside_still_tells_which_way_round_a_thing_is(
    box: Known, aside: int | None, speaks: bool
) -> None:
    thing, view = standing(box), camera()
    rgb, depth, _ = picture(view, [thing])
    painted = 255 - rgb if aside is None else np.roll(rgb, aside, axis=1)
    segments = segment(painted, depth, 1.0, Grid.of(view, 2), AIR)
    one_image = View(segments, Frame.of(segments), PARAMS, 60)
    assert (turn_speaks(box.model, one_image.frame, at(thing, one_image, box)) > 0.0) == speaks
    turned = at(replace(thing, R=yawed(YAW + np.pi)), one_image, box)
    assert turn_speaks(box.model, one_image.frame, turned) == 0.0
    free = np.ones(len(segments.labels), dtype=bool)
    asked = replace(PARAMS, told_by_shape=True)
    found = recognise({0: box.model}, {0: box.upright}, segments, one_image.frame, free, asked, 60)
    assert set(found) == ({0} if speaks else set())
    if aside:
        assert found[0].score < RECOGNITION.accept
        assert off(found[0].registration.R, thing.R) < 0.03


def test_a_pose_that_shows_next_to_nothing_is_no_rival(box: Known) -> None:
    thing = standing(box)
    poses = Poses(np.stack([thing.R, thing.R]), np.stack([thing.p, thing.p + [0.0, 0.3, 0.0]]))
    assert colour_costs(box.model, seen([thing]).frame, poses, 200)[1] == TUNING.never


def beside(other: Thing, hidden: Thing | None) -> Segments:
    """Return an image of one thing, without depth where another one would be."""
    view = camera()
    rgb, depth, _ = picture(view, [other])
    if hidden is not None:
        (u,), (v,), _ = view.project(hidden.p[None])
        depth[max(int(v) - 90, 0) : int(v) + 90, max(int(u) - 90, 0) : int(u) + 90] = 0.0
    return segment(rgb, depth, 1.0, Grid.of(view, 2), AIR)


@pytest.mark.parametrize(("hidden", "ago", "found"), [(True, 0.07, False), (True, 0.6, True), (False, 0.07, True)])
def test_what_is_hidden_where_it_was_a_moment_ago_is_not_found_elsewhere(
    box: Known, hidden: bool, ago: float, found: bool
) -> None:
    before, other = standing(box, 0.45, -0.2), standing(box, 0.6, 0.2)
    segments = beside(other, before if hidden else None)
    image = View(segments, Frame.of(segments), PARAMS, 60)
    slot = Slot(True, before.R, before.p, np.zeros(6), 1.0 - ago)
    free = np.ones(len(segments.labels), dtype=bool)
    result = search_for([box], [slot], [0], image, free, {})
    assert (0 in result) == found
    assert not found or np.linalg.norm(result[0].p - other.p) < 0.01


@pytest.mark.parametrize("hidden", [False, True])
def test_what_was_taken_from_where_it_stood_may_be_in_the_air(box: Known, hidden: bool) -> None:
    before, other = standing(box, 0.45, -0.2), standing(Known.of(model("can")), 0.6, 0.2)
    segments = beside(other, before if hidden else None)
    slot = Slot(True, before.R, before.p, np.zeros(6), 0.5)
    (after,), _, _ = step([box], [slot], segments, PARAMS, 60)
    assert carried(after, 1.0) != hidden and after.attempts == 1


@pytest.mark.parametrize("turn", [np.diag([-1.0, -1.0, 1.0]), np.diag([1.0, -1.0, -1.0])])
def test_a_box_that_is_followed_the_wrong_way_round_is_put_right(box: Known, turn: Array) -> None:
    thing = standing(box)
    view = seen([thing])
    found = register_where_expected(box, Slot(True, thing.R @ turn, thing.p, np.zeros(6), 0.93), view)
    assert found is not None and off(found.R, thing.R) < 0.02


@pytest.mark.parametrize("made_up", [False, True])
def test_colours_that_no_picture_showed_neither_veto_a_pose_nor_pull_at_it(box: Known, made_up: bool) -> None:
    thing = standing(box)
    view, right = seen([thing]), Poses(thing.R[None], thing.p[None])
    asset = box.model.asset
    # From above the camera sees the lid, and a side whose colours are right.
    unseen = asset.normals_O[:, 2] > 0.9
    told = []
    for colours in (asset.colours, np.where(unseen[:, None], 1.0 - asset.colours, asset.colours)):
        other = replace(asset, colours=colours, unpainted=unseen if made_up else None)
        model = ModelCloud.of(other, 400)
        looked = look(model, view.frame, right, 400, FINE)
        fit, votes = assess(model, view.frame, right, 400), colour_costs(model, view.frame, right, 400)
        shape = compare(model, view.frame, right, view.segments.points_W[::10], FINE)
        pull = colour_terms(looked, view.frame, FINE, 0.007, 0.3).b[0]
        told.append(np.concatenate([fit.quality, fit.likeness, fit.points, votes, shape, pull]))
        assert fit.shape[0] > 0.95 and (0.03 < np.mean(looked.painted) < 0.97) == made_up
    assert np.array_equal(*told) == made_up
    assert np.isclose(*told, rtol=1e-3).any() == made_up, "of those that are not marked all are another"
    if made_up:
        assert told[0][0] == pytest.approx(assess(box.model, view.frame, right, 400).quality[0], abs=0.03)


def test_a_side_that_no_picture_showed_is_no_likelier_than_one_that_is_seen(box: Known) -> None:
    """Paint that fits badly, as fine print does, costs more than made-up colours are taken to cost: those then, too."""
    thing = standing(box)
    view = seen([thing])
    asset = box.model.asset
    noise = np.random.default_rng(5).normal(0.0, 0.25, asset.colours.shape)
    faces = asset.normals_O @ (thing.R.T @ (view.frame.camera.p_WC - thing.p)) > 0.0
    sides = faces & (np.abs(asset.normals_O[:, 2]) < 0.9)
    other = replace(asset, colours=np.clip(asset.colours + noise, 0.0, 1.0), unpainted=~sides)
    model = ModelCloud.of(other, 400)
    both = Poses(thing.R @ np.stack([np.eye(3), np.diag([-1.0, -1.0, 1.0])]), np.stack([thing.p, thing.p]))
    seen_sides, other_sides = look(model, view.frame, both, 400, FINE).painted.mean(axis=1)
    assert seen_sides > 0.4 and other_sides < 0.1
    votes = colour_costs(model, view.frame, both, 400)
    shape = compare(model, view.frame, both, view.segments.points_W[::10], FINE)
    assert votes[1] == pytest.approx(votes[0]) and shape[1] > shape[0] - 1.0


def test_where_colours_do_not_tell_a_pose_stays(box: Known) -> None:
    thing = standing(box)
    view = seen([thing], grey=True)
    one = at(thing, view, box)
    left = unmistaken(box, view, one)
    assert left.R is one.R and left.p is one.p
    assert left.odds == TURNED.unsaid


@pytest.mark.parametrize("worse", [2.0, -2.0])
def test_a_pose_gives_way_to_no_turn_that_is_less_likely_once_it_is_registered(
    box: Known, monkeypatch: pytest.MonkeyPatch, worse: float
) -> None:
    thing = standing(box)
    view = seen([thing])
    one, count = at(thing, view, box), len(box.model.mistaken)
    assert count > TURNED.rivals, "one is not registered"
    laid = np.concatenate([[0.0], np.full(count, -9.0)])
    monkeypatch.setattr(turned_alike, "colour_costs", lambda *told: laid)
    monkeypatch.setattr(turned_alike, "_most", lambda *told: np.full(count + 1, np.inf))
    monkeypatch.setattr(turned_alike, "_worse", lambda *told: np.full(TURNED.rivals, worse))
    after = weighed(box.model, view, one, -0.5, lambda R, p: replace(one, R=R, p=p))
    assert (off(after.R, thing.R) < 0.05) == (worse > 0.0)
    assert after.odds is not None and (after.odds < -TURNED.wrong) == (worse > 0.0), "it is doubted all the same"


def test_what_is_turned_back_keeps_its_name(box: Known) -> None:
    thing = standing(box)
    view = seen([thing])
    turned = register(box.model, view.frame, thing.R @ np.diag([-1.0, -1.0, 1.0]), thing.p, PARAMS)
    after = unmistaken(box, view, replace(turned, named=Naming(-0.4, 1), by_shape=False))
    assert np.trace(after.R.T @ thing.R) > 2.9, "it is turned back"
    assert after.named == Naming(-0.4, 1) and after.by_shape is False


def test_a_pose_that_colours_tell_is_sure_with_the_second_image_and_stays_so(box: Known) -> None:
    thing = standing(box)
    view = seen([thing])
    one = unmistaken(box, view, at(thing, view, box))
    assert one.odds == TURNED.most_of_one
    assert unmistaken(box, view, one, one.odds).odds == TURNED.most
    assert (
        unmistaken(box, view, replace(at(thing, view, box), quality=0.99 * one.shape), TURNED.most).odds == TURNED.most
    )


def test_what_nothing_speaks_against_is_not_looked_into_again(box: Known, monkeypatch: pytest.MonkeyPatch) -> None:
    thing = standing(box)
    view = seen([thing])
    one = replace(at(thing, view, box), quality=0.8)
    asked: list[float] = []
    most_told = turned_alike.most_told
    monkeypatch.setattr(turned_alike, "most_told", lambda *told: asked.append(0.0) or most_told(*told))
    assert unmistaken(box, view, one, TURNED.most).odds == TURNED.most and not asked
    assert unmistaken(box, view, one, TURNED.most - 0.1).odds == TURNED.most and asked


def test_images_that_tell_count_and_are_taken_back_bit_by_bit() -> None:
    one = odds_after(0.0, 40.0)
    assert one == TURNED.most_of_one and odds_after(one, 40.0) == TURNED.most and odds_after(one, 2.0) == one
    odds = TURNED.most
    for _ in range(2):
        odds = odds_after(odds, -5.0)
    assert odds == pytest.approx(TURNED.most - 2.5)
    assert probability(0.0) == 0.5 and probability(TURNED.most) > 0.99


def test_images_that_hardly_tell_count_by_their_mean_however_many_there_are() -> None:
    rng = np.random.default_rng(0)
    odds = 0.0
    for told in rng.normal(0.7, 1.0, 200):
        odds = odds_after(odds, min(told, 2.9))
    assert odds < 1.5 and probability(odds) == 0.5
    assert probability(0.5 * (TURNED.tells + 1.5)) < probability(TURNED.tells)
    contradicted = 0.0
    for _ in range(4):
        contradicted = odds_after(contradicted, -3.0)
    assert contradicted < -TURNED.wrong and probability(contradicted) < 0.5


def test_what_colours_cannot_tell_is_no_mistake_and_what_they_half_tell_is_even(box: Known) -> None:
    thing = standing(box)
    view = seen([thing])
    plain = Asset(**{**vars(box.model.asset), "colours": np.full_like(box.model.asset.colours, 0.5)})
    none = ModelCloud.of(plain, 400)
    assert len(box.model.turns) and not len(none.turns)
    assert weighed(none, view, at(thing, view, box), 0.0, lambda R, p: None).odds == TURNED.most
    # All that is seen is of one colour on either side: nothing tells them apart.
    half = replace(box.model, colours=np.full_like(box.model.colours, 0.5), texture=0.0 * box.model.texture)
    grey = Thing(plain, 7, thing.R, thing.p)
    shown = seen([grey])
    one = register(half, shown.frame, thing.R, thing.p, PARAMS, points_W=shown.segments.points_W[::10])
    even = weighed(half, shown, one, 0.0, lambda R, p: replace(one, R=R, p=p))
    assert even.odds is not None and probability(even.odds) < 0.65


def test_a_round_thing_is_mistaken_for_itself_turned_anyhow() -> None:
    asset = Asset.load(models_dir() / "objects" / "can")
    around = ModelCloud.of(Asset(**{**vars(asset), "symmetric_axis": None}), 60).turns
    yaws = np.sort([np.arctan2(R[1, 0], R[0, 0]) % (2 * np.pi) for R in around if R[2, 2] > 0.5])
    np.testing.assert_allclose(yaws, 2 * np.pi * np.arange(1, 24) / 24, atol=1e-9)
    assert sum(R[2, 2] < -0.5 for R in around) == 24
    assert not any(np.allclose(R, np.eye(3)) for R in around)


def test_what_is_inside_of_the_table_is_hidden_by_nothing(box: Known) -> None:
    flat = Asset.load(models_dir() / "objects" / "gelatin_box")
    low = Thing(flat, 7, yawed(YAW), np.array([0.5, 0.0, flat.size[2] / 2]))
    view = seen([low])
    top = np.array([0.5, 0.0, flat.size[2] - box.model.asset.size[2] / 2])
    sunk = Poses(yawed(YAW)[None], top[None])
    looked = look(box.model, view.frame, sunk, 400, FINE)
    assert looked.buried[looked.counted].mean() > 0.4
    fit = assess(box.model, view.frame, sunk, 400)
    assert fit.visible_share[0] > 0.9 and fit.shape[0] < 0.6, "it should be seen, and is not"
    thing = standing(box)
    assert not look(box.model, seen([thing]).frame, Poses(thing.R[None], thing.p[None]), 400, FINE).buried.any()


def test_in_the_air_an_object_must_end_where_what_is_seen_ends(box: Known) -> None:
    height = np.array([0.0, 0.0, 0.15])
    lifted = replace(standing(box), p=standing(box).p + height)
    view = seen([lifted])
    assert stands_out(box, view, at(lifted, view, box), 0.75)
    assert floats(box, view, at(lifted, view, box))
    on_table = seen([standing(box)])
    assert not floats(box, on_table, at(standing(box), on_table, box))
    asset = box.model.asset
    size = asset.size * [1.0, 4.0, 1.6]
    corners = np.array(np.meshgrid(*([-0.5, 0.5],) * 3)).T.reshape(-1, 3) * size
    beam = replace(lifted, asset=replace(asset, size=size, convex_pieces=(corners,)))
    view = seen([beam])
    one = replace(at(lifted, view, box), R=lifted.R, p=lifted.p, visible_share=1.0)
    front = one.p + beam.R @ [0.0, 0.0, 0.0]
    assert not stands_out(box, view, replace(one, p=front), 0.0)
    on_table = replace(one, p=standing(box).p)
    assert stands_out(box, view, on_table, 0.0), "what stands may touch its likes"
    assert stands_out(box, view, replace(one, visible_share=0.4), 0.0), "too little is seen"


@pytest.mark.parametrize(
    ("shape", "quality", "visible", "doubt"),
    [(0.95, 0.9, 1.0, False), (0.89, 0.89, 1.0, True), (0.95, 0.66, 1.0, True), (0.95, 0.2, 0.39, False)],
)
def test_a_pose_whose_shape_or_colours_are_not_there_is_doubtful(
    shape: float, quality: float, visible: float, doubt: bool
) -> None:
    one = RegisteredPose(np.eye(3), np.zeros(3), np.eye(6), quality, quality, visible, 300.0, shape)
    assert doubtful(one, 0.75) == doubt
    slots = [Slot(next_search=2.0), Slot(next_search=0.5)]
    assert doubted(slots, {0: one, 1: one}, 1.0) == ([1] if doubt else [])
    assert doubted(slots, {0: one, 1: one}, 3.0) == ([1, 0] if doubt else [])


def test_a_box_that_is_taken_for_a_lying_one_is_found_standing(box: Known) -> None:
    thing = standing(box)
    view = seen([thing])
    lying = exp(np.array([[0.0, 0.5 * np.pi, 0.0]]))[0]
    wrong = replace(at(thing, view, box), R=lying, quality=0.3, likeness=0.2, shape=0.8)
    free = np.ones(len(view.segments.labels), dtype=bool)
    found = challenger(box, Slot(True, lying, thing.p), wrong, view, free)
    assert found is not None and off(found.R, thing.R) < 0.02
    right = at(thing, view, box)
    assert challenger(box, Slot(True, thing.R, thing.p), right, view, free) is None, "nothing is better"
    nowhere = replace(wrong, p=thing.p + 3.0)
    assert challenger(box, Slot(), nowhere, view, free) is None


def test_what_was_lost_while_it_moved_is_looked_for_in_the_air_first(box: Known) -> None:
    moving = Slot(True, np.eye(3), np.zeros(3), np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0]), 1.0)
    assert carried(moving, 5.9) and not carried(moving, 6.1)
    assert not carried(replace(moving, velocity=np.zeros(6)), 2.0)
    assert carried(replace(moving, velocity=np.zeros(6), aloft=True), 2.0), "held still"
    lying = [box.upright, box.fallen]
    in_turn = [[], *lying, [], *lying]
    for attempts in range(6):
        assert orientations(box, replace(moving, attempts=attempts), 2.0) == in_turn[attempts]
        assert orientations(box, replace(moving, attempts=attempts), 1.2) == [], "it was there a moment ago"
        resting = replace(moving, velocity=np.zeros(6), attempts=attempts)
        assert orientations(box, resting, 2.0) == lying[attempts % 2]
    waits = replace(moving, next_search=5.0)
    assert due(waits, 1.2) and not due(waits, 2.0) and not due(replace(waits, velocity=np.zeros(6)), 1.2)


@pytest.mark.parametrize("shown", [0.45, 0.7])
def test_a_half_hidden_box_in_the_air_is_laid_by_what_is_not_hidden_of_it(box: Known, shown: float) -> None:
    thing = standing(box)
    held = replace(thing, R=exp(np.array([[0.3, 0.0, 0.2]]))[0] @ thing.R, p=thing.p + [0.0, 0.0, 0.2])
    whole = seen([held])
    points = whole.segments.points_W
    u = whole.segments.camera.project(points)[0]
    edge = float(np.quantile(u, shown))
    rgb, depth, _ = picture(camera(), [held])
    depth[:, int(edge) :] = 0.4  # a hand
    hidden = Frame.of(segment(rgb, depth, 1.0, Grid.of(camera(), 2), AIR))
    middle = points[u < edge].mean(axis=0)
    as_if_whole = centred(box.model, whole.frame, Poses(held.R[None], middle[None]), middle)
    found = centred(box.model, hidden, as_if_whole, middle)
    aside = np.abs(found.p - held.p)[0, 1], np.abs(as_if_whole.p - held.p)[0, 1]
    assert aside[0] < 0.006 and aside[1] > 2.0 * aside[0]


def test_a_box_in_the_air_is_found_turned_otherwise_than_before(box: Known) -> None:
    thing = standing(box)
    R = exp(np.array([[0.35, -0.2, 0.3]]))[0] @ thing.R
    held = replace(thing, R=R, p=thing.p + [0.05, -0.1, 0.2])
    view = seen([held])
    found = afloat(box.model, view.frame, view.segments.points_W, thing.R, PARAMS)
    assert found is not None and off(found.registration.R, R) < 0.03
    assert np.linalg.norm(found.registration.p - held.p) < 0.003
    far = np.concatenate([view.segments.points_W, view.segments.points_W + 1.0])
    assert afloat(box.model, view.frame, far, thing.R, PARAMS) is None, "too large"


@pytest.mark.parametrize(("likeness", "itself"), [(0.46, True), (0.44, False)])
def test_an_object_must_look_like_itself_as_it_usually_does(likeness: float, itself: bool) -> None:
    one = RegisteredPose(np.eye(3), np.zeros(3), np.eye(6), 0.9, likeness, 1.0, 300.0, 1.0)
    assert looks_like_itself(one, 0.75) == itself
    assert looks_like_itself(one, 0.3), "in this light it never looked better"
    assert looks_like_itself(one, 0.0), "nobody knows how it looks before this camera"


def test_how_much_an_object_looks_like_itself_is_learnt_while_it_is_seen() -> None:
    one = RegisteredPose(np.eye(3), np.zeros(3), np.eye(6), 0.9, 0.6, 1.0, 300.0, 0.8)
    first = after_image(Slot(), one, 1.0)
    assert first.alike == pytest.approx(0.75)
    later = after_image(first, replace(one, likeness=0.4), 1.1)
    assert later.alike == pytest.approx(0.9 * 0.75 + 0.1 * 0.5)
    assert after_image(first, replace(one, likeness=0.1, visible_share=0.3), 1.1).alike == first.alike
    assert after_image(first, replace(one, likeness=0.3), 1.1).alike == first.alike, "another thing, not another light"
    assert Slot.unpack(later.pack()).alike == later.alike
