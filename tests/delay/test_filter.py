"""The optimal filter of a system with delays, in its four recursions."""

import mpmath
import numpy as np
import pytest
from scipy.linalg import block_diag

from seedslib.delay import DelayKalmanFilter, DelaySystem, apply_gains, error_covariance, examples
from seedslib.delay.recursions import RECURSIONS

EXACT = ("structured", "array")


def varying_system(delays, steps, seed=3, n=3, m=2):
    """Time-varying in everything, singular Q, correlated history with its own mean."""
    rng = np.random.default_rng(seed)
    size = (max(delays) + 1) * n
    spread, noise = rng.standard_normal((size, size)), rng.standard_normal((steps + 1, m, m))
    return DelaySystem(
        {d: 0.3 * rng.standard_normal((steps, n, n)) for d in delays},
        sensor=rng.standard_normal((steps + 1, m, n)),
        noise_cov=np.diag([1.0, 0.0]),
        sensor_cov=noise @ noise.swapaxes(1, 2) + 0.3 * np.eye(m),
        cov0=spread @ spread.T / size,
        mean0=rng.standard_normal(size),
        noise_input=lambda k: np.array([[1.0, k], [np.sin(k), 0.0], [0.5, 1.0]]),
    )


class Regression:
    """Everything as a linear function of start and noises; estimates by one regression."""

    def __init__(self, system, steps):
        self.system, n, reach = system, system.state_size, system.max_delay
        q = system.step(1).noise_cov.shape[0]
        start = (reach + 1) * n
        self.states = np.zeros((reach + 1 + steps, n, start + steps * q))
        self.means = np.zeros((reach + 1 + steps, n))
        for j in range(reach + 1):
            self.states[reach - j, :, j * n : (j + 1) * n] = np.eye(n)
            self.means[reach - j] = system.mean0[j * n : (j + 1) * n]
        spreads = [system.start_cov()]
        for k in range(1, steps + 1):
            step, at = system.step(k), start + (k - 1) * q
            for d, a in step.dynamics.items():
                self.states[reach + k] += a @ self.states[reach + k - 1 - d]
                self.means[reach + k] += a @ self.means[reach + k - 1 - d]
            self.states[reach + k, :, at : at + q] += step.noise_input
            spreads.append(step.noise_cov)
        self.spread = block_diag(*spreads)

    def estimate(self, y, k, last):
        """Mean and covariance of x_k given the measurements up to `last`, and their log density."""
        reach = self.system.max_delay
        rows, left, noises = [], [], []
        for i in range(1, last + 1):
            step, present = self.system.step(i), ~np.isnan(y[i])
            rows.append((step.sensor @ self.states[reach + i])[present])
            left.append((y[i] - step.sensor @ self.means[reach + i])[present])
            noises.append(step.sensor_cov[np.ix_(present, present)])
        rows, left = np.vstack(rows), np.concatenate(left)
        spread = rows @ self.spread @ rows.T + block_diag(*(r for r in noises if r.size))
        cross = self.states[reach + k] @ self.spread @ rows.T
        weights = np.linalg.solve(spread, cross.T).T
        cov = self.states[reach + k] @ self.spread @ self.states[reach + k].T - weights @ cross.T
        loglik = -0.5 * (
            left @ np.linalg.solve(spread, left) + np.linalg.slogdet(2 * np.pi * spread)[1]
        )
        return self.means[reach + k] + weights @ left, cov, loglik


def worst(one, other):
    """Largest difference of two tables of gains."""
    return max(np.abs(a - b).max() for a, b in zip(one[:-1], other[:-1], strict=True))


PLANTS = {
    "two delays": lambda: varying_system((0, 4), 50),
    "four delays": lambda: varying_system((0, 2, 3, 7), 40),
    "no delay": lambda: varying_system((0,), 40),
    "pure delay": lambda: varying_system((3,), 40),
    "rotation": lambda: examples.rotation(0.7, 10),
    "precise sensor": examples.precise_sensor,
    "unstable": lambda: examples.rotation(0.8, 3),
    "no process noise": lambda: DelaySystem({0: 0.5, 2: 0.4}, 1.0, 0.0, 1.0, 1.0, 0.0),
}


