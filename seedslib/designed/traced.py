"""Moments of the sensor and correction in one straight line of code.

The lines of `seedslib.base.correction` run once on symbols; what comes out is compiled together
with the formulas of the sensor's moments, for one path at a time: there the interpreter's work on
arrays of two numbers is most of the time. For many paths it gains nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from seedslib.base.correction import correct
from seedslib.base.semidefinite import ABSOLUTE, RELATIVE, WIDE
from seedslib.linearization.moments import Linearization, symmetric
from seedslib.models.kinds import AnySystem
from seedslib.models.maps import StochasticMap

LARGEST_STATE = 4
LARGEST_MEASUREMENT = 2

WIDEST = 1e140
"""Variances up to this and from its reciprocal: squares of covariances stay numbers."""


def traced_correction(
    map: StochasticMap, linearization: Linearization, rows: int
) -> TracedCorrection | None:
    """A `TracedCorrection`, or None where there are no formulas or they would be long."""
    small = map.state_size <= LARGEST_STATE and map.size <= LARGEST_MEASUREMENT
    if not (small and map.symbolic and hasattr(linearization, "formulas")):
        return None
    return TracedCorrection(map, linearization, rows)


def mean_velocity(system: AnySystem, linearization: Linearization) -> Callable[..., Any]:
    """E b(t, X) for X ~ N(mean, cov), as ``f(t, mean components, cov) -> components``.

    The covariance is common to all paths, (n, n).
    """
    if not (system.symbolic and hasattr(linearization, "formulas")):
        moments = linearization.moments(system.drift_map, spread=False)
        return lambda t, mean, cov: list(moments(t, np.stack(mean), cov).mean)
    from seedslib.models.codegen import compile_components

    mean, lower, cov = law_symbols(system.state_size)
    velocity = linearization.formulas(system.drift_map, list(mean), cov, spread=False)[0]
    evaluate = compile_components((system.time, mean, lower), list(velocity))
    return lambda t, mean, cov: evaluate(t, mean, _lower(cov))


def law_symbols(n: int) -> tuple[Any, ...]:
    """Symbols of a mean, of a covariance on and below the diagonal, and that covariance (n, n)."""
    import sympy

    mean = sympy.symbols(f"m:{n}", cls=sympy.Dummy, real=True)
    lower = sympy.symbols(f"P:{n * (n + 1) // 2}", cls=sympy.Dummy, real=True)
    return mean, lower, sympy.Matrix(symmetric(np.array(lower, dtype=object), n))


def _moderate(variance):
    return 1 / WIDEST < variance < WIDEST


def _lower(cov):
    """Entries of a matrix on and below the diagonal, row by row, as numbers."""
    return [row[j] for i, row in enumerate(cov.tolist()) for j in range(i + 1)]


class TracedCorrection:
    """Correction of one path by a complete measurement, see `seedslib.base.correct`.

    Parameters
    ----------
    map : StochasticMap
        The sensor.
    linearization : Taylor or ExactGaussian
        Anything with `formulas`.
    rows : int
        Leading components of the state to correct.
    """

    def __init__(self, map: Any, linearization: Linearization, rows: Any) -> None:
        self.map: Any = map
        self.linearization: Linearization = linearization
        self.rows: Any = rows

    @cached_property
    def _mean(self):
        return self._compiled(False)

    @cached_property
    def _mean_and_cov(self):
        return self._compiled(True)

    def _compiled(self, spread):
        import sympy

        from seedslib.models.codegen import compile_components

        m, (mean, lower, cov) = self.map.size, law_symbols(self.map.state_size)
        y = sympy.symbols(f"y:{m}", cls=sympy.Dummy, real=True)
        parts = self.linearization.formulas(self.map, list(mean), cov)
        h, cross, sensed = (np.array(part.tolist(), dtype=object) for part in parts)
        corrected = correct(
            np.array(mean, dtype=object), np.array(cov) if spread else None,
            np.array(y, dtype=object),
            (h[:, 0], cross, sensed), self.rows,
        )  # fmt: skip
        # how far each component of the measurement is from being a function of those before it
        pivots = [sensed[0, 0]]
        if m == 2:
            pivots.append(sensed[1, 1] - sensed[1, 0] ** 2 / sensed[0, 0])
        found = [*pivots, *np.diagonal(sensed), *corrected[0], corrected[2]]
        if spread:
            found += list(corrected[1][np.tril_indices(self.rows)])
        if any(entry.has(sympy.zoo, sympy.nan, sympy.oo) for entry in map(sympy.sympify, found)):
            return None  # a component of the measurement is always redundant
        return compile_components((self.map.time, mean, lower, y), found)

    def __call__(
        self, t: float, mean: np.ndarray, cov: np.ndarray, y: np.ndarray, spread: np.ndarray
    ) -> Any:
        """Mean (rows,), covariance (rows, rows) or None, and log-likelihood.

        None for a measurement with missing components, where a component is redundant, and where
        a variance falls too far or is out of the middle of the range of numbers; the general
        correction knows what to do then.
        """
        m, rows, shown = self.map.size, self.rows, y.tolist()
        if any(math.isnan(value) for value in shown):
            return None
        evaluate = self._mean_and_cov if spread else self._mean
        if evaluate is None:
            return None
        lower = _lower(cov)
        try:
            with np.errstate(all="ignore"):  # a pivot that is no number is found below
                found = evaluate(t, mean.tolist(), lower, shown)
        except ZeroDivisionError:
            return None
        for pivot, variance in zip(found[:m], found[m : 2 * m], strict=True):
            if not (pivot > RELATIVE * variance + ABSOLUTE and _moderate(variance)):
                return None
        estimate, loglik = np.array(found[2 * m : 2 * m + rows]), found[2 * m + rows]
        if not spread:
            return estimate, None, loglik
        rest = np.empty((rows, rows))
        entries = zip(found[2 * m + rows + 1 :], lower, strict=False)
        for i in range(rows):
            for j in range(i + 1):
                now, before = next(entries)
                rest[i, j] = rest[j, i] = now
            if now < WIDE * before or not (before == 0 or _moderate(before)):
                return None  # the noise has been rounded off, or numbers end
        return estimate, rest, loglik
