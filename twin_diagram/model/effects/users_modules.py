"""Modules of users that define effects of their own: a file named on the command line, or an installed package.

A package offers its effects by an entry point, which is loaded when effects are first looked for:

    [project.entry-points."twin_diagram.effects"]
    drag = "my_package.drag"

A file is imported only where somebody says so (`--import drag.py`). A corrected model notes the module's name; reading
it never imports a file by itself.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from twin_diagram.errors import ModelError

GROUP = "twin_diagram.effects"
"""The entry points' group."""
OWN = "twin_diagram"
"""Effects of this package need no module noted."""
SCRIPT = "__main__"
"""The module of a script, which no other process imports: it would do all that it does once more."""


def import_file(path: str | Path) -> str:
    """Import a Python file that registers effects; answer its module's name, that of the file.

    Raises:
        ModelError: no such file, a name that is taken by another module, or whatever the file itself raises.
    """
    file = Path(path).expanduser().resolve()
    if file.suffix != ".py" or not file.is_file():
        raise ModelError(f"--import {path}: is no Python file")
    name = file.stem
    loaded = sys.modules.get(name)
    if loaded is not None:
        if getattr(loaded, "__file__", None) == str(file):
            return name
        raise ModelError(f"--import {path}: another module is called {name!r}; give the file a name of its own")
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None and spec.loader is not None  # a .py file has both
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        raise ModelError(f"--import {path}: {type(error).__name__}: {' '.join(str(error).split())}") from error
    return name


def import_again(files: Mapping[str, str]) -> None:
    """Import in a helping process the modules that the one that started it has.

    Args:
        files: each module's, by its name.

    Raises:
        ModelError: one of them cannot be imported.
    """
    for name, file in files.items():
        if "." not in name:
            import_file(file)
            continue
        try:
            importlib.import_module(name)
        except Exception as error:
            what = f"{type(error).__name__}: {' '.join(str(error).split())}"
            raise ModelError(f"effects of {name}: {what}") from error


@cache
def load_installed() -> tuple[str, ...]:
    """Load the effects that installed packages offer, once; answer their modules' names.

    Raises:
        ModelError: one of them cannot be loaded.
    """
    loaded = []
    for point in entry_points(group=GROUP):
        try:
            point.load()
        except Exception as error:
            what = f"{type(error).__name__}: {' '.join(str(error).split())}"
            raise ModelError(f"effects of the installed {point.value}: {what}") from error
        loaded.append(point.module)
    return tuple(loaded)


def module_of(cls: type) -> str:
    """Return the module that a corrected model notes beside an effect: empty for those that come along."""
    return "" if cls.__module__.partition(".")[0] == OWN else cls.__module__


def lacking(name: str, module: str) -> str:
    """Return what to do about an effect whose module is noted but was not imported."""
    if module == SCRIPT:
        return f"effects: {name!r} is defined in a script: put its class into a file of its own, and import that there"
    return (
        f"effects: {name!r} is defined in the module {module!r}, which is not loaded: name its file with "
        f"--import {module.rpartition('.')[2]}.py, or import it before the model is read"
    )
