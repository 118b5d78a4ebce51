"""A linear system in discrete time, given by the matrices of the textbooks."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.linalg import expm, matrix_balance

from seedslib.base.arrays import align
from seedslib.base.checks import (
    as_covariance,
    as_positive,
    as_real,
    brief,
    is_whole,
    require_shape,
)
from seedslib.base.clock import lengths_alike, when
from seedslib.base.conditioning import gaussian_logpdf
from seedslib.base.linalg import cholesky
from seedslib.base.values import Values, in_order, require_no_step
from seedslib.models.discrete import DiscreteSystem
from seedslib.models.maps import Conditional, Functions, Noise, StochasticMap, tidy

RTOL = 1e-11
ATOL = 1e-14

Pair = tuple[np.ndarray, np.ndarray]

Matrix: TypeAlias = Any
"""An array of numbers or of SymPy expressions, or a function of time that gives one."""

STORED = 64
"""Lengths of a step whose discretisation is stored."""


class LinearMap(StochasticMap):
    """y = A(t) x + b(t) + v with v ~ N(0, S(t)).

    Parameters
    ----------
    slope, cov, offset : ndarray, Entries, OfTime or SteppedMatrix
        A, S and b, shapes (m, n), (m, m) and (m,); the attribute `matrices` has all three.
    shape : (int, int)
        m and n.
    """

    def __init__(self, slope: Matrix, cov: Matrix, offset: Matrix, shape: tuple[int, int]) -> None:
        m, n = shape
        self.matrices = slope, cov, offset
        entries = getattr(offset, "expressions", offset)
        if not all(isinstance(M, np.ndarray) for M in (slope, cov, entries)):
            self.state = self.time = self.expressions = self.weight_expression = None
            self.state_size, self.size, self.noise, self.period = n, m, Noise(m), ()
            varying = [M for M in self.matrices if not isinstance(M, np.ndarray)]
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
        parts = tuple(getattr(M, "expressions", M) for M in self.matrices)
        return parts if all(isinstance(part, np.ndarray) for part in parts) else None

    @cached_property
    def _at(self) -> list[Any]:
        """A, S and b as functions (t, p), or as they are where they are constant."""
        return [
            M if isinstance(M, np.ndarray) else M.compiled(self.parameters) for M in self.matrices
        ]

    @cached_property
    def _last(self) -> list[Any]:
        """Of A, S and b the places in p that they depend on, the last numbers, and the values."""
        places = [
            [self.parameters.index(p) for p in getattr(M, "mentions", ())] for M in self.matrices
        ]
        return [(part, (), None) for part in places]

    @property
    def timeless(self) -> bool:
        """See `StochasticMap.timeless`."""
        return all(
            isinstance(M, np.ndarray) or (isinstance(M, Entries) and not M.timed)
            for M in self.matrices
        )

    def _matrix(self, k: int, t: float, p: Values, shape: tuple[int, ...]) -> np.ndarray:
        matrix = self._at[k]
        if not callable(matrix):
            return matrix
        places, known, value = self._last[k]
        given = (*(p[i] for i in places), t if getattr(self.matrices[k], "timed", True) else None)
        if len(given) == len(known) and all(map(_same, given, known)):
            return value
        name = ("slope", "cov", "offset")[k]
        value = as_real(name, matrix(t, p), (*shape, ...))
        if k == 1 and value.ndim == 2:
            value = as_covariance(name, value)
        self._last[k] = places, given, value
        return value

    def slope_at(self, t: float, p: Values = ()) -> np.ndarray:
        """A at a time, shape (m, n); with axes of paths where parameters have them."""
        return self._matrix(0, t, p, (self.size, self.state_size))

    def cov_at(self, t: float, p: Values = ()) -> np.ndarray:
        """S at a time, shape (m, m); with axes of paths where parameters have them."""
        return self._matrix(1, t, p, (self.size, self.size))

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
        Moments of the state at the first time; entries may be expressions in parameters.
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
        start = np.array(mean0, dtype=object, ndmin=1)
        if not any(hasattr(entry, "free_symbols") for entry in start.flat):
            start = np.atleast_1d(as_real("mean0", mean0))
        n = len(start)
        if R is None:
            raise TypeError("R: wanted a covariance, or a function of time, got None")
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
        super().__init__(LinearMap(F, Q, b, (n, n)), LinearMap(H, R, d, (m, n)), mean0, cov0)
        if np.any(self.cov0[list(diffuse)] != 0.0):
            raise ValueError("cov0: wanted zeros in the rows of diffuse components")
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
        drift: Matrix,
        diffusion: Matrix,
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
            Covariance of W per unit of time. Entries of both may be expressions in parameters.
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
        n = np.array(diffusion, dtype=object, ndmin=2).shape[0]
        noise = _entries("diffusion", diffusion, (n, n))
        drift = _entries("drift", drift, (n, n))
        b = None if b is None else _entries("b", b, (n,))
        for name, M in (("drift", drift), ("diffusion", noise)):
            if isinstance(M, OfTime):
                raise ValueError(f"{name}: wanted numbers or formulas, got a function of time")
        if isinstance(noise, np.ndarray):
            as_covariance("diffusion", noise)
        if step is not None:
            step = as_positive("step", step)
        if step is None or isinstance(drift, Entries) or isinstance(noise, Entries):
            steps = Discretised(drift, noise, b, step)
            F, Q = SteppedMatrix(steps, 0), SteppedMatrix(steps, 1)
            b = None if b is None else SteppedMatrix(steps, 2)
        else:
            F, Q = stepped(drift, noise, step)
            b = None if b is None else _weighted(_integral(drift, step), b)
        return cls(F, Q, H, R, mean0, cov0, b=b, **options)


def _same(one: Any, two: Any) -> bool:
    """Whether two numbers are equal, or are one array."""
    numbers = isinstance(one, float | int) and isinstance(two, float | int)
    return one is two or (numbers and one == two)


def _entries(name: str, matrix: Any, shape: tuple[int, ...]) -> Any:
    """A matrix of numbers, or what changes with time or has parameters."""
    if isinstance(matrix, SteppedMatrix | Remade):
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

        from seedslib.base.symbols import parameters_of
        from seedslib.models.codegen import known_expressions

        self.time: Any = sympy.Symbol("t")
        self.expressions: np.ndarray = known_expressions(name, entries, shape, {}, {self.time})
        self.mentions: tuple[Any, ...] = parameters_of(self.expressions.flat)
        self.timed: bool = any(self.time in entry.free_symbols for entry in self.expressions.flat)

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
    """Exact discretisation of dX = (F X + b) dt + dW, once for all steps of one length.

    Parameters
    ----------
    drift, diffusion : ndarray or Entries, shape (n, n)
        F, and the covariance of W per unit of time.
    rate : ndarray, Entries, OfTime or None, shape (n,)
        b, constant in a step.
    step : float or None
        Length of all steps; None for the elapsed time.
    """

    def __init__(self, drift: Any, diffusion: Any, rate: Any, step: float | None) -> None:
        from seedslib.base.symbols import ELAPSED

        for name, M in (("drift", drift), ("diffusion", diffusion)):
            if getattr(M, "timed", False):
                raise ValueError(f"{name}: wanted constants and parameters, got a function of time")
            require_no_step(name, getattr(M, "mentions", ()))
        self.drift, self.diffusion, self.rate, self.step = drift, diffusion, rate, step
        elapsed = (ELAPSED,) if step is None else ()
        own = (*getattr(drift, "mentions", ()), *getattr(diffusion, "mentions", ()))
        self.own: tuple[Any, ...] = in_order((*own, *elapsed))
        self._known: dict[Any, tuple[np.ndarray, ...]] = {}

    def parts(self, given: tuple[Any, ...]) -> tuple[np.ndarray, ...]:
        """Transition, noise, and the integral of the transition, with axes (*batch) of numbers."""
        if self.step is None:
            given = (*given[:-1], float(lengths_alike(given[-1])))
        arrays = [np.asarray(number, dtype=float) for number in given]
        key = tuple((array.shape, array.tobytes()) for array in arrays)
        known = self._known.get(key)
        if known is None:
            if len(self._known) >= STORED:
                self._known.clear()
            known = self._known[key] = self._found(given)
        return known

    def _found(self, given: tuple[Any, ...]) -> tuple[np.ndarray, ...]:
        batch = np.broadcast_shapes(*map(np.shape, given))
        step = given[-1] if self.step is None else self.step
        n = len(getattr(self.drift, "expressions", self.drift))
        F, Q = (
            align(np.asarray(_compiled(M, self.own)(0.0, given), dtype=float), 2, len(batch))
            for M in (self.drift, self.diffusion)
        )
        F, Q = (np.broadcast_to(M, (n, n, *batch)).reshape(n, n, -1) for M in (F, Q))
        each = [self._one(F[..., k], Q[..., k], step) for k in range(F.shape[-1])]
        parts = zip(*each, strict=True)
        return tuple(np.stack(part, axis=-1).reshape(n, n, *batch) for part in parts)

    def _one(self, drift: np.ndarray, diffusion: np.ndarray, step: float) -> tuple[np.ndarray, ...]:
        parts = stepped(drift, diffusion, step)
        return parts if self.rate is None else (*parts, _integral(drift, step))


class SteppedMatrix:
    """A matrix of `Discretised`.

    Parameters
    ----------
    steps : Discretised
    part : int
        0 for the transition, 1 for the noise, 2 for the offset.
    """

    def __init__(self, steps: Discretised, part: int) -> None:
        self.steps, self.part = steps, part

    @property
    def mentions(self) -> tuple[Any, ...]:
        """Parameters, and of the offset the inputs in the rate."""
        rate = getattr(self.steps.rate, "mentions", ()) if self.part == 2 else ()
        return in_order((*self.steps.own, *rate))

    def compiled(self, parameters: tuple[Any, ...]) -> Callable[..., np.ndarray]:
        """The matrix as a function (t, p)."""
        steps, part = self.steps, self.part
        places = [parameters.index(q) for q in steps.own]
        rate = _compiled(steps.rate, parameters) if part == 2 else None

        def matrix(t: float, p: Values) -> np.ndarray:
            value = steps.parts(tuple(p[k] for k in places))[part]
            if rate is None:
                return value
            b = np.asarray(rate(t, p), dtype=float)
            depth = max(value.ndim - 2, b.ndim - 1)
            return np.einsum("ij...,j...->i...", align(value, 2, depth), align(b, 1, depth))

        return matrix


class Remade:
    """What a function makes of a matrix that changes with the time or the length of a step.

    Parameters
    ----------
    matrix : OfTime or SteppedMatrix
    make : callable
        Of an array.
    """

    def __init__(self, matrix: Any, make: Callable[[Any], np.ndarray]) -> None:
        self.matrix, self.make = matrix, make
        self.mentions: tuple[Any, ...] = matrix.mentions

    @classmethod
    def of(cls, matrix: Any, make: Callable[[Any], np.ndarray]) -> Any:
        """The same of any matrix: one of numbers or of expressions is made at once."""
        entries = getattr(matrix, "expressions", matrix)
        return make(entries) if isinstance(entries, np.ndarray) else cls(matrix, make)

    def compiled(self, parameters: tuple[Any, ...]) -> Callable[..., np.ndarray]:
        """The matrix as a function (t, p)."""
        matrix, make = self.matrix.compiled(parameters), self.make
        return lambda t, p: make(matrix(t, p))


def _compiled(matrix: Any, parameters: tuple[Any, ...]) -> Callable[..., Any]:
    """A matrix of numbers, of expressions or of the time as a function (t, p)."""
    return matrix.compiled(parameters) if hasattr(matrix, "compiled") else lambda t, p: matrix


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


RTOL = 1e-11
ATOL = 1e-14


def van_loan(drift: np.ndarray, diffusion: np.ndarray, step: float) -> Pair:
    """Transition matrix and noise covariance of a step, constant coefficients.

    The matrix exponential of Van Loan (1978) is taken on a step so short that ``|F| h <= 1``;
    doubling ``A <- A A``, ``Q <- A Q Aᵀ + Q`` then reaches the wanted step as a sum of
    nonnegative terms. One long exponential of a stable system would overflow and cancel.

    Parameters
    ----------
    drift, diffusion : ndarray
        F and G Q Gᵀ, both (n, n).
    step : float
        Length of the step, nonnegative.

    Returns
    -------
    A, Qd : ndarray
        Both (n, n).

    Raises
    ------
    TypeError, ValueError
        No numbers, other shapes, no covariance, no such step; the moments overflow.
    """
    diffusion = as_covariance("diffusion", diffusion)
    drift = as_real("drift", drift, diffusion.shape)
    return stepped(drift, diffusion, as_positive("step", step, zero=True))


def stepped(drift: np.ndarray, diffusion: np.ndarray, step: float) -> Pair:
    """`van_loan` of arrays that were checked when their system was made."""
    n = len(drift)
    unit, drift, _, diffusion = balanced(drift, np.zeros((n, n)), diffusion)
    doublings = halvings(np.linalg.norm(drift, 1) * step)
    short = step / 2**doublings
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n] = -drift
    block[:n, n:] = diffusion
    block[n:, n:] = drift.T
    power = expm(short * block)
    move = power[n:, n:].T
    spread = move @ power[:n, n:]
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(doublings):
            spread = move @ spread @ move.T + spread
            move = move @ move
        column = unit[:, None]
        move, spread = move * (column / unit), 0.5 * (spread + spread.T) * column * unit
    return bounded(step, move, spread)


def balanced(
    drift: np.ndarray, information: np.ndarray, diffusion: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Units of the state in which the Hamiltonian matrix is small, and the three matrices in them.

    Noise and information are given in units of the state squared and of its inverse: in badly
    chosen units a step would be halved until the drift is lost to rounding. The units are powers
    of two, so that changing to them and back is exact.

    Parameters
    ----------
    drift, information, diffusion : ndarray
        F, HᵀR⁻¹H and GQGᵀ, all (n, n).

    Returns
    -------
    unit : ndarray
        d, shape (n,); x is measured in units of d.
    drift, information, diffusion : ndarray
        ``D⁻¹FD``, ``D HᵀR⁻¹H D`` and ``D⁻¹GQGᵀD⁻¹``.
    """
    n = drift.shape[0]
    rate = np.abs(drift).max() or 1.0
    gain, noise = np.abs(information).max(), np.abs(diffusion).max()
    if gain > 0 and noise > 0:
        square = np.sqrt(noise) / np.sqrt(gain)
    else:
        square = noise / rate if noise > 0 else rate / gain if gain > 0 else 1.0
    common = np.ldexp(1.0, np.frexp(np.sqrt(square))[1])
    upper, lower = information * common * common, diffusion / common / common
    matrix = np.block([[-drift.T, upper], [lower, drift]])
    with np.errstate(invalid="ignore"):  # of the permutation, which is not asked for
        scale = np.log2(matrix_balance(np.abs(matrix), permute=False, separate=True)[1][0])
    unit = common * 2.0 ** np.round(0.5 * (scale[n:] - scale[:n]))
    column = unit[:, None]
    return unit, drift * (unit / column), information * column * unit, diffusion / column / unit


