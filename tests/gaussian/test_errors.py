"""Exact errors of optimal and plug-in estimates against closed forms, quadrature, simulation."""

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy import special

from oracles.positive_parts import positive_part_product
from seedslib.gaussian import (
    FunctionClass,
    NoClosedForm,
    approximate_errors,
    expectation_function,
    mean_square_errors,
    posterior_variance_function,
)

x, y, z = sp.symbols("x y z")

POLYNOMIAL = [x**2, x * y**2 - y, (x - 2 * y) ** 4, [x, x * y, y**2]]
SMOOTH = [
    sp.sin(x),
    x * sp.cos(y) + sp.exp(x / 4),
    sp.exp(-(x**2)),
    sp.cos(x * y / 2),
    y * sp.exp(-(x**2) / 2 + x * y / 4 - y**2),
    [sp.sin(x), sp.cos(y), x * y],
]
SWITCHED = [
    abs(x - 0.3),
    sp.Max(x, y),
    sp.sign(x),
    x * abs(y - x),
    sp.Max(x + y, 0) ** 2,
    sp.Piecewise((x**2, x > 1), (y, True)),
    [abs(x), x, sp.Heaviside(x) * y],
]
NORMS = [
    sp.sqrt(x**2 + y**2),
    2 * sp.sqrt((x - 1) ** 2 + y**2 + 1) + 3,
    sp.sqrt((x - 20) ** 2 + y**2),
]
ALL = [*POLYNOMIAL, *SMOOTH, *SWITCHED, *NORMS]


def random_case(rng, n, share=0.4, scale=1.0):
    root, error = scale * rng.normal(size=(2, n, n))
    P = share * error @ error.T
    return rng.normal(size=n), root @ root.T + P, P


def components(f):
    return list(f) if isinstance(f, list) else [f]


def standard_rule(nodes):
    points, weights = np.polynomial.hermite_e.hermegauss(nodes)
    first, second = (g.ravel() for g in np.meshgrid(points, points, indexing="ij"))
    weights = weights / weights.sum()
    return np.array([first, second]), np.outer(weights, weights).ravel()


@pytest.mark.parametrize("f", [*POLYNOMIAL, *SMOOTH], ids=str)
def test_smooth_functions_match_nested_gauss_hermite(f):
    mean, cov, error_cov = random_case(np.random.default_rng(6), 2, share=0.5, scale=0.35)
    grid, weights = standard_rule(45)
    xhat = mean[:, None] + np.linalg.cholesky(cov - error_cov) @ grid
    error = np.linalg.cholesky(error_cov) @ grid
    state = xhat[:, :, None] + error[:, None, :]
    optimal, plugin = [], []
    tables = [sp.lambdify((x, y), g)(*state) for g in components(f)]
    at_estimate = [sp.lambdify((x, y), g)(*xhat) for g in components(f)]
    for a, fa in zip(tables, at_estimate, strict=True):
        for b, fb in zip(tables, at_estimate, strict=True):
            ga, gb = a @ weights, b @ weights
            optimal.append(weights @ ((a * b) @ weights - ga * gb))
            plugin.append(optimal[-1] + weights @ ((ga - fa) * (gb - fb)))
    result = mean_square_errors(f, [x, y])(mean, cov, error_cov)
    size = max(np.abs(optimal).max(), np.abs(plugin).max())
    assert_allclose(np.ravel(result.optimal), optimal, rtol=1e-9, atol=1e-10 * size)
    assert_allclose(np.ravel(result.plugin), plugin, rtol=1e-9, atol=1e-10 * size)
    # and the conditional variance at every estimate
    variance = posterior_variance_function(f, [x, y])(xhat, error_cov)
    first = (tables[0] ** 2) @ weights - (tables[0] @ weights) ** 2
    variance = variance if variance.ndim == 1 else variance[0, 0]
    assert_allclose(variance, first, rtol=1e-7, atol=1e-9 * np.abs(first).max())


