"""Numbers without bounds in the place of parameters that have some."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import expit, logit

from seedslib.evaluation.differences import STEP


@dataclass(frozen=True)
class Scale:
    """Free numbers u in the place of parameters between bounds: logarithms, or logits."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError(f"bounds: wanted a lower one first, got {self.low}, {self.high}")

    def value(self, u: Any) -> Any:
        """The parameter."""
        if np.isfinite(self.low) and np.isfinite(self.high):
            return self.low + (self.high - self.low) * expit(u)
        if np.isfinite(self.low):
            return self.low + np.exp(u)
        return self.high - np.exp(-u) if np.isfinite(self.high) else u

    def free(self, value: float) -> float:
        """The number u of a parameter.

        Raises
        ------
        ValueError
            A value that is not between the bounds.
        """
        if not self.low < value < self.high:
            raise ValueError(
                f"start: wanted a value between {self.low:g} and {self.high:g}, got {value:g}"
            )
        if np.isfinite(self.low) and np.isfinite(self.high):
            return float(logit((value - self.low) / (self.high - self.low)))
        if np.isfinite(self.low):
            return float(np.log(value - self.low))
        return float(-np.log(self.high - value)) if np.isfinite(self.high) else value

    def slope(self, u: float) -> float:
        """Derivative of the parameter by u."""
        return float((self.value(u + STEP) - self.value(u - STEP)) / (2 * STEP))
