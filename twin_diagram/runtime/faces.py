"""Faces of packages that load what they show only once it is asked for (PEP 562).

Only the standard library is imported here: `import twin_diagram` comes through this module.
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from typing import Any


def lazy_face(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` for a package, so that each public name is imported at its first use.

    The package tells its names once, in the form that type checkers and editors read: imports under
    ``if TYPE_CHECKING:`` and the list `__all__`. A name is looked for where the imports say (as with the stubs of
    ``lazy_loader.attach_stub``); `dir` shows `__all__`. No name may be that of a module right below the package,
    because importing that module would put it in the name's place; ``tests/test_faces.py`` holds this.

    Args:
        package: its `__name__`.
    """
    module = sys.modules[package]

    @cache
    def homes() -> dict[str, str]:
        return imported_for_typing(_source(package))

    def __getattr__(name: str) -> Any:
        if name not in module.__all__ or name not in homes():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(homes()[name]), name)
        setattr(module, name, value)  # from now on it is found without coming here
        return value

    def __dir__() -> list[str]:
        return sorted(module.__all__)

    return __getattr__, __dir__


def imported_for_typing(source: str) -> dict[str, str]:
    """Return which names a module's source imports under ``if TYPE_CHECKING:``, and from where."""
    blocks = [node for node in ast.parse(source).body if isinstance(node, ast.If)]
    typing = [node for block in blocks if ast.unparse(block.test) == "TYPE_CHECKING" for node in block.body]
    return {
        alias.name: node.module
        for node in typing
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }


def _source(package: str) -> str:
    spec = find_spec(package)
    source = spec.loader.get_source(package) if spec and spec.loader else None  # type: ignore[attr-defined]
    if source is None:
        raise ImportError(f"{package} must come with its source, from which it reads what it shows")
    return str(source)
