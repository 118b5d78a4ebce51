"""Parameters of a model from data: the maximum of the likelihood that a filter gives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from seedslib.base.checks import brief
from seedslib.base.progress import LOG, followed
from seedslib.base.symbols import Parameter
from seedslib.base.values import Inputs
from seedslib.filters.base import Filter

STEP = 1e-3
"""Step of the differences that derivatives are taken by."""

CONVERGED = 1e-6
"""The log-likelihood is expected to rise by less than this."""

FLAT = 1e-5
"""Curvatures below this part of those along the axes are rounding."""

BOUND = 1e-4
"""A positive parameter is at its bound where its logarithm is known by less information."""

FLATTEST = 1e-8
"""Curvatures below this part of the largest are taken for as much as that, in a step."""

NEAR = 1e-8
"""The step that is expected to rise by less is the last one."""

STEPS = 100
"""Steps uphill before one gives up."""

PATIENCE, GAIN = 15, 1e-4
"""So many steps that gain less than this together are the last."""

RADII = 1.0, 1e3, 1e-7
"""Length of the first step, of the longest, and of one that is too short to go on."""


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
        Why not, or nothing: a step that meets no number, a likelihood that is rough (of random
        numbers, as those of a particle filter), a positive parameter that goes to zero or grows
        without end, parameters that the data do not distinguish. They are named.
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
            u = self._likelihood.climb(u, others, self._likelihood.batch)
            logliks.append(float(self._likelihood.loglik(u[:, None])[0]))
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
    stand; positive parameters are varied by their logarithms, and steps that meet no number are
    shortened. A filter from `seedslib.export.compiled` gives the same likelihoods sooner.

    Parameters
    ----------
    filter : Filter, or callable
        One that gives a log-likelihood, of a model whose formulas mention the parameters; or a
        function of their numbers, as `bind` takes them, that makes it, where a filter cannot have
        a number for each record (a chain on a grid) or a parameter cannot stand in a formula.
        That is called for every value, without a batch.
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
        No filter, no parameters, a positive one that starts at zero, a filter without a
        likelihood, a likelihood that is zero or no number at the start.
    """
    if not isinstance(filter, Filter) and (hasattr(filter, "parameters") or not callable(filter)):
        raise TypeError(
            "filter: wanted a filter, such as KalmanFilter(system), or a function that makes it, "
            f"got {brief(filter)}"
        )
    if isinstance(free, Parameter):
        raise TypeError(f"free: wanted a sequence of parameters, got {free}; write [{free}]")
    likelihood = _Likelihood(filter, times, measurements, tuple(free), indicators, inputs)
    u, along = likelihood.free(likelihood.start), range(len(likelihood.parameters))
    if not likelihood.batch:  # second derivatives only where they pay
        u = likelihood.climb(u, along, False)
    return likelihood.maximum(likelihood.climb(u, along, True))