@pytest.mark.parametrize("f", ALL, ids=str)
@pytest.mark.parametrize("share", [0.4, 0.01])
def test_all_classes_match_simulation(f, share):
    rng = np.random.default_rng(12)
    mean, cov, error_cov = random_case(rng, 2, share)
    draws = 100_000
    xhat = mean[:, None] + np.linalg.cholesky(cov - error_cov) @ rng.normal(size=(2, draws))
    state = xhat + np.linalg.cholesky(error_cov) @ rng.normal(size=(2, draws))
    result = mean_square_errors(f, [x, y])(mean, cov, error_cov)
    estimate = np.atleast_2d(expectation_function(f, [x, y])(xhat, error_cov))
    variance = posterior_variance_function(f, [x, y])(xhat, error_cov)
    variance = variance if variance.ndim == 3 else variance[None, None]
    for k, g in enumerate(components(f)):
        numeric = sp.lambdify((x, y), g)
        value, plugin = numeric(*state), numeric(*xhat)
        optimal = np.atleast_2d(result.optimal)[k, k]
        for squares, exact in [
            ((value - estimate[k]) ** 2, optimal),
            ((value - plugin) ** 2, np.atleast_2d(result.plugin)[k, k]),
            (variance[k, k], optimal),
        ]:
            tolerance = 4 * squares.std() / np.sqrt(draws) + 1e-12 * exact
            assert abs(squares.mean() - exact) < tolerance


def sine_reference(m, C, P):
    k = mp.mpf(1) / 2
    optimal = k * (-mp.expm1(-P) + mp.expm1(P) * mp.exp(-2 * C) * mp.cos(2 * m))
    third = k * (1 - mp.exp(-2 * (C - P)) * mp.cos(2 * m))
    return optimal, mp.expm1(-P / 2) ** 2 * third


