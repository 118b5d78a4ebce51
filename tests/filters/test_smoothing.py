"""Smoothers against one large regression, an exact discretisation and published numbers."""

import json
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from seedslib.filters import (
    CovarianceFilter,
    KalmanFilter,
    RaoBlackwellFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    smooth,
    unscented_kalman,
)
from seedslib.linearization import GaussHermite
from seedslib.models import DiscreteSystem, JumpDiffusion, LinearSystem, Noise, StochasticMap
from seedslib.zoo import kicked_duffing

DATA = Path(__file__).resolve().parents[2] / "benchmarks" / "data"


@pytest.fixture(scope="module")
def linear():
    """A system of three states with singular noise, records with gaps, and their exact law."""
    rng = np.random.default_rng(0)
    n, m, last = 3, 2, 6
    move, see = 0.5 * rng.normal(size=(n, n)), rng.normal(size=(m, n))
    noise, start = np.diag([1, 0.5, 0.0]), np.diag([1, 0.0, 2])
    system = LinearSystem(move, noise, see, 0.3 * np.eye(m), np.ones(n), start)
    times = np.arange(last + 1.0)
    y = np.array(system.simulate(times, 4, 0).measurements)
    y[2, 0, 1], y[3] = np.nan, np.nan
    powers = [np.linalg.matrix_power(move, k) for k in range(last + 1)]
    moves = np.block([
        [powers[k - j] if j <= k else np.zeros((n, n)) for j in range(last + 1)]
        for k in range(last + 1)
    ])  # fmt: skip
    spread = np.kron(np.eye(last + 1), noise)
    spread[:n, :n] = start
    mean, cov = moves[:, :n] @ np.ones(n), moves @ spread @ moves.T
    whole = np.kron(np.eye(last + 1), see)

    def exact(path, until):
        row = y[:, :, path].ravel().copy()
        row[(until + 1) * m :] = np.nan
        seen = np.isfinite(row)
        gain = cov @ whole[seen].T
        square = whole[seen] @ gain + 0.3 * np.eye(seen.sum())
        gain = gain @ np.linalg.inv(square)
        late = mean + gain @ (row[seen] - whole[seen] @ mean), cov - gain @ whole[seen] @ cov
        return late[0].reshape(-1, n), late[1].reshape(last + 1, n, last + 1, n)

    return system, times, y, exact


@pytest.mark.parametrize(
    "filter", [KalmanFilter, extended_kalman, assumed_density, unscented_kalman]
)
@pytest.mark.parametrize("lag", [None, 2])
def test_every_smoother_of_a_linear_system_is_the_regression(linear, filter, lag):
    system, times, y, exact = linear
    found = smooth(filter(system), times, y, lag=lag)
    for path in range(4):
        for k in range(7):
            mean, cov = exact(path, 6 if lag is None else min(k + lag, 6))
            assert np.allclose(found.mean[k, :, path], mean[k], atol=1e-13)
            assert np.allclose(found.cov[k, ..., path], cov[k, :, k], atol=1e-13)


def test_the_last_estimates_and_the_likelihood_are_those_of_the_filter(linear):
    system, times, y, _ = linear
    one, two = extended_kalman(system).run(times, y), smooth(extended_kalman(system), times, y)
    assert np.array_equal(one.mean[-1], two.mean[-1])
    assert np.array_equal(one.loglik, two.loglik)


@pytest.mark.parametrize("filter", [extended_kalman, assumed_density, unscented_kalman])
def test_between_measurements_it_is_the_exact_discretisation(filter):
    drift, spread = np.array([[0.0, 1.0], [-1.0, -0.4]]), np.array([[0.1, 0.0], [0.2, 0.7]])
    x1, x2, v = sp.symbols("x1 x2 v")
    start = [1, 0], [[0.5, 0.1], [0.1, 0.3]]
    system = JumpDiffusion(
        (x1, x2), [x2, -x1 - 0.4 * x2], spread.tolist(), [x1 + 0.5 * v], Noise((v,)), *start
    )
    times = np.arange(0, 5, 0.5)
    y = np.array(system.simulate(times, 3, 1).measurements)
    y[3, 0, 1], y[4] = np.nan, np.nan
    exact = LinearSystem.from_continuous(drift, spread @ spread.T, [[1, 0]], 0.25, *start, step=0.5)
    one, two = smooth(filter(system), times, y), smooth(KalmanFilter(exact), times, y)
    assert np.allclose(one.mean, two.mean, atol=5e-9)  # Runge-Kutta steps of .01
    assert np.allclose(one.cov, two.cov, atol=1e-9)


def test_smoothing_a_signal_with_jumps_is_better_than_filtering():
    system = kicked_duffing()
    times = np.arange(0, 4.1, 0.5)
    sim = system.simulate(times, 400, 3)
    truth, y = np.asarray(sim.states), np.asarray(sim.measurements)
    filter = assumed_density(system)
    errors = [((found.mean - truth) ** 2).sum(axis=1)[2:-1].mean(axis=0)
              for found in (filter.run(times, y), smooth(filter, times, y))]  # fmt: skip
    gain = errors[0] - errors[1]
    assert gain.mean() > 5 * gain.std() / np.sqrt(400)


