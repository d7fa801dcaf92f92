"""The version of the package, where all rooms can see it; the build reads it from here."""

__version__ = "0.2.0"
