"""A linear system in discrete time, given by the matrices of the textbooks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import align
from seedslib.base.checks import as_covariance, as_positive, as_real, brief, is_whole
from seedslib.base.conditioning import gaussian_logpdf
from seedslib.base.linalg import cholesky
from seedslib.base.values import Values, in_order
from seedslib.models.discrete import DiscreteSystem
from seedslib.models.maps import Conditional, Functions, StochasticMap
from seedslib.models.noise import Noise, tidy
from seedslib.models.propagation import Discretised, SteppedMatrix

Matrix: TypeAlias = Any
"""An array of numbers or of SymPy expressions, or a function of time that gives one."""


class LinearMap(StochasticMap):
    """y = A(t) x + B(t) u + v with v ~ N(0, S(t)).

    Parameters
    ----------
    slope : array_like or callable, shape (m, n)
        A, or a function of time that gives it.
    cov : array_like or callable, shape (m, m)
        S, likewise.
    shape : (int, int)
        m and n.
    push : array_like or callable, shape (m, p), optional
        B, likewise.
    inputs : tuple of Parameter, length p
        u.

    Raises
    ------
    TypeError, ValueError
        Other shapes, or a constant S that is not positive semidefinite.
    """

    def __init__(
        self,
        slope: Matrix,
        cov: Matrix,
        shape: tuple[int, int],
        push: Matrix = None,
        inputs: tuple[Any, ...] = (),
    ) -> None:
        m, n = shape
        self._matrices, self._inputs = (slope, cov, push), inputs
        if any(map(_varies, self._matrices)):
            self.state = self.time = self.expressions = self.weight_expression = None
            self.state_size, self.size, self.noise, self.period = n, m, Noise(m), ()
            self._functions = Functions(None, None, None, None, None, self._mentioned())
            self.parameters = in_order(self._functions.parameters)
            return
        import sympy

        state = sympy.symbols(f"x1:{n + 1}", real=True)
        noise = sympy.symbols(f"v1:{m + 1}", real=True)
        rows = slope if push is None else np.hstack([slope, push])
        value = [
            sum((tidy(a) * x for a, x in zip(row, (*state, *inputs), strict=True) if a), v)
            for row, v in zip(rows, noise, strict=True)
        ]
        super().__init__(state, value, Noise(noise, 0.0, cov))

    def _mentioned(self) -> tuple[Any, ...]:
        """Inputs, and parameters in the entries of the matrices."""
        parameters = set(self._inputs)
        for M in self._matrices:
            if isinstance(M, Entries):
                parameters.update(M.mentions)
            elif isinstance(M, SteppedMatrix):
                from seedslib.base.parameters import ELAPSED

                parameters.add(ELAPSED)
        return in_order(parameters)

    def taking(self, parameters: tuple[Any, ...]) -> StochasticMap:
        """See `StochasticMap.taking`."""
        made = super().taking(parameters)
        if made is not self:
            vars(made).pop("_at", None)
        return made

    @property
    def formulas(self) -> tuple[Any, ...] | None:
        """A, S and B (or None) as numbers or expressions in t, and u; None without such."""
        parts = [getattr(M, "expressions", M) for M in self._matrices]
        return None if any(map(callable, parts)) else (*parts, self._inputs)

    @cached_property
    def _at(self) -> list[Any]:
        """A, S and B as functions (t, p), or as they are where they are constant."""
        return [self._function_of(M) for M in self._matrices]

    def _function_of(self, M: Matrix) -> Any:
        if isinstance(M, Entries):
            return M.compiled(self.parameters)
        if isinstance(M, SteppedMatrix):
            step = next(k for k, p in enumerate(self.parameters) if p.role == "elapsed")
            return lambda t, p: M(t, p[step])
        return (lambda t, p: M(t)) if callable(M) else M

    def slope_at(self, t: float, p: Values = ()) -> np.ndarray:
        """A at a time, shape (m, n); with axes of paths where parameters have them."""
        slope = self._at[0]
        if not callable(slope):
            return slope
        return as_real("slope", slope(t, p), (self.size, self.state_size, ...))

    def cov_at(self, t: float, p: Values = ()) -> np.ndarray:
        """S at a time, shape (m, m); with axes of paths where parameters have them."""
        cov = self._at[1]
        if not callable(cov):
            return cov
        cov = as_real("cov", cov(t, p))
        if cov.ndim > 2:
            return as_real("cov", cov, (self.size, self.size, ...))
        return as_covariance("cov", cov, self.size)

    def pushed(self, t: float, y: np.ndarray, p: Values = ()) -> np.ndarray:
        """What the inputs make of A x, shape (m, *batch): they are added."""
        push = self._at[2]
        if push is None:
            return y
        if callable(push):
            push = as_real("push", push(t, p), (self.size, len(self._inputs), ...))
        push = align(push, 2, y.ndim - 1)
        for k, u in enumerate(self._inputs):
            y = y + push[:, k] * p[self.parameters.index(u)]
        return y

    def _mean(self, t: float, x: np.ndarray, p: Values) -> np.ndarray:
        return self.pushed(t, np.einsum("ij...,j...->i...", self.slope_at(t, p), x), p)

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
    """X_{k+1} = F X_k + B u_k + W_k, Y_k = H X_k + D u_k + V_k, W ~ N(0, Q), V ~ N(0, R).

    Every filter takes it; the one that is made for it is `seedslib.filters.KalmanFilter`.

    Parameters
    ----------
    F, Q : array_like or callable, shape (n, n)
        Matrices, or functions of the time that the step leaves. An entry may be a SymPy
        expression in the time ``t``, in parameters, inputs and the elapsed time.
    H, R : array_like or callable, shapes (m, n) and (m, m)
        Likewise, at the time of the measurement.
    mean0, cov0 : array_like, shapes (n,) and (n, n)
        Law of the state at the first time.
    diffuse : sequence of int
        Components of the first state of which nothing is known: `KalmanFilter` gives them an
        infinite variance, and other filters refuse the system. Their rows of `cov0` are zero.
    B, D : array_like or callable, shapes (n, p) and (m, p), optional
        What the inputs do to the state and to the measurement, like F and H.
    inputs : sequence of Input, length p
        u; those of a time act until the next time.

    Raises
    ------
    TypeError, ValueError
        Shapes that do not fit, covariances that are not positive semidefinite, components that
        do not exist, inputs without a matrix or a matrix without them.
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
        diffuse: tuple[int, ...] = (),
        B: Matrix = None,
        D: Matrix = None,
        inputs: Sequence[Any] = (),
    ) -> None:
        inputs = tuple(inputs)
        if not all(hasattr(u, "role") for u in inputs):
            raise TypeError(f"inputs: wanted a sequence of Input, got {inputs!r}")
        if bool(inputs) != (B is not None or D is not None):
            raise ValueError("B, D, inputs: wanted a matrix and its inputs, got one without other")
        mean0 = np.atleast_1d(as_real("mean0", mean0))
        n = len(mean0)
        given = zip("FQHRBD", (F, Q, H, R, B, D), strict=True)
        made = {name: _entries(name, M) for name, M in given if M is not None}
        m = next((len(made[name]) for name in "RH" if hasattr(made[name], "__len__")), None)
        m = len(np.atleast_2d(R(0.0))) if m is None else m
        rows, columns = {"F": n, "Q": n, "B": n}, {"F": n, "H": n, "Q": n, "R": m}
        for name, M in made.items():
            if not _varies(M):
                as_real(name, M, (rows.get(name, m), columns.get(name, len(inputs))))
                if name in "QR":
                    as_covariance(name, M)
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
        maps = (("F", "Q", "B", n), ("H", "R", "D", m))
        dynamics, sensor = (
            LinearMap(made[a], made[s], (size, n), made.get(b), inputs if b in made else ())
            for a, s, b, size in maps
        )
        super().__init__(dynamics, sensor, mean0, cov0)
        vars(self)["diffuse"] = diffuse

    def initial_sample(self, rng: Any, count: int) -> np.ndarray:
        """Draws of the first state, shape (n, count).

        Raises
        ------
        ValueError
            Diffuse components, which have no law.
        """
        if self.diffuse:
            raise ValueError(f"diffuse: components {self.diffuse} have no law to draw from")
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
        diffuse: tuple[int, ...] = (),
        B: ArrayLike | None = None,
        D: Matrix = None,
        inputs: Sequence[Any] = (),
    ) -> LinearSystem:
        """The system dX = (drift X + B u) dt + dW seen at some times, by exact discretisation.

        Parameters
        ----------
        drift : array_like, shape (n, n)
        diffusion : array_like, shape (n, n)
            Covariance of W per unit of time.
        H, R, mean0, cov0, diffuse, D, inputs
            As for the class.
        step : float, or None
            Time from one measurement to the next; None for times at any distance, each step being
            discretised by itself.
        B : array_like, shape (n, p), optional
            Of the inputs, which are constant from one measurement to the next.

        Raises
        ------
        TypeError, ValueError
            As the class; a step that is not positive.
        """
        drift = np.atleast_2d(as_real("drift", drift))
        noise = as_covariance("diffusion", np.atleast_2d(as_real("diffusion", diffusion)))
        as_real("drift", drift, noise.shape)
        push = np.zeros((len(drift), 0)) if B is None else np.atleast_2d(as_real("B", B))
        as_real("B", push, (len(drift), len(inputs) if B is not None else 0))
        steps = Discretised(drift, noise, push)
        if step is None:
            F, Q, B = (SteppedMatrix(steps, part) for part in range(3))
        else:
            F, Q, B = steps(as_positive("step", step))
        B = None if push.size == 0 else B
        return cls(F, Q, H, R, mean0, cov0, diffuse=diffuse, B=B, D=D, inputs=inputs)


