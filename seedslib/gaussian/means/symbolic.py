"""Classes of functions of a Gaussian vector, and vectorised NumPy functions for their means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
import sympy as sp

from seedslib.base.checks import as_real
from seedslib.base.symbols import as_symbols
from seedslib.gaussian.arguments import gaussian_arguments, in_range
from seedslib.gaussian.means.classes import Key, NoClosedForm
from seedslib.gaussian.means.compile import Compiled, compile_terms
from seedslib.gaussian.means.parse import Parsed, components_of, parse


class FunctionClass(StrEnum):
    """How the Gaussian mean of a function is found."""

    POLYNOMIAL = "polynomial"
    EXPONENTIAL = "exponential-polynomial"
    TILT = "tilt"
    PIECEWISE = "piecewise"
    NORM = "norm"
    MIXED = "mixed"
    NONE = "none"


def classify(f: object, variables: Sequence[sp.Symbol]) -> FunctionClass:
    """Class of a function, which decides how its Gaussian mean and its errors are computed.

    Parameters
    ----------
    f : SymPy expression, list or column Matrix of expressions
        Real function of `variables`.
    variables : sequence of Symbol
        The components of the Gaussian vector.

    Returns
    -------
    FunctionClass
        ``polynomial``; ``exponential-polynomial`` (with exponents affine in the variables, sines
        and cosines included); ``tilt`` (quadratic exponents); ``piecewise`` (polynomials, and one
        switching plane in all components); ``norm`` (a constant multiple of one norm of an affine
        map, plus a constant); ``mixed`` (a sum of several of them, and whatever has an error
        function); ``none`` (no closed form).

    Raises
    ------
    TypeError, ValueError
        Unknown symbols in f, repeated variables, complex or infinite values.
    """
    try:
        return class_of(parse(f, variables))
    except NoClosedForm:
        return FunctionClass.NONE


def class_of(parsed: Parsed) -> FunctionClass:
    """Class of a parsed function."""
    keys: set[Key] = {key for terms in parsed.components for key in terms}
    exponents = {key.exponent for key in keys} - {()}
    planes = {key.plane.boundary for key in keys if key.plane}
    blurred = any(key.plane.blurred for key in keys if key.plane)
    norms = {key for key in keys if key.norm is not None}
    if norms:
        rest = [t for terms in parsed.components for k, t in terms.items() if k not in norms]
        alone = len(parsed.components) == 1 and len(norms) == 1 and not (exponents or planes)
        constant = all(poly.total_degree() <= 0 for poly in rest)
        return FunctionClass.NORM if alone and constant else FunctionClass.MIXED
    if planes:
        plain = not exponents and len(planes) == 1 and not blurred
        return FunctionClass.PIECEWISE if plain else FunctionClass.MIXED
    if any(sum(monomial) == 2 for exponent in exponents for monomial, _ in exponent):
        return FunctionClass.TILT
    return FunctionClass.EXPONENTIAL if exponents else FunctionClass.POLYNOMIAL


@dataclass(frozen=True, eq=False)
class GaussianMean:
    """Vectorised ``(mean, cov) -> E f(x)``; made by `expectation_function`.

    Attributes
    ----------
    kind : FunctionClass
        Class of the function.
    dimension : int
        n.
    scalar : bool
        Whether f is scalar: the result then has no component axis.
    parameters : tuple of Symbols
        Order of the further arguments of a call.
    """

    kind: FunctionClass
    dimension: int
    scalar: bool
    parameters: tuple[sp.Symbol, ...]
    _parsed: Parsed
    _compiled: Compiled | None

    def __call__(self, mean: object, cov: object, *values: float) -> np.ndarray:
        """Mean of f under N(mean, cov).

        Parameters
        ----------
        mean : array_like (n, ...)
            Batch axes last.
        cov : array_like (n, n) or (n, n, ...)
            Positive semidefinite, one for all or one for each member of the batch.
        *values : float
            The parameters, if any.

        Returns
        -------
        ndarray (...) for a scalar f, (p, ...) for a vector
        """
        mean, cov = gaussian_arguments(mean, cov, self.dimension)
        return self.evaluate(mean, cov, *values)

    def evaluate(self, mean: np.ndarray, cov: np.ndarray, *values: float) -> np.ndarray:
        """As a call, without the checks of the mean and covariance."""
        function = self.compiled(*values)
        result = in_range("mean, cov", lambda: function.mean(mean, cov))
        return result[0][()] if self.scalar else result

    def compiled(self, *values: float) -> Compiled:
        """Numeric terms at given values of the parameters."""
        if len(values) != len(self.parameters):
            raise TypeError(f"wanted values of the parameters {self.parameters}, got {values}")
        if self._compiled is not None:
            return self._compiled
        named = zip(self.parameters, self._parsed.parameters, values, strict=True)
        table = {own: float(as_real(str(name), value, ndim=0)) for name, own, value in named}
        return compile_terms(self._parsed, lambda c: complex(sp.sympify(c).xreplace(table)))


def expectation_function(
    f: object, variables: Sequence[sp.Symbol], *, parameters: Sequence[sp.Symbol] = ()
) -> GaussianMean:
    """NumPy function ``(mean, cov) -> E f(x)``, x ~ N(mean, cov), for batches.

    Polynomials by the Stein-Isserlis recursion; the other terms of the closed class after
    completing the square; norms by a one-dimensional integral of full precision. Singular and
    zero covariances are exact. Results are real.

    Parameters
    ----------
    f : expression, list or column Matrix of expressions
        Real function of `variables`.
    variables : sequence of n Symbols
        Components of x.
    parameters : sequence of Symbols
        Further symbols of f; their values follow the covariance in each call.

    Returns
    -------
    GaussianMean
        Callable ``(mean (n, ...), cov (n, n) or (n, n, ...)) -> (...)`` or ``(p, ...)``.

    Raises
    ------
    NoClosedForm
        A term is outside the class; the message names it.
    TypeError, ValueError
        Unknown symbols in f, repeated variables, complex or infinite values. When called: bad
        means or covariances, or an infinite mean (`ValueError`).
    """
    variables, parameters = as_symbols("variables", variables), as_symbols("parameters", parameters)
    return _function(*components_of(f), variables, parameters)


@lru_cache(maxsize=256)
def _function(
    expressions: tuple, scalar: bool, variables: tuple, parameters: tuple
) -> GaussianMean:
    parsed = parse(list(expressions), variables, parameters)
    compiled = None if parameters else compile_terms(parsed)
    return GaussianMean(class_of(parsed), len(variables), scalar, parameters, parsed, compiled)
