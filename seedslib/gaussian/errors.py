"""Exact mean-square errors of the optimal and of the plug-in estimate of a nonlinear function.

Given the measurements, x is N(xhat, P) with an estimate xhat ~ N(mean, C - P). The optimal
estimate of f(x) is ``E[f(x) | xhat]``, the plug-in estimate is ``f(xhat)`` (Choi, Song, Shin 2019,
sections 2.2 and 2.4). Their errors need no simulation: they are means of the conditional variance
and of the squared bias of f(xhat), both of which have a closed form, or differences of second
moments of two correlated copies of the state. Where such a difference cancels, what is left of it
is integrated.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import combinations_with_replacement, product

import numpy as np
import sympy as sp

from seedslib.base.arrays import align
from seedslib.base.linalg import cholesky
from seedslib.gaussian.algebra import NoClosedForm, components_of, multiply, parse
from seedslib.gaussian.arguments import (
    blockwise,
    estimate_arguments,
    gaussian_arguments,
    in_range,
)
from seedslib.gaussian.functions import MeanSquareErrors, norm_mean, sinh_rule, split_rule
from seedslib.gaussian.hermite import (
    active,
    joint_factor,
    marginal,
    plugin_excess,
    polynomial_expansion,
)
from seedslib.gaussian.means import (
    Coefficients,
    Compiled,
    FunctionClass,
    HalfSpace,
    Index,
    compile_terms,
    expectation_function,
    half_space_means,
    inner_product,
    monomial_means,
    polynomial_value,
    taylor_coefficients,
    times,
)
from seedslib.gaussian.quadrature import fifth_degree, rule_of_rank

CANCELLED = 1e-3  # share of a second moment below which a difference has lost too many digits
ENTRIES = 2_000_000  # of the moment matrices of a block: they stay below the memory of a batch
NEGLIGIBLE = 4e-16  # an estimate's share of the variance across a plane: it is a point
ALMOST_LINEAR = 1e-5  # trace of the covariance beside the squared distance: see `NormErrors`


def mean_square_errors(f: object, variables: Sequence[sp.Symbol]) -> ExactErrors:
    """Exact errors of the optimal and of the plug-in estimate of f(x).

    Polynomials by a sum of squares (equations (3.8), (3.9) of Choi, Song, Shin 2019, for any
    degree); exponentials, sines and Gaussian tilts from two correlated copies of the state;
    polynomials with one switching plane by quadrature of their closed conditional variance, split
    at the kink; one norm by a double integral. All are deterministic, and none loses digits
    because P is small beside C, except the norm, whose absolute error is about 1e-15 of its second
    moment.

    Parameters
    ----------
    f : expression, list or column Matrix of p expressions
        Real function of `variables`.
    variables : sequence of n Symbols
        Components of the state.

    Returns
    -------
    ExactErrors
        Callable ``(mean (n,), cov C (n, n), error_cov P (n, n)) -> (optimal, plugin)``.

    Raises
    ------
    NoClosedForm
        f, or the product f f', is outside the closed class.
    TypeError, ValueError
        As `expectation_function`.
    """
    return ExactErrors(f, variables)


def posterior_variance_function(f: object, variables: Sequence[sp.Symbol]) -> PosteriorVariance:
    """Conditional variance of f(x) given the estimate: ``V = E[f f' | xhat] - zhat zhat'``.

    Delivered with each estimate it states its accuracy; its mean over xhat is the optimal
    mean-square error. Twelve digits are left however small P is, except for norms (absolute error
    about 1e-15 of the squared norm).

    Parameters
    ----------
    f : expression, list or column Matrix of p expressions
        Real function of `variables`.
    variables : sequence of n Symbols
        Components of the state.

    Returns
    -------
    PosteriorVariance
        Callable ``(xhat (n, ...), P (n, n) or (n, n, ...)) -> (...)`` or ``(p, p, ...)``.

    Raises
    ------
    NoClosedForm
        f or the product f f' is outside the closed class.
    TypeError, ValueError
        As `expectation_function`.
    """
    return PosteriorVariance(f, variables)


class _OfFunction:
    """The variables that a function depends on, and the engine of its class."""

    def __init__(self, f: object, variables: Sequence[sp.Symbol]) -> None:
        self.dimension, self._coordinates, symbols = active(f, variables)
        advice = "; a quadrature rule of the estimator gives numbers"
        try:
            function = expectation_function(f, symbols)
        except NoClosedForm as error:
            raise NoClosedForm(f"{error}{advice}") from None
        if function.kind is FunctionClass.MIXED:
            raise NoClosedForm(
                f"no exact errors for {f}: it mixes switching planes, norms or exponentials{advice}"
            )
        self.kind, self.scalar = function.kind, function.scalar
        engines = {
            FunctionClass.POLYNOMIAL: PolynomialErrors,
            FunctionClass.PIECEWISE: PiecewiseErrors,
            FunctionClass.NORM: NormErrors,
        }
        engine = engines.get(function.kind, ExponentialErrors)
        self._engine = engine(components_of(f)[0], symbols, function.compiled)


class ExactErrors(_OfFunction):
    """Callable ``(mean, cov, error_cov) -> (optimal, plugin)``; made by `mean_square_errors`."""

    def __call__(self, mean: object, cov: object, error_cov: object) -> MeanSquareErrors:
        """Errors at one time.

        Parameters
        ----------
        mean, cov : array_like (n,), (n, n)
            Unconditional mean and central covariance C of the state.
        error_cov : array_like (n, n)
            Covariance P of the error of its estimate, P <= C.

        Returns
        -------
        MeanSquareErrors
            ``optimal`` and ``plugin``: numbers for a scalar f, else matrices (p, p).

        Raises
        ------
        TypeError, ValueError
            Bad mean or covariances, ``error_cov exceeds cov``, an infinite mean.
        """
        moments = estimate_arguments(mean, cov, error_cov, self.dimension)
        optimal, plugin = (np.zeros((self._engine.function.size,) * 2) for _ in range(2))
        if moments[2].any():  # else the state is known, and so is f
            moments = marginal(self._coordinates, *moments)
            optimal, plugin = in_range(
                "mean, cov, error_cov", lambda: self._engine.errors(*moments)
            )
        if self.scalar:
            return MeanSquareErrors(float(optimal[0, 0]), float(plugin[0, 0]))
        return MeanSquareErrors(optimal, plugin)


class PosteriorVariance(_OfFunction):
    """Callable ``(xhat, P) -> V``; made by `posterior_variance_function`."""

    def __call__(self, mean: object, cov: object) -> np.ndarray:
        """Conditional variance of f(x) for x ~ N(mean, cov).

        Parameters
        ----------
        mean : array_like (n, ...)
            Estimates xhat, batch axes last.
        cov : array_like (n, n) or (n, n, ...)
            Error covariance P.

        Returns
        -------
        ndarray (...) for a scalar f, (p, p, ...) for a vector
        """
        mean, cov = gaussian_arguments(mean, cov, self.dimension)
        batch = np.broadcast_shapes(mean.shape[1:], cov.shape[2:])
        mean = np.broadcast_to(align(mean, 1, len(batch)), (self.dimension, *batch))
        if cov.ndim > 2:
            cov = np.broadcast_to(align(cov, 2, len(batch)), (*cov.shape[:2], *batch))
        mean, cov = marginal(self._coordinates, mean, cov)
        flat = mean.reshape(len(mean), -1), cov.reshape(*cov.shape[:2], *[-1] * (cov.ndim > 2))
        value = in_range("mean, cov", lambda: self._engine.variance(*flat))
        value = value.reshape(*value.shape[:2], *batch)
        return value[0, 0][()] if self.scalar else value


class _Engine:
    """Errors of a function of p values and n variables that belongs to one class.

    An engine has ``errors(mean, cov, error_cov)``, the two error matrices (p, p), and
    ``variance(mean, cov)``, the conditional variance (p, p, K) for means (n, K) and covariances
    (n, n) or (n, n, K).
    """

    def __init__(
        self, expressions: Sequence[sp.Expr], variables: Sequence[sp.Symbol], function: Compiled
    ) -> None:
        self.expressions, self.variables, self.function = expressions, variables, function


def outer_product(
    left: Sequence[sp.Expr], right: Sequence[sp.Expr], variables: Sequence[sp.Symbol]
) -> Compiled:
    """``left right'`` in numbers, one value for each pair, those of the right side fastest."""
    parsed = parse([*left, *right], variables)
    first, second = parsed.components[: len(left)], parsed.components[len(left) :]
    products = tuple(multiply(a, b) for a in first for b in second)
    return compile_terms(parsed._replace(components=products))


class PolynomialErrors(_Engine):
    """Polynomials, here with at most one switching plane: what is closed given the estimate.

    On its own side of the plane f is a polynomial in the step e = x - xhat, and beyond the plane
    another one is added:

        f(x) - f(xhat) = own(e) + 1{beyond} jump(e).

    The moments of both are those of monomials under N(0, P) and over a half-space of it, so that
    neither the conditional variance nor the bias of f(xhat) is a difference of numbers of the size
    of f.
    """

    def errors(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Optimal and plug-in error matrices (p, p)."""
        polynomial = self.function.polynomial()
        optimal = polynomial_expansion(polynomial, mean, cov, error_cov).optimal_error()
        return optimal, optimal + plugin_excess(polynomial, mean, cov, error_cov)

    def variance(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Conditional variance (p, p, K)."""
        return self.moments(mean, cov)[0]

    @cached_property
    def plane(self) -> HalfSpace | None:
        """The plane where the function switches."""
        return next((group.plane for group in self.function.groups if group.plane), None)

    @cached_property
    def pieces(self) -> tuple[Coefficients, Coefficients, Coefficients]:
        """Polynomials below the plane, on it and above it, of the same monomials."""
        zero = {(0,) * self.function.dimension: np.zeros(self.function.size)}
        tables: tuple[Coefficients, ...] = dict(zero), dict(zero), dict(zero)
        for group in self.function.groups:
            shares = [1.0, 1.0, 1.0]
            if group.plane:
                above = float(group.plane.normal @ self.plane.normal > 0)
                shares = [1.0 - above, group.plane.edge, above]
            for table, share in zip(tables, shares, strict=True):
                for alpha, coefficient in group.polynomial.items():
                    table[alpha] = table.get(alpha, 0.0) + share * coefficient
        return tables

    @cached_property
    def monomials(self) -> tuple[list[Index], list[Index], np.ndarray]:
        """Those of a step, those of a product of two, and the place of each product (T, T)."""
        ranges = [[range(k + 1) for k in alpha] for alpha in self.pieces[0]]
        table = np.array(sorted({beta for each in ranges for beta in product(*each)}))
        sums = (table[:, None] + table).reshape(-1, table.shape[1])
        pairs, place = np.unique(sums, axis=0, return_inverse=True)
        several = [list(map(tuple, rows.tolist())) for rows in (table, pairs)]
        return *several, place.reshape(len(table), len(table))

    def moments(self, xhat: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Variance (p, p, K) and bias ``E f - f(xhat)`` (p, K) given estimates (n, K)."""
        variance, bias = blockwise(
            lambda block: self._block(xhat[:, block], cov if cov.ndim == 2 else cov[..., block]),
            xhat.shape[1],
            max(1, ENTRIES // len(self.monomials[0]) ** 2),
        )
        return variance, bias

    def _block(self, xhat: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        (below, on, above), size, count = self.pieces, self.function.size, xhat.shape[1]
        level, side = np.ones(count), np.ones(count)
        if self.plane is not None:
            level = inner_product(self.plane.normal, xhat) + self.plane.offset
            width = inner_product(self.plane.normal, times(cov, self.plane.normal))
            # an estimate on the plane that does not err across it has the value of the plane
            side = np.where((level == 0) & (width <= 0), 0, np.where(level > 0, 1, -1))
        variance, bias = np.empty((size, size, count)), np.empty((size, count))
        for sign, own, other in ((1, above, below), (-1, below, above), (0, on, on)):
            k = np.flatnonzero(side == sign)
            if k.size:
                part = xhat[:, k], cov if cov.ndim == 2 else cov[..., k], sign, np.abs(level[k])
                variance[..., k], bias[:, k] = self._given(own, other, *part)
        edge = (level == 0) & (side != 0)
        if edge.any():  # f(xhat) is neither that of one side nor that of the other
            at = xhat[:, edge]
            bias[:, edge] += polynomial_value(below, at, size) - self.function.value(at)
        return variance, bias

    def _given(
        self,
        own: Coefficients,
        other: Coefficients,
        xhat: np.ndarray,
        cov: np.ndarray,
        sign: int,
        distance: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Variance and bias given estimates on one side, by their distance from the plane."""
        single, pairs, place = self.monomials
        jump = {alpha: other[alpha] - own[alpha] for alpha in own}
        steps, jumps = (
            np.array([table.get(beta, 0.0 * xhat[:1]) for beta in single])
            for table in (taylor_coefficients(own, xhat), taylor_coefficients(jump, xhat))
        )
        steps[0] = 0.0
        # of e: common to all estimates where the covariance is
        start = np.zeros((len(xhat), *(cov.shape[2:] or (1,))))
        means = monomial_means(pairs, start, cov, zeroth=np.ones(start.shape[1:]))
        moments = np.array([means[index] for index in pairs])[place]
        first = np.einsum("ak,apk->pk", moments[0], steps)
        by_steps = np.einsum("abk,bpk->apk", moments, steps)
        by_jumps = np.zeros_like(jumps)
        if jumps.any():
            beyond = HalfSpace(-sign * self.plane.normal, -distance, 1.0)
            means, log_scale = half_space_means(pairs, beyond, start, cov)
            moments = (np.exp(log_scale) * np.array([means[index] for index in pairs]))[place]
            first += np.einsum("ak,apk->pk", moments[0], jumps)
            by_steps += np.einsum("abk,bpk->apk", moments, jumps)
            by_jumps = np.einsum("abk,bpk->apk", moments, steps + jumps)
        second = np.einsum("apk,aqk->pqk", steps, by_steps)
        second += np.einsum("apk,aqk->pqk", jumps, by_jumps)
        return second - first[:, None] * first, first


class PiecewiseErrors(PolynomialErrors):
    """Polynomials with one switching plane: the closed moments, and a rule over the estimate.

    Across the plane the rule consists of Gauss-Legendre panels that are split at the kink; along
    it it is a Gauss-Hermite rule, which is exact.
    """

    def errors(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Optimal and plug-in error matrices (p, p)."""
        normal = self.plane.normal
        factor, shares = joint_factor(cov, error_cov)
        estimate_cov = (factor * (1.0 - shares)) @ factor.T
        direction, level = estimate_cov @ normal, normal @ mean + self.plane.offset
        variance, rest = normal @ direction, estimate_cov
        gain, z, weights = np.zeros(len(mean)), np.zeros(1), np.ones(1)
        if variance > NEGLIGIBLE * (normal @ cov @ normal):
            deviation = np.sqrt(variance)
            error = np.sqrt(max(normal @ error_cov @ normal, 0.0))
            z, weights = split_rule(level, deviation, error)
            gain = direction / deviation
            rest = estimate_cov - np.outer(gain, gain)
        order = 1 + max(map(sum, self.pieces[0]))
        root = cholesky(rest, np.diagonal(cov))
        # directions along the plane that only rounding leaves would multiply the points
        scale = np.abs(root).max(axis=0)
        root = root[:, (scale > 1e-12 * scale.max(initial=0.0)) & (order > 1)]
        grid, along = rule_of_rank(root.shape[1], order)
        points = mean[:, None, None] + np.multiply.outer(gain, z)[..., None]
        points = (points + (root @ grid)[:, None]).reshape(len(mean), -1)
        weights = np.outer(weights, along).ravel()
        variances, bias = self.moments(points, error_cov)
        optimal = variances @ weights
        return optimal, optimal + (bias * weights) @ bias.T


class ExponentialErrors(_Engine):
    """Exponentials, sines and tilts, from two correlated copies x and x' of the state.

    If both have covariance C and cross-covariance X, then ``E f(x) f(x')'`` is the second moment
    of the optimal estimate for ``X = C - P`` and that of f for ``X = C``. Their difference, the
    optimal error, is the integral, over 0 < s < 1, of its derivative
    ``E grad f(x) P grad f(x')'`` at ``X = C - s P``; likewise the plug-in's excess is a double
    integral of second derivatives. Every mean is one of the same class in 2n variables.
    """

    @cached_property
    def square(self) -> Compiled:
        """``f f'``, p p values."""
        return outer_product(self.expressions, self.expressions, self.variables)

    @cached_property
    def gradients(self) -> Compiled:
        """Products of first derivatives at x and at x', the variable fastest."""
        return self._of_two_copies([f.diff(x) for f in self.expressions for x in self.variables])

    @cached_property
    def hessians(self) -> Compiled:
        """Products of second derivatives at x and at x', those of one value together."""
        pairs = list(combinations_with_replacement(self.variables, 2))
        return self._of_two_copies([f.diff(*pair) for f in self.expressions for pair in pairs])

    def _of_two_copies(self, expressions: Sequence[sp.Expr]) -> Compiled:
        copies = {x: sp.Dummy(x.name) for x in self.variables}
        others = [f.xreplace(copies) for f in expressions]
        return outer_product(expressions, others, (*self.variables, *copies.values()))

    def errors(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Optimal and plug-in error matrices (p, p)."""
        optimal = self._integrated(mean[:, None], cov, error_cov)[..., 0]
        return optimal, optimal + self._integrated_excess(mean, cov, error_cov)

    def variance(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Conditional variance (p, p, K); where moments cancel, the error with no measurement."""
        average = self.function.mean(mean, cov)
        moment = self.square.mean(mean, cov).reshape(*average.shape[:1] * 2, -1)
        value = moment - average[:, None] * average
        small = np.einsum("iik->ik", value) < CANCELLED * np.einsum("iik->ik", moment)
        cancelled = np.flatnonzero(small.any(axis=0))
        for start in range(0, len(cancelled), 1024):  # members, each with tens of nodes
            k = cancelled[start : start + 1024]
            part = cov if cov.ndim == 2 else cov[..., k]
            value[..., k] = self._integrated(mean[:, k], part, part)
        return value

    def _integrated(self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray) -> np.ndarray:
        """Optimal error (p, p, K) by the integral over the cross-covariance, nothing subtracted."""
        n, p = self.function.dimension, self.function.size
        node, weight = unit_rule(self._rate(error_cov))
        cov, error_cov = (c.reshape(n, n, -1, 1) for c in (cov, error_cov))
        full = np.broadcast_to(cov, (*cov.shape[:3], node.size))
        both = pair_cov(full, full, cov - error_cov * node)
        slopes = self.gradients.mean(np.concatenate([mean, mean])[..., None], both) @ weight
        return np.einsum("aibjk,ijk->abk", slopes.reshape(p, n, p, n, -1), error_cov[..., 0])

    def _integrated_excess(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> np.ndarray:
        """``E b b'`` of the bias, the integral of ``tr P grad grad f / 2`` under N(xhat, s P)."""
        n, p = self.function.dimension, self.function.size
        node, weight = unit_rule(self._rate(error_cov))
        rest, share = (cov - error_cov)[..., None, None], error_cov[..., None, None]
        shape = (n, n, node.size, node.size)
        first = np.broadcast_to(rest + share * node[:, None], shape)
        both = pair_cov(first, np.swapaxes(first, 2, 3), np.broadcast_to(rest, shape))
        values = self.hessians.mean(np.tile(mean, 2)[:, None, None], both) @ weight @ weight
        # each mixed derivative stands for two
        trace = (error_cov - 0.5 * np.diag(np.diag(error_cov)))[np.triu_indices(n)]
        return np.einsum("aibj,i,j->ab", values.reshape(p, trace.size, p, -1), trace, trace)

    def _rate(self, error_cov: np.ndarray) -> float:
        """Largest rate at which the integrand changes along the path, ``|c'Pc|`` and ``|PM|``."""
        size, rates = np.abs(error_cov).sum(axis=1).max(), [0.0]
        for group in self.function.groups:
            if group.linear is not None:
                c = np.abs(group.linear)
                rates.append(np.einsum("i,ij...,j->...", c, np.abs(error_cov), c).max())
            if group.quadratic is not None:
                rates.append(2 * size * np.abs(group.quadratic).sum(axis=1).max())
        return max(rates)


def unit_rule(rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Double-exponential nodes and weights on (0, 1) for functions such as ``exp(-rate s)``.

    In the variable t of the rule such a function falls over a width ``1 / (pi cosh t0)``, where
    ``pi sinh t0 = log(rate)``: the step has to resolve it.
    """
    reach, step = 3.25, 0.125
    if rate > 0.05:
        step = 0.08 / np.cosh(np.arcsinh(np.log(min(rate, 1e6)) / np.pi))
    count = int(np.ceil(reach / step))
    t = step * np.arange(-count, count + 1)
    lift = np.pi * np.sinh(t)
    node, complement = 1 / (1 + np.exp(-lift)), 1 / (1 + np.exp(lift))
    return node, step * np.pi * np.cosh(t) * node * complement


def pair_cov(first: np.ndarray, second: np.ndarray, cross: np.ndarray) -> np.ndarray:
    """Covariance (2n, 2n, ...) of two copies with covariances `first`, `second` and `cross`."""
    upper = np.concatenate([first, cross], axis=1)
    lower = np.concatenate([np.swapaxes(cross, 0, 1), second], axis=1)
    return np.concatenate([upper, lower], axis=0)


class NormErrors(_Engine):
    """One norm |y| of an affine map y, in any dimension.

    Far from the origin, where it is almost linear, by a rule of the fifth degree for its difference
    from |mean|; elsewhere errors are differences of second moments, accurate to about 1e-15 of
    ``E |y|^2``. The two meet at about 1e-9 of the error.
    """

    def variance(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Conditional variance (1, 1, K)."""
        (norm,) = self.function.norms
        return norm.coefficient[0] ** 2 * norm_variance(*norm.affine(mean, cov))[None, None]

    def errors(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Optimal and plug-in error (1, 1)."""
        (norm,) = self.function.norms
        mean, error_cov = norm.affine(mean, error_cov)
        cov = norm.affine(np.zeros(self.function.dimension), cov)[1]
        pair = norm_estimate_errors(mean, cov, error_cov)
        return tuple(np.full((1, 1), norm.coefficient[0] ** 2 * error) for error in pair)


def norm_estimate_errors(
    mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
) -> tuple[float, float]:
    """Optimal and plug-in mean-square error of the estimates of ``|y|``."""
    factor, shares = joint_factor(cov, error_cov)
    estimate_cov = (factor * (1.0 - shares)) @ factor.T
    if np.trace(cov) < ALMOST_LINEAR * (mean @ mean):
        rule = fifth_degree(max(1, factor.shape[1]))
        points = mean[:, None] + (factor * np.sqrt(1.0 - shares)) @ rule.points[: factor.shape[1]]
        excess = norm_mean(points, error_cov) - np.linalg.norm(points, axis=0)
        optimal = float(norm_variance(points, error_cov) @ rule.weights)
        return optimal, optimal + max(float(rule.weights @ excess**2), 0.0)
    second = float(np.trace(cov) + mean @ mean)
    estimate = norm_product((mean, mean), (cov, cov), estimate_cov)
    mixed = norm_product((mean, mean), (cov, estimate_cov), estimate_cov)
    plugin = second - 2 * mixed + float(np.trace(estimate_cov) + mean @ mean)
    optimal = max(second - estimate, 0.0)
    return optimal, max(plugin, optimal)


def norm_variance(mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Variance of ``|y|``, shape (K,), for y ~ N(mean, cov), mean (n, K)."""
    square, width = np.square(mean).sum(axis=0), np.einsum("ii...->...", cov)
    variance = np.maximum(width + square - norm_mean(mean, cov) ** 2, 0.0)
    narrow = np.broadcast_to(width < ALMOST_LINEAR * square, variance.shape)
    if narrow.any():
        centre = mean[:, narrow, None]
        part = np.broadcast_to(align(cov, 2, 1), (*cov.shape[:2], variance.size))[..., narrow]
        rule = fifth_degree(len(mean))
        step = np.einsum("ijk,jq->ikq", cholesky(part), rule.points)
        # |mean + step| - |mean| without a subtraction of lengths
        lengths = np.linalg.norm(centre + step, axis=0) + np.linalg.norm(centre, axis=0)
        gap = (2 * centre * step + step**2).sum(axis=0) / lengths
        variance[narrow] = np.square(gap - (gap @ rule.weights)[:, None]) @ rule.weights
    return variance


def norm_product(
    means: tuple[np.ndarray, np.ndarray], covs: tuple[np.ndarray, np.ndarray], cross: np.ndarray
) -> float:
    """``E |y| |y'|`` for jointly Gaussian y, y' of shape (n,).

    ``|y| = (2 / sqrt(pi)) int_0^inf |y|^2 exp(-s^2 |y|^2) ds`` makes it a double integral of
    Gaussian tilts. With ``s = c sinh v`` in both variables the integrand is analytic and bounded in
    a strip that does not depend on the covariances, so the trapezoidal rule converges
    geometrically for all of them.

    Parameters
    ----------
    means, covs : pairs of ndarray (n,) and (n, n)
        Means and covariances of y and y'.
    cross : ndarray (n, n)
        cov(y, y').
    """
    scales = [
        np.sqrt(2 * np.linalg.eigvalsh(c)[-1] + m @ m) for m, c in zip(means, covs, strict=True)
    ]
    if min(scales) == 0.0:
        return 0.0
    # lengths in units of the scales; the two tilts are then sinh^2 of the two nodes
    n = means[0].size
    unit = np.repeat(scales, n)
    mean = np.concatenate(means) / unit
    cov = pair_cov(*covs, cross) / np.outer(unit, unit)
    tilt, weight = sinh_rule(0.14)
    first, second = (grid.ravel() for grid in np.meshgrid(tilt, tilt, indexing="ij"))
    (values,) = blockwise(
        lambda block: (_tilted_squares(mean, cov, first[block], second[block], n),),
        first.size,
        4096,  # pairs of nodes, each with a matrix of its own
    )
    return float(scales[0] * scales[1] * (np.outer(weight, weight).ravel() @ values))


def _tilted_squares(
    mean: np.ndarray, cov: np.ndarray, first: np.ndarray, second: np.ndarray, n: int
) -> np.ndarray:
    """``E |y|^2 |y'|^2 exp(-a |y|^2 - b |y'|^2)`` for arrays a, b of shape (N,)."""
    weight = 2 * np.repeat(np.stack([first, second], axis=1), n, axis=1)
    # K = I + P M with M = diag(weight); symmetrised by the root of M it is I + R P R
    root = np.sqrt(weight)
    kernel = root[:, :, None] * cov * root[:, None, :]
    # the rounding of the product would make singular covariances indefinite; where what covers it
    # exceeds one (huge tilts) the integrand is below the rounding of the total
    kernel += (1.0 + 1e-15 * weight.max(axis=1))[:, None, None] * np.eye(2 * n)
    lower = np.linalg.cholesky(kernel)
    half = np.linalg.solve(
        lower, np.concatenate([(root * mean)[..., None], root[:, :, None] * cov], -1)
    )
    logs = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(1)
    log_mass = -0.5 * np.square(half[..., 0]).sum(1) - logs
    new_cov = cov - np.swapaxes(half[..., 1:], 1, 2) @ half[..., 1:]
    new_mean = mean - np.einsum("kij,ki->kj", half[..., 1:], half[..., 0])
    a, b, cross = new_mean[:, :n], new_mean[:, n:], new_cov[:, :n, n:]
    own = [
        np.einsum("kii->k", new_cov[:, s, s]) + np.square(m).sum(1)
        for s, m in ((slice(n), a), (slice(n, None), b))
    ]
    # E |y|^2 |y'|^2 = E|y|^2 E|y'|^2 + 2 tr(XX') + 4 a'Xb
    joint = 2 * np.square(cross).sum((1, 2)) + 4 * np.einsum("ki,kij,kj->k", a, cross, b)
    return np.exp(log_mass) * (own[0] * own[1] + joint)
