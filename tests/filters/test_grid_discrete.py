"""Discrete systems on exact grids: against Kalman filters, one mode, and by hand."""

import warnings
from itertools import pairwise

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from seedslib.base import Nodes, Parameter, assigned
from seedslib.design import grid_synthesis, plane_steps
from seedslib.designed import Memory
from seedslib.evaluation import fit
from seedslib.filters import GridBayesFilter, KalmanFilter, smooth
from seedslib.models import (
    DiscreteChain,
    DiscreteSystem,
    LinearSystem,
    Noise,
    PlaneModes,
    StochasticMap,
    SwitchingSystem,
)

X, V, W, T = sympy.symbols("x v w t", real=True)
F, Q, H, R = 0.9, 0.5, 1.0, 0.3
TWO = np.eye(2)
LINE = (-9.0, 9.0, 65)  # a step of .4 deviations of the noise


def line():
    return LinearSystem([[F]], [[Q]], [[H]], [[R]], [0.2], [[1.0]])


@pytest.fixture(scope="module")
def record():
    y = np.random.default_rng(1).standard_normal((20, 1, 3))
    y[4, 0, 1] = np.nan
    return np.arange(20.0), y


def plain(cov, batch):
    return np.broadcast_to(cov[..., None] if cov.ndim == 3 else cov, (*cov.shape[:3], *batch))


def growth():
    moved = X / 2 + 25 * X / (1 + X**2) + 8 * sympy.cos(1.2 * T) + V
    return (
        StochasticMap([X], [moved], Noise([V]), time=T),
        StochasticMap([X], [X**2 / 20 + W], Noise([W]), time=T),
    )


def one_mode(dynamics, sensor, mean, cov):
    return SwitchingSystem.from_maps([[dynamics]], [[sensor]], [(1, [mean], [[cov]])])


