"""Exact errors of the optimal and the plug-in estimate, and the conditional variance."""

from functools import cache

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy import special

from oracles.gaussian import hermite_grid, random_dist
from seedslib.gaussian import (
    FunctionClass,
    expectation_function,
    max_errors,
    mean_square_errors,
    posterior_variance_function,
)

x, y, z = sp.symbols("x y z")

SMOOTH = [
    x**2,
    x * y**2 - y,
    (x - 2 * y) ** 4,
    (x, x * y, y**2),
    sp.sin(x),
    x * sp.cos(y) + sp.exp(x / 4),
    sp.exp(-(x**2)),
    sp.cos(x * y / 2),
    y * sp.exp(-(x**2) / 2 + x * y / 4 - y**2),
    (sp.sin(x), sp.cos(y), x * y),
]
SWITCHED = [
    abs(x - 0.3),
    sp.Max(x, y),
    sp.sign(x),
    x * abs(y - x),
    sp.Max(x + y, 0) ** 2,
    sp.Piecewise((x**2, x > 1), (y, True)),
    (abs(x), x, sp.Heaviside(x) * y),
]
NORMS = [
    sp.sqrt(x**2 + y**2),
    2 * sp.sqrt((x - 1) ** 2 + y**2 + 1) + 3,
    sp.sqrt((x - 20) ** 2 + y**2),
]
ALL = [*SMOOTH, *SWITCHED, *NORMS]


def random_case(rng, n, share=0.4, scale=1.0):
    """Mean, covariance C and error covariance P <= C."""
    mean, known = random_dist(rng, n, scale)
    _, error = random_dist(rng, n, scale)
    return mean, known + share * error, share * error


def components(f):
    return list(f) if isinstance(f, tuple) else [f]


@cache
def derived(f):
    """Errors, conditional variance and estimate of a function, or of several, derived once."""
    f = list(f) if isinstance(f, tuple) else f
    makers = mean_square_errors, posterior_variance_function, expectation_function
    return tuple(make(f, [x, y]) for make in makers)


@pytest.mark.parametrize("f", SMOOTH, ids=str)
def test_errors_of_a_smooth_function_match_nested_quadrature(f):
    """Averages over the error at each estimate, and over the estimate."""
    mean, cov, error_cov = random_case(np.random.default_rng(6), 2, share=0.5, scale=0.35)
    grid, weights = hermite_grid(2, 45)
    xhat = mean[:, None] + np.linalg.cholesky(cov - error_cov) @ grid
    state = xhat[:, :, None] + (np.linalg.cholesky(error_cov) @ grid)[:, None, :]
    tables = np.array([sp.lambdify((x, y), g)(*state) for g in components(f)])
    gaps = tables @ weights - np.array([sp.lambdify((x, y), g)(*xhat) for g in components(f)])
    means = tables @ weights
    squares = np.einsum("iks,jks,s->ijk", tables, tables, weights) - means[:, None] * means
    optimal = squares @ weights
    plugin = optimal + (gaps * weights) @ gaps.T
    errors, variance, _ = derived(f)
    found = errors(mean, cov, error_cov)
    size = np.abs(plugin).max()
    assert_allclose(np.ravel(found.optimal), optimal.ravel(), rtol=1e-9, atol=1e-10 * size)
    assert_allclose(np.ravel(found.plugin), plugin.ravel(), rtol=1e-9, atol=1e-10 * size)
    assert_allclose(
        variance(xhat, error_cov).reshape(squares.shape),
        squares,
        rtol=1e-7,
        atol=1e-9 * np.abs(squares).max(),
    )


