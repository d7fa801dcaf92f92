"""What nothing explains: things, and what the robot's model leaves over."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.perception.segmentation.segmentation import level
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things.clusters import clusters
from twin_diagram.perception.things.seen_through import looked_at, seen_through

DOWN = np.diag([1.0, -1.0, -1.0])
CAMERA = Pinhole(width=160, height=120, focal=150.0, R_WC=DOWN, p_WC=np.array([0.0, 0.0, 1.0]))
"""Looks straight down from a metre above the table."""


def image(heights: npt.NDArray[np.float64], label_image: npt.NDArray[np.int64], lids: list[Plane]) -> Segments:
    """Return an image of what stands at heights (h, w) [m] above the table, labelled so."""
    depth = (1.0 - heights).astype(np.float32)
    row, column = np.nonzero(label_image >= 0)
    points = CAMERA.p_WC + depth[row, column][:, None] * CAMERA.rays(1)[row, column]
    return Segments(
        time=0.0,
        points_W=points,
        normals_W=np.tile([0.0, 0.0, 1.0], (len(points), 1)),
        colours=np.full((len(points), 3), 0.5),
        labels=label_image[row, column],
        count=int(label_image.max()) + 1,
        label_image=label_image.astype(np.int16),
        stride=1,
        depth=depth,
        rgb=np.zeros((120, 160, 3), dtype=np.uint8),
        camera=CAMERA,
        table=np.zeros(3),
        planes=(level(0.0), *lids),
    )


def scene(foot: float, beside_robot: bool) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Return heights and labels of a thing 4 cm tall at `foot` [m]; the robot beside it, or far off."""
    heights, label = np.zeros((120, 160)), np.full((120, 160), SEGMENTS.background)
    heights[40:70, 60:90] = foot + np.linspace(0.0, 0.04, 30)
    label[40:70, 60:90] = 0
    columns = slice(90, 110) if beside_robot else slice(130, 150)
    heights[40:70, columns] = 0.5
    label[40:70, columns] = SEGMENTS.robot
    return heights, label


@pytest.mark.parametrize(("foot", "beside", "found"), [(0.0, True, 1), (0.3, True, 0), (0.3, False, 1)])
def test_what_borders_on_the_robot_and_hangs_in_the_air_is_the_robots(foot: float, beside: bool, found: int) -> None:
    heights, label = scene(foot, beside)
    segments = image(heights, label, [])
    assert len(clusters(segments, np.ones(len(segments.labels), dtype=bool))) == found


@pytest.mark.parametrize("whose", [0, 1])
def test_the_robots_own_lids_carry_nothing(whose: int) -> None:
    heights, label = scene(0.3, True)
    heights[10:40, 90:110], label[10:40, 90:110] = 0.31, 1  # another part that the robot's model leaves over
    segments = image(heights, label, [Plane(np.array([0.0, 0.0, 1.0]), 0.3, 0.01, whose)])
    assert not clusters(segments, np.ones(len(segments.labels), dtype=bool))


def test_a_thing_on_a_box_beside_the_robot_is_a_thing() -> None:
    heights, label = scene(0.2, True)
    label[30:80, 40:60] = 1
    heights[30:80, 40:60] = np.linspace(0.0, 0.2, 20)  # a box's side and top, from the table up
    heights[30:80, 50:60] = 0.2
    lid = Plane(np.array([0.0, 0.0, 1.0]), 0.2, 0.01, 1)
    segments = image(heights, label, [lid])
    found = clusters(segments, np.ones(len(segments.labels), dtype=bool))
    assert {int(segments.labels[own[0]]) for own in found} == {0, 1}
    # Of a box elsewhere the lid carries nothing here, however high it is.
    label[30:80, 40:60], heights[30:80, 40:60] = SEGMENTS.background, 0.0
    label[30:80, 2:30], heights[30:80, 2:16], heights[30:80, 16:30] = 1, np.linspace(0.0, 0.2, 14), 0.2
    segments = image(heights, label, [lid])
    found = clusters(segments, np.ones(len(segments.labels), dtype=bool))
    assert {int(segments.labels[own[0]]) for own in found} == {1}


@pytest.mark.parametrize(("wide", "found"), [(8, 1), (2, 0)])
def test_a_fifth_of_a_segment_is_a_thing_beside_the_known_one_unless_it_is_its_rim(wide: int, found: int) -> None:
    """6.7 mm a cell: a rest of 5 × 20 cm, or of 1.3 cm by 20."""
    heights, label = np.zeros((120, 160)), np.full((120, 160), SEGMENTS.background)
    heights[40:70, 60 : 100 + wide], label[40:70, 60 : 100 + wide] = 0.05, 0
    segments = image(heights, label, [])
    free = np.nonzero(label >= 0)[1] >= 100
    assert free.mean() < 0.2
    assert len(clusters(segments, free)) == found


def test_the_robot_behind_a_place_shows_that_it_is_empty_and_before_it_hides_it() -> None:
    heights, label = scene(0.0, True)
    segments = image(heights, label, [])
    row, column = np.mgrid[45:65:5, 92:108:4].reshape(2, -1)
    rays = CAMERA.rays(1)[row, column]
    above, below, at = (CAMERA.p_WC + z * rays for z in (0.3, 0.9, 0.5))
    assert seen_through(above, segments).empty == 1.0
    assert seen_through(below, segments).hidden == 1.0
    assert seen_through(at, segments).hidden == 1.0
    # One by one as together.
    there, empty = looked_at(np.concatenate([above, below, at]), segments)
    assert empty[: len(above)].all() and not empty[len(above) :].any() and not there.any()
