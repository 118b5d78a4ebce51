"""The optimal filter of a system with delays, in its four recursions, against regression."""

import numpy as np
import pytest

from oracles.delay import Regression, varying_system
from seedslib.delay import RECURSIONS, DelayKalmanFilter, DelaySystem, apply_gains, examples

STEPS = 12


def constant_system(delays, **start):
    """Constant coefficients, two unlike correlated sensors, history of one covariance."""
    rng = np.random.default_rng(len(delays))
    return DelaySystem(
        {d: 0.35 * rng.standard_normal((2, 2)) for d in delays},
        sensor=[[1.0, 0.0], [0.3, 1.0]],
        noise_cov=[[1.0, 0.0], [0.0, 0.0]],
        sensor_cov=[[1.0, 0.2], [0.2, 0.5]],
        mean0=[0.4, -0.9],
        cov0=[[2.0, 0.3], [0.3, 0.8]],
        **start,
    )


SYSTEMS = {
    "no delay": varying_system((0,), STEPS),
    "pure delay": varying_system((3,), STEPS),
    "several delays": varying_system((0, 2, 5), STEPS),
    "constant": constant_system((0, 1, 3), history_cov=[[0.5, 0.1], [0.1, 0.4]]),
    "known history": constant_system((2,)),
    "constant without delay": constant_system((0,)),
}
CASES = [
    (name, method)
    for name, system in SYSTEMS.items()
    for method in RECURSIONS
    if system.constant or method != "chandrasekhar"
]


def records(system, seed=5):
    """Four records: complete, partly missing in two ways, and with whole instants missing."""
    y = system.simulate(STEPS, 4, seed).measurements
    lost = np.random.default_rng(1).random(y.shape) < 0.3
    lost[..., 0] = lost[..., 3] = False
    y[lost] = np.nan
    y[[4, 7, 8], :, 3] = np.nan
    return y


@pytest.mark.parametrize(("name", "method"), CASES)
def test_estimates_equal_regression_on_all_data(name, method):
    """Means, covariances and log densities, with missing values, for the least and largest lag."""
    system = SYSTEMS[name]
    y, n = records(system), system.state_size
    kalman, truth = DelayKalmanFilter(system, method), Regression(system, STEPS)
    for lag in {0, min(1, system.max_delay), system.max_delay}:
        run = kalman.run(STEPS, y, lag=lag)
        assert run.cov.shape == (STEPS + 1, n, n, 4)
        for path in range(4):
            for k in range(STEPS + 1):
                last = min(k + lag, STEPS)
                mean, cov, loglik, _ = truth.estimate(y[..., path], k, last)
                np.testing.assert_allclose(run.mean[k, :, path], mean, atol=1e-11)
                np.testing.assert_allclose(run.cov[k, ..., path], cov, atol=1e-11)
                total = run.loglik[: last + 1, path].sum()
                assert total == pytest.approx(loglik, abs=1e-10)


@pytest.mark.parametrize(("name", "method"), CASES)
def test_gains_are_the_weights_of_the_newest_measurement(name, method):
    system = SYSTEMS[name]
    missing = np.zeros((STEPS + 1, system.measurement_size), bool)
    missing[3, 0] = missing[6] = True
    truth = Regression(system, STEPS)
    for lost in (None, missing):
        table = DelayKalmanFilter(system, method).gains(STEPS, lost)
        fast = method != "chandrasekhar" or lost is None
        assert table.method.split(",")[0] == (method if fast else "structured")
        y = np.where(missing & (lost is not None), np.nan, 0.0)
        for k in range(1, STEPS + 1):
            predicted = truth.estimate(y, k, k - 1)[1]
            np.testing.assert_allclose(table.predicted[k], predicted, atol=1e-11)
            np.testing.assert_allclose(table.cov[k], truth.estimate(y, k, k)[1], atol=1e-11)
            step, present = system.step(k), ~np.isnan(y[k])
            inner = step.sensor @ predicted @ step.sensor.T + step.sensor_cov
            both = np.ix_(present, present)
            np.testing.assert_allclose(table.innovation_cov[k][both], inner[both], atol=1e-11)
            for s in range(system.max_delay + 1):
                weights = truth.estimate(y, k - s, k)[3]
                np.testing.assert_allclose(table.gain[k, s], weights, atol=1e-11)