def power_reference(power, m, C, P):
    # the replica identity for x^power with 50 digits
    def product(X):
        total = mp.mpf(0)
        for j in range(power + 1):
            # E d^j f / dx^j under N(m, C)
            derivative = mp.fsum(
                mp.ff(power, j)
                * mp.binomial(power - j, 2 * i)
                * mp.fac2(2 * i - 1)
                * C**i
                * m ** (power - j - 2 * i)
                for i in range((power - j) // 2 + 1)
            )
            total += derivative**2 * X**j / mp.factorial(j)
        return total

    return product(C) - product(C - P)


@pytest.mark.parametrize("ratio", ["0.9", "1e-3", "1e-8", "1e-12", "1e-15"])
def test_relative_accuracy_for_small_errors(ratio):
    with mp.workdps(60):
        m, C = mp.mpf(0.4), mp.mpf(2)
        P = mp.mpf(float(mp.mpf(ratio) * C))
        law = ([float(m)], [[float(C)]], [[float(P)]])
        result = mean_square_errors(sp.sin(x), [x])(*law)
        optimal, _ = sine_reference(m, C, P)
        assert abs(result.optimal / optimal - 1) < 1e-13
        for power in (2, 3, 4, 7):
            result = mean_square_errors(x**power, [x])(*law)
            assert abs(result.optimal / power_reference(power, m, C, P) - 1) < 1e-13
        # |x|: one minus the mean of 2 a d + d^2, d the gap of the mean modulus
        s, spread = mp.sqrt(P), mp.sqrt(C - P)

        def lost(a):
            gap = 2 * (mp.npdf(a) - a * mp.ncdf(-a))
            return (2 * a * gap + gap**2) * (
                mp.npdf((s * a - m) / spread) + mp.npdf((s * a + m) / spread)
            )

        exact = P * (1 - s / spread * mp.quad(lost, [0, 1, 3, 8, 20]))
        result = mean_square_errors(abs(x), [x])(*law)
        assert abs(result.optimal / exact - 1) < 1e-13


def test_plugin_excess_for_small_errors():
    # the excess is of second order: compare with its leading term, E (P : grad grad f)^2 / 4
    for f, curvature in [
        (sp.sin(x), lambda u: -np.sin(u)),
        (sp.exp(-(x**2)), lambda u: (4 * u**2 - 2) * np.exp(-(u**2))),
        (x**3, lambda u: 6 * u),
    ]:
        errors = mean_square_errors(f, [x])
        points, weights = np.polynomial.hermite_e.hermegauss(80)
        leading = weights / weights.sum() @ curvature(0.4 + np.sqrt(2) * points) ** 2
        P = 1e-4
        result = errors([0.4], [[2.0]], [[P]])
        assert_allclose(result.plugin - result.optimal, 0.25 * P**2 * leading, rtol=1e-3)


def test_fast_and_slow_parts_together():
    # the line is learnt while the oscillation is still unknown: neither may spoil the other
    errors = mean_square_errors(1000 * x + sp.sin(1000 * x), [x])
    for P in (1e-2, 1e-4, 1e-6, 1e-7, 1e-9, 1e-12):
        result = errors([0.3], [[1.0]], [[P]])
        assert_allclose(result.optimal, 1e6 * P - 0.5 * np.expm1(-1e6 * P), rtol=1e-10)
        excess = 0.5 * np.expm1(-5e5 * P) ** 2
        assert_allclose(result.plugin - result.optimal, excess, rtol=1e-8)


def test_modulus_matches_the_bivariate_function():
    # four sign patterns of L, where the closed form has not lost its digits
    def product(h, k, rho):
        return (
            positive_part_product(h, k, rho)
            + positive_part_product(-h, -k, rho)
            + positive_part_product(h, -k, -rho)
            + positive_part_product(-h, k, -rho)
        )

    for delta, C, P in [(0.4, 2.0, 0.6), (1.0, 1.0, 0.2), (0.0, 3.0, 2.9), (-2.0, 0.5, 0.3)]:
        tau, s = np.sqrt(C), np.sqrt(C - P)
        second = C + delta**2
        optimal = second - C * product(delta / tau, delta / tau, s**2 / C)
        mixed = tau * s * product(delta / tau, delta / s, s / tau)
        plugin = second + s**2 + delta**2 - 2 * mixed
        result = mean_square_errors(abs(x - 1), [x])([1 + delta], [[C]], [[P]])
        assert_allclose(result, [optimal, plugin], rtol=1e-12)


def test_maximum_matches_the_values_of_the_paper_example():
    error_cov = np.array([[0.5, 0.1], [0.1, 0.3]])
    cov = error_cov + np.array([[1, -0.4], [-0.4, 0.8]])
    result = mean_square_errors(sp.Max(x, y), [x, y])([0.3, -0.2], cov, error_cov)
    assert_allclose(result, [0.384190, 0.396050], atol=1e-6)


def test_sign_has_the_arcsine_error():
    for C, P in [(1.0, 0.3), (2.0, 1e-8), (1.0, 1.0)]:
        result = mean_square_errors(sp.sign(x), [x])([0.0], [[C]], [[P]])
        # E sgn x sgn x' = (2 / pi) arcsin(rho); for the optimal error rho = 1 - P / C
        half = np.arctan2(np.sqrt(P / C * (2 - P / C)), 1 - P / C)
        assert_allclose(result.optimal, 2 / np.pi * half, rtol=1e-11)
        known = C - P
        mixed = np.arctan2(np.sqrt(P), np.sqrt(known)) if known > 0 else np.pi / 2
        assert_allclose(result.plugin, 4 / np.pi * mixed if known > 0 else 1.0, rtol=1e-11)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_norm_without_information_matches_the_chi_law(n):
    symbols = sp.symbols(f"u:{n}")
    f = sp.sqrt(sum(s**2 for s in symbols))
    result = mean_square_errors(f, symbols)(np.zeros(n), 2 * np.eye(n), 2 * np.eye(n))
    mean = 2 * special.gamma((n + 1) / 2) / special.gamma(n / 2)
    assert_allclose(result, [2 * n - mean**2, 2 * n], rtol=1e-12)


@pytest.mark.parametrize("distance", [9.99, 10.01, 14.0, 60.0])
def test_norm_changes_its_method_without_a_step(distance):
    # near and far from the origin: against the variance averaged by Gauss-Hermite
    mean = np.array([distance * 0.8, distance * 0.6, 0.0])
    error_cov = np.array([[0.3, 0.1, 0], [0.1, 0.2, 0], [0, 0, 0.1]])
    points, weights = np.polynomial.hermite_e.hermegauss(24)
    grid = np.array(np.meshgrid(points, points, points, indexing="ij")).reshape(3, -1)
    weights = weights / weights.sum()
    weights = np.einsum("i,j,k->ijk", weights, weights, weights).ravel()
    xhat = mean[:, None] + np.sqrt(np.diag(np.eye(3) - np.diag(np.diag(error_cov))))[:, None] * grid
    cov = error_cov + np.diag(1 - np.diag(error_cov))
    f = sp.sqrt(x**2 + y**2 + z**2)
    variance = posterior_variance_function(f, [x, y, z])(xhat, error_cov)
    bias = expectation_function(f, [x, y, z])(xhat, error_cov) - np.linalg.norm(xhat, axis=0)
    result = mean_square_errors(f, [x, y, z])(mean, cov, error_cov)
    assert_allclose(result.optimal, weights @ variance, rtol=1e-9)
    assert_allclose(result.plugin - result.optimal, weights @ bias**2, rtol=1e-5, atol=1e-12)


def test_variance_of_a_distant_norm_is_that_of_its_radial_part():
    direction = np.array([0.6, 0.64, 0.48])
    error_cov = np.diag([100.0, 25.0, 4.0])
    f = sp.sqrt(x**2 + y**2 + z**2)
    variance = posterior_variance_function(f, [x, y, z])
    for distance in (1e5, 1e8):
        value = variance(distance * direction, error_cov)
        assert_allclose(value, direction @ error_cov @ direction, rtol=1e-6)
    batch = variance(np.multiply.outer(direction, [1.0, 1e3, 1e8]), error_cov)
    assert batch.shape == (3,)
    assert_allclose(batch[2], variance(1e8 * direction, error_cov), rtol=1e-12)


def test_variances_in_batches_and_for_small_covariances():
    rng = np.random.default_rng(2)
    points, roots = rng.normal(size=(2, 6)), rng.normal(size=(2, 2, 6))
    covs = np.einsum("ik...,jk...->ij...", roots, roots) * np.logspace(0, -14, 6)
    for f in ALL:
        function = posterior_variance_function(f, [x, y])
        together = function(points, covs)
        for k in range(6):
            one = function(points[:, k], covs[..., k])
            # a norm loses the digits of its square
            lost = 4e-13 if f in NORMS else 0.0
            assert_allclose(together[..., k], one, rtol=1e-9, atol=lost)
            assert np.linalg.eigvalsh(np.atleast_2d(one))[0] >= -1e-12 * np.abs(one).max()
    gradient = posterior_variance_function(sp.sin(x) * y, [x, y])([0.4, 2.0], 1e-14 * np.eye(2))
    assert_allclose(gradient, 1e-14 * ((2 * np.cos(0.4)) ** 2 + np.sin(0.4) ** 2), rtol=1e-10)


@pytest.mark.parametrize("f", [sp.Integer(3), sp.Integer(0), *ALL], ids=str)
def test_degenerate_laws(f):
    errors = mean_square_errors(f, [x, y])
    variance = posterior_variance_function(f, [x, y])
    estimate = expectation_function(f, [x, y])
    zero = np.zeros((2, 2))
    for mean in ([0.0, 0.0], [1.0, 1.0], [0.3, -0.7]):
        for cov in (np.eye(2), np.ones((2, 2)), np.diag([1.0, 0.0]), zero, 1e-20 * np.eye(2)):
            exact = errors(mean, cov, zero)
            assert not np.any(exact)
            # no measurement: the estimate is the prior mean, the plug-in the value at it
            silent = errors(mean, cov, cov)
            value = np.atleast_1d(estimate(mean, zero))
            bias = np.atleast_1d(estimate(mean, cov)) - value
            size = np.abs(np.atleast_2d(silent.plugin)).max()
            prior = variance(mean, cov)
            assert_allclose(silent.optimal, prior, rtol=2e-6, atol=1e-12 * size)
            gap = np.atleast_2d(silent.plugin) - np.atleast_2d(silent.optimal)
            rounding = 1e-15 * (1 + np.abs(value).max())  # of the bias, a difference
            tolerance = 1e-9 * size + 3 * rounding * (rounding + np.abs(bias).max())
            assert_allclose(gap, np.outer(bias, bias), atol=tolerance)
            # and something between, in every degenerate direction
            between = errors(mean, cov, 0.3 * cov)
            assert np.isfinite(np.array(between)).all()
            assert np.linalg.eigvalsh(np.atleast_2d(between.optimal))[0] >= -1e-12 * size


def test_plugin_never_beats_the_optimal_estimate():
    rng = np.random.default_rng(9)
    for f in ALL:
        errors = mean_square_errors(f, [x, y])
        for share in (1.0, 1e-2, 1e-5):
            optimal, plugin = (np.atleast_2d(e) for e in errors(*random_case(rng, 2, share)))
            gap = np.linalg.eigvalsh(plugin - optimal)
            assert gap[0] >= -1e-12 * np.abs(plugin).max()


def test_only_the_coordinates_of_the_function_matter():
    mean, cov, error_cov = random_case(np.random.default_rng(0), 6)
    symbols = sp.symbols("u0:6")
    pick = [4, 1]
    small = (mean[pick], cov[np.ix_(pick, pick)], error_cov[np.ix_(pick, pick)])
    for f in [x * y**2, x * sp.sin(y), abs(x) * y, sp.sqrt(x**2 + y**2)]:
        large = f.subs({x: symbols[4], y: symbols[1]}, simultaneous=True)
        result = mean_square_errors(large, symbols)(mean, cov, error_cov)
        assert_allclose(result, mean_square_errors(f, [x, y])(*small), rtol=1e-11)


def test_units_of_very_different_size():
    # metres against radians: the errors of a product scale with both units
    base = mean_square_errors(x * y**2, [x, y])
    mean, cov, error_cov = random_case(np.random.default_rng(5), 2)
    scale = np.array([1e9, 1e-6])
    scaled = base(mean * scale, cov * np.outer(scale, scale), error_cov * np.outer(scale, scale))
    expected = base(mean, cov, error_cov)
    factor = (1e9 * 1e-12) ** 2
    assert_allclose(scaled, np.array(expected) * factor, rtol=1e-9)


def test_kinds_and_refusals():
    assert mean_square_errors(x * y, [x, y]).kind is FunctionClass.POLYNOMIAL
    for f in [abs(x) + sp.sin(x), abs(x) + abs(y), sp.atan(x), [x, sp.sqrt(x**2 + y**2)]]:
        for make in (mean_square_errors, posterior_variance_function):
            with pytest.raises(NoClosedForm, match="approximate_errors"):
                make(f, [x, y])
    with pytest.raises(ValueError, match="wanted known symbols, got z"):
        mean_square_errors(x * z, [x, y])
    with pytest.raises(TypeError, match="variables"):
        mean_square_errors(x, x)


def test_bad_laws_are_refused():
    errors = mean_square_errors(x * y, [x, y])
    eye = np.eye(2)
    for mean, cov, error_cov, error in [
        ([0.0], eye, eye, ValueError),
        ([0.0, np.nan], eye, eye, ValueError),
        ([0.0, 0.0], [[1, 2], [0, 1]], eye, ValueError),
        ([0.0, 0.0], -eye, eye, ValueError),
        ([0.0, 0.0], eye, np.eye(3), ValueError),
        ([0.0, 1j], eye, eye, TypeError),
        (np.array([0.0, None]), eye, eye, TypeError),
    ]:
        with pytest.raises(error):
            errors(mean, cov, error_cov)
    for cov, error_cov in [
        (eye, 1.001 * eye),
        (np.zeros((2, 2)), eye),
        (np.diag([1e12, 1.0]), np.diag([1e11, 1.5])),
        (np.ones((2, 2)), 0.5 * eye),
    ]:
        with pytest.raises(ValueError, match="error_cov exceeds cov"):
            errors([0.0, 0.0], cov, error_cov)
    # rounding is no excess
    errors([0.0, 0.0], eye, (1 + 1e-12) * eye)


def test_infinite_errors_are_refused():
    errors = mean_square_errors(sp.exp(x**2 / 5), [x])
    assert errors([0.0], [[1.0]], [[0.5]]).optimal > 0
    # the mean under variance 2 is finite, the second moment is not
    assert np.isfinite(expectation_function(sp.exp(x**2 / 5), [x])([0.0], [[2.0]]))
    with pytest.raises(ValueError, match="infinite"):
        errors([0.0], [[2.0]], [[0.1]])


@pytest.mark.filterwarnings("ignore:f. the quadrature rule:UserWarning")
def test_approximate_errors_are_labelled_bounds():
    law = ([0.3], [[1.0]], [[0.2]])
    bounds = approximate_errors(sp.sin(x), [x], degree=30)(*law)
    exact = mean_square_errors(sp.sin(x), [x])(*law)
    assert_allclose(bounds, [exact.optimal, exact.optimal, exact.plugin], rtol=1e-12)
    bounds = approximate_errors(sp.atan(x), [x])(*law)
    assert bounds.lower < bounds.upper < bounds.plugin
    rng = np.random.default_rng(1)
    xhat = 0.3 + np.sqrt(0.8) * rng.normal(size=400_000)
    squares = (np.arctan(xhat + np.sqrt(0.2) * rng.normal(size=xhat.size)) - np.arctan(xhat)) ** 2
    assert abs(squares.mean() - bounds.plugin) < 4 * squares.std() / np.sqrt(xhat.size) + 1e-5
    vector = approximate_errors([sp.atan(x), y], [x, y], degree=8, nodes=30)
    result = vector([0.3, 0.1], np.eye(2), 0.2 * np.eye(2))
    assert result.lower.shape == result.upper.shape == result.plugin.shape == (2, 2)
    assert_allclose(result.lower[1, 1], 0.2, rtol=1e-12)
