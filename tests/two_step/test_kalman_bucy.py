import numpy as np
import pytest
from scipy.integrate import solve_ivp

from seedslib.two_step import KalmanBucyFilter, LinearDiffusion
from seedslib.two_step.riccati import riccati_step

A, Q, R, S0 = -1.0, 0.5, 0.1, 4.0


def scalar(a=A, q=Q, r=R, s0=S0, mean=0.0):
    return KalmanBucyFilter(LinearDiffusion(a, q, 1, r, [mean], s0))


def scalar_error_cov(t, a=A, q=Q, r=R, s0=S0):
    """Closed solution of the scalar Riccati equation."""
    g = np.sqrt(a * a + q / r)
    high, low = r * (a + g), r * (a - g)
    ratio = (s0 - high) / (s0 - low)
    decay = ratio * np.exp(-2 * g * t)
    return (high - low * decay) / (1 - decay)


def planar(**changes):
    known = {
        "drift": [[0.2, 1.0], [-2.0, -0.3]],
        "noise_intensity": [[0.4, 0.1], [0.1, 0.2]],
        "sensor": [[1.0, 0.5], [0.0, 1.0]],
        "sensor_intensity": [[0.2, 0.05], [0.05, 0.4]],
        "mean0": [1.0, -1.0],
        "cov0": [[0.5, 0.1], [0.1, 0.3]],
    }
    return LinearDiffusion(**{**known, **changes})


def integrated(system, times):
    """Moments by an implicit integrator, with the matrices as the system gives them."""

    def slope(t, y):
        f, w, h, r = system.matrices(t)
        m, (c, p) = y[:2], y[2:].reshape(2, 2, 2)
        rates = [f @ c + c @ f.T + w, f @ p + p @ f.T + w - p @ h.T @ np.linalg.inv(r) @ h @ p]
        return np.concatenate([f @ m, np.ravel(rates)])

    start = np.concatenate([system.mean0, system.cov0.ravel(), system.cov0.ravel()])
    y = solve_ivp(slope, (0, times[-1]), start, "Radau", times, rtol=1e-11, atol=1e-13).y
    return y[:2].T, *y[2:].T.reshape(-1, 2, 2, 2).swapaxes(0, 1)


@pytest.mark.parametrize("a", [-1.0, 0.7])
@pytest.mark.parametrize("r", [1e-4, 0.1, 30.0])
def test_scalar_riccati(a, r):
    times = np.array([0.0, 1e-5, 0.1, 0.3, 1.1, 4.0, 50.0])
    moments = scalar(a=a, r=r, mean=2.0).moments(times)
    np.testing.assert_allclose(
        moments.error_cov[:, 0, 0], scalar_error_cov(times, a=a, r=r), rtol=1e-12
    )
    growth = np.exp(2 * a * times)
    np.testing.assert_allclose(
        moments.cov[:, 0, 0], S0 * growth + Q / (2 * a) * (growth - 1), rtol=1e-12
    )
    np.testing.assert_allclose(moments.mean[:, 0], 2.0 * np.exp(a * times), rtol=1e-12)


def test_static_parameter():
    times = np.array([0.0, 0.5, 3.0, 1e4])
    moments = scalar(a=0.0, q=0.0, r=0.2, s0=1.5).moments(times)
    np.testing.assert_allclose(
        moments.error_cov[:, 0, 0], 1.5 / (1 + times * 1.5 / 0.2), rtol=1e-12
    )
    assert np.array_equal(moments.cov[:, 0, 0], np.full(4, 1.5))


def test_constant_coefficients_against_an_implicit_integrator():
    times = np.array([0.0, 0.05, 0.4, 1.0, 3.0])
    for ours, exact in zip(
        KalmanBucyFilter(planar()).moments(times), integrated(planar(), times), strict=True
    ):
        np.testing.assert_allclose(ours, exact, rtol=1e-8, atol=1e-9)


def test_time_varying_coefficients_against_an_implicit_integrator():
    system = planar(
        drift=lambda t: [[0.2 * np.cos(t), 1.0], [-2.0, -0.3]],
        sensor_intensity=lambda t: np.eye(2) * (0.3 + 0.2 * np.sin(3 * t)),
    )
    times = np.array([0.05, 0.4, 1.0, 3.0])
    moments = KalmanBucyFilter(system).moments(times)
    for ours, exact in zip(moments, integrated(system, times), strict=True):
        np.testing.assert_allclose(ours, exact, rtol=1e-8, atol=1e-9)
    start = KalmanBucyFilter(system).moments([0.0])
    np.testing.assert_array_equal(start.error_cov[0], system.cov0)


