"""Observation systems: what evolves, what is measured, and how to simulate both."""

from seedslib._lazy import lazy_names

_HOMES = {
    "Noise": ".maps",
    "StochasticMap": ".maps",
    "LinearDiffusion": ".linear",
    "AugmentedDiffusion": ".augmented",
    "DelaySystem": ".delay",
    "DiscreteSystem": ".discrete",
    "JumpDiffusion": ".jump_diffusion",
    "PiecewiseLinearSystem": ".piecewise",
    "SwitchingSystem": ".switching",
    "averaged_switching": ".switching_average",
    "delay_examples": "",
    "zoo": "",
}
__getattr__, __dir__ = lazy_names(__name__, globals(), _HOMES)
__all__ = [*_HOMES]
