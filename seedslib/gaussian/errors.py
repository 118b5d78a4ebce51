"""Exact mean-square errors of the optimal and of the plug-in estimate of a nonlinear function.

Given the measurements, x is N(xhat, P) with an estimate xhat ~ N(mean, C - P). The optimal
estimate of f(x) is ``E[f(x) | xhat]``, the plug-in estimate is ``f(xhat)`` (Choi, Song, Shin 2019,
sections 2.2 and 2.4). Their errors need no simulation: they are differences of second moments of
two correlated copies of the state, and where these cancel, integrals of what is left.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from math import prod

import numpy as np
import sympy as sp
from scipy.linalg import block_diag

from seedslib.base.arrays import align
from seedslib.base.linalg import cholesky, nearest_psd
from seedslib.gaussian.algebra import NoClosedForm
from seedslib.gaussian.arguments import (
    as_joint_law,
    blockwise,
    gaussian_arguments,
    in_range,
)
from seedslib.gaussian.functions import (
    MeanSquareErrors,
    norm_mean,
    positive_part,
    ratio,
    sinh_rule,
    split_rule,
)
from seedslib.gaussian.hermite import (
    active,
    joint_factor,
    marginal,
    plugin_excess,
    polynomial_expansion,
)
from seedslib.gaussian.kernels import Group, HalfSpace, inner_product, times
from seedslib.gaussian.means import Compiled, FunctionClass, expectation_function, narrow
from seedslib.gaussian.polynomial import derivative
from seedslib.gaussian.quadrature import fifth_degree, rule_of_rank

# Below these shares of the second moments they cancel too much: in an error, in a variance.
CANCELLED, LOST = 1e-2, 1e-3
SIDE = np.polynomial.legendre.leggauss(52)
REACH = 9.5  # deviations
POINTS = 250_000  # evaluations at a time
SMALL = 1e-12  # deviations along the plane beside the largest one that are rounding
NEGLIGIBLE = 4e-16
KINK = 1e-14  # of the coefficients: a smaller jump across a plane is rounding


def mean_square_errors(f: object, variables: Sequence[sp.Symbol]) -> ExactErrors:
    """Exact errors of the optimal and of the plug-in estimate of f(x).

    Polynomials by a sum of squares (equations (3.8), (3.9) of Choi, Song, Shin 2019, for any
    degree); exponentials, sines and Gaussian tilts from two correlated copies of the state;
    polynomials with one switching plane by quadrature split at the kink; one norm by a double
    integral. All are deterministic, and none loses digits because P is small beside C, except
    the norm of a vector that may come near zero (absolute error about 1e-15 of its second moment).

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


class _ClosedFunction:
    """A function in those of its variables that it depends on, and the way to its errors."""

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
        self.kind, self.scalar, compiled = function.kind, function.scalar, function.compiled
        ways = {
            FunctionClass.POLYNOMIAL: Polynomial,
            FunctionClass.PIECEWISE: Switched,
            FunctionClass.NORM: NormErrors,
        }
        self._way = ways.get(function.kind, Waves)(compiled)


class ExactErrors(_ClosedFunction):
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
        law = as_joint_law(mean, cov, error_cov, self.dimension)
        optimal, plugin = (np.zeros((self._way.function.size,) * 2) for _ in range(2))
        if law[2].any():  # else the state is known, and so is f
            law = marginal(self._coordinates, *law)
            optimal, plugin = in_range("mean, cov, error_cov", lambda: self._way.errors(*law))
        if self.scalar:
            return MeanSquareErrors(float(optimal[0, 0]), float(plugin[0, 0]))
        return MeanSquareErrors(optimal, plugin)


class PosteriorVariance(_ClosedFunction):
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
        value = in_range("mean, cov", lambda: self._way.variance(*flat))
        value = value.reshape(*value.shape[:2], *batch)
        return value[0, 0][()] if self.scalar else value


