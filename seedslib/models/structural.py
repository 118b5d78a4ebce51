"""Structural time series: level, trend, season and regression, parts that add up to a system."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.base.checks import as_count, brief
from seedslib.models.linear import LinearSystem


class Structural(LinearSystem):
    """A `LinearSystem` with one measured component that is a sum of parts, and white noise.

    `level`, `trend`, `season` and `regression` make the parts, and ``+`` adds their states,
    measured values and noises. Nothing is known of the first state: it is diffuse, so the filter
    is `seedslib.filters.KalmanFilter`. A step is one of the record, and a gap is a NaN in it.

    Attributes
    ----------
    components : tuple of str
        Names of the components of the state, as `Estimates.to_dataframe` takes them.
    """

    components: tuple[str, ...]

    def __init__(self, F: Any, Q: Any, H: Any, noise: Any, components: tuple[str, ...]) -> None:
        n = len(components)
        vars(self).update(components=components, _given=(F, Q, H, noise))
        super().__init__(F, Q, [H], noise, np.zeros(n), np.zeros((n, n)), diffuse=tuple(range(n)))

    def __add__(self, other: Any) -> Structural:
        """The system whose measured value is the sum of those of both."""
        if not isinstance(other, Structural):
            raise TypeError(f"+: wanted a part such as level(q) or season(12, w), got {other!r}")
        (F, Q, H, noise), (F2, Q2, H2, noise2) = self._given, other._given
        both = [_diagonal(F, F2), _diagonal(Q, Q2), [*H, *H2], noise + noise2]
        whole = Structural(*both, (*self.components, *other.components))
        return whole.bind({**self.numbers, **other.numbers})


def level(variance: Any, *, noise: Any = 0.0) -> Structural:
    """A random walk.

    Parameters
    ----------
    variance : number or SymPy expression
        Of what it moves by in a step; an expression in parameters can be fitted.
    noise : number or SymPy expression
        Variance of white noise that is measured with it.
    """
    return Structural([[1]], [[variance]], [1], noise, ("level",))


def trend(variance: Any, slope: Any, *, noise: Any = 0.0) -> Structural:
    """A level that moves by a slope in each step, while the slope itself walks.

    Parameters
    ----------
    variance, slope : number or SymPy expression
        Variances of what moves the level and the slope in a step.
    noise : number or SymPy expression
        See `level`.
    """
    return Structural(
        [[1, 1], [0, 1]], [[variance, 0], [0, slope]], [1, 0], noise, ("level", "slope")
    )


def season(period: int, variance: Any, *, noise: Any = 0.0) -> Structural:
    """A pattern of some steps whose sum over a period is zero but for noise.

    Parameters
    ----------
    period : int
        Steps, at least 2; the state has one component less.
    variance : number or SymPy expression
        Of the noise in that sum; zero for a pattern that does not change.
    noise : number or SymPy expression
        See `level`.

    Raises
    ------
    TypeError, ValueError
        No such period.
    """
    n = as_count("period", period, 2) - 1
    F, Q = np.eye(n, k=-1, dtype=object), np.zeros((n, n), dtype=object)
    F[0], Q[0, 0] = -1, variance
    names = (f"season{period}", *(f"season{period}_{k}" for k in range(1, n)))
    return Structural(F, Q, [1, *[0] * (n - 1)], noise, names)


def regression(*inputs: Any, noise: Any = 0.0) -> Structural:
    """The sum of inputs times coefficients that are unknown and do not change.

    Parameters
    ----------
    *inputs : Input or SymPy expression
        Known numbers at each time, such as ``u``, ``u**2`` or the time ``t``.
    noise : number or SymPy expression
        See `level`.

    Raises
    ------
    ValueError
        No input.
    """
    if not inputs:
        raise ValueError(f"inputs: wanted at least one Input, got {brief(inputs)}")
    n = len(inputs)
    names = tuple(f"on {u}" for u in inputs)
    return Structural(np.eye(n), np.zeros((n, n)), [*inputs], noise, names)


def _diagonal(one: Any, two: Any) -> np.ndarray:
    """A matrix with two blocks on its diagonal."""
    n = len(one)
    both = np.zeros((n + len(two),) * 2, dtype=object)
    both[:n, :n], both[n:, n:] = one, two
    return both
