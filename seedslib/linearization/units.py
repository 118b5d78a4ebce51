"""Units of the state in which powers of it are numbers."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np

from seedslib.linearization.moments import Linearization
from seedslib.models.maps import StochasticMap

NARROW = 1e-10
"""Scales of a state above this are not looked at: what they are powers of is no matter."""


def as_linearization(value: Any, system: Any) -> Linearization:
    """The linearization that was passed, for a system whose units it can be taken in.

    A power of the state that falls below the smallest number is zero, and what it stands for is
    lost without a trace; one that exceeds the largest is found by the filters.

    Raises
    ------
    TypeError
        Something else.
    ValueError
        The first law of the state is so small that a product in the maps, or a mean of its square
        where the linearization takes that as a formula, is no number.
    """
    if not isinstance(value, Linearization):
        raise TypeError(f"linearization: wanted a Linearization, got {value!r}")
    mean, variance = np.abs(system.mean0), np.abs(np.diagonal(system.cov0))
    scale = np.maximum(mean, np.sqrt(variance))
    if ((scale > NARROW) | (scale == 0)).all():
        return value
    maps = [
        part
        for name in ("dynamics", "drift_map", "spread_map", "sensor", "sensors")
        for part in _listed(getattr(system, name, ()))
    ]
    for map in maps:
        if map.symbolic and (least := _least_product(map, scale)) is not None:
            power, digits = least
            if digits * value.products < math.log10(sys.float_info.min):
                raise ValueError(
                    "mean0, cov0: wanted units of the state in which products of it are numbers, "
                    f"got {power} of about 1e{digits:.0f}"
                    + (", which is squared" if value.products > 1 else "")
                )
    return value


def _listed(part: Any) -> Any:
    return (part,) if isinstance(part, StochasticMap) else part


def _least_product(map: StochasticMap, scale: np.ndarray) -> Any:
    """The least product of several state components in a map, and its decimal logarithm."""
    import sympy

    logs = {x: math.log10(s) for x, s in zip(map.state, scale, strict=True) if s > 0}
    least = None
    nodes = (node for e in map.expressions for node in sympy.preorder_traversal(e))
    for part in (node for node in nodes if isinstance(node, sympy.Expr)):
        factors = [f.as_base_exp() for f in sympy.Mul.make_args(part) if f.free_symbols & set(logs)]
        powers = [(b, float(e)) for b, e in factors if e.is_Rational and e > 0]
        if sum(e for _, e in powers) < 2:
            continue
        digits = sum(e * max((logs[x] for x in b.free_symbols & set(logs)), default=0.0)
                     for b, e in powers if not b.is_Function)  # fmt: skip
        if least is None or digits < least[1]:
            least = sympy.Mul(*(b**e for b, e in factors)), digits
    return least