@pytest.mark.parametrize(("name", "method"), CASES)
def test_verbs_with_several_predictions_in_a_row_equal_run(name, method):
    """Instants 4, 7, 8 are only predicted over; the states before are left as they were."""
    system = SYSTEMS[name]
    y = records(system)[..., 3]
    batch = np.stack([y, y + np.linspace(0, 1, STEPS + 1)[:, None]], axis=2)
    kalman = DelayKalmanFilter(system, method)
    if method == "chandrasekhar":  # it cannot go on after a gap, and says so
        batch, whole = batch[:4], kalman.run(3, batch[:4])
    else:
        whole = kalman.run(STEPS, batch)
    state = kalman.initial((2,))
    n = system.state_size
    np.testing.assert_array_equal(state.cov, system.start_cov()[:n, :n])
    for k in range(len(batch)):
        if k and np.isnan(batch[k]).all():
            ahead = kalman.forecast(state, k)
            np.testing.assert_allclose(ahead.mean, whole.mean[k], atol=1e-12)
            np.testing.assert_allclose(ahead.cov, whole.cov[k], atol=1e-12)
            continue
        before, copies = state, [np.copy(state.mean), np.copy(state.cov)]
        state = kalman.correct(kalman.predict(state, k), batch[k])
        for part, copy in zip((before.mean, before.cov), copies, strict=True):
            np.testing.assert_array_equal(part, copy)
        found = kalman.report(state)
        np.testing.assert_allclose(found.mean, whole.mean[k], atol=1e-12)
        np.testing.assert_allclose(found.cov, whole.cov[k], atol=1e-12)
        np.testing.assert_allclose(found.loglik, whole.loglik[k], atol=1e-11)
        assert kalman.predict(state, k).time == k
    lag = system.max_delay
    smoothed = kalman.run(len(batch) - 1, batch, lag=lag).mean
    if lag < len(batch):
        np.testing.assert_allclose(state.mean[lag], smoothed[len(batch) - 1 - lag], atol=1e-12)


def test_a_step_with_a_missing_component_equals_run():
    system = SYSTEMS["several delays"]
    y = records(system)[..., 1:2]
    kalman = DelayKalmanFilter(system)
    whole, state = kalman.run(STEPS, y), kalman.initial((1,))
    for k in range(1, STEPS + 1):
        state = kalman.step(state, k, y[k])
        np.testing.assert_allclose(state.mean[0], whole.mean[k], atol=1e-12)
        np.testing.assert_allclose(state.loglik, whole.loglik[k], atol=1e-11)


def test_batch_axes_and_threads_change_nothing():
    system = SYSTEMS["several delays"]
    y = np.concatenate([records(system), records(system, 6)[..., :2]], axis=2)
    kalman = DelayKalmanFilter(system)
    flat, folded = kalman.run(STEPS, y), kalman.run(STEPS, y.reshape(STEPS + 1, 2, 2, 3), workers=2)
    for name in ("mean", "cov", "loglik"):
        one, other = getattr(flat, name), getattr(folded, name)
        assert other.shape == (*one.shape[:-1], 2, 3)
        np.testing.assert_array_equal(other.reshape(one.shape), one)
    alone = kalman.run(STEPS, y[..., 1])
    assert (alone.mean.shape, alone.loglik.shape) == ((STEPS + 1, 3), (STEPS + 1,))
    np.testing.assert_allclose(alone.mean, flat.mean[..., 1], atol=1e-13)
    complete = kalman.run(np.arange(6.0), y[:6, :, [0, 0]])
    assert complete.cov.shape == (6, 3, 3)
    np.testing.assert_allclose(complete.mean[..., 0], flat.mean[:6, :, 0], atol=1e-13)


def test_innovations_are_white_and_their_squares_normalised():
    """The covariance of the innovations with each other, by their coefficients."""
    system, steps = examples.rotation(0.7, 3), 15
    kalman, truth = DelayKalmanFilter(system), Regression(system, steps)
    coefficients = truth.outputs.copy()
    coefficients[0] = np.nan
    errors, squares = kalman.innovations(coefficients)
    inner = kalman.gains(steps).innovation_cov[:, 0, 0]
    cov = errors[1:, 0] @ truth.spread @ errors[1:, 0].T
    np.testing.assert_allclose(cov, np.diag(inner[1:]), atol=1e-14)
    np.testing.assert_allclose(squares, errors[:, 0] ** 2 / inner[:, None], rtol=1e-12)


