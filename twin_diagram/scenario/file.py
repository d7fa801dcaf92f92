"""Reads and writes scenario files, with overrides, and says in one line what is wrong with them."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import logging
import math
import os
import re
import reprlib
import sys
import types
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from twin_diagram.errors import ScenarioError, expect, expect_path
from twin_diagram.runtime import atomic_file
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.field_table import nearest
from twin_diagram.scenario.models import ENDLESS
from twin_diagram.scenario.resources import models_dir

_brief = reprlib.Repr()
_brief.maxstring = _brief.maxother = _brief.maxlong = 60

STATIONS = ("sim", "replay", "lcm")
"""Values of `station`."""


class _Loader(yaml.SafeLoader):
    """Reads 1e-3 as a number, as YAML 1.2 and everybody else does, and no field twice: the first would be lost."""

    def compose_mapping_node(self, anchor: Any) -> Any:
        """Return a mapping's node.

        Raises:
            YAMLError: one of its keys is there twice.
        """
        node = super().compose_mapping_node(anchor)
        known: set[str] = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode) and key.value != "<<"):
            if key.value in known:
                raise yaml.MarkedYAMLError(problem=f"{key.value} is there twice", problem_mark=key.start_mark)
            known.add(key.value)
        return node


class _FastLoader(yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader):  # type: ignore[misc]
    """Reads what is right at a tenth of the time; what it refuses, `_Loader` is asked about."""

    def get_single_node(self) -> Any:
        """Return the node of the whole text.

        Raises:
            YAMLError: it is none, or a key of one of its mappings is there twice.
        """
        node = super().get_single_node()
        left, seen = [node], set[int]()
        while left:
            one = left.pop()
            if id(one) in seen or not isinstance(one, yaml.CollectionNode):
                continue
            seen.add(id(one))
            if isinstance(one, yaml.MappingNode):
                keys = [key.value for key, _ in one.value if isinstance(key, yaml.ScalarNode) and key.value != "<<"]
                if len(set(keys)) < len(keys):
                    raise yaml.YAMLError("a key is there twice")
                left += [each for pair in one.value for each in pair]
            else:
                left += one.value
        return node


class _Dumper(yaml.SafeDumper):
    """Puts text that reads as such a number in quotes."""


for _class in (_Loader, _FastLoader, _Dumper):
    _class.add_implicit_resolver(
        "tag:yaml.org,2002:float",
        re.compile(r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$"),
        list("-+.0123456789"),
    )

_OTHER_FILES = dict.fromkeys(
    (".csv", ".npz", ".mcap", ".db3", ".bag"), "is a log; `twin-diagram replay` runs the twin on one"
) | dict.fromkeys((".urdf", ".sdf", ".xml"), "describes a robot; `twin-diagram init --arm` writes a scenario for it")
"""What else users have beside a scenario, and what takes it."""


def load_scenario(path: str | Path, overrides: Iterable[str] = ()) -> Scenario:
    """Read a scenario.

    Relative paths inside it are taken from the scenario's own folder first, then from the models that come along.

    Args:
        path: a YAML file, or the name of a scenario that comes along such as ``tabletop``.
        overrides: ``dotted.field=value`` each, the value being YAML, e.g. ``twin.filter.rate=400``; or a single one.

    Raises:
        ScenarioError: the file is missing or not YAML, or a field is unknown or of the wrong type; it names the field.
    """
    expect_path(path, "scenario", "a YAML file (or the name of a scenario that comes along)")
    file = find_scenario(path)
    if file.suffix.lower() in _OTHER_FILES:
        raise ScenarioError(str(path), f"{_OTHER_FILES[file.suffix.lower()]}; a scenario is YAML")
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ScenarioError(str(file), "not a text file; a scenario is YAML in UTF-8") from error
    except OSError as error:
        raise ScenarioError(str(file), f"cannot be read: {error.strerror}") from error
    data = _read(text, str(file))
    if data is None:
        logging.getLogger("twin_diagram").warning("%s is empty: every field is at its default", file)
        data = {}
    if not isinstance(data, dict):
        raise ScenarioError(str(file), f"a scenario is a mapping of fields, this is a {type(data).__name__}")
    return _anchored(override_scenario(parse_scenario(data), overrides), file.parent)


def override_scenario(scenario: Scenario, overrides: Iterable[str]) -> Scenario:
    """Return a copy with fields set anew, as in `load_scenario`."""
    check_scenario(scenario)
    overrides = [overrides] if isinstance(overrides, str) else list(overrides)
    if not overrides:
        return copy_scenario(scenario)
    # All of it as plain data, so that an override may reach into what no file named.
    data = _plain(scenario)
    for override in overrides:
        _override(data, override)
        data = dict(_task_spelled_out(data))
    return parse_scenario(data)


def find_scenario(path: str | Path) -> Path:
    """Return the scenario's file: `path` itself, or one that comes along, with or without ``.yaml``."""
    given = Path(os.path.expanduser(path))
    for candidate in (given, models_dir() / "scenarios" / given, models_dir() / "scenarios" / f"{given}.yaml"):
        # Not Path.is_file, which raises for names that no file can have.
        if os.path.isfile(candidate):
            return candidate.resolve()
    if str(path) and os.path.isdir(given):
        raise ScenarioError(str(path), "is a folder; a scenario is one YAML file")
    known = sorted(p.stem for p in (models_dir() / "scenarios").glob("*.yaml"))
    raise ScenarioError(str(path), f"no such scenario file; those that come along: {', '.join(known) or 'none'}")


