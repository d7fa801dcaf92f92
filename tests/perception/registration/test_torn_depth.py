"""What a shiny surface tears of depth is taken for none; another thing behind it is told by its colours."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import search
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.past_tears import followed_past_tears, search_past_tears
from twin_diagram.perception.registration.registration import information, register
from twin_diagram.perception.registration.resting import resting
from twin_diagram.perception.registration.torn_depth import past_tears, past_what_is_torn
from twin_diagram.perception.registration.view import View
from twin_diagram.perception.registration.without_colours import without_colours
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.runs.tracking.object_tracker import ObjectTracker
from twin_diagram.scenario.defects import CameraDefects
from twin_diagram.scenario.resources import models_dir
from twin_diagram.station.sim.camera_materials import Reflections
from twin_diagram.station.sim.camera_profiles import faults

ROOM = scenario.Perception(workspace=[[-1.0, -1.0, -0.02], [1.2, 1.0, 1.0]])
SEEDS = (0, 1, 2)


@dataclass(frozen=True)
class Shiny:
    """A can before a camera: its truth, what is seen of it, and where depth is missing or too deep."""

    thing: Thing
    rgb: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]
    exact: npt.NDArray[np.float32]
    own: npt.NDArray[np.bool_]

    def view(self) -> View:
        """Return the image taken apart."""
        segments = segment(self.rgb, self.depth, 1.0, Grid.of(camera(), 2), ROOM)
        return View(segments, Frame.of(segments), scenario.Registration(), 60)


def can() -> Asset:
    return Asset.load(models_dir() / "objects" / "can")


@functools.cache
def cloud() -> ModelCloud:
    return ModelCloud.of(can(), scenario.Registration().model_points)


@functools.cache
def shiny(seed: int, lost: float = 0.3, deep: float = 0.3) -> Shiny:
    """Return a can with such shares of its surface without depth, and 5 to 30 mm too deep, in patches."""
    thing = Thing(can(), 5, yawed(0.4 + seed), np.array([0.55, 0.05, can().size[2] / 2]))
    rgb, exact, owner = picture(camera(), [thing], np.random.default_rng(seed))
    off = faults(CameraDefects("d435", reflective_lost=lost, reflective_deep=deep))
    torn = Reflections(exact.shape, off, seed).on(exact, owner == 0)
    return Shiny(thing, rgb, torn.astype(np.float32), exact, owner == 0)


def test_a_shiny_can_is_found_named_and_followed_where_it_is() -> None:
    for seed in SEEDS:
        one, tracker = shiny(seed), ObjectTracker({"can": can()}, ROOM)
        for k in range(4):
            noise = np.random.default_rng([seed, k]).normal(0.0, 0.0005, one.depth.shape)
            depth = np.where(one.depth > 0, one.depth + noise, 0.0).astype(np.float32)
            found = tracker.observe(segment(one.rgb, depth, 1.0 + k / 15.0, Grid.of(camera(), 2), ROOM))
            cans = [each for each in found if each.asset is not None]
            assert len(cans) == 1 and cans[0].found and cans[0].probability > 0.7
            assert np.linalg.norm(cans[0].p - one.thing.p) < 0.005 and cans[0].R[2, 2] > np.cos(np.radians(7.0))


def test_patches_too_deep_are_taken_for_none_and_little_else() -> None:
    for seed in SEEDS:
        one, view = shiny(seed), shiny(seed).view()
        past = past_tears(cloud(), view, one.thing.R, one.thing.p)
        assert past is not None
        gone = (past.frame.depth == 0) & (one.depth > 0)
        deeper = np.where(one.depth > 0, one.depth - one.exact, 0.0) * one.own
        assert gone[deeper > 0.012].mean() > 0.9
        assert gone[one.own & (one.depth > 0) & (deeper < 0.001)].mean() < 0.05
        assert np.count_nonzero(gone & ~one.own) < 0.02 * np.count_nonzero(one.own)
        # Points and labels go with the pixels, all else of the image stays.
        left = past.segments
        assert len(left.points_W) == len(left.labels) == len(left.cells) < len(view.segments.points_W)
        np.testing.assert_array_equal(left.rgb, view.segments.rgb)


def test_a_search_finds_it_where_depth_alone_draws_it_away() -> None:
    away = 0
    for seed in (0, 8, 14):
        one, view = shiny(seed), shiny(seed).view()
        ways, points = resting(can())[:1], view.segments.points_W
        plain = search(cloud(), view.frame, points, ways, view.params)
        assert plain is not None
        past = search_past_tears(cloud(), view, points, ways, plain)
        away += int(np.linalg.norm(plain.registration.p - one.thing.p) > 0.005)
        assert np.linalg.norm(past.registration.p - one.thing.p) < 0.004
        assert past.score >= plain.score
    assert away == 2  # by 14 and 11 mm


def test_it_is_followed_from_where_it_was() -> None:
    for seed in SEEDS:
        one, view = shiny(seed), shiny(seed).view()
        prior = information(0.03, 0.005)
        points = view.segments.points_W[::10]
        plain = register(cloud(), view.frame, one.thing.R, one.thing.p, view.params, prior=prior, points_W=points)
        at = Poses(one.thing.R[None], one.thing.p[None])
        past = followed_past_tears(cloud(), view, plain, at, points, prior)
        assert np.linalg.norm(past.p - one.thing.p) < 0.004 and past.shape > 0.9


def test_what_lies_behind_and_looks_otherwise_is_another_thing() -> None:
    one = shiny(0)
    R, p = one.thing.R, one.thing.p
    assert past_tears(cloud(), one.view(), R, p) is not None
    # Grey where depth is too deep: another thing behind it.
    grey, behind = one.rgb.copy(), one.own & (one.depth > one.exact + 0.004)
    grey[behind] = 120
    assert past_tears(cloud(), replace(one, rgb=grey).view(), R, p) is None
    # All of it is behind: it stands 12 mm farther off.
    farther = np.where(one.own, one.exact + np.float32(0.012), one.exact)
    assert past_tears(cloud(), replace(one, depth=farther).view(), R, p) is None
    # Nothing is told of what has no colours, nor where no table tells what stands.
    assert past_tears(without_colours(cloud()), one.view(), R, p) is None
    view = one.view()
    assert past_tears(cloud(), replace(view, frame=replace(view.frame, planes=())), R, p) is None


def test_the_table_seen_past_a_smaller_thing_is_not_torn() -> None:
    """A can a third shorter stands there: where the model's lower end would be, one sees the table."""
    one = shiny(0, 0.0, 0.0)
    rays = camera().rays()
    table = (-camera().p_WC[2] / rays[..., 2]).astype(np.float32)
    low = one.own & (camera().p_WC[2] + one.exact * rays[..., 2] < 0.035)
    rgb, depth = one.rgb.copy(), np.where(low, table, one.exact)
    rgb[low] = one.rgb[~one.own][0]
    view = replace(one, rgb=rgb, depth=depth).view()
    assert past_tears(cloud(), view, one.thing.R, one.thing.p) is None


def test_an_image_without_tears_is_left_as_it_is() -> None:
    one = shiny(1, 0.0, 0.0)
    view = one.view()
    assert past_what_is_torn(cloud(), view, one.thing.R, one.thing.p) is view
    plain = search(cloud(), view.frame, view.segments.points_W, resting(can())[:1], view.params)
    assert plain is not None
    assert search_past_tears(cloud(), view, view.segments.points_W, resting(can())[:1], plain) is plain
