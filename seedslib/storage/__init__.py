"""Designed filters as files, bound to the model they were designed for."""

from seedslib._lazy import lazy_names

_HOMES = {
    "save": ".files",
    "load": ".files",
}
__getattr__, __dir__ = lazy_names(__name__, globals(), _HOMES)
__all__ = [*_HOMES]