def parse_scenario(data: Mapping[str, Any]) -> Scenario:
    """Return a scenario from plain YAML data.

    Raises:
        ScenarioError: a field is unknown, has the wrong type or an impossible value.
    """
    data = _task_spelled_out(data)
    _check(data, Scenario, "")
    scenario = _filled(data, Scenario, Scenario())
    if scenario.station not in STATIONS:
        raise ScenarioError("station", f"{scenario.station!r} is none of {', '.join(STATIONS)}")
    if scenario.seed < 0:
        raise ScenarioError("seed", f"{scenario.seed} is negative")
    if scenario.duration <= 0:
        raise ScenarioError("duration", f"{scenario.duration} s is not a length of time")
    return typing.cast(Scenario, scenario)


def _task_spelled_out(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return plain data whose task is a mapping: a list in its place is its steps."""
    twin = data.get("twin")
    if not isinstance(twin, Mapping) or not isinstance(twin.get("task"), list):
        return data
    return {**data, "twin": {**twin, "task": {"steps": twin["task"]}}}


def dump_scenario(scenario: Scenario) -> str:
    """Return the scenario as YAML, every field written out.

    Entries keep their order, which is that of the twin's ports.
    """
    return yaml.dump(
        _plain(scenario), Dumper=_Dumper, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120
    )


def save_scenario(scenario: Scenario, path: Path) -> None:
    """Write the scenario as YAML, whole or not at all."""
    check_scenario(scenario)
    atomic_file.write(path, dump_scenario(scenario))


def check_scenario(scenario: object) -> None:
    """Refuse what is no scenario; raises ArgumentError."""
    expect(scenario, Scenario, "scenario", "a Scenario (as load_scenario returns it)")


def copy_scenario(scenario: Scenario) -> Scenario:
    """Return a deep copy."""
    return copy.deepcopy(scenario)


def _read(text: str, field: str) -> Any:
    """Return plain data from YAML; `field` is named where it is none."""
    with contextlib.suppress(Exception):  # whatever it is, the other one says it in its own words
        return yaml.load(text, _FastLoader)
    try:
        return yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}" if mark else "it"
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "not readable"
        raise ScenarioError(field, f"{where} is not YAML: {problem}") from error
    except RecursionError as error:
        raise ScenarioError(field, "nested too deep") from error
    except (ValueError, OverflowError) as error:  # a date or a number that looks like one and is none
        raise ScenarioError(field, f"holds a value that cannot be read: {error}") from error


def _plain(value: Any) -> Any:
    """Return plain data of a scenario, also where it was made with NumPy's numbers."""
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _plain(sub) for key, sub in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(sub) for sub in value]
    return _plain(value.tolist()) if hasattr(value, "tolist") else value


def _override(data: dict[str, Any], override: str) -> None:
    expect(override, str, "override", "text (FIELD=VALUE, e.g. twin.filter.rate=400)")
    name, equals, text = override.partition("=")
    if not equals or not name:
        raise ScenarioError(_key(override), "an override reads FIELD=VALUE, e.g. twin.filter.rate=400")
    value = _read(text, name)
    here: Any = data
    *parents, last = name.split(".")
    for depth, parent in enumerate(parents):
        here = _entry(here, parent, parents[:depth])
    if isinstance(here, dict):
        here[last] = value
    else:
        _entry(here, last, parents)
        here[int(last)] = value


def _entry(holder: Any, key: str, parents: list[str]) -> Any:
    """Return what `key` names in a mapping or a list; where a mapping has nothing there, it gets an empty mapping."""
    if isinstance(holder, dict):
        if holder.get(key) is None:
            holder[key] = {}
        return holder[key]
    name = ".".join([*parents, key])
    if not isinstance(holder, list):
        raise ScenarioError(name, f"cannot be set: {'.'.join(parents)} holds {_shown(holder)}")
    if not (key.isascii() and key.isdigit() and int(key) < len(holder)):
        raise ScenarioError(name, f"{'.'.join(parents)} has {len(holder)} entries, numbered from 0")
    return holder[int(key)]