class _Likelihood:
    """A log-likelihood as a function of free numbers u, many points at once."""

    def __init__(self, filter, times, measurements, parameters, indicators, inputs):
        if not parameters or not all(isinstance(p, Parameter) for p in parameters):
            raise TypeError(f"free: wanted parameters of the model, got {brief(parameters)}")
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
        if y.ndim < 2:
            raise ValueError(f"measurements: wanted shape (K+1, m), got {y.shape}")
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
        first, self.evaluations = not self.evaluations, self.evaluations + points.shape[1]
        try:
            with np.errstate(all="ignore"):
                logliks = self._logliks(self.values(points))
        except (ValueError, ArithmeticError, np.linalg.LinAlgError):
            if first:  # what is wrong at the start is wrong everywhere
                self._logliks(self.values(points[:, :1]))
            return np.full(points.shape[1], np.nan)
        return np.where(np.isfinite(logliks), logliks, np.nan)

    def _logliks(self, values: np.ndarray) -> np.ndarray:
        """Log-likelihood of each of the values (p, count)."""
        if not self.batch:
            made = (self.filter(self._numbers(v)) for v in values.T.tolist())
            return np.array([self._run(filter, 1).sum() for filter in made])
        count, series = values.shape[1], self.y.shape[2]
        filter = self.filter.bind(self._numbers(np.repeat(values, series, axis=1)))
        return self._run(filter._for_likelihoods(), count).reshape(count, series).sum(axis=1)

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

    def climb(self, u: np.ndarray, along: Sequence[int], second: bool) -> np.ndarray:
        """A maximum near u, in some of the numbers; steps that meet no number are shortened.

        Raises
        ------
        ValueError
            The likelihood is zero or no number at the start.
        """
        along, (radius, longest, shortest) = list(along), RADII
        if not along:
            return u
        here = derivatives(self.loglik, u, along, second)
        if not _are_numbers(here):
            start = dict(zip(map(str, self.parameters), self.values(u).tolist(), strict=True))
            place = self._irregular(u) if np.isfinite(here[0]) else "it is zero or no number there"
            raise ValueError(f"free: wanted a start with a likelihood, got {start}; {place}")
        value, slopes, curvature = here
        curvature = -np.eye(len(along)) if curvature is None else curvature
        gained = [value]
        for number in followed(range(STEPS), "fit", lines=False):
            LOG.info("fit: step %d, log-likelihood %.6f at %s", number, value, self.values(u))
            step = uphill(slopes, curvature, radius)
            expected = slopes @ step + 0.5 * step @ curvature @ step
            there, later = u.copy(), None
            there[along] += step
            if not expected > NEAR + 1e-14 * abs(value):
                return there if self.loglik(there[:, None])[0] >= value else u
            stalled = number >= PATIENCE and value - gained[-PATIENCE] < GAIN
            if stalled or radius < shortest:
                break
            if self.batch or self.loglik(there[:, None])[0] > value:
                later = derivatives(self.loglik, there, along, second)
            rises = later is not None and _are_numbers(later) and later[0] > value
            part = (later[0] - value) / expected if rises else -1.0
            if part < 0.25:
                radius = 0.25 * min(radius, np.linalg.norm(step))
            elif part > 0.75:
                radius = min(max(radius, 2.0 * np.linalg.norm(step)), longest)
            if rises:
                if later[2] is None:  # a formula of rank one that gives the new slopes
                    missing = later[1] - slopes - curvature @ step
                    if abs(missing @ step) > 1e-8 * np.linalg.norm(missing) * np.linalg.norm(step):
                        curvature = curvature + np.outer(missing, missing) / (missing @ step)
                else:
                    curvature = later[2]
                u, value, slopes = there, later[0], later[1]
            gained.append(value)
        return u

    def maximum(self, u: np.ndarray) -> Fit:
        """The fit at a maximum, with its errors and whether it is one."""
        loglik, slopes, curvature = derivatives(self.loglik, u, range(len(u)))
        information = -np.diagonal(curvature)
        bound = self.positive & (np.abs(information) < BOUND)
        bound &= np.abs(u - self.free(self.start)) > 3.0
        values, cov = self.values(u), np.full((len(u), len(u)), np.nan)
        inside = np.flatnonzero(~bound)
        part, message = curvature[np.ix_(inside, inside)], ""
        definite = not len(inside) or _is_negative(part)
        if definite:
            rise = -0.5 * slopes[inside] @ np.linalg.solve(part, slopes[inside])
            if not rise < CONVERGED:
                message = f"the log-likelihood can rise by about {rise:.2g}"
            slope = (self.values(u + STEP) - self.values(u - STEP))[inside] / (2 * STEP)
            cov[np.ix_(inside, inside)] = np.linalg.inv(-part) * np.outer(slope, slope)
        if message or not definite:
            message = self._irregular(u) or message or self._flat(curvature, inside)
        for k in np.flatnonzero(bound):
            goes = "zero" if u[k] < self.free(self.start)[k] else "infinity"
            message = (
                f"{self.parameters[k]} goes to {goes}, its bound" + "; " * bool(message) + message
            )
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

    def _named(self, chosen: Iterable[int]) -> str:
        return ", ".join(str(self.parameters[k]) for k in chosen)

    def _irregular(self, u: np.ndarray) -> str:
        """What is wrong with the likelihood near u, or nothing: no numbers, or rough ones."""
        steps = STEP * np.array([1.0, -1.0, 2.0, -2.0])
        ends = u[:, None, None] + np.eye(len(u))[:, :, None] * steps
        here = self.loglik(u[:, None])[0]
        rise = self.loglik(ends.reshape(len(u), -1)).reshape(-1, 4) - here
        if len(none := np.flatnonzero(np.isnan(rise).any(axis=1))):
            return f"the likelihood is zero or no number beside it in {self._named(none)}"
        # curvatures of one and of two steps; both are rounding where it is flat
        one, two = rise[:, :2].sum(axis=1), rise[:, 2:].sum(axis=1) / 4.0
        rough = np.abs(one - two) > 0.5 * np.maximum(np.abs(one), np.abs(two)) + 1e-10 * abs(here)
        names = self._named(np.flatnonzero(rough))
        return f"the log-likelihood is rough in {names}, as random numbers make it" if names else ""

    def _flat(self, curvature: np.ndarray, inside: np.ndarray) -> str:
        """Along which parameters the log-likelihood does not curve down."""
        part = curvature[np.ix_(inside, inside)]
        size = np.sqrt(np.abs(np.diagonal(part)))
        size = np.where(size > 0, size, 1.0)
        direction = np.linalg.eigh(part / np.outer(size, size))[1][:, -1]
        names = self._named(inside[np.abs(direction) > 0.1])
        return f"the log-likelihood does not curve down along {names}: too many parameters"


