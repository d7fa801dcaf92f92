"""Scenario files: what loads, what is refused, and that every refusal names its field in one line."""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_diagram import scenario as schema
from twin_diagram.errors import ScenarioError, TwinError
from twin_diagram.runtime import atomic_file
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import (
    copy_scenario,
    dump_scenario,
    find_scenario,
    load_scenario,
    override_scenario,
    parse_scenario,
    save_scenario,
)
from twin_diagram.scenario.resources import models_dir
from twin_diagram.scenario.validation import NOT_NEGATIVE, POSITIVE, SHARE, check_twin
from twin_diagram.twin.closed_loop import make_closed_loop
from twin_diagram.twin.twin import make_twin

Path_ = tuple[str | int, ...]
WRONG: dict[Any, tuple[Any, ...]] = {
    float: ("text", True, None, [1.0], {"a": 1}, float("nan"), float("inf"), 10**400),
    int: ("text", 1.5, True, None, [1], {"a": 1}),
    str: (1, 1.5, False, None, ["a"], {"a": "b"}),
    bool: (1, 0, "yes please", None, [True], {"a": True}),
    list: (1, "text", None, {"a": 1}),
    dict: (1, "text", None, ["a"], {1: "a"}),
    "fields": (1, "text", None, ["a"], {1: "a"}),
}


def one_of_everything() -> dict[str, Any]:
    """Plain data that sets every field of the schema to something that is not its default."""

    def make(kind: Any, name: str) -> Any:
        origin, arguments = typing.get_origin(kind), typing.get_args(kind)
        if origin in (typing.Union, types.UnionType):
            return make(next(a for a in arguments if a is not type(None)), name)
        if dataclasses.is_dataclass(kind):
            return {f.name: make(f.type, f.name) for f in dataclasses.fields(kind)}
        if origin is list:
            return [make(arguments[0], name), make(arguments[0], name)]
        if origin is dict:
            return {"first": make(arguments[1], name), "second": make(arguments[1], name)}
        return {float: 0.375, int: 7, str: f"a {name}", bool: True}[kind]

    data = make(Scenario, "")
    data["station"] = "lcm"
    return typing.cast(dict[str, Any], data)


OPTIONAL: set[Path_] = set()
"""Where there may be nothing."""


