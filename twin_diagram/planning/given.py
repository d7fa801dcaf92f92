"""Refuses what planner and stop monitor cannot be built of, as users give it who wire them themselves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twin_diagram.assets import Asset
from twin_diagram.errors import ScenarioError, expect
from twin_diagram.model.model import Model
from twin_diagram.scenario import Planner, Twin


def check_kinds(model: Model, twin: Twin, library: Mapping[str, Asset]) -> None:
    """Refuse arguments of other kinds.

    Raises:
        ArgumentError: it says what is wanted.
    """
    expect(model, Model, "model", "a Model (as Model.load(PATH) returns it)")
    expect(twin, Twin, "twin", "a Twin (of a Scenario its field `twin`)")
    expect(library, Mapping, "library", "a mapping of names with Assets")
    for asset in library.values():
        expect(asset, Asset, "library", "an Asset for each name (Asset.load(FOLDER))")


def check_planner(params: Planner) -> None:
    """Refuse a planner's tuning that makes no sense.

    Raises:
        ScenarioError: it names the field.
    """
    positive = ("rate", "step", "clearance", "influence", "velocity_share", "torque_share", "acceleration")
    for name in positive:
        value, least = getattr(params, name), 0.0
        if value is None:
            continue
        if not (np.isfinite(value) and value > least):
            raise ScenarioError(f"twin.planner.{name}", f"{value} is not a positive number")
    if params.knots < 4:
        raise ScenarioError("twin.planner.knots", f"{params.knots} knots leave nothing to plan; give 4 or more")
    if params.influence < 1.5 * params.clearance:
        raise ScenarioError(
            "twin.planner.influence", f"{params.influence} m must be well above clearance ({params.clearance} m)"
        )
    for name in ("velocity_share", "torque_share"):
        if getattr(params, name) > 1.0:
            raise ScenarioError(f"twin.planner.{name}", f"{getattr(params, name)} is above the joints' limits")
