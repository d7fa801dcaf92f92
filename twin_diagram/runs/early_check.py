"""Refuses at once what a scenario tells wrongly or what is not there: a run's other modules take seconds to import."""

from __future__ import annotations

from functools import partial

from twin_diagram.assets.description import read_spec
from twin_diagram.errors import ModelError
from twin_diagram.model.description import add_arm
from twin_diagram.model.effects import make
from twin_diagram.scenario import Scenario, World
from twin_diagram.scenario.resources import resolve
from twin_diagram.scenario.validation import check_twin
from twin_diagram.twin.given_files import check_angles, check_fixtures, model_of, named


def check_given(scenario: Scenario) -> None:
    """Check what the twin is told, and that the files are there which it and a simulated world name.

    `make_twin` and the station read them whole.

    Raises:
        ScenarioError: it names the field.
    """
    twin, packages = scenario.twin, scenario.packages
    check_twin(twin)
    model = model_of(twin, packages)
    check_fixtures(twin, packages)
    for name, folder in twin.library.items():
        named(f"twin.library.{name}", partial(_description, folder, packages))
    if scenario.station == "sim":
        check_angles("world.q0", scenario.world.q0, model)
        _check_world(scenario.world, packages)


def _check_world(world: World, packages: dict[str, str]) -> None:
    try:
        add_arm.resolve(world.arm, packages)
    except ModelError as error:
        raise add_arm.scenario_error("world.arm", error) from error
    for effect in world.arm.effects:
        named("world.arm", partial(make, effect))
    for index, fixture in enumerate(world.fixtures):
        named(f"world.fixtures[{index}].model", partial(resolve, fixture.model, packages))
    for name, thing in world.objects.items():
        if thing.asset:  # that it names none is told by the station
            named(f"world.objects.{name}.asset", partial(resolve, thing.asset, packages))


def _description(folder: str, packages: dict[str, str]) -> None:
    read_spec(resolve(folder, packages))
