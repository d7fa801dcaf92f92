"""A mug whose handle is out of sight is as likely a plain cup, however well it fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.naming import Naming
from twin_diagram.perception.registration.plain_body import most_of_name
from twin_diagram.perception.registration.round_body import off_round_body
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.runs.tracking.individual import Individual
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array

POINTS = 600


def grey(name: str) -> ModelCloud:
    asset = Asset.load(models_dir() / "objects" / name)
    return ModelCloud.of(replace(asset, colours=np.full_like(asset.colours, 0.5)), 600)


def shown(model: ModelCloud, yaw: float) -> tuple[Frame, Poses]:
    """Return an image of a grey thing and its pose."""
    thing = Thing(model.asset, 11, yawed(yaw), np.array([0.5, 0.0, model.asset.size[2] / 2]))
    rgb, depth, _ = picture(camera(), [thing], np.random.default_rng(1971))
    segments = segment(np.full_like(rgb, 128), depth, 0.0, Grid.of(camera(), 2), scenario.Perception())
    return Frame.of(segments), Poses(thing.R[None], thing.p[None])


def test_the_handle_alone_tells_a_mug_from_a_plain_cup() -> None:
    mug = grey("mug")
    told = [most_of_name(mug, *shown(mug, yaw), POINTS) for yaw in np.arange(8) * np.pi / 4]
    assert min(told) < 0.5, "it is hidden behind the mug"
    assert max(told) > 6.0 and np.isfinite(max(told)), "it is seen at its side"


@pytest.mark.parametrize("name", ["can", "ring", "sugar_box"])
def test_what_is_round_itself_or_not_at_all_has_no_plain_like(name: str) -> None:
    model = grey(name)
    assert model.is_round == (name != "sugar_box")
    assert most_of_name(model, *shown(model, 0.3), POINTS) == np.inf


def test_print_all_round_tells_a_mug_without_its_handle() -> None:
    mug = ModelCloud.of(Asset.load(models_dir() / "objects" / "mug"), 600)
    assert all(most_of_name(mug, *shown(mug, yaw), POINTS) == np.inf for yaw in (0.0, np.pi / 2, np.pi))


def half_pipe(axis: int, knob: float) -> tuple[Array, Array]:
    """Return points and normals of half a pipe about a line beside an axis of O, with a knob on it."""
    angle, height = (x.ravel() for x in np.meshgrid(np.linspace(-1.4, 1.4, 30), np.linspace(0.0, 0.1, 25)))
    out = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    points = 0.04 * out + np.stack([0.01 + 0.0 * height, -0.02 + 0.0 * height, height], axis=1)
    at = (np.abs(angle - 0.5) < 0.15) & (np.abs(height - 0.05) < 0.012)
    points[at] += knob * out[at]
    return np.roll(points, axis + 1, axis=1), np.roll(out, axis + 1, axis=1)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_what_lies_beside_a_round_body_is_as_far_off_as_it_is(axis: int) -> None:
    for knob in (0.0, 0.025):
        points, normals = half_pipe(axis, knob)
        off = off_round_body(points, normals)
        assert off is not None
        assert knob - 0.012 <= float(off.max()) <= knob
        assert np.count_nonzero(off > 0.5 * knob) == (0 if not knob else np.count_nonzero(off > 1e-6))


def test_a_name_is_even_until_a_frame_shows_what_tells_it_and_certain_where_somebody_said_so() -> None:
    mug = grey("mug")
    hidden, seen = (shown(mug, yaw) for yaw in told_yaws(mug))
    one, said = Individual(0, 0, np.zeros(1)), Naming(4.0, 1)
    assert one.named(said, mug, *hidden) == pytest.approx(0.5, abs=0.1)
    assert one.named(Naming(-2.0, 1), mug, *hidden) == Naming(-2.0, 1).probability
    assert one.named(Naming(), mug, *hidden) == Naming().probability, "told by the user"
    assert one.named(said, mug, *seen) == said.probability
    assert one.named(said, mug, *hidden) == said.probability, "what was seen once is known"
    assert one.named(said, mug, seen[0], None) == said.probability


def told_yaws(mug: ModelCloud) -> tuple[float, float]:
    """Return turns of a mug that hide its handle, and that show it best."""
    yaws = np.arange(8) * np.pi / 4
    told = [most_of_name(mug, *shown(mug, yaw), POINTS) for yaw in yaws]
    return float(yaws[int(np.argmin(told))]), float(yaws[int(np.argmax(told))])
