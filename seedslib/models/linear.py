"""A linear system in discrete time, given by the matrices of the textbooks."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from seedslib.base.arrays import align
from seedslib.base.checks import (
    as_covariance,
    as_positive,
    as_real,
    brief,
    is_whole,
    require_shape,
)
from seedslib.base.clock import lengths_alike
from seedslib.base.conditioning import gaussian_logpdf
from seedslib.base.linalg import cholesky
from seedslib.base.values import Values, in_order
from seedslib.models.discrete import DiscreteSystem
from seedslib.models.maps import Conditional, Functions, StochasticMap
from seedslib.models.noise import Noise, tidy
from seedslib.models.propagation import stepped

Matrix: TypeAlias = Any
"""An array of numbers or of SymPy expressions, or a function of time that gives one."""

STORED = 64
"""Lengths of a step whose discretisation is stored."""


class LinearMap(StochasticMap):
    """y = A(t) x + b(t) + v with v ~ N(0, S(t)).

    Parameters
    ----------
    slope, cov, offset : ndarray, Entries, OfTime or SteppedMatrix
        A, S and b, shapes (m, n), (m, m) and (m,).
    shape : (int, int)
        m and n.
    """

    def __init__(self, slope: Matrix, cov: Matrix, offset: Matrix, shape: tuple[int, int]) -> None:
        m, n = shape
        self._matrices = slope, cov, offset
        entries = getattr(offset, "expressions", offset)
        if not all(isinstance(M, np.ndarray) for M in (slope, cov, entries)):
            self.state = self.time = self.expressions = self.weight_expression = None
            self.state_size, self.size, self.noise, self.period = n, m, Noise(m), ()
            varying = [M for M in self._matrices if not isinstance(M, np.ndarray)]
            self.parameters = in_order(p for M in varying for p in M.mentions)
            self._functions = Functions(None, None, None, None, None, self.parameters)
            return
        import sympy

        state = sympy.symbols(f"x1:{n + 1}", real=True)
        noise = sympy.symbols(f"v1:{m + 1}", real=True)
        value = [
            sum((tidy(a) * x for a, x in zip(row, state, strict=True) if a), b + v)
            for row, b, v in zip(slope, entries, noise, strict=True)
        ]
        super().__init__(state, value, Noise(noise, 0.0, cov))

    @property
    def formulas(self) -> tuple[Any, ...] | None:
        """A, S and b as numbers or expressions in t; None without such."""
        parts = tuple(getattr(M, "expressions", M) for M in self._matrices)
        return parts if all(isinstance(part, np.ndarray) for part in parts) else None

    @cached_property
    def _at(self) -> list[Any]:
        """A, S and b as functions (t, p), or as they are where they are constant."""
        return [
            M if isinstance(M, np.ndarray) else M.compiled(self.parameters) for M in self._matrices
        ]

    def _matrix(self, k: int, t: float, p: Values, shape: tuple[int, ...]) -> np.ndarray:
        matrix = self._at[k]
        if callable(matrix):
            return as_real(("slope", "cov", "offset")[k], matrix(t, p), (*shape, ...))
        return matrix

    def slope_at(self, t: float, p: Values = ()) -> np.ndarray:
        """A at a time, shape (m, n); with axes of paths where parameters have them."""
        return self._matrix(0, t, p, (self.size, self.state_size))

    def cov_at(self, t: float, p: Values = ()) -> np.ndarray:
        """S at a time, shape (m, m); with axes of paths where parameters have them."""
        cov = self._matrix(1, t, p, (self.size, self.size))
        if cov.ndim > 2 or cov is self._at[1]:
            return cov
        return as_covariance("cov", cov)

    def offset_at(self, t: float, p: Values = ()) -> np.ndarray:
        """Offset b at a time, shape (m,); with axes of paths where inputs have them."""
        return self._matrix(2, t, p, (self.size,))

    def _mean(self, t: float, x: np.ndarray, p: Values) -> np.ndarray:
        product = np.einsum("ij...,j...->i...", self.slope_at(t, p), x)
        return product + align(self.offset_at(t, p), 1, np.ndim(x) - 1)

    def _cov(self, t: float, x: np.ndarray, p: Values) -> np.ndarray:
        cov = align(self.cov_at(t, p), 2, np.ndim(x) - 1)
        return np.broadcast_to(cov, (self.size, self.size, *np.shape(x)[1:]))

    @cached_property
    def conditional(self) -> Conditional:
        """See `StochasticMap.conditional`."""
        return super().conditional if self.symbolic else Conditional(self._mean, self._cov, None)

    def value(self, t: float, x: np.ndarray, v: np.ndarray, p: Values = ()) -> np.ndarray:
        """See `StochasticMap.value`."""
        if self.symbolic:
            return super().value(t, x, v, p)
        noise = np.einsum("ij...,j...->i...", cholesky(self.cov_at(t, p)), v)
        return self._mean(t, x, p) + noise

    @property
    def has_log_density(self) -> bool:
        """Always: the noise is Gaussian and is added."""
        return True

    @property
    def gaussian_density(self) -> bool:
        """Always."""
        return True

    def log_density(self, t: float, y: np.ndarray, x: np.ndarray, p: Values = ()) -> np.ndarray:
        """See `StochasticMap.log_density`."""
        mean, cov, _ = self.conditional
        return gaussian_logpdf(y, mean(t, x, p), cov(t, x, p))


class LinearSystem(DiscreteSystem):
    """X_{k+1} = F X_k + b + W_k, Y_k = H X_k + d + V_k, W ~ N(0, Q), V ~ N(0, R).

    Every filter takes it; the one that is made for it is `seedslib.filters.KalmanFilter`.

    Parameters
    ----------
    F, Q : array_like or callable, shape (n, n)
        Matrices, or functions of the time that the step leaves. An entry may be a SymPy
        expression in the time ``t``, in parameters, inputs and the elapsed time.
    H, R : array_like or callable, shapes (m, n) and (m, m)
        Likewise, at the time of the measurement.
    mean0, cov0 : array_like, shapes (n,) and (n, n)
        Moments of the state at the first time.
    b, d : array_like or callable, shapes (n,) and (m,)
        What is added to the state and to the measurement, like F and H; zero by default. Controls
        u are inputs in it: ``b=B @ [u1, u2]`` with `seedslib.base.Input`.
    diffuse : sequence of int
        Components of the first state of which nothing is known: `KalmanFilter` gives them an
        infinite variance, and other filters refuse the system. Their rows of `cov0` are zero.

    Raises
    ------
    TypeError, ValueError
        Shapes that do not fit, covariances that are not positive semidefinite, components that
        do not exist.
    """

    def __init__(
        self,
        F: Matrix,
        Q: Matrix,
        H: Matrix,
        R: Matrix,
        mean0: ArrayLike,
        cov0: ArrayLike,
        *,
        b: Matrix = None,
        d: Matrix = None,
        diffuse: tuple[int, ...] = (),
    ) -> None:
        mean0 = np.atleast_1d(as_real("mean0", mean0))
        n = len(mean0)
        known = next((M for M in (R, H) if not callable(M)), None)
        m = len(np.atleast_2d(R(0.0) if known is None else np.array(known, dtype=object)))
        b, d = np.zeros(n) if b is None else b, np.zeros(m) if d is None else d
        F, Q, b = _entries("F", F, (n, n)), _entries("Q", Q, (n, n)), _entries("b", b, (n,))
        H, R, d = _entries("H", H, (m, n)), _entries("R", R, (m, m)), _entries("d", d, (m,))
        for name, cov in (("Q", Q), ("R", R)):
            if isinstance(cov, np.ndarray):
                as_covariance(name, cov)
        try:
            components = tuple(diffuse)
        except TypeError:
            components = (None,)
        for k in components:
            if not is_whole(k) or not 0 <= k < n or components.count(k) > 1:
                raise ValueError(
                    f"diffuse: wanted a sequence of distinct components from 0 to {n - 1}, got "
                    f"{brief(diffuse)}; all of them are range({n})"
                )
        diffuse = components
        cov0 = as_covariance("cov0", np.atleast_2d(as_real("cov0", cov0)), n)
        if np.any(cov0[list(diffuse)] != 0.0):
            raise ValueError("cov0: wanted zeros in the rows of diffuse components")
        super().__init__(LinearMap(F, Q, b, (n, n)), LinearMap(H, R, d, (m, n)), mean0, cov0)
        vars(self)["diffuse"] = diffuse

    def initial_sample(self, rng: Any, count: int) -> np.ndarray:
        """Draws of the first state, shape (n, count).

        Raises
        ------
        ValueError
            Diffuse components, which have no distribution.
        """
        if self.diffuse:
            raise ValueError(
                f"diffuse: components {self.diffuse} have no distribution to draw from"
            )
        return super().initial_sample(rng, count)

    @classmethod
    def from_continuous(
        cls,
        drift: ArrayLike,
        diffusion: ArrayLike,
        H: Matrix,
        R: Matrix,
        mean0: ArrayLike,
        cov0: ArrayLike,
        *,
        step: float | None,
        b: Matrix = None,
        **options: Any,
    ) -> LinearSystem:
        """The system dX = (drift X + b) dt + dW measured at some times, by exact discretisation.

        Parameters
        ----------
        drift : array_like, shape (n, n)
        diffusion : array_like, shape (n, n)
            Covariance of W per unit of time.
        H, R, mean0, cov0, **options
            As for the class.
        step : float, or None
            Time from one measurement to the next; None for times at any distance, each step being
            discretised by itself.
        b : array_like or callable, shape (n,)
            Inputs in it are constant from one measurement to the next.

        Raises
        ------
        TypeError, ValueError
            As the class; a step that is not positive.
        """
        noise = as_covariance("diffusion", np.atleast_2d(as_real("diffusion", diffusion)))
        drift = as_real("drift", np.atleast_2d(drift), noise.shape)
        b = None if b is None else _entries("b", b, (len(drift),))
        if step is None:
            steps = Discretised(drift, noise, b is not None)
            F, Q = SteppedMatrix(steps, 0), SteppedMatrix(steps, 1)
            b = None if b is None else SteppedOffset(steps, b)
        else:
            F, Q = stepped(drift, noise, as_positive("step", step))
            b = None if b is None else _weighted(_integral(drift, step), b)
        return cls(F, Q, H, R, mean0, cov0, b=b, **options)


def _entries(name: str, matrix: Any, shape: tuple[int, ...]) -> Any:
    """A matrix of numbers, or what changes with time or has parameters."""
    if isinstance(matrix, SteppedMatrix):
        return matrix
    if callable(matrix):
        return OfTime(matrix)
    entries = np.array(matrix, dtype=object, ndmin=len(shape))
    if any(hasattr(entry, "free_symbols") for entry in entries.flat):
        return Entries(name, entries, shape)
    array = np.array(as_real(name, matrix), ndmin=len(shape))
    require_shape(name, array, shape)
    return array


class Entries:
    """A matrix of SymPy expressions in the time and in parameters.

    Parameters
    ----------
    name : str
        Of the matrix, for messages.
    entries : ndarray of SymPy expressions
    shape : tuple of int
        Wanted shape.

    Raises
    ------
    TypeError, ValueError
        No expressions, another shape, other symbols, or what is no number.
    """

    def __init__(self, name: str, entries: np.ndarray, shape: tuple[int, ...]) -> None:
        import sympy

        from seedslib.base.parameters import parameters_of
        from seedslib.models.codegen import known_expressions

        self.time: Any = sympy.Symbol("t")
        self.expressions: np.ndarray = known_expressions(name, entries, shape, {}, {self.time})
        self.mentions: tuple[Any, ...] = parameters_of(self.expressions.flat)

    def compiled(self, parameters: tuple[Any, ...]) -> Callable[..., np.ndarray]:
        """The matrix as a function (t, p)."""
        from seedslib.models.codegen import compile_components, stack

        function = compile_components([self.time, parameters], list(self.expressions.flat))
        return lambda t, p: stack(function(t, p), self.expressions.shape)


class OfTime:
    """A matrix that is a function of the time alone."""

    mentions: tuple[Any, ...] = ()

    def __init__(self, function: Callable[[float], Any]) -> None:
        self.function = function

    def compiled(self, parameters: tuple[Any, ...]) -> Callable[..., Any]:
        """The matrix as a function (t, p)."""
        return lambda t, p: self.function(t)


class Discretised:
    """Exact discretisation of dX = (F X + b) dt + dW, once for each length of a step.

    Parameters
    ----------
    drift, diffusion : ndarray, shape (n, n)
        F, and the covariance of W per unit of time.
    offset : bool
        Whether there is a b.
    """

    def __init__(self, drift: np.ndarray, diffusion: np.ndarray, offset: bool) -> None:
        self.drift, self.diffusion, self.offset = drift, diffusion, offset
        self._known: dict[float, tuple[np.ndarray, ...]] = {}

    def __call__(self, step: float) -> tuple[np.ndarray, ...]:
        """Transition matrix, noise covariance and, with b, the integral of exp(F s) of a step."""
        step = float(lengths_alike(step))
        parts = self._known.get(step)
        if parts is None:
            if len(self._known) >= STORED:
                self._known.clear()
            parts = stepped(self.drift, self.diffusion, step)
            if self.offset:
                parts = (*parts, _integral(self.drift, step))
            self._known[step] = parts
        return parts


class SteppedMatrix:
    """One of the matrices of `Discretised`, for the time that has elapsed in a step.

    Parameters
    ----------
    steps : Discretised
    part : int
        0 for the transition, 1 for the noise, 2 for the integral.
    """

    def __init__(self, steps: Discretised, part: int) -> None:
        self.steps, self.part = steps, part

    @property
    def mentions(self) -> tuple[Any, ...]:
        """The elapsed time."""
        from seedslib.base.parameters import ELAPSED

        return (ELAPSED,)

    def compiled(self, parameters: tuple[Any, ...]) -> Callable[..., np.ndarray]:
        """The matrix as a function (t, p)."""
        place = parameters.index(self.mentions[-1])
        return lambda t, p: self.steps(p[place])[self.part]


class SteppedOffset(SteppedMatrix):
    """What b adds to the state in a step in which it is constant.

    Parameters
    ----------
    steps : Discretised
    rate : ndarray, Entries or OfTime, shape (n,)
        b.
    """

    def __init__(self, steps: Discretised, rate: Any) -> None:
        super().__init__(steps, 2)
        self.rate = rate

    @property
    def mentions(self) -> tuple[Any, ...]:
        """What b mentions, and the elapsed time."""
        return (*getattr(self.rate, "mentions", ()), *super().mentions)

    def compiled(self, parameters: tuple[Any, ...]) -> Callable[..., np.ndarray]:
        """The offset as a function (t, p)."""
        weight, rate = super().compiled(parameters), self.rate
        if isinstance(rate, np.ndarray):
            return lambda t, p: weight(t, p) @ rate
        value = rate.compiled(parameters)
        return lambda t, p: np.tensordot(weight(t, p), value(t, p), 1)


def _weighted(weight: np.ndarray, rate: Any) -> Any:
    """The offset of steps of one length: numbers, expressions or a function of time."""
    if isinstance(rate, OfTime):
        return partial(_weighted_at, weight, rate.function)
    return weight @ getattr(rate, "expressions", rate)


def _weighted_at(weight: np.ndarray, function: Callable[[float], Any], t: float) -> np.ndarray:
    return weight @ function(t)


def _integral(drift: np.ndarray, step: float) -> np.ndarray:
    """The integral of exp(F s) over a step."""
    n = len(drift)
    return expm(step * np.block([[drift, np.eye(n)], [np.zeros((n, 2 * n))]]))[:n, n:]
