"""Where things are to be put down: not inside of what never moves."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.errors import ScenarioError
from twin_diagram.planning.collision.convex_solids import Box, Solid
from twin_diagram.planning.collision.geometry_to_solids import fixture_solids
from twin_diagram.planning.tasks.bearing import borne, depth_inside
from twin_diagram.planning.tasks.place_goals import check_places
from twin_diagram.scenario import Pose, TaskStep
from twin_diagram.scenario.resources import resolve

HALF = 0.0508
"""Of the can's height [m]."""


@pytest.fixture(scope="module")
def library() -> dict[str, Asset]:
    return {"can": Asset.load(resolve("objects/can"))}


def placing(x: float, z: float, tolerance: float = 0.01) -> scenario.Task:
    goal = Pose(translation=[x, 0.2, z])
    return scenario.Task(
        steps=[
            TaskStep(kind="pick", object="can"),
            TaskStep(kind="place", object="can", goal=goal, position_tolerance=tolerance),
        ]
    )


def test_depth_is_that_of_the_nearest_way_out() -> None:
    def cube(z: float) -> list[np.ndarray]:
        return [Box(np.full(3, 0.05), np.eye(3), np.array([0.0, 0.0, z])).vertices]

    slab: list[Solid] = [Box(np.array([1.0, 1.0, 0.1]), np.eye(3), np.array([0.0, 0.0, -0.1]))]
    assert depth_inside(cube(0.03), slab) == pytest.approx(0.02)
    assert depth_inside(cube(0.08), slab) == pytest.approx(-0.03)
    assert depth_inside(cube(0.0), []) == -np.inf
    thin: list[Solid] = [Box(np.array([1.0, 1.0, 0.02]), np.eye(3), np.zeros(3))]
    assert depth_inside(cube(0.0), thin) == pytest.approx(0.02, abs=0.005), "no corner is inside, the middle is"


@pytest.mark.parametrize("height", [0.0, 0.15])
def test_a_goal_at_the_tables_top_in_the_place_of_the_objects_middle_is_refused(
    library: dict[str, Asset], height: float
) -> None:
    table = fixture_solids([scenario.Fixture("scenes/table.sdf", Pose(translation=[0.0, 0.0, height]))])
    check_places(placing(0.5, height + HALF), library, table)
    check_places(placing(0.5, height + HALF - 0.008), library, table)
    with pytest.raises(ScenarioError, match="would fall"):
        check_places(placing(1.2, height), library, table)
    with pytest.raises(ScenarioError, match=r"steps\.1\.goal: can would stand inside table.* is 0\.051 m above"):
        check_places(placing(0.5, height), library, table)
    with pytest.raises(ScenarioError, match="inside table"):
        check_places(placing(0.5, height + HALF - 0.008, tolerance=0.005), library, table)


def test_a_goal_with_nothing_below_it_is_refused(library: dict[str, Asset]) -> None:
    """What is let go in mid-air falls, and what stands half over an edge or leans tips over."""
    table = fixture_solids([scenario.Fixture("scenes/table.sdf")])
    check_places(placing(0.5, HALF + 0.008), library, table)
    check_places(placing(0.5, 0.25), library, [])
    check_places(placing(0.99, HALF), library, table)
    for task in (placing(0.5, 0.25), placing(0.5, HALF + 0.012), placing(1.02, HALF), placing(0.5, 0.056, 0.002)):
        with pytest.raises(ScenarioError, match=r"steps\.1\.goal: can would fall or tip: no fixture bears its middle"):
            check_places(task, library, table)
    leaning = placing(0.5, 0.07)
    leaning.steps[1].goal = Pose(translation=[0.5, 0.2, 0.065], rpy=[0.7, 0.0, 0.0])
    with pytest.raises(ScenarioError, match="would fall"):
        check_places(leaning, library, table)
    lying = placing(0.5, 0.07)
    lying.steps[1].goal = Pose(translation=[0.5, 0.2, 0.034], rpy=[1.5708, 0.0, 0.0])
    check_places(lying, library, table)


def test_upon_another_it_must_touch_that(library: dict[str, Asset]) -> None:
    """Whichever way that lies then; no fixture counts."""
    boxes = library | {"box": Asset.load(resolve("objects/cracker_box"))}
    table = fixture_solids([scenario.Fixture("scenes/table.sdf")])

    def upon(below: str, above: str, *translation: float) -> scenario.Task:
        goal = Pose(translation=list(translation))
        return scenario.Task(steps=[TaskStep(kind="pick", object=above), TaskStep(kind="place", upon=below, goal=goal)])

    on_top = HALF + 0.105
    for good in (upon("box", "can", 0, 0, on_top), upon("box", "can", 0.0, 0.05, on_top + 0.009)):
        check_places(good, boxes, table)
    check_places(upon("can", "box", 0, 0, on_top), boxes, table)
    for inside in (upon("box", "can", 0, 0, 0.105), upon("can", "box", 0, 0, 0.105)):
        with pytest.raises(ScenarioError, match=r"steps\.1\.goal: .* would stand [0-9.]+ mm inside"):
            check_places(inside, boxes, table)
    for beside in (upon("box", "can", 0, 0, on_top + 0.012), upon("can", "box", 0, 0, 0.3)):
        with pytest.raises(ScenarioError, match=r"steps\.1\.goal: .* mm off .* more than 10 mm"):
            check_places(beside, boxes, table)


def test_what_is_beside_bears_nothing() -> None:
    cube = [Box(np.full(3, 0.05), np.eye(3), np.array([0.0, 0.0, 0.05])).vertices]
    middle = np.array([0.0, 0.0, 0.05])
    wall: list[Solid] = [Box(np.array([0.05, 1.0, 1.0]), np.eye(3), np.array([0.101, 0.0, 0.0]))]
    post: list[Solid] = [Box(np.array([0.01, 0.01, 0.5]), np.eye(3), np.array([0.0, 0.0, -0.502]))]
    aside: list[Solid] = [Box(np.array([0.01, 0.01, 0.5]), np.eye(3), np.array([0.03, 0.0, -0.502]))]
    assert not borne(cube, middle, wall, 0.01)
    assert borne(cube, middle, post, 0.01)
    assert not borne(cube, middle, post, 0.001)
    assert not borne(cube, middle, aside, 0.01)


def test_a_grasp_that_is_told_is_at_its_object(library: dict[str, Asset]) -> None:
    """X_OG, from the can's middle: where the can stands in the world is half a metre off, and was gripped at there."""

    def picking(x: float, z: float) -> scenario.Task:
        return scenario.Task(steps=[TaskStep(kind="pick", object="can", goal=Pose(translation=[x, 0.0, z]))])

    for near in (picking(0.0, 0.02), picking(0.0, HALF + 0.2)):
        check_places(near, library, [])
    with pytest.raises(ScenarioError, match=r"twin.task.steps.0.goal: .* 0.47 m off can .* X_OG"):
        check_places(picking(0.5, 0.05), library, [])
