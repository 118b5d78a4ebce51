"""The square-root form: the ordinary one where that has digits, and right where it has none."""

import pickle

import mpmath
import numpy as np
import pytest
import sympy as sp

from oracles.linear import Regression
from seedslib import zoo
from seedslib.base import Parameter
from seedslib.evaluation import fit
from seedslib.export import compiled, to_c
from seedslib.filters import (
    CovarianceFilter,
    KalmanFilter,
    SquareRootKalmanFilter,
    extended_kalman,
    forecast_measurements,
    smooth,
)
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Unscented
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap
from systems import (
    EVEN,
    INPUTS,
    TIMES,
    discrete_system,
    linear_numbers,
    linear_system,
    record,
)

x, y, v, w, a = *sp.symbols("x y v w", real=True), Parameter("a", 0.3)


def assert_same(found, wanted, atol=1e-12):
    for name in ("mean", "cov", "loglik"):
        assert getattr(found, name).shape == getattr(wanted, name).shape
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), atol=atol)


@pytest.mark.parametrize(("system", "means"), [(linear_system, False), (discrete_system, True)])
def test_filter_of_a_linear_system_is_regression_on_the_data(system, means):
    model = linear_numbers(means=means)
    exact, (_, data) = Regression(model), record(model)
    found = SquareRootKalmanFilter(system()).run(TIMES, data, inputs=INPUTS)
    for part, wanted in zip(
        found, (*exact.filtered(data), None, exact.logliks(data)), strict=False
    ):
        if wanted is not None:
            np.testing.assert_allclose(part, wanted, atol=1e-12)


def runs(missing):
    """Measurements of five runs: with none, with the same or with other components missing."""
    data = np.random.default_rng(3).normal(size=(7, 2, 5))
    if missing != "none":
        data[1, 0], data[3] = np.nan, np.nan
    if missing == "other":
        data[2, :, 3], data[4, 1, 1:3], data[5, 0, 0] = np.nan, np.nan, np.nan
    return data


@pytest.mark.parametrize("missing", ["none", "same", "other"])
@pytest.mark.parametrize("form", ["formulas", "functions"])
def test_many_runs_at_once_are_those_of_the_ordinary_form(form, missing):
    system, data = linear_system(form, inputs=form == "formulas"), runs(missing)
    inputs = INPUTS if form == "formulas" else None
    found, wanted = (
        make(system).run(EVEN, data, inputs=inputs)
        for make in (SquareRootKalmanFilter, KalmanFilter)
    )
    assert_same(found, wanted)
    expected, ordinary = (
        forecast_measurements(make(system), EVEN, data, inputs=inputs)
        for make in (SquareRootKalmanFilter, KalmanFilter)
    )
    np.testing.assert_allclose(expected.mean, ordinary.mean, atol=1e-12)
    np.testing.assert_allclose(expected.cov, ordinary.cov, atol=1e-12)


def turning():
    """Curved dynamics with noise that the state scales, and a bearing that comes round."""
    moves = [x + 0.3 * sp.sin(y) + 0.1 * v, y + 0.2 * x**2 - 0.1 * y + (0.2 + x**2 / 10) * v]
    bearing = StochasticMap([x, y], [sp.atan2(y, x) + w / 5], Noise((w,)), period={0: 2 * sp.pi})
    dynamics = StochasticMap([x, y], moves, Noise((v,)))
    return DiscreteSystem(dynamics, bearing, [-1.0, 0.1], 0.1 * np.eye(2))


def test_filter_of_a_curved_system_is_the_extended_kalman_filter():
    system = turning()
    data = system.simulate(range(12), paths=4, seed=2).measurements
    data[3, 0, 2], data[5] = np.nan, np.nan
    found, wanted = (
        make(system).run(range(12), data) for make in (SquareRootKalmanFilter, extended_kalman)
    )
    assert np.abs(wanted.mean).max() < 50
    assert_same(found, wanted)
    filter = SquareRootKalmanFilter(system)
    state = filter.initial()
    for k in range(12):
        state = filter.step(state, k, data[k, :, 0])
    np.testing.assert_allclose(state.mean, wanted.mean[-1, :, 0], atol=1e-12)
    np.testing.assert_allclose(filter.forecast(state, 12).mean, extended_ahead(system, data))


@pytest.mark.parametrize("rule", [Cubature(), GaussHermite(4), Unscented(kappa=0.5)])
@pytest.mark.parametrize("form", ["formulas", "arrays"])
def test_filter_with_points_is_the_ordinary_one(rule, form):
    """Of array functions the points are laid in the space of the state and the noise."""
    system = turning()
    if form == "arrays":
        maps = (
            StochasticMap.from_functions(2, size, value, Noise(1), period=period)
            for size, value, period in ((2, moved, None), (1, shown, {0: 2 * np.pi}))
        )
        system = DiscreteSystem(*maps, [-1.0, 0.1], 0.1 * np.eye(2))
    data = turning().simulate(range(8), paths=4, seed=2).measurements
    data[3, 0, 2], data[5] = np.nan, np.nan
    filter = pickle.loads(pickle.dumps(SquareRootKalmanFilter(system, rule)))
    found, wanted = (made.run(range(8), data) for made in (filter, CovarianceFilter(system, rule)))
    assert_same(found, wanted, 1e-10)


