"""The light's colour is told by several things that are off by the same, and taken out of the image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.light import WHITE, common_tint, in_white, tint_on
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.scenario.resources import models_dir

ROOM = scenario.Perception(workspace=[[-1.0, -1.0, -0.02], [1.2, 1.0, 1.0]])
WARM = np.array([0.9, 0.66, 0.44])


@pytest.fixture(scope="module")
def things() -> list[tuple[ModelCloud, Thing]]:
    made = []
    for k, (name, seed) in enumerate({"sugar_box": 7, "cracker_box": 3, "can": 5}.items()):
        asset = Asset.load(models_dir() / "objects" / name)
        place = np.array([0.5, 0.25 * (k - 1), asset.size[2] / 2])
        made.append((ModelCloud.of(asset, 400), Thing(asset, seed, yawed(0.3), place)))
    return made


def seen(things: list[tuple[ModelCloud, Thing]], light: np.ndarray) -> Segments:
    rgb, depth, _ = picture(camera(), [thing for _, thing in things], np.random.default_rng(1903))
    lit = np.rint(rgb * light).clip(0, 255).astype(np.uint8)
    return segment(lit, depth, 1.0, Grid.of(camera(), 2), ROOM)


def tints(things: list[tuple[ModelCloud, Thing]], segments: Segments) -> list[np.ndarray]:
    frame = Frame.of(segments)
    told = [tint_on(model, frame, thing.R, thing.p) for model, thing in things]
    assert all(one is not None for one in told)
    return [one for one in told if one is not None]


def test_three_things_tell_a_warm_light_which_is_then_taken_out(things: list[tuple[ModelCloud, Thing]]) -> None:
    warm = seen(things, WARM)
    tint = common_tint(tints(things, warm))
    np.testing.assert_allclose(tint, np.log(WARM[[0, 2]] / WARM[1]), atol=0.06)
    white = in_white(warm, tint)
    assert not common_tint(tints(things, white)).any(), "nothing is left of it"
    assert white.rgb.max() <= 255 and white.rgb.dtype == np.uint8 and not white.rgb.flags.writeable
    np.testing.assert_allclose(
        white.colours, white.rgb[:: warm.stride, :: warm.stride][warm.label_image >= 0] / 255, atol=0.003
    )


def test_a_plain_light_changes_nothing(things: list[tuple[ModelCloud, Thing]]) -> None:
    dim = seen(things, np.full(3, 0.5))
    assert not common_tint(tints(things, dim)).any()
    assert in_white(dim, WHITE) is dim


def test_a_thing_that_is_painted_otherwise_is_no_light() -> None:
    warm, green = np.array([0.3, -0.4]), np.array([-0.5, 0.2])
    np.testing.assert_allclose(common_tint([warm, warm + 0.02, warm - 0.02, green]), warm, atol=1e-9)
    assert not common_tint([warm, warm]).any(), "two may be painted alike"
    assert not common_tint([warm, warm, warm, green, -green, 0.5 * green]).any(), "half of them do not agree"
    assert not common_tint([warm, green, -warm]).any()
    assert not common_tint([0.2 * warm] * 5).any(), "hardly any"


def test_what_is_grey_or_hardly_shows_tells_no_light(things: list[tuple[ModelCloud, Thing]]) -> None:
    segments = seen(things, np.ones(3))
    model, thing = things[0]
    grey = replace(model.asset, colours=np.full_like(model.asset.colours, 0.5))
    assert tint_on(ModelCloud.of(grey, 400), Frame.of(segments), thing.R, thing.p) is None
    assert tint_on(model, Frame.of(segments), thing.R, thing.p + [0.0, 0.0, 0.5]) is None
    assert tint_on(model, Frame.of(seen(things, np.full(3, 0.01))), thing.R, thing.p) is None, "it is dark"
    plain = replace(segments, rgb=np.repeat(segments.rgb.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8))
    assert tint_on(model, Frame.of(plain), thing.R, thing.p) is None, "the picture has no colours"
