"""Parameters of a model from data: the maximum of the likelihood that a filter gives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from scipy.special import ndtri

from seedslib.base.checks import as_count
from seedslib.base.parameters import Parameter
from seedslib.base.values import Inputs, assigned
from seedslib.evaluation.differences import Local, derivatives
from seedslib.evaluation.scales import Scale
from seedslib.filters.verbs import Filter
from seedslib.models.kinds import mentioned

LEFT = 1e-6
"""Converged: the log-likelihood is expected to rise by less than this."""

FLAT = 1e-5
"""Curvatures below this part of those along the axes are rounding."""

WORST = 1e200
"""Stands for a likelihood that is zero or no number."""

Bounds: TypeAlias = tuple[float, float]


@dataclass(frozen=True)
class Fit:
    """What was found.

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
    tried : ndarray, shape (starts, p + 1)
        Parameters and log-likelihood that each start came to.
    evaluations : int
        Likelihoods that were computed.
    """

    parameters: tuple[Parameter, ...]
    values: np.ndarray
    cov: np.ndarray
    loglik: float
    converged: bool
    message: str
    tried: np.ndarray
    evaluations: int
    _problem: Any = field(repr=False, compare=False)

    @property
    def errors(self) -> np.ndarray:
        """Standard errors, shape (p,)."""
        return np.sqrt(np.diagonal(self.cov))

    def interval(self, level: float = 0.95) -> np.ndarray:
        """Intervals of this coverage for large samples, shape (p, 2); from the curvature."""
        width = ndtri(0.5 + 0.5 * level) * self.errors
        return np.stack([self.values - width, self.values + width], axis=-1)

    def assigned(self) -> AbstractContextManager[None]:
        """``with fit.assigned():`` gives the parameters the values that were found."""
        return assigned(dict(zip(self.parameters, self.values.tolist(), strict=True)))

    def profile(self, parameter: Parameter, points: Iterable[float]) -> np.ndarray:
        """Largest log-likelihood for each of some values of one parameter, the others free.

        Raises
        ------
        ValueError
            A parameter that was not fitted, a point out of its bounds.
        """
        if parameter not in self.parameters:
            raise ValueError(f"parameter: wanted one that was fitted, got {parameter}")
        return self._problem.profile(self.parameters.index(parameter), self.values, points)

    def __str__(self) -> str:
        rows = zip(self.parameters, self.values, self.errors, strict=True)
        lines = [f"{p!s:>12} {value:14.6g} +- {error:.3g}" for p, value, error in rows]
        state = "converged" if self.converged else f"not converged: {self.message}"
        return "\n".join([*lines, f"log-likelihood {self.loglik:.6f}, {state}"])


def fit(
    filter: Filter | Callable[[], Filter], times: ArrayLike, measurements: ArrayLike,
    free: Sequence[Parameter], *, bounds: Mapping[Parameter, Bounds] | None = None,
    starts: int = 1, seed: int = 0, indicators: ArrayLike | None = None,
    inputs: Inputs | None = None,
) -> Fit:  # fmt: skip
    """Fit parameters of a model to records by the likelihood of a filter.

    Derivatives, first and second, are differences of fourth order, and all the likelihoods that
    they need are computed as one batch of paths, each with its own parameters; nothing is compiled
    again. The maximum is found by Newton's method in a region of trust.

    Parameters
    ----------
    filter : Filter, or callable
        One that gives a log-likelihood, of a model whose formulas mention the parameters; or a
        function without arguments that makes it, where a filter takes in the values when it is
        made (a chain on a grid). That is called for every value, without a batch.
    times : array_like, shape (K+1,)
    measurements : array_like, shape (K+1, m) or (K+1, m, series)
        Of one record, or of many with the same parameters.
    free : sequence of Parameter
    bounds : mapping of Parameter to (low, high), optional
        By default positive parameters are above zero, and the others anywhere.
    starts : int
        The first start is where the parameters stand, further ones are drawn about it.
    seed : int
        Of the further starts.
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
        No parameters, a start out of its bounds, a filter without a likelihood, a likelihood that
        is zero at all starts.
    """
    problem = _Problem(filter, times, measurements, tuple(free), bounds or {}, indicators, inputs)
    rng = np.random.default_rng(seed)
    spread = rng.normal(size=(as_count("starts", starts) - 1, len(problem.scales)))
    first = problem.start()
    found = [problem.climb(u) for u in (first, *(first + spread))]
    tried = np.array([[*problem.values(u), loglik] for u, loglik in found])
    best, loglik = max(found, key=lambda pair: pair[1])
    if loglik <= -WORST:
        raise ValueError("free: the likelihood is zero, or no number, at every start")
    return problem.judged(best, tried)


class _Problem:
    """A log-likelihood as a function of free numbers, many points at once."""

    def __init__(self, filter, times, measurements, parameters, bounds, indicators, inputs):
        if not parameters or not all(isinstance(p, Parameter) for p in parameters):
            raise TypeError(f"free: wanted parameters of the model, got {parameters!r}")
        if unknown := set(bounds) - set(parameters):
            raise ValueError(f"bounds: wanted those of free parameters, got {unknown}")
        system = getattr(filter, "system", None)
        strange = [p for p in parameters if p not in mentioned(system)]
        if system is not None and strange:
            raise ValueError(f"free: wanted parameters of the model, got {strange[0]}")
        self.filter, self.times, self.parameters = filter, times, parameters
        y = np.asarray(measurements, dtype=float)
        self.y = y[..., None] if y.ndim == 2 else y
        self.seen = None
        if indicators is not None:
            self.seen = np.asarray(indicators).reshape(len(self.y), -1)
        self.told = {u: np.asarray(part) for u, part in dict(inputs or {}).items()}
        anywhere = {p: (0.0 if p.is_positive else -np.inf, np.inf) for p in parameters}
        self.scales = [Scale(*(anywhere | dict(bounds))[p]) for p in parameters]
        self.evaluations = 0

    def start(self) -> np.ndarray:
        return np.array(
            [s.free(p.value) for s, p in zip(self.scales, self.parameters, strict=True)]
        )

    def values(self, u):
        """Parameters (p, ...) of free numbers (p, ...)."""
        return np.stack([s.value(part) for s, part in zip(self.scales, u, strict=True)])

    def loglik(self, points: np.ndarray) -> np.ndarray:
        """Log-likelihood at each of the points (p, count)."""
        self.evaluations += points.shape[1]
        with np.errstate(all="ignore"):
            values = self.values(points)
            if isinstance(self.filter, Filter):
                found = self._batch(values)
            else:
                found = np.array([self._one(column) for column in values.T])
        return np.where(np.isfinite(found), found, -WORST)

    def _batch(self, values):
        count, series = values.shape[1], self.y.shape[2]
        repeated = np.repeat(values, series, axis=1)
        seen = None if self.seen is None else np.tile(self.seen, (1, count))
        told = {u: v if v.ndim == 1 else np.tile(v, (1, count)) for u, v in self.told.items()}
        found = self._run(self.filter, repeated, np.tile(self.y, (1, 1, count)), seen, told)
        return found.reshape(count, series).sum(axis=1)

    def _one(self, values):
        return self._run(None, values, self.y, self.seen, self.told).sum()

    def _run(self, filter, values, y, seen, told):
        """Log-likelihood of each record, with a filter that is made where there is None."""
        with assigned(dict(zip(self.parameters, values, strict=True))):
            filter = self.filter() if filter is None else filter
            own = {"inputs": told} if told else {}
            found = filter.run(self.times, y, indicators=seen, **own).loglik
        if found is None:
            raise ValueError(f"filter: {filter!r} gives no likelihood")
        return found.sum(axis=0)

    def local(self, u: np.ndarray, along: Sequence[int], bend: bool = True) -> Local:
        """Log-likelihood at u with its derivatives."""
        return derivatives(self.loglik, u, along, bend)

    def climb(self, u: np.ndarray, along: Sequence[int] | None = None) -> tuple[np.ndarray, float]:
        """A maximum near u, in some of the numbers."""
        along, u = list(range(len(u)) if along is None else along), u.copy()
        # a batch is as quick with second derivatives as without
        batch = isinstance(self.filter, Filter)

        @lru_cache(maxsize=4)
        def down(key):
            u[along] = np.frombuffer(key)
            value, slopes, bend = self.local(u, along, batch)
            return -value, -slopes, None if bend is None else -bend

        def part(which):
            return lambda free: down(np.ascontiguousarray(free, dtype=float).tobytes())[which]

        if along:
            method = {"method": "trust-exact", "hess": part(2)} if batch else {"method": "BFGS"}
            best = minimize(part(0), u[along], jac=part(1), options={"gtol": 1e-5}, **method)
            u[along] = best.x
        return u, float(self.loglik(u[:, None])[0])

    def profile(self, axis, values, points):
        u = np.array([s.free(v) for s, v in zip(self.scales, values, strict=True)])
        others, found = [k for k in range(len(u)) if k != axis], []
        for point in points:
            u[axis] = self.scales[axis].free(float(point))
            found.append(self.climb(u, others)[1])
        return np.array(found)

    def judged(self, u: np.ndarray, tried: np.ndarray) -> Fit:
        """The maximum, polished by Newton's steps, with its errors and whether it is one."""
        every = range(len(u))
        loglik, slopes, bend = self.local(u, every)
        for _ in range(4):
            definite = _bends_down(bend)
            if not definite:
                break
            step = np.linalg.solve(bend, slopes)
            later = self.local(u - step, every)
            if not later[0] > loglik:
                break
            u, (loglik, slopes, bend) = u - step, later
        left = -0.5 * slopes @ np.linalg.solve(bend, slopes) if definite else np.inf
        cov = np.full((len(u), len(u)), np.nan)
        message = "" if left < LEFT else f"the log-likelihood can rise by about {left:.2g}"
        if definite:
            turn = np.diag([s.slope(part) for s, part in zip(self.scales, u, strict=True)])
            cov = turn @ np.linalg.inv(-bend) @ turn
        else:
            message = "the log-likelihood does not curve down: too many parameters"
        return Fit(
            self.parameters, self.values(u), cov, float(loglik), not message, message, tried,
            self.evaluations, self,
        )  # fmt: skip


def _bends_down(bend: np.ndarray) -> bool:
    """Whether a curvature is negative in all directions, by more than its differences are wrong."""
    size = np.sqrt(np.abs(np.diagonal(bend)))
    if not np.all(size > 0):
        return False
    return bool(np.linalg.eigvalsh(bend / np.outer(size, size)).max() < -FLAT)