def moved(t, state, noise):
    (x, y), (v,) = state, noise
    shifts = 0.3 * np.sin(y) + 0.1 * v, 0.2 * x**2 - 0.1 * y + (0.2 + x**2 / 10) * v
    return np.stack([x + shifts[0], y + shifts[1]])


def shown(t, state, noise):
    return np.arctan2(state[1], state[0])[None] + noise / 5


def extended_ahead(system, data):
    filter = extended_kalman(system)
    state = filter.initial()
    for k in range(12):
        state = filter.step(state, k, data[k, :, 0])
    return filter.forecast(state, 12).mean


def test_a_noise_that_grows_with_state_and_time_is_that_of_the_step():
    t = sp.Symbol("t")
    noisy = StochasticMap((x,), [x + (1 + t) * sp.sqrt(1 + x**2) * v], Noise((v,)), time=t)
    moved = StochasticMap((x,), [sp.sin(x) + (2 + t) * x * w], Noise((w,), cov=[[0.1]]), time=t)
    system = DiscreteSystem(moved, noisy, [0.3], [[0.5]])
    data = system.simulate(range(6), paths=3, seed=8).measurements
    found, wanted = (
        make(system, Cubature()).run(range(6), data)
        for make in (SquareRootKalmanFilter, CovarianceFilter)
    )
    assert_same(found, wanted)


def test_components_that_others_determine_are_left_out():
    """One sensor twice, with one noise and with none; a sensor of nothing in between."""
    H, R = [[1, 2], [0, 0], [1, 2], [0, 1]], np.zeros((4, 4))
    R[np.ix_([0, 2], [0, 2])] = 0.5
    system = LinearSystem([[1, 0.5], [0, 1]], 0.1 * np.eye(2), H, R, [0, 0], np.eye(2))
    data = np.array([[1.0, 0, 1, 0.2], [1.5, 0, 1.5, 0.1], [np.nan, 0, 0.4, 0.3]])
    found, wanted = (
        make(system).run(range(3), data) for make in (SquareRootKalmanFilter, KalmanFilter)
    )
    assert_same(found, wanted)
    many = np.stack([data, data + np.array([1, 0, 1, 0])], axis=-1)
    many[1, 0, 1] = np.nan
    found, wanted = (
        make(system).run(range(3), many) for make in (SquareRootKalmanFilter, KalmanFilter)
    )
    np.testing.assert_allclose(found.mean, wanted.mean, atol=1e-12)
    np.testing.assert_allclose(found.loglik, wanted.loglik, atol=1e-12)


def test_numbers_of_each_run_and_fits():
    walk = LinearSystem(a, 1, 1, 0.5, 0, 1)
    data = KalmanFilter(walk).system.simulate(range(40), paths=1, seed=4).measurements[:, :, 0]
    many = np.repeat(data[:, :, None], 3, axis=2)
    found, wanted = (
        make(walk).bind(a=[0.1, 0.5, 0.9]).run(range(40), many)
        for make in (SquareRootKalmanFilter, KalmanFilter)
    )
    assert_same(found, wanted)
    found, wanted = (
        fit(make(walk), range(40), data, [a]) for make in (SquareRootKalmanFilter, KalmanFilter)
    )
    np.testing.assert_allclose(found.loglik, wanted.loglik, rtol=1e-9)


# What it gains: nearly collinear sensors of a wide prior, against 60 digits


def collinear(noise):
    H = np.array([[1.0, 1, 1], [1, 1, 1.0001]])
    Q, R = noise * np.eye(3), 1e-10 * np.eye(2)
    return LinearSystem(np.eye(3), Q, H, R, np.zeros(3), 1e8 * np.eye(3))


def precisely(system, data):
    """Means and covariances by the textbook's formulas in 60 digits."""

    def matrix(array):
        return mpmath.matrix(np.asarray(array, dtype=float).tolist())

    F, Q = matrix(system.dynamics.slope_at(0)), matrix(system.dynamics.cov_at(0))
    H, R = matrix(system.sensor.slope_at(0)), matrix(system.sensor.cov_at(0))
    m, P, states = matrix(system.mean0[:, None]), matrix(system.cov0), []
    with mpmath.workdps(60):
        for k, row in enumerate(data):
            if k:
                m, P = F * m, F * P * F.T + Q
            gain = P * H.T * mpmath.inverse(H * P * H.T + R)
            m, P = m + gain * (matrix(row[:, None]) - H * m), P - gain * H * P
            states.append((m, P))
    return states


