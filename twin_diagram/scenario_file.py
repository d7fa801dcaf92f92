"""Reads and writes scenario files, with overrides, and says in one line what is wrong with them."""

from __future__ import annotations

import copy
import dataclasses
import difflib
import os
import re
import types
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed

from twin_diagram.errors import ScenarioError
from twin_diagram.resources import models_dir
from twin_diagram.scenario import Scenario

STATIONS = ("sim", "replay", "lcm")


class _Loader(yaml.SafeLoader):
    """Reads 1e-3 as a number, as YAML 1.2 and everybody else does."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$"), list("-+.0123456789")
)


def load_scenario(path: str | Path, overrides: Iterable[str] = ()) -> Scenario:
    """Reads a scenario.

    Relative paths inside it are taken from the scenario's own folder first, then from the models that come along.

    Args:
        path: a YAML file, or the name of a scenario that comes along such as ``tabletop``.
        overrides: ``dotted.field=value`` each, the value being YAML, e.g. ``twin.filter.rate=400``.

    Raises:
        ScenarioError: the file is missing or not YAML, or a field is unknown or of the wrong type; it names the field.
    """
    file = find_scenario(path)
    try:
        data = yaml.load(file.read_text(), _Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}" if mark else "the file"
        problem = getattr(error, "problem", None) or "not readable"
        raise ScenarioError(str(file), f"{where} is not YAML: {problem}") from error
    except UnicodeDecodeError as error:
        raise ScenarioError(str(file), "not a text file; a scenario is YAML in UTF-8") from error
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise ScenarioError(str(file), f"a scenario is a mapping of fields, this is a {type(data).__name__}")
    for override in overrides:
        _override(data, override)
    scenario = parse_scenario(data)
    return _anchored(scenario, file.parent)


def override_scenario(scenario: Scenario, overrides: Iterable[str]) -> Scenario:
    """A copy with fields set anew, as in `load_scenario`."""
    data = yaml.safe_load(dump_scenario(scenario))
    for override in overrides:
        _override(data, override)
    return parse_scenario(data)


def find_scenario(path: str | Path) -> Path:
    """The scenario's file: `path` itself, or one that comes along, with or without ``.yaml``."""
    given = Path(path).expanduser()
    candidates = [given, models_dir() / "scenarios" / given, models_dir() / "scenarios" / f"{given}.yaml"]
    for candidate in candidates:
        if candidate.is_file():
            return candidate.resolve()
    known = sorted(p.stem for p in (models_dir() / "scenarios").glob("*.yaml"))
    raise ScenarioError(str(path), f"no such scenario file; those that come along: {', '.join(known) or 'none'}")


def parse_scenario(data: Mapping[str, Any]) -> Scenario:
    """A scenario from plain YAML data.

    Raises:
        ScenarioError: a field is unknown, has the wrong type or an impossible value.
    """
    _check(data, Scenario, "")
    try:
        scenario = yaml_load_typed(
            schema=Scenario,
            data=yaml.safe_dump(dict(data), sort_keys=False),
            defaults=Scenario(),
            retain_map_defaults=True,
        )
    except (RuntimeError, ValueError, TypeError) as error:  # the loader's own words, where the check above saw nothing
        raise ScenarioError("scenario", " ".join(str(error).split())) from error
    if scenario.station not in STATIONS:
        raise ScenarioError("station", f"{scenario.station!r} is none of {', '.join(STATIONS)}")
    if scenario.duration <= 0:
        raise ScenarioError("duration", f"{scenario.duration} s is not a length of time")
    return typing.cast(Scenario, scenario)


def dump_scenario(scenario: Scenario) -> str:
    """The scenario as YAML, every field written out."""
    return typing.cast(str, yaml_dump_typed(scenario, schema=Scenario))


