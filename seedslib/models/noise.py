"""Random vectors that enter a map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from seedslib.base.arrays import Array, align
from seedslib.base.blocks import drawn, normal
from seedslib.base.checks import as_covariance, as_real
from seedslib.base.linalg import cholesky
from seedslib.gaussian.quadrature import rule_of_rank

HERMITE_ORDER = 9


@dataclass(frozen=True, eq=False)
class Noise:
    """A random vector that enters a map.

    Parameters
    ----------
    symbols : sequence of SymPy symbols, or int
        Names of the components; their number where the maps are array functions.
    mean : float or array_like, shape (size,)
        Mean (default 0).
    cov : array_like, shape (size, size), optional
        Covariance (default the identity).
    sample : callable, optional
        ``sample(rng, count) -> (size, count)`` draws the vector where it is not Gaussian; `mean`
        and `cov` must be its moments. Gaussian by default.
    log_density : callable, optional
        ``log_density(v) -> (*batch)``, logarithm of the density of `sample` at v of shape
        (size, *batch). Maps that are affine in the noise and can be solved for it have one then.

    Raises
    ------
    TypeError, ValueError
        A density without `sample`, repeated symbols, shapes that do not fit or a covariance that
        is not positive semidefinite.
    """

    symbols: Sequence[Any] | Any = ()
    mean: Array = 0.0
    cov: Array = None
    sample: Callable[..., Any] | None = None
    log_density: Callable[..., Any] | None = None
    size: int = field(init=False)
    root: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if isinstance(self.symbols, int):
            symbols, size = None, self.symbols
        else:
            symbols = _named(self.symbols)
            size = len(symbols)
        if size < 0:
            raise ValueError(f"symbols: wanted a nonnegative number of components, got {size}")
        mean = as_real("mean", self.mean)
        if mean.ndim > 1 or mean.size not in (1, size):
            raise ValueError(f"mean: wanted a number or shape ({size},), got {mean.shape}")
        mean = np.broadcast_to(mean, (size,)).copy()
        cov = np.eye(size) if self.cov is None else as_covariance("cov", self.cov, size)
        if self.sample is not None and not callable(self.sample):
            raise TypeError(f"sample: wanted a function (rng, count), got {self.sample!r}")
        if self.log_density is not None and not (callable(self.log_density) and self.sample):
            raise TypeError("log_density: wanted a function (v) beside sample, got another")
        vars(self).update(symbols=symbols, size=size, mean=mean, cov=cov, root=cholesky(cov))

    def __eq__(self, other: object) -> bool:
        """Whether names, moments and sampler are the same."""
        if not isinstance(other, Noise):
            return NotImplemented
        return self.symbols == other.symbols and self.alike(other)

    def alike(self, other: Noise) -> bool:
        """Whether the distribution is the same, whatever the components are called."""
        return (
            (self.size, self.sample, self.log_density)
            == (other.size, other.sample, other.log_density)
            and np.array_equal(self.mean, other.mean)
            and np.array_equal(self.cov, other.cov)
        )

    def __hash__(self) -> int:
        return hash((self.symbols, self.size, *self.mean.tolist(), *self.cov.ravel().tolist()))

    @property
    def gaussian(self) -> bool:
        """Whether the distribution is the Gaussian one."""
        return self.sample is None

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Independent draws, shape (size, count); the first of many are the draws of a few."""
        if self.sample is None:
            return self.mean[:, None] + lower_times(self.root, normal(rng, self.size, count))
        return drawn(rng, count, self._sampled)

    def _sampled(self, rng: np.random.Generator, count: int) -> np.ndarray:
        return as_real("noise.sample", self.sample(rng, count), (self.size, count))

    def rule(self, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Hermite product rule of the Gaussian noise: points (size, S), weights (S,)."""
        nodes, weights = rule_of_rank(self.size, order)
        return self.mean[:, None] + self.root @ nodes, weights

    def nodes(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States beside the nodes of Gaussian noise, nine Gauss-Hermite nodes per component.

        Parameters
        ----------
        x : ndarray, shape (n, *batch)

        Returns
        -------
        x, v, weights : ndarray, shapes (n, S, *batch), (size, S, *batch) and (S,)
        """
        v, weights = self.rule(HERMITE_ORDER)
        batch = (len(weights), *x.shape[1:])
        v = np.broadcast_to(align(v, v.ndim, x.ndim - 1), (self.size, *batch))
        return np.broadcast_to(x[:, None], (len(x), *batch)), v, weights

    def expectation(self, expression: Any) -> Any:
        """Mean of a SymPy expression over the noise.

        Raises
        ------
        NoClosedForm
            Neither of degree two in the noise nor (for Gaussian noise) of the class of
            `seedslib.gaussian.expectation`.
        """
        from seedslib.base.symbols import as_expression

        expression = as_expression("expression", expression)
        if not expression.free_symbols & set(self.symbols):
            return expression
        polynomial = expression.as_poly(*self.symbols)
        if polynomial is not None and polynomial.total_degree() <= 2:
            return self._quadratic_mean(polynomial)
        from seedslib.base.symbols import real_part
        from seedslib.gaussian.algebra import NoClosedForm
        from seedslib.gaussian.formulas import mean_expression

        if not self.gaussian:
            raise NoClosedForm(
                f"noise: only its mean and covariance are known, so {expression} has no mean in "
                "closed form; use GaussHermite or another rule with points"
            )
        from sympy import Matrix

        others = tuple(expression.free_symbols - set(self.symbols))
        moments = self.mean.tolist(), Matrix(self.cov.tolist())
        return real_part(mean_expression(expression, self.symbols, *moments, parameters=others))

    def _quadratic_mean(self, polynomial):
        moments = np.ones(()), self.mean, self.cov + np.outer(self.mean, self.mean)
        total = 0
        for powers, coefficient in polynomial.terms():
            used = tuple(k for k, power in enumerate(powers) for _ in range(power))
            total += coefficient * tidy(moments[len(used)][used])
        return total


def named_noise(name: str, noise: Noise | None) -> Noise:
    """The noise of a symbolic map, without components where there is None.

    Raises
    ------
    TypeError, ValueError
        No noise, or one whose components have no names.
    """
    noise = Noise() if noise is None else noise
    if not isinstance(noise, Noise):
        raise TypeError(f"{name}: wanted a Noise, got {noise!r}")
    if noise.symbols is None:
        raise ValueError(f"{name}: wanted named components for a symbolic map, got a number")
    return noise


def _named(symbols: Sequence) -> tuple:
    """Distinct symbols; a noise without components needs no SymPy."""
    if not isinstance(symbols, tuple | list) or symbols:
        from seedslib.base.symbols import as_symbols, require_distinct

        symbols = as_symbols("symbols", symbols)
        require_distinct(symbols=symbols)
    return tuple(symbols)


def tidy(number: float) -> float:
    """The exact integer where a float is one: keeps formulas such as 1*x free of 1.0*x."""
    return int(number) if float(number).is_integer() else float(number)


def lower_times(root: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Product of a lower triangular matrix with draws, component by component."""
    if np.array_equal(root, np.eye(len(root))):
        return normal
    result = np.zeros(normal.shape)
    for k, row in enumerate(root):
        for q in range(k + 1):
            if row[q] != 0.0:
                result[k] += row[q] * normal[q]
    return result
