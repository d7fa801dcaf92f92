"""Parses command lines: what is wrong with one is said in one line, and what is told twice is wrong."""

from __future__ import annotations

import argparse
import sys
from typing import Any, NoReturn


class CommandParser(argparse.ArgumentParser):
    """Says in one line what is wrong with the command line."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.register("action", None, _Once)

    def error(self, message: str) -> NoReturn:
        """End the program."""
        print(f"error: {' '.join(message.split())} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(2)


def add_command(commands: Any, name: str, does: str) -> argparse.ArgumentParser:
    """Add a command, and return its parser.

    Args:
        commands: as `add_subparsers` returned them.
        name: of the command.
        does: in the list of commands, and where its own `--help` begins; small first letter, no full stop.
    """
    parser: argparse.ArgumentParser = commands.add_parser(name, help=does, description=f"{does[0].upper()}{does[1:]}.")
    return parser


class _Once(argparse.Action):
    """Store a value; of two `--holdout` the first was left out, and nobody said so."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Keep it.

        Raises:
            argparse.ArgumentError: there is one already.
        """
        before = getattr(namespace, self.dest, self.default)
        if option_string is not None and before is not self.default:
            raise argparse.ArgumentError(self, f"is given twice, as {_said(before)} and as {_said(values)}")
        setattr(namespace, self.dest, values)


def _said(values: Any) -> str:
    return " ".join(map(str, values)) if isinstance(values, list) else str(values)
