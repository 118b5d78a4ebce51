"""What a filter is worth on test paths: errors with their standard errors, and consistency."""

from seedslib._lazy import lazy_names

_HOMES = {
    "evaluate": ".scores",
    "compare": ".scores",
    "diff": ".designs",
}
__getattr__, __dir__ = lazy_names(__name__, globals(), _HOMES)
__all__ = [*_HOMES]