def test_a_grid_that_starts_late_or_is_uneven_changes_nothing():
    kalman = KalmanBucyFilter(planar())
    whole = kalman.moments(np.linspace(0, 2, 401))
    part = kalman.moments([0.25, 0.3, 1.7])
    for ours, exact in zip(part, whole, strict=True):
        np.testing.assert_allclose(ours, exact[[50, 60, 340]], rtol=1e-12, atol=1e-13)


def test_composition_of_riccati_steps():
    system = planar()
    f, w, h, r = system.matrices(0.0)
    information = h.T @ np.linalg.solve(r, h)
    short, long = (riccati_step(f, information, w, step) for step in (0.7, 2.1))
    for ours, exact in zip(short.then(short).then(short), long, strict=True):
        np.testing.assert_allclose(ours, exact, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(
        long.apply(system.cov0), short.apply(short.apply(short.apply(system.cov0))), rtol=1e-12
    )


def test_one_huge_step_with_a_precise_sensor():
    """One step of a thousand time constants ends in the steady covariance, symmetric to the bit."""
    kalman = KalmanBucyFilter(planar(sensor_intensity=1e-8 * np.eye(2)))
    cov = kalman.moments([0.0, 100.0]).error_cov[1]
    np.testing.assert_allclose(cov, kalman.steady_error_cov(), rtol=1e-7)
    assert np.array_equal(cov, cov.T)


def test_singular_prior_and_silent_dynamics():
    kalman = KalmanBucyFilter(
        LinearDiffusion(
            np.zeros((2, 2)), np.zeros((2, 2)), np.eye(2), np.eye(2), [1, 2], np.diag([1.0, 0.0])
        )
    )
    moments = kalman.moments([0.0, 1.0, 5.0])
    assert np.array_equal(moments.error_cov[:, 1], np.zeros((3, 2)))
    np.testing.assert_allclose(moments.error_cov[:, 0, 0], [1, 1 / 2, 1 / 6], rtol=1e-14)


def test_error_covariance_never_exceeds_the_prior():
    times = np.concatenate([[0.0], np.geomspace(1e-9, 20, 60)])
    moments = KalmanBucyFilter(planar()).moments(times)
    excess = np.linalg.eigvalsh(moments.cov - moments.error_cov)[:, 0]
    assert excess.min() > -1e-12
    assert np.linalg.eigvalsh(moments.error_cov).min() > 0


def test_steady_state():
    kalman = KalmanBucyFilter(planar())
    late = kalman.moments([60.0])
    np.testing.assert_allclose(kalman.steady_error_cov(), late.error_cov[0], rtol=1e-9)
    steady = scalar().steady_moments()
    assert steady.error_cov[0, 0, 0] == pytest.approx(scalar_error_cov(1e3), rel=1e-13)
    assert steady.cov[0, 0, 0] == pytest.approx(0.25, rel=1e-13)
    late = KalmanBucyFilter(planar(drift=[[-0.5, 1.0], [-2.0, -0.3]]))
    for ours, exact in zip(late.steady_moments(), late.moments([80.0]), strict=True):
        np.testing.assert_allclose(ours, exact, rtol=1e-8, atol=1e-9)


def test_steady_state_that_does_not_exist():
    blind = KalmanBucyFilter(planar(drift=[[0.1, 0.0], [0.0, -1.0]], sensor=[[0, 1], [0, 2]]))
    with pytest.raises(ValueError, match="detectable"):
        blind.steady_error_cov()
    with pytest.raises(ValueError, match="Hurwitz"):
        scalar(a=0.0).steady_moments()
    with pytest.raises(ValueError, match="undamped mode"):
        scalar(a=0.0, q=0.0).steady_error_cov()
    turning = planar(drift=[[0, 1.0], [-1, 0]], noise_intensity=np.zeros((2, 2)))
    with pytest.raises(ValueError, match="undamped mode"):
        KalmanBucyFilter(turning).steady_error_cov()
    varying = KalmanBucyFilter(planar(drift=lambda t: np.eye(2)))
    with pytest.raises(ValueError, match="constant coefficients"):
        varying.steady_error_cov()


def test_prediction():
    system = planar()
    kalman = KalmanBucyFilter(system)
    here, ahead = kalman.moments([0.5]), kalman.moments([0.5], lead=0.4)
    mean, cov = kalman.predict(here.mean[0], here.error_cov[0], 0.5, 0.9)
    np.testing.assert_allclose(ahead.error_cov[0], cov, rtol=1e-12)
    np.testing.assert_allclose(ahead.mean[0], mean, rtol=1e-12)
    np.testing.assert_allclose(ahead.cov, kalman.moments([0.9]).cov, rtol=1e-12)
    # Without measurements the Riccati equation is the Lyapunov equation.
    f, w, _, _ = system.matrices(0.0)
    blind = riccati_step(f, np.zeros((2, 2)), w, 0.4)
    np.testing.assert_allclose(cov, blind.apply(here.error_cov[0]), rtol=1e-12)
    batch = kalman.predict(np.ones((2, 3, 4)), cov, 0.0, 1.0)[0]
    assert batch.shape == (2, 3, 4)


def test_errors_on_simulated_paths_have_the_promised_covariance():
    system, paths = planar(), 20_000
    times = np.linspace(0, 1.5, 301)
    sample = system.simulate(times, paths, 4)
    kalman = KalmanBucyFilter(system)
    estimates = kalman.run(times, sample.increments)
    np.testing.assert_allclose(estimates.cov, kalman.moments(times).error_cov, rtol=1e-11)
    for k in (20, 100, 300):
        cov = estimates.cov[k]
        error = sample.states[k] - estimates.mean[k]
        spread = np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / paths)
        assert np.all(np.abs(error @ error.T / paths - cov) < 4 * spread)
        # the error is uncorrelated with the estimate
        mean = estimates.mean[k] - estimates.mean[k].mean(axis=1, keepdims=True)
        spread = np.sqrt(np.outer(np.diag(cov), mean.var(axis=1)) / paths)
        assert np.all(np.abs(error @ mean.T / paths) < 4 * spread)