def _varies(matrix: Any) -> bool:
    """Whether a matrix is no constant."""
    return callable(matrix) or isinstance(matrix, Entries)


def _entries(name: str, matrix: Any) -> Any:
    """A matrix of numbers, or a function of time where it is one or has expressions for entries."""
    if callable(matrix):  # of the time
        return matrix
    entries = np.array(matrix, dtype=object)
    if not any(hasattr(entry, "free_symbols") for entry in entries.flat):
        return np.atleast_2d(as_real(name, matrix))
    return Entries(name, np.atleast_2d(entries))


class Entries:
    """A matrix of SymPy expressions in the time and in parameters.

    Parameters
    ----------
    name : str
        Of the matrix, for messages.
    entries : ndarray of SymPy expressions, shape (m, n)

    Raises
    ------
    TypeError, ValueError
        No expressions, other symbols, or what is no number.
    """

    def __init__(self, name: str, entries: np.ndarray) -> None:
        import sympy

        from seedslib.base.parameters import parameters_of
        from seedslib.models.codegen import known_expressions

        self.shape: tuple[int, ...] = entries.shape
        self.time: Any = sympy.Symbol("t")
        self.expressions: np.ndarray = known_expressions(
            name, entries, entries.shape, {}, {self.time}
        )
        self.mentions: tuple[Any, ...] = parameters_of(self.expressions.flat)

    def compiled(self, parameters: tuple[Any, ...]) -> Callable[..., np.ndarray]:
        """The matrix as a function (t, p)."""
        from seedslib.models.codegen import compile_components, stack

        function = compile_components([self.time, parameters], list(self.expressions.flat))
        return lambda t, p: stack(function(t, p), self.shape)

    def __len__(self) -> int:
        return self.shape[0]
