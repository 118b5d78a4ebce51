"""Systems in discrete time, linear and not: simulated paths have the distribution of the model."""

import pickle

import numpy as np
import pytest
import sympy
from scipy.integrate import quad_vec, solve_ivp
from scipy.linalg import expm

from oracles.linear import Regression
from seedslib.base import ELAPSED, Input, Parameter
from seedslib.filters import KalmanFilter, extended_kalman
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap
from seedslib.models.linear import _integral, stepped
from systems import EVEN, INPUTS, TIMES, U, discrete_system, linear_numbers, linear_system

x, v, w, t = sympy.symbols("x v w t")
PATHS = 20_000


def assert_joint_dist(data, oracle):
    """All states and measurements of a run against mean and covariance of the regression."""
    (times, n), m = oracle.state_means.shape, oracle.m
    rows = np.concatenate([oracle.states.reshape(times * n, -1), *oracle.measured])
    mean = np.concatenate([oracle.state_means.ravel(), oracle.measured_means.ravel()])
    cov = rows @ oracle.cov @ rows.T
    drawn = np.concatenate(
        [data.states.reshape(times * n, -1), data.measurements.reshape(times * m, -1)]
    )
    paths, size = drawn.shape[1], np.sqrt(np.diagonal(cov))
    assert (np.abs(drawn.mean(axis=1) - mean) < 4.5 * size / np.sqrt(paths)).all()
    spread = np.sqrt((np.outer(size, size) ** 2 + cov**2) / paths)
    assert (np.abs(np.cov(drawn) - cov) < 5 * spread).all()


@pytest.mark.parametrize("make", [discrete_system, linear_system])
def test_simulated_records_have_the_joint_dist_of_the_model(make):
    """Depends on time and on the length of the step, driven by inputs, from a late start."""
    data = make().simulate(TIMES, PATHS, 1, inputs=INPUTS)
    assert_joint_dist(data, Regression(linear_numbers(means=make is discrete_system)))


def test_functions_of_time_simulate_and_average_as_formulas_do():
    of_functions, formulas = linear_system("functions"), linear_system()
    data = of_functions.simulate(EVEN, PATHS, 1, inputs=INPUTS)
    assert_joint_dist(data, Regression(linear_numbers(EVEN, means=False)))
    at = np.random.default_rng(0).normal(size=(3, 4))
    inputs = {u: row[2] for u, row in INPUTS.items()}
    for name in ("dynamics", "sensor"):
        one, two = (
            getattr(system, name).conditional_moments(2.3, at, system.values(inputs, 0.4))
            for system in (of_functions, formulas)
        )
        np.testing.assert_allclose(one[0], two[0], rtol=1e-13)
        cov = np.broadcast_to(two[1].reshape(*two[1].shape[:2], -1), one[1].shape)
        np.testing.assert_allclose(one[1], cov, rtol=1e-12)
    assert of_functions.sensor.has_log_density


def test_each_path_may_have_inputs_of_its_own():
    """Also beyond the first block of paths: each as where its input is that of all paths."""
    paths = 8192 + 8
    own = INPUTS[U][:, None] * np.linspace(-1.0, 2.0, paths)
    for system, times in ((discrete_system(), TIMES), (linear_system("functions"), EVEN)):
        many = system.simulate(times, paths, 4, inputs=INPUTS | {U: own})
        for path in (1, paths - 3):
            alone = system.simulate(times, paths, 4, inputs=INPUTS | {U: own[:, path]})
            for one, two in zip(many[1:3], alone[1:3], strict=True):
                np.testing.assert_allclose(one[..., path], two[..., path], rtol=1e-12)


def test_dynamics_see_the_time_they_leave():
    system = DiscreteSystem(StochasticMap((x,), [x + t]), StochasticMap((x,), [x * t]), [1], [[0]])
    data = system.simulate([2, 3, 4], 2, 0)
    np.testing.assert_array_equal(data.states[:, 0, 0], [1, 3, 6])
    np.testing.assert_array_equal(data.measurements[:, 0, 0], [2, 9, 24])