@pytest.mark.parametrize("f", [*SWITCHED, *NORMS], ids=str)
def test_errors_match_simulation(f):
    rng = np.random.default_rng(12)
    mean, cov, error_cov = random_case(rng, 2, 0.1)
    draws = 50_000
    xhat = mean[:, None] + np.linalg.cholesky(cov - error_cov) @ rng.normal(size=(2, draws))
    state = xhat + np.linalg.cholesky(error_cov) @ rng.normal(size=(2, draws))
    errors, spread, mean_of = derived(f)
    found = errors(mean, cov, error_cov)
    estimate, variance = np.atleast_2d(mean_of(xhat, error_cov)), spread(xhat, error_cov)
    count = len(components(f))
    variance = variance.reshape(count, count, draws)
    parts = [sp.lambdify((x, y), g) for g in components(f)]
    value, plugin = (np.array([g(*at) for g in parts]) for at in (state, xhat))
    for i, j in np.ndindex(count, count):
        optimal = np.atleast_2d(found.optimal)[i, j]
        for products, wanted in [
            ((value - estimate)[i] * (value - estimate)[j], optimal),
            ((value - plugin)[i] * (value - plugin)[j], np.atleast_2d(found.plugin)[i, j]),
            (variance[i, j], optimal),
        ]:
            doubt = products.std() / np.sqrt(draws)
            assert abs(products.mean() - wanted) < 4.5 * doubt + 1e-12 * abs(wanted)


def test_plugin_excess_of_small_errors_is_a_quarter_of_the_squared_curvature():
    points, weights = np.polynomial.hermite_e.hermegauss(80)
    for f in (sp.sin(x), sp.exp(-(x**2)), x**3):
        curvature = sp.lambdify(x, sp.diff(f, x, 2))
        leading = weights / weights.sum() @ curvature(0.4 + np.sqrt(2) * points) ** 2
        found = mean_square_errors(f, [x])([0.4], [[2.0]], [[1e-4]])
        assert_allclose(found.plugin - found.optimal, 0.25e-8 * leading, rtol=1e-3)


def test_fast_and_slow_parts_together():
    """The line is learnt while the oscillation is still unknown: neither spoils the other."""
    errors = mean_square_errors(1000 * x + sp.sin(1000 * x), [x])
    for P in (1e-2, 1e-4, 1e-6, 1e-7, 1e-9):
        found = errors([0.3], [[1.0]], [[P]])
        assert_allclose(found.optimal, 1e6 * P - 0.5 * np.expm1(-1e6 * P), rtol=1e-10)
        excess = 0.5 * np.expm1(-5e5 * P) ** 2
        assert_allclose(found.plugin - found.optimal, excess, rtol=1e-8)


def test_errors_of_a_maximum_and_a_sign_are_the_closed_ones():
    error_cov = np.array([[0.5, 0.1], [0.1, 0.3]])
    cov = error_cov + np.array([[1, -0.4], [-0.4, 0.8]])
    dist = [0.3, -0.2], cov, error_cov
    found = mean_square_errors(sp.Max(x, y), [x, y])(*dist)
    assert_allclose(found, [0.384190, 0.396050], atol=1e-6)  # example 2 of the paper
    assert_allclose(found, max_errors(*dist), rtol=1e-9)
    for C, P in [(1.0, 0.3), (2.0, 1e-8), (1.0, 1.0)]:
        found = mean_square_errors(sp.sign(x), [x])([0.0], [[C]], [[P]])
        half = np.arctan2(np.sqrt(P / C * (2 - P / C)), 1 - P / C)
        assert_allclose(found.optimal, 2 / np.pi * half, rtol=1e-11)
        plugin = 4 / np.pi * np.arctan2(np.sqrt(P), np.sqrt(C - P)) if C > P else 1.0
        assert_allclose(found.plugin, plugin, rtol=1e-11)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_norm_without_information_has_the_variance_of_the_chi_distribution(n):
    symbols = sp.symbols(f"u:{n}")
    errors = mean_square_errors(sp.sqrt(sum(s**2 for s in symbols)), symbols)
    found = errors(np.zeros(n), 2 * np.eye(n), 2 * np.eye(n))
    mean = 2 * special.gamma((n + 1) / 2) / special.gamma(n / 2)
    assert_allclose(found, [2 * n - mean**2, 2 * n], rtol=1e-12)


