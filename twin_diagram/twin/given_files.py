"""Reads the files that a scenario's ``twin:`` names; what is wrong with them is said with the field."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from twin_diagram import scenario
from twin_diagram.errors import ModelError, ScenarioError, TwinError
from twin_diagram.model.description import add_arm as description
from twin_diagram.model.model import Model
from twin_diagram.scenario.resources import resolve

if TYPE_CHECKING:
    from twin_diagram.assets.asset import Asset

Packages = Mapping[str, str | Path]
Made = TypeVar("Made")


def model_of(twin: scenario.Twin, packages: Packages | None) -> Model:
    """Load the arm, with a home for each joint."""
    # A corrected model's folder says itself on which side its torques were measured.
    side = "link" if twin.driver.torque_side == "link" else None
    try:
        model = Model.load(twin.arm, packages, torque_side=side)
    except ModelError as error:
        raise description.scenario_error("twin.arm", error) from error
    if twin.home and len(twin.home) != len(model.joints):
        raise ScenarioError(
            "twin.home", f"{len(twin.home)} angles for {len(model.joints)} joints ({', '.join(model.joints)})"
        )
    check_angles("twin.home", twin.home, model)
    return model


def check_angles(field: str, angles: list[float], model: Model) -> None:
    """Refuse angles (n,) that are in degrees; none, or another number of them, is not looked at."""
    if len(angles) == len(model.joints) and model.limits.in_degrees(np.array([angles])):
        k = int(np.argmax(np.abs(angles)))
        raise ScenarioError(field, f"{model.joints[k]} is {angles[k]:g}: it looks like degrees; angles are in rad")


def check_fixtures(twin: scenario.Twin, packages: Packages | None) -> None:
    """Refuse a fixture whose file does not exist, by the field's name."""
    for index, fixture in enumerate(twin.fixtures):
        named(f"twin.fixtures.{index}.model", partial(resolve, fixture.model, packages))


def library_of(twin: scenario.Twin, packages: Packages | None) -> dict[str, Asset]:
    """Load the known objects' assets."""
    return {
        name: named(f"twin.library.{name}", partial(_asset, folder, packages)) for name, folder in twin.library.items()
    }


def _asset(folder: str, packages: Packages | None) -> Asset:
    from twin_diagram.assets.asset import Asset  # with SciPy, which is not needed to refuse what is not there

    return Asset.load(resolve(folder, packages))


def named(field: str, make: Callable[[], Made]) -> Made:
    """Run `make`; what is wrong with the user's files is said with the scenario's field."""
    try:
        return make()
    except ScenarioError:
        raise
    except TwinError as error:
        raise ScenarioError(field, str(error)) from error