def test_run_is_exact_for_a_constant_rate_of_measurement():
    """With dy = c dt the estimate obeys a linear equation, which DOP853 integrates."""
    system, rate = planar(), np.array([0.7, -1.2])
    f, w, h, r = system.matrices(0.0)

    def slope(t, y):
        m, p = y[:2], y[2:].reshape(2, 2)
        gain = p @ h.T @ np.linalg.inv(r)
        return np.concatenate(
            [f @ m + gain @ (rate - h @ m), (f @ p + p @ f.T + w - gain @ h @ p).ravel()]
        )

    start = np.concatenate([system.mean0, system.cov0.ravel()])
    exact = solve_ivp(slope, (0, 1.0), start, "DOP853", rtol=1e-12, atol=1e-13).y[:2, -1]
    for steps in (4, 40):
        times = np.linspace(0, 1, steps + 1)
        run = KalmanBucyFilter(system).run(times, np.tile(rate / steps, (steps, 1)))
        np.testing.assert_allclose(run.mean[-1], exact, rtol=1e-10)


def test_estimates_converge_as_the_grid_is_refined():
    """Increments of one fine path, merged: the estimate's deviation is of first order in h."""
    kalman = scalar()
    fine = np.linspace(0, 2, 6401)
    sample = kalman.system.simulate(fine, 400, 8)
    reference = kalman.run(fine, sample.increments).mean[-1]
    deviations = []
    for merge in (64, 16):
        merged = sample.increments.reshape(-1, merge, 1, 400).sum(axis=1)
        coarse = kalman.run(fine[::merge], merged).mean[-1]
        deviations.append(np.sqrt(np.mean((coarse - reference) ** 2)))
    assert deviations[0] < 0.01
    assert 3 < deviations[0] / deviations[1] < 6


def test_run_with_time_varying_coefficients():
    system = planar(drift=lambda t: [[0.2 * np.cos(t), 1.0], [-2.0, -0.3]])
    times = np.linspace(0, 1, 201)
    sample = system.simulate(times[::20], 3, 1)
    assert sample.states.shape == (11, 2, 3)
    kalman = KalmanBucyFilter(system)
    run = kalman.run(times, np.zeros((200, 2)))
    np.testing.assert_allclose(run.cov, kalman.moments(times).error_cov, rtol=1e-5)


