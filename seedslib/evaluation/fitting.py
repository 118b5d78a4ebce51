"""Parameters of a model from data: the maximum of the likelihood that a filter gives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from scipy.special import ndtri

from seedslib.base.parameters import Parameter
from seedslib.base.values import Inputs
from seedslib.filters.base import Filter

STEP = 1e-3
"""Step of the differences that derivatives are taken by."""

CONVERGED = 1e-6
"""The log-likelihood is expected to rise by less than this."""

FLAT = 1e-5
"""Curvatures below this part of those along the axes are rounding."""

WORST = 1e200
"""Stands for a likelihood that is zero or no number."""


@dataclass(frozen=True)
class Fit:
    """Parameters of largest likelihood.

    Attributes
    ----------
    parameters : tuple of Parameter
    values : ndarray, shape (p,)
        Where the likelihood is largest.
    cov : ndarray, shape (p, p)
        Inverse of the observed information; NaN where that is not positive definite.
    loglik : float
    converged : bool
        Whether the log-likelihood is expected to rise by less than 1e-6 from here, and curves
        down in all directions.
    message : str
        Why not, or nothing.
    evaluations : int
        Likelihoods that were computed.
    """

    parameters: tuple[Parameter, ...]
    values: np.ndarray
    cov: np.ndarray
    loglik: float
    converged: bool
    message: str
    evaluations: int
    _likelihood: Any = field(repr=False, compare=False)

    @property
    def errors(self) -> np.ndarray:
        """Standard errors, shape (p,)."""
        return np.sqrt(np.diagonal(self.cov))

    def interval(self, level: float = 0.95) -> np.ndarray:
        """Intervals of this coverage for large samples, shape (p, 2); from the curvature."""
        width = ndtri(0.5 + 0.5 * level) * self.errors
        return np.stack([self.values - width, self.values + width], axis=-1)

    @property
    def numbers(self) -> dict[Parameter, float]:
        """The values by parameter, as ``filter.bind(fit.numbers)`` takes them."""
        return dict(zip(self.parameters, self.values.tolist(), strict=True))

    def profile(self, parameter: Parameter, points: Iterable[float]) -> np.ndarray:
        """Largest log-likelihood for each of some values of one parameter, the others free.

        Raises
        ------
        ValueError
            A parameter that was not fitted, a point that is not positive where it has to be.
        """
        if parameter not in self.parameters:
            raise ValueError(f"parameter: wanted one that was fitted, got {parameter}")
        axis, values, logliks = self.parameters.index(parameter), self.values.copy(), []
        u = self._likelihood.free(values)
        others = [k for k in range(len(u)) if k != axis]
        for values[axis] in points:
            u[axis] = self._likelihood.free(values)[axis]
            u, loglik = self._likelihood.climb(u, others)
            logliks.append(loglik)
        return np.array(logliks)

    def __str__(self) -> str:
        rows = zip(self.parameters, self.values, self.errors, strict=True)
        lines = [f"{p!s:>12} {value:14.6g} +- {error:.3g}" for p, value, error in rows]
        state = "converged" if self.converged else f"not converged: {self.message}"
        return "\n".join([*lines, f"log-likelihood {self.loglik:.6f}, {state}"])


def fit(
    filter: Filter | Callable[[dict[Parameter, float]], Filter],
    times: ArrayLike,
    measurements: ArrayLike,
    free: Sequence[Parameter],
    *,
    indicators: ArrayLike | None = None,
    inputs: Inputs | None = None,
) -> Fit:
    """Fit parameters of a model to records by the likelihood of a filter.

    Derivatives, first and second, are differences of fourth order, and all the likelihoods that
    they need are computed as one batch of paths, each with its own parameters; nothing is compiled
    again. The maximum is found by Newton's method in a region of trust, from where the parameters
    stand; positive parameters are varied by their logarithms.

    Parameters
    ----------
    filter : Filter, or callable
        One that gives a log-likelihood, of a model whose formulas mention the parameters; or a
        function of their numbers, as `bind` takes them, that makes it, where a filter cannot have
        a number for each record (a chain on a grid). That is called for every value, without a
        batch.
    times : array_like, shape (K+1,)
    measurements : array_like, shape (K+1, m) or (K+1, m, series)
        Of one record, or of many with the same parameters.
    free : sequence of Parameter
    indicators : array_like of int, shape (K+1) or (K+1, series), optional
        Of a system with modes that has one.
    inputs : mapping of Input to array_like, shape (K+1,) or (K+1, series), optional
        As `run` of the filter.

    Returns
    -------
    Fit

    Raises
    ------
    TypeError, ValueError
        No parameters, a positive one that starts at zero, a filter without a likelihood, a
        likelihood that is zero at the start.
    """
    likelihood = _Likelihood(filter, times, measurements, tuple(free), indicators, inputs)
    u, loglik = likelihood.climb(likelihood.free(likelihood.start))
    if loglik <= -WORST:
        raise ValueError("free: the likelihood is zero, or no number, at the start")
    return likelihood.maximum(u)


class _Likelihood:
    """A log-likelihood as a function of free numbers u, many points at once."""

    def __init__(self, filter, times, measurements, parameters, indicators, inputs):
        if not parameters or not all(isinstance(p, Parameter) for p in parameters):
            raise TypeError(f"free: wanted parameters of the model, got {parameters!r}")
        system = getattr(filter, "system", None)
        strange = [p for p in parameters if system is not None and p not in system.parameters]
        if strange:
            raise ValueError(f"free: wanted parameters of the model, got {strange[0]}")
        self.filter, self.times, self.parameters = filter, times, parameters
        bound = getattr(system, "numbers", {})
        self.start = [bound.get(p, p.value) for p in parameters]
        # a batch is as quick with second derivatives as without
        self.batch = isinstance(filter, Filter)
        self.positive = np.array([bool(p.is_positive) for p in parameters])
        y = np.asarray(measurements, dtype=float)
        self.y = y[..., None] if y.ndim == 2 else y
        self.indicators = indicators
        if indicators is not None:
            self.indicators = np.asarray(indicators).reshape(len(self.y), -1)
        self.inputs = {u: np.asarray(part) for u, part in dict(inputs or {}).items()}
        self.evaluations = 0

    def free(self, values: ArrayLike) -> np.ndarray:
        """Numbers u (p,) without bounds for parameters: logarithms of those that are positive."""
        values = np.array(values, dtype=float)
        for k in np.flatnonzero(self.positive & ~(values > 0)):
            name = self.parameters[k]
            raise ValueError(f"{name}: wanted a positive value to start from, got {values[k]:g}")
        return np.where(self.positive, np.log(np.where(self.positive, values, 1.0)), values)

    def values(self, u):
        """Parameters (p, ...) of free numbers (p, ...)."""
        return np.array([np.exp(v) if p else v for p, v in zip(self.positive, u, strict=True)])

    def loglik(self, points: np.ndarray) -> np.ndarray:
        """Log-likelihood at each of the points (p, count)."""
        self.evaluations += points.shape[1]
        with np.errstate(all="ignore"):
            values = self.values(points)
            if self.batch:
                count, series = points.shape[1], self.y.shape[2]
                filter = self.filter.bind(self._numbers(np.repeat(values, series, axis=1)))
                logliks = self._run(filter, count).reshape(count, series).sum(axis=1)
            else:
                made = (self.filter(self._numbers(v)) for v in values.T.tolist())
                logliks = np.array([self._run(filter, 1).sum() for filter in made])
        return np.where(np.isfinite(logliks), logliks, -WORST)

    def _numbers(self, values):
        return dict(zip(self.parameters, values, strict=True))

    def _run(self, filter, count):
        """Log-likelihood of each record, all records `count` times beside each other."""
        options: dict[str, Any] = {"indicators": self.indicators}
        if self.indicators is not None:
            options["indicators"] = np.tile(self.indicators, (1, count))
        if self.inputs:
            options["inputs"] = {
                u: v if v.ndim == 1 else np.tile(v, (1, count)) for u, v in self.inputs.items()
            }
        loglik = filter.run(self.times, np.tile(self.y, (1, 1, count)), **options).loglik
        if loglik is None:
            raise ValueError(f"filter: {filter!r} gives no likelihood")
        return loglik.sum(axis=0)

    def climb(self, u: np.ndarray, along: Sequence[int] | None = None) -> tuple[np.ndarray, float]:
        """A maximum near u, in some of the numbers."""
        along, u = list(range(len(u)) if along is None else along), u.copy()

        @lru_cache(maxsize=4)
        def down(key):
            u[along] = np.frombuffer(key)
            value, slopes, curvature = derivatives(self.loglik, u, along, self.batch)
            return -value, -slopes, None if curvature is None else -curvature

        def part(which):
            return lambda free: down(np.ascontiguousarray(free, dtype=float).tobytes())[which]

        if along:
            method = (
                {"method": "trust-exact", "hess": part(2)} if self.batch else {"method": "BFGS"}
            )
            best = minimize(part(0), u[along], jac=part(1), options={"gtol": 1e-5}, **method)
            u[along] = best.x
        return u, float(self.loglik(u[:, None])[0])

    def maximum(self, u: np.ndarray) -> Fit:
        """The maximum, polished by Newton's steps, with its errors and whether it is one."""
        every = range(len(u))
        loglik, slopes, curvature = derivatives(self.loglik, u, every)
        for _ in range(4):
            definite = _is_negative(curvature)
            if not definite:
                break
            step = np.linalg.solve(curvature, slopes)
            later = derivatives(self.loglik, u - step, every)
            if not later[0] > loglik:
                break
            u, (loglik, slopes, curvature) = u - step, later
        values, cov = self.values(u), np.full((len(u), len(u)), np.nan)
        if definite:
            rise = -0.5 * slopes @ np.linalg.solve(curvature, slopes)
            message = "" if rise < CONVERGED else f"the log-likelihood can rise by about {rise:.2g}"
            slope = (self.values(u + STEP) - self.values(u - STEP)) / (2 * STEP)
            cov = np.linalg.inv(-curvature) * np.outer(slope, slope)
        else:
            message = "the log-likelihood does not curve down: too many parameters"
        return Fit(
            self.parameters,
            values,
            cov,
            float(loglik),
            not message,
            message,
            self.evaluations,
            self,
        )


