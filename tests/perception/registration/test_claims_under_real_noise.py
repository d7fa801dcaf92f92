"""What registration claims under the noise of real cameras, told rightly and told half of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import register
from twin_diagram.perception.registration.rotation import exp, log
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario.resources import models_dir
from twin_diagram.station.sim.camera_noise import DepthNoiseField
from twin_diagram.station.sim.camera_profiles import faults


@pytest.fixture(scope="module")
def models() -> list[ModelCloud]:
    return [ModelCloud.of(Asset.load(models_dir() / "objects" / name), 600) for name in ("sugar_box", "cracker_box")]


def squared_errors(models: list[ModelCloud], profile: str, sheet: str) -> list[float]:
    """Per degree of freedom over the claim (NEES), one a frame."""
    off, found = faults(scenario.CameraDefects(profile)), []
    view = replace(camera(), depth_noise=DepthSigma.of(scenario.DepthNoise(sheet)))
    grid, params = Grid.of(view, 2), scenario.Registration(colour_weight=0.0)
    for seed in range(10):
        rng, model = np.random.default_rng([seed, 7]), models[seed % 2]
        R = yawed(rng.uniform(-3.0, 3.0))
        p = np.array([rng.uniform(0.4, 0.7), rng.uniform(-0.25, 0.25), model.asset.size[2] / 2])
        rgb, depth, _ = picture(view, [Thing(model.asset, 11, R, p)])
        rms = off.depth_noise_floor + off.depth_noise * (depth - off.depth_noise_start) ** 2
        depth += np.where(depth > 0, rms * DepthNoiseField(depth.shape, off, seed).frame(0), 0).astype(depth.dtype)
        segments = segment(rgb, depth, 0.0, grid, scenario.Perception())
        start = exp(0.03 * rng.normal(size=(1, 3)))[0] @ R, p + 0.004 * rng.normal(size=3)
        pose = register(model, Frame.of(segments), *start, params)
        error = np.concatenate([log((pose.R @ R.T)[None])[0], pose.p - p])
        found.append(float(error @ np.linalg.solve(pose.covariance, error)) / 6.0)
    return found


@pytest.mark.parametrize(("profile", "sheet"), [("d415", "d415"), ("d435", "d435"), ("d435", "d415")])
def test_squared_errors_are_about_as_large_as_claimed(models: list[ModelCloud], profile: str, sheet: str) -> None:
    """The last row's sheet promises two and a half times too much."""
    found = squared_errors(models, profile, sheet)
    assert 0.2 < np.mean(found) < 1.5 and max(found) < 5.0, found
