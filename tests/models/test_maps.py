import numpy as np
import pytest
import sympy
from scipy.stats import multivariate_normal

from seedslib.gaussian import NoClosedForm
from seedslib.models import Noise, StochasticMap

x, y, v, w, t = sympy.symbols("x y v w t")


def test_noise_draws_have_the_stated_moments():
    cov = np.array([[2.0, 0.6], [0.6, 0.5]])
    noise = Noise((v, w), mean=[1.0, -2.0], cov=cov)
    draws = noise.draw(np.random.default_rng(1), 200_000)
    error = 4 / np.sqrt(200_000)
    np.testing.assert_allclose(draws.mean(axis=1), [1, -2], atol=error * np.sqrt(2))
    np.testing.assert_allclose(np.cov(draws), cov, atol=error * 2 * np.sqrt(2))


def test_singular_noise_stays_on_its_line():
    draws = Noise((v, w), cov=[[1, 2], [2, 4]]).draw(np.random.default_rng(0), 50)
    np.testing.assert_allclose(draws[1], 2 * draws[0], rtol=1e-14)


def test_first_draws_of_many_are_the_draws_of_few():
    noise = Noise((v, w), cov=[[1, 0.5], [0.5, 1]])
    few, many = (noise.draw(np.random.default_rng(4), n) for n in (3, 100))
    np.testing.assert_array_equal(few, many[:, :3])


def test_noise_without_a_gaussian_law():
    def sample(rng, count):
        return rng.uniform(-1, 1, (1, count))

    noise = Noise((v,), cov=[[1 / 3]], sample=sample)
    draws = noise.draw(np.random.default_rng(0), 10_000)
    assert abs(draws).max() <= 1
    assert float(noise.expectation(x * v**2 + v).subs(x, 3)) == pytest.approx(1)
    with pytest.raises(NoClosedForm, match="only its mean and covariance are known"):
        noise.expectation(v**4)
    bad = Noise((v,), sample=lambda rng, count: np.zeros(count))
    with pytest.raises(ValueError, match=r"noise.sample: wanted shape \(1, 5\), got \(5,\)"):
        bad.draw(np.random.default_rng(0), 5)


@pytest.mark.parametrize(
    "expression",
    [
        v**2 * x + v * w + 3,
        sympy.exp(v) * x + v**4,
        sympy.sin(v + x) * w,
        sympy.exp(-((v - x) ** 2) / 2),
    ],
)
def test_noise_expectation_against_quadrature(expression):
    cov = [[1.2, 0.3], [0.3, 0.5]]
    noise = Noise((v, w), mean=[0.2, -0.1], cov=cov)
    got = sympy.lambdify(x, noise.expectation(expression))(0.7)
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    weights = weights / weights.sum()
    root = np.linalg.cholesky(cov)
    a, b = np.meshgrid(nodes, nodes)
    points = np.array([0.2, -0.1])[:, None, None] + np.einsum("ij,jkl->ikl", root, np.array([a, b]))
    values = sympy.lambdify((x, v, w), expression, "numpy")(0.7, *points)
    np.testing.assert_allclose(complex(got).real, weights @ values @ weights, rtol=1e-12)
    assert abs(complex(got).imag) < 1e-14


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"symbols": (v,), "cov": [[-1.0]]}, "cov: wanted a positive semidefinite"),
        ({"symbols": (v,), "cov": np.eye(2)}, r"cov: wanted shape \(1, 1\)"),
        ({"symbols": -1}, "symbols: wanted"),
    ],
)
def test_bad_noise(arguments, message):
    with pytest.raises(ValueError, match=message):
        Noise(**arguments)


def test_noise_sampler_must_be_a_function():
    with pytest.raises(TypeError, match="sample: wanted a function"):
        Noise((v,), sample=3)


def test_conditional_moments_of_a_multiplicative_sensor():
    b, r = sympy.Rational(1, 5), 2
    sensor = StochasticMap((x,), [x * (1 + b * v) + r * w], Noise((v, w)))
    mean, cov, weight = sensor.conditional_expressions
    assert mean.tolist() == [x]
    assert sympy.simplify(cov[0, 0] - (b**2 * x**2 + r**2)) == 0
    assert weight == 1
    assert not sensor.weighted
    points = np.array([[0.0, 1.0, -2.0]])
    np.testing.assert_allclose(sensor.conditional.cov(0, points)[0, 0], 4 + 0.04 * points[0] ** 2)
    got = sensor.conditional_moments(0, points)
    np.testing.assert_allclose(got[0], points)