def _are_numbers(derivatives: tuple[Any, ...]) -> bool:
    """Whether a likelihood and its derivatives are finite."""
    return all(part is None or np.isfinite(part).all() for part in derivatives)


def uphill(slopes: np.ndarray, curvature: np.ndarray, radius: float) -> np.ndarray:
    """Step of at most this length to where the quadratic model of a function is largest."""
    values, vectors = np.linalg.eigh(curvature)
    flat = FLATTEST * np.abs(values).max()
    values = np.where(np.abs(values) < flat, -flat, values)  # so that rounding leads nowhere
    slope, top = vectors.T @ slopes, max(values[-1], 0.0)

    def step(shift: float) -> np.ndarray:
        return slope / (shift - values)

    if values[-1] < 0.0 and np.linalg.norm(step(0.0)) <= radius:
        return vectors @ step(0.0)
    low, high = top, top + np.linalg.norm(slope) / radius
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.linalg.norm(step(middle)) > radius else (low, middle)
    found = step(high) if high > values[-1] else np.zeros_like(slope)
    # a slope without a part in the direction that curves up: either side of it will do
    found[-1] += np.copysign(np.sqrt(max(radius**2 - found @ found, 0.0)), found[-1])
    return vectors @ found


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
    # many of them are one point: corners that meet in the middle, or at ends
    points, places = np.unique(np.concatenate(points) + 0.0, axis=0, return_inverse=True)
    values = function(u[:, None] + STEP * points.T)[places.ravel()]
    one, back, two, far = values[1 : 4 * q + 1].reshape(q, 4).T
    slopes = (8 * (one - back) - (two - far)) / (12 * STEP)
    if not second:
        return values[0], slopes, None
    fine, coarse = (values[4 * q + 1 :].reshape(-1, 2, 4) @ [1, -1, -1, 1] / (4 * STEP**2)).T
    curvature = np.empty((q, q))
    for (i, j), part in zip(pairs, (4 * fine - coarse / 4) / 3, strict=True):
        curvature[i, j] = curvature[j, i] = part
    return values[0], slopes, curvature
