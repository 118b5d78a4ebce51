"""Noise whose mean is not zero, in the conditional moments of a map and in every linearization."""

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import Noise, StochasticMap
from seedslib.models.branches import Branch

x, y, v, w = sympy.symbols("x y v w", real=True)

MEAN = np.array([0.7, -1.3])
COV = np.array([[0.5, 0.2], [0.2, 0.8]])
NOISE = Noise((v, w), mean=MEAN, cov=COV)
RULES = [Taylor(), ExactGaussian(), Unscented(), Unscented(0.5, 2, 0), Cubature(), GaussHermite(5)]
AT, SPREAD = np.array([0.4]), np.array([[0.3]])


def plain(map):
    return map


def hidden(map):
    """The same map as an array function: points are laid in the joint space of x and the noise."""
    return StochasticMap.from_functions(map.state_size, map.size, map.value, map.noise)


CASES = [(rule, plain) for rule in RULES] + [(rule, hidden) for rule in RULES[2:]]


# What a map does at a fixed state


def product():
    """y = (1 + x) v + 2 w: affine in the noise, and the noise multiplies the state."""
    return StochasticMap((x,), [(1 + x) * v + 2 * w], NOISE)


def test_conditional_moments_in_closed_form():
    mean, cov = product().conditional_moments(0.0, AT)
    row = np.array([1.4, 2.0])
    assert mean == pytest.approx(row @ MEAN)
    assert cov[0, 0] == pytest.approx(row @ COV @ row)


def test_conditional_moments_of_squares_and_exponentials():
    """E v² = mean² + variance and E exp(v) = exp(mean + variance / 2)."""
    map = StochasticMap((x,), [v**2, sympy.exp(v)], NOISE)
    m, d = MEAN[0], COV[0, 0]
    mean, cov = map.conditional_moments(0.0, AT)
    np.testing.assert_allclose(mean, [m**2 + d, np.exp(m + d / 2)], rtol=1e-12)
    high = np.exp(2 * m + d) * np.expm1(d)
    both = np.exp(m + d / 2) * ((m + d) ** 2 - m**2)
    np.testing.assert_allclose(cov, [[4 * m**2 * d + 2 * d**2, both], [both, high]], rtol=1e-11)


def test_conditional_moments_by_nodes():
    """No closed form; against 60 nodes laid about the mean here."""
    map = StochasticMap((x,), [x + sympy.sqrt(4 + v**2)], NOISE)
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    value = AT[0] + np.sqrt(4 + (MEAN[0] + np.sqrt(COV[0, 0]) * nodes) ** 2)
    weights = weights / weights.sum()
    mean, cov = map.conditional_moments(0.0, AT)
    assert mean[0] == pytest.approx(value @ weights, abs=1e-6)
    assert cov[0, 0] == pytest.approx(value**2 @ weights - (value @ weights) ** 2, abs=1e-5)


def test_density_and_draws():
    map, row = product(), np.array([1.4, 2.0])
    law = norm(row @ MEAN, np.sqrt(row @ COV @ row))
    assert map.log_density(0.0, np.array([2.0]), AT) == pytest.approx(law.logpdf(2.0))
    drawn = map.sample(0.0, np.full((1, 40_000), 0.4), np.random.default_rng(0))[0]
    assert drawn.mean() == pytest.approx(law.mean(), abs=4 * law.std() / 200)
    assert drawn.var() == pytest.approx(law.var(), rel=4 * np.sqrt(2) / 200)


# What it does to a Gaussian state


@pytest.mark.parametrize(("rule", "form"), CASES)
def test_affine_map(rule, form):
    """y = 3 x + v - 2 w + 1: every rule is exact, in the space of x and in the joint one."""
    map = form(StochasticMap((x,), [3 * x + v - 2 * w + 1], NOISE))
    row = np.array([1.0, -2.0])
    got = rule.moments(map)(0.0, AT, SPREAD)
    np.testing.assert_allclose(got.mean, [3 * 0.4 + row @ MEAN + 1], rtol=1e-12)
    np.testing.assert_allclose(got.cross, [[3 * 0.3]], rtol=1e-12)
    np.testing.assert_allclose(got.cov, [[9 * 0.3 + row @ COV @ row]], rtol=1e-12)


