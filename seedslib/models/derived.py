"""Maps made of maps: of two states at once, and of products whose means are moments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from seedslib.models.maps import StochasticMap


def doubled(map: StochasticMap) -> StochasticMap:
    """The same map of a state of twice the size, of which it sees the second half."""
    n = map.state_size
    if map.symbolic:
        import sympy

        before = sympy.symbols(f"before1:{n + 1}", cls=sympy.Dummy, real=True)
        return StochasticMap([*before, *map.state], map.expressions, map.noise, time=map.time)
    value, given = map.value, map.__dict__.get("conditional")
    return StochasticMap.from_functions(
        2 * n, map.size, _of_half(value, n), map.noise,
        mean=given and _of_half(given.mean, n), cov=given and _of_half(given.cov, n),
    )  # fmt: skip


def products(map: StochasticMap) -> StochasticMap:
    """Map of the products (w, w x, w y, w x xᵀ, w x yᵀ, w y yᵀ), symmetric ones lower.

    Their plain means are the raw moments in the branch.
    """
    n, m = map.state_size, map.size

    def terms(w, x, y):
        pairs = [
            *(x[i] * x[j] for i in range(n) for j in range(i + 1)),
            *(x[i] * y[j] for i in range(n) for j in range(m)),
            *(y[i] * y[j] for i in range(m) for j in range(i + 1)),
        ]
        return [w, *(w * part for part in (*x, *y, *pairs))]

    if map.symbolic:
        value = terms(map.weight_expression, map.state, map.expressions)
        return StochasticMap(map.state, value, map.noise, time=map.time)

    def value(t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.stack(terms(map.weight(t, x, v), x, map.value(t, x, v)))

    size = (n + m + 1) * (n + m + 2) // 2  # pairs of (1, x, y)
    return StochasticMap.from_functions(n, size, value, map.noise)


def _of_half(function: Callable[..., Any], n: int) -> Callable[..., Any]:
    return lambda t, x, *rest: function(t, x[n:], *rest)