def bounded(step: float, *values: np.ndarray) -> tuple[np.ndarray, ...]:
    """The values, all finite.

    Raises
    ------
    ValueError
        An unstable system has left the range of floating-point numbers.
    """
    if not all(np.isfinite(value).all() for value in values):
        raise ValueError(f"times: the moments overflow over a time of {step:g}: unstable system")
    return values


def halvings(size: float) -> int:
    """How often a step of scaled length `size` is halved until its length is at most one."""
    return max(0, int(np.ceil(np.log2(size)))) if size > 0 else 0


def integrated(coefficients: Callable[[float], Pair], start: float, stop: float) -> Pair:
    """Transition matrix and noise covariance of a step, coefficients that depend on time.

    Integrates ``A' = F A`` and ``Q' = F Q + Q Fᵀ + G Q Gᵀ`` with DOP853.

    Parameters
    ----------
    coefficients : callable
        Time to (F, G Q Gᵀ).
    start, stop : float
        The step, ``start <= stop``.

    Returns
    -------
    A, Qd : ndarray

    Raises
    ------
    ValueError
        The integration failed, for instance because the solution grows without bound.
    """
    n = coefficients(start)[0].shape[0]
    start_pair = np.stack([np.eye(n), np.zeros((n, n))])
    if stop == start:
        return start_pair[0], start_pair[1]

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        drift, diffusion = coefficients(t)
        move, spread = y.reshape(2, n, n)
        return np.stack([drift @ move, drift @ spread + spread @ drift.T + diffusion]).ravel()

    y0 = start_pair.ravel()
    # An absolute tolerance far below the size of the data keeps components that start at zero
    # accurate relative to what they become.
    size = max(1.0, np.abs(slope(start, y0)).max() * (stop - start))
    with np.errstate(over="ignore", invalid="ignore"):
        result = solve_ivp(slope, (start, stop), y0, "DOP853", rtol=RTOL, atol=ATOL * size)
    if not result.success:
        raise ValueError(
            f"times: the equations of the moments could not be integrated from {when(start)} to "
            f"{when(stop)}: {result.message}"
        )
    move, spread = result.y[:, -1].reshape(2, n, n)
    return move, 0.5 * (spread + spread.T)


def distinct_steps(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lengths of steps that differ by more than rounding, and the index of each step's length.

    The steps of a uniform grid differ in the last digits; lengths equal to 1e-12 relative are
    taken as one, so that a uniform grid needs one matrix exponential.

    Returns
    -------
    lengths : ndarray
        Shape (J,).
    index : ndarray
        Shape (K,), ``lengths[index]`` are the steps.
    """
    steps = np.diff(times)
    _, first, index = np.unique(lengths_alike(steps), return_index=True, return_inverse=True)
    return steps[first], index
