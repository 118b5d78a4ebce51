"""Design of finite-order filters before any data: one pass over simulated paths, or none."""

from seedslib._lazy import lazy_names

_HOMES = {
    "synthesize": ".simulated",
    "Affine": ".predictors",
    "Polynomial": ".predictors",
    "Continuous": ".predictors",
}
__getattr__, __dir__ = lazy_names(__name__, globals(), _HOMES)
__all__ = [*_HOMES]
