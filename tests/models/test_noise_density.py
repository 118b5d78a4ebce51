"""Noise that says its density: maps affine in it have one by the change of variables."""

import pickle

import numpy as np
import pytest
import sympy
from scipy import stats

from seedslib.filters import GridBayesFilter, ParticleFilter
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap, SwitchingSystem

X, V, W, T = sympy.symbols("x v w t", real=True)
DEGREES = 5.0


def student(rng, count):
    return rng.standard_t(DEGREES, (1, count))


def student_log(v):
    return stats.t.logpdf(v[0], DEGREES)


def log_square(rng, count):
    return np.log(rng.standard_normal((1, count)) ** 2)


def log_square_log(v):
    return 0.5 * (v[0] - np.exp(v[0]) - np.log(2 * np.pi))


def pair(rng, count):
    return rng.laplace(size=(2, count))


def pair_log(v):
    return stats.laplace.logpdf(v).sum(axis=0)


def heavy(symbol=V):
    return Noise([symbol], 0, [[DEGREES / (DEGREES - 2)]], student, student_log)


def test_scalar_map_against_scipy():
    map = StochasticMap([X], [sympy.sin(X) * T - (2 + X**2) * V], heavy(), time=T)
    assert map.has_log_density
    assert not map.gaussian_density
    x, y = np.array([[0.3, -1.0, 2.0]]), np.array([[0.5, np.nan, -7.0]])
    found = map.log_density(1.5, y, x)
    wanted = stats.t.logpdf(y[0], DEGREES, 1.5 * np.sin(x[0]), 2 + x[0] ** 2)
    np.testing.assert_allclose(found[[0, 2]], wanted[[0, 2]], rtol=1e-13)
    assert found[1] == 0.0
    nodes = np.linspace(-4000, 4000, 800001)[None]
    mass = np.trapezoid(np.exp(map.log_density(1.5, nodes, np.full_like(nodes, 0.3))), nodes[0])
    assert mass == pytest.approx(1.0, abs=1e-8)


def test_map_of_two_components_integrates_to_one_and_equals_a_hand_made_density():
    x, v = sympy.symbols("x1 x2", real=True), sympy.symbols("v1 v2", real=True)
    noise = Noise(v, 0, 2 * np.eye(2), pair, pair_log)
    value = [x[0] + v[0] + v[1] / 2, x[1] ** 2 - (1 + x[0] ** 2) * v[1]]
    map = StochasticMap(x, value, noise)
    at = np.array([0.5, -1.0])
    y = np.array([[0.1, 2.0], [-0.4, 3.0]])
    second = -(y[1] - 1.0) / 1.25
    wanted = stats.laplace.logpdf(y[0] - 0.5 - second / 2) + stats.laplace.logpdf(second)
    found = map.log_density(0.0, y, np.broadcast_to(at[:, None], (2, 2)))
    np.testing.assert_allclose(found, wanted - np.log(1.25), rtol=1e-13)
    again = pickle.loads(pickle.dumps(map))
    np.testing.assert_array_equal(again.log_density(0.0, y, at[:, None] + 0 * y), found)
    draws = map.sample(0.0, np.broadcast_to(at[:, None], (2, 40000)), np.random.default_rng(1))
    inside = (np.abs(draws - np.array([[0.5], [1.0]])) < 1.0).all(axis=0).mean()
    u = (np.arange(400) + 0.5) / 200 - 1
    grid = np.stack(np.meshgrid(0.5 + u, 1.0 + u)).reshape(2, -1)
    chance = np.exp(map.log_density(0.0, grid, at[:, None] + 0 * grid)).sum() / 200**2
    assert abs(inside - chance) < 4 * np.sqrt(chance / 40000)


def test_volatility_is_written_once_and_its_likelihood_is_that_of_the_returns():
    """log y² = log .25 + x + log v² has the likelihood of y = .5 exp(x/2) v, but for a Jacobian."""
    dynamics = StochasticMap([X], [0.91 * X + V], Noise([V]))
    plain = StochasticMap([X], [sympy.exp(X / 2) * W / 2], Noise([W]))
    moments = (-np.euler_gamma - np.log(2), [[np.pi**2 / 2]])
    shown = StochasticMap(
        [X], [X + W - np.log(4)], Noise([W], *moments, log_square, log_square_log)
    )
    start = (0.0, 1 / (1 - 0.91**2))
    system = DiscreteSystem(dynamics, plain, *start)
    data = system.simulate(range(12), 2, 1)
    y, axis = data.measurements, (-16, 16, 65)
    logs = np.log(y**2)
    one = GridBayesFilter(system, axis).run(data.times, y)
    two = GridBayesFilter(DiscreteSystem(dynamics, shown, *start), axis).run(data.times, logs)
    np.testing.assert_allclose(two.mean, one.mean, atol=1e-11)
    np.testing.assert_allclose(two.loglik, one.loglik + np.log(np.abs(y[:, 0])), atol=1e-11)
    # particles weigh by it too, and a switching system takes it
    rough = ParticleFilter(DiscreteSystem(dynamics, shown, *start), 4000).run(data.times, logs)
    assert np.abs(rough.mean - one.mean).max() < 0.2
    modes = SwitchingSystem.from_maps([[dynamics]], [[shown]], [(1, [0.0], [[start[1]]])])
    same = GridBayesFilter(modes, axis).run(data.times, logs)
    np.testing.assert_allclose(same.mean, one.mean, atol=1e-6)


def test_dynamics_with_heavy_tails():
    """Two steps by plain quadrature over the first state and the noises."""
    moved = StochasticMap([X], [X / 2 + V / 4], heavy())
    sensor = StochasticMap([X], [X + W], Noise([W]))
    system = DiscreteSystem(moved, sensor, 0.3, 0.25)
    found = GridBayesFilter(system, (-30, 30, 1201)).run([0, 1], [[0.4], [-1.0]])
    x = np.linspace(-4, 4, 1601)[:, None]
    v = np.linspace(-60, 60, 6001)
    prior = stats.norm.pdf(x, 0.3, 0.5) * stats.norm.pdf(0.4 - x) * stats.t.pdf(v, DEGREES)
    joint = prior * stats.norm.pdf(-1.0 - x / 2 - v / 4)
    evidence = joint.sum() * (x[1, 0] - x[0, 0]) * (v[1] - v[0])
    assert found.loglik.sum() == pytest.approx(np.log(evidence), abs=1e-6)
    mean = (joint * (x / 2 + v / 4)).sum() / joint.sum()
    assert found.mean[1, 0] == pytest.approx(mean, abs=1e-6)


@pytest.mark.parametrize("value", [[X + V**2], [X], [X + V, V]])
def test_maps_that_cannot_be_solved_have_none(value):
    map = StochasticMap([X], value, heavy())
    assert not map.has_log_density
    with pytest.raises(ValueError, match="log_density"):
        map.log_density(0.0, np.zeros((map.size, 1)), np.zeros((1, 1)))


def test_noises_compare_and_refuse():
    assert heavy() == heavy()
    assert heavy() != Noise([V], 0, heavy().cov, student)
    with pytest.raises(TypeError, match="log_density: wanted a function"):
        Noise([V], log_density=student_log)
    with pytest.raises(TypeError, match="log_density: wanted a function"):
        Noise([V], sample=student, log_density=1.0)
    assert not StochasticMap([X], [X + V], heavy(), period={0: 6.0}).has_log_density
    assert LinearSystem(1, 1, 1, 1, 0, 1).sensor.gaussian_density
