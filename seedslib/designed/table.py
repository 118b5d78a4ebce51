"""Filters that look their estimates up: the optimal functions of theorem 1 as tables or fits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seedslib.base.tables import Axis, interpolate
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.finite_order_rules import FiniteOrderState, Rules
from seedslib.designed.prediction import held_out_words, with_held_out
from seedslib.designed.summary import ROWS
from seedslib.filters.estimates import Estimates


class TableFit(NamedTuple):
    """A function of several arguments by multilinear interpolation, constant beyond its ends.

    Attributes
    ----------
    axes : tuple of Axis
    values : ndarray, shape (n', count of each axis...)
    """

    axes: tuple[Axis, ...]
    values: np.ndarray

    def __call__(self, *arguments: np.ndarray) -> np.ndarray:
        """Value (n', *batch) at arguments (size, *batch) whose components follow the axes."""
        return interpolate(self.values, self.axes, [part for a in arguments for part in a])

    def mean(self, u: np.ndarray) -> np.ndarray:
        """Forecast (n', *batch) from the memory (d, *batch)."""
        return self(u)

    def forecast(self, u: np.ndarray) -> tuple[np.ndarray, None]:
        """Forecast (n', *batch); a table of means knows no covariance."""
        return self(u), None


@dataclass(frozen=True)
class Table:
    """Estimates and forecasts by tables over the measurement and the memory.

    Attributes
    ----------
    measurement : tuple of Axis
        One for each component of a measurement.
    memory : tuple of Axis
        One for each component of a block of the memory.
    method : str
        How the tables were made.
    """

    measurement: tuple[Axis, ...]
    memory: tuple[Axis, ...]
    method: str

    def __str__(self) -> str:
        return (
            f"tables ({self.method}) over measurements ({_listed(self.measurement)}) "
            f"and memory ({_listed(self.memory)})"
        )


@dataclass(frozen=True)
class OutputRules(Rules):
    """What a filter holds whose output functions f_k(y, u) are known as wholes.

    Attributes
    ----------
    outputs : tuple of callable
        ``f(y, u) -> (n', *batch)`` for each measurement; the first has an empty memory,
        (0, *batch).
    covariances : ndarray, shape (K+1, n', n')
        Error covariances that the design found.
    """

    outputs: tuple[Callable, ...] = ()
    covariances: np.ndarray | None = None


class OutputFilter(FiniteOrderFilter):
    """Finite-order filter whose estimate is any function of measurement and memory.

    Z_k = f_k(Y_k, U_{k-1}) and Z_k^i = g_k^i(U_k), theorem 1 of the jump-diffusion paper. The
    verbs are those of `FiniteOrderFilter`; there is no likelihood, and the covariance is the
    unconditional one that the design found, NaN from a missing measurement on.
    """

    def output(self, k: int, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        """f_k(y, u), (n', *batch), for y (m, *batch) and the memory u (d, *batch).

        Batch axes may be any that broadcast; at k = 0 the memory is empty, (0, *batch).
        """
        return self.rules.outputs[k](y, u)

    @property
    def expect(self):
        """Not there: the filter forecasts no moments of the measurement."""
        raise AttributeError("expect: this filter forecasts no moments of the measurement")

    def _correct(self, state, y, spread) -> FiniteOrderState:
        """State after a measurement; a missing one leaves the forecast, which is exact."""
        if state.index < 0 or state.corrected:
            raise ValueError("state: wanted a forecast, got a state without; call predict first")
        k, mean = state.index, state.mean[: self.components]
        lost = np.isnan(y)
        missing = lost.all(axis=0)
        if lost.any() and not np.array_equal(lost.any(axis=0), missing):
            raise ValueError("y: wanted all components of a measurement or none, got some NaN")
        u = state.past.vector if k else np.empty((0, *y.shape[1:]))
        if not missing.any():
            mean = self.rules.outputs[k](y, u)
        elif not missing.all():
            mean = np.where(missing, mean, self.rules.outputs[k](np.where(lost, 0.0, y), u))
        if missing.any() and self.memory.measurements:
            raise ValueError("y: wanted a measurement, it is to be remembered; got NaN")
        past = self.memory.push(state.past, estimate=mean, measurement=y)
        cov = self.rules.covariances[k] if spread else None
        if spread and missing.any():  # the design knows the error with the measurement only
            cov = np.where(missing, np.nan, cov.reshape(*cov.shape, *(1,) * missing.ndim))
        return state._replace(
            mean=mean, cov=cov, past=past, measurement=y, loglik=np.nan, corrected=True
        )

    def run(self, times, measurements, *, covariances=False, workers=1) -> Estimates:
        """Filter a record, or many at once: as `FiniteOrderFilter.run`, without likelihoods.

        A measurement is missing as a whole or not at all.

        Raises
        ------
        TypeError, ValueError
            As there; also for a measurement of which some components are NaN, and for a missing
            one that the memory wants.
        """
        found = super().run(times, measurements, covariances=covariances, workers=workers)
        return found._replace(loglik=None)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of order {self.order}: {self.memory}; {self.predictor}>"

    def __str__(self) -> str:
        predicted, times = self.predicted, self.times
        made = "exact moments or densities on a grid, without random numbers"
        if not self.design.exact:
            made = f"{self.design.paths} paths, seed {self.design.entropy}"
        lines = [
            f"Finite-order filter of order {self.order}: {self.memory}",
            f"  estimates    {self.components} of {len(self.start.mean)} state components",
            f"  by           {self.predictor}",
            f"  measurements {len(times)}, from {times[0]:g} to {times[-1]:g}",
            f"  designed on  {made}",
            "  predicted root-mean-square errors"
            + ("" if self.design.exact else " (with standard errors)"),
            *held_out_words(self.held_out),
        ]
        at = self.clock.rows(predicted.times)
        shown = np.arange(len(at))
        if len(at) > ROWS:
            shown = np.linspace(0, len(at) - 1, ROWS).astype(int)
        for k, j in zip(shown, at[shown], strict=True):
            row = "  ".join(
                f"{rms:.4f}" + ("" if self.design.exact else f" ± {error:.4f}")
                for rms, error in zip(predicted.rms[j], predicted.error[j], strict=True)
            )
            row = f"    t = {predicted.times[j]:<8g} {row}"
            lines += with_held_out(row, self.held_out, k)
        return "\n".join(lines)


class TableFilter(OutputFilter):
    """Optimal filter of finite order as tables; `seedslib.design` makes it.

    Examples
    --------
    >>> from seedslib.design import grid_synthesis
    >>> from seedslib.designed.memory import large_order
    >>> from seedslib import zoo
    >>> filter = grid_synthesis(
    ...     zoo.flip_process(), large_order(1), [0.0, 0.25, 0.5],
    ...     x=(-3.5, 3.5, 141), z=(-3, 3, 121), y=(-8, 8, 121),
    ... )
    >>> filter.order
    1
    """

    @property
    def bytes(self) -> int:
        """Memory of the tables."""
        parts = [*self.rules.outputs, *self.fits, *(f for row in self.node_fits for f in row)]
        return sum(part.values.nbytes for part in parts)


def _listed(axes):
    return "; ".join(map(str, axes))
