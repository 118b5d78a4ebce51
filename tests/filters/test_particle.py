import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.filters import ParticleFilter, assumed_density, extended_kalman
from seedslib.filters.particle import _resample
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

x, v, w = sympy.symbols("x v w")


@pytest.fixture(scope="module")
def autoregression():
    return DiscreteSystem(
        StochasticMap((x,), [0.9 * x + w], Noise((w,))),
        StochasticMap((x,), [x + v], Noise((v,))),
        mean0=[0],
        cov0=[[1]],
    )


def test_approaches_the_kalman_filter(autoregression):
    """Errors over 40 records shrink as the square root of the number of particles."""
    times = np.arange(8.0)
    record = autoregression.simulate(times, 40, 1).measurements
    record[3, 0, :20] = np.nan
    exact = extended_kalman(autoregression).run(times, record)
    distance = []
    for particles in (500, 8000):
        got = ParticleFilter(autoregression, particles).run(times, record, seed=2)
        distance.append(np.sqrt(((got.mean - exact.mean) ** 2).mean()))
        # the likelihood estimate is unbiased; its logarithm is low by half its variance
        gap = (got.loglik - exact.loglik).sum(axis=0)
        assert abs(gap.mean() + gap.var() / 2) < 4 * gap.std() / np.sqrt(40) + 2 / particles
    assert distance[1] < 4 * 0.8 / np.sqrt(8000)
    assert 2.5 < distance[0] / distance[1] < 6.5
    cov = exact.cov if exact.cov.ndim == 4 else exact.cov[..., None]
    assert abs((got.cov - cov).mean()) < 0.01
    assert not got.diverged.any()


def test_kicked_oscillator():
    """Section 9.2: .673 at the times k >= 4, against .7315 of the assumed-density filter."""
    system, times = zoo.kicked_duffing(), 0.5 * np.arange(13)
    run = system.simulate(times, 300, 4)
    got = ParticleFilter(system, 400, step=0.02).run(times, run.measurements, seed=5)
    gauss = assumed_density(system, step=0.05).run(times, run.measurements)
    squares = [((e.mean - run.states)[4:, 0] ** 2).mean(axis=0) for e in (got, gauss)]
    value = np.sqrt(squares[0].mean())
    error = squares[0].std() / np.sqrt(300) / (2 * value)
    assert abs(value - 0.673) < 4 * error * np.sqrt(1 + 300 / 2000)
    gain = squares[1] - squares[0]
    assert gain.mean() > 2 * gain.std() / np.sqrt(300)


def test_resampling_keeps_expected_counts():
    """Systematic resampling gives each particle the floor or the ceiling of its expected count."""
    rng = np.random.default_rng(0)
    weight = rng.random((50, 4)) ** 4
    weight /= weight.sum(axis=0)
    tags = np.broadcast_to(np.arange(50.0)[:, None], (50, 4))[None]
    totals = np.zeros((50, 4))
    for _ in range(400):
        drawn = _resample(tags, weight, rng)[0]
        for k in range(4):
            counts = np.bincount(drawn[:, k].astype(int), minlength=50)
            assert (np.abs(counts - 50 * weight[:, k]) < 1 + 1e-9).all()
            totals[:, k] += counts
    np.testing.assert_allclose(totals / 400, 50 * weight, atol=4 * 0.5 / np.sqrt(400))


def test_threads_do_not_matter_and_seeds_do(autoregression):
    times = np.arange(3.0)
    record = autoregression.simulate(times, 40, 1).measurements
    filter_ = ParticleFilter(autoregression, 1000)
    one, two, three = (
        filter_.run(times, record, seed=s, workers=k) for s, k in ((7, 1), (7, 2), (8, 1))
    )
    for a, b in zip(one, two, strict=True):
        if a is not None:
            np.testing.assert_array_equal(a, b)
    assert not np.array_equal(one.mean, three.mean)
    single = filter_.run(times, record[..., 0], seed=7)
    assert single.mean.shape == (3, 1)
    assert single.cov.shape == (3, 1, 1)
    folded = filter_.run(times, record.reshape(3, 1, 5, 8), seed=7)
    np.testing.assert_array_equal(folded.mean.reshape(3, 1, 40), one.mean)


def test_verbs_are_pure_and_make_up_a_run(autoregression):
    times = np.arange(3.0)
    record = autoregression.simulate(times, 2, 1).measurements
    filter_ = ParticleFilter(autoregression, 100)
    state = filter_.initial((2,), seed=3)
    again = filter_.initial((2,), seed=3)
    np.testing.assert_array_equal(state.particles, again.particles)
    for k, t in enumerate(times):
        state = filter_.step(state, t, record[k])
        again = filter_.correct(filter_.predict(again, t), record[k])
    np.testing.assert_array_equal(state.mean, again.mean)
    np.testing.assert_array_equal(
        filter_.forecast(state, 3.0).mean, filter_.forecast(state, 3.0).mean
    )
    assert state.time == 2.0