@pytest.mark.parametrize("method", EXACT)
@pytest.mark.parametrize("name", PLANTS)
def test_recursions_agree_with_the_augmented_filter(name, method):
    system = PLANTS[name]()
    dense = DelayKalmanFilter(system, "augmented").gains(40)
    scale = max(1.0, np.abs(dense.predicted).max())
    assert worst(DelayKalmanFilter(system, method).gains(40), dense) <= 1e-13 * scale


@pytest.mark.parametrize("method", RECURSIONS)
def test_covariances_are_exactly_symmetric(method):
    table = DelayKalmanFilter(examples.rotation(0.7, 4), method).gains(30)
    for cov in (table.innovation_cov, table.predicted, table.cov):
        tolerance = 0.0 if method != "array" else 1e-15 * np.abs(cov).max()
        assert np.abs(cov - cov.swapaxes(1, 2)).max() <= tolerance


def test_repaired_filter_is_the_batch_optimum():
    """DK-R1: recursion (R1)-(R2) against one regression on all data."""
    system = varying_system((0, 4), 50)
    run = system.simulate(50, 3, 1)
    kalman = DelayKalmanFilter(system)
    gains = kalman.innovation_gains(50)
    means = apply_gains(system, gains, run.measurements)
    table, truth = kalman.gains(50), Regression(system, 50)
    exact = error_covariance(system, gains)
    for k in (1, 2, 3, 6, 20, 50):
        for path in range(3):
            mean, cov, _ = truth.estimate(run.measurements[..., path], k, k)
            np.testing.assert_allclose(means[k, :, path], mean, rtol=0, atol=1e-11)
            np.testing.assert_allclose(table.cov[k], cov, rtol=0, atol=1e-11)
            np.testing.assert_allclose(exact[k], cov, rtol=0, atol=1e-11)


def test_innovations_are_white():
    """DK-R1: covariance of the innovations with each other, by their coefficients."""
    system = examples.rotation(0.7, 3)
    steps, reach = 25, 3
    kalman, truth = DelayKalmanFilter(system), Regression(system, 25)
    size = truth.spread.shape[0]
    coefficients = np.zeros((steps + 1, 1, size + steps))
    coefficients[0] = np.nan
    for k in range(1, steps + 1):
        coefficients[k, :, :size] = system.step(k).sensor @ truth.states[reach + k]
        coefficients[k, 0, size + k - 1] = 1.0
    errors, _ = kalman.innovations(coefficients)
    spread = block_diag(truth.spread, np.eye(steps))
    cov = errors[1:, 0] @ spread @ errors[1:, 0].T
    inner = kalman.gains(steps).innovation_cov[1:, 0, 0]
    np.testing.assert_allclose(cov, np.diag(inner), rtol=0, atol=1e-14)


@pytest.mark.parametrize("plant", ["varying", "precise sensor"])
def test_repaired_filter_equals_the_augmented_one_path_by_path(plant):
    """DK-R2."""
    system = varying_system((0, 4), 50) if plant == "varying" else examples.precise_sensor()
    y = system.simulate(50, 2000, 42).measurements
    dense = DelayKalmanFilter(system, "augmented").run(len(y) - 1, y)
    kalman = DelayKalmanFilter(system)
    run = kalman.run(len(y) - 1, y)
    by_innovations = apply_gains(system, kalman.innovation_gains(50), y)
    scale = max(1.0, np.abs(dense.mean).max())
    for mean in (run.mean, by_innovations):
        assert np.abs(mean - dense.mean).max() <= 1e-13 * scale
    assert np.abs(run.loglik - dense.loglik).max() <= 1e-11