def test_normalised_innovations_of_partly_missing_records():
    system = SYSTEMS["several delays"]
    y = records(system)
    errors, squares = DelayKalmanFilter(system).innovations(y.reshape(STEPS + 1, 2, 2, 2))
    assert (errors.shape, squares.shape) == ((STEPS + 1, 2, 2, 2), (STEPS + 1, 2, 2))
    truth, path = Regression(system, STEPS), 1
    for k in range(1, STEPS + 1):
        mean, cov, *_ = truth.estimate(y[..., path], k, k - 1)
        step, seen = system.step(k), np.isfinite(y[k, :, path])
        error = np.where(seen, y[k, :, path] - step.sensor @ mean, 0.0)
        inner = (step.sensor @ cov @ step.sensor.T + step.sensor_cov)[np.ix_(seen, seen)]
        np.testing.assert_allclose(errors[k, :, 0, 1], error, atol=1e-11)
        wanted = error[seen] @ np.linalg.solve(inner, error[seen]) if seen.any() else 0.0
        assert squares[k, 0, 1] == pytest.approx(wanted, abs=1e-10)


@pytest.mark.parametrize("name", ["several delays", "constant", "no delay"])
def test_the_innovations_form_gives_the_same_estimates(name):
    """Equations (R1), (R2): past innovations enter the corrected prediction."""
    system = SYSTEMS[name]
    y = system.simulate(STEPS, 3, 1).measurements
    kalman = DelayKalmanFilter(system)
    gains = kalman.innovation_gains(STEPS)
    assert gains.corrected
    run = kalman.run(STEPS, y)
    np.testing.assert_allclose(apply_gains(system, gains, y), run.mean, atol=1e-12)


@pytest.mark.parametrize("damping", [0.7, 0.8])
@pytest.mark.parametrize("method", ["structured", "array", "chandrasekhar"])
def test_long_runs_of_stable_and_unstable_systems_settle_alike(damping, method):
    """Against the plain Kalman recursion of the stack; a short table is the head of a long one."""
    system = examples.rotation(damping, 4)
    stack, cov = system.augmented(), system.start_cov()
    for _ in range(200):
        cov = stack.transition @ cov @ stack.transition.T + stack.noise
        inner = stack.sensor @ cov @ stack.sensor.T + stack.sensor_cov
        gain = np.linalg.solve(inner, stack.sensor @ cov).T
        cov = cov - gain @ inner @ gain.T
    kalman = DelayKalmanFilter(system, method)
    table = kalman.gains(200)
    assert table.method == method
    np.testing.assert_allclose(table.gain[-1].reshape(gain.shape), gain, atol=1e-11)
    np.testing.assert_allclose(table.cov[-1], cov[:2, :2], rtol=1e-10)
    np.testing.assert_array_equal(kalman.gains(7).gain, table.gain[:8])


def test_the_array_recursion_keeps_digits_and_the_fast_one_gives_way():
    """Two nearly parallel sensors; the variances after 60 steps are from 60-digit arithmetic."""
    system = examples.nearly_parallel_sensors()
    cov = DelayKalmanFilter(system, "array").gains(60).cov[-1]
    np.testing.assert_allclose(
        np.diag(cov), [5.0000013817249999e-13, 1.0033866697886802e-04], rtol=1e-11
    )
    table = DelayKalmanFilter(system, "chandrasekhar").gains(20)
    assert table.method.startswith("structured, because")
    np.testing.assert_array_equal(table.cov, DelayKalmanFilter(system).gains(20).cov)


def test_errors_on_simulated_paths_have_the_claimed_covariance():
    system, paths = SYSTEMS["several delays"], 4000
    run = system.simulate(STEPS, paths, 42)
    found = DelayKalmanFilter(system).run(STEPS, run.measurements)
    error = run.states[-1] - found.mean[-1]
    products = error[:, None] * error
    deviation = products.std(axis=2) / np.sqrt(paths)
    assert (np.abs(products.mean(axis=2) - found.cov[-1]) <= 4 * deviation).all()
