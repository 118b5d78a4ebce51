"""Late measurements: a state with its past against the joint distribution of all that arrived."""

import pickle
from functools import partial

import numpy as np
import pytest
import sympy as sp

from oracles.linear import Regression
from seedslib.base import ELAPSED, Parameter
from seedslib.filters import (
    CovarianceFilter,
    KalmanFilter,
    extended_kalman,
    smooth,
    unscented_kalman,
)
from seedslib.linearization import GaussHermite
from seedslib.models import (
    DiscreteSystem,
    LinearSystem,
    Noise,
    StochasticMap,
    by_arrival,
    van_loan,
    with_past_states,
)
from systems import (
    COV0,
    EVEN,
    INPUTS,
    MEAN0,
    NOISE,
    NOISE_COV,
    NOISE_MEAN,
    SENSOR_COV,
    SENSOR_NOISE,
    STATE,
    TIMES,
    S,
    U,
    coefficients,
    linear_formulas,
    linear_numbers,
    t,
)

LAG, COUNT = 3, 7
H = np.array([[1.0, -0.4, 0.2], [0.0, 0.5, 1.0]])
DRIFT = np.array([[-0.4, 1.0, 0.0], [0.0, -0.2, 0.5], [-0.3, 0.0, -0.1]])
DELAYS = np.array([1, 0, 3, 1, 0, 0, 2])
"""At step 5 the measurements of steps 2 and 5 arrive together; that of step 6 is too late."""

x, y, v, w, a = *sp.symbols("x y v w", real=True), Parameter("a", 0.3)


def numbers(kind, R=SENSOR_COV):
    """Times, and the system as numbers, with one sensor for all times."""
    times, inputs = (EVEN, None) if kind == "functions" else (TIMES, INPUTS)
    model = linear_numbers(times, inputs, means=kind == "maps")
    model = model._replace(H=np.tile(H, (COUNT, 1, 1)), R=np.tile(R, (COUNT, 1, 1)))
    if kind == "continuous":
        pairs = [van_loan(DRIFT, NOISE_COV, h) for h in np.diff(times)]
        F, Q = (np.array(part) for part in zip(*pairs, strict=True))
        model = model._replace(F=F, Q=Q)
    if kind in ("continuous", "functions"):
        model = model._replace(b=np.zeros((COUNT - 1, 3)))
    return times, inputs, model._replace(d=np.zeros((COUNT, 2)))


def system(kind, R=SENSOR_COV):
    """The same as a model of the library."""
    sensor = H, R, MEAN0, COV0
    if kind == "continuous":
        return LinearSystem.from_continuous(DRIFT, NOISE_COV, *sensor, step=None)
    if kind == "maps":
        shows = sp.Matrix(H) * sp.Matrix(STATE) + sp.Matrix(SENSOR_NOISE)
        moves = StochasticMap(STATE, linear_formulas()[0], Noise(NOISE, NOISE_MEAN, NOISE_COV))
        noise = Noise(SENSOR_NOISE, 0.0, SENSOR_COV)
        return DiscreteSystem(moves, StochasticMap(STATE, list(shows), noise), MEAN0, COV0)
    if kind == "functions":
        G = partial(of_time, "G")
        return LinearSystem(partial(of_time, "F"), lambda s: G(s) @ NOISE_COV @ G(s).T, *sensor)
    parts = coefficients(t, ELAPSED, m=sp)
    F, G, B = (np.array(part, dtype=object) for part in (parts.F, parts.G, parts.B))
    return LinearSystem(F, G @ NOISE_COV @ G.T, *sensor, b=B @ [U, S] + parts.c)


def of_time(name, time):
    return np.array(getattr(coefficients(time), name), dtype=float)


def measured(model, runs, seed=4):
    """Measurements (K+1, m, runs), of which one component and one as a whole never arrive."""
    exact = Regression(model)
    rng = np.random.default_rng(seed)
    draws = rng.multivariate_normal(np.zeros(len(exact.cov)), exact.cov, runs).T
    y = exact.measured_means[:, :, None] + np.einsum("kij,jr->kir", exact.measured, draws)
    y[1, 0], y[3] = np.nan, np.nan
    return exact, y


def known(y, delays, k):
    """The measurements that have arrived by step k, where they were taken."""
    late = np.arange(COUNT)[:, None] + delays.reshape(COUNT, -1) > k
    return np.where(late, np.nan, y)


