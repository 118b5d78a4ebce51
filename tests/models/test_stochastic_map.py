"""Maps with noise: values, conditional moments, weights, densities."""

import pickle
import warnings

import mpmath
import numpy as np
import pytest
import sympy
from scipy import stats

from seedslib.base import ELAPSED, Input, Parameter
from seedslib.linearization import Taylor, Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap, inputs_of

x, y, v, w = sympy.symbols("x y v w", real=True)
t = sympy.Symbol("t")
rate, u = Parameter("a", 0.7, positive=True), Input("u")
NONE = np.empty((0, 1))


# Values


def test_value_equals_the_arithmetic_of_sympy():
    """Powers, roots, constants, steps and special functions, at five points of a batch."""
    expressions = [
        x**2 * y + x**4 + 1 / (x**2 + 1) ** 3,
        sympy.sqrt(x) * sympy.exp(-(x**2) / 2) / sympy.sqrt(y),
        sympy.erf(x) + x**-2 + x ** sympy.Rational(3, 2) + y ** sympy.Rational(-5, 2),
        sympy.pi**2 / 100 * x + t * sympy.sqrt(2),
        sympy.Rational(1, 3),
        sympy.Piecewise((x, x < 1), (y, True)) * sympy.sign(x - 1) + sympy.Heaviside(y - 1),
        sympy.sinc(x * y) ** 2 + sympy.atan2(y, x) + sympy.Max(x, y) ** 7,
        sympy.Sum(x ** sympy.Symbol("k"), (sympy.Symbol("k"), 0, 3)).doit(),
    ]
    at = np.random.default_rng(0).uniform(0.3, 2.5, (2, 5))
    got = StochasticMap((x, y), expressions).value(0.3, at, np.empty((0, 5)))
    assert got.shape == (8, 5)
    for row, expression in zip(got, expressions, strict=True):
        wanted = [float(expression.subs({t: 0.3, x: a, y: b}).evalf(20)) for a, b in at.T]
        np.testing.assert_allclose(row, wanted, rtol=1e-13)


@pytest.mark.parametrize("kind", [sympy.Symbol, sympy.Dummy])
@pytest.mark.parametrize("name", ["u0_", "u3_", "numpy", "exp", "sqrt", "abs", "sinc"])
def test_a_state_may_have_any_name(kind, name):
    """Names that generated code uses itself; a power has the bits of the products."""
    s, other = kind(name, real=True), sympy.Dummy("u1_", real=True)
    value = [s**3, sympy.exp(s) * other + sympy.sqrt(other) * sympy.Abs(s)]
    at = np.array([[0.4, -1.7], [2.0, 0.3]])
    got = StochasticMap((s, other), value).value(0.0, at, np.empty((0, 2)))
    np.testing.assert_array_equal(got[0], at[0] * at[0] * at[0])
    np.testing.assert_allclose(got[1], np.exp(at[0]) * at[1] + np.sqrt(at[1]) * np.abs(at[0]))


def test_values_of_constants_fill_the_batch_and_the_time_may_be_renamed():
    clock = sympy.Symbol("s")
    for name, options in ((sympy.Symbol("t"), {}), (clock, {"time": clock})):
        moving = StochasticMap((x,), [x * name, 2], **options)
        at = np.ones((1, 3, 4))
        got = moving.value(3.0, 2 * at, np.empty((0, 3, 4)))
        assert got.shape == (2, 3, 4)
        assert (got[0] == 6).all()
        assert (got[1] == 2).all()


@pytest.mark.parametrize("turn", [0.0, 1e-300, -1e-7, 1e-3, 0.7, -19.99, 20.01, 60.0])
def test_a_coordinated_turn_and_its_slope_keep_their_digits_at_any_rate(turn):
    """Displacement h sinc(w h) u - w h^2/2 sinc(w h/2)^2 v, in arithmetic of eighty digits."""
    a, b, q = sympy.symbols("a b q", real=True)
    h = 0.1
    shift = h * sympy.sinc(q * h) * a - q * h**2 / 2 * sympy.sinc(q * h / 2) ** 2 * b
    map = StochasticMap((a, b, q), [shift, q + w], Noise((w,), cov=[[0.1]]))

    def exact(one, two, three):
        if three == 0:
            return one * h
        angle = three * mpmath.mpf(h)
        return (mpmath.sin(angle) * one - (1 - mpmath.cos(angle)) * two) / three

    mean = np.array([3.0, 4.0, turn])
    with mpmath.workdps(80), warnings.catch_warnings():
        warnings.simplefilter("error")
        point = tuple(mpmath.mpf(part) for part in mean)
        wanted = float(exact(*point))
        slope = float(mpmath.diff(exact, point, (0, 0, 1), h=mpmath.mpf(10) ** -15))
        value, cross, _ = Taylor().moments(map)(0.0, mean, np.diag([0, 0, 1.0]))
        points = Unscented().moments(map)(0.0, mean, 1e-8 * np.eye(3))
    assert value[0] == pytest.approx(wanted, rel=1e-14, abs=1e-15)
    assert cross[2, 0] == pytest.approx(slope, rel=1e-12, abs=1e-15)
    assert points.cross[2, 0] == pytest.approx(1e-8 * slope, rel=1e-6, abs=1e-15)