@pytest.mark.parametrize(("rule", "form"), CASES)
def test_noise_that_multiplies_the_state(rule, form):
    """y = (1 + x) v + 2 w: the mean of v is the slope; the variance of Taylor is taken at m."""
    map = form(product())
    m, d = AT[0], SPREAD[0, 0]
    got = rule.moments(map)(0.0, AT, SPREAD)
    np.testing.assert_allclose(got.mean, [(1 + m) * MEAN[0] + 2 * MEAN[1]], rtol=1e-12)
    np.testing.assert_allclose(got.cross, [[MEAN[0] * d]], rtol=1e-12)
    row = np.array([1 + m, 2.0])
    at_mean = MEAN[0] ** 2 * d + row @ COV @ row
    exact = at_mean + d * COV[0, 0]
    if map.symbolic or isinstance(rule, GaussHermite):  # others miss part of fourth moments there
        want = at_mean if isinstance(rule, Taylor) else exact
        np.testing.assert_allclose(got.cov, [[want]], rtol=1e-12)


def test_taylor_expands_about_the_mean_of_the_noise():
    """y = exp(x v): value, slope by the state and slope by the noise at (m, mean of v)."""
    map = StochasticMap((x,), [sympy.exp(x * v)], NOISE)
    m, d, u = AT[0], SPREAD[0, 0], MEAN[0]
    value = np.exp(m * u)
    got = Taylor().moments(map)(0.0, AT, SPREAD)
    np.testing.assert_allclose(got.mean, [value], rtol=1e-13)
    np.testing.assert_allclose(got.cross, [[d * u * value]], rtol=1e-13)
    square = (u * value) ** 2 * d + (m * value) ** 2 * COV[0, 0]
    np.testing.assert_allclose(got.cov, [[square]], rtol=1e-13)
    there = Taylor().transition(map)(0.0, AT, SPREAD)
    np.testing.assert_allclose(there.mean, got.mean, rtol=1e-15)
    np.testing.assert_allclose(there.cov, got.cov, rtol=1e-15)


@pytest.mark.parametrize(
    ("rule", "form"),
    [(ExactGaussian(), plain), (GaussHermite(24), plain), (GaussHermite(24), hidden)],
)
def test_noise_inside_an_exponential(rule, form):
    """y = exp(x + v) is log-normal: mean e, covariance with x D e, variance e² (exp(D + R) - 1)."""
    map = form(StochasticMap((x,), [sympy.exp(x + v)], NOISE))
    d, r = SPREAD[0, 0], COV[0, 0]
    e = np.exp(AT[0] + MEAN[0] + (d + r) / 2)
    got = rule.moments(map)(0.0, AT, SPREAD)
    np.testing.assert_allclose(got.mean, [e], rtol=1e-10)
    np.testing.assert_allclose(got.cross, [[d * e]], rtol=1e-10)
    np.testing.assert_allclose(got.cov, [[e**2 * np.expm1(d + r)]], rtol=1e-8)


# Branches of a switching map


@pytest.mark.parametrize("rule", RULES)
def test_branch_of_constant_probability(rule):
    """The moments of the branch are those of the map; only the mass is the probability."""
    branch = StochasticMap((x,), [(1 + x) * v + 2 * w], NOISE, weight=0.3)
    got = rule.weighted(branch)(0.0, AT, SPREAD)
    row = np.array([1 + AT[0], 2.0])
    assert got.mass == pytest.approx(0.3)
    np.testing.assert_allclose(got.value.mean, [row @ MEAN], rtol=1e-12)
    np.testing.assert_allclose(got.value.cross, [[MEAN[0] * SPREAD[0, 0]]], rtol=1e-12)


@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian(), GaussHermite(5)])
def test_branch_whose_probability_depends_on_the_state(rule):
    """w = 0.5 + 0.1 x leans the state by 0.1 D / mass; y = 2 v + x v follows it."""
    branch = StochasticMap((x,), [2 * v + x * v], NOISE, weight=0.5 + 0.1 * x)
    got = rule.weighted(branch)(0.0, AT, SPREAD)
    mass = 0.5 + 0.1 * AT[0]
    centre = AT[0] + 0.1 * SPREAD[0, 0] / mass
    assert got.mass == pytest.approx(mass)
    np.testing.assert_allclose(got.state.mean, [centre], rtol=1e-12)
    np.testing.assert_allclose(got.value.mean, [MEAN[0] * (2 + centre)], rtol=1e-12)