def errors(found, precise):
    """Errors of means and covariances at each time, in units of the deviations."""
    result, n = [], len(precise[0][0])
    for k, (m, P) in enumerate(precise):
        with mpmath.workdps(60):
            unit = [mpmath.sqrt(P[i, i]) for i in range(n)]
            mean = [abs(found.mean[k, i] - m[i]) / unit[i] for i in range(n)]
            cov = [
                abs(found.cov[k, i, j] - P[i, j]) / unit[i] / unit[j]
                for i in range(n)
                for j in range(n)
            ]
        result.append((float(max(mean)), float(max(cov))))
    return np.array(result)


@pytest.mark.parametrize("noise", [0.0, 1e-10])
def test_nearly_collinear_sensors_of_a_wide_prior_keep_their_digits(noise):
    system = collinear(noise)
    data = system.simulate(range(8), paths=1, seed=6).measurements[:, :, 0]
    precise = precisely(system, data)
    found = SquareRootKalmanFilter(system).run(range(8), data)
    ordinary = KalmanFilter(system).run(range(8), data)
    mean, cov = errors(found, precise).max(axis=0)
    assert cov < 1e-6
    assert mean < 1e-5  # a deviation is 1e-8 of what is measured with it
    assert not (errors(ordinary, precise)[-1] < 0.1).any()  # wrong altogether, or no number


def test_covariances_are_symmetric_and_semidefinite_where_the_ordinary_form_breaks_down():
    rng = np.random.default_rng(8)
    for size in (2, 3, 5):
        H = np.ones((size, size)) + 1e-5 * rng.normal(size=(size, size))
        F = np.eye(size) + 0.1 * np.eye(size, k=1)
        system = LinearSystem(F, 0 * F, H, 1e-12 * np.eye(size), np.zeros(size), 1e8 * np.eye(size))
        filter = SquareRootKalmanFilter(system)
        state = filter.initial()
        for k in range(6):
            state = filter.step(state, k, np.zeros(size))
            cov = filter.report(state).cov
            np.testing.assert_array_equal(cov, cov.T)
            unit = np.sqrt(np.diag(cov))
            assert np.linalg.eigvalsh(cov / unit / unit[:, None])[0] > -1e-14
            np.testing.assert_array_equal(state.root, np.tril(state.root))
            assert (np.diag(state.root) > 0).all()


def test_the_root_does_not_depend_on_the_signs_that_a_factorization_chooses(monkeypatch):
    def states():
        filter = SquareRootKalmanFilter(linear_system())
        state = filter.initial((5,))
        for k, row in enumerate(runs("other")):
            state = filter.step(state, TIMES[k], row, inputs={u: s[k] for u, s in INPUTS.items()})
            yield state

    wanted, qr, rng = list(states()), np.linalg.qr, np.random.default_rng(0)

    def turned(matrix, mode):
        upper = qr(matrix, mode=mode)
        upper *= rng.choice([-1.0, 1.0], (*upper.shape[:-1], 1))  # in the same order in memory
        return upper

    monkeypatch.setattr(np.linalg, "qr", turned)
    for found, known in zip(states(), wanted, strict=True):
        np.testing.assert_array_equal(found.root, known.root)
        np.testing.assert_array_equal(found.mean, known.mean)


ARRAYS = StochasticMap.from_functions(1, 1, lambda t, x, v: x, Noise(1))
WALK = LinearSystem(1, 1, 1, 1, 0, 1)
FILTER = SquareRootKalmanFilter(WALK)


@pytest.mark.parametrize(
    ("call", "error", "sentence"),
    [
        (lambda: SquareRootKalmanFilter(zoo.flip_process()), TypeError, "system: .*JumpDiffusion"),
        (lambda: SquareRootKalmanFilter(zoo.manoeuvring_target("noisy")), TypeError, "system: "),
        (lambda: SquareRootKalmanFilter(LinearSystem(1, 1, 1, 1, 0, 0, diffuse=[0])), ValueError,
         "system: .*first state"),
        (lambda: SquareRootKalmanFilter(DiscreteSystem(ARRAYS, ARRAYS, 0, 1)), ValueError,
         "Taylor: "),
        (lambda: SquareRootKalmanFilter(WALK, Unscented(kappa=-0.5)), ValueError,
         "linearization: .*negative"),
        (lambda: SquareRootKalmanFilter(WALK, GaussHermite(1)), ValueError, "linearization: "),
        (lambda: SquareRootKalmanFilter(WALK, ExactGaussian()), TypeError, "linearization: "),
        (lambda: compiled(FILTER), TypeError, "filter: .*SquareRootKalmanFilter"),
        (lambda: to_c(FILTER, "f"), TypeError, "filter: .*SquareRootKalmanFilter"),
        (lambda: smooth(FILTER, range(2), np.zeros((2, 1))), TypeError, "filter: .*SquareRoot"),
        (lambda: FILTER.run(range(2), [[np.inf], [0.0]]), ValueError, "measurements: "),
        (lambda: FILTER.step(FILTER.initial(), 0, [np.inf]), ValueError, "y: .*inf"),
    ],
)  # fmt: skip
def test_refusals(call, error, sentence):
    with pytest.raises(error, match=f"^{sentence}"):
        call()