def test_several_delays_against_regression():
    """DK-R3: delays 0, 2, 3, 7, everything time-varying."""
    system = varying_system((0, 2, 3, 7), 30)
    y = system.simulate(30, 2, 4).measurements
    run, truth = DelayKalmanFilter(system).run(len(y) - 1, y), Regression(system, 30)
    for k in (1, 3, 9, 30):
        mean, cov, _ = truth.estimate(y[..., 1], k, k)
        np.testing.assert_allclose(run.mean[k, :, 1], mean, rtol=0, atol=1e-11)
        np.testing.assert_allclose(run.cov[k], cov, rtol=0, atol=1e-11)


@pytest.mark.parametrize("method", RECURSIONS)
def test_missing_values_and_lags_against_regression(method):
    system = varying_system((0, 2, 5), 20)
    if method == "chandrasekhar":
        system = examples.rotation(0.7, 5)
    y = system.simulate(20, 6, 5).measurements
    lost = np.random.default_rng(1).random(y.shape) < 0.3
    lost[..., :2] = False
    lost[..., 3] = lost[..., 2]
    y[lost] = np.nan
    y[7, :, 4] = np.nan
    kalman, truth = DelayKalmanFilter(system, method), Regression(system, 20)
    for lag in (0, 1, 5):
        run = kalman.run(len(y) - 1, y, lag=lag)
        assert run.cov.shape == (21, system.state_size, system.state_size, 6)
        for path in (0, 3, 4):
            for k in (0, 1, 7, 16, 20):
                last = max(min(k + lag, 20), 1 if k == 0 and lag else 0)
                if last == 0:
                    np.testing.assert_array_equal(
                        run.mean[0, :, path], system.mean0[: system.state_size]
                    )
                    continue
                mean, cov, loglik = truth.estimate(y[..., path], k, last)
                np.testing.assert_allclose(run.mean[k, :, path], mean, rtol=0, atol=1e-11)
                np.testing.assert_allclose(run.cov[k, ..., path], cov, rtol=0, atol=1e-11)
                total = run.loglik[: last + 1, path].sum()
                assert total == pytest.approx(loglik, abs=1e-10)


def test_step_by_step_equals_run():
    system = varying_system((0, 3), 15)
    y = system.simulate(15, 5, 2).measurements
    y[4, 0] = np.nan
    y[9] = np.nan
    for method in ("structured", "array", "augmented"):
        kalman = DelayKalmanFilter(system, method)
        run, state = kalman.run(len(y) - 1, y), kalman.initial((5,))
        for k in range(1, 16):
            before = state
            copies = [np.copy(part) for part in (before.mean, before.recursion[1])]
            state = kalman.step(state, k, y[k])
            for part, copy in zip((before.mean, before.recursion[1]), copies, strict=True):
                np.testing.assert_array_equal(part, copy)
            np.testing.assert_allclose(state.mean[0], run.mean[k], rtol=0, atol=1e-13)
            np.testing.assert_allclose(state.loglik, run.loglik[k], rtol=0, atol=1e-12)
            np.testing.assert_allclose(state.cov, run.cov[k], rtol=0, atol=1e-13)
        smoothed = kalman.run(len(y) - 1, y, lag=3)
        np.testing.assert_allclose(state.mean[3], smoothed.mean[12], rtol=0, atol=1e-13)


def test_batch_axes_come_back_as_they_were():
    system = examples.rotation(0.7, 3)
    y = system.simulate(10, 6, 3).measurements
    kalman = DelayKalmanFilter(system)
    flat, folded = kalman.run(len(y) - 1, y), kalman.run(10, y.reshape(11, 1, 2, 3))
    assert folded.mean.shape == (11, 2, 2, 3)
    assert folded.loglik.shape == (11, 2, 3)
    np.testing.assert_array_equal(folded.mean.reshape(11, 2, 6), flat.mean)
    alone = kalman.run(10, y[..., 4])
    assert (alone.mean.shape, alone.cov.shape, alone.loglik.shape) == ((11, 2), (11, 2, 2), (11,))
    np.testing.assert_allclose(alone.mean, flat.mean[..., 4], rtol=0, atol=1e-14)


