"""Lazy public names (PEP 562): a room's names are imported when they are first used."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module


def lazy_names(
    package: str,
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Give a room its ``__getattr__``, ``__dir__`` and ``__all__``.

    The one list of its names is what its ``__init__`` imports under ``if TYPE_CHECKING:``, in the
    form ``from module import name as name``: type checkers read it there, and so does this
    function.

    Parameters
    ----------
    package : str
        Name of the package, its ``__name__``, while it is being imported.

    Raises
    ------
    ImportError
        The source of the package cannot be read.
    """
    room = sys.modules[package]
    source = room.__spec__.loader.get_source(package)
    if source is None:
        raise ImportError(f"{package}: its source is wanted, it lists the public names")
    homes = {
        alias.asname or alias.name: (node.module, alias.name)
        for block in ast.parse(source).body
        if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }

    def __getattr__(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home, there = homes[name]
        if home == package or not hasattr(module := import_module(home), there):
            value = import_module(f"{home}.{there}")
        else:
            value = getattr(module, there)
        setattr(room, name, value)
        return value

    def __dir__() -> list[str]:
        return sorted({*vars(room), *homes})

    return __getattr__, __dir__, sorted(homes)
