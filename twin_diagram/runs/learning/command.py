"""The command `twin-diagram learn`. Cheap to import, as the command line is."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from twin_diagram.runtime.command_parser import add_command
from twin_diagram.runtime.progress import say_beside


def add_learn_command(commands: Any) -> None:
    """Add the command that empties a bin and learns what lies in it."""
    learn = add_command(commands, "learn", "take objects from a bin, show and weigh them, and write an asset of each")
    learn.add_argument("scenario", help="a YAML file, or the name of a scenario that comes along, e.g. bin_picking")
    learn.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the run")
    mode = learn.add_mutually_exclusive_group()
    mode.add_argument("--resume", action="store_true", help="go on with the run in that folder")
    mode.add_argument("--again", metavar="NAME", help="make this object's asset anew from what the run kept of it")
    learn.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE", help="override a field")
    learn.set_defaults(command=_learn)


def _learn(arguments: argparse.Namespace) -> int:
    from twin_diagram.native import RUN, require_egl, require_packages
    from twin_diagram.scenario.file import load_scenario

    scenario = load_scenario(arguments.scenario, arguments.set)
    require_packages(*RUN)
    from twin_diagram.runs.learning.start import learn, learn_again

    if arguments.again:
        state = learn_again(scenario, arguments.out, arguments.again, say_beside)
    else:
        require_egl()
        state = learn(scenario, arguments.out, resume=arguments.resume, say=say_beside)
    for one in state.learned:
        print(f"{one.name}: {one.state}{f' ({one.told})' if one.told else ''}")
    print(f"see {arguments.out / 'gallery.html'}")
    return 0