def walk(kind: Any, at: Path_ = ()) -> Iterator[tuple[Path_, Any]]:
    """Every field of the schema and every kind of entry, as paths into `one_of_everything`."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        (kind,) = (a for a in arguments if a is not type(None))
        yield from walk(kind, at)
        OPTIONAL.add(at)
        return
    if at:
        yield at, origin or ("fields" if dataclasses.is_dataclass(kind) else kind)
    if dataclasses.is_dataclass(kind):
        for field in dataclasses.fields(kind):
            yield from walk(field.type, (*at, field.name))
    elif origin is list:
        yield from walk(arguments[0], (*at, 1))
    elif origin is dict:
        yield from walk(arguments[1], (*at, "second"))


PLACES = list(walk(Scenario))


def place(data: Any, path: Path_) -> Any:
    for key in path:
        data = data[key]
    return data


def dotted(path: Path_) -> str:
    return ".".join(map(str, path))


# What loads.


def test_nothing_at_all_is_a_scenario_of_defaults() -> None:
    assert parse_scenario({}) == Scenario()


def test_an_empty_file_loads_and_is_told_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = tmp_path / "empty.yaml"
    file.write_text("# nothing\n")
    assert load_scenario(file) == Scenario()
    assert "empty.yaml is empty" in caplog.text


def test_a_folder_is_no_scenario(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="is a folder"):
        load_scenario(tmp_path)


@pytest.mark.parametrize(
    ("name", "command"), [("log.csv", "replay"), ("run.MCAP", "replay"), ("arm.urdf", "init --arm")]
)
def test_what_is_no_scenario_is_told_what_takes_it(tmp_path: Path, name: str, command: str) -> None:
    (tmp_path / name).write_bytes(b"\x89\xff")
    with pytest.raises(ScenarioError, match=f"`twin-diagram {command}`"):
        load_scenario(tmp_path / name)


def test_defaults_written_out_load_again() -> None:
    assert parse_scenario(yaml.safe_load(dump_scenario(Scenario()))) == Scenario()


def test_one_of_everything_is_told_apart_from_the_defaults() -> None:
    """That the walk reaches every field is what the refusals below stand on."""
    data = one_of_everything()
    scenario = parse_scenario(data)
    plain = dataclasses.asdict(Scenario(station="lcm"))
    assert dataclasses.asdict(scenario) == data
    for path, kind in PLACES:
        if kind in (int, float, str, list, dict) and path[-1] not in ("station", 1, "second"):
            try:
                default = place(plain, path)
            except (KeyError, IndexError, TypeError):
                continue  # an entry that the defaults do not have
            assert place(data, path) != default, dotted(path)


def test_one_of_everything_round_trips(tmp_path: Path) -> None:
    scenario = parse_scenario(one_of_everything())
    file = tmp_path / "all.yaml"
    atomic_file.write(file, dump_scenario(scenario))
    assert load_scenario(file) == scenario
    assert [p.name for p in tmp_path.iterdir()] == ["all.yaml"]


@pytest.mark.parametrize("name", sorted(p.stem for p in (models_dir() / "scenarios").glob("*.yaml")))
def test_each_scenario_that_comes_along_round_trips_and_can_be_true(name: str, tmp_path: Path) -> None:
    scenario = load_scenario(name)
    check_twin(scenario.twin)
    file = tmp_path / "again.yaml"
    atomic_file.write(file, dump_scenario(scenario))
    assert load_scenario(file) == scenario


def test_a_copy_shares_nothing() -> None:
    scenario = load_scenario("tabletop")
    other = copy_scenario(scenario)
    other.world.objects["can"].X_WO.translation[0] = 9.0
    other.twin.library["can"] = "elsewhere"
    assert scenario == load_scenario("tabletop")


def test_paths_are_taken_from_the_scenarios_own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "arm.urdf").write_text("<robot name='r'/>")
    file = tmp_path / "mine" / "s.yaml"
    file.write_text("twin: {arm: {model: arm.urdf}, library: {can: objects/can}}\n")
    monkeypatch.chdir("/")
    twin = load_scenario(file).twin
    assert twin.arm.model == str(tmp_path / "mine" / "arm.urdf")
    assert twin.library == {"can": "objects/can"}


def test_files_of_gripper_and_motors_are_taken_from_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("hand.yaml", "motors.yaml"):
        (tmp_path / name).write_text("[]")
    (tmp_path / "wsg50").mkdir()  # of a gripper that comes along; a folder is none
    file = tmp_path / "s.yaml"
    file.write_text("twin: {learning: {gripper: hand.yaml}}\nreplay: {torque_constants: [motors.yaml]}\n")
    monkeypatch.chdir("/")
    scenario = load_scenario(file)
    assert scenario.twin.learning is not None and scenario.twin.learning.gripper == str(tmp_path / "hand.yaml")
    assert scenario.replay.torque_constants == [str(tmp_path / "motors.yaml")]
    other = load_scenario(file, ["twin.learning.gripper=wsg50", "replay.torque_constants=[a=1, b=2]"])
    assert other.twin.learning is not None and other.twin.learning.gripper == "wsg50"
    assert other.replay.torque_constants == ["a=1", "b=2"]


def test_an_effect_may_have_come_after_the_end_of_another_log(tmp_path: Path) -> None:
    load = {"name": "payload", "parameters": {"mass": [1.0], "com": [0.0, 0.0, 0.1]}, "onset": 1.0, "log": "a"}
    scenario = parse_scenario({"twin": {"arm": {"effects": [{**load, "elsewhere": {"b": math.inf, "c": -math.inf}}]}}})
    check_twin(scenario.twin)
    save_scenario(scenario, tmp_path / "s.yaml")
    assert load_scenario(tmp_path / "s.yaml") == scenario
    with pytest.raises(ScenarioError, match=r"effects\.0\.elsewhere\.b: expected a number, got nan"):
        parse_scenario({"twin": {"arm": {"effects": [{**load, "elsewhere": {"b": math.nan}}]}}})
    with pytest.raises(ScenarioError, match=r"effects\.0\.onset: expected a finite number, got inf"):
        parse_scenario({"twin": {"arm": {"effects": [{**load, "onset": math.inf}]}}})


@pytest.mark.parametrize("text", ["1e-3", "1.0e-3", "1.e-3", "0.001", "+1e-3", ".1e-2"])
def test_exponents_are_numbers(tmp_path: Path, text: str) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(f"twin: {{filter: {{encoder_std: {text}}}}}\n")
    assert load_scenario(file).twin.filter.encoder_std == pytest.approx(1e-3)
    assert load_scenario("tabletop", [f"twin.filter.encoder_std={text}"]).twin.filter.encoder_std == pytest.approx(1e-3)


def test_floats_are_kept_to_the_bit() -> None:
    scenario = Scenario()
    values = [0.1, 1 / 3, 1e-300, 5e-324, 1.7976931348623157e308, -0.0, 123456789.123456789]
    scenario.world.q0 = values
    again = parse_scenario(yaml.safe_load(dump_scenario(scenario))).world.q0
    assert [v.hex() for v in again] == [v.hex() for v in values]


def test_objects_keep_their_order() -> None:
    """The order of the library is that of the twin's ports: a recording must not change it."""
    scenario = load_scenario("tabletop")
    assert list(scenario.twin.library) != sorted(scenario.twin.library)
    for again in (
        parse_scenario(yaml.safe_load(dump_scenario(scenario))),
        load_scenario("tabletop", ["duration=3"]),
        override_scenario(scenario, ["seed=2"]),
    ):
        assert list(again.twin.library) == list(scenario.twin.library)
        assert list(again.world.objects) == list(scenario.world.objects)