def test_gains_are_computed_once_and_a_shorter_record_reuses_them(monkeypatch):
    kalman = DelayKalmanFilter(examples.rotation(0.7, 3))
    table = kalman.gains(30)

    def never(*_):
        raise AssertionError("the recursion ran again")

    monkeypatch.setattr(RECURSIONS["structured"], "advance", never)
    short = kalman.gains(12)
    np.testing.assert_array_equal(short.gain, table.gain[:13])
    kalman.run(20, kalman.system.simulate(20, 4, 1).measurements)


def test_monte_carlo_error_and_innovations():
    """DK-R2: plant E2 at k = 40, and the normalised innovations squared."""
    system, paths = examples.precise_sensor(), 20_000
    run = system.simulate(40, paths, 42)
    kalman = DelayKalmanFilter(system)
    square = ((run.states[40] - kalman.run(run.times, run.measurements).mean[40]) ** 2).sum(axis=0)
    trace = np.trace(kalman.gains(40).cov[40])
    assert trace == pytest.approx(1.5842, abs=5e-5)
    assert abs(square.mean() - trace) <= 4.0 * square.std() / np.sqrt(paths)
    _, squares = kalman.innovations(run.measurements)
    mean = squares[1:].mean(axis=0)
    assert abs(mean.mean() - 1.0) <= 4.0 * mean.std() / np.sqrt(paths)


STARTS = {
    "unequal": {"cov0": 2.0 * np.eye(2), "history_cov": 0.5 * np.eye(2)},
    "known history": {"cov0": np.eye(2)},
    "equal": {"cov0": np.eye(2), "history_cov": np.eye(2)},
}


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("delays", [(0, 1), (0, 3), (0, 10), (0, 2, 3, 7), (0,), (2,)])
def test_fast_recursion_agrees_with_the_augmented_filter(delays, start):
    """DK-R5, also for several delays."""
    rng = np.random.default_rng(len(delays))
    given = dict(STARTS[start])
    if delays == (0,):
        given.pop("history_cov", None)
    system = DelaySystem(
        {d: 0.25 * rng.standard_normal((2, 2)) for d in delays},
        sensor=[[1.0, 0.0], [0.3, 1.0]],
        noise_cov=[[1.0, 0.0], [0.0, 0.0]],
        sensor_cov=[[1.0, 0.2], [0.2, 0.5]],
        **given,
    )
    fast = DelayKalmanFilter(system, "chandrasekhar").gains(200)
    assert fast.method == "chandrasekhar"
    assert worst(fast, DelayKalmanFilter(system, "augmented").gains(200)) <= 1e-12


def test_fast_recursion_on_an_unstable_plant():
    for system in (examples.rotation(0.8, 3), examples.scalar(1.2, -1.2, 10.0, 3)):
        fast = DelayKalmanFilter(system, "chandrasekhar").gains(200)
        assert fast.method == "chandrasekhar"
        assert worst(fast, DelayKalmanFilter(system, "augmented").gains(200)) <= 1e-11


def test_fast_recursion_needs_no_large_matrix():
    """At D = 12 000 one D × D matrix would take 1.1 GB."""
    import tracemalloc

    system = examples.rotation(0.6, 5999)
    tracemalloc.start()
    try:
        kalman = DelayKalmanFilter(system, "chandrasekhar")
        table = kalman.gains(20)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert table.method == "chandrasekhar"
    assert peak < 30e6


def test_fast_recursion_settles():
    system = examples.scalar(0.6, 0.3, 1.0, 2)
    state = RECURSIONS["chandrasekhar"].start(system)
    for _ in range(200):
        state, now = RECURSIONS["chandrasekhar"].advance(system, state)
    assert state.change.shape[2] == 0
    dense = DelayKalmanFilter(system, "augmented").gains(400)
    np.testing.assert_allclose(now.gain, dense.gain[-1], rtol=0, atol=1e-15)


