"""A plate's floor lies as low as the table, within what stands: its colours are compared all the same."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.synthetic_scene import Thing, camera, picture
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.enclosed import LEAST, enclosed
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.scenario.resources import models_dir


def ring(radius: float, wide: float = 4.0) -> np.ndarray:
    v, u = np.mgrid[:60, :80]
    away = np.hypot(v - 30, u - 40)
    label = np.full((60, 80), SEGMENTS.background, np.int16)
    label[np.abs(away - radius) < wide / 2] = 3
    return label


def test_what_a_rim_encloses_is_found_and_nothing_else() -> None:
    label = ring(16.0)
    v, u = np.mgrid[:60, :80]
    inside = np.hypot(v - 30, u - 40) < 13.5
    found = enclosed(label)
    assert found[inside].mean() > 0.95 and not found[np.hypot(v - 30, u - 40) > 14.0].any()
    label[30, 54:60] = SEGMENTS.background  # a gap a cell wide is closed, …
    assert enclosed(label)[inside].mean() > 0.95
    label[22:38, 50:] = SEGMENTS.background  # … an open bay is not
    assert not enclosed(label).any()


def test_small_holes_robots_and_the_pictures_edge_do_not_count() -> None:
    handle = ring(6.0)
    assert ((np.hypot(*(np.mgrid[:60, :80] - np.array([30, 40])[:, None, None])) < 4).sum()) < LEAST
    assert not enclosed(handle).any()
    assert not enclosed(ring(16.0)[30:]).any()  # cut off by the edge
    robot = ring(16.0)
    robot[robot == SEGMENTS.background] = SEGMENTS.robot
    assert not enclosed(robot).any()
    assert not enclosed(np.full((60, 80), SEGMENTS.background, np.int16)).any()


def seen_box() -> Segments:
    asset, room = Asset.load(models_dir() / "objects" / "sugar_box"), scenario.Perception()
    thing = Thing(asset, 7, np.eye(3), np.array([0.5, 0.0, asset.size[2] / 2]))
    rgb, depth, _ = picture(camera(), [thing], np.random.default_rng(3))
    return segment(rgb, depth, 1.0, Grid.of(camera(), 2), room)


def test_a_frame_has_the_colours_of_floors_and_no_others_of_the_table() -> None:
    segments = seen_box()
    plain = Frame.of(segments)
    label = segments.label_image
    depth = cv2.distanceTransform((label >= 0).astype(np.uint8), cv2.DIST_C, 3)
    v, u = np.unravel_index(int(np.argmax(depth)), depth.shape)
    low = np.s_[v - 4 : v + 12, u - 4 : u + 4]
    assert (label[low] >= 0).all()
    lower = label.copy()
    lower[low] = SEGMENTS.background  # as low as the table
    frame = Frame.of(replace(segments, label_image=lower, normals_W=segments.normals_W[lower[label >= 0] >= 0]))
    middle = (2 * u - frame.corner[0], 2 * (v + 4) - frame.corner[1])
    for own, before in zip(frame.colours, plain.colours, strict=True):
        at = own[middle[1], middle[0]]
        assert at.any() and at == pytest.approx(before[middle[1], middle[0]], abs=0.1)
        assert np.array_equal(own[0, 0], before[0, 0]) and not own[0, 0].any(), "the table around stays black"
