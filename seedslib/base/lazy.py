"""Lazy public names (PEP 562): a package's names are imported when they are first used."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module

BRACKETS = str.maketrans("(),", "   ")


def lazy_names(package: str) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Give a package its ``__getattr__``, ``__dir__`` and ``__all__``.

    The one list of its names is what its ``__init__`` imports under ``if TYPE_CHECKING:``, in the
    form ``from module import name as name``: type checkers read it there, and so does this
    function. `TYPE_CHECKING` is a plain False: importing `typing` would take longer.

    Parameters
    ----------
    package : str
        Name of the package, its ``__name__``, while it is being imported.
    """
    owner = sys.modules[package]
    source = owner.__spec__.loader.get_data(owner.__file__).decode()
    block = source.partition("\nif TYPE_CHECKING:\n")[2].partition("\nelse:\n")[0]
    homes = {}
    # read as text: parsing would cost more than all else that importing the library does
    for statement in block.split("from ")[1:]:
        home, _, names = statement.partition(" import ")
        for name in names.translate(BRACKETS).split()[::3]:  # name as name
            homes[name] = home

    def __getattr__(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = homes[name]
        if home == package or not hasattr(module := import_module(home), name):
            value = import_module(f"{home}.{name}")
        else:
            value = getattr(module, name)
        setattr(owner, name, value)
        return value

    def __dir__() -> list[str]:
        return sorted({*vars(owner), *homes})

    return __getattr__, __dir__, sorted(homes)