def test_fast_recursion_gives_way_where_it_fails():
    hard = DelayKalmanFilter(examples.nearly_parallel_sensors(), "chandrasekhar")
    table = hard.gains(20)
    assert table.method.startswith("structured, because")
    plain = DelayKalmanFilter(examples.nearly_parallel_sensors()).gains(20)
    np.testing.assert_array_equal(table.cov, plain.cov)
    with pytest.raises(ValueError, match="lost its digits"):
        hard.step(hard.initial(), 1, np.zeros(2))
    for system in (
        varying_system((0, 2), 5),
        DelaySystem({1: 0.5}, 1.0, 1.0, 1.0, np.eye(2) + 0.5),
    ):
        with pytest.raises(ValueError, match="chandrasekhar"):
            DelayKalmanFilter(system, "chandrasekhar")


# Diagonal of the stacked covariance after 60 steps; Joseph's form with 120 digits gives the same.
REFERENCE = (
    5.0000013817249999e-13, 1.0033866697886802e-04, 5.0000003865934140e-13,
    1.3417997651414172e-06, 5.0000003372454711e-13, 1.4080907739833081e-06,
    5.0000003396563162e-13, 1.6706817018188486e-06, 5.0000001770554803e-13,
    1.6723830734595037e-06,
)  # fmt: skip


def exact_diagonals(system, steps):
    """Diagonal of the stacked covariance at k = 1..steps, 60 digits."""
    with mpmath.workdps(60):
        step = system.augmented()
        f, w, h, r = (mpmath.matrix(part.tolist()) for part in step)
        cov, found = mpmath.matrix(system.start_cov().tolist()), []
        for _ in range(steps):
            predicted = f * cov * f.T + w
            gain = predicted * h.T * (h * predicted * h.T + r) ** -1
            cov = predicted - gain * (h * predicted)
            cov = (cov + cov.T) / 2
            found.append([float(cov[i, i]) for i in range(cov.rows)])
    return np.array(found)


def test_square_roots_keep_the_digits_that_covariances_lose():
    system = examples.nearly_parallel_sensors()
    exact = exact_diagonals(system, 60)
    np.testing.assert_allclose(exact[-1], REFERENCE, rtol=1e-15)

    def error(diagonal, k):
        return (np.abs(diagonal - exact[k - 1]) / exact[k - 1]).max()

    errors, smallest = {}, 0.0
    for method in ("array", "structured"):
        recursion = RECURSIONS[method]
        state, errors[method] = recursion.start(system), []
        for k in range(1, 61):
            state, _ = recursion.advance(system, state)
            if method == "array":
                diagonal = (state.root**2).sum(axis=1).reshape(5, 2)[::-1]
            else:
                diagonal = np.diag(state.cov).reshape(5, 2)[(k - np.arange(5)) % 5]
            errors[method].append(error(diagonal.ravel(), k))
    step, cov, plain = system.augmented(), system.start_cov(), []
    for k in range(1, 61):
        predicted = step.transition @ cov @ step.transition.T + step.noise
        inner = step.sensor @ predicted @ step.sensor.T + step.sensor_cov
        gain = np.linalg.solve(inner, step.sensor @ predicted).T
        cov = predicted - gain @ inner @ gain.T
        cov = 0.5 * (cov + cov.T)
        plain.append(error(np.diag(cov), k))
        smallest = min(smallest, np.linalg.eigvalsh(cov)[0])
    assert errors["array"][-1] <= 1e-12
    assert max(errors["array"]) <= 1e-7
    assert errors["structured"][-1] <= 1e-4  # five digits; implementations differ by ten
    assert plain[-1] >= 1e-6  # the plain update keeps less than six digits
    assert smallest < 0.0  # and is no covariance on the way