def test_a_missing_component_is_a_sensor_that_was_switched_off():
    system = planar(sensor_intensity=np.diag([0.2, 0.4]))
    times = np.linspace(0, 1, 101)
    increments = system.simulate(times, 6, 2).increments.copy()
    increments[:, 1] = np.nan
    alone = planar(sensor=[[1.0, 0.5]], sensor_intensity=[[0.2]])
    ours = KalmanBucyFilter(system).run(times, increments)
    exact = KalmanBucyFilter(alone).run(times, increments[:, :1])
    np.testing.assert_allclose(ours.mean, exact.mean, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(ours.cov, exact.cov, rtol=1e-11)
    increments[:] = np.nan
    blind = KalmanBucyFilter(system).run(times, increments)
    np.testing.assert_allclose(blind.cov[-1], KalmanBucyFilter(system).moments([1.0]).cov[0])


def test_batch_axes():
    kalman = KalmanBucyFilter(planar())
    times = np.linspace(0, 0.5, 26)
    increments = planar().simulate(times, 12, 0).increments
    flat = kalman.run(times, increments)
    folded = kalman.run(times, increments.reshape(25, 2, 3, 4))
    np.testing.assert_array_equal(folded.mean, flat.mean.reshape(26, 2, 3, 4))
    single = kalman.run(times, increments[..., 5])
    np.testing.assert_allclose(single.mean, flat.mean[..., 5], rtol=1e-13)


def test_bad_input():
    kalman = KalmanBucyFilter(planar())
    times = np.linspace(0, 1, 11)
    with pytest.raises(ValueError, match="increments: wanted shape"):
        kalman.run(times, np.zeros((9, 2)))
    with pytest.raises(ValueError, match="increments: wanted shape"):
        kalman.run(times, np.zeros(10))
    with pytest.raises(ValueError, match="increments: wanted finite"):
        kalman.run(times, np.full((10, 2), np.inf))
    partly = np.zeros((10, 2, 3))
    partly[4, 1, 2] = np.nan
    with pytest.raises(ValueError, match="component 1 of step 4"):
        kalman.run(times, partly)
    with pytest.raises(ValueError, match="steps shorter than"):
        KalmanBucyFilter(planar(sensor_intensity=1e-6 * np.eye(2))).run(times, np.zeros((10, 2)))
    with pytest.raises(ValueError, match="overflow"):
        scalar(a=1.0).moments([0.0, 300.0, 600.0])
    with pytest.raises(ValueError, match="lead"):
        kalman.moments(times, lead=-1.0)
    with pytest.raises(ValueError, match="times"):
        kalman.moments([])
    with pytest.raises(TypeError, match="times"):
        kalman.moments([1j])
    with pytest.raises(TypeError, match="system: wanted a LinearDiffusion"):
        KalmanBucyFilter("no system")
    with pytest.raises(ValueError, match="mean: wanted shape"):
        kalman.predict([1.0], np.eye(2), 0, 1)
    with pytest.raises(ValueError, match="cov: wanted"):
        kalman.predict([1.0, 0.0], -np.eye(2), 0, 1)


@pytest.mark.parametrize(
    "units", [(1e6, 1e6), (1e20, 1e20), (1e75, 1e75), (1e-75, 1e-75), (1e6, 1e-6)]
)
def test_units_of_the_state_and_of_the_measurement_do_not_matter(units):
    own, d, e = planar(), np.array(units), np.array([1e9, 1e-3])
    other = planar(
        drift=own.drift * d[:, None] / d,
        noise_intensity=own.noise_intensity * d[:, None] * d,
        sensor=own.sensor * e[:, None] / d,
        sensor_intensity=own.sensor_intensity * e[:, None] * e,
        mean0=own.mean0 * d,
        cov0=own.cov0 * d[:, None] * d,
    )
    own, other = KalmanBucyFilter(own), KalmanBucyFilter(other)
    times, square = [0.0, 0.01, 0.4, 7.0], d[:, None] * d
    known, moved = own.moments(times), other.moments(times)
    np.testing.assert_allclose(moved.cov / square, known.cov, rtol=1e-11)
    np.testing.assert_allclose(moved.error_cov / square, known.error_cov, rtol=1e-11)
    np.testing.assert_allclose(
        other.steady_error_cov() / square, own.steady_error_cov(), rtol=1e-11
    )
    grid, dy = np.linspace(0, 0.1, 5), np.random.default_rng(2).normal(size=(4, 2))
    estimates = own.run(grid, dy).mean, other.run(grid, dy * e).mean / d
    np.testing.assert_allclose(estimates[1], estimates[0], rtol=1e-11)


def test_no_paths_and_no_steps_are_legal():
    own = KalmanBucyFilter(planar())
    assert own.run([0.0, 0.01, 0.02], np.zeros((2, 2, 0))).mean.shape == (3, 2, 0)
    start = own.run([0.0], np.zeros((0, 2, 5)))
    np.testing.assert_array_equal(start.mean, np.broadcast_to([[[1.0], [-1.0]]], (1, 2, 5)))
    assert own.run([0.0], np.zeros((0, 2))).mean.shape == (1, 2)
