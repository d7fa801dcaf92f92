"""A wall behind what stands on a table is no thing; a carton is one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from tests.runs.tracking.test_table_frame import THINGS, Box, depth_of, looking
from twin_diagram import scenario
from twin_diagram.perception.segmentation.segmentation import Grid, label_pixels

GROUND: Box = ((-4.0, -4.0, -0.02), (4.0, 4.0, 0.0))
PERCEPTION = scenario.Perception(workspace=[[-5.0, -5.0, -0.02], [5.0, 5.0, 5.0]], stride=1)


def labelled(boxes: tuple[Box, ...], in_a_room: bool) -> tuple[int, npt.NDArray[np.int16], npt.NDArray[np.float32]]:
    camera = looking(0.9, 0.3)
    depth = depth_of(boxes, camera)
    apart = label_pixels(depth, Grid.of(camera, 1), PERCEPTION, in_a_room=in_a_room)
    return apart.count, apart.label_image, depth


@pytest.mark.parametrize("away", [0.35, 1.2])
def test_a_wall_is_background_and_things_before_it_are_not(away: float) -> None:
    wall: Box = ((-4.0, away, 0.0), (4.0, away + 0.1, 3.0))
    alone, labels, _ = labelled((GROUND, *THINGS), in_a_room=True)
    count, with_wall, _ = labelled((GROUND, *THINGS, wall), in_a_room=True)
    assert count == alone == len(THINGS)
    assert np.mean((with_wall >= 0)[labels >= 0]) > 0.97 and np.mean((with_wall >= 0)[labels < 0]) < 0.002
    assert labelled((GROUND, *THINGS, wall), in_a_room=False)[0] > len(THINGS), "else it counts as one"


def test_a_carton_is_a_thing() -> None:
    carton: Box = ((-0.25, 0.3, 0.0), (0.25, 0.7, 0.4))
    count, labels, depth = labelled((GROUND, carton), in_a_room=True)
    assert count == 1
    without, _, bare = labelled((GROUND,), in_a_room=True)
    assert without == 0 and np.mean((labels >= 0)[np.abs(depth - bare) > 0.05]) > 0.9