def _shown(value: Any) -> str:
    """Return a value in a message, on one line and not longer than it."""
    try:
        return _brief.repr(value)
    except ValueError:
        return "a number of thousands of digits"


def _check(value: Any, schema: Any, name: str, endless: bool = False) -> None:
    """Hold plain YAML data against a schema of dataclasses and raise with the dotted name of what does not fit."""
    origin, arguments = typing.get_origin(schema), typing.get_args(schema)
    shown = name or "scenario"
    if origin in (typing.Union, types.UnionType):
        if value is None:
            return
        schema = next(a for a in arguments if a is not type(None))
        _check(value, schema, name)
    elif dataclasses.is_dataclass(schema):
        if not isinstance(value, Mapping):
            raise ScenarioError(shown, f"expected fields, got {_shown(value)}")
        fields = {f.name: f for f in dataclasses.fields(schema)}
        for key, sub in value.items():
            dotted = f"{name}.{_key(key)}" if name else _key(key)
            if key not in fields:
                raise ScenarioError(dotted, f"unknown field; {nearest(str(key), fields)}")
            _check(sub, fields[key].type, dotted, ENDLESS in fields[key].metadata)
    elif origin is list:
        if not isinstance(value, list):
            raise ScenarioError(shown, f"expected a list, got {_shown(value)}")
        for index, sub in enumerate(value):
            _check(sub, arguments[0], f"{name}.{index}")
    elif origin is dict:
        if not isinstance(value, Mapping):
            raise ScenarioError(shown, f"expected named entries, got {_shown(value)}")
        for key, sub in value.items():
            if not isinstance(key, str):
                raise ScenarioError(f"{name}.{_key(key)}", "the name of an entry is text; put it in quotes")
            _check(sub, arguments[1], f"{name}.{_key(key)}", endless)
    elif schema is float:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not (abs(value) <= sys.float_info.max or (endless and abs(value) == math.inf)):
            raise ScenarioError(shown, f"expected a {'' if endless else 'finite '}number, got {_shown(value)}")
    elif schema is bool:
        if not isinstance(value, bool):
            raise ScenarioError(shown, f"expected true or false, got {_shown(value)}")
    elif schema is int:
        if isinstance(value, bool) or not isinstance(value, int) or abs(value) >= 2**63:
            raise ScenarioError(shown, f"expected a whole number, got {_shown(value)}")
    elif schema is str:
        if not isinstance(value, str):
            raise ScenarioError(shown, f"expected text, got {_shown(value)}")


def _filled(value: Any, schema: Any, default: Any) -> Any:
    """Return checked plain data as the schema's classes; what it does not name is as in `default`.

    As `pydrake.common.yaml.yaml_load_typed` does from text, whose parsing in Python took most of a scenario's loading.
    """
    origin, arguments = typing.get_origin(schema), typing.get_args(schema)
    if origin in (typing.Union, types.UnionType):
        return None if value is None else _filled(value, next(a for a in arguments if a is not type(None)), default)
    if dataclasses.is_dataclass(schema):
        made = copy.deepcopy(default) if isinstance(default, typing.cast(type, schema)) else typing.cast(type, schema)()
        fields = {f.name: f.type for f in dataclasses.fields(schema)}
        for key, sub in value.items():
            setattr(made, key, _filled(sub, fields[key], getattr(made, key)))
        return made
    if origin is list:
        return [_filled(sub, arguments[0], None) for sub in value]
    if origin is dict:
        known = dict(default or {})
        return known | {key: _filled(sub, arguments[1], known.get(key)) for key, sub in value.items()}
    return float(value) if schema is float else value


def _key(key: Any) -> str:
    """Return a key as it stands in a dotted name."""
    return key if isinstance(key, str) and key and key.isprintable() else _shown(key)


def _anchored(scenario: Scenario, folder: Path) -> Scenario:
    """Make relative paths that exist below the scenario's folder absolute: it may then be read anywhere."""

    def anchor(name: str) -> str:
        path = folder / name
        return str(path.resolve()) if name and not name.startswith("package://") and os.path.exists(path) else name

    def anchor_file(name: str) -> str:
        """Anchor what may also be said by a name or a number, which a folder of that name must not hide."""
        return anchor(name) if os.path.isfile(folder / name) else name

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
    scenario.replay.columns = anchor_file(scenario.replay.columns)
    scenario.replay.torque_constants = [anchor_file(constant) for constant in scenario.replay.torque_constants]
    if scenario.twin.learning is not None:
        scenario.twin.learning.gripper = anchor_file(scenario.twin.learning.gripper)
    return scenario
