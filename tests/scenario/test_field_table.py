"""Every field of a scenario says what it means: in `twin-diagram fields`, and in `help`."""

from __future__ import annotations

import dataclasses
import pydoc
from typing import get_type_hints

import pytest

import twin_diagram.scenario as schema
from twin_diagram import cli
from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Filter, Scenario
from twin_diagram.scenario.field_table import rows, rows_at, table

SECTIONS = [c for c in (getattr(schema, name) for name in schema.__all__) if dataclasses.is_dataclass(c)]


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
def test_each_field_has_a_meaning_and_its_own_default(section: type) -> None:
    found = rows(section)
    assert [row.name for row in found] == [field.name for field in dataclasses.fields(section)]
    for row in found:
        assert row.meaning and row.meaning[-1] in ".]", f"{section.__name__}.{row.name}: {row.meaning!r}"
        assert row.kind and "twin_diagram" not in row.kind
        default = getattr(section(), row.name)
        shown = {"null": None, "true": True, "false": False, "…": default}.get(row.default, row.default)
        assert shown == default or row.default in (str(default), repr(default))


def test_help_shows_fields_with_unit_and_default() -> None:
    text = pydoc.plain(pydoc.render_doc(Filter))
    assert "rate: float = 200.0" in text and "[Hz]" in text
    for row in rows(Filter):
        assert f"{row.name}: {row.kind} = {row.default}" in text and row.meaning[:40] in text


def test_paths_lead_into_sections_lists_and_mappings() -> None:
    assert rows_at(Scenario, "") == rows(Scenario)
    assert rows_at(Scenario, "twin.filter") == rows(Filter)
    assert [row.name for row in rows_at(Scenario, "world.objects.X_WO")] == ["translation", "rpy"]
    assert [row.name for row in rows_at(Scenario, "twin.filter.sensors")] == list(get_type_hints(schema.SensorSpec))
    (rate,) = rows_at(Scenario, "twin.filter.rate")
    assert (rate.kind, rate.default) == ("float", "200.0")
    assert table([rate]).startswith("rate: float = 200.0\n    ")


@pytest.mark.parametrize(
    ("path", "said"),
    [("twin.filtre", "filter"), ("nothing", "world, twin"), ("duration.more", "duration has no fields")],
)
def test_paths_that_lead_nowhere_are_refused(path: str, said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        rows_at(Scenario, path)


def test_the_command_prints_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["fields", "twin.drift"]) == 0
    assert "horizon: float = 0.1\n    Length of a rollout [s]." in capsys.readouterr().out
    assert cli.main(["fields", "twin.drfit"]) == 2
    assert "twin.drfit" in capsys.readouterr().err
