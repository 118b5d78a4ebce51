"""Designed filters as C: one header, no dependencies, the same numbers."""

from seedslib._lazy import lazy_names

_HOMES = {"to_c": ".header"}
__getattr__, __dir__ = lazy_names(__name__, globals(), _HOMES)
__all__ = [*_HOMES]
