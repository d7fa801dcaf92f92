"""Refuses at once what a scenario tells wrongly or what is not there: a run's other modules take seconds to import."""

from __future__ import annotations

from functools import partial

from twin_diagram.assets.description import read_spec
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.resources import resolve
from twin_diagram.scenario.validation import check_twin
from twin_diagram.twin.given_files import check_fixtures, model_of, named


def check_given(scenario: Scenario) -> None:
    """Check what the twin is told, and that the files are there which it names; `make_twin` reads them whole.

    Raises:
        ScenarioError: it names the field.
    """
    twin, packages = scenario.twin, scenario.packages
    check_twin(twin)
    model_of(twin, packages)
    check_fixtures(twin, packages)
    for name, folder in twin.library.items():
        named(f"twin.library.{name}", partial(_description, folder, packages))


def _description(folder: str, packages: dict[str, str]) -> None:
    read_spec(resolve(folder, packages))
