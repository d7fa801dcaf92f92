"""Tasks of several steps: both forms load, and what cannot be done is refused before anything starts."""

from __future__ import annotations

import pytest

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Scenario, TaskStep, load_scenario, override_scenario
from twin_diagram.scenario.file import dump_scenario, parse_scenario
from twin_diagram.scenario.validation import check_twin

GOAL = "goal: {translation: [0.5, 0.2, 0.1]}"
PICK = "{kind: pick, object: can}"
PLACE = f"{{kind: place, {GOAL}}}"


def tabletop(steps: str) -> Scenario:
    return load_scenario("tabletop", [f"twin.task=[{steps}]"])


def test_a_list_of_steps_is_a_task() -> None:
    """Also one that is written out in full and read again, or reached into."""
    scenario = tabletop(f"{{kind: hold, seconds: 0.2}}, {PICK}, {PLACE}")
    check_twin(scenario.twin)
    assert [step.kind for step in scenario.twin.task.steps] == ["hold", "pick", "place"]
    assert scenario.twin.task.X_WG is None
    assert scenario.twin.task.steps[0].seconds == 0.2
    assert scenario.twin.task.steps[1] == TaskStep(kind="pick", object="can")
    again = override_scenario(scenario, ["twin.task.steps.1.force=25"])
    assert again.twin.task.steps[1].force == 25.0
    assert "steps" in dump_scenario(again)


def test_overrides_reach_beside_a_list_that_was_set_before() -> None:
    scenario = load_scenario("tabletop", [f"twin.task=[{PICK}]", "twin.task.start=0.3", "twin.task.steps.0.tries=5"])
    assert (scenario.twin.task.start, scenario.twin.task.steps[0].tries) == (0.3, 5)


def test_the_present_form_is_as_before() -> None:
    scenario = load_scenario("tabletop")
    check_twin(scenario.twin)
    assert scenario.twin.task.steps == []
    assert scenario.twin.task.X_WG is not None
    assert parse_scenario({"twin": {"task": {"start": 2.0}}}).twin.task.start == 2.0


CASES = {
    "{kind: jump}": ("kind", "'jump'", "reach, follow, hold, pick, place"),
    "{kind: pick, object: teapot}": ("object", "'teapot'", "can"),
    "{kind: pick}": ("object", "''"),
    "{kind: follow, object: can}": ("goal", "X_OG"),
    "{kind: reach}": ("goal", "X_WG"),
    "{kind: reach, object: can, goal: {}}": ("object",),
    "{kind: hold, goal: {}}": ("goal",),
    "{kind: hold, seconds: 30}": ("seconds", "30.0", "20.0"),
    "{kind: hold, seconds: -1}": ("seconds", "-1.0"),
    f"{{kind: reach, {GOAL}, time_limit: 0}}": ("time_limit", "0.0"),
    f"{{kind: reach, {GOAL}, position_tolerance: 0}}": ("position_tolerance", "0.0"),
    "{kind: reach, goal: {translation: [1, 2]}}": ("goal.translation", "[1.0, 2.0]"),
    "{kind: pick, object: can, tries: 0}": ("tries", "0"),
    "{kind: pick, object: can, force: -2}": ("force", "-2.0"),
    PLACE: ("kind", "pick"),
}


@pytest.mark.parametrize("steps", CASES)
def test_what_cannot_be_done_is_refused_by_its_field(steps: str) -> None:
    field, *words = CASES[steps]
    with pytest.raises(ScenarioError) as caught:
        check_twin(tabletop(steps).twin)
    message = str(caught.value)
    assert message.startswith(f"twin.task.steps.0.{field}"), message
    assert all(word in message for word in words), message
    assert "\n" not in message


SECOND = {
    f"{PICK}, {PICK}": ("kind", "can"),
    f"{PICK}, {{kind: place, object: mug, {GOAL}}}": ("object", "'mug'", "can"),
    f"{PICK}, {{kind: follow, object: can, {GOAL}}}": ("object", "can"),
    f"{PICK}, {{kind: place}}": ("goal", "X_WO"),
    f"{PICK}, {{kind: place, upon: teapot, {GOAL}}}": ("upon", "'teapot'", "cracker_box"),
    f"{PICK}, {{kind: place, upon: can, {GOAL}}}": ("upon", "can"),
    f"{PICK}, {{kind: reach, upon: mug, {GOAL}}}": ("upon", "reach"),
}


@pytest.mark.parametrize("steps", SECOND)
def test_steps_must_follow_one_another(steps: str) -> None:
    field, *words = SECOND[steps]
    with pytest.raises(ScenarioError) as caught:
        check_twin(tabletop(steps).twin)
    assert str(caught.value).startswith(f"twin.task.steps.1.{field}")
    assert all(word in str(caught.value) for word in words)
    check_twin(tabletop(f"{PICK}, {{kind: place, object: can, {GOAL}}}, {PICK}").twin)


def test_what_bears_another_is_not_picked_before_that_is() -> None:
    upon, mug = f"{{kind: place, upon: mug, {GOAL}}}", "{kind: pick, object: mug}"
    check_twin(tabletop(f"{PICK}, {upon}, {PICK}, {PLACE}, {mug}").twin)
    check_twin(tabletop(f"{PICK}, {{kind: place, upon: mug}}").twin)
    with pytest.raises(ScenarioError, match=r"steps\.2\.object: mug bears can by then"):
        check_twin(tabletop(f"{PICK}, {upon}, {mug}").twin)


def test_one_goal_and_steps_are_not_both() -> None:
    with pytest.raises(ScenarioError, match=r"twin\.task\.X_WG"):
        check_twin(load_scenario("tabletop", [f"twin.task.steps=[{PICK}]"]).twin)


def test_a_list_of_something_else_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"twin\.task\.steps\.0"):
        load_scenario("tabletop", ["twin.task=[1]"])
    with pytest.raises(ScenarioError, match=r"twin\.task\.steps\.0\.object"):
        load_scenario("tabletop", ["twin.task=[{object: 3}]"])