def test_continuous_matrices_are_discretised_exactly_for_each_step():
    drift, noise = np.array([[0.0, 1.0], [-2.0, -0.3]]), np.array([[0.2, 0.1], [0.1, 1.5]])
    parts, u = (drift, noise, [[1, 0]], [[0.2]], [0, 0], np.eye(2)), Input("u")
    free = LinearSystem.from_continuous(*parts, step=None, b=[0.5, u])
    at = np.array([0.3, -0.4])
    for step in (0.3, 1.7, 12.0):
        even = LinearSystem.from_continuous(*parts, step=step, b=[0.5, u])
        spread = quad_vec(lambda s: expm(drift * s) @ noise @ expm(drift * s).T, 0, step)[0]
        for system in (even, free, pickle.loads(pickle.dumps(free))):
            p = system.values({u: -0.6}, step)
            mean, cov = system.dynamics.conditional_moments(0.0, at[:, None], p)
            move = solve_ivp(
                lambda t, x: drift @ x + [0.5, -0.6], (0, step), at, rtol=1e-12, atol=1e-13
            )
            moved = move.y[:, -1]
            assert mean[:, 0] == pytest.approx(moved, rel=1e-9)
            assert cov.reshape(2, 2, -1)[..., 0] == pytest.approx(spread, rel=1e-8)


def test_steps_of_one_length_but_for_rounding_are_discretised_once(monkeypatch):
    """Three lengths in 300 steps, whose times are sums of tenths."""
    lengths, made = np.tile([0.1, 0.2, 0.7], 100), []

    def counted(*arguments):
        made.append(arguments[-1])
        return stepped(*arguments)

    def counted_integral(*arguments):
        made.append(arguments[-1])
        return _integral(*arguments)

    monkeypatch.setattr("seedslib.models.linear.stepped", counted)
    monkeypatch.setattr("seedslib.models.linear._integral", counted_integral)
    system = LinearSystem.from_continuous(-0.5, 1, 1, 1, 0, 1, step=None, b=[0.3])
    KalmanFilter(system).run(np.cumsum(lengths), np.zeros((300, 1)))
    assert sorted(made) == pytest.approx([0.1, 0.1, 0.2, 0.2, 0.7, 0.7], rel=1e-11)


def test_numbers_of_records_in_another_shape_are_discretised_in_that_shape():
    q = Parameter("q", 1.0)
    system = LinearSystem.from_continuous([[q]], [[1.0]], 1, 1, 0, 1, step=1.0)
    for numbers in (np.array([0.1, 0.2]), np.array([[0.1], [0.2]])):
        bound = system.bind(q=numbers)
        slope = bound.dynamics.slope_at(0.0, bound.values())
        np.testing.assert_allclose(slope[0, 0], np.exp(numbers), rtol=1e-13)


def growing(t):
    return np.array([t])


def test_an_offset_of_time_is_that_of_the_start_of_a_step():
    weight = (1 - np.exp(-0.5 * 2.0)) / 0.5
    for step in (2.0, None):
        system = LinearSystem.from_continuous(-0.5, 1, 1, 1, 0, 1, step=step, b=growing)
        for one in (system, pickle.loads(pickle.dumps(system))):
            mean, _ = one.dynamics.conditional_moments(3.0, np.zeros((1, 1)), one.values(None, 2.0))
            assert mean[0, 0] == pytest.approx(3.0 * weight, rel=1e-12)


def test_unequal_steps_are_for_maps_that_see_them():
    """Equal ones may be of any length and from anywhere; single steps refuse what a run refuses."""
    even = DiscreteSystem(
        StochasticMap([x], [x / 2 + v], Noise((v,))),
        StochasticMap([x], [x + w], Noise((w,))),
        [0],
        [[1]],
    )
    for start, step in ((0, 1), (7.3, 1e-3), (1.6e9, 0.01), (0, 1e6)):
        assert np.isfinite(even.simulate(start + step * np.arange(4), 1, 0).states).all()
    filter = extended_kalman(even)
    for run in (filter.run, lambda times, y: even.simulate(times, 3, 0)):
        with pytest.raises(ValueError, match=r"^times"):
            run(TIMES, np.zeros((7, 1)))
    state = filter.initial()
    for now in (1.6e9, 1.6e9 + 0.1, 1.6e9 + 0.2):
        state = filter.step(state, now, [0.0])
    with pytest.raises(ValueError, match=r"^t"):
        filter.predict(state, 1.6e9 + 0.5)
    sensed = StochasticMap([x], [x + ELAPSED * w], Noise((w,)))
    with pytest.raises(ValueError, match=r"^sensor"):
        DiscreteSystem(even.dynamics, sensed, [0], [[1]])
