"""Where the package finds its own models, and how a model's name becomes a path."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from twin_diagram.errors import ModelError

_INSTALLED = Path(__file__).parent.parent / "_models"
"""Where a wheel has them."""
_CHECKOUT = Path(__file__).parents[2] / "models"
"""Where a checkout has them."""


def models_dir() -> Path:
    """Return the folder of the models that come with the package (wheel or checkout)."""
    return _INSTALLED if _INSTALLED.is_dir() else _CHECKOUT


def name_package(package: str) -> str:
    """Return what to do about a package of which no folder is given."""
    return f"name it in the scenario (packages: {{{package}: DIR}}) or with --packages {package}=DIR"


def resolve(name: str, packages: Mapping[str, str | Path] | None = None) -> Path:
    """Turn a model's name into an existing path.

    Args:
        name: an absolute or relative path, ``package://PKG/rest`` with PKG in `packages` (or ``twin_diagram`` for the
            models that come along), or a path below the models that come along such as ``arms/panda.urdf``.
        packages: local folders by package name.

    Raises:
        ModelError: nothing exists there; the message lists what was tried.
    """
    tried: list[Path] = []
    if name.startswith("package://"):
        package, _, rest = name.removeprefix("package://").partition("/")
        folders = {"twin_diagram": models_dir(), **(packages or {})}
        if package not in folders:
            raise ModelError(f"{name}: no folder is given for package {package!r}; {name_package(package)}")
        tried.append(Path(folders[package]) / rest)
    else:
        path = Path(os.path.expanduser(name))
        tried.append(path)
        if not path.is_absolute():
            tried.append(models_dir() / path)
    for path in tried:
        if path.exists():
            return path.resolve()
    raise ModelError(f"{name}: no such file (tried {', '.join(map(str, tried))})")
