"""Coarse colours of what hides a part of a thing reach over its rim: they do not lead away from what is right."""

from __future__ import annotations

import numpy as np
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import RegisteredPose, register
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals import rotations

PARAMS = scenario.Registration()


def half_hidden(seed: int) -> tuple[RegisteredPose, float]:
    """Register a can behind a carton from where it is, in an image of few pixels; return it, and its turn [deg]."""
    rng, view = np.random.default_rng(seed), camera(320, 240, 300.0)
    can, carton = (Asset.load(models_dir() / "objects" / name) for name in ("can", "sugar_box"))
    behind = Thing(can, 5, yawed(rng.uniform(0.0, 6.28)), np.array([0.55, 0.0, 0.5 * can.size[2]]))
    aside = rng.uniform(0.03, 0.06) * rng.choice([-1, 1])
    before = Thing(carton, 7, yawed(rng.uniform(-0.3, 0.3)), np.array([0.63, aside, 0.5 * carton.size[2]]))
    rgb, depth, _ = picture(view, [behind, before], rng)
    segments = segment(rgb, depth, 0.0, Grid.of(view, 1), scenario.Perception(stride=1, smallest=100))
    model = ModelCloud.of(can, PARAMS.model_points)
    one = register(model, Frame.of(segments), behind.R, behind.p, PARAMS)
    return one, float(np.degrees(np.linalg.norm(rotations.log(rotations.from_matrix(behind.R.T @ one.R)))))


@pytest.mark.parametrize("seed", [9, 10, 14, 17])
def test_what_begins_right_stays_right_beside_what_hides_it(seed: int) -> None:
    """By coarse colours they were led away by 12, 16, 46 and 20 degrees, and had 0.31 to 0.75."""
    one, turned = half_hidden(seed)
    assert turned < 5.0 and one.quality > 0.8, (turned, one.quality)