def test_a_scenario_made_with_numpy_is_written_too() -> None:
    scenario = Scenario(duration=2, seed=typing.cast(int, np.int64(3)))
    scenario.twin.home = typing.cast(list[float], np.array([0.1, 0.2]))
    scenario.twin.arm.effects = [schema.EffectSpec("payload", [], [], {"mass": [np.float64(1.5)]})]
    again = parse_scenario(yaml.safe_load(dump_scenario(scenario)))
    assert (again.seed, again.duration, again.twin.home) == (3, 2.0, [0.1, 0.2])
    assert again.twin.arm.effects[0].parameters == {"mass": [1.5]}


@pytest.mark.parametrize(
    "text",
    ["1e5", "-.5E3", "yes", "null", "~", "1", "0x1f", "2020-01-01", "a: b", "- a", "é\n2", " ", "#", "1:30", "=", "!x"],
)
def test_text_stays_text_whatever_it_looks_like(text: str, tmp_path: Path) -> None:
    scenario = Scenario(packages={text: text})
    scenario.twin.camera = None
    scenario.twin.arm.joints = [text]
    atomic_file.write(tmp_path / "s.yaml", dump_scenario(scenario))
    assert load_scenario(tmp_path / "s.yaml") == scenario


# Overrides.


def test_overrides() -> None:
    scenario = load_scenario(
        "tabletop",
        [
            "seed=3",
            "duration=2.5",
            "twin.filter.rate=4e2",
            "twin.home.1=0.25",
            "world.arm.effects.0.parameters.mass=[1.25]",
            "world.arm.effects.0.parameters.com.2=0.2",
            "world.objects.mover.path.1.X_WO.translation.0=0.5",
            "world.objects.can.asset=objects/bottle",
            "twin.camera=null",
            "twin.perception={stride: 3}",
            "packages.mine=/there",
        ],
    )
    assert (scenario.seed, scenario.duration, scenario.twin.filter.rate) == (3, 2.5, 400.0)
    assert scenario.twin.home[1] == 0.25
    payload = scenario.world.arm.effects[0]
    assert (payload.parameters["mass"], payload.parameters["com"][2]) == ([1.25], 0.2)
    assert scenario.world.objects["mover"].path[1].X_WO.translation[0] == 0.5
    assert scenario.world.objects["can"].asset == "objects/bottle"
    assert scenario.twin.camera is None
    assert scenario.twin.perception.stride == 3
    assert scenario.twin.perception.smallest == load_scenario("tabletop").twin.perception.smallest
    assert scenario.packages == {"mine": "/there"}


def test_overrides_of_a_scenario_in_hand_reach_fields_that_no_file_named() -> None:
    scenario = override_scenario(
        Scenario(), ["twin.perception.workspace.0.2=-0.5", "twin.filter.parameters.0=torque_bias"]
    )
    assert scenario.twin.perception.workspace[0][2] == -0.5
    assert scenario.twin.filter.parameters == ["torque_bias"]
    assert override_scenario(Scenario(), []) == Scenario()