@pytest.fixture(scope="module")
def pendulum():
    data = json.loads((DATA / "pendulum.json").read_text())
    dt, g = 0.01, 9.81
    x1, x2, q1, q2, r = sp.symbols("x1 x2 q1 q2 r")
    noise = Noise((q1, q2), cov=0.01 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
    move = StochasticMap((x1, x2), [x1 + dt * x2 + q1, x2 - g * dt * sp.sin(x1) + q2], noise)
    see = StochasticMap((x1, x2), [sp.sin(x1) + r], Noise((r,), cov=[[0.1]]))
    y = np.concatenate([[np.nan], data["Y"]])[:, None]
    return DiscreteSystem(move, see, [0, 0], np.eye(2)), y, np.array(data["X"])


@pytest.mark.parametrize(
    ("make", "filtered", "smoothed"),
    [
        (extended_kalman, 0.16830859061153763, 0.057446202494837),
        (cubature_kalman, 0.1141966031380275, 0.04064624229594188),
        (lambda s: unscented_kalman(s, kappa=1), 0.09524392125923083, 0.036617555415464256),
        (lambda s: CovarianceFilter(s, GaussHermite(5)), 0.0998062421916222, 0.03710181978632009),
    ],
)
def test_the_published_errors_of_the_pendulum(pendulum, make, filtered, smoothed):
    system, y, truth = pendulum
    times, filter = np.arange(501.0), make(system)
    for found, wanted in ((filter.run(times, y), filtered), (smooth(filter, times, y), smoothed)):
        error = np.sqrt(np.mean((found.mean[1:, 0] - truth[0]) ** 2))
        assert error == pytest.approx(wanted, rel=1e-11)


def test_the_published_errors_of_the_car():
    data = json.loads((DATA / "car_track.json").read_text())
    truth, y, dt = np.array(data["X"]), np.array(data["Y"]).T, 0.1
    drift = np.eye(4, k=2)
    system = LinearSystem.from_continuous(
        drift, np.diag([0, 0, 1, 1]), np.eye(2, 4), 0.25 * np.eye(2), [0, 0, 1, -1], np.eye(4),
        step=dt,
    )  # fmt: skip
    filter, times = KalmanFilter(system), np.arange(101.0)
    y = np.concatenate([[[np.nan] * 2], y])
    for found, wanted in (
        (filter.run(times, y), 0.4253824660526518),
        (smooth(filter, times, y), 0.26497104638205465),
    ):
        error = np.sqrt(np.mean(((found.mean[1:, :2].T - truth[:2]) ** 2).sum(axis=0)))
        assert error == pytest.approx(wanted, rel=1e-12)


def test_records_are_smoothed_in_blocks_that_do_not_show(linear, monkeypatch):
    system, times, y, _ = linear
    filter = extended_kalman(system)
    whole = smooth(filter, times, y)
    monkeypatch.setattr(type(filter), "block", lambda *_: 3)
    parts = smooth(filter, times, y)
    full = np.nan_to_num(y)
    assert np.allclose(whole.mean, parts.mean, atol=1e-14)
    assert np.allclose(whole.cov, parts.cov, atol=1e-14)
    assert smooth(filter, times, full).cov.shape == (7, 3, 3)  # common to all records


def test_what_leaves_the_bound_of_the_filter_has_diverged(linear):
    system, times, y, _ = linear
    bound = np.abs(extended_kalman(system).run(times, y).mean).max(axis=(0, 1))
    found = smooth(extended_kalman(system, bound=np.sort(bound)[1:3].mean()), times, y)
    assert found.diverged.sum() == 2


def test_angles_are_smoothed_as_if_the_circle_were_unrolled():
    """A record of angles, wrapped, against the same record without a cut."""
    x, rate, v1, v2, w = sp.symbols("x rate v1 v2 w")
    move = [x + rate + v1, rate + v2]
    noise = Noise((v1, v2), cov=[[0.05, 0], [0, 0.01]])
    period = {0: 2 * np.pi}
    found = []
    for around in (None, period):
        dynamics = StochasticMap((x, rate), move, noise, period=around)
        sensor = StochasticMap((x, rate), [x + 0.3 * w], Noise((w,)), period=around)
        system = DiscreteSystem(dynamics, sensor, [3, 0.3], 0.1 * np.eye(2))
        if around is None:
            y = np.array(system.simulate(np.arange(30.0), 5, 1).measurements)
            y[7:9] = np.nan
        else:
            y = np.angle(np.exp(1j * y))
        for make in (extended_kalman, unscented_kalman):
            found.append(smooth(make(system), np.arange(30.0), y))
    assert np.nanmax(np.abs(y)) < np.pi
    assert np.abs(found[0].mean[:, 0]).max() > 3 * np.pi
    for one, two in zip(found[:2], found[2:], strict=True):
        turns = (one.mean - two.mean) / (2 * np.pi)
        assert np.allclose(turns[:, 0], np.round(turns[:, 0]), atol=1e-12)
        assert np.allclose(one.mean[:, 1], two.mean[:, 1], atol=1e-12)
        assert np.allclose(one.cov, two.cov, atol=1e-12)


def test_what_cannot_be_smoothed_is_refused(linear):
    system, times, y, _ = linear
    kalman = extended_kalman(system)
    with pytest.raises(TypeError, match=r"one that can be smoothed .* got RaoBlackwell"):
        smooth(RaoBlackwellFilter.__new__(RaoBlackwellFilter), times, y)
    with pytest.raises(TypeError, match="filter: wanted a filter of this library, got str"):
        smooth("kalman", times, y)
    with pytest.raises(ValueError, match="lag: wanted at least 1, got 0"):
        smooth(kalman, times, y, lag=0)
    with pytest.raises(ValueError, match="trajectories: wanted none, the filter draws none"):
        smooth(kalman, times, y, trajectories=100)
    with pytest.raises(ValueError, match="modes: wanted none"):
        smooth(kalman, times, y, modes=np.zeros((7, 4), int))