class _Way:
    """Errors of a function of one class."""

    def __init__(self, function: Compiled) -> None:
        self.function = function

    @cached_property
    def waves(self) -> list[Group]:
        """Terms of f with all their matrices."""
        return list(_waves(self.function))

    @cached_property
    def square(self) -> Compiled:
        """``f f'``, p p values."""
        return self._product(self.waves, self.function.size)

    def variance(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Conditional variance (p, p, K) for means (n, K) and covariances (n, n) or (n, n, K)."""
        average = self.function.mean(mean, cov)
        moment = self.square.mean(mean, cov).reshape(*average.shape[:1] * 2, -1)
        value = moment - average[:, None] * average
        lost = (_diagonal(value) < LOST * _diagonal(moment)).any(axis=0)
        if lost.any():
            value[..., lost] = self.refined(mean[:, lost], cov if cov.ndim == 2 else cov[..., lost])
        return value

    def _product(self, groups: Sequence[Group], size: int, copies: int = 1) -> Compiled:
        """Outer product of a function of `size` values with itself, of one x or of two copies."""
        merged: dict = {}
        for a in groups:
            for b in groups:
                planes = [group.plane for group in (a, b) if group.plane]
                if len(planes) == 2 and not np.array_equal(a.plane.normal, b.plane.normal):
                    continue  # the two sides of one plane
                plane = planes[0]._replace(edge=prod(p.edge for p in planes)) if planes else None
                quadratic, linear = a.quadratic + b.quadratic, a.linear + b.linear
                if copies == 2:
                    quadratic = block_diag(a.quadratic, b.quadratic)
                    linear = np.concatenate([a.linear, b.linear])
                # of two conjugate products one is kept, twice
                phase = next((v for v in (*linear.imag, *quadratic.imag.ravel()) if v), 0.0)
                if phase < 0:
                    continue
                key = *quadratic.ravel(), *linear, *((*plane.normal, plane.edge) if plane else ())
                whole = Group({}, narrow(quadratic), narrow(linear), plane)
                table = merged.setdefault(key, whole).polynomial
                twice = 2.0 if phase else 1.0
                for alpha, c in a.polynomial.items():
                    for beta, d in b.polynomial.items():
                        index = tuple(np.add(alpha, beta)) if copies == 1 else alpha + beta
                        table[index] = table.get(index, 0.0) + np.outer(c, twice * d).ravel()
        return Compiled(size**2, copies * self.function.dimension, tuple(merged.values()), ())


class Polynomial(_Way):
    """Polynomials: a sum of squares, and a rule over ``x - xhat`` that is exact."""

    def errors(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Optimal and plug-in error matrices (p, p)."""
        polynomial = self.function.polynomial()
        optimal = polynomial_expansion(polynomial, mean, cov, error_cov).lower()
        return optimal, optimal + plugin_excess(polynomial, mean, cov, error_cov)

    def refined(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Conditional variance where the second moments cancel."""
        return self.moments(mean, cov)[0]

    @cached_property
    def plane(self) -> HalfSpace | None:
        """The plane where the function switches."""
        return next((group.plane for group in self.function.groups if group.plane), None)

    @cached_property
    def order(self) -> int:
        """Nodes in each direction that are exact along the plane."""
        return 1 + max(
            (sum(a) for group in self.function.groups for a in group.polynomial), default=0
        )

    def moments(self, xhat: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Variance (p, p, K) and bias ``E f - f(xhat)`` (p, K), from differences with f(xhat)."""
        n, switches = len(xhat), self.plane is not None
        nodes = self.order ** (n - switches) * (2 * SIDE[0].size if switches else 1)
        cov = cov.reshape(n, n, -1)
        variance, bias = blockwise(
            lambda k: self._block(xhat[:, k], cov if cov.shape[2] == 1 else cov[..., k]),
            xhat.shape[1],
            max(1, POINTS // nodes),
        )
        return variance, bias

    def _block(self, xhat: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        count, normal = xhat.shape[1], None
        z, across = np.zeros((1, count)), np.ones((1, count))
        gain = np.zeros_like(xhat)
        if self.plane is not None:
            normal = self.plane.normal
            direction = np.einsum("ijk,j->ik", cov, normal)
            spread = inner_product(normal, direction)
            deviation = np.sqrt(np.where(spread > 0, spread, 1.0))
            gain = np.where(spread > 0, direction / deviation, 0.0)
            z, across = _split_normal(
                -(inner_product(normal, xhat) + self.plane.offset) / deviation
            )
            cov = cov - gain[:, None] * gain
        along, weights = _along(cov, self.order, normal)
        points = xhat[:, None, None] + gain[:, None, None] * z[:, None] + along[:, None]
        gap = self.function.value(points) - self.function.value(xhat)[:, None, None]
        weights = (across[:, None] * weights).reshape(-1, count)
        gap = gap.reshape(len(gap), *weights.shape)
        bias = (gap * weights).sum(axis=1)
        away = gap - bias[:, None]
        return np.einsum("pjk,qjk->pqk", away * weights, away), bias


class Switched(Polynomial):
    """Polynomials with one switching plane, by nested quadrature.

    The conditional variance and the bias of the plug-in estimate are a rule over ``x - xhat``, or
    closed where f is continuous and linear on both sides; their means are a rule over ``xhat``.
    Across the plane the rules are Gauss-Legendre panels split at the kink, along it Gauss-Hermite
    rules that are exact.
    """

    @cached_property
    def bent(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Slopes (p, n) below and above the plane, and their step per unit of the switching
        function (p,), of a continuous function that is linear on both sides, such as a maximum.
        """
        if self.order > 2 or self.plane.blur:
            return None
        n, normal = self.function.dimension, self.plane.normal
        below, above = (np.zeros((self.function.size, n + 1)) for _ in range(2))
        for group in self.function.groups:
            plane = group.plane
            for side, sign in ((below, -1.0), (above, 1.0)):
                if plane is None or sign * (plane.normal @ normal) > 0:
                    for alpha, value in group.polynomial.items():
                        side[:, alpha.index(1) if any(alpha) else n] += value
        step = above - below
        level = np.append(normal, self.plane.offset)
        bend = step @ level / (level @ level)
        size = np.abs(above) + np.abs(below)
        if (np.abs(step - np.outer(bend, level)) > KINK * size.max()).any():
            return None
        return below[:, :n], above[:, :n], bend

    def variance(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Conditional variance (p, p, K) for means (n, K) and covariances (n, n) or (n, n, K)."""
        return super().variance(mean, cov) if self.bent is None else self.moments(mean, cov)[0]

    def moments(self, xhat: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Variance (p, p, K) and bias ``E f - f(xhat)`` (p, K).

        A bent function is the linear one of the side where xhat lies, and a multiple of the
        positive part of the switching function towards the other side.
        """
        if self.bent is None:
            return super().moments(xhat, cov)
        below, above, bend = self.bent
        normal, n = self.plane.normal, len(xhat)
        cov = np.broadcast_to(cov.reshape(n, n, -1), (n, n, xhat.shape[1]))
        direction = times(cov, normal[:, None] * np.ones(xhat.shape[1]))
        root = np.sqrt(np.maximum(inner_product(normal, direction), 0.0))
        level = inner_product(normal, xhat) + self.plane.offset
        excess, square, mass = positive_part(ratio(np.abs(level), root))
        slope = np.where(level < 0, below[..., None], above[..., None])
        towards = np.where(level < 0, mass, -mass) * np.einsum("pik,ik->pk", slope, direction)
        both = towards[:, None] * bend[:, None]
        variance = np.einsum("pik,qik->pqk", np.einsum("pjk,jik->pik", slope, cov), slope)
        variance += both + both.swapaxes(0, 1)
        variance += np.multiply.outer(np.outer(bend, bend), root**2 * (square - excess**2))
        return variance, np.multiply.outer(bend, root * excess)

    def errors(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Optimal and plug-in error matrices (p, p)."""
        normal = self.plane.normal
        factor, shares = joint_factor(cov, error_cov)
        known = (factor * (1.0 - shares)) @ factor.T
        direction, centre = known @ normal, normal @ mean + self.plane.offset
        spread, rest = normal @ direction, known
        gain, across, weights = np.zeros(len(mean)), np.zeros(1), np.ones(1)
        if spread > NEGLIGIBLE * (normal @ cov @ normal):
            deviation = np.sqrt(spread)
            error = np.sqrt(max(normal @ error_cov @ normal, 0.0))
            across, weights = split_rule(centre, deviation, error)
            gain = direction / deviation
            rest = known - np.outer(gain, gain)
        root = cholesky(nearest_psd(rest)[0])
        scale = np.abs(root).max(axis=0)
        root = root[:, (scale > SMALL * scale.max(initial=0.0)) & (self.order > 1)]
        grid, along = rule_of_rank(root.shape[1], self.order)
        points = mean[:, None, None] + np.multiply.outer(gain, across)[..., None]
        points = (points + (root @ grid)[:, None]).reshape(len(mean), -1)
        weights = np.outer(weights, along).ravel()
        variance, bias = self.moments(points, error_cov)
        optimal = variance @ weights
        return optimal, optimal + (bias * weights) @ bias.T


def _along(cov: np.ndarray, order: int, normal: np.ndarray | None = None) -> tuple:
    """Gauss-Hermite steps (n, G, K) and weights (G, 1) of N(0, cov), where given in a plane."""
    n = len(cov)
    pivot = None if normal is None else int(np.argmax(np.abs(normal)))
    others = [i for i in range(n) if i != pivot]
    grid, weights = rule_of_rank(len(others) if order > 1 else 0, order)
    step = np.zeros((n, len(weights), cov.shape[2]))
    if order > 1 and others:
        root = cholesky(cov[np.ix_(others, others)])
        step[others] = np.einsum("ijk,jg->igk", root, grid)
    if normal is not None:  # the component with the largest part in the normal follows
        step[pivot] = -np.tensordot(normal[others], step[others], 1) / normal[pivot]
    return step, weights[:, None]


def _split_normal(kink: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights (J, K) of the standard normal law, half of them beyond each kink (K,)."""
    kink = np.clip(kink, -REACH, REACH)
    nodes, lengths = 0.5 * (SIDE[0][:, None] + 1.0), 0.5 * SIDE[1][:, None]
    z = np.concatenate([-REACH + (kink + REACH) * nodes, kink + (REACH - kink) * nodes])
    share = np.concatenate([(kink + REACH) * lengths, (REACH - kink) * lengths])
    share = share * np.exp(-0.5 * z * z)
    return z, share / share.sum(axis=0)


class Waves(_Way):
    """Exponentials, sines and tilts, from two correlated copies x and x' of the state.

    If both have covariance C and cross-covariance X, then ``E f(x) f(x')'`` is the second moment
    of the optimal estimate for ``X = C - P`` and that of f for ``X = C``. Their difference is the
    optimal error. Where it cancels it is the integral, over 0 < s < 1, of its derivative
    ``E grad f(x) P grad f(x')'`` at ``X = C - s P``; likewise the plug-in's excess is a double
    integral of second derivatives. Every mean is one of the same class in 2n variables.
    """

    @cached_property
    def pair(self) -> Compiled:
        """``f(x) f(x')'``."""
        return self._product(self.waves, self.function.size, 2)

    @cached_property
    def gradient(self) -> list[Group]:
        """``grad f``, p n values."""
        return gradient(self.waves)

    @cached_property
    def slopes(self) -> Compiled:
        """``grad f(x) (x) grad f(x')``."""
        return self._product(self.gradient, self.function.size * self.function.dimension, 2)

    def errors(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Optimal and plug-in error matrices (p, p)."""
        known, twice, shape = cov - error_cov, np.tile(mean, 2), (self.function.size,) * 2
        moment, plugin = (self.square.mean(mean, c).reshape(shape) for c in (cov, known))
        between, mixed = (
            self.pair.mean(twice, pair_cov(cov, c, known)).reshape(shape) for c in (cov, known)
        )
        optimal = moment - between
        if (np.diag(optimal) < CANCELLED * np.diag(moment)).any():
            optimal = self.conditional(mean[:, None], cov, error_cov)[..., 0]
        excess = between - mixed - mixed.T + plugin
        scale = np.abs(np.diag(between)) + np.abs(np.diag(plugin))
        if (np.diag(excess) < CANCELLED * scale).any():
            excess = self._excess(mean, cov, error_cov)
        return optimal, optimal + excess

    def refined(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Conditional variance where the second moments cancel."""
        (value,) = blockwise(
            lambda k: (self.conditional(mean[:, k], *[cov if cov.ndim == 2 else cov[..., k]] * 2),),
            mean.shape[1],
            1024,
        )
        return value

    def conditional(self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray) -> np.ndarray:
        """Optimal error (p, p, K) by the integral over the cross-covariance, nothing subtracted."""
        n, p = self.function.dimension, self.function.size
        node, weight = unit_rule(self._rate(error_cov))
        cov, error_cov = (c.reshape(n, n, -1, 1) for c in (cov, error_cov))
        full = np.broadcast_to(cov, (*cov.shape[:3], node.size))
        both = pair_cov(full, full, cov - error_cov * node)
        slopes = self.slopes.mean(np.concatenate([mean, mean])[..., None], both) @ weight
        return np.einsum("aibjk,ijk->abk", slopes.reshape(p, n, p, n, -1), error_cov[..., 0])

    def _excess(self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray) -> np.ndarray:
        """``E b b'`` of the bias, the integral of ``tr P grad grad f / 2`` under N(xhat, s P)."""
        n, p = self.function.dimension, self.function.size
        bends = []
        for wave in gradient(self.gradient):
            tables = {a: c.reshape(p, n, n) for a, c in wave.polynomial.items()}
            bent = {a: 0.5 * np.einsum("aij,ij->a", c, error_cov) for a, c in tables.items()}
            bends.append(wave._replace(polynomial=bent))
        node, weight = unit_rule(self._rate(error_cov))
        known, share = (cov - error_cov)[..., None, None], error_cov[..., None, None]
        shape = (n, n, node.size, node.size)
        first = np.broadcast_to(known + share * node[:, None], shape)
        both = pair_cov(first, np.swapaxes(first, 2, 3), np.broadcast_to(known, shape))
        values = self._product(bends, p, 2).mean(np.tile(mean, 2)[:, None, None], both)
        return (values @ weight @ weight).reshape(p, p)

    def _rate(self, error_cov: np.ndarray) -> float:
        """Largest rate at which the integrand changes along the path, ``|c'Pc|`` and ``|PM|``."""
        size, rates = np.abs(error_cov).sum(axis=1).max(), [0.0]
        for wave in self.waves:
            c = np.abs(wave.linear)
            rates.append(np.einsum("i,ij...,j->...", c, np.abs(error_cov), c).max())
            rates.append(2 * size * np.abs(wave.quadratic).sum(axis=1).max())
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


def _waves(function: Compiled) -> Iterator[Group]:
    """Groups with all their matrices whose sum is f: of a complex one half, and its conjugate."""
    n = function.dimension
    for group in function.groups:
        quadratic = np.zeros((n, n)) if group.quadratic is None else group.quadratic
        linear = np.zeros(n) if group.linear is None else group.linear
        whole = group._replace(quadratic=quadratic, linear=linear)
        if not (np.iscomplexobj(quadratic) or np.iscomplexobj(linear)):
            yield whole
            continue
        half = {alpha: 0.5 * c for alpha, c in group.polynomial.items()}
        yield whole._replace(polynomial=half)
        twin = {alpha: np.conj(c) for alpha, c in half.items()}
        yield Group(twin, np.conj(quadratic), np.conj(linear), group.plane)


def gradient(waves: Sequence[Group]) -> list[Group]:
    """All first derivatives of a function of p values: p n values, the axis fastest."""
    slopes = []
    for wave in waves:
        n, table = len(wave.linear), {}
        for axis in range(n):
            terms = [*derivative(wave.polynomial, axis).items()]
            for alpha, c in wave.polynomial.items():
                terms.append((alpha, wave.linear[axis] * c))
                for j in np.flatnonzero(wave.quadratic[axis]):
                    raised = (*alpha[:j], alpha[j] + 1, *alpha[j + 1 :])
                    terms.append((raised, -wave.quadratic[axis, j] * c))
            for alpha, c in terms:
                columns = table.setdefault(alpha, np.zeros((c.size, n), dtype=complex))
                columns[:, axis] += c
        slopes.append(wave._replace(polynomial={a: c.ravel() for a, c in table.items()}))
    return slopes


def _diagonal(values: np.ndarray) -> np.ndarray:
    return np.einsum("iik->ik", values)


class NormErrors(_Way):
    """One norm, in any dimension.

    ``|y| = (2 / sqrt(pi)) int_0^inf |y|^2 exp(-s^2 |y|^2) ds`` makes the mean product of the norms
    of two correlated Gaussian vectors a double integral of Gaussian tilts. With ``s = c sinh v``
    in both variables the integrand is analytic and bounded in a strip that does not depend on the
    covariances, so the trapezoidal rule converges geometrically for all of them.
    """

    def variance(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Conditional variance (1, 1, K)."""
        (norm,) = self.function.norms
        return norm.coefficient[0] ** 2 * norm_variance(*norm.law(mean, cov))[None, None]

    def errors(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Optimal and plug-in error (1, 1)."""
        (norm,) = self.function.norms
        centre, spread = norm.law(mean, cov)
        pair = norm_estimate_errors(centre, spread, norm.law(mean, error_cov)[1])
        return tuple(np.full((1, 1), norm.coefficient[0] ** 2 * error) for error in pair)


# up to this rank: standard deviations from the origin beyond which a rule of so many nodes along
# each direction is more accurate than the difference of second moments
SMOOTH = ((3, 10.0, 24), (6, 100.0, 7), (12, 1e4, 3), (np.inf, np.inf, 1))
ALMOST_LINEAR = 1e-6


def norm_estimate_errors(
    mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
) -> tuple[float, float]:
    """Optimal and plug-in mean-square error of the estimates of ``|y|``.

    Where the law stays ten standard deviations away from the origin (more in over three
    dimensions) the errors are means over the estimate by a Gauss-Hermite rule; elsewhere they are
    differences of second moments, accurate to about 1e-15 of ``E |y|^2``.
    """
    factor, shares = joint_factor(cov, error_cov)
    known = (factor * (1.0 - shares)) @ factor.T
    rank, deviation = factor.shape[1], np.sqrt(max(np.linalg.eigvalsh(cov)[-1], 0.0))
    far, nodes = next(rule[1:] for rule in SMOOTH if rank <= rule[0])
    if np.linalg.norm(mean) >= far * deviation:
        grid, weights = rule_of_rank(rank, nodes)
        points = mean[:, None] + (factor * np.sqrt(1.0 - shares)) @ grid
        excess = norm_mean(points, error_cov) - np.linalg.norm(points, axis=0)
        optimal = float(norm_variance(points, error_cov) @ weights)
        return optimal, optimal + float(weights @ excess**2)
    second = float(np.trace(cov) + mean @ mean)
    estimate = norm_product((mean, mean), (cov, cov), known)
    mixed = norm_product((mean, mean), (cov, known), known)
    plugin = second - 2 * mixed + float(np.trace(known) + mean @ mean)
    optimal = max(second - estimate, 0.0)
    return optimal, max(plugin, optimal)


def norm_variance(mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Variance of ``|y|``, shape (K,), for y ~ N(mean, cov), mean (n, K).

    ``E |y|^2 - (E |y|)^2`` or, a thousand standard deviations from the origin, the variance of
    ``|y| - |mean|`` by a rule of the fifth degree: the norm is then almost linear.
    """
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

    Parameters
    ----------
    means, covs : pairs of ndarray (n,) and (n, n)
        Laws of y and y'.
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
        4096,
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
    # singular laws need the rounding of the product covered; where it exceeds one (huge tilts)
    # the integrand is below the rounding of the total
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