@pytest.mark.parametrize(
    ("call", "error", "name"),
    [
        (lambda s: DelayKalmanFilter("plant"), TypeError, "system"),
        (lambda s: DelayKalmanFilter(s, "fast"), ValueError, "method"),
        (lambda s: DelayKalmanFilter(s).gains(0), ValueError, "steps"),
        (lambda s: DelayKalmanFilter(s).gains(2.5), TypeError, "steps"),
        (lambda s: DelayKalmanFilter(s).gains(3, np.zeros((4, 1))), ValueError, "missing"),
        (
            lambda s: DelayKalmanFilter(s).run(1, np.full((1, 1), np.nan)),
            ValueError,
            "measurements",
        ),
        (lambda s: DelayKalmanFilter(s).run(3, np.zeros((4, 1))), ValueError, "k = 0"),
        (lambda s: DelayKalmanFilter(s).run(3, np.zeros((4, 2, 7))), ValueError, "measurements"),
        (lambda s: DelayKalmanFilter(s).run(3, np.zeros((4, 1, 0))), ValueError, "path"),
        (lambda s: DelayKalmanFilter(s).run(1, [[np.nan], [np.inf]]), ValueError, "measurements"),
        (lambda s: DelayKalmanFilter(s).run(1, [[np.nan], [1.0]], lag=4), ValueError, "lag"),
        (lambda s: DelayKalmanFilter(s).run(1, [[np.nan], [1.0]], lag=1.0), TypeError, "lag"),
        (lambda s: step_of(s, np.zeros(2)), ValueError, "y"),
        (lambda s: step_of(s, [[np.nan, 1.0]], (2,)), ValueError, "y"),
    ],
)
def test_bad_input_is_named(call, error, name):
    with pytest.raises(error, match=name):
        call(examples.rotation(0.7, 3))


def step_of(system, y, batch=()):
    kalman = DelayKalmanFilter(system)
    return kalman.step(kalman.initial(batch), 1, y)


def test_fast_recursion_never_loses_digits_silently():
    """Random plants, also unstable and badly scaled: either a fallback or the right numbers."""
    rng, kept = np.random.default_rng(0), 0
    for _ in range(60):
        n, m, reach = (int(rng.integers(1, top)) for top in (5, 4, 7))
        delays = sorted({reach, *rng.integers(0, reach + 1, size=2).tolist()})
        scale = 10 ** rng.uniform(-1.0, 0.3) / np.sqrt(n * len(delays))
        system = DelaySystem(
            {d: scale * rng.standard_normal((n, n)) for d in delays},
            sensor=rng.standard_normal((m, n)),
            noise_cov=np.eye(n),
            sensor_cov=10 ** rng.uniform(-4, 2) * np.eye(m),
            cov0=10 ** rng.uniform(-3, 4) * np.eye(n),
            history_cov=10 ** rng.uniform(-3, 4) * np.eye(n),
        )
        fast = DelayKalmanFilter(system, "chandrasekhar").gains(60)
        exact = DelayKalmanFilter(system, "array").gains(60)
        kept += fast.method == "chandrasekhar"
        size = np.abs(exact.innovation_cov[1:]).max(axis=(1, 2))
        wrong = np.abs(fast.innovation_cov - exact.innovation_cov)[1:].max(axis=(1, 2))
        assert (wrong <= 1e-9 * size).all()
    assert kept >= 30


@pytest.mark.parametrize("method", RECURSIONS)
@pytest.mark.parametrize(
    ("dynamics", "sensor", "steps"), [(1e160, 1.0, 5), (0.5, 1e160, 5), (3.0, 0.0, 400)]
)
def test_overflow_is_refused(dynamics, sensor, steps, method):
    def tabulate():
        plant = DelaySystem({0: dynamics, 2: 0.3}, sensor, 1.0, 1.0, 1.0, 1.0)
        return DelayKalmanFilter(plant, method).gains(steps)

    with pytest.raises(ValueError, match=r"system.*overflow"):
        tabulate()


def test_overflow_of_means_and_odd_arguments_are_refused():
    plant = DelaySystem({0: 3.0}, 1e-160, 0.0, 1.0, 0.0, mean0=[1e150])
    with pytest.raises(ValueError, match=r"system.*estimates"):
        DelayKalmanFilter(plant).run(499, np.full((500, 1), np.nan))
    kalman = DelayKalmanFilter(examples.rotation(0.7, 3))
    with pytest.raises(TypeError, match="missing"):
        kalman.gains(3, [[True], [True, False]])
    with pytest.raises(TypeError, match="batch"):
        kalman.initial(3)
    with pytest.raises(ValueError, match="batch"):
        kalman.initial((0,))
    with pytest.raises(ValueError, match="method"):
        DelayKalmanFilter(kalman.system, ["array"])