def test_overrides_of_lists_that_the_file_leaves_at_their_defaults() -> None:
    scenario = load_scenario("tabletop", ["twin.perception.workspace.1.0=0.9"])
    assert scenario.twin.perception.workspace == [[0.1, -0.6, -0.02], [0.9, 0.6, 0.6]]


@pytest.mark.parametrize(
    ("override", "field"),
    [
        ("nonsense", "nonsense"),
        ("=3", "=3"),
        ("twin.filter.rte=3", "twin.filter.rte"),
        ("twin.filter.rate=fast", "twin.filter.rate"),
        ("twin.filter.rate=[1", "twin.filter.rate"),
        ("twin.filter.rate.x=1", "twin.filter.rate"),
        ("twin.home.9=1", "twin.home.9"),
        ("twin.home.-1=1", "twin.home.-1"),
        ("twin.home.first=1", "twin.home.first"),
        ("twin.home.0.x=1", "twin.home.0"),
        ("world.objects.can.colour=red", "world.objects.can.colour"),
        ("world.arm.effects.7.name=payload", "world.arm.effects.7"),
        ("seed=-1", "seed"),
        ("seed=1.5", "seed"),
        ("duration=0", "duration"),
        ("duration=-1", "duration"),
        ("duration=.inf", "duration"),
        ("duration=.nan", "duration"),
        ("station=mars", "station"),
        (".=1", "''"),
        ("twin..rate=1", "twin.''"),
        ("twin.filter.rate=2001-99-99", "twin.filter.rate"),
    ],
)  # fmt: skip
def test_bad_overrides_name_their_field(override: str, field: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario("tabletop", [override])
    assert caught.value.field.startswith(field)
    assert str(caught.value).startswith(caught.value.field)
    assert "\n" not in str(caught.value)


# What is refused: wrong types and unknown fields, anywhere in the schema.


def test_the_walk_reaches_every_dataclass() -> None:
    classes = {c for c in (getattr(schema, name) for name in schema.__all__) if dataclasses.is_dataclass(c)}
    assert len(classes) >= 20
    names = {dotted(path) for path, _ in PLACES}
    for cls in classes - {Scenario}:
        for field in dataclasses.fields(cls):
            assert any(name.split(".")[-1] == field.name for name in names), f"{cls.__name__}.{field.name}"


@pytest.mark.parametrize(("path", "kind"), PLACES, ids=[dotted(path) for path, _ in PLACES])
def test_wrong_types_are_refused_by_field(path: Path_, kind: Any) -> None:
    for wrong in WRONG[kind]:
        if (wrong is None and path in OPTIONAL) or (wrong == math.inf and "elsewhere" in path):
            continue
        data = one_of_everything()
        place(data, path[:-1])[path[-1]] = wrong
        with pytest.raises(ScenarioError) as caught:
            parse_scenario(data)
        assert caught.value.field.startswith(dotted(path)), wrong
        assert str(caught.value).startswith(dotted(path))
        assert "\n" not in str(caught.value)


HOLDERS = [(), *[path for path, kind in PLACES if kind == "fields"]]


@pytest.mark.parametrize("path", HOLDERS, ids=[dotted(path) or "scenario" for path in HOLDERS])
def test_unknown_fields_are_refused_with_a_suggestion(path: Path_) -> None:
    known = list(place(one_of_everything(), path))
    for name in known:
        data = one_of_everything()
        typo = name[:-1] + "_" + name[-1]
        place(data, path)[typo] = place(data, path).pop(name)
        with pytest.raises(ScenarioError) as caught:
            parse_scenario(data)
        assert caught.value.field == dotted((*path, typo))
        assert f"did you mean {difflib.get_close_matches(typo, known, n=1)[0]!r}" in str(caught.value)
    data = one_of_everything()
    place(data, path)["zzqx"] = 1
    with pytest.raises(ScenarioError, match=r"zzqx: unknown field; it is one of ") as caught:
        parse_scenario(data)
    assert all(name in str(caught.value) for name in known)


def test_wrong_types_are_refused_in_files_too(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    for text, field in (
        ("twin: {camera: {rate: fast}}", "twin.camera.rate"),
        ("twin: {camera: {rate: 2020-01-01}}", "twin.camera.rate"),
        ("twin: {camera: {rate: !!binary aGk=}}", "twin.camera.rate"),
        ("twin: {home: !!set {a, b}}", "twin.home"),
        ("twin: {library: {1: objects/can}}", "twin.library.1"),
        ("twin: {library: {can: no}}", "twin.library.can"),
        ("world: &w {objects: {a: *w}}", "world.objects.a.objects"),
        ("twin: &t [*t]", "twin"),
        ("[1, 2]", str(file)),
        ("just words", str(file)),
        ("5", str(file)),
    ):
        file.write_text(text)
        with pytest.raises(ScenarioError) as caught:
            load_scenario(file)
        assert caught.value.field == field, text
        assert "\n" not in str(caught.value)


# Files that cannot be read.


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    for name in (
        str(tmp_path / "none.yaml"),
        "nonesuch",
        "",
        "~nosuchuser/s.yaml",
        "a" * 5000,
        "nul\0byte",
    ):
        with pytest.raises(ScenarioError) as caught:
            load_scenario(name)
        assert "no such scenario file" in str(caught.value)
        assert "tabletop" in str(caught.value)
        assert name in str(caught.value)


def test_a_scenario_that_comes_along_is_found_by_name() -> None:
    assert find_scenario("tabletop") == find_scenario("tabletop.yaml") == models_dir() / "scenarios" / "tabletop.yaml"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("seed: 1\nduration: [1, 2\nstation: sim\n", 3),
        ("seed: 1\n\tduration: 2\n", 2),
        ("a: b: c\n", 1),
        ("seed: 1\nduration: 'open\n", 3),
        ("? [1]\n: 2\n{", 3),
        ("seed: *unknown\n", 1),
        ("seed: !!python/object:os.system x\n", 1),
        ("twin:\n  home: [1.0]\nseed: 1\ntwin:\n  filter: {rate: 100}\n", 4),
        ("twin:\n  filter: {rate: 100,\n    rate: 200}\n", 3),
    ],
)
def test_broken_yaml_names_file_and_line(tmp_path: Path, text: str, line: int) -> None:
    file = tmp_path / "broken.yaml"
    file.write_text(text)
    with pytest.raises(ScenarioError, match=rf"line {line} is not YAML") as caught:
        load_scenario(file)
    assert caught.value.field == str(file)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [
        b"\xff\xfe\x00\x01",
        b"seed: \x80\n",
        b"seed: \x00\n",
        b"[" * 20000,
        b"{a: " * 20000,
        b"seed: 2001-99-99\n",
        b"seed: 0b_\n",
        b"seed: " + b"9" * 6000 + b"\n",
        b"seed: 1\n---\nseed: 2\n",
    ],
    ids=["utf-16", "latin-1", "nul", "deep list", "deep map", "date", "binary", "digits", "two documents"],
)
def test_files_that_hold_anything_else(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "odd.yaml"
    file.write_bytes(content)
    with pytest.raises(ScenarioError) as caught:
        load_scenario(file)
    assert "\n" not in str(caught.value)


# Hypothesis: nothing that looks like YAML raises anything but a TwinError.

FIELD_NAMES = sorted({str(key) for path, _ in PLACES for key in path})
KEYS = st.one_of(st.sampled_from(FIELD_NAMES), st.text(max_size=5), st.integers(), st.booleans(), st.none())
LEAVES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=12), st.dates(), st.binary(max_size=3)
)
DATA = st.recursive(
    LEAVES, lambda sub: st.lists(sub, max_size=3) | st.dictionaries(KEYS, sub, max_size=4), max_leaves=25
)