@pytest.mark.parametrize("rule", [ExactGaussian(), GaussHermite(60)])
def test_branch_whose_probability_depends_on_the_noise(rule):
    """Probability Phi(v) of y = x + v: mass Phi(c), the noise leans by R phi(c) / Phi(c) / s."""
    chance = (1 + sympy.erf(v / sympy.sqrt(2))) / 2
    branch = StochasticMap((x,), [x + v], Noise((v,), mean=0.7, cov=[[0.5]]), weight=chance)
    s = np.sqrt(1.5)
    mass = norm.cdf(0.7 / s)
    lean = 0.5 * norm.pdf(0.7 / s) / s / mass
    got = rule.weighted(branch)(0.0, AT, SPREAD)
    assert got.mass == pytest.approx(mass, rel=1e-9)
    np.testing.assert_allclose(got.state.mean, AT, rtol=1e-9)
    np.testing.assert_allclose(got.value.mean, AT + 0.7 + lean, rtol=1e-8)
    made = Branch(branch)
    assert made.probability(0.0, AT[:, None]) == pytest.approx(mass)
    # y = 2 shows v = 2 - x: its density times Phi of it
    want = norm.logpdf(1.6, 0.7, np.sqrt(0.5)) + norm.logcdf(1.6)
    assert made.log_density(0.0, np.array([[2.0]]), AT[:, None]) == pytest.approx(want)


def test_probability_of_a_branch_by_nodes():
    """1 / (1 + v²) has no closed form; its mean by 60 nodes about the mean of v."""
    made = Branch(StochasticMap((x,), [x + v], NOISE, weight=1 / (9 + v**2)))
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    at = MEAN[0] + np.sqrt(COV[0, 0]) * nodes
    want = (1 / (9 + at**2)) @ weights / weights.sum()
    assert made.probability(0.0, AT[:, None]) == pytest.approx(want, rel=1e-6)


# The unscented transform away from its defaults


@pytest.mark.parametrize(
    ("alpha", "beta", "kappa"),
    [(0.5, 2, 0), (1, 0, 2), (0.3, 2, 1), (1e-2, 2, 0), (2, 0, -0.5), (0.7, -1, 3)],
)
def test_unscented_square(alpha, beta, kappa):
    """Y = X²: E Y = m² + D and F = 4 m² D + (alpha² kappa + beta) D² for all parameters.

    With r = alpha² (1 + kappa) the points are m and m ± sqrt(r D), their values less the mean
    -D and ± 2 m sqrt(r D) + (r - 1) D; weights of squares 1 - 1/r + 1 - alpha² + beta and
    1 / (2 r) twice. Then F = (2 - 1/r - alpha² + beta) D² + 4 m² D + (r - 1)² D² / r.
    """
    square = StochasticMap((x,), [x**2], None)
    mean, cov = np.array([[1.7, -0.2]]), np.array([[[0.6, 1.1]]])
    got = Unscented(alpha, beta, kappa).moments(square)(0.0, mean, cov)
    m, d = mean[0], cov[0, 0]
    close = {"rtol": 1e-13 / alpha**2, "atol": 1e-14}
    np.testing.assert_allclose(got.mean[0], m**2 + d, **close)
    np.testing.assert_allclose(got.cross[0, 0], 2 * m * d, **close)
    np.testing.assert_allclose(
        got.cov[0, 0], 4 * m**2 * d + (alpha**2 * kappa + beta) * d**2, **close
    )


def test_unscented_square_in_two_dimensions():
    """Y = X1² + X2²: r = alpha² (2 + kappa); the axes share the central weight.

    Values less the mean are -D1 - D2 and ± 2 m_i sqrt(r D_i) + r D_i - D1 - D2.
    """
    alpha, beta, kappa = 0.5, 2.0, 1.0
    square = StochasticMap((x, y), [x**2 + y**2], None)
    m, d = np.array([0.5, -1.0]), np.array([0.3, 0.7])
    got = Unscented(alpha, beta, kappa).moments(square)(0.0, m, np.diag(d))
    r, total = alpha**2 * (2 + kappa), d.sum()
    want = (1 - 2 / r + 1 - alpha**2 + beta) * total**2 + (4 * m**2 * d).sum()
    want += ((r * d - total) ** 2).sum() / r
    np.testing.assert_allclose(got.mean, [(m**2 + d).sum()], rtol=1e-13)
    np.testing.assert_allclose(got.cov, [[want]], rtol=1e-13)