def test_conditional_moments_by_nodes_where_there_is_no_closed_form():
    smooth = StochasticMap.from_functions(1, 1, lambda t, x, v: np.exp(v) * x, Noise(1))
    mean, cov = smooth.conditional_moments(0, np.array([[1.0, 2.0]]))
    np.testing.assert_allclose(mean[0], np.exp(0.5) * np.array([1, 2]), rtol=1e-6)
    variance = (np.exp(2) - np.exp(1)) * np.array([1, 4])
    np.testing.assert_allclose(cov[0, 0], variance, rtol=1e-4)
    shapeless = Noise(1, sample=lambda rng, count: rng.uniform(-1, 1, (1, count)))
    other = StochasticMap.from_functions(1, 1, lambda t, x, v: x + v, shapeless)
    with pytest.raises(ValueError, match="array functions"):
        other.conditional_moments(0, np.ones((1, 2)))


def test_weight_that_depends_on_the_noise_tilts_the_moments():
    """Branch weight exp(-(v - x)²/2) against Gauss-Hermite sums."""
    branch = StochasticMap((x,), [x + 2 * v], Noise((v,)), weight=sympy.exp(-((v - x) ** 2) / 2))
    mean, cov, weight = (f(0, np.array([[0.7]])) for f in branch.conditional)
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    share = weights / weights.sum() * np.exp(-((nodes - 0.7) ** 2) / 2)
    value = 0.7 + 2 * nodes
    first = share @ value / share.sum()
    np.testing.assert_allclose(weight, [share.sum()], rtol=1e-12)
    np.testing.assert_allclose(mean[0], [first], rtol=1e-12)
    np.testing.assert_allclose(cov[0, 0], [share @ (value - first) ** 2 / share.sum()], rtol=1e-12)


def test_samples_follow_the_conditional_moments():
    sensor = StochasticMap((x,), [x**2 + v, x * w], Noise((v, w), cov=[[1, 0.5], [0.5, 1]]))
    states = np.full((1, 100_000), 1.5)
    draws = sensor.sample(0.0, states, np.random.default_rng(2))
    mean, cov, _ = (f(0, states[:, :1]) for f in sensor.conditional)
    error = 4 * 1.5 / np.sqrt(100_000)
    np.testing.assert_allclose(draws.mean(axis=1), mean[:, 0], atol=error)
    np.testing.assert_allclose(np.cov(draws), cov[..., 0], atol=3 * error)


def test_log_density_with_missing_components():
    sensor = StochasticMap(
        (x, y), [x**2 + v, y + w * x], Noise((v, w), mean=[0.5, 0], cov=[[1, 0.5], [0.5, 2]])
    )
    states = np.array([[1.0, 2.0, -1.0], [0.0, 1.0, 3.0]])
    seen = np.array([[1.0, np.nan, np.nan], [0.5, 1.0, np.nan]])
    got = sensor.log_density(0.0, seen, states)
    mean, cov, _ = (f(0, states) for f in sensor.conditional)
    np.testing.assert_allclose(
        got[0], multivariate_normal(mean[:, 0], cov[..., 0]).logpdf(seen[:, 0]), rtol=1e-12
    )
    np.testing.assert_allclose(
        got[1], multivariate_normal(mean[1, 1], cov[1, 1, 1]).logpdf(1.0), rtol=1e-12
    )
    assert got[2] == 0


def test_log_density_is_refused_where_it_has_no_closed_form():
    sensor = StochasticMap((x,), [x * v**2], Noise((v,)))
    assert not sensor.has_log_density
    with pytest.raises(ValueError, match="log_density: wanted y affine in Gaussian noise"):
        sensor.log_density(0, np.zeros((1, 1)), np.zeros((1, 1)))
    given = StochasticMap.from_functions(
        1, 1, lambda t, x, v: x + v, Noise(1), log_density=lambda t, y, x: -abs(y - x)[0]
    )
    assert given.has_log_density
    assert given.log_density(0, np.ones((1, 2)), np.zeros((1, 2))).tolist() == [-1, -1]


def test_time_may_be_used_and_renamed():
    moving = StochasticMap((x,), [x * t])
    assert moving.value(3.0, np.array([[2.0]]), np.empty((0, 1)))[0, 0] == 6
    clock = sympy.Symbol("s")
    other = StochasticMap((x,), [x * clock], time=clock)
    assert other.value(3.0, np.array([[2.0]]), np.empty((0, 1)))[0, 0] == 6


def test_bad_maps():
    with pytest.raises(ValueError, match="got y"):
        StochasticMap((x,), [x + y])
    with pytest.raises(ValueError, match="value: wanted a vector"):
        StochasticMap((x,), [[x]])
    with pytest.raises(ValueError, match="noise: wanted named components"):
        StochasticMap((x,), [x], Noise(1))
    with pytest.raises(ValueError, match="mean, cov: wanted both or neither"):
        StochasticMap.from_functions(1, 1, lambda t, x, v: x, mean=lambda t, x: x)
    short = StochasticMap.from_functions(1, 2, lambda t, x, v: x)
    with pytest.raises(ValueError, match=r"value: wanted shape \(2, \*batch\) from the function"):
        short.value(0, np.ones((1, 3)), None)
    with pytest.raises(NoClosedForm, match="array functions have no closed form"):
        _ = short.conditional