@given(st.dictionaries(KEYS, DATA, max_size=4))
def test_arbitrary_data_raises_twin_errors_alone(data: dict[Any, Any]) -> None:
    try:
        scenario = parse_scenario(data)
        check_twin(scenario.twin)
    except TwinError as error:
        assert "\n" not in str(error)
    else:
        assert parse_scenario(yaml.safe_load(dump_scenario(scenario))) == scenario


@given(st.sampled_from(PLACES), DATA)
def test_arbitrary_values_anywhere_raise_twin_errors_alone(chosen: tuple[Path_, Any], value: Any) -> None:
    data = one_of_everything()
    place(data, chosen[0][:-1])[chosen[0][-1]] = value
    try:
        scenario = parse_scenario(data)
        check_twin(scenario.twin)
    except ScenarioError as error:
        assert "\n" not in str(error)


@settings(max_examples=25)
@given(st.text(max_size=40))
def test_arbitrary_text_as_an_override(text: str) -> None:
    for override in (text, f"twin.filter.rate={text}", f"{text}=1", f"twin.{text}=1"):
        try:
            override_scenario(Scenario(), [override])
        except TwinError as error:
            assert "\n" not in str(error)


@given(st.binary(max_size=80))
def test_arbitrary_bytes_as_a_file(content: bytes) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "s.yaml"
        file.write_bytes(content)
        try:
            load_scenario(file)
        except TwinError as error:
            assert "\n" not in str(error)


