"""The typed errors of this package: each carries the offending value and says what to do about it.

Every one derives from `TwinError`; the command line prints its message as one line and exits with status 2.
"""

from __future__ import annotations

import os
from typing import Any


class TwinError(ValueError):
    """Bad input that the user can mend."""

    def __reduce__(self) -> tuple[Any, ...]:
        # Errors cross process borders, whatever arguments their constructors take.
        return _rebuilt, (type(self), self.args, self.__dict__)


def _rebuilt(kind: type[TwinError], args: tuple[Any, ...], state: dict[str, Any]) -> TwinError:
    error = kind.__new__(kind, *args)
    error.args = args
    error.__dict__.update(state)
    return error


class ScenarioError(TwinError):
    """A scenario file or an override that does not fit the schema.

    Attributes:
        field: dotted name of the offending field, e.g. ``twin.arm.model``.
    """

    def __init__(self, field: str, message: str) -> None:
        super().__init__(f"{field}: {message}")
        self.field = field


class ArgumentError(TwinError):
    """An argument of a kind that a function cannot take."""


def expect(value: object, kind: type | tuple[type, ...], name: str, wanted: str) -> None:
    """Refuse an argument of another kind, by what is wanted in its place; for what users call first.

    Args:
        value: the argument.
        kind: what it must be an instance of.
        name: of the argument.
        wanted: what it is to be, and where that comes from: "a Scenario (as load_scenario returns it)".

    Raises:
        ArgumentError: it is something else.
    """
    if not isinstance(value, kind):
        name_of = type(value).__name__
        article = "an" if name_of[0].lower() in "aeiou" else "a"
        given = f"the class {value.__name__}" if isinstance(value, type) else f"{article} {name_of}"
        raise ArgumentError(f"{name}: {wanted} is wanted, not {given}")


def expect_path(value: object, name: str, wanted: str) -> None:
    """Refuse what is no path; see `expect`."""
    expect(value, (str, os.PathLike), name, f"the path of {wanted}")


class ModelError(TwinError):
    """A model file that is missing, cannot be parsed or lacks what was asked of it."""


class LogError(TwinError):
    """A measured log that cannot be used as it stands."""


class FramesError(TwinError):
    """Recorded images, or what is said of their cameras, that cannot be used as they stand."""


class AssetError(TwinError):
    """An object of the library that is missing or malformed."""


class StationError(TwinError):
    """A station that cannot be built or has no such signal."""
