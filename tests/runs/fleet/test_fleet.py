"""Fleets: a table of robots in, one line each out, whatever becomes of the others."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import pytest

from twin_diagram.cli import main
from twin_diagram.errors import TwinError
from twin_diagram.runs.fleet import fleet, work
from twin_diagram.runs.fleet.page import first_days, page
from twin_diagram.runs.fleet.robots import read_fleet
from twin_diagram.runs.fleet.work import VisitResult
from twin_diagram.runtime.stopping import Stopped, stoppable

HEADER = "robot,date,model,fit,holdout\n"
ANSWER = {
    "verdict": "named",
    "remainder": True,
    "effects": [{"name": "payload", "joints": [], "links": ["tool"]}],
    "gap": {"torque_rms": {"holdout": {"before": {"a": 2.0, "b": 4.0}, "after": {"a": 1.0, "b": 1.0}}}},
}


@pytest.fixture
def three(tmp_path: Path) -> Path:
    """A table of three robots."""
    path = tmp_path / "fleet.csv"
    path.write_text(HEADER + "".join(f"r{k},2026-01-0{k},m{k}.urdf,a.csv;b.csv,c.csv\n" for k in (1, 2, 3)))
    for name in ("a.csv", "b.csv", "c.csv"):
        (tmp_path / name).write_text("time\n")
    return path


@pytest.fixture
def stood_in(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """`gap` that knows m1, fails on m2 and hangs on m3; which models it was asked about."""
    asked: list[str] = []

    def run(command: list[str], timeout: float) -> tuple[int, str, str]:
        model, out = (Path(command[command.index(name) + 1]) for name in ("--model", "--out"))
        asked.append(model.name)
        assert [Path(command[k + 1]).name for k, part in enumerate(command) if part == "--fit"] == ["a.csv", "b.csv"]
        if model.name == "m2.urdf":
            return 2, "", "error: m2.urdf: no such file or folder"
        if model.name == "m3.urdf":
            raise subprocess.TimeoutExpired(command, timeout)
        (out / "gap.json").write_text(json.dumps(ANSWER))
        return 0, "payload 2.0 kg; little left", ""

    monkeypatch.setattr(work, "_run", run)
    return asked


def test_a_bad_or_hanging_robot_costs_its_own_line(three: Path, stood_in: list[str], tmp_path: Path) -> None:
    lines = fleet.run_fleet(three, tmp_path / "out", jobs=2, timeout=7.0)
    assert [line.verdict for line in lines] == ["named with remainder", "failed", "timeout"]
    assert lines[0].left == pytest.approx(0.375) and lines[0].effects == ["payload tool"]
    assert lines[1].headline == "error: m2.urdf: no such file or folder" and lines[2].headline == "stopped after 7 s"
    with (tmp_path / "out" / "fleet.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["robot"] for row in rows] == ["r1", "r2", "r3"] and rows[0]["headline"] == "payload 2.0 kg; little left"
    assert "payload" in (tmp_path / "out" / "fleet.html").read_text()


def test_a_second_call_in_one_folder_waits_for_the_first(
    three: Path,
    stood_in: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Both would run all robots, and write into one another's folders."""
    second: list[tuple[int, str]] = []

    def say(text: str) -> None:
        second.append((main(["gap", "--fleet", str(three), "--out", str(tmp_path / "out")]), capsys.readouterr().err))

    fleet.run_fleet(three, tmp_path / "out", say=say)
    assert len(stood_in) == len(second) == 3
    assert all(status == 2 and err.count("\n") == 1 and "another fleet is at work" in err for status, err in second)
    assert main(["gap", "--fleet", str(three), "--out", str(tmp_path / "out")]) == 0


def test_it_goes_on_where_it_stopped(three: Path, stood_in: list[str], tmp_path: Path) -> None:
    for _ in range(2):
        fleet.run_fleet(three, tmp_path / "out")
    assert stood_in == ["m1.urdf", "m2.urdf", "m3.urdf", "m2.urdf", "m3.urdf"]
    (tmp_path / "a.csv").write_text("time,more\n")
    assert fleet.run_fleet(three, tmp_path / "out")[0].verdict == "named with remainder"
    assert stood_in[5:] == ["m1.urdf", "m2.urdf", "m3.urdf"]