def test_record_that_no_particle_explains_is_marked(autoregression):
    record = np.zeros((3, 1, 2))
    record[1, 0, 1] = 1e200
    got = ParticleFilter(autoregression, 50).run(np.arange(3.0), record, seed=0)
    assert got.diverged.tolist() == [False, True]
    assert np.isneginf(got.loglik[1, 1])
    assert np.isfinite(got.mean).all()


def test_unmeasured_times_are_forecasts(autoregression):
    record = np.array([[0.5], [np.nan]])
    got = ParticleFilter(autoregression, 20_000).run([0.0, 1.0], record, seed=0)
    assert got.loglik[1] == 0
    assert got.mean[1, 0] == pytest.approx(0.9 * got.mean[0, 0], abs=4 * np.sqrt(1.4 / 20_000))


def test_sensor_without_a_likelihood_is_refused():
    system = JumpDiffusion((x,), [0], [[1]], [x * v**2], Noise((v,)), [0], [[1]])
    with pytest.raises(ValueError, match="wanted a sensor affine in Gaussian noise or one with"):
        ParticleFilter(system)


@pytest.mark.parametrize("count", [0, -5])
def test_bad_counts(autoregression, count):
    with pytest.raises(ValueError, match="particles: wanted at least 1"):
        ParticleFilter(autoregression, count)


def test_bad_records(autoregression):
    with pytest.raises(ValueError, match=r"measurements: wanted shape \(2, 1, \*batch\)"):
        ParticleFilter(autoregression, 5).run([0.0, 1.0], np.zeros((2, 2)))
    filter_ = ParticleFilter(autoregression, 5)
    with pytest.raises(ValueError, match="state: wanted a state with a time"):
        filter_.correct(filter_.initial(), [0.0])


# Switching systems


def test_switching_particles_against_the_grid():
    """Scalar example A1H: distance to the exact posterior within the sampling error."""
    from seedslib.filters import GridBayesFilter

    system, times = zoo.scalar_switching("A1H"), np.arange(11.0)
    data = system.simulate(times, 60, 1)
    exact = GridBayesFilter(system).run(times, data.measurements)
    got = ParticleFilter(system, 2000).run(times, data.measurements, seed=2)
    assert got.mean.shape == (11, 1, 60)
    assert got.mode_prob.shape == (11, 2, 60)
    np.testing.assert_allclose(got.mode_prob.sum(axis=1), 1.0)
    np.testing.assert_array_equal(got.modes, got.mode_prob.argmax(axis=1))
    scale = np.sqrt(exact.cov[:, 0, 0].mean() / 2000)
    assert np.sqrt(((got.mean - exact.mean) ** 2).mean()) < 3 * scale
    assert np.sqrt(((got.mode_prob - exact.mode_prob) ** 2).mean()) < 3 * 0.5 / np.sqrt(2000)
    assert abs((got.cov - exact.cov).mean()) < 0.02
    gap = (got.loglik - exact.loglik).sum(axis=0)
    assert abs(gap.mean() + gap.var() / 2) < 4 * gap.std() / np.sqrt(60)


def test_switching_particles_use_the_indicator():
    system, times = zoo.manoeuvring_target("exact"), np.arange(6.0)
    data = system.simulate(times, 50, 3)
    data.indicators[4, :25] = -1
    filter_ = ParticleFilter(system, 800)
    got = filter_.run(times, data.measurements, indicators=data.indicators, seed=1)
    seen = np.delete(np.arange(6), 4)
    np.testing.assert_array_equal(got.modes[seen], data.modes[seen])
    assert 0.001 < got.mode_prob[4, :, :25].min(axis=0).mean() < 0.4
    state = filter_.initial((50,), seed=1)
    for k, t in enumerate(times):
        state = filter_.step(state, t, data.measurements[k], data.indicators[k])
    assert state.mode_prob.shape == (2, 50)
    assert filter_.forecast(state, 6.0).mode_prob.shape == (2, 50)
    with pytest.raises(ValueError, match="indicators: wanted, the system has an indicator"):
        filter_.run(times, data.measurements)


def test_indicators_are_refused_where_there_are_no_modes(autoregression):
    with pytest.raises(ValueError, match="indicators: wanted none, the system has no modes"):
        ParticleFilter(autoregression, 5).run([0.0], np.zeros((1, 1)), indicators=np.zeros(1, int))
