"""Gaussian means of SymPy expressions: closed forms in symbols and vectorised NumPy functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
import sympy as sp

from seedslib.base.checks import as_real
from seedslib.base.symbols import as_expression, as_symbols
from seedslib.gaussian.arguments import gaussian_arguments, in_range
from seedslib.gaussian.means.classes import Key, NoClosedForm
from seedslib.gaussian.means.compile import Compiled, compile_terms
from seedslib.gaussian.means.formulas import mean_formula
from seedslib.gaussian.means.parse import Parsed, check_symbols, components_of, parse

__all__ = [
    "FunctionClass",
    "GaussianMean",
    "NoClosedForm",
    "classify",
    "expectation",
    "expectation_function",
]


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
    planes = {key.plane.place for key in keys if key.plane}
    norms = {key for key in keys if key.norm is not None}
    if norms:
        rest = [t for terms in parsed.components for k, t in terms.items() if k not in norms]
        alone = len(parsed.components) == 1 and len(norms) == 1 and not (exponents or planes)
        constant = all(poly.total_degree() <= 0 for poly in rest)
        return FunctionClass.NORM if alone and constant else FunctionClass.MIXED
    if planes:
        plain = not exponents and len(planes) == 1 and not any(blurred for *_, blurred in planes)
        return FunctionClass.PIECEWISE if plain else FunctionClass.MIXED
    if any(sum(monomial) == 2 for exponent in exponents for monomial, _ in exponent):
        return FunctionClass.TILT
    return FunctionClass.EXPONENTIAL if exponents else FunctionClass.POLYNOMIAL


def expectation(
    f: object,
    variables: Sequence[sp.Symbol],
    mean: Sequence,
    cov: sp.MatrixBase,
    *,
    parameters: Sequence[sp.Symbol] = (),
) -> sp.Expr | sp.Matrix:
    """Mean of f(x) for x ~ N(mean, cov), as a SymPy expression.

    Polynomials (equation (3.2) of Choi, Song, Shin 2019, for any degree), times exponentials of
    quadratics, times the indicator of one half-space or one error function (erf, erfc) of an
    affine argument. The result is not simplified.

    Parameters
    ----------
    f : expression, list or column Matrix of expressions
        Real function of `variables`.
    variables : sequence of n Symbols
        Components of x.
    mean : list or Matrix of n expressions
        Real.
    cov : Matrix (n, n) of expressions
        Real, symmetric. The formula of a function with a switching plane divides by the variance
        of the switching function; use `expectation_function` for degenerate numbers.
    parameters : sequence of Symbols
        Further symbols that f may contain; taken as real constants.

    Returns
    -------
    Expr, or Matrix (p, 1) for a vector f

    Raises
    ------
    NoClosedForm
        A term is outside the class; a norm has only a numeric mean.
    TypeError, ValueError
        Unknown symbols in f, wrong shapes, an asymmetric covariance.

    Examples
    --------
    >>> x, m, P = sp.symbols("x m P", real=True)
    >>> expectation(sp.sin(x), [x], [m], sp.Matrix([[P]]))
    exp(-P/2)*sin(m)
    """
    result = mean_expression(f, variables, mean, cov, parameters=parameters)
    if isinstance(result, sp.MatrixBase):
        return result.applyfunc(lambda part: part.rewrite(sp.erf))
    return result.rewrite(sp.erf)


def mean_expression(
    f: object,
    variables: Sequence[sp.Symbol],
    mean: Sequence,
    cov: sp.MatrixBase,
    *,
    parameters: Sequence[sp.Symbol] = (),
) -> sp.Expr | sp.Matrix:
    """As `expectation`, with probabilities of half-spaces as `NormalCDF`.

    Code made of it keeps the relative accuracy of small probabilities.
    """
    variables = as_symbols("variables", variables)
    n = len(variables)
    mean, cov = _matrix("mean", list(mean)), _matrix("cov", cov)
    if mean.shape != (n, 1):
        raise ValueError(f"mean: wanted {n} components, got shape {mean.shape}")
    if cov.shape != (n, n):
        raise ValueError(f"cov: wanted shape ({n}, {n}), got {cov.shape}")
    if any(sp.expand(entry) != 0 for entry in cov - cov.T):
        raise ValueError("cov: wanted a symmetric matrix")
    formulas, means, covs, scalar = _template(
        components_of(f), variables, as_symbols("parameters", parameters)
    )
    values = dict(zip(means, mean, strict=True))
    values |= {covs[i][j]: cov[i, j] for i in range(n) for j in range(i, n)}
    results = [formula.xreplace(values) for formula in formulas]
    return results[0] if scalar else sp.Matrix(results)


def _matrix(name: str, value: object) -> sp.Matrix:
    """Matrix of expressions; SymPy alone would evaluate strings."""
    if isinstance(value, sp.MatrixBase):
        return sp.Matrix(value)
    array = np.array(value, dtype=object)
    entries = [as_expression(name, entry) for entry in array.ravel()]
    return sp.Matrix(*(array.shape if array.ndim == 2 else (array.size, 1)), entries)


@lru_cache(maxsize=256)
def _template(components: tuple, variables: tuple, parameters: tuple) -> tuple:
    """Formulas in stand-ins for the mean and covariance, cached by (expressions, symbols)."""
    expressions, scalar = components
    parsed = parse(list(expressions), variables, parameters)
    for expression, terms in zip(expressions, parsed.components, strict=True):
        if any(key.norm is not None for key in terms):
            raise NoClosedForm(
                f"no closed form in symbols for {expression}: the mean of a norm is an integral; "
                "expectation_function gives its numbers"
            )
    n = len(variables)
    means = tuple(sp.Dummy(f"m{i}", real=True) for i in range(n))
    upper = {
        (i, j): sp.Dummy(f"P{i}{j}", real=True, nonnegative=True if i == j else None)
        for i in range(n)
        for j in range(i, n)
    }
    covs = tuple(tuple(upper[min(i, j), max(i, j)] for j in range(n)) for i in range(n))
    back = dict(zip(parsed.parameters, parameters, strict=True))
    formulas = tuple(
        mean_formula(terms, parsed.symbols, means, covs).xreplace(back)
        for terms in parsed.components
    )
    return formulas, means, covs, scalar


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
    expressions, scalar = components_of(f)
    variables, parameters = as_symbols("variables", variables), as_symbols("parameters", parameters)
    check_symbols(expressions, variables, parameters)
    return _function(expressions, scalar, variables, parameters)


@lru_cache(maxsize=256)
def _function(
    expressions: tuple, scalar: bool, variables: tuple, parameters: tuple
) -> GaussianMean:
    parsed = parse(list(expressions), variables, parameters)
    compiled = None if parameters else compile_terms(parsed)
    return GaussianMean(class_of(parsed), len(variables), scalar, parameters, parsed, compiled)
