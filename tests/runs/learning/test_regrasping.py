"""What stands on the platform is taken by what the picture alone shows where no chosen grasp can be had."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_diagram.planning.grasps import gripper_of
from twin_diagram.planning.grasps.cost import TUNING as COST
from twin_diagram.runs.learning import handling, regrasping
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.felt_weight import Centre
from twin_diagram.runs.learning.following import Followed
from twin_diagram.runs.learning.looking_about import LyingAbout
from twin_diagram.runs.learning.picking import Taken
from twin_diagram.runs.learning.regrasping import fallen_pose, other_grasps, take_again
from twin_diagram.runs.learning.shown_object import ShownObject
from twin_diagram.scenario import Learning

AT = np.array([0.52, 0.0, 0.06])
NOBODY: Any = SimpleNamespace()


def no_walls(thing: SeenThing) -> list[np.ndarray]:
    return [np.zeros((0, 3))]


def arguments(mover: Any, learning: Learning, shown: ShownObject, X_WS: Any, order: Any, look: Any) -> tuple[Any, ...]:
    """Those of `take_again` where no walls are about."""
    return mover, NOBODY, learning, gripper_of("wsg50"), shown, X_WS, order, look, no_walls


def box_seen() -> SeenThing:
    """The upper side of a box 4 cm wide and 8 cm tall, and its side towards the camera."""
    rng = np.random.default_rng(1)
    top = np.column_stack([rng.uniform(-0.02, 0.02, (900, 2)), np.full(900, 0.08)])
    side = np.column_stack([np.full(900, 0.02), rng.uniform(-0.02, 0.02, 900), rng.uniform(0.0, 0.08, 900)])
    normals = np.repeat([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], 900, axis=0)
    order = rng.permutation(1800)
    points = np.vstack([top, side]) + AT
    return SeenThing(points[order], normals[order], np.zeros((1800, 2), int), np.array([1.15, 0.0, 0.62]))


@pytest.mark.long
def test_the_picture_alone_is_the_last_resort(monkeypatch: pytest.MonkeyPatch) -> None:
    thing, asked = box_seen(), []
    shown = ShownObject(Followed(points=thing.points - AT, normals=thing.normals))

    def reach_of(mover: Any, cell: Any, grasps: Any, order: list[int]) -> Any:
        asked.append(len(order))
        return SimpleNamespace(X_WT=np.eye(4)) if order else None

    def take(mover: Any, cell: Any, reach: Any) -> Taken | None:
        return None if len(asked) < 5 else Taken(reach.X_WT, 0.04, 0)

    for name, stand_in in (("reach_of", reach_of), ("take", take)):
        monkeypatch.setattr(regrasping, name, stand_in)
    lying, mover = LyingAbout(thing, AT[2], NOBODY), SimpleNamespace(stand=lambda *told: None)
    X_WS = np.eye(4)
    X_WS[:3, 3] = AT
    learning = Learning(platform=[[0.42, -0.1, 0.0], [0.62, 0.1, 0.06]])
    told = partial(arguments, mover, learning, shown, X_WS, lambda grasps, X: [])
    found = take_again(*told(lambda: lying))
    assert asked[:3] == [0, 0, 0] and min(asked[3:]) > 0 and len(asked) == 5
    assert found is not None
    np.testing.assert_allclose(found[1], np.linalg.inv(X_WS), atol=2e-3)
    assert (
        len(shown.notes) == 4
        and "try 3 of taking it from the platform: no grasp is reached, it is seen at" in (shown.notes[2])
    )
    assert "the fingers held nothing" in shown.notes[3]


@pytest.mark.parametrize("beside", [False, True])
def test_where_nothing_is_seen_fingers_do_not_shut(monkeypatch: pytest.MonkeyPatch, beside: bool) -> None:
    """A ring lay on the table beside the platform, and the hand took air where it had been."""
    cloud, outward = block((0.04, 0.05, 0.08))
    shown, looks, reached = ShownObject(Followed(points=cloud, normals=outward)), [], []
    other = replace(box_seen(), beside=True)
    flat = replace(other, points=other.points * [8.0, 8.0, 0.1], normals=np.tile([0.0, 0.0, 1.0], (1800, 1)))

    def look() -> LyingAbout | None:
        looks.append(1)
        return LyingAbout(flat, 0.0, NOBODY) if beside else None

    monkeypatch.setattr(regrasping, "reach_of", lambda *told: reached.append(1))
    X_WS = np.eye(4)
    X_WS[:3, 3] = AT + [0.0, 0.0, 0.04]
    learning = Learning(platform=[[0.42, -0.1, 0.0], [0.62, 0.1, 0.06]])
    told = partial(arguments, NOBODY, learning, shown, X_WS, lambda grasps, X: [])
    assert take_again(*told(look)) is None
    assert len(looks) == 2 and not reached, "it is looked again first"
    why = "no known pose fits" if beside else "nothing is seen there or about it"
    assert len(shown.notes) == 2 and all(why in note for note in shown.notes)


def test_what_fell_off_the_platform_is_taken_from_where_it_lies_now(monkeypatch: pytest.MonkeyPatch) -> None:
    cloud, outward = block((0.04, 0.04, 0.08))
    shown = ShownObject(Followed(points=cloud, normals=outward))
    seen, off = box_seen(), np.array([-0.15, -0.11, -0.06])
    lying = LyingAbout(replace(seen, points=seen.points + off, beside=True), 0.0, NOBODY)
    places, stood = list[Any](), list[Any]()

    def order(grasps: Any, X_WS: Any) -> list[int]:
        places.append((X_WS[:3, 3], grasps.poses[:, 4:].mean(axis=0)))
        return [0]

    monkeypatch.setattr(regrasping, "reach_of", lambda *told: SimpleNamespace(X_WT=np.eye(4)))
    monkeypatch.setattr(regrasping, "take", lambda *told: Taken(np.eye(4), 0.04, 0))
    X_WS = np.eye(4)
    X_WS[:3, 3] = AT + [0.0, 0.0, 0.04]
    mover = SimpleNamespace(stand=lambda where, clouds, support: stood.append((clouds[0].min(axis=0)[2], support)))
    told = partial(arguments, mover, Learning(), shown, X_WS, order)
    assert take_again(*told(lambda: lying)) is not None
    now, grasped = places[0]
    np.testing.assert_allclose(now, X_WS[:3, 3] + off, atol=3e-3)
    assert np.linalg.norm((grasped - now)[:2]) < 0.02 and stood[0] == pytest.approx((0.0, 0.0), abs=4e-3)


def test_room_beside_the_platform_is_asked_for_before_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """What fell against it is taken as if its side were 4 mm nearer; as it is where that leaves no grasp."""
    cloud, outward = block((0.04, 0.04, 0.08))
    shown = ShownObject(Followed(points=cloud, normals=outward))
    seen = box_seen()
    thing = replace(seen, points=seen.points + [0.13, 0.0, -0.06], beside=True)
    side = np.column_stack([np.full(50, 0.62), np.linspace(-0.1, 0.1, 50), np.linspace(0.0, 0.06, 50)])
    monkeypatch.setattr(handling, "upright_points", lambda faces, thing: [side])
    tools: Any = SimpleNamespace(faces=None)
    nearest, asked = [float(walls[:, 0].max()) for walls in handling.walls_about(tools, thing)], list[float]()
    assert nearest == pytest.approx([0.624, 0.62])

    def other_grasps(*told: Any) -> Any:
        asked.append(float(told[-1][:, 0].max()))
        return SimpleNamespace(poses=np.zeros((1, 7)))

    found = [None, SimpleNamespace(X_WT=np.eye(4))]
    monkeypatch.setattr(regrasping, "other_grasps", other_grasps)
    monkeypatch.setattr(regrasping, "reach_of", lambda *told: found.pop(0))
    monkeypatch.setattr(regrasping, "take", lambda *told: Taken(np.eye(4), 0.04, 0))
    X_WS = np.eye(4)
    X_WS[:3, 3] = thing.middle
    mover: Any = SimpleNamespace(stand=lambda *told: None)
    told = [mover, NOBODY, Learning(), gripper_of("wsg50"), shown, X_WS, lambda grasps, X: [0]]
    walls = partial(handling.walls_about, tools)
    assert take_again(*told, lambda: LyingAbout(thing, 0.0, NOBODY), walls) is not None
    assert asked == pytest.approx(nearest)


def block(size: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals (N, 3) all over a block about its middle."""
    rng, points, normals = np.random.default_rng(4), [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            face = rng.uniform(-0.5, 0.5, (700, 3)) * size
            face[:, axis] = 0.5 * sign * size[axis]
            points.append(face)
            normals.append(np.tile(sign * np.eye(3)[axis], (700, 1)))
    return np.concatenate(points), np.concatenate(normals)


@pytest.mark.long
def test_what_is_loaded_to_one_side_is_taken_there() -> None:
    """A block of 18 x 4 x 6 cm, whose weight is felt to pull 5 cm beside its middle."""
    cloud, outward = block((0.18, 0.04, 0.06))
    shown = ShownObject(Followed(points=cloud, normals=outward), mass_at_rest=1.4)
    X_WS = np.eye(4)
    X_WS[:3, :3] = Rotation.from_euler("z", 60, degrees=True).as_matrix()
    X_WS[:3, 3] = AT + [0.0, 0.0, 0.03]
    gripper, along = gripper_of("wsg50"), X_WS[:3, 0]
    for felt, where in ((None, 0.0), (Centre(np.array([0.05, 0.0, 0.0]), 1e-6 * np.eye(3)), 0.05)):
        shown.centre = felt
        grasps = other_grasps(shown, X_WS, gripper, AT[2], 0)
        best = (grasps.poses[:3, 4:] - X_WS[:3, 3]) @ along
        assert abs(best.mean() - where) < 0.015
        assert (grasps.terms["torque"] < 0.5 * COST.torque).sum() >= 26, "one search has 21 and 23"


def test_what_tipped_over_is_found_on_its_new_side() -> None:
    """A block of 4 x 6 x 10 cm, on its largest side now, turned by 70° and 3 cm aside."""
    rng = np.random.default_rng(4)
    size = np.array([0.04, 0.06, 0.10])
    cloud, outward = block((0.04, 0.06, 0.10))
    seen = Followed(points=cloud, normals=outward)
    thought, true = np.eye(4), np.eye(4)
    thought[:3, 3] = AT + [0.0, 0.0, 0.05]
    true[:3, :3] = Rotation.from_euler("ZY", [70, 90], degrees=True).as_matrix()
    true[:3, 3] = AT + [0.03, -0.01, 0.02]
    placed, facing = cloud @ true[:3, :3].T + true[:3, 3], outward @ true[:3, :3].T
    shown = np.flatnonzero(np.einsum("ni,ni->n", facing, np.array([1.15, 0.0, 0.62]) - placed) > 0.0)
    shown = rng.permutation(shown)[:1200]
    noisy = placed[shown] + 5e-4 * rng.normal(size=(len(shown), 3))
    X_SW, share = fallen_pose(seen, noisy, facing[shown], thought, 0.06)
    assert share > 0.9
    back = noisy @ X_SW[:3, :3].T + X_SW[:3, 3]
    assert (np.abs(np.abs(back) - 0.5 * size).min(axis=1) < 3e-3).mean() > 0.97
    assert (np.abs(back) < 0.5 * size + 3e-3).all()