def test_other_options_are_another_question(three: Path, stood_in: list[str], tmp_path: Path) -> None:
    for name in ("map.yaml", "own.py"):
        (tmp_path / name).write_text("# 1")
    told = ("--torque-side", "link", "--columns", str(tmp_path / "map.yaml"), "--import", str(tmp_path / "own.py"))

    def asks(*options: str) -> bool:
        stood_in.clear()
        fleet.run_fleet(three, tmp_path / "out", options=options)
        return "m1.urdf" in stood_in

    assert asks() and asks(*told) and not asks(*told) and asks("--torque-side", "motor", *told[2:])
    for name in ("map.yaml", "own.py"):
        asks(*told)
        before = (tmp_path / name).stat()
        (tmp_path / name).write_text("# 2")
        os.utime(tmp_path / name, ns=(before.st_atime_ns, before.st_mtime_ns))
        assert asks(*told) and not asks(*told), "contents count"
    assert (
        asks(*told, "--packages", "a=b") and asks(*told, "--packages", "a=c") and not asks(*told, "--packages", "a=c")
    )


def test_what_hangs_is_ended() -> None:
    begin = time.monotonic()
    with pytest.raises(subprocess.TimeoutExpired):
        work._run([sys.executable, "-c", "import time; time.sleep(60)"], 0.5)
    assert time.monotonic() - begin < 30.0
    assert work._run([sys.executable, "-c", "print('so'); print('more')"], 60.0) == (0, "so", "ended without a word")
    assert work._run([sys.executable, "-c", "import sys; sys.exit('why')"], 60.0) == (1, "", "why")


def test_a_robot_may_take_as_long_as_it_likes(three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "COMMAND", (sys.executable, "-c", "import sys; sys.exit('why')"))
    lines = fleet.run_fleet(three, tmp_path / "out", timeout=float("inf"))
    assert [line.headline for line in lines] == ["gap ended with status 1: why"] * 3


