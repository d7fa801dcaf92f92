"""Scenarios drawn afresh: everything within its range, and the ranges used; nothing too near to anything."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.small_loop import small_scenario
from twin_diagram.model.model import Model
from twin_diagram.runs import randomization
from twin_diagram.runs.randomization import vary
from twin_diagram.scenario import Pose, Scenario, WayPoint, WorldObject
from twin_diagram.scenario.file import copy_scenario, load_scenario
from twin_diagram.signals.arrays import Array

START, GOAL = np.array([0.45, 0.3]), np.array([0.5, -0.3])
EDGES = {"small": [0.06, 0.08, 0.1], "large": [0.12, 0.16, 0.2], "mover": [0.1, 0.06, 0.24]}
SIZES = {name: np.array(edges) for name, edges in EDGES.items()}
RADII = {"small": 0.05, "large": 0.1, "mover": np.sqrt(0.05**2 + 0.03**2)}


def table(*names: str) -> Scenario:
    scenario = Scenario()
    still = WayPoint(0.0, Pose())
    scenario.world.objects = {
        name: WorldObject(asset=name, path=[still, still] if name == "mover" else []) for name in names
    }
    return scenario


def drawn(seed: int, *names: str, start: Array = START, goal: Array = GOAL) -> Scenario:
    scenario = table(*names)
    rng = np.random.default_rng(seed)
    assert any(randomization._draw_places(scenario, SIZES, start, goal, rng) for _ in range(20))
    return scenario


def way_of(item: WorldObject) -> Array:
    """(20, 2) places that an object takes."""
    if not item.path:
        return np.array([item.X_WO.translation[:2]])
    a, b = (np.array(point.X_WO.translation[:2]) for point in item.path)
    return a + np.linspace(0, 1, 20)[:, None] * (b - a)


def assert_fills(values: Array, low: float, high: float) -> None:
    """Within a range, and up to both of its ends."""
    margin = 0.03 * (high - low)
    assert low - 1e-12 <= values.min() < low + margin
    assert high - margin < values.max() <= high + 1e-12


def test_objects_stand_upright_anywhere_on_the_table() -> None:
    far = np.array([9.0, 9.0])
    for name, radius in (("small", 0.05), ("large", 0.1)):
        poses = [drawn(seed, name, start=far, goal=far).world.objects[name].X_WO for seed in range(300)]
        places = np.array([pose.translation for pose in poses])
        assert_fills(places[:, 0], 0.30 + radius, 0.80 - radius)
        assert_fills(places[:, 1], -0.46 + radius, 0.46 - radius)
        np.testing.assert_allclose(places[:, 2], SIZES[name][2] / 2)
        turns = np.array([pose.rpy for pose in poses])
        assert (turns[:, :2] == 0).all()
        assert_fills(turns[:, 2], -np.pi, np.pi)


def test_objects_keep_apart_and_leave_the_tool_its_room() -> None:
    """3 cm between any two, whichever way they are turned; 10 cm around where the tool starts and goes."""
    between, around = [], []
    for seed in range(150):
        objects = drawn(seed, "small", "mover", "large").world.objects
        ways = {name: way_of(item) for name, item in objects.items()}
        for name, way in ways.items():
            for end in (START, GOAL):
                around.append(np.linalg.norm(way - end, axis=1).min() - RADII[name])
            for other in ways:
                if other < name:
                    gaps = np.linalg.norm(way[:, None] - ways[other][None], axis=2)
                    between.append(gaps.min() - RADII[name] - RADII[other])
    assert 0.03 < min(between) < 0.04
    assert 0.10 < min(around) < 0.11


def test_what_finds_no_room_is_told() -> None:
    crowd = [f"large{k}" for k in range(30)]
    scenario = table(*crowd)
    sizes = {name: SIZES["large"] for name in crowd}
    assert not randomization._draw_places(scenario, sizes, START, GOAL, np.random.default_rng(0))


def test_a_mover_does_not_end_where_the_tool_has_no_room() -> None:
    """Its way may begin far from the tool; here it would end within 14 cm of it, and needs 15.8."""
    near = np.array([0.45, 0.12]), np.array([0.45, -0.12])
    for seed in range(3):
        assert not randomization._draw_places(table("mover"), SIZES, *near, np.random.default_rng(seed))


@pytest.mark.parametrize("names", [("small", "large"), ("large", "small"), ("large", "mover"), ("mover", "large")])
def test_who_needs_the_most_room_is_placed_first(names: tuple[str, str]) -> None:
    first = "mover" if "mover" in names else "large"
    for seed in range(30):
        item = drawn(seed, *names).world.objects[first]
        yaw = (item.path[0].X_WO if item.path else item.X_WO).rpy[2]
        tries = np.random.default_rng(seed).uniform(-np.pi, np.pi)
        if yaw == tries:  # its first place was free: the first number that was drawn is its own
            break
    else:
        pytest.fail("never")


def test_movers_come_from_beyond_into_the_tools_way() -> None:
    turns, begins, durations, along, shifts, away = [], [], [], [], [], []
    far = np.array([0.0, 3.0]), np.array([0.0, -3.0])  # so that no place is too near to an end
    for seed in range(400):
        (item,) = drawn(seed, "mover", start=far[0], goal=far[1]).world.objects.values()
        first, last = item.path
        turns.append(last.X_WO.rpy[2] - first.X_WO.rpy[2])
        begins.append(first.time)
        durations.append(last.time - first.time)
        end = np.array(last.X_WO.translation)
        assert end[2] == first.X_WO.translation[2] == 0.12
        along.append((3.0 - end[1]) / 6.0)
        shifts.append(end[0])
        away.append(np.array(first.X_WO.translation[:2]) - end[:2])
    assert_fills(np.array(turns), -0.8, 0.8)
    assert_fills(np.array(begins), 0.5, 2.0)
    assert_fills(np.array(durations), 1.5, 3.5)
    assert_fills(np.array(along), 0.35, 0.65)
    assert_fills(np.array(shifts), -0.03, 0.06)
    assert_fills(np.array(away)[:, 0], 0.18, 0.28)
    assert_fills(np.array(away)[:, 1], -0.2, 0.2)


def test_payload_and_friction_are_drawn() -> None:
    base = load_scenario("tabletop")
    told = {effect.name: effect.parameters for effect in base.twin.arm.effects}
    payloads, factors = [], []
    for seed in range(200):
        scenario = copy_scenario(base)
        randomization._draw_dynamics(scenario, np.random.default_rng(seed))
        for effect in scenario.world.arm.effects:
            if effect.name == "payload":
                payloads.append([*effect.parameters["mass"], *effect.parameters["com"]])
            else:
                for name, values in effect.parameters.items():
                    factors.extend(np.array(values) / told[effect.name][name])
    for column, (low, high) in zip(
        np.array(payloads).T, ((0.2, 1.5), (-0.03, 0.03), (-0.03, 0.03), (0.12, 0.2)), strict=True
    ):
        assert_fills(column, low, high)
    assert_fills(np.array(factors), 0.9, 1.1)


def test_a_whole_scenario(tmp_path: Path) -> None:
    """The twin is told the new textures and nothing else; the base stays as it is; the same seed says the same."""
    base = small_scenario(objects=("can", "mover"))
    before = copy_scenario(base)
    one, again, other = (vary(base, seed, tmp_path / name) for seed, name in ((4, "a"), (4, "a"), (5, "b")))
    assert base == before and one == again and one.seed == 4 and other.seed == 5
    for name in ("can", "mover"):
        assert one.twin.library[name] == one.world.objects[name].asset == str((tmp_path / "a" / name).resolve())
        assert (tmp_path / "a" / name / "visual.png").read_bytes() != (
            tmp_path / "b" / name / "visual.png"
        ).read_bytes()
    assert one.twin.arm == base.twin.arm and one.world.arm != base.world.arm
    assert one.world.objects["can"].X_WO != other.world.objects["can"].X_WO
    # The mover ends near the line between where the tool starts and where it goes.
    model = Model.load(base.twin.arm)
    start = model.tool_pose(np.array(base.twin.home)).translation()[:2]
    assert base.twin.task.X_WG is not None
    goal = np.array(base.twin.task.X_WG.translation[:2])
    end = np.array(one.world.objects["mover"].path[-1].X_WO.translation[:2])
    share = np.array([(end[1] - start[1]) / (goal[1] - start[1])])
    assert 0.35 <= share[0] <= 0.65
    assert -0.03 <= end[0] - (start + share * (goal - start))[0] <= 0.06