# What a scenario names must exist and fit: found when the twin is built, said with the field.


def test_every_number_of_the_twin_is_bounded() -> None:
    """A new field gets its bound in `scenario.validation`, or is named here as one that may be anything."""
    free = {
        "table_height",
        "translation",
        "rpy",
        "home",
        "depth_range",
        "workspace",
        "stiffness",
        "damping",
        "parameters",
    }
    rules = (*POSITIVE.items(), *NOT_NEGATIVE.items(), *SHARE.items())
    bounded = {(cls, name) for cls, names in rules for name in names}
    for cls, name in bounded:
        assert name in {f.name for f in dataclasses.fields(cls)}
    for cls in {type(x) for x in [*_parts(one_of_everything_typed().twin)]}:
        for field in dataclasses.fields(cls):
            if field.type in (int, float) and field.name not in free:
                assert (cls, field.name) in bounded, f"{cls.__name__}.{field.name}"


def one_of_everything_typed() -> Scenario:
    return parse_scenario(one_of_everything())


def _parts(value: Any) -> Iterator[Any]:
    if dataclasses.is_dataclass(value):
        yield value
        for field in dataclasses.fields(value):
            yield from _parts(getattr(value, field.name))
    elif isinstance(value, (list, dict)):
        for sub in value.values() if isinstance(value, dict) else value:
            yield from _parts(sub)


TWIN_CASES = {
    "twin.arm.joints=[panda_joint1, elbow]": ("twin.arm.joints", "'elbow'", "panda_joint7"),
    "twin.arm.joints=[panda_joint1, panda_joint1]": ("twin.arm.joints", "twice"),
    "twin.arm.gripper_joints=[thumb]": ("twin.arm.gripper_joints", "'thumb'"),
    "twin.arm.tool_frame=toolx": ("twin.arm.tool_frame", "'toolx'", "panda_tcp"),
    "twin.arm.model=arms/nope.urdf": ("twin.arm.model", "arms/nope.urdf", "no such file"),
    "twin.arm.model=''": ("twin.arm.model",),
    "twin.arm.model=package://mine/x.urdf": ("twin.arm.model", "'mine'", "packages"),
    "twin.arm.model=scenes/table.sdf": ("twin.arm.model", "table.sdf", "joint"),
    "twin.arm.model=scenarios/tabletop.yaml": ("twin.arm.model", "tabletop.yaml"),
    "twin.arm.effects.0.name=stiction": ("twin.arm.effects", "'stiction'", "coulomb_friction"),
    "twin.arm.effects.0.joints.2=elbow": ("twin.arm.effects.coulomb_friction.joints", "'elbow'"),
    "twin.arm.effects.0.parameters.torque=[1.0]": ("twin.arm.effects.coulomb_friction.torque", "7", "1"),
    "twin.arm.effects.0.parameters={damping: [1, 1, 1, 1, 1, 1, 1]}": ("twin.arm.effects.coulomb_friction", "damping"),
    "twin.arm.X_WB.translation=[0, 0]": ("twin.arm.X_WB.translation", "[0.0, 0.0]"),
    "twin.home=[0.1, 0.2]": ("twin.home", "2", "7"),
    "twin.fixtures.0.model=scenes/nope.sdf": ("twin.fixtures.0.model", "scenes/nope.sdf"),
    "twin.fixtures.0.X_WB.rpy=[1]": ("twin.fixtures.0.X_WB.rpy", "[1.0]"),
    "twin.library.can=objects/nope": ("twin.library.can", "objects/nope"),
    "twin.library.can=scenes/table.sdf": ("twin.library.can", "asset.yaml"),
    "twin.library.can=scenes": ("twin.library.can", "asset.yaml"),
    "twin.camera.rate=0": ("twin.camera.rate", "0.0"),
    "twin.camera.depth_range=[3, 1]": ("twin.camera.depth_range", "[3.0, 1.0]"),
    "twin.camera.X_WC.rpy=[1, 2, 3, 4]": ("twin.camera.X_WC.rpy",),
    "twin.cameras={my cam: {role: perception}}": ("twin.cameras.my cam: 'my cam'", "letters"),
    "twin.camera.X_WC.rpy=[-130, 0, 90]": ("twin.camera.X_WC.rpy", "-130", "degrees"),
    "twin.camera.X_WC.translation=[1400, 0, 850]": ("twin.camera.X_WC.translation", "1400", "millimetres"),
    "twin.filter.rate=-5": ("twin.filter.rate", "-5.0"),
    "twin.filter.parameters=[magic]": ("twin.filter.parameters", "'magic'", "payload"),
    "twin.perception.stride=0": ("twin.perception.stride", "0"),
    "twin.perception.workspace=[[1, 2]]": ("twin.perception.workspace",),
    "twin.registration.colour_weight=1.5": ("twin.registration.colour_weight", "1.5"),
    "twin.planner.knots=1": ("twin.planner.knots", "1"),
    "twin.task.X_WG.translation=[]": ("twin.task.X_WG.translation", "[]"),
    "twin.task.start=-1": ("twin.task.start", "-1.0"),
}