def test_what_is_killed_is_said_to_be(three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where memory is short; what it was at is no reason."""
    dies = "import os, sys; print('searching for a name', file=sys.stderr, flush=True); os.kill(os.getpid(), 9)"
    monkeypatch.setattr(work, "COMMAND", (sys.executable, "-c", dies))
    visit = read_fleet(three)[0]
    line = work.work(visit, tmp_path / "out", (), 60.0)
    assert (line.verdict, line.headline) == ("failed", "gap was ended by a signal: Killed")


HANGS = """
import os, subprocess, sys, time
from pathlib import Path
below = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
note = Path(sys.argv[sys.argv.index("--out") + 1]) / "note"
note.write_text(f"{os.getpid()} {below.pid}")
note.rename(note.with_name("pids"))
time.sleep(60)
"""


def gone(pid: int) -> bool:
    """Whether a process has ended, be it that nobody has asked how."""
    try:
        os.kill(pid, 0)
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (ProcessLookupError, FileNotFoundError):
        return True


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_all_that_runs(
    number: signal.Signals, three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(work, "COMMAND", (sys.executable, "-c", HANGS))
    begin: list[float] = []

    def stop() -> None:
        while len(list(tmp_path.glob("out/robots/*/pids"))) < 2:
            time.sleep(0.02)
        begin.append(time.monotonic())
        os.kill(os.getpid(), number)

    threading.Thread(target=stop, daemon=True).start()
    with stoppable(), pytest.raises(Stopped):
        fleet.run_fleet(three, tmp_path / "out", jobs=2)
    assert time.monotonic() - begin[0] < 2.0
    pids = [int(pid) for file in tmp_path.glob("out/robots/*/pids") for pid in file.read_text().split()]
    assert len(pids) == 4
    # One that was killed closes its pipes a moment before it is gone.
    while not all(map(gone, pids)) and time.monotonic() - begin[0] < 2.0:
        time.sleep(0.01)
    assert all(map(gone, pids))
    assert len(list(tmp_path.glob("out/robots/*"))) == 2, "the third, which waited, was never started"
    assert (tmp_path / "out" / "fleet.csv").read_text().count("\n") == 1, "no line about what was stopped"


def test_a_child_ends_with_its_parent(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    child = f"""
import os, time
from twin_diagram.runs.fleet.child import end_with_parent
end_with_parent()
fifo = open({str(tmp_path / "fifo")!r}, "w", buffering=1)
time.sleep(0.2)
fifo.write(f"{{os.getpid()}}\\n")
time.sleep(20)
fifo.write("outlived it")
"""
    starter = (
        f"import sys; from twin_diagram.runs.fleet import work; work._run([sys.executable, '-c', {child!r}], 60.0)"
    )
    parent = subprocess.Popen([sys.executable, "-c", starter])
    with (tmp_path / "fifo").open() as fifo:
        assert fifo.readline().strip().isdigit(), "it goes on while its parent is there"
        parent.kill()
        assert fifo.read() == ""
    assert parent.wait() == -signal.SIGKILL


def test_robots_are_sorted_by_what_is_wrong_and_the_first_day_that_shows_it() -> None:
    lines = [
        VisitResult("b", "2026-02-02", "named", ["payload tool", "backlash j1"]),
        VisitResult("a", "2026-02-01", "named", ["payload tool"]),
        VisitResult("b", "2026-01-01", "named", ["payload tool"]),
        VisitResult("c", "2026-01-05", "unknown"),
        VisitResult("d", "2026-01-05", "none"),
    ]
    assert first_days(lines) == [
        ("payload", "b", "2026-01-01"),
        ("payload", "a", "2026-02-01"),
        ("backlash", "b", "2026-02-02"),
        ("unknown", "c", "2026-01-05"),
    ]
    assert "4 robots, 5 visits" in page(lines, ["x"] * 5)
    assert "<script>" not in page([VisitResult("<script>", "1", "none")], ["x"])


def test_visits_without_an_answer_are_no_faults_of_robots() -> None:
    lines = [
        VisitResult("a", "2026-02-01", "named", ["payload tool"]),
        VisitResult("b", "2026-02-01", "failed", headline="b.csv: no such log <file>"),
        VisitResult("b", "2026-01-01", "timeout", headline="stopped after 9 s"),
    ]
    assert first_days(lines) == [("payload", "a", "2026-02-01")]
    wrong, lost, every = page(lines, ["x"] * 3).split("<h2>")[1:]
    assert "failed" not in wrong and "timeout" not in wrong and "failed" in every
    assert lost.startswith("Without an answer") and "no such log &lt;file&gt;" in lost
    assert lost.index("2026-01-01") < lost.index("2026-02-01")
    assert "Without an answer" not in page(lines[:1], ["x"])


@pytest.mark.parametrize(
    ("dates", "first"),
    [
        (["2026-10-01", "2026-02-01"], "2026-02-01"),
        (["1.10.2026", "02.2.2026"], "02.2.2026"),
        (["2026/10/1", "2026/2/1"], "2026/2/1"),
        (["2026-10-1", "2026-2-1"], "2026-2-1"),
        (["2026-10-01", "2026-2-1", "3.2.2026"], "2026-2-1"),
        (["10", "9"], "9"),
        (["10/1/2026", "2/1/2026"], "10/1/2026"),
        (["2026-10-01T08:00+01:00", "2026-02-01"], "2026-02-01"),
        (["2026-10-01T08:00:00Z", "2026-02-01T23:00:00+02:00", "2026-02-01T20:30"], "2026-02-01T20:30"),
        (["2026-10", "2026-275", "2026-273", "20260930T080000"], "2026-273"),
        (["2026-10-01", "yesterday", "2026-02-01"], "2026-10-01"),
    ],
    ids=[
        "ISO",
        "with dots",
        "with slashes, year first",
        "no leading zeros",
        "days in three ways",
        "numbers",
        "one of two days: as in the table",
        "with and without a zone",
        "zones in three ways",
        "months, days of the year, without dashes",
        "not all of one kind: as in the table",
    ],
)
def test_the_first_day_is_the_first_of_dates_of_one_kind(dates: list[str], first: str) -> None:
    """They were sorted as text, by which October comes before February."""
    assert first_days([VisitResult("r", date, "unknown") for date in dates]) == [("unknown", "r", first)]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "holds no robot"),
        (
            "robot,date,model,fit\nr,1,m,a\n",
            "line 1: no column holdout; with commas between they are robot,date,model,fit,holdout",
        ),
        ("robot;date;model;fit;holdout\nr;1;m;a;b\n", "line 1: no column robot, date, model, fit, holdout; "),
        ("robot,date,model,fit,holdout\nr,1,m,a\n", "line 2: nothing in holdout"),
        (HEADER + "r,1,m,a,h\nr,1,m,b,h\n", "line 3: r on 1 stands there twice"),
        (HEADER + "r,1,m,a,b,h\n", "line 2: more cells than columns; fit logs stand in one, with ; between"),
        (HEADER + "\n\nr,1,m,a,\n", "line 4: nothing in holdout"),
        (HEADER + "r,1,m,;,h\n", "line 2: nothing in fit"),
        ("robot,robot," + HEADER.split(",", 1)[1] + "r,s,1,m,a,h\n", "line 1: column robot is there 2 times"),
        (HEADER + "r,2026-03-01,m,a,h\nr,2026-02-30,m,a,h\n", "line 3: date '2026-02-30' is on no calendar"),
        (
            HEADER.replace("\n", ",torque_side\n") + "r,1,m,a,h,\nr,2,m,a,h,sensor\n",
            "line 3: torque_side 'sensor': it is motor or link, or empty",
        ),
    ],
)
def test_a_table_that_cannot_be_used_is_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "fleet.csv").write_text(text)
    with pytest.raises(TwinError, match=said):
        read_fleet(tmp_path / "fleet.csv")


def test_a_robots_own_torque_side_wins_over_the_one_told_of_all(
    three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: dict[str, list[str]] = {}

    def run(command: list[str], timeout: float) -> tuple[int, str, str]:
        model, out = (Path(command[command.index(name) + 1]) for name in ("--model", "--out"))
        told[model.name] = [command[k + 1] for k, part in enumerate(command) if part == "--torque-side"]
        (out / "gap.json").write_text(json.dumps(ANSWER))
        return 0, "", ""

    monkeypatch.setattr(work, "_run", run)
    head, *rows = three.read_text().splitlines()

    def asks(*sides: str, options: tuple[str, ...] = ()) -> dict[str, list[str]]:
        told.clear()
        lines = [f"{head},torque_side", *(f"{row},{side}" for row, side in zip(rows, sides, strict=True))]
        three.write_text("\n".join(lines) + "\n")
        fleet.run_fleet(three, tmp_path / "out", options=options)
        return dict(told)

    assert asks("link", "", "motor") == {"m1.urdf": ["link"], "m2.urdf": [], "m3.urdf": ["motor"]}
    assert asks("link", "", "link") == {"m3.urdf": ["link"]}, "another side is another question, none is not"
    last = asks("link", "", "motor", options=("--torque-side", "link"))
    assert [last[f"m{k}.urdf"][-1] for k in (1, 2, 3)] == ["link", "link", "motor"]


def test_a_table_may_come_from_a_spreadsheet(tmp_path: Path) -> None:
    text = "\ufeff" + HEADER + '"r, ""1""",1,m,"a; b",h\nr,2,m,a,h,\n,,,,\n'
    (tmp_path / "fleet.csv").write_text(text.replace("\n", "\r\n"), encoding="utf-8", newline="")
    first, second = read_fleet(tmp_path / "fleet.csv")
    assert first.robot == 'r, "1"' and [path.name for path in first.fit] == ["a", "b"] and second.date == "2"


def test_names_of_columns_may_have_spaces_about_them(tmp_path: Path) -> None:
    (tmp_path / "fleet.csv").write_text("robot, date , model, fit, holdout\nr, 1, m, a; b, h\n")
    (visit,) = read_fleet(tmp_path / "fleet.csv")
    assert (visit.robot, visit.date, visit.model) == ("r", "1", tmp_path / "m")


def test_the_page_says_where_dates_do_not_tell_which_is_first() -> None:
    lines = [VisitResult("r<", date, "unknown") for date in ("2026-03-01", "yesterday")]
    assert "Dates of r&lt; are not all of one kind" in page(lines, ["x", "y"])
    assert "first in the table" not in page(lines[:1], ["x"])


def test_one_robots_odd_dates_cost_no_others_order() -> None:
    lines = [VisitResult("r", date, "unknown") for date in ("2026-10-01", "2026-02-01")]
    odd = [VisitResult("odd", date, "unknown") for date in ("last week", "2026-01-01")]
    assert first_days([*odd, *lines]) == [("unknown", "r", "2026-02-01"), ("unknown", "odd", "last week")]
    text = page([*odd, *lines], ["x"] * 4)
    assert "Dates of odd are not" in text and "Dates of odd, r" not in text


def test_a_bag_or_constants_that_change_are_another_question(tmp_path: Path) -> None:
    (tmp_path / "fleet.csv").write_text(HEADER + "r,1,m,a.mcap#/states,h\n")
    bag, constants = tmp_path / "a.mcap", tmp_path / "constants.yaml"
    bag.write_text("1")
    constants.write_text("[1.0]")
    [visit] = read_fleet(tmp_path / "fleet.csv")
    options = ("--torque-constants", str(constants))
    before = visit.mark()
    bag.write_text("11")
    assert visit.mark() != before
    told = visit.mark(options)
    constants.write_text("[2.0]")
    assert visit.mark(options) != told


def test_visits_have_folders_of_their_own(three: Path) -> None:
    three.write_text(HEADER + "r/1,a,m,a.csv,c.csv\nr_1,a,m,a.csv,c.csv\n../..,a,m,a.csv,c.csv\n")
    folders = [visit.folder for visit in read_fleet(three)]
    assert len(set(folders)) == 3 and not any("/" in folder or folder.startswith(".") for folder in folders)


def test_the_command_takes_one_robot_or_a_fleet(three: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(three.parent / "out")
    one = ["--model", "m.urdf", "--fit", "a.csv", "--holdout", "c.csv"]
    for given, said in (
        (["--model", "m.urdf"], "required: --fit, --holdout"),
        (["--fleet", str(three), "--model", "m.urdf"], "leave out --model"),
        ([*one, "--jobs", "1"], "--jobs: only with --fleet"),
        ([*one, "--timeout", "0", "--dask", ""], "--timeout, --dask: only with --fleet"),
    ):
        with pytest.raises(SystemExit) as end:
            main(["gap", *given, "--out", out])
        assert end.value.code == 2 and said in capsys.readouterr().err
    assert main(["gap", "--fleet", str(three), "--out", out, "--jobs", "0"]) == 2
    assert "--jobs 0" in capsys.readouterr().err
    assert main(["gap", "--fleet", str(three), "--out", out, "--packages", "robot=nowhere"]) == 2
    assert "--packages robot=nowhere: 'nowhere' is no folder" in capsys.readouterr().err
    assert main(["gap", "--fleet", str(three), "--out", out, "--columns", "nowhere.yaml"]) == 2
    assert "nowhere.yaml: no such map of columns" in capsys.readouterr().err
    assert not Path(out).exists()


def test_the_command_hands_on_what_it_is_told(three: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[list[str], float]] = []

    def run(command: list[str], timeout: float) -> tuple[int, str, str]:
        told.append((command, timeout))
        return 2, "", ""

    monkeypatch.setattr(work, "_run", run)
    monkeypatch.chdir(three.parent)
    (three.parent / "meshes").mkdir()
    given = ["--timeout", "7", "--columns", "libfranka", "--packages", "robot=meshes", "--joints", "left_1", "left_2"]
    assert main(["gap", "--fleet", str(three), "--out", "out", *given]) == 0 and len(told) == 3
    for command, timeout in told:
        text = " ".join(command)
        assert timeout == 7.0 and f"--columns libfranka --packages robot={three.parent / 'meshes'} --fit" in text
        assert "--joints left_1 left_2 --" in text  # all joints of a robot of two arms were asked about
    assert main(["gap", "--fleet", str(three), "--out", "out"]) == 0 and told[-1][1] == 3600.0


class StoodInClient(ThreadPoolExecutor):
    """Of `distributed`: what is asked of a cluster is done here."""

    asked: ClassVar[list[tuple[str, bool]]] = []

    def __init__(self, address: str, timeout: int) -> None:
        if address == "nobody":
            raise OSError(f"timed out after {timeout} s")
        super().__init__(2)
        self.address = address

    def get_executor(self, pure: bool) -> StoodInClient:
        self.asked.append((self.address, pure))
        return self


def test_work_goes_to_a_cluster(
    three: Path,
    stood_in: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(Client=StoodInClient))
    monkeypatch.setattr(StoodInClient, "asked", [])
    monkeypatch.setattr(fleet, "ThreadPoolExecutor", None)
    lines = fleet.run_fleet(three, tmp_path / "out", dask="tcp://there:1")
    assert [line.verdict for line in lines] == ["named with remainder", "failed", "timeout"]
    assert StoodInClient.asked == [("tcp://there:1", False)], "what was asked before is asked again"
    with pytest.raises(TwinError, match="--dask nobody: no scheduler answers there: timed out after 10 s"):
        fleet.run_fleet(three, tmp_path / "out", dask="nobody")
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["gap", "--fleet", str(three), "--out", str(tmp_path / "out"), "--dask", "tcp://there:1"]) == 2
    assert "twin-diagram[fleet]" in capsys.readouterr().err


def test_a_cluster_does_the_same(three: Path, stood_in: list[str], tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra `fleet` is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
    ) as cluster:
        lines = fleet.run_fleet(three, tmp_path / "out", dask=cluster.scheduler_address)
    assert [line.verdict for line in lines] == ["named with remainder", "failed", "timeout"]
