"""The typed errors of this package: each carries the offending value and says what to do about it.

Every one derives from `TwinError`; the command line prints its message as one line and exits with status 2.
"""

from __future__ import annotations


class TwinError(ValueError):
    """Bad input that the user can mend."""


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


class AssetError(TwinError):
    """An object of the library that is missing or malformed."""


class StationError(TwinError):
    """A station that cannot be built or has no such signal."""
