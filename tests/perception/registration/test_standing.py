"""What stands is held to the plane that it stands on."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.rotation import exp, log
from twin_diagram.perception.registration.slots import Slot, seen
from twin_diagram.perception.registration.standing import TUNING, footings, standing, stood
from twin_diagram.perception.registration.where_expected import held_by_planes
from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array

SIZE = np.array([0.06, 0.1, 0.16])
TABLE = Plane(np.array([0.0, 0.0, 1.0]), 0.0, 1.0)
EYE = np.array([0.0, -0.8, 0.7])
NOISE = DepthSigma(0.0, 0.0038, 0.0, 0.6, 0.3)
SIGMA = 0.0038
"""Its deviation a metre off [m]."""


def box(size: Array = SIZE, count: int = 4000, rough: float = 0.0) -> Any:
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.5, 0.5, (count, 3))
    side = rng.integers(3, size=count)
    points[np.arange(count), side] = 0.5 * rng.choice([-1.0, 1.0], count)
    return SimpleNamespace(points_O=points * size + rough * rng.standard_normal((count, 3)), symmetric_axis=None)


def cylinder(radius: float = 0.033, height: float = 0.1, count: int = 4000) -> Any:
    rng = np.random.default_rng(1)
    turn, z = rng.uniform(-np.pi, np.pi, count), rng.uniform(-0.5, 0.5, count)
    r = np.full(count, radius)
    lid = rng.random(count) < 0.3
    r[lid], z[lid] = radius * np.sqrt(rng.random(lid.sum())), 0.5 * rng.choice([-1.0, 1.0], lid.sum())
    points = np.stack([r * np.cos(turn), r * np.sin(turn), height * z], axis=1)
    return SimpleNamespace(points_O=points, symmetric_axis="z")


def posed(R: Array, p: Array, covariance: Array) -> RegisteredPose:
    return RegisteredPose(R, p, covariance, 0.95, 0.95, 1.0, 300.0, 0.95)


def image_covariance(p: Array, sight: float = 0.004, across: float = 0.0006) -> Array:
    """Return what waves of depth leave open: the line of sight, and how it leans."""
    along = (p - EYE) / np.linalg.norm(p - EYE)
    C = np.zeros((6, 6))
    C[:3, :3] = np.radians(1.5) ** 2 * np.eye(3)
    C[3:, 3:] = across**2 * np.eye(3) + sight**2 * np.outer(along, along)
    return C


def camera_at(z: float) -> Any:
    """Return a camera for which everything lies at one depth z."""
    return SimpleNamespace(depth_noise=NOISE, project=lambda p: (0.0, 0.0, z), width=8, height=8)


def test_noise_is_that_of_the_depth_along_the_optical_axis() -> None:
    p = np.array([0.1, 0.05, 0.08])
    one = posed(np.eye(3), p + [0.0, 0.002, 0.002], image_covariance(p))
    for z in (0.5, 2.0):
        seen = replace(Segments.empty(camera_at(z), 2), planes=(TABLE,))
        held = stood(footings(box()), False, one, TABLE, 0.0038 * z**2)
        np.testing.assert_array_equal(standing(footings(box()), False, one, seen).covariance, held.covariance)


def test_the_planes_own_error_is_left_in_the_height() -> None:
    """Of noise that hundreds of patches share a twentieth is left: 2.5 mm of 5 cm, where half a millimetre is told."""
    p = np.array([0.1, 0.05, 0.08])
    one = posed(np.eye(3), p, np.diag([1e-8] * 3 + [1e-2] * 3))
    for sigma in (0.0, 0.05):
        height = np.sqrt(stood(footings(box()), False, one, TABLE, sigma).covariance[5, 5])
        assert height == pytest.approx(np.hypot(TUNING.place, 0.05 * sigma), rel=0.02)


@pytest.mark.parametrize("rough", [0.0, 0.0002])
def test_a_box_rests_on_its_six_sides(rough: float) -> None:
    faces = footings(box(rough=rough))
    ups = np.stack([face.up for face in faces])
    assert len(faces) == 6
    assert np.sort(np.abs(ups).max(axis=1)) == pytest.approx(1.0, abs=2e-3)
    for face in faces:
        k = int(np.argmax(np.abs(face.up)))
        assert (face.contacts @ face.up).mean() == pytest.approx(-0.5 * SIZE[k], abs=8e-4)
        assert face.area == pytest.approx(np.prod(np.delete(SIZE, k)), rel=0.15)


def test_what_is_round_has_one_side_of_each_kind() -> None:
    ups = np.stack([face.up for face in footings(cylinder())])
    assert sorted(np.round(ups[:, 2]).tolist()) == [-1.0, 0.0, 1.0]


def test_what_would_tip_over_is_no_face() -> None:
    leaning = box()
    leaning.points_O = leaning.points_O + np.outer(leaning.points_O[:, 2], [1.0, 0.0, 0.0])  # sheared by 45°
    ups = np.stack([face.up for face in footings(leaning)])
    assert np.abs(ups @ [0.0, 0.0, 1.0]).max() < 0.99


def test_waves_along_the_sight_are_taken_out_and_claims_stay_honest() -> None:
    rng, feet = np.random.default_rng(2), footings(box())
    R, p = exp(np.array([0.0, 0.0, 0.7])), np.array([0.1, 0.05, 0.08])
    C = image_covariance(p)
    before, after, squared = [], [], []
    for _ in range(300):
        error = np.linalg.cholesky(C) @ rng.standard_normal(6)
        one = posed(exp(-error[:3]) @ R, p - error[3:], C)
        plane = Plane(TABLE.normal, float(TUNING.place * rng.standard_normal()), 1.0)
        result = stood(feet, False, one, plane, SIGMA)
        left = np.append(log((R @ result.R.T)[None])[0], p - result.p)
        before.append(np.linalg.norm(error[3:]))
        after.append(np.linalg.norm(left[3:]))
        squared.append(left @ np.linalg.solve(result.covariance, left) / 6)
    assert np.median(after) < 0.45 * np.median(before)
    # Both tilts are exact here, which leaves four numbers of six that err.
    assert np.mean(squared) == pytest.approx(4 / 6, abs=0.08)


def test_what_is_in_the_air_or_leans_stays_as_seen() -> None:
    feet, p = footings(box()), np.array([0.1, 0.05, 0.08])
    C = image_covariance(p)
    lifted = posed(np.eye(3), p + [0.0, 0.0, 0.03], C)
    assert stood(feet, False, lifted, TABLE, SIGMA) is lifted
    for angle in (0.1, 0.3):
        leaning = posed(exp(np.array([angle, 0.0, 0.0])), p + [0.0, 0.0, 0.05 * angle], C / 9.0)
        assert stood(feet, False, leaning, TABLE, SIGMA) is leaning


def test_a_can_that_lies_keeps_its_roll() -> None:
    feet = footings(cylinder())
    R = exp(np.array([0.0, 0.0, 0.4])) @ exp(np.array([np.pi / 2, 0.0, 0.0])) @ exp(np.array([0.0, 0.0, 1.1]))
    p = np.array([0.0, 0.0, 0.033])
    C = image_covariance(p)
    C[:3, :3] += np.outer(R[:, 2], R[:, 2])
    one = posed(exp(np.radians([1.0, 1.0, 0.0])) @ R, p + [0.0, -0.002, 0.002], C)
    result = stood(feet, True, one, TABLE, SIGMA)
    assert result is not one
    assert abs(result.p[2] - 0.033) < 0.0008
    assert abs(np.arcsin(result.R[2, 2])) < 0.5 * abs(np.arcsin(one.R[2, 2]))


def test_of_several_planes_the_nearest_holds_it() -> None:
    feet, shelf = footings(box()), Plane(np.array([0.0, 0.0, 1.0]), 0.3, 0.2)
    lid = Plane(np.array([0.0, 0.0, 1.0]), 0.301, 0.01, part=2)
    camera: Any = camera_at(0.3)
    seen = replace(Segments.empty(camera, 2), planes=(TABLE, lid, shelf))
    p = np.array([0.1, 0.05, 0.38])
    one = posed(np.eye(3), p + [0.0, 0.002, -0.002], image_covariance(p))
    assert standing(feet, False, one, seen).p[2] == pytest.approx(0.38, abs=TUNING.place)
    assert standing(feet, False, one, replace(seen, planes=())) is one
    assert standing((), False, one, seen) is one


def test_what_moves_is_not_held() -> None:
    feet = footings(box())
    camera: Any = camera_at(0.9)
    view: Any = SimpleNamespace(segments=replace(Segments.empty(camera, 2), planes=(TABLE,)))
    known: Any = SimpleNamespace(feet=feet, model=SimpleNamespace(asset=box()))
    p = np.array([0.1, 0.05, 0.08])
    one = posed(np.eye(3), p + [0.0, 0.002, 0.002], image_covariance(p))
    moving = held_by_planes([known], [Slot(velocity=np.full(6, 0.1))], view, {0: one})
    still = held_by_planes([known], [Slot()], view, {0: one})
    assert moving[0] is one
    assert still[0].p[2] == pytest.approx(0.08, abs=TUNING.place)


def test_what_a_plane_begins_to_hold_has_not_moved() -> None:
    p = np.array([0.1, 0.05, 0.08])
    one = posed(np.eye(3), p + [0.0, 0.004, -0.004], image_covariance(p))
    held = stood(footings(box()), False, one, TABLE, SIGMA)
    assert np.linalg.norm(held.p - one.p) > 0.003
    for first, second in ((one, held), (held, one), (held, held)):
        slot = Slot.unpack(seen(seen(Slot(), first, 1.0), second, 1.0 + 1 / 15).pack())
        assert not np.any(slot.velocity)
        np.testing.assert_allclose(slot.p, second.p, atol=1e-12)