def _is_negative(curvature: np.ndarray) -> bool:
    """Whether a curvature is negative in all directions, by more than its differences are wrong."""
    size = np.sqrt(np.abs(np.diagonal(curvature)))
    if not np.all(size > 0):
        return False
    return bool(np.linalg.eigvalsh(curvature / np.outer(size, size)).max() < -FLAT)


def derivatives(
    function: Callable[[np.ndarray], np.ndarray],
    u: np.ndarray,
    along: Sequence[int],
    second: bool = True,
) -> tuple[Any, np.ndarray, np.ndarray | None]:
    """Value, slopes (q,) and second derivatives (q, q) along q axes, of fourth order in the step.

    Parameters
    ----------
    function : callable
        Of points (p, N), gives values (N,); it is called once.
    u : ndarray, shape (p,)
    along : sequence of int, length q
    second : bool
        Whether second derivatives are wanted.
    """
    q, axes = len(along), np.eye(len(u))[list(along)]
    pairs = [(i, i) for i in range(q)] + list(combinations(range(q), 2)) if second else []
    # ends of a step along each axis, and corners of squares of one and two steps along each pair
    ends = np.array([[1.0], [-1.0], [2.0], [-2.0]])
    corners = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    points = [np.zeros((1, len(u))), *(ends * axis for axis in axes)]
    points += [size * corners @ axes[[i, j]] for i, j in pairs for size in (1, 2)]
    values = function(u[:, None] + STEP * np.concatenate(points).T)
    one, back, two, far = values[1 : 4 * q + 1].reshape(q, 4).T
    slopes = (8 * (one - back) - (two - far)) / (12 * STEP)
    if not second:
        return values[0], slopes, None
    fine, coarse = (values[4 * q + 1 :].reshape(-1, 2, 4) @ [1, -1, -1, 1] / (4 * STEP**2)).T
    curvature = np.empty((q, q))
    for (i, j), part in zip(pairs, (4 * fine - coarse / 4) / 3, strict=True):
        curvature[i, j] = curvature[j, i] = part
    return values[0], slopes, curvature