def sensed(t, x, v, a, u, dt):
    return np.exp(-a * dt) * x + u * v


def test_array_functions_are_given_parameters_after_their_own_arguments():
    map = StochasticMap.from_functions(1, 1, sensed, Noise(1), parameters=(rate, u, ELAPSED))
    assert map.parameters == (rate, u, ELAPSED)
    system = DiscreteSystem(map, StochasticMap([x], [x + w], Noise((w,))), [0], [[1]])
    assert inputs_of(system) == {u}
    point = 0.0, np.array([[1.0, 3.0]]), np.array([[0.1, -0.2]])
    got = pickle.loads(pickle.dumps(map)).value(*point, (2.0, np.array([1.0, 2.0]), 0.5))
    np.testing.assert_allclose(got, [[np.exp(-1.0) + 0.1, 3 * np.exp(-1.0) - 0.4]], rtol=1e-15)
    every = StochasticMap.from_functions(
        1,
        1,
        lambda t, x, v, a: x + a * v,
        Noise(1),
        parameters=(rate,),
        mean=lambda t, x, a: x,
        cov=lambda t, x, a: a**2 * np.ones((1, *x.shape)),
        log_density=lambda t, y, x, a: -0.5 * ((y - x)[0] / a) ** 2 - np.log(a),
        weight=lambda t, x, v, a: np.exp(-a * x[0] ** 2),
    )
    at = np.array([[0.5]])
    assert every.conditional_moments(0.0, at, (2.0,))[1].item() == 4.0
    assert every.log_density(0.0, at + 1, at, (2.0,)) == pytest.approx(-0.125 - np.log(2))
    assert every.weight(0.0, at, at, (2.0,)) == pytest.approx(np.exp(-0.5))


# Moments given the state


def test_conditional_moments_of_a_map_of_correlated_noises():
    """Nonlinear in noises of a mean, against Gauss-Hermite sums; formulas and nodes agree."""
    cov, mean = np.array([[1.0, 0.5], [0.5, 2.0]]), np.array([0.5, -0.2])
    noise = Noise((v, w), mean, cov)
    map = StochasticMap((x, y), [x**2 + v * y, sympy.sin(v) + x * w, t * v * w], noise)
    at, now = np.array([[0.7, -1.2], [2.0, 0.1]]), 1.3
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    weights = np.outer(weights, weights).ravel() / weights.sum() ** 2
    grid = np.stack(np.meshgrid(nodes, nodes, indexing="ij")).reshape(2, -1)
    a, b = mean[:, None] + np.linalg.cholesky(cov) @ grid
    got = map.conditional_moments(now, at)
    numeric = StochasticMap.from_functions(2, 3, map.value, noise).conditional_moments(now, at)
    for k, (p, q) in enumerate(at.T):
        values = np.stack([p**2 + a * q, np.sin(a) + p * b, now * a * b])
        wanted = values @ weights
        apart = values - wanted[:, None]
        spread = (apart * weights) @ apart.T
        np.testing.assert_allclose(got[0][:, k], wanted, rtol=1e-12)
        np.testing.assert_allclose(got[1][..., k], spread, rtol=1e-10, atol=1e-13)
        np.testing.assert_allclose(numeric[0][:, k], wanted, rtol=1e-6)
        np.testing.assert_allclose(numeric[1][..., k], spread, rtol=1e-4, atol=1e-6)
    draws = map.sample(now, np.tile(at[:, :1], (1, 100_000)), np.random.default_rng(2))
    error = np.sqrt(np.diagonal(got[1][..., 0]) / 100_000)
    assert (np.abs(draws.mean(axis=1) - got[0][:, 0]) < 4 * error).all()


def test_a_weight_that_looks_at_the_noise_tilts_the_moments():
    branch = StochasticMap((x,), [x + 2 * v], Noise((v,)), weight=sympy.exp(-((v - x) ** 2) / 2))
    mean, cov, weight = (f(0, np.array([[0.7]]), ()) for f in branch.conditional)
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    share = weights / weights.sum() * np.exp(-((nodes - 0.7) ** 2) / 2)
    value = 0.7 + 2 * nodes
    first = share @ value / share.sum()
    np.testing.assert_allclose(weight, [share.sum()], rtol=1e-12)
    np.testing.assert_allclose(mean[0], [first], rtol=1e-12)
    np.testing.assert_allclose(cov[0, 0], [share @ (value - first) ** 2 / share.sum()], rtol=1e-12)
    whole = branch.with_weight(1)
    np.testing.assert_allclose(whole.conditional_moments(0, np.array([[0.7]]))[1].ravel(), 4.0)


# Densities


