"""The folder that gets what grows: refused before a run where it cannot be, and no loss of the run where it goes."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.assets.building.pictured import box, cameras, shots
from tests.small_loop import small_scenario
from twin_diagram.assets.building.growth import Growth, in_thing
from twin_diagram.assets.building.growth_file import free_name, read_growth, write_growth
from twin_diagram.errors import FramesError, ScenarioError
from twin_diagram.perception.things.growing import GrowingThing
from twin_diagram.runs.growth_watch import GrowthWatch
from twin_diagram.runs.run import run_scenario
from twin_diagram.runs.run_folder import RunFolder
from twin_diagram.scenario import Growing
from twin_diagram.scenario.validation import check_twin
from twin_diagram.twin.growing import Grower


def one_picture() -> Growth:
    (frame,) = shots([box((0.06, 0.05, 0.05))], cameras(1, 0.02, distance=0.42), masked=True).frames
    return Growth().with_frame(in_thing(frame, np.eye(3), np.zeros(3)))


def grower(library: Path, events: list[dict[str, Any]]) -> Grower:
    """A grower of a twin that has eyes and slots."""
    twin: Any = SimpleNamespace(added=SimpleNamespace(check=lambda: None, assets={}), library={})
    return Grower(twin, Growing(library=str(library)), events.append)


def test_a_library_that_is_a_file_is_refused_by_the_field_s_name(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(ScenarioError, match=r"twin\.growth\.library: .*file"):
            grower(place, [])


def test_what_ignores_unknown_things_grows_nothing() -> None:
    scenario = small_scenario("twin.slots.unknown=0", "twin.growth={}")
    with pytest.raises(ScenarioError, match=r"twin\.growth: .*twin\.slots\.unknown is 0"):
        check_twin(scenario.twin)


def test_a_run_into_a_folder_of_another_keeps_that_where_nothing_can_grow(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    out = tmp_path / "out"
    out.mkdir()
    (out / "summary.json").write_text("{}")
    (out / "events.jsonl").write_text("before")
    scenario = small_scenario()
    scenario.twin.growth = Growing(library=str(tmp_path / "file"))
    with pytest.raises(ScenarioError, match=r"twin\.growth\.library"):
        run_scenario(scenario, out=out, pictures=False, quiet=True, say=lambda text: None)
    assert (out / "events.jsonl").read_text() == "before"


def test_a_library_that_is_gone_at_the_end_is_told_and_breaks_no_run(tmp_path: Path) -> None:
    events: list[dict[str, Any]] = []
    library = tmp_path / "library"
    with grower(library, events) as watching:
        watching.growing[3] = GrowingThing(growth=one_picture())
        library.touch()
    (failed,) = events
    assert failed["event"] == "growth_failed" and failed["object"] == "unknown#3"
    assert "could not be written" in failed["why"] and str(library) in failed["why"]


def test_a_name_is_neither_in_use_nor_in_the_library(tmp_path: Path) -> None:
    assert free_name(tmp_path / "none", 2, {}) == "thing_2"
    (tmp_path / "thing_3").mkdir()
    assert free_name(tmp_path, 2, {"thing_2"}) == "thing_4"


def test_pictures_that_were_cut_off_are_no_pictures(tmp_path: Path) -> None:
    file = tmp_path / "pictures.npz"
    write_growth(file, one_picture())
    assert len(read_growth(file)) == 1
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(FramesError, match="no pictures of a thing"):
        read_growth(file)


def test_what_somebody_else_put_beside_what_grows_is_not_the_run_s(tmp_path: Path) -> None:
    (tmp_path / "grown" / "mine").mkdir(parents=True)
    (tmp_path / "grown" / "mine" / "asset.yaml").touch()
    scenario = small_scenario()
    scenario.twin.growth = Growing()
    twin: Any = SimpleNamespace(added=SimpleNamespace(check=lambda: None, assets={}), library={})
    leave = RunFolder(tmp_path)
    with GrowthWatch(scenario, twin, leave, lambda text: None) as watch:
        assert watch._grower is not None
        watch._grower.growing[1] = GrowingThing(growth=one_picture())
    assert (tmp_path / "grown" / "unknown_1.partial.npz").is_file()
    leave.clear()
    assert [path.name for path in (tmp_path / "grown").rglob("*")] == ["mine", "asset.yaml"]
