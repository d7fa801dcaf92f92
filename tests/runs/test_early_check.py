"""What a scenario names and is not there is told before anything slow is imported."""

from __future__ import annotations

import pytest

from twin_diagram.errors import ScenarioError
from twin_diagram.runs.early_check import check_given
from twin_diagram.scenario import load_scenario

WRONG = {
    "world.arm.model=arms/none.urdf": "world.arm.model",
    "world.arm.effects=[{name: warmth}]": "world.arm",
    "world.fixtures=[{model: scenes/none.sdf}]": r"world.fixtures\[0\].model",
    "world.objects.can.asset=objects/none": "world.objects.can.asset",
    "twin.library.can=objects/none": "twin.library.can",
}


@pytest.mark.parametrize("override", WRONG)
def test_what_is_not_there_is_told_by_its_field(override: str) -> None:
    with pytest.raises(ScenarioError, match=f"^{WRONG[override]}.*(no such file|no effect is called)"):
        check_given(load_scenario("tabletop", [override]))


@pytest.mark.parametrize("field", ["twin.home", "world.q0"])
def test_angles_in_degrees_are_told(field: str) -> None:
    with pytest.raises(ScenarioError, match=f"^{field}: panda_joint4 is -135: it looks like degrees"):
        check_given(load_scenario("tabletop", [f"{field}=[0, -45, 0, -135, 0, 90, 45]"]))


@pytest.mark.parametrize("station", ["sim", "lcm"])
def test_of_the_world_a_simulated_station_alone_is_checked(station: str) -> None:
    check_given(load_scenario("tabletop", [f"station={station}"]))
    if station != "sim":
        check_given(load_scenario("tabletop", [f"station={station}", "world.arm.model=arms/none.urdf"]))