@pytest.mark.parametrize("nodes", [LINE, "uneven"])
def test_linear_system_equals_the_kalman_filter(record, nodes):
    if nodes == "uneven":
        u = np.linspace(-1.2, 1.2, 97)
        nodes = Nodes(6 * np.sinh(u), 6 * np.cosh(u) * (u[1] - u[0]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = GridBayesFilter(line(), nodes).run(*record)
    wanted = KalmanFilter(line()).run(*record)
    np.testing.assert_allclose(found.mean, wanted.mean, atol=1e-8)
    np.testing.assert_allclose(found.cov, plain(wanted.cov, (3,)), atol=1e-8)
    np.testing.assert_allclose(found.loglik, wanted.loglik, atol=1e-8)
    assert found.mode_prob is None
    assert not found.diverged.any()


def test_linear_system_of_two_components_equals_the_kalman_filter(record):
    times, y = record
    times, y = times[:8], y[:8]
    system = LinearSystem(
        [[0.5, 0.2], [-0.1, 0.4]], [[0.5, 0.1], [0.1, 0.4]], [[1.0, 0.5]], [[R]], [0.2, 0.0],
        [[0.6, 0.1], [0.1, 0.5]],
    )  # fmt: skip
    found = GridBayesFilter(system, [(-5.2, 5.2, 27), (-4.6, 4.6, 26)]).run(times, y)
    wanted = KalmanFilter(system).run(times, y)
    np.testing.assert_allclose(found.mean, wanted.mean, atol=1e-6)
    np.testing.assert_allclose(found.cov, plain(wanted.cov, (3,)), atol=1e-6)
    np.testing.assert_allclose(found.loglik, wanted.loglik, atol=1e-6)


@pytest.mark.parametrize("lag", [None, 1, 3])
def test_smoothing_equals_that_of_the_kalman_filter(record, lag):
    found = smooth(GridBayesFilter(line(), LINE), *record, lag=lag)
    wanted = smooth(KalmanFilter(line()), *record, lag=lag)
    np.testing.assert_allclose(found.mean, wanted.mean, atol=1e-8)
    np.testing.assert_allclose(found.cov, plain(wanted.cov, (3,)), atol=1e-8)
    np.testing.assert_allclose(found.loglik, wanted.loglik, atol=1e-8)


def test_smoothing_of_modes_equals_the_sum_over_all_paths():
    stay = [[0.8, 0.2], [0.3, 0.7]]
    system = SwitchingSystem(
        [X], [[X / 2 + V], [2 - X / 2 + V]], Noise([V], cov=[[0.5]]), stay, [[X + W], [X + W]],
        Noise([W]), [(0.4, [0], [[1]]), (0.6, [1], [[1]])],
    )  # fmt: skip
    times, y = np.arange(4.0), np.array([[0.3], [2.0], [-0.5], [1.0]])
    found = smooth(GridBayesFilter(system, (-8, 9, 137)), times, y)
    # of each of the 16 courses of the modes the likelihood by a Kalman filter of its own
    weights, means = [], []
    for course in np.ndindex(2, 2, 2, 2):
        a = np.array([[0.5, -0.5][m] for m in course])
        b = np.array([[0.0, 2.0][m] for m in course])
        mean, cov = np.array([float(course[0])]), np.array([[1.0]])
        for k in range(3):  # joint law of all states
            cross = a[k] * cov[:, -1:]
            mean = np.append(mean, a[k] * mean[-1] + b[k])
            cov = np.block([[cov, cross], [cross.T, a[k] ** 2 * cov[-1:, -1:] + 0.5]])
        likely = np.exp(-0.5 * (y[:, 0] - mean) @ np.linalg.solve(cov + np.eye(4), y[:, 0] - mean))
        likely /= np.sqrt(np.linalg.det(cov + np.eye(4)))
        chance = [0.4, 0.6][course[0]] * np.prod([stay[i][j] for i, j in pairwise(course)])
        weights.append(chance * likely)
        means.append(mean + cov @ np.linalg.solve(cov + np.eye(4), y[:, 0] - mean))
    weights = np.array(weights) / np.sum(weights)
    np.testing.assert_allclose(found.mean[:, 0], weights @ np.array(means), atol=1e-7)
    second = np.array([np.array(c) for c in np.ndindex(2, 2, 2, 2)])
    np.testing.assert_allclose(found.mode_prob[:, 1], weights @ second, atol=1e-7)


def test_growth_model_equals_the_system_of_one_mode():
    dynamics, sensor = growth()
    system = DiscreteSystem(dynamics, sensor, 0.1, 1.0)
    other = one_mode(dynamics, sensor, 0.1, 1.0)
    data = system.simulate(range(16), 4, 1)
    found, wanted = (
        GridBayesFilter(s, (-36, 36, 217)).run(data.times, data.measurements)
        for s in (system, other)
    )
    np.testing.assert_allclose(found.mean, wanted.mean, atol=1e-10)
    np.testing.assert_allclose(found.cov, wanted.cov, atol=1e-10)
    np.testing.assert_allclose(found.loglik, wanted.loglik, atol=1e-12)


def test_design_equals_that_of_the_system_of_one_mode():
    dynamics, sensor = growth()
    axes = {"x": (-36, 36, 145), "z": (-34, 34, 91), "y": (-6, 66, 145)}
    system = DiscreteSystem(dynamics, sensor, 0.1, 1.0)
    found = grid_synthesis(system, Memory(1), range(4), **axes)
    wanted = grid_synthesis(one_mode(dynamics, sensor, 0.1, 1.0), Memory(1), range(4), **axes)
    np.testing.assert_allclose(found.predicted.rms, wanted.predicted.rms, rtol=1e-11)
    np.testing.assert_allclose(found.steps[0].shown[1], wanted.steps[0].shown[1], atol=1e-10)
    assert found.node_times[0].size == 0
    # the paths of a run stay where tables have probability, and there they are the same
    data = system.simulate(range(4), 400, 3)
    apart = found.run(data.times, data.measurements).mean
    apart = apart - wanted.run(data.times, data.measurements).mean
    assert np.median(np.abs(apart), axis=2).max() < 1e-12


def test_design_in_the_plane_equals_that_of_one_mode():
    x = sympy.symbols("x1 x2", real=True)
    noise = sympy.symbols("v1 v2", real=True)
    moved = [x[0] / 2 + x[1] / 5 + noise[0], sympy.sin(x[0]) / 2 + noise[1]]
    dynamics = StochasticMap(x, moved, Noise(noise))
    sensor = StochasticMap(x, [x[0] + W], Noise([W]))
    system = DiscreteSystem(dynamics, sensor, [0, 0], np.eye(2))
    other = SwitchingSystem.from_maps([[dynamics]], [[sensor]], [(1, [0, 0], np.eye(2))])
    axes = [(-5.5, 5.5, 19), (-5.5, 5.5, 19)]
    found, wanted = (
        np.array([s.mse for s in plane_steps(
            chain, range(3), z=[(-3, 3, 9)] * 2, y=(-9, 9, 22)
        )]) for chain in (DiscreteChain(system, axes), PlaneModes(other, axes))
    )  # fmt: skip
    np.testing.assert_allclose(found, wanted, rtol=1e-4)  # both leave out shares of 1e-7


def test_what_leaves_the_axis_is_dropped_counted_and_warned_about():
    still = StochasticMap([X], [X + V], Noise([V], cov=[[0.25]]))
    sensor = StochasticMap([X], [X + W], Noise([W]))
    system = DiscreteSystem(still, sensor, 0.0, 0.0)
    missing = [[np.nan], [np.nan]]
    filter = GridBayesFilter(system, (-1.0, 1.0, 2001))
    with pytest.warns(UserWarning, match="leaves the nodes"):
        found = filter.run([0, 1], missing)
    inside = norm.cdf(2.0) - norm.cdf(-2.0)  # two deviations to either side of the known start
    assert found.loglik.sum() == pytest.approx(np.log(inside), abs=4e-7)
    assert found.mean[1, 0] == pytest.approx(0.0, abs=1e-12)
    two = norm.pdf(2.0)  # variance of a normal law cut off at two deviations
    assert found.cov[1, 0, 0] == pytest.approx(0.25 * (1 - 4 * two / inside), rel=1e-6)
    told = filter.accuracy([0, 1], missing)
    assert told.lost == pytest.approx(1 - inside, abs=4e-7)
    # a switching system keeps it
    kept = GridBayesFilter(one_mode(still, sensor, 0.0, 0.0), (-1.0, 1.0, 401))
    assert kept.run([0, 1], missing).loglik.sum() == pytest.approx(0.0, abs=1e-12)
    assert kept.accuracy([0, 1], missing).lost == pytest.approx(0.0, abs=1e-12)


def test_accuracy_bounds_the_error(record):
    wanted = KalmanFilter(line()).run(*record)
    for count in (17, 21, 25):
        filter = GridBayesFilter(line(), (-9, 9, count))
        told = filter.accuracy(*record)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = filter.run(*record)
        error = np.abs((found.loglik - wanted.loglik).sum(axis=0))
        assert (error > 1e-12).all()
        assert (error < told.loglik).all()
        assert (np.abs(found.mean - wanted.mean).max(axis=0) < told.mean).all()
    assert GridBayesFilter(line(), LINE).accuracy(*record).loglik.max() < 1e-3


def by_hand(u, y):
    """Log-likelihood of x' = F x + u + noise by the scalar Kalman filter."""
    mean, cov, found = 0.2, 1.0, 0.0
    for k in range(len(y)):
        if k:
            mean, cov = F * mean + u[k - 1], F**2 * cov + Q
        found += norm.logpdf(y[k], mean, np.sqrt(cov + R))
        gain = cov / (cov + R)
        mean, cov = mean + gain * (y[k] - mean), (1 - gain) * cov
    return found


@pytest.mark.parametrize("switching", [False, True])
def test_values_of_parameters_may_change_from_step_to_step(record, switching):
    u = Parameter("u", 0.0)
    dynamics = StochasticMap([X], [F * X + u + V], Noise([V], cov=[[Q]]))
    sensor = StochasticMap([X], [X + W], Noise([W], cov=[[R]]))
    times, y = record[0], record[1][:, 0, 0]
    told = np.cos(times)
    system = DiscreteSystem(dynamics, sensor, 0.2, 1.0)
    filter = GridBayesFilter(
        one_mode(dynamics, sensor, 0.2, 1.0) if switching else system, (-14, 14, 101)
    )
    state, found = filter.initial(), 0.0
    for k, t in enumerate(times):
        with assigned({u: told[k - 1]}):
            state = filter.step(state, t, y[k : k + 1])
        found += state.loglik
    assert found == pytest.approx(by_hand(told, y), abs=1e-8)
    if not switching:
        with assigned({u: np.zeros(3)}), pytest.raises(ValueError, match="one value on a grid"):
            filter.predict(state, times[-1] + 1)


def test_fit_on_a_grid_equals_that_of_the_kalman_filter(record):
    times, y = record[0], record[1][:, :, 0]
    f = Parameter("f", 0.5)
    moved = StochasticMap([X], [f * X + V], Noise([V], cov=[[Q]]))
    system = DiscreteSystem(moved, StochasticMap([X], [X + W], Noise([W], cov=[[R]])), 0.2, 1.0)
    found = fit(lambda: GridBayesFilter(system, (-9, 9, 49)), times, y, [f])
    wanted = fit(KalmanFilter(LinearSystem([[f]], Q, 1, R, 0.2, 1.0)), times, y, [f])
    assert found.converged
    np.testing.assert_allclose(found.values, wanted.values, rtol=1e-6)
    np.testing.assert_allclose(found.errors, wanted.errors, rtol=1e-5)


def sampled(rng, count):
    return rng.standard_normal((1, count))


@pytest.mark.filterwarnings("ignore:x. more than")
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: LinearSystem(1, 0, 1, 1, 0, 1), "dynamics: wanted noise of its own"),
        (
            lambda: LinearSystem(TWO, np.ones((2, 2)), TWO, TWO, [0, 0], TWO),
            "dynamics: wanted noise of its own",
        ),
        (
            lambda: LinearSystem(TWO, TWO, TWO, TWO, [0, 0], np.diag([1, 0])),
            "cov0: wanted noise of its own",
        ),
        (lambda: LinearSystem(*[np.eye(3)] * 4, [0] * 3, np.eye(3)), "two state comp"),
        (
            lambda: DiscreteSystem(
                StochasticMap([X], [X + V**2], Noise([V])), StochasticMap([X], [X + W], Noise([W])),
                0, 1,
            ), "dynamics: wanted values affine",
        ),
        (
            lambda: DiscreteSystem(
                StochasticMap([X], [X + V], Noise([V])), StochasticMap([X], [X + W], Noise([W])),
                0, 1, sampled,
            ), "Gaussian initial law",
        ),
        (lambda: LinearSystem(1, 1, 1, 1, 0, 0, diffuse=(0,)), "system: wanted a law"),
    ],
)  # fmt: skip
def test_refusals(make, words):
    system = make()
    axes = (-5, 5, 11) if system.state_size == 1 else [(-5, 5, 11)] * system.state_size
    with pytest.raises(ValueError, match=words):
        GridBayesFilter(system, axes).run([0, 1], np.zeros((2, system.measurement_size)))


def test_refusals_of_nodes():
    sensor = StochasticMap([X], [X + W], Noise([W]))
    uneven = Nodes([0.0, 1.0, 3.0])
    np.testing.assert_array_equal(uneven.weights, [0.5, 1.5, 1.0])
    assert str(uneven) == "3 nodes from 0 to 3"
    assert uneven.halved().weights.tolist() == [1.0, 2.0]
    with pytest.raises(TypeError, match="x: wanted an Axis"):
        GridBayesFilter(one_mode(StochasticMap([X], [X + V], Noise([V])), sensor, 0, 1), uneven)
    for nodes, weights, words in (
        ([1, 0], None, "increasing"), ([0, 1], [1, 0], "positive"), ([0, 1], [1], "weights"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=words):
            Nodes(nodes, weights)