def assert_exact(found, exact, y, delays, lag=LAG):
    """Of one record: the states now and before, and the density of what arrives."""
    n = exact.n
    for k in range(COUNT):
        for j in range(min(lag, k) + 1):
            mean, cov = exact.estimate(known(y, delays, k), k - j, k)
            part = slice(j * n, j * n + n)
            np.testing.assert_allclose(found.mean[k, part], mean, rtol=1e-10, atol=1e-10)
            np.testing.assert_allclose(found.cov[k, part, part], cov, rtol=1e-10, atol=1e-10)
    arrived = known(y, delays, COUNT - 1)
    np.testing.assert_allclose(found.loglik.sum(), exact.loglik(arrived), rtol=1e-10)


@pytest.mark.parametrize(
    ("kind", "make"),
    [
        ("formulas", KalmanFilter),
        ("functions", KalmanFilter),
        ("continuous", KalmanFilter),
        ("formulas", unscented_kalman),
        ("maps", extended_kalman),
        ("maps", unscented_kalman),
    ],
)
def test_filter_of_late_measurements_is_the_joint_gaussian_distribution(kind, make):
    (times, inputs, model), filter = numbers(kind), make(with_past_states(system(kind), LAG))
    inputs = inputs if kind in ("formulas", "maps") else None
    exact, y = measured(model, 1)
    filter = filter if kind == "functions" else pickle.loads(pickle.dumps(filter))
    found = filter.run(times, by_arrival(y[:, :, 0], DELAYS, LAG), inputs=inputs)
    assert_exact(found, exact, y[:, :, 0], DELAYS)


def test_delays_of_each_run_and_component():
    times, inputs, model = numbers("formulas", np.diag([0.5, 0.8]))
    exact, y = measured(model, 4)
    delays = np.random.default_rng(6).integers(0, LAG + 1, y.shape)
    late = with_past_states(system("formulas", np.diag([0.5, 0.8])), LAG)
    found = KalmanFilter(late).run(times, by_arrival(y, delays, LAG), inputs=inputs)
    for r in range(4):
        own = found._replace(**{k: getattr(found, k)[..., r] for k in ("mean", "cov", "loglik")})
        assert_exact(own, exact, y[..., r], delays[..., r])


def test_estimates_of_past_states_are_those_of_the_smoother_with_fixed_lag():
    times, inputs, model = numbers("formulas")
    _, y = measured(model, 2)
    plain = KalmanFilter(system("formulas"))
    filter = KalmanFilter(with_past_states(system("formulas"), LAG))
    found = filter.run(times, by_arrival(y, np.zeros((COUNT, 2), int), LAG), inputs=inputs)
    smoothed = smooth(plain, times, y, lag=LAG, inputs=inputs)
    last = slice(LAG * 3, LAG * 3 + 3)
    np.testing.assert_allclose(found.mean[LAG:, last], smoothed.mean[:-LAG], atol=1e-10)
    np.testing.assert_allclose(found.mean[:, :3], plain.run(times, y, inputs=inputs).mean, 1e-10)


def test_unknown_first_components_and_numbers_of_parameters_stay():
    plain = LinearSystem([[1, 1], [0, a]], np.eye(2), [[1, 0]], 1, [0, 0], [[0, 0], [0, a]],
                         diffuse=[0])  # fmt: skip
    y, none = np.array([[1.0], [2.5], [2.0], [4.0]]), np.zeros(4, int)
    wanted = KalmanFilter(plain.bind(a=0.7)).run(range(4), y)
    for late in (with_past_states(plain.bind(a=0.7), 2), with_past_states(plain, 2).bind(a=0.7)):
        found = KalmanFilter(late).run(range(4), by_arrival(y, none, 2))
        np.testing.assert_allclose(found.mean[:, :2], wanted.mean, atol=1e-12)
        np.testing.assert_allclose(found.loglik, wanted.loglik, atol=1e-12)


def curved(scale=1.0):
    """Nonlinear dynamics, a linear sensor; what is uncertain has deviations of order `scale`."""
    moves = [x + 0.3 * sp.sin(y), y + 0.2 * x**2 + scale * v]
    noise, shown = Noise((v,)), Noise((w,), cov=0.25 * np.eye(1))
    maps = StochasticMap([x, y], moves, noise), StochasticMap([x, y], [x + scale * w], shown)
    return DiscreteSystem(*maps, [0.4, -0.2], scale**2 * np.diag([0.3, 0.5]))


def test_without_delays_a_curved_system_has_the_filter_that_it_had():
    bearing = StochasticMap([x, y], [sp.atan2(y, x) + w / 5], Noise((w,)), period={0: 2 * sp.pi})
    plain = DiscreteSystem(curved().dynamics, bearing, [-1.0, 0.1], 0.1 * np.eye(2))
    run = plain.simulate(range(6), paths=3, seed=2)
    arrived = by_arrival(run.measurements, np.zeros((6, 3), int), 2)
    wanted = extended_kalman(plain).run(range(6), run.measurements)
    found = extended_kalman(with_past_states(plain, 2)).run(range(6), arrived)
    np.testing.assert_allclose(found.mean[:, :2], wanted.mean, atol=1e-12)
    np.testing.assert_allclose(found.cov[:, :2, :2], wanted.cov, atol=1e-12)
    np.testing.assert_allclose(found.loglik, wanted.loglik, atol=1e-12)


