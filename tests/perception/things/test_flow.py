"""How a thing's surface tells its velocity: right, honest, and not where it slides along itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.perception.registration.test_whole_image import SUGAR, TALL, standing
from tests.perception.things.test_motion import PERIOD, PLACE, Watched
from tests.synthetic_scene import Thing
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things.flow import Flow, flow_since, no_views, with_view

Array = npt.NDArray[np.float64]


def image(watched: Watched, thing: Thing) -> tuple[Segments, npt.NDArray[np.int64]]:
    segments = watched.segments([thing], [])
    watched._k += 1
    return segments, np.flatnonzero(np.linalg.norm(segments.points_W - thing.p, axis=1) < 0.25)


def flow_of(seed: int, box: object, v: Array, turn: float = 0.0) -> Flow | None:
    """Return what three images tell of a box that goes at v (3) and turns at `turn` [rad/s]."""
    watched, views, flow = Watched(seed), no_views(), None
    for k in range(3):
        segments, own = image(watched, standing(box, PLACE + k * PERIOD * v[:2], 0.3 + seed + k * PERIOD * turn))
        flow = flow_since(views, own, segments, np.zeros(3))
        views = with_view(views, own, segments)
    return flow


@pytest.mark.long
@pytest.mark.parametrize("v", [[0.0, 0.0, 0.0], [-0.4, 0.1, 0.0], [0.2, 0.3, 0.0], [0.0, -0.5, 0.0]])
def test_told_velocities_are_as_far_off_as_they_say(v: list[float]) -> None:
    """Of a D435: squared errors over claims, per axis, of ten boxes."""
    squares = []
    for seed in range(10):
        flow = flow_of(seed, TALL if seed % 2 else SUGAR, np.array(v))
        if flow is None:
            continue
        off = flow.velocity - v
        squares.append(off @ flow.information @ off / 3.0)
        # Along its surest direction a velocity is told to a few centimetres a second.
        assert np.linalg.eigvalsh(flow.information)[-1] > 1.0 / 0.05**2
    assert len(squares) >= 8
    assert 0.2 < np.mean(squares) < 1.8, squares


def test_what_turns_in_place_does_not_go() -> None:
    for seed in range(4):
        flow = flow_of(seed, SUGAR, np.zeros(3), turn=1.0)
        assert flow is not None
        assert flow.velocity @ flow.information @ flow.velocity < 16.3


def test_a_surface_does_not_tell_how_it_slides_along_itself() -> None:
    segments, own = image(Watched(1), standing(TALL, PLACE, 0.3))
    up = own[segments.normals_W[own, 2] > 0.95]
    assert len(up) > 50
    flow = flow_since(with_view(no_views(), up, segments), up, later(segments), np.array([0.1, 0.0, 0.0]))
    assert flow is not None
    along = np.linalg.eigvalsh(flow.information[:2, :2])[-1]
    assert along < 0.02 * flow.information[2, 2]
    assert along < 1.0 / 0.1**2
    assert abs(flow.velocity[2]) < 0.02


def test_without_an_image_before_or_with_an_old_one_alone_nothing_is_told() -> None:
    segments, own = image(Watched(1), standing(TALL, PLACE, 0.3))
    assert flow_since(no_views(), own, segments, np.zeros(3)) is None
    views = with_view(no_views(), own, segments)
    assert flow_since(views, own, segments, np.zeros(3)) is None  # the same image
    assert flow_since(views, own, later(segments, 1.0), np.zeros(3)) is None
    assert flow_since(views, own[:3], later(segments), np.zeros(3)) is None


def later(segments: Segments, after: float = PERIOD) -> Segments:
    return replace(segments, time=segments.time + after)
