"""The command ``twin-diagram``.

Bad input ends in one clear line on stderr and exit status 2; nothing half-written is left behind.
"""

from __future__ import annotations

import argparse
import io
import logging
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin_diagram.assets.command import add_asset_commands
from twin_diagram.errors import TwinError
from twin_diagram.native import RUN, missing_packages_named, require_packages, require_utf8
from twin_diagram.planning.grasps.command import add_grasps_command
from twin_diagram.runs.fleet import command as fleet_command
from twin_diagram.runs.learning.command import add_learn_command
from twin_diagram.runs.tracking.command import add_track_command
from twin_diagram.runtime.command_parser import CommandParser, add_command
from twin_diagram.runtime.progress import say_beside
from twin_diagram.runtime.stopping import Stopped, stoppable
from twin_diagram.runtime.threads import one_thread

if TYPE_CHECKING:
    from twin_diagram.logs.torque_constants import TorqueConstants


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status.

    Args:
        argv: what follows the program's name; None: this process's own, which ends here where a signal stops it.
    """
    for closed in [name for name in ("stdout", "stderr") if getattr(sys, name) is None]:  # `>&-`, a bare service
        setattr(sys, closed, open(os.devnull, "w", encoding="utf-8"))  # takes its number, before a file of ours does
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="replace")  # where the terminal has no `·` or `°`, the rest is worth reading
    arguments = _parser().parse_args(argv)
    command: Callable[[argparse.Namespace], int] = arguments.command
    # Where to look is said by the run itself; a filter stays when importing pydrake sets the level.
    logging.getLogger("drake").addFilter(_worth_saying)
    if arguments.verbose:
        logging.getLogger("twin_diagram").setLevel(logging.DEBUG)
    try:
        require_utf8()
        with missing_packages_named(), one_thread(), stoppable():  # before NumPy is imported
            _import_effects(getattr(arguments, "imported", []))
            status = command(arguments)
        sys.stdout.flush()  # a reader that has left is noticed here, not at exit
        return status
    except TwinError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stop:
        print("stopped", file=sys.stderr)
        status = stop.status if isinstance(stop, Stopped) else 130
        if argv is None:  # as a program of its own: taking Drake down takes longer than closing did
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
        return status
    except BrokenPipeError:
        # Whoever read the output has enough of it; keep the interpreter from complaining about it at exit.
        _leave_stdout()
        return 0
    except MemoryError as error:
        print(
            f"error: not enough memory: {' '.join(str(error).split()) or 'something asked for is too large'}",
            file=sys.stderr,
        )
        return 2
    except OSError as error:
        print(f"error: {_said(error)}", file=sys.stderr)
        try:
            sys.stdout.flush()
        except OSError:  # that is what could not be written
            _leave_stdout()
        return 2


def _said(error: OSError) -> str:
    where = f"{error.filename}: " if error.filename is not None else ""
    return " ".join(f"{where}{error.strerror or error}".split())


def _leave_stdout() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _worth_saying(record: logging.LogRecord) -> bool:
    """Leave out what Drake says of joint friction, which `model.description.unparsed` reads, and of meshes' paint.

    Of that a Panda as MJCF has 232 lines, one for each OBJ whose .mtl is not there; and nothing here is deformable.
    """
    paint = ("no materials will be included", "Material file [", "has its own materials, but", "vtkGLTFDocumentLoader")
    left_out = ("non-zero joint friction", "not currently supported for deformable contact", *paint)
    return record.levelno >= logging.WARNING and not any(words in record.getMessage() for words in left_out)


def _parser() -> argparse.ArgumentParser:
    from twin_diagram.runtime.version import __version__

    parser = CommandParser(prog="twin-diagram", description="A digital twin of a robot arm as a Drake Diagram.")
    parser.add_argument("--version", action="version", version=f"twin-diagram {__version__}")
    parser.add_argument("--verbose", action="store_true", help="say all that Drake warns of in a description")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    run = add_command(commands, "run", "run a scenario: station and twin in closed loop")
    run.add_argument("scenario", help="a YAML file, or the name of a scenario that comes along, e.g. tabletop")
    _add_scenario_options(run)
    run.add_argument("--out", type=Path, metavar="DIR", help="write replay.html, diagram.svg, plots and summary.json")
    run.add_argument(
        "--record", type=Path, metavar="DIR", help="record log and images; `twin-diagram replay DIR` runs them"
    )
    run.add_argument("--log", type=Path, metavar="F", help="write the measured log (.csv or .npz)")
    run.set_defaults(command=_run)

    replay = add_command(commands, "replay", "run the twin on a recording or a measured log")
    replay.add_argument("log", type=Path, metavar="DIR_OR_LOG", help="a folder of `run --record`, or a measured log")
    replay.add_argument("--model", help="the arm's description, for a bare log: URDF, SDF, MJCF or a corrected model")
    _add_scenario_options(replay)
    _add_columns(replay)
    _add_joints(replay)
    replay.add_argument("--out", type=Path, metavar="DIR", help="write replay.html, diagram.svg and summary.json")
    replay.set_defaults(command=_replay)

    _add_scenario_commands(commands)
    _add_log_commands(commands)
    add_asset_commands(commands)
    add_track_command(commands)
    add_grasps_command(commands)
    add_learn_command(commands)
    return parser


def _add_scenario_commands(commands: Any) -> None:
    """Add the commands about scenarios."""
    init = add_command(commands, "init", "write a first scenario for an arm of one's own")
    init.add_argument("--arm", required=True, help="URDF, SDF or MJCF")
    init.add_argument("--out", required=True, type=Path, metavar="YAML", help="the scenario; must not exist yet")
    _add_packages(init)
    _add_joints(init)
    init.set_defaults(command=_init)

    fields = add_command(commands, "fields", "what a scenario's fields mean, with units and defaults")
    fields.add_argument("section", nargs="?", default="", help="e.g. twin.filter; without it: the top level")
    fields.set_defaults(command=_fields)


def _add_log_commands(commands: Any) -> None:
    """Add the commands about models and logs."""
    predict = add_command(commands, "predict", "what a model says of a measured log: torques and motion")
    predict.add_argument("--model", required=True, help="URDF, SDF, MJCF or the folder of a corrected model")
    predict.add_argument("--log", required=True, type=Path, help="measured log: .csv, .npz, a ROS bag or an LCM log")
    predict.add_argument("--out", required=True, type=Path, help="where the prediction is written, .csv or .npz")
    predict.add_argument("--horizon", type=float, default=0.2, help="length of a rollout [s] (default: %(default)s)")
    _add_columns(predict)
    _add_torque_side(predict)
    _add_packages(predict)
    _add_joints(predict)
    predict.set_defaults(command=_predict)

    gap = add_command(commands, "gap", "find what a model lacks to explain measured logs, and add it")
    gap.add_argument("--model", help="URDF, SDF, MJCF or the folder of a corrected model")
    gap.add_argument(
        "--fit", type=Path, action="append", metavar="LOG", help="measured log in which to look; may be repeated"
    )
    gap.add_argument("--holdout", type=Path, metavar="LOG", help="measured log of another run, which is the proof")
    gap.add_argument(
        "--out", required=True, type=Path, metavar="DIR", help="write gap.json, model/, experiments/ and report.html"
    )
    fleet_command.add_fleet_options(gap)
    _add_columns(gap)
    _add_torque_side(gap)
    _add_packages(gap)
    _add_joints(gap)
    gap.set_defaults(command=_gap, refuse=gap.error)


def _add_columns(parser: argparse.ArgumentParser) -> None:
    """Add what a foreign log means, and what its currents are worth."""
    parser.add_argument(
        "--columns",
        metavar="MAP",
        help="what a foreign log's columns mean: a YAML file or a preset (libfranka, franka_ros, ur_rtde, iiwa_fri, …)",
    )
    parser.add_argument(
        "--torque-constants",
        nargs="+",
        metavar="K",
        help="the log holds currents [A] (current_measured, or in the place of torques): each joint's torque over "
        "current [N·m/A, motor constant times gear ratio] in the model's order, JOINT=K, or a YAML file",
    )


def _constants(arguments: argparse.Namespace) -> TorqueConstants | None:
    from twin_diagram.logs.torque_constants import torque_constants

    return None if arguments.torque_constants is None else torque_constants(arguments.torque_constants)


def _add_torque_side(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--torque-side",
        choices=("motor", "link"),
        help="of the gear that torques were measured on: what the motor gives, or a sensor behind the gear, where no "
        "rotor of its own shows (default: as the folder of a corrected model says, else motor)",
    )


def _add_joints(parser: argparse.ArgumentParser) -> None:
    said = "the joints of one arm, in order, of a robot that has more; the others are held (default: all)"
    parser.add_argument("--joints", nargs="+", default=(), metavar="JOINT", help=said)


def _add_packages(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--packages",
        action="append",
        default=[],
        metavar="NAME=DIR",
        help="local folder for package://NAME; may be repeated",
    )
    parser.add_argument(
        "--import",
        dest="imported",
        action="append",
        default=[],
        metavar="FILE",
        help="Python file that registers effects of one's own; may be repeated",
    )


def _import_effects(files: Sequence[str]) -> None:
    if files:
        from twin_diagram.model.effects.users_modules import import_file

        for file in files:
            import_file(file)


def _packages(arguments: argparse.Namespace) -> dict[str, str | Path]:
    found: dict[str, str | Path] = {}
    for given in arguments.packages:
        name, equals, folder = given.partition("=")
        if not (name and equals and Path(folder).is_dir()):
            what = f"{folder!r} is no folder" if name and equals else "is not NAME=DIR"
            raise TwinError(f"--packages {given}: {what}; it names the local folder that package://NAME stands for")
        found[name] = Path(folder).resolve()
    return found


def _add_scenario_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set", action="append", default=[], metavar="FIELD=VALUE", help="override a field, e.g. twin.filter.rate=400"
    )
    _add_packages(parser)
    parser.add_argument("--seed", type=int, help="of everything random")
    parser.add_argument("--duration", type=float, help="of the run [s]")
    parser.add_argument("--meshcat", action="store_true", help="look on in a browser while it runs")
    parser.add_argument("--meldis", action="store_true", help="show both scenes in a Meldis that is running")


def _overrides(arguments: argparse.Namespace) -> list[str]:
    import yaml

    given = {name: getattr(arguments, name) for name in ("seed", "duration")}
    named = [f"{name}={value}" for name, value in given.items() if value is not None]
    # In YAML's own quotes: to it ` #` begins a comment, `: ` a mapping, and a surrogate pair of JSON's is two letters.
    told = _packages(arguments).items()
    quoted = {name: yaml.safe_dump(str(folder), default_style='"', width=float("inf")) for name, folder in told}
    packages = [f"packages.{name}={text.strip()}" for name, text in quoted.items()]
    return [*packages, *arguments.set, *named]


def _run(arguments: argparse.Namespace) -> int:
    from twin_diagram.native import require_egl
    from twin_diagram.runs.places import places_for
    from twin_diagram.scenario.file import load_scenario

    scenario = load_scenario(arguments.scenario, _overrides(arguments))
    places_for(arguments.out, arguments.record, arguments.log)
    require_packages(*RUN)
    if scenario.station == "sim" and scenario.twin.perceiving:
        require_egl()
    from twin_diagram.runs.early_check import check_given

    check_given(scenario)
    from twin_diagram.runs.health_watch import said_unheard
    from twin_diagram.runs.run import run_scenario

    summary = run_scenario(
        scenario,
        out=arguments.out,
        record=arguments.record,
        log=arguments.log,
        show=arguments.meshcat,
        meldis=arguments.meldis,
        say=print,
    )
    return 3 if said_unheard(scenario, summary) else 0


def _replay(arguments: argparse.Namespace) -> int:
    from twin_diagram.runs.places import places_for
    from twin_diagram.runs.replayed import replay_scenario

    require_packages(*RUN)
    given = (arguments.log, arguments.model, _overrides(arguments), arguments.columns, arguments.joints)
    scenario = replay_scenario(*given, arguments.torque_constants or ())
    places_for(arguments.out, None, None)
    from twin_diagram.runs.early_check import check_given

    check_given(scenario)
    from twin_diagram.runs.run import run_scenario

    def say(text: str) -> None:
        """What the twin believes is JSON, which another program may read; anything else goes beside it."""
        print(text, file=sys.stdout if text.startswith("{") else sys.stderr, flush=True)

    run_scenario(scenario, out=arguments.out, show=arguments.meshcat, meldis=arguments.meldis, say=say)
    return 0


def _init(arguments: argparse.Namespace) -> int:
    from twin_diagram.runs.first_scenario import write_first_scenario

    found = write_first_scenario(arguments.arm, arguments.out, _packages(arguments), arguments.joints)
    print(f"{arguments.out}: {len(found.joints)} joints ({', '.join(found.joints)}), tool frame {found.frames[0]}")
    for note in found.notes(arguments.arm):
        print(f"note: {note}", file=sys.stderr)
    print(f"run it: twin-diagram run {shlex.quote(str(arguments.out))} --out out/first")
    return 0


def _fields(arguments: argparse.Namespace) -> int:
    from twin_diagram.scenario import Scenario
    from twin_diagram.scenario.field_table import rows_at, table

    print(table(rows_at(Scenario, arguments.section)))
    return 0


def _predict(arguments: argparse.Namespace) -> int:
    from twin_diagram.model.prediction import predict

    if not arguments.horizon > 0:
        raise TwinError(f"--horizon {arguments.horizon}: the length of a rollout is positive [s]")
    packages = _packages(arguments)
    given = (arguments.model, arguments.log, arguments.out, arguments.horizon, packages, arguments.columns)
    more = {"torque_side": arguments.torque_side, "constants": _constants(arguments), "joints": arguments.joints}
    predict(*given, say=print, **more)
    return 0


def _gap(arguments: argparse.Namespace) -> int:
    if wrong := fleet_command.one_or_many(arguments):
        arguments.refuse(wrong)
    if arguments.fleet is not None:
        return fleet_command.run(arguments, _packages(arguments))
    from numpy.linalg import LinAlgError

    from twin_diagram.gap.report.words import headline
    from twin_diagram.gap.workflow import run_gap

    try:
        found = run_gap(
            arguments.model,
            arguments.fit,
            arguments.holdout,
            arguments.out,
            say_beside,
            packages=_packages(arguments),
            columns=arguments.columns,
            torque_side=arguments.torque_side,
            constants=_constants(arguments),
            joints=arguments.joints,
        )
    except LinAlgError as error:  # more that could explain the runs than samples to tell it by
        raise TwinError(
            "these runs are too short, or move too little, to tell noise from what a model may lack; "
            "ten seconds in which each joint moves to and fro do"
        ) from error
    for note in found.notes:
        say_beside(f"warning: {note}")
    print(headline(found.verdict))
    print(f"see {arguments.out / 'report.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