def test_names_of_the_time_angles_and_means_of_noises_stay():
    """A product rule has the same points for the state of now, whatever else there is."""
    s = sp.Symbol("s", real=True)
    angle = x + y + 0.1 * s
    moves = [sp.atan2(sp.sin(angle), sp.cos(angle)), 0.9 * y + v]
    noises = Noise((v,), 0.2, [[0.1]]), Noise((w,), 0.5, [[0.3]])
    dynamics = StochasticMap([x, y], moves, noises[0], time=s, period={0: 2 * sp.pi})
    shown = StochasticMap([x, y], [x + w], noises[1], period={0: 2 * sp.pi})
    plain = DiscreteSystem(dynamics, shown, [2.5, 0.5], 0.2 * np.eye(2))
    run = plain.simulate(range(8), paths=3, seed=2).measurements
    arrived = by_arrival(run, np.zeros((8, 3), int), 1)
    found, wanted = (
        CovarianceFilter(system, GaussHermite(3)).run(range(8), data)
        for system, data in ((with_past_states(plain, 1), arrived), (plain, run))
    )
    np.testing.assert_allclose(found.mean[:, :2], wanted.mean, atol=1e-10)
    np.testing.assert_allclose(found.loglik, wanted.loglik, atol=1e-10)


def test_a_late_measurement_of_a_curved_system_is_worth_what_it_is_in_order_to_first_order():
    """Reprocessing in order expands the dynamics about better means: a second-order difference."""
    delays, differences = np.array([2, 0, 1, 0, 0]), []
    for scale in (1e-2, 1e-3):
        plain = curved(scale)
        run = plain.simulate(range(5), paths=1, seed=8).measurements[:, :, 0]
        found = extended_kalman(with_past_states(plain, 2)).run(
            range(5), by_arrival(run, delays, 2)
        )
        wanted = extended_kalman(plain).run(range(5), run)
        differences.append(np.abs(found.mean[-1, :2] - wanted.mean[-1]).max() / scale)
    assert differences[0] < 0.02
    assert differences[1] < 0.15 * differences[0]


def test_what_arrives_when():
    y = np.array([[1.0, 10.0], [2.0, np.nan], [3.0, 30.0]])
    gone = np.nan
    wanted = [[gone, gone, gone, gone], [2, gone, 1, 10], [gone, 30, gone, gone]]
    np.testing.assert_array_equal(by_arrival(y, [[1, 1], [0, 9], [1, 0]], 1), wanted)
    np.testing.assert_array_equal(by_arrival(y, [1, 0, 0], 1)[1], wanted[1])


def sensor_of(expression, noise=None):
    shown = StochasticMap([x, y], [expression], Noise((w,)) if noise is None else noise)
    return DiscreteSystem(curved().dynamics, shown, [0, 0], np.eye(2))


def drawn(rng, count):
    return rng.uniform(-1, 1, (1, count))


ARRAYS = StochasticMap.from_functions(2, 2, lambda t, x, v: x, Noise(1))
ONE = np.zeros((3, 1))


@pytest.mark.parametrize(
    ("call", "argument", "got"),
    [
        (lambda: with_past_states(sensor_of(x * t + w), 1), "system", "time"),
        (lambda: with_past_states(sensor_of(x * U + w), 1), "system", "inputs"),
        (lambda: with_past_states(sensor_of(x + w, Noise((w,), 0, [[1 / 3]], drawn)), 1),
         "system", "Gaussian"),
        (lambda: with_past_states(DiscreteSystem(ARRAYS, curved().sensor, [0, 0], np.eye(2)), 1),
         "system", "array functions"),
        (lambda: with_past_states(curved(), 0), "lag", "got 0"),
        (lambda: by_arrival(ONE, [0, 3, 0], 2), "delays", "wanted 0 to 2.*got 3.*step 1"),
        (lambda: by_arrival(ONE, [0, 0, -1], 2), "delays", "wanted 0 to 2.*got -1.*step 2"),
        (lambda: by_arrival(ONE, [0, 0], 2), "delays", "shape"),
        (lambda: by_arrival([1.0, 2.0], [0, 0], 2), "measurements", "shape"),
    ],
)  # fmt: skip
def test_refusals(call, argument, got):
    with pytest.raises(ValueError, match=f"^{argument}: .*{got}"):
        call()
    with pytest.raises(TypeError, match=r"^system: "):
        with_past_states(KalmanFilter, 1)