@pytest.mark.parametrize("override", TWIN_CASES)
def test_what_the_twin_is_told_must_exist_and_fit(override: str) -> None:
    field, *words = TWIN_CASES[override]
    scenario = load_scenario("tabletop", [override])
    # The fewer the assets that load before the mistake is found, the faster this test.
    scenario.twin.library = {name: path for name, path in scenario.twin.library.items() if name == "can"}
    _raises(lambda: make_twin(scenario.twin, scenario.packages), field, words)


def _raises(make: Any, field: str, words: list[str]) -> None:
    with pytest.raises(TwinError) as caught:
        make()
    message = str(caught.value)
    assert message.startswith(field), message
    assert all(word in message for word in words), message
    assert "\n" not in message
    assert len(message) < 1500


WORLD_CASES = {
    "world.arm.model=arms/nope.urdf": ("world.arm.model", "arms/nope.urdf"),
    "world.arm.joints=[elbow]": ("world.arm.joints", "'elbow'"),
    "world.fixtures.0.model=scenes/nope.sdf": ("world.fixtures[0].model", "scenes/nope.sdf"),
    "world.objects.can.asset=objects/nope": ("world.objects.can.asset", "objects/nope"),
    "world.q0=[1, 2]": ("world.q0", "2", "7"),
}


@pytest.mark.parametrize("override", WORLD_CASES)
def test_what_the_world_is_made_of_must_exist_and_fit(override: str) -> None:
    field, *words = WORLD_CASES[override]
    scenario = load_scenario("tabletop", [override, "twin.library={}", "twin.camera=null"])
    _raises(lambda: make_closed_loop(scenario), field, words)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["station=replay"], ["replay.log"]),
        (["station=replay", "replay.log=/no/where.csv"], ["replay.log", "/no/where.csv"]),
        (["station=lcm", "lcm.arm=scara"], ["lcm.arm", "scara"]),
    ],
)
def test_what_a_station_needs_must_exist_and_fit(overrides: list[str], words: list[str]) -> None:
    scenario = load_scenario("tabletop", [*overrides, "twin.library={}", "twin.camera=null"])
    _raises(lambda: make_closed_loop(scenario), words[0], words[1:])


def test_an_object_without_a_name_is_refused() -> None:
    scenario = Scenario()
    scenario.twin.library = {" ": "objects/can"}
    with pytest.raises(ScenarioError, match=r"twin\.library: an object has an empty name"):
        check_twin(scenario.twin)


def test_a_single_override_needs_no_list() -> None:
    assert load_scenario("tabletop", "duration=2.5").duration == 2.5