def test_log_density_of_a_gaussian_map_leaves_missing_components_out():
    noise = Noise((v, w), mean=[0.5, 0], cov=[[1, 0.5], [0.5, 2]])
    sensor = StochasticMap((x, y), [x**2 + v, y + w * x], noise)
    states = np.array([[1.0, 2.0, -1.0], [0.0, 1.0, 3.0]])
    shown = np.array([[1.0, np.nan, np.nan], [0.5, 1.0, np.nan]])
    got = sensor.log_density(0.0, shown, states)
    whole = stats.multivariate_normal([1.5, 0.0], [[1, 0.5], [0.5, 2]]).logpdf(shown[:, 0])
    np.testing.assert_allclose(got, [whole, stats.norm.logpdf(1.0, 1.0, np.sqrt(8)), 0.0])
    assert sensor.has_log_density
    assert sensor.gaussian_density
    assert not StochasticMap((x,), [x * v**2], Noise((v,))).has_log_density


DEGREES = 5.0


def student(rng, count):
    return rng.standard_t(DEGREES, (1, count))


def student_log(v):
    return stats.t.logpdf(v[0], DEGREES)


def pair(rng, count):
    return rng.laplace(size=(2, count))


def pair_log(v):
    return stats.laplace.logpdf(v).sum(axis=0)


HEAVY = Noise([v], 0, [[DEGREES / (DEGREES - 2)]], student, student_log)


def test_density_of_a_map_affine_in_noise_of_a_known_density():
    map = StochasticMap([x], [sympy.sin(x) * t - (2 + x**2) * v], HEAVY, time=t)
    assert map.has_log_density
    assert not map.gaussian_density
    at, shown = np.array([[0.3, -1.0, 2.0]]), np.array([[0.5, np.nan, -7.0]])
    found = map.log_density(1.5, shown, at)
    wanted = stats.t.logpdf(shown[0], DEGREES, 1.5 * np.sin(at[0]), 2 + at[0] ** 2)
    np.testing.assert_allclose(found, np.where(np.isnan(shown[0]), 0.0, wanted), rtol=1e-13)
    spread = map.log_density(1.5, np.array([[[0.5], [-7.0]]]), at)
    wanted = stats.t.logpdf([[0.5], [-7.0]], DEGREES, 1.5 * np.sin(at[0]), 2 + at[0] ** 2)
    np.testing.assert_allclose(spread, wanted, rtol=1e-13)
    for value in ([x + v**2], [x], [x + v, v]):
        assert not StochasticMap([x], value, HEAVY).has_log_density
    assert not StochasticMap([x], [x + v], HEAVY, period={0: 6.0}).has_log_density


def test_density_of_two_components_changes_variables():
    """Laplace noises through a matrix of the state, against the density written by hand."""
    noise = Noise((v, w), 0, 2 * np.eye(2), pair, pair_log)
    map = StochasticMap((x, y), [x + v + w / 2, y**2 - (1 + x**2) * w], noise)
    at = np.array([0.5, -1.0])
    shown = np.array([[0.1, 2.0], [-0.4, 3.0]])
    second = -(shown[1] - 1.0) / 1.25
    wanted = stats.laplace.logpdf(shown[0] - 0.5 - second / 2) + stats.laplace.logpdf(second)
    found = map.log_density(0.0, shown, np.broadcast_to(at[:, None], (2, 2)))
    np.testing.assert_allclose(found, wanted - np.log(1.25), rtol=1e-13)
    again = pickle.loads(pickle.dumps(map))
    np.testing.assert_array_equal(again.log_density(0.0, shown, at[:, None] + 0 * shown), found)


@pytest.mark.parametrize("total", [np.nansum, np.sum])
def test_a_given_log_density_is_asked_about_parts_but_not_about_nothing(total):
    """One that cannot do without a part is refused where that is missing."""
    map = StochasticMap.from_functions(
        1, 2, sensed, log_density=lambda t, y, x: total(stats.norm.logpdf(y, x), axis=0)
    )
    at, gap = np.array([[0.3, -1.0, 2.0]]), np.nan
    found = map.log_density(0.0, np.array([[1.0, gap], [0.5, gap]]), at[:, :2])
    np.testing.assert_allclose(found, [stats.norm.logpdf([1.0, 0.5], 0.3).sum(), 0.0])
    shown = np.array([[gap, gap, 2.0], [gap, gap, gap]])
    if total is np.sum:
        with pytest.raises(ValueError, match="log_density"):
            map.log_density(0.0, shown, at)
    else:
        wanted = [0.0, 0.0, stats.norm.logpdf(0.0)]
        np.testing.assert_allclose(map.log_density(0.0, shown, at), wanted)


def test_a_map_on_a_circle_reports_between_minus_and_plus_half_a_period():
    map = StochasticMap((x,), [x + v, x + w], Noise((v, w)), period={1: 2.0})
    draws = map.sample(0.0, np.full((1, 2000), 7.0), np.random.default_rng(0))
    assert np.abs(draws[1]).max() <= 1.0
    assert draws[0].mean() == pytest.approx(7.0, abs=0.1)
    one = map.log_density(0.0, np.array([[7.0], [0.6]]), np.array([[7.0]]))
    wanted = stats.norm.logpdf(0.0) + stats.norm.logpdf(6.6, 7.0)
    assert one == pytest.approx(wanted, rel=1e-12)