def save_scenario(scenario: Scenario, path: Path) -> None:
    """Writes the scenario as YAML, by a temporary name."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(dump_scenario(scenario))
    temporary.replace(path)


def copy_scenario(scenario: Scenario) -> Scenario:
    """A deep copy."""
    return copy.deepcopy(scenario)


def _override(data: dict[str, Any], override: str) -> None:
    name, equals, text = override.partition("=")
    if not equals or not name:
        raise ScenarioError(override, "an override reads FIELD=VALUE, e.g. twin.filter.rate=400")
    try:
        value = yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        raise ScenarioError(name, f"{text!r} is not YAML") from error
    here: Any = data
    *parents, last = name.split(".")
    for depth, parent in enumerate(parents):
        if not isinstance(here, dict):
            raise ScenarioError(".".join(parents[:depth]), f"holds {here!r}, so {name} cannot be set")
        if here.get(parent) is None:
            here[parent] = {}
        here = here[parent]
    if isinstance(here, list):
        try:
            here[int(last)] = value
        except (ValueError, IndexError) as error:
            raise ScenarioError(name, f"the list has {len(here)} entries, numbered from 0") from error
    elif isinstance(here, dict):
        here[last] = value
    else:
        raise ScenarioError(name, f"cannot be set: {'.'.join(parents)} holds {here!r}")


def _check(value: Any, schema: Any, name: str) -> None:
    """Holds plain YAML data against a schema of dataclasses and raises with the dotted name of what does not fit."""
    origin, arguments = typing.get_origin(schema), typing.get_args(schema)
    shown = name or "scenario"
    if origin in (typing.Union, types.UnionType):
        if value is None:
            return
        schema = next(a for a in arguments if a is not type(None))
        _check(value, schema, name)
    elif dataclasses.is_dataclass(schema):
        if not isinstance(value, Mapping):
            raise ScenarioError(shown, f"expected fields, got {value!r}")
        fields = {f.name: f.type for f in dataclasses.fields(schema)}
        for key, sub in value.items():
            dotted = f"{name}.{key}" if name else str(key)
            if key not in fields:
                raise ScenarioError(dotted, f"unknown field{_nearest(str(key), fields)}")
            _check(sub, fields[key], dotted)
    elif origin is list:
        if not isinstance(value, list):
            raise ScenarioError(shown, f"expected a list, got {value!r}")
        for index, sub in enumerate(value):
            _check(sub, arguments[0], f"{name}.{index}")
    elif origin is dict:
        if not isinstance(value, Mapping):
            raise ScenarioError(shown, f"expected named entries, got {value!r}")
        for key, sub in value.items():
            _check(sub, arguments[1], f"{name}.{key}")
    elif schema is float:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or value != value:
            raise ScenarioError(shown, f"expected a number, got {value!r}")
    elif schema is int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise ScenarioError(shown, f"expected a whole number, got {value!r}")
    elif schema is str:
        if not isinstance(value, str):
            raise ScenarioError(shown, f"expected text, got {value!r}")


def _nearest(key: str, fields: Mapping[str, Any]) -> str:
    near = difflib.get_close_matches(key, fields, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; it is one of {', '.join(fields)}"


def _anchored(scenario: Scenario, folder: Path) -> Scenario:
    """Makes relative paths that exist below the scenario's folder absolute: it may then be read anywhere."""

    def anchor(name: str) -> str:
        path = folder / name
        return str(path.resolve()) if name and not name.startswith("package://") and path.exists() else name

    arms = [scenario.world.arm, scenario.twin.arm]
    for arm in arms:
        arm.model = anchor(arm.model)
    for fixture in [*scenario.world.fixtures, *scenario.twin.fixtures]:
        fixture.model = anchor(fixture.model)
    for item in scenario.world.objects.values():
        item.asset = anchor(item.asset)
    scenario.twin.library = {name: anchor(path) for name, path in scenario.twin.library.items()}
    scenario.packages = {name: anchor(path) for name, path in scenario.packages.items()}
    scenario.replay.log = anchor(scenario.replay.log)
    return scenario
