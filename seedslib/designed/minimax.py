"""The conditionally minimax filter: a chosen prediction and correction, with regressed gains."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

import numpy as np

from seedslib.base.checks import as_count
from seedslib.designed.base import freeze
from seedslib.designed.memory import Memory
from seedslib.designed.predictors import AffineFit, PolynomialFit
from seedslib.designed.tables import Output, OutputFilter, Step, prior
from seedslib.models.discrete import DiscreteSystem

Basic = Callable[..., np.ndarray]
"""A basic function of the user's."""


@dataclass(frozen=True)
class BoundedPolynomial:
    """Basic correction by a polynomial that cannot run away.

    What the best affine map of predicted state and measurement leaves of the state is regressed
    on all products of up to `degree` components of basic prediction and measurement,
    standardised and clipped to 3.5 deviations. The polynomial is bounded by its values on the
    design's paths, and the estimate by the range of their states.

    Parameters
    ----------
    degree : int
        At least 1.

    Raises
    ------
    TypeError, ValueError
        A degree that is not a whole number, or too small.
    """

    degree: int = 3

    def __post_init__(self) -> None:
        object.__setattr__(self, "degree", as_count("degree", self.degree))

    def __str__(self) -> str:
        return f"bounded polynomials of degree {self.degree}"


@dataclass(frozen=True)
class Minimax:
    """How a conditionally minimax filter predicts and corrects, see `minimax_synthesis`."""

    prediction: Basic | None
    correction: Basic | BoundedPolynomial | None

    def __post_init__(self) -> None:
        if not (self.prediction is None or callable(self.prediction)):
            raise TypeError(f"prediction: wanted a function or None, got {self.prediction!r}")
        correction = self.correction
        if not (correction is None or self.bounded or callable(correction)):
            raise TypeError(
                f"correction: wanted a function, a BoundedPolynomial or None, got {correction!r}"
            )

    @property
    def bounded(self) -> bool:
        """Whether the correction is a `BoundedPolynomial`."""
        return isinstance(self.correction, BoundedPolynomial)

    def __str__(self) -> str:
        first = "the mean of the dynamics" if self.prediction is None else "a given function"
        second = (
            "a given function" if callable(self.correction) else self.correction or "the residual"
        )
        return f"conditionally minimax regression on {first}, then on {second}"


class BoundedFit(NamedTuple):
    """A fitted `BoundedPolynomial`.

    Attributes
    ----------
    powers : PolynomialFit
    values, states : ndarray, shape (2, n)
        Least and largest values of the polynomial, and states, on the design's paths.
    """

    powers: PolynomialFit
    values: np.ndarray
    states: np.ndarray

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Value (n, *batch) at basic prediction and measurement (p + m, *batch)."""
        return clipped(self.values, self.powers.mean(points))


def clipped(ends: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Components (n, *batch) cut to their ranges, (2, n)."""
    return np.clip(x, *ends.reshape(*ends.shape, *(1,) * (x.ndim - 1)))


class MinimaxFit(NamedTuple):
    """The regressions of one measurement.

    Attributes
    ----------
    forecast : AffineFit
        F, f and the predicted error covariance before the measurement.
    correction : AffineFit
        H, h and that after it.
    bounded : BoundedFit, or None
    """

    forecast: AffineFit
    correction: AffineFit
    bounded: BoundedFit | None = None


