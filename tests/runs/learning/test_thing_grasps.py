"""Grasps of what leans, and of what a picture cuts off at its border."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.runs.learning.test_bin_picture import CAMERA, HEIGHT, picture
from tests.runs.learning.test_choosing import all_reached, choice_of
from tests.runs.learning.test_placing import flat
from twin_diagram.planning.grasps import gripper_of
from twin_diagram.runs.learning import choosing
from twin_diagram.runs.learning.bin_view import SeenThing, things_at
from twin_diagram.runs.learning.picking import Reach
from twin_diagram.runs.learning.thing_grasps import downward, grasps_of_thing, guessed_sides, leaning, why_not

SIZE = np.array([0.175, 0.086, 0.042])
"""A sugar box."""


def leaning_box() -> tuple[SeenThing, np.ndarray]:
    """A sugar box as it lay over a corner of bin 730, as its camera saw it, and its axes (3, 3)."""
    normal, along = np.array([-0.22, -0.56, 0.8]), np.array([-0.16, 0.83, 0.53])
    axes = np.linalg.qr(np.column_stack([along, np.cross(normal, along), normal]))[0]
    axes *= np.sign(np.array([axes[1, 0], axes[0, 1], axes[2, 2]]))
    rng, eye, middle = np.random.default_rng(0), np.array([0.42, -0.36, 0.95]), np.array([0.32, -0.235, 0.11])
    points, normals = [], []
    for axis in range(3):
        for sign in (1.0, -1.0):
            own = rng.uniform(-0.5, 0.5, (3000, 3)) * SIZE
            own[:, axis] = 0.5 * sign * SIZE[axis]
            outward, there = sign * axes[:, axis], own @ axes.T + middle
            slant = float(outward @ (eye - there.mean(axis=0))) / np.linalg.norm(eye - there.mean(axis=0))
            kept = there[: max(int(3000 * slant), 0)]  # a slanted face fills fewer pixels
            points.append(kept)
            normals.append(np.tile(outward, (len(kept), 1)))
    order = rng.permutation(sum(len(some) for some in points))
    cloud = np.concatenate(points)[order] + rng.normal(0.0, 0.0005, (len(order), 3))
    return SeenThing(cloud, np.concatenate(normals)[order], np.zeros((len(order), 2), int), eye), axes


def test_hidden_sides_of_what_leans_go_along_the_normal_of_its_face() -> None:
    thing, axes = leaning_box()
    lean = leaning(thing)
    assert lean is not None and lean.R_LW @ axes[:, 2] == pytest.approx([0.0, 0.0, 1.0], abs=0.03)
    points, normals = guessed_sides(thing, 0.01, lean)
    own, outward = (points - [0.32, -0.235, 0.11]) @ axes, normals @ axes
    assert np.abs(outward[:, 2]).max() < 0.05 and own[:, 2].min() > -0.5 * SIZE[2] - 0.006
    off = np.maximum(np.abs(own[:, 0]) - 0.5 * SIZE[0], np.abs(own[:, 1]) - 0.5 * SIZE[1])
    assert np.quantile(np.abs(off), 0.95) < 0.008 and np.abs(off).max() < 0.02 and points[:, 2].min() > 0.01


def test_what_leans_is_taken_across_its_own_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    """Straight from above fingers closed on sides that were 16 degrees off, one of them unknown, and held nothing."""
    monkeypatch.setattr(choosing, "reach_of", all_reached)
    thing, axes = leaning_box()
    reach = choice_of(thing).one(choosing.LEANING)
    assert reach is not None and not reach.sure and abs(reach.X_WT[:3, 1] @ axes[:, 1]) > np.cos(np.deg2rad(6.0))
    assert reach.X_WT[2, 2] < -0.7
    assert choice_of(flat(0.06, 0.10, 0.04)).one(choosing.LEANING) is None


def test_what_lies_flat_does_not_lean() -> None:
    assert leaning(flat(0.06, 0.10, 0.04)) is None
    ball = np.random.default_rng(0).normal(size=(2000, 3)) * [1.0, 1.0, 0.2]
    ball = 0.03 * np.abs(ball / np.linalg.norm(ball, axis=1)[:, None]) * [1.0, 1.0, 1.0]
    assert leaning(SeenThing(ball, ball / 0.03, np.zeros((2000, 2), int), np.array([0.0, 0.0, 1.0]))) is None


def cut_off(rows: int) -> SeenThing:
    """A box, 16 cm wide and as long, 6 cm high, of whose length the picture shows so many rows."""
    rays = CAMERA.rays()[..., :2] * (HEIGHT - 0.06)
    top = (np.abs(rays[..., 0]) < 0.08) & (np.arange(CAMERA.height)[:, None] >= CAMERA.height - rows)
    depth = np.where(top, HEIGHT - 0.06, HEIGHT).astype(np.float32)
    (thing,) = things_at(picture(depth), np.ones_like(top), 0.0, beside=True)
    return thing


def test_what_the_picture_cuts_off_goes_on_beyond_it_and_is_not_taken_there() -> None:
    """A carton that lay at the border was taken for as narrow as what was seen of it: six tries held nothing."""
    gripper, free = gripper_of("wsg50"), np.zeros((0, 3))
    for rows in (16, 28):  # 5 and 9 cm
        thing = cut_off(rows)
        assert thing.beyond[:, 1].max() < thing.points[:, 1].min() + 1e-3 and np.ptp(thing.beyond[:, 1]) > 0.15
        assert thing.beyond[:, 2].min() < 0.01 and thing.beyond[:, 2].max() == pytest.approx(0.06, abs=0.01)
        found = grasps_of_thing(thing, gripper, 0.003, free)
        assert not len(downward(found)) and "beyond the picture's border" in why_not(thing, gripper, found)
        assert len(downward(grasps_of_thing(replace(thing, beyond=free), gripper, 0.003, free))), "as it was before"


def test_of_what_the_picture_cuts_off_no_side_is_unknown_and_tried() -> None:
    thing = cut_off(28)
    for beyond, tried in ((thing.beyond, False), (np.zeros((0, 3)), True)):
        choice = choice_of(replace(thing, beyond=beyond))
        nowhere = np.zeros((2, 7))
        choice._looked.update(dict.fromkeys(choosing.SURE))
        choice._spares[choosing.ONE_SIDED] = Reach(0, np.eye(4), nowhere, nowhere)
        assert (choice.one(choosing.ONE_SIDED) is not None) == tried


def test_what_the_picture_shows_whole_goes_on_nowhere() -> None:
    rays = CAMERA.rays()[..., :2] * (HEIGHT - 0.06)
    depth = np.where((np.abs(rays) < 0.05).all(axis=-1), HEIGHT - 0.06, HEIGHT).astype(np.float32)
    (thing,) = things_at(picture(depth), np.ones(depth.shape, dtype=bool), 0.0)
    assert not len(thing.beyond)
