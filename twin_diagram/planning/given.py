"""Refuses what planner and stop monitor cannot be built of, as users give it who wire them themselves."""

from __future__ import annotations

from collections.abc import Mapping

from twin_diagram.assets import Asset
from twin_diagram.errors import expect
from twin_diagram.model.model import Model
from twin_diagram.scenario import Twin


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