class Basics(NamedTuple):
    """The basic functions of one measurement.

    Attributes
    ----------
    system : DiscreteSystem
    method : Minimax
    estimates : int
        How many estimates are remembered before it.
    times : ndarray, shape (estimates + 1,) or more
        Times up to its own.
    """

    system: DiscreteSystem
    method: Minimax
    estimates: int
    times: np.ndarray

    @classmethod
    def of(
        cls, system: DiscreteSystem, memory: Memory, method: Minimax, times: np.ndarray, k: int
    ) -> Basics:
        """The basic functions of measurement k."""
        estimates = min(k, memory.estimates)
        return cls(system, method, estimates, times[k - max(estimates, min(k, 1)) : k + 1])

    def prediction(self, u: np.ndarray) -> np.ndarray:
        """Basic prediction (p, *batch) from the memory (d, *batch)."""
        if not len(u):
            return u
        if self.method.prediction is not None:
            return _checked("prediction", self.method.prediction(self.times[-2], u), u)
        n, parts = self.system.state_size, []
        for age in range(1, self.estimates + 1):
            x = u[(age - 1) * n : age * n]
            for start, stop in pairwise(self.times[-age - 1 :]):
                p = self.system.values(dt=stop - start)
                x = self.system.dynamics.conditional_moments(start, x, p)[0]
            parts.append(x)
        return np.concatenate([*parts, u[self.estimates * n :]])

    def correction(
        self, forecast: np.ndarray, xi: np.ndarray, y: np.ndarray, bounded: BoundedFit | None
    ) -> np.ndarray:
        """Basic correction (q, *batch) from predicted state, basic prediction and measurement."""
        t, correction = self.times[-1], self.method.correction
        if bounded is not None:
            return np.concatenate([forecast, y, bounded(np.concatenate([xi, y]))])
        if correction is None:
            p = self.system.values()
            return y - self.system.sensor.conditional_moments(t, forecast, p)[0]
        return _checked("correction", correction(t, forecast, y), y)

    def functions(self, fit: MinimaxFit) -> Step:
        """The output functions with the regressions."""
        forecast = partial(_forecast, self, fit)
        if len(self.times) == 1:
            forecast = prior(self.system, len(fit.forecast.offset))
        return Step(partial(_update, self, fit), forecast)


def _checked(name, value, like):
    value = np.asarray(value, dtype=float)
    if value.ndim != like.ndim or value.shape[1:] != like.shape[1:]:
        raise ValueError(
            f"{name}: wanted (rows, {', '.join(map(str, like.shape[1:]))}) from the function, got "
            f"{value.shape}"
        )
    return value


def _forecast(basics: Basics, fit: MinimaxFit, points: Sequence[np.ndarray]) -> Output:
    u = np.stack(np.broadcast_arrays(*points))
    return Output(fit.forecast.mean(basics.prediction(u)))


def _update(basics: Basics, fit: MinimaxFit, points: Sequence[np.ndarray]) -> Output:
    points, m = np.stack(np.broadcast_arrays(*points)), basics.system.measurement_size
    y, xi = points[:m], basics.prediction(points[m:])
    forecast = fit.forecast.mean(xi)
    mean = forecast + fit.correction.mean(basics.correction(forecast, xi, y, fit.bounded))
    return Output(mean if fit.bounded is None else clipped(fit.bounded.states, mean))


@dataclass(frozen=True, eq=False, repr=False)
class MinimaxFilter(OutputFilter):
    """Conditionally minimax filter; `minimax_synthesis` makes it.

    With functions of one's own it is not written to files, since they are programs.

    Attributes
    ----------
    fits : tuple of MinimaxFit, length K+1
        The regressions; `steps` are made of them.
    """

    system: DiscreteSystem
    steps: tuple[Step, ...] = field(init=False)
    method: Minimax
    fits: tuple[MinimaxFit, ...] = field(kw_only=True)
    per_step: ClassVar[Mapping[str, int]] = {"fits": 0, "covariances": 0}

    def __post_init__(self) -> None:
        steps = tuple(self.basics(k).functions(fit) for k, fit in enumerate(self.fits))
        vars(self).update(steps=steps)
        freeze(self.fits)
        super().__post_init__()

    def bind(self, values: Any = None, /, **named: Any) -> MinimaxFilter:
        """See `seedslib.filters.Filter.bind`; the output functions contain the model."""
        return replace(self, system=self.system.bind(values, **named))

    def basics(self, k: int) -> Basics:
        """The basic functions of measurement k."""
        return Basics.of(self.system, self.memory, self.method, self.times, k)
