"""Distances by Drake, against known ones and against differences; what is absent, held, new or endless."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.planning.braking.drake_distances import DrakeDistances, Shapes
from twin_diagram.planning.braking.stop_check import Nearness
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.pose_vectors import as_matrix

Q = np.array([0.3, 0.4, 0.1, -1.9, 0.2, 2.3, 0.9])
V = np.array([0.5, -0.4, 0.3, 0.6, -0.5, 0.4, 0.8])
NAMES = ("can", "sugar_box")
SLOTS = len(NAMES) + 1 + 2
CUBE = 0.05 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


@pytest.fixture(scope="module")
def near() -> DrakeDistances:
    library = {name: Asset.load(models_dir() / "objects" / name) for name in NAMES}
    arm = scenario.ArmModel(model="arms/panda_hand.urdf", tool_frame="panda_tcp")
    return DrakeDistances(arm, [scenario.Fixture()], library, 1, 2)


def at(p: tuple[float, float, float]) -> np.ndarray:
    X = np.eye(4)
    X[:3, 3] = p
    return X


def look(
    near: DrakeDistances, places: dict[int, tuple[float, float, float]], within: float = 0.5, **told: object
) -> Nearness:
    present, X_WO = np.zeros(SLOTS, dtype=bool), np.tile(np.eye(4), (SLOTS, 1, 1))
    for slot, p in places.items():
        present[slot], X_WO[slot] = True, at(p)
    q = np.asarray(told.pop("q", Q))
    told = {"assets": [0], "things": [(), ()]} | told
    near.surround(Shapes(present, **told))  # type: ignore[arg-type]
    return near.near(q, V, None, present, X_WO, within)


def least(found: Nearness, body: int) -> float:
    return float(found.distance[found.body == body].min())


def test_a_can_below_the_hand_is_as_far_as_it_is(near: DrakeDistances) -> None:
    """The hand points down over a can: the gap is that between the fingers' ends and the can's top."""
    down = np.array([0.0, 0.2, 0.0, -2.1, 0.0, 2.3, 0.785])
    tool = near.tool(down)
    place = (float(tool[0, 3]), float(tool[1, 3]), 0.051)
    can = Asset.load(models_dir() / "objects" / "can")
    present, X_WO = np.zeros(SLOTS, dtype=bool), np.tile(np.eye(4), (SLOTS, 1, 1))
    present[0], X_WO[0] = True, at(place)
    near.surround(Shapes(present, [0], [(), ()]))
    found = near.near(down, np.zeros(7), None, present, X_WO, 0.5)
    fingers = [k for k, name in near.parts.items() if "finger" in name]
    gap, height = (min(found.distance[(found.body == k) & np.isin(found.part, fingers)]) for k in (1, 0))
    assert gap == pytest.approx(tool[2, 3] - place[2] - can.size[2] / 2, abs=0.03)
    assert height - gap == pytest.approx(can.size[2], abs=0.003), "the table is below the can"


def test_approach_is_the_derivative_of_distance(near: DrakeDistances) -> None:
    places = {0: (0.55, 0.2, 0.1), 1: (0.4, -0.1, 0.3), 2: (0.5, 0.3, 0.5)}
    h = 1e-5
    one, two = (look(near, places, q=Q + s * h * V) for s in (-1.0, 1.0))
    middle = look(near, places)
    assert len(one.distance) == len(two.distance) == len(middle.distance) > 20
    slope = -(two.distance - one.distance) / (2 * h)
    same = (one.part == two.part) & (one.body == two.body)
    off = np.abs(slope - middle.approach)[same]
    assert np.quantile(off, 0.9) < 2e-3, "edges apart, where the nearest points jump"
    assert np.median(off) < 1e-4
    assert np.all(np.abs(middle.approach) <= middle.reach + 1e-9)


def test_no_point_of_the_arm_is_faster_than_said(near: DrakeDistances) -> None:
    h = 1e-6
    plant_speed = np.linalg.norm(near.tool(Q + h * V)[:3, 3] - near.tool(Q - h * V)[:3, 3]) / (2 * h)
    bound = near.speed(Q, V)
    assert plant_speed < bound < 2.0 * plant_speed + 0.5
    assert near.speed(Q, 2 * V) == pytest.approx(2 * bound)
    assert near.speed(Q, np.zeros(7)) == 0.0


def test_no_point_of_what_is_held_is_faster_than_said(near: DrakeDistances) -> None:
    turned = np.array([np.cos(0.6), np.sin(0.6), 0.0, 0.0, 0.02, 0.03, 0.25])
    look(near, {}, held=1, X_TO=turned)
    bound, h, X_TO = near.speed(Q, V), 1e-6, as_matrix(turned)
    corners = np.concatenate([np.asarray(p) for p in Asset.load(models_dir() / "objects" / "sugar_box").convex_pieces])
    one, two = (near.tool(Q + s * h * V) @ X_TO for s in (-1.0, 1.0))
    fast = np.linalg.norm(corners @ (two - one)[:3, :3].T + (two - one)[:3, 3], axis=1) / (2 * h)
    assert fast.max() <= bound + 1e-6 and bound < 1.5 * fast.max()
    middle = np.linalg.norm((two - one)[:3, 3]) / (2 * h)
    assert fast.max() > 1.02 * middle, "a corner is faster than the middle"
    look(near, {})
    assert near.speed(Q, V) < bound, "nothing is held any more"


def test_what_is_absent_is_not_met_and_nothing_meets_its_like(near: DrakeDistances) -> None:
    assert set(look(near, {}).body) <= {0}
    both = look(near, {0: (0.5, 0.2, 0.1), 1: (0.5, 0.2, 0.1)})
    assert set(both.body) == {0, 1, 2}
    assert set(both.part) <= set(near.parts), "pairs of the arm with others alone"
    assert not any("link0" in name for name in near.parts.values())


def test_a_further_instance_has_the_shape_of_its_kind(near: DrakeDistances) -> None:
    place = (0.5, 0.25, 0.3)
    for kind in (0, 1, 0):
        mine = least(look(near, {kind: place}), 1 + kind)
        assert least(look(near, {2: place}, assets=[kind]), 3) == pytest.approx(mine, abs=1e-9)


def test_an_unknown_thing_is_where_its_pieces_are_told_and_may_change(near: DrakeDistances) -> None:
    X = near.tool(Q)[:3, 3]
    away = X + np.array([0.0, 0.0, 0.4])
    first = look(near, {3: (0, 0, 0)}, things=[(CUBE + away,), ()])
    nearer = look(near, {3: (0, 0, 0)}, things=[(CUBE + away - [0, 0, 0.1],), ()])
    assert least(nearer, 4) < least(first, 4)
    again = look(near, {3: (0, 0, 0)}, things=[(CUBE + away,), ()])
    assert least(again, 4) == pytest.approx(least(first, 4), abs=1e-9)
    assert 4 not in set(look(near, {}).body)


def test_what_is_held_moves_with_the_arm_and_meets_the_rest(near: DrakeDistances) -> None:
    X_TO = np.array([1.0, 0, 0, 0, 0, 0, 0.1])
    p = tuple(near.tool(Q) @ np.array([0.0, 0.0, 0.35, 1.0]))[:3]
    bare = look(near, {1: p})
    held = look(near, {1: p}, held=0, X_TO=X_TO)
    assert least(held, 2) < least(bare, 2) - 0.05, "the can in the hand is nearer to the box than the fingers are"
    assert 1 not in set(held.body), "it is no obstacle"
    table = look(near, {}, held=0, X_TO=X_TO, within=2.0)
    lifted = look(near, {}, held=0, X_TO=X_TO, on_support=True, within=2.0)
    assert len(table.distance) > len(lifted.distance)
    borne = look(near, {1: p}, held=0, X_TO=X_TO, on_support=True, support=1)
    assert least(borne, 2) == pytest.approx(least(bare, 2)), "what bears it is met by the arm alone"
    assert least(look(near, {1: p}, held=0, X_TO=X_TO, support=1), 2) == pytest.approx(least(held, 2)), (
        "lifted, by both"
    )
    assert near.speed(Q, V) > 0.0
    free = look(near, {0: p, 1: p})
    assert {1, 2} <= set(free.body), "let go it is an obstacle again"


def test_what_is_not_sure_of_its_place_in_the_hand_is_nearer(near: DrakeDistances) -> None:
    X_TO = np.array([1.0, 0, 0, 0, 0, 0, 0.1])
    p = tuple(near.tool(Q) @ np.array([0.0, 0.0, 0.35, 1.0]))[:3]
    sure = least(look(near, {1: p}, held=0, X_TO=X_TO), 2)
    for within in (0.5, sure - 0.005):  # also where it is the doubt that brings it within
        assert least(look(near, {1: p}, within, held=0, X_TO=X_TO, unsure=0.01), 2) == pytest.approx(sure - 0.01)
    bare = look(near, {1: p})
    assert least(look(near, {1: p}, unsure=0.01), 2) == pytest.approx(least(bare, 2)), "the arm knows where it is"


def test_a_half_space_is_as_far_as_it_is(tmp_path: Path) -> None:
    floor = tmp_path / "floor.sdf"
    floor.write_text(
        '<sdf version="1.9"><model name="floor"><link name="floor"><collision name="c"><geometry><plane>'
        "<normal>0 0 1</normal></plane></geometry></collision></link></model></sdf>"
    )
    arm = scenario.ArmModel(model="arms/panda_hand.urdf", tool_frame="panda_tcp")
    box = DrakeDistances(arm, [scenario.Fixture(model=str(floor))], {}, 0, 0)
    box.surround(Shapes(np.zeros(0, dtype=bool), [], []))
    found = box.near(Q, V, None, np.zeros(0, dtype=bool), np.zeros((0, 4, 4)), 0.6)
    assert found.distance.min() > 0.0
    assert found.distance.min() < box.tool(Q)[2, 3]
