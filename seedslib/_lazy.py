"""Lazy public names (PEP 562): a name is imported when it is first used."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_names(
    package: str, namespace: dict, homes: Mapping[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Give a package its module-level ``__getattr__`` and ``__dir__``.

    Parameters
    ----------
    package : str
        Name of the package, its ``__name__``.
    namespace : dict
        The package's ``globals()``; a resolved name is stored there.
    homes : mapping of str to str
        For each public name the module that holds it, relative to `package`
        (``".symbolic"``). A module of the same name is exposed itself by an empty string.
    """

    def __getattr__(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = homes[name]
        value = (
            getattr(import_module(home, package), name)
            if home
            else import_module("." + name, package)
        )
        namespace[name] = value
        return value

    def __dir__() -> list[str]:
        return sorted({*namespace, *homes})

    return __getattr__, __dir__
