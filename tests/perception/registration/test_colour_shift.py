"""Colours that lie beside depth: what is eliminated, what is learnt, and that poses do not follow them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.registration.colour_shift import (
    ALIGNED,
    TUNING,
    ColourShift,
    ShiftEvidence,
    learnt,
)
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.residuals import ColourNormal
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.tracking import step
from twin_diagram.perception.registration.view import Known
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.scenario.resources import models_dir

Array = npt.NDArray[np.float64]
PARAMS = scenario.Registration()
VIEW = replace(camera(), depth_noise=DepthSigma.of(scenario.DepthNoise("d435")))
"""Told of such noise, registration weighs colours against shape as it does before a real camera."""
ASIDE = np.array([3.0, -2.0])


def joint(seed: int) -> tuple[Array, Array, ColourNormal]:
    """Normal equations of a pose and a shift (8, 8), (8,), and the same in parts."""
    J = np.random.default_rng(seed).normal(size=(40, 8))
    H, b = J.T @ J, J.T @ np.random.default_rng(seed + 1).normal(size=40)
    return H, b, ColourNormal(H[None, :6, :6], b[None, :6], H[None, :6, 6:], H[None, 6:, 6:], b[None, 6:])


@given(st.integers(0, 1000), st.floats(0.1, 10.0))
def test_what_is_left_to_the_pose_is_that_of_solving_for_both(seed: int, std: float) -> None:
    """Colours err alike, in what they say against the shift that is told as in what is learnt of it."""
    H, b, parts = joint(seed)
    held = H / TUNING.alike
    held[6:, 6:] += np.eye(2) / std**2
    both = np.linalg.solve(held, b / TUNING.alike)
    left = parts.without_shift(ColourShift.told(std))
    np.testing.assert_allclose(np.linalg.solve(left.H[0], left.b[0]), both[:6], atol=1e-9)
    np.testing.assert_allclose(TUNING.alike * np.linalg.inv(left.H[0]), np.linalg.inv(held)[:6, :6], atol=1e-8)
    assert parts.without_shift(ALIGNED).H is parts.H


@given(st.integers(0, 1000), st.floats(0.1, 10.0))
def test_what_is_left_to_the_shift_is_that_of_solving_for_both(seed: int, std: float) -> None:
    """At the pose at which nothing pulls on the pose any more: further terms bring it there."""
    H, b, parts = joint(seed)
    shift = ColourShift.told(std)
    extra = np.diag(np.arange(1.0, 7.0))
    pulls = -parts.without_shift(shift).b[0]
    whole, right = H.copy(), b.copy()
    whole[:6, :6] += extra
    right[:6] += pulls
    one = parts.evidence(extra, shift)
    np.testing.assert_allclose(np.linalg.inv(one.information), np.linalg.inv(whole)[6:, 6:], rtol=1e-6)
    np.testing.assert_allclose(
        np.linalg.solve(one.information, one.gradient), np.linalg.solve(whole, right)[6:], atol=1e-8
    )


def test_evidence_adds_up_and_is_never_believed_beyond_its_floor() -> None:
    told = ColourShift.told(2.0)
    assert learnt(ALIGNED, [ShiftEvidence(np.eye(2), np.ones(2))]) is ALIGNED
    alone = learnt(told, [])
    assert not alone.mean.any() and np.allclose(np.diag(alone.covariance), 4.0 + TUNING.walk**2)
    weak = ShiftEvidence(TUNING.alike * np.diag([0.25, 1.0]), TUNING.alike * np.array([0.25, -1.0]))
    one, two = learnt(told, [weak]), learnt(told, [weak, weak])
    variance = 1.0 / (0.25 + 1.0 / (4.0 + TUNING.walk**2))
    assert one.mean[0] == pytest.approx(0.25 * variance)
    assert one.covariance[0, 0] == pytest.approx(variance + TUNING.unsettled * one.mean[0] ** 2)
    assert two.mean[1] < one.mean[1] < 0.0
    assert two.mean[0] == pytest.approx(0.5 / (0.5 + 1.0 / (4.0 + TUNING.walk**2)))
    strong = ShiftEvidence(1e6 * np.eye(2), 1e7 * np.array([3.0, 4.0]))
    sure = learnt(told, [strong])
    settling = TUNING.unsettled * np.outer(sure.mean, sure.mean)
    np.testing.assert_allclose(sure.covariance - settling, TUNING.floor**2 * np.eye(2), atol=1e-9)
    np.testing.assert_allclose(sure.mean, TUNING.step * np.array([0.6, 0.8]), rtol=1e-6)
    again = ColourShift.unpack(sure.pack())
    np.testing.assert_array_equal(again.covariance, sure.covariance)


@pytest.fixture(scope="module")
def boxes() -> list[tuple[Known, Thing]]:
    """Two boxes on the table, turned so that each shows two sides and its top."""
    made = []
    for name, seed, x, yaw in (("sugar_box", 7, 0.45, 0.5), ("gelatin_box", 11, 0.6, -0.6)):
        model = ModelCloud.of(Asset.load(models_dir() / "objects" / name), PARAMS.model_points)
        place = np.array([x, 0.3 * yaw, model.asset.size[2] / 2])
        made.append((Known.of(model), Thing(model.asset, seed, yawed(yaw), place)))
    return made


def image(boxes: list[tuple[Known, Thing]], k: int) -> Segments:
    """An image whose colours lie aside."""
    rgb, depth, _ = picture(VIEW, [thing for _, thing in boxes], np.random.default_rng(k))
    aside = np.roll(rgb, (int(ASIDE[1]), int(ASIDE[0])), axis=(0, 1))
    return segment(aside, depth, k / 15, Grid.of(VIEW, 2), scenario.Perception())


@pytest.mark.long
def test_the_shift_is_found_and_poses_do_not_follow_colours(boxes: list[tuple[Known, Thing]]) -> None:
    library = [known for known, _ in boxes]
    off: dict[str, float] = {}
    for name, shift in (("taken as told", ALIGNED), ("learnt", ColourShift.told(2.0))):
        slots = [Slot(True, thing.R, thing.p, np.zeros(6), 0.0) for _, thing in boxes]
        for k in range(1, 13):
            segments = image(boxes, k)
            slots, found, shift = step(library, slots, segments, PARAMS, 60, Frame.of(segments, shift))
        assert all(one.quality > 0 for one in found)
        off[name] = max(float(np.linalg.norm(slot.p - thing.p)) for slot, (_, thing) in zip(slots, boxes, strict=True))
        if name == "learnt":
            np.testing.assert_allclose(shift.mean, ASIDE, atol=0.4)
    assert off["learnt"] < 0.5 * off["taken as told"], off