@pytest.mark.parametrize("distance", [9.99, 10.01, 60.0])
def test_norm_near_and_far_from_the_origin_matches_the_averaged_variance(distance):
    mean = np.array([distance * 0.8, distance * 0.6, 0.0])
    error_cov = np.array([[0.3, 0.1, 0], [0.1, 0.2, 0], [0, 0, 0.1]])
    known = np.diag(1 - np.diag(error_cov))
    grid, weights = hermite_grid(3, 24)
    xhat = mean[:, None] + np.sqrt(known) @ grid
    f = sp.sqrt(x**2 + y**2 + z**2)
    variance = posterior_variance_function(f, [x, y, z])(xhat, error_cov)
    bias = expectation_function(f, [x, y, z])(xhat, error_cov) - np.linalg.norm(xhat, axis=0)
    found = mean_square_errors(f, [x, y, z])(mean, known + error_cov, error_cov)
    assert_allclose(found.optimal, weights @ variance, rtol=1e-9)
    assert_allclose(found.plugin - found.optimal, weights @ bias**2, rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize(("size", "far"), [(3, 1e8), (4, 1e3), (7, 1e5)])
def test_norm_far_from_the_origin_is_almost_linear(size, far):
    """From ``|y| = r + u + |v|²/2r - u|v|²/2r²``: to the order 1/r² the prior cancels."""
    state = sp.symbols(f"s:{size}", real=True)
    f = sp.sqrt(sum(s**2 for s in state))
    mean, share = np.eye(size)[0] * far, 0.3
    optimal, plugin = mean_square_errors(f, state)(mean, np.eye(size), share * np.eye(size))
    across = (size - 1) / far**2
    lost = -0.5 * share**2 * across
    assert optimal == pytest.approx(share + lost, rel=1e-10, abs=1e-3 * abs(lost) + 4e-15)
    bias = share**2 * ((size - 1) / (2 * far)) ** 2
    assert plugin - optimal == pytest.approx(bias, rel=1e-2, abs=4e-15)
    variance = posterior_variance_function(f, state)
    radial = np.diag([100.0, *[25.0] * (size - 1)])
    places = np.outer(np.eye(size)[0], [1.0, 30 * far, 1e4 * far])
    batch = variance(places, radial)
    assert_allclose(batch[1:], 100.0, rtol=1e-5)
    alone = [float(variance(places[:, k], radial)) for k in range(3)]
    assert_allclose(batch, alone, rtol=1e-12)


@pytest.mark.parametrize("mean", [1e2, 1e5, 1e8])
def test_errors_far_from_the_kink_are_those_of_the_polynomial_there(mean):
    dist = [mean], [[1.0]], [[0.3]]
    for f, smooth in ((abs(x), x), (x * abs(x), x**2), (sp.Max(x, 0) ** 2, x**2)):
        errors, known = (mean_square_errors(g, [x])(*dist) for g in (f, smooth))
        assert_allclose(errors, known, rtol=max(1e-13, 1e-15 * mean))  # a rounding of the state


def test_errors_of_both_sides_of_a_plane_at_once():
    """The smaller and the larger of x and 0 are sums of x and |x|, which have one side only."""
    dist = [0.3], [[1.2]], [[0.4]]
    sides = np.array([[0.5, -0.5], [0.5, 0.5]])
    both = mean_square_errors([sp.Min(x, 0), sp.Max(x, 0)], [x])
    assert both.kind is FunctionClass.PIECEWISE
    apart = mean_square_errors([x, abs(x)], [x])(*dist)
    for found, given in zip(both(*dist), apart, strict=True):
        assert_allclose(found, sides @ given @ sides.T, rtol=1e-9)
    # a jump: the value on the plane is that of neither side
    jump = sp.Heaviside(-x, sp.Rational(1, 4))
    two = mean_square_errors([jump, sp.Heaviside(x, sp.Rational(3, 4))], [x])([0.0], *dist[1:])
    assert_allclose(two.optimal, two.optimal[0, 0] * np.array([[1, -1], [-1, 1]]), rtol=1e-9)


@pytest.mark.parametrize("f", [sp.Integer(3), *ALL], ids=str)
def test_errors_of_degenerate_distributions(f):
    errors, variance, estimate = derived(f)
    zero = np.zeros((2, 2))
    for mean in ([0.0, 0.0], [0.3, -0.7]):
        for cov in (np.eye(2), np.ones((2, 2)), np.diag([1.0, 0.0]), zero):
            assert not np.any(errors(mean, cov, zero))
            # no measurement: the estimate is the prior mean, the plug-in the value at it
            silent = errors(mean, cov, cov)
            value = np.atleast_1d(estimate(mean, zero))
            bias = np.atleast_1d(estimate(mean, cov)) - value
            size = np.abs(np.atleast_2d(silent.plugin)).max()
            assert_allclose(silent.optimal, variance(mean, cov), rtol=2e-6, atol=1e-12 * size)
            gap = np.atleast_2d(silent.plugin) - np.atleast_2d(silent.optimal)
            rounding = 1e-15 * (1 + np.abs(value).max())  # of the bias, a difference
            tolerance = 1e-9 * size + 3 * rounding * (rounding + np.abs(bias).max())
            assert_allclose(gap, np.outer(bias, bias), atol=tolerance)
            # something between, in every degenerate direction: 0 <= optimal <= plugin
            between = errors(mean, cov, 0.3 * cov)
            optimal, plugin = (np.atleast_2d(part) for part in between)
            assert np.linalg.eigvalsh(optimal)[0] >= -1e-12 * size
            assert np.linalg.eigvalsh(plugin - optimal)[0] >= -1e-12 * np.abs(plugin).max()


def test_variances_of_small_covariances_are_those_of_the_slope():
    variance = posterior_variance_function(sp.sin(x) * y, [x, y])([0.4, 2.0], 1e-12 * np.eye(2))
    exact = 1e-12 * ((2 * np.cos(0.4)) ** 2 + np.sin(0.4) ** 2)
    assert_allclose(variance, exact, rtol=1e-10)


def test_only_the_components_of_the_function_matter():
    mean, cov, error_cov = random_case(np.random.default_rng(0), 6)
    symbols = sp.symbols("u0:6")
    pick = [4, 1]
    small = mean[pick], cov[np.ix_(pick, pick)], error_cov[np.ix_(pick, pick)]
    for f in [x * y**2, x * sp.sin(y), abs(x) * y, sp.sqrt(x**2 + y**2)]:
        large = f.subs({x: symbols[4], y: symbols[1]}, simultaneous=True)
        found = mean_square_errors(large, symbols)(mean, cov, error_cov)
        assert_allclose(found, mean_square_errors(f, [x, y])(*small), rtol=1e-11)


def test_dense_polynomial_of_six_variables_has_the_error_of_its_expansion():
    """Of a power of one direction in six variables: the scalar error of that direction."""
    symbols = sp.symbols("u0:6")
    mean, cov, error_cov = random_case(np.random.default_rng(3), 6)
    slope = np.array([1.0, -0.5, 0.3, 0.2, -0.7, 0.4])
    direction = sum(float(c) * s for c, s in zip(slope, symbols, strict=True))
    found = mean_square_errors(sp.expand(direction**4), symbols)(mean, cov, error_cov)
    m, C, P = slope @ mean, slope @ cov @ slope, slope @ error_cov @ slope
    exact = mean_square_errors(x**4, [x])([m], [[C]], [[P]])
    assert_allclose(found, exact, rtol=1e-10)


def test_rounding_is_no_excess_and_infinite_errors_are_refused():
    mean_square_errors(x * y, [x, y])([0.0, 0.0], np.eye(2), (1 + 1e-12) * np.eye(2))
    errors = mean_square_errors(sp.exp(x**2 / 5), [x])
    assert errors([0.0], [[1.0]], [[0.5]]).optimal > 0
    # the mean under variance 2 is finite, the second moment is not
    assert np.isfinite(expectation_function(sp.exp(x**2 / 5), [x])([0.0], [[2.0]]))
    with pytest.raises(ValueError, match="infinite"):
        errors([0.0], [[2.0]], [[0.1]])
