"""The typed errors of this package: each carries the offending value and says what to do about it.

Every one derives from `TwinError`; the command line prints its message as one line and exits with status 2.
"""

from __future__ import annotations

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
