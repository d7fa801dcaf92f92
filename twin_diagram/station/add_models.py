"""Adds models to a plant as a scenario names them, and reads its poses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from twin_diagram.errors import ModelError, ScenarioError
from twin_diagram.model.description import add_arm as description
from twin_diagram.model.description import foreign, parser_warnings
from twin_diagram.scenario import Pose, Scenario, poses
from twin_diagram.scenario.resources import resolve


def transform(pose: Pose, field: str) -> RigidTransform:
    """Return a scenario's pose as Drake's.

    Raises:
        ScenarioError: it has not three finite numbers each; `field` names it.
    """
    for name, values in (("translation", pose.translation), ("rpy", pose.rpy)):
        if len(values) != 3 or not np.all(np.isfinite(values)):
            raise ScenarioError(f"{field}.{name}", f"{values} is not three finite numbers")
    return poses.pose(pose)


def twin_arm(scenario: Scenario, plant: MultibodyPlant | None = None) -> description.Arm:
    """Return the arm that the twin was told of: its joints' names and, in `plant`, its places.

    Raises:
        ScenarioError: it cannot be loaded.
    """
    try:
        return description.add_arm(plant or MultibodyPlant(0.0), scenario.twin.arm, scenario.packages)
    except ModelError as error:
        raise description.scenario_error("twin.arm", error) from error


def add_model(
    plant: MultibodyPlant, name: str, packages: Mapping[str, str], model: str, *, still: bool = False
) -> list[ModelInstanceIndex]:
    """Parse one description into `plant`.

    Args:
        plant: not yet finalized.
        name: prefix of the new model instances' names.
        packages: local folders for ``package://`` names.
        model: a path, see `twin_diagram.scenario.resources.resolve`.
        still: it stands still, wherever it is put; see `foreign.add_models`.

    Raises:
        ModelError: the file is missing or the parser refuses it; the message says where.
    """
    path = resolve(model, packages)
    if path.is_dir():
        raise ModelError(f"{model}: {path} is a folder, not a model's description")
    try:
        with parser_warnings.in_one_line(path):
            instances = list(foreign.add_models(_parser(plant, packages, name), path, still=still))
    except RuntimeError as error:
        raise ModelError(f"{path}: {' '.join(str(error).split())}") from error
    if not instances:
        raise ModelError(f"{path}: no model in it")
    return instances


def _parser(plant: MultibodyPlant, packages: Mapping[str, str], prefix: str) -> Parser:
    """Return the package's own parser, with a prefix to the names of what it adds."""
    parser = Parser(plant, prefix)
    parser.SetAutoRenaming(True)
    known = description.parser(plant, packages).package_map()
    package_map = parser.package_map()
    for name in package_map.GetPackageNames():
        package_map.Remove(name)
    package_map.AddMap(known)
    return parser
