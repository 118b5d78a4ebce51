"""The bootstrap filter against exact filters, within the error of its samples."""

import warnings

import numpy as np
import pytest
import sympy as sp

from oracles.linear import Regression, histories, moments
from seedslib.filters import ParticleFilter
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap
from systems import (
    INPUTS,
    TIMES,
    U,
    continuous_numbers,
    continuous_system,
    discrete_system,
    linear_numbers,
    linear_system,
    record,
    switching_numbers,
    switching_system,
)

x, v, w = sp.symbols("x v w", real=True)
RUNS = 30


def within(parts, exact, count=4.5):
    """Independent runs, last axis, have the exact mean within so many of its standard errors."""
    error = parts.std(axis=-1, ddof=1) / np.sqrt(parts.shape[-1])
    return (np.abs(parts.mean(axis=-1) - exact) < count * error + 1e-3).all()


def unbiased(loglik, exact):
    """The estimate of a likelihood, over runs, has the exact one as its mean."""
    ratio = np.exp(loglik.sum(axis=0) - exact)
    return abs(ratio.mean() - 1) < 4 * ratio.std() / np.sqrt(len(ratio))


@pytest.mark.parametrize(("make", "means"), [(discrete_system, True), (linear_system, False)])
def test_particles_come_to_regression(make, means):
    """Of formulas and of matrices; with inputs, noise means, unequal steps and gaps."""
    model = linear_numbers(means=means)
    exact, y = Regression(model), record(model)[1]
    filter, many = ParticleFilter(make(), 3000), np.repeat(y[..., None], RUNS, axis=-1)
    estimates = filter.run(TIMES, many, inputs=INPUTS, seed=2)
    mean, cov = exact.filtered(y)
    assert within(estimates.mean, mean)
    assert within(estimates.cov, cov, count=5)
    assert unbiased(estimates.loglik, exact.loglik(y))
    assert (estimates.loglik[[2, 3]] == 0).all()  # nothing measured
    assert not estimates.diverged.any()
    few = ParticleFilter(make(), 100).run(TIMES, many, inputs=INPUTS, seed=2)
    assert 3 < few.mean.std(axis=-1).mean() / estimates.mean.std(axis=-1).mean() < 10


@pytest.mark.parametrize("drives", ["old", "new"])
def test_particles_of_modes_come_to_the_sum_over_histories(drives):
    """Step by step, with a forecast; an indicator is missing, a measurement is."""
    y, shown = record(linear_numbers())[1][[0, 4, 2, 5]], np.array([0, -1, 1, 0])
    filter = ParticleFilter(switching_system(drives), 3000)
    state, numbers = filter.initial((RUNS,), seed=5), switching_numbers()
    for k in range(4):
        dist = histories(numbers, y, shown, k, k - 1, drives)
        ahead = filter.forecast(
            state, TIMES[k], inputs={u: values[max(k - 1, 0)] for u, values in INPUTS.items()}
        )
        state = filter.predict(
            state, TIMES[k], inputs={u: values[max(k - 1, 0)] for u, values in INPUTS.items()}
        )
        assert within(ahead.mean, dist.mean)
        assert within(ahead.mode_prob, dist.mode_prob)
        assert ahead.loglik is None
        dist = histories(numbers, y, shown, k, k, drives)
        seen = np.repeat(y[k][:, None], RUNS, axis=1)
        state = filter.correct(
            state,
            seen,
            np.full(RUNS, shown[k]),
            inputs={u: values[k] for u, values in INPUTS.items()},
        )
        said = filter.report(state)
        assert within(said.mean, dist.mean)
        assert within(said.cov, dist.cov, count=5)
        assert within(said.mode_prob, dist.mode_prob)
        np.testing.assert_array_equal(said.modes, said.mode_prob.argmax(axis=0))


def test_particles_of_a_jump_diffusion_have_its_moments():
    """Nothing is measured; options go to the integration."""
    model, many = continuous_numbers(), np.full((3, 2, RUNS), np.nan)
    filter, inputs = ParticleFilter(continuous_system(), 2000, step=0.01), {U: INPUTS[U][:3]}
    estimates = filter.run(TIMES[:3], many, inputs=inputs, seed=1)
    m, P = model.mean0, model.cov0
    for k in range(3):
        if k:
            m, P = moments(model, *TIMES[k - 1 : k + 1], m, P, INPUTS[U][k - 1])
        # Euler steps of .01 are off by some thousandths
        assert (np.abs(estimates.mean[k].mean(axis=-1) - m) < 0.015).all()
        assert (np.abs(estimates.cov[k].mean(axis=-1) - P) < 0.02).all()


def test_resampling_keeps_the_expected_counts():
    """Each particle is drawn as often as its weight says, rounded down or up."""
    system = LinearSystem(1, 0.01, 1, 0.5, 0, 1)
    filter, y = ParticleFilter(system, 200), np.array([[0.3, -1.0, 2.5]])
    state = filter.predict(filter.initial((3,), seed=1), 0.0)
    later = filter.correct(state, y)
    for i in range(3):
        before, after = state.particles[0, :, i], later.particles[0, :, i]
        weight = np.exp(-((y[0, i] - before) ** 2))
        wanted = 200 * weight / weight.sum()
        counts = (after[:, None] == before).sum(axis=0)
        assert counts.sum() == 200
        assert (np.abs(counts - wanted) < 1 + 1e-9).all()
        assert later.mean[0, i] == pytest.approx(wanted @ before / 200)
        apart = before - later.mean[0, i]
        assert later.cov[0, 0, i] == pytest.approx(wanted @ apart**2 / 200)
    missing = filter.correct(state, np.full((1, 3), np.nan))
    np.testing.assert_array_equal(missing.particles, state.particles)


def test_seeds_matter_and_threads_and_verbs_do_not():
    system, y = discrete_system(), record(linear_numbers())[1]
    filter, many = ParticleFilter(system, 2000), np.repeat(y[..., None], 6, axis=-1)
    one, two, other = (
        filter.run(TIMES, many, inputs=INPUTS, seed=seed, workers=count)
        for seed, count in ((7, 1), (7, 2), (8, 1))
    )
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(one.mean, other.mean)
    folded = filter.run(TIMES, many.reshape(7, 2, 2, 3), inputs=INPUTS, seed=7)
    np.testing.assert_array_equal(folded.mean.reshape(7, 3, 6), one.mean)
    single = filter.run(TIMES, y, inputs=INPUTS, seed=7)
    assert single.mean.shape == (7, 3)
    assert single.cov.shape == (7, 3, 3)
    state, again = filter.initial((2,), seed=3), filter.initial((2,), seed=3)
    for k in range(3):
        state = filter.step(state, TIMES[k], many[k, :, :2], inputs=dict.fromkeys(INPUTS, 0.5))
        again = filter.correct(
            filter.predict(again, TIMES[k], inputs=dict.fromkeys(INPUTS, 0.5)),
            many[k, :, :2],
            inputs=dict.fromkeys(INPUTS, 0.5),
        )
    np.testing.assert_array_equal(state.mean, again.mean)
    np.testing.assert_array_equal(state.particles, again.particles)
    ahead = filter.forecast(state, TIMES[3], inputs=dict.fromkeys(INPUTS, 0.5))
    np.testing.assert_array_equal(
        ahead.mean, filter.forecast(again, TIMES[3], inputs=dict.fromkeys(INPUTS, 0.5)).mean
    )
    assert filter.initial((2,)).particles.shape == (3, 2000, 2)


@pytest.mark.parametrize("modes", [False, True])
def test_measurement_that_no_particle_explains_is_marked_for_good(modes):
    """In a run and step by step; the estimate stays a number."""
    system = switching_system() if modes else discrete_system()
    filter = ParticleFilter(system, 50)
    y = np.zeros((4, 2, 3))
    y[1, 0, 1], y[1, :, 2] = 1e200, np.nan
    options = {"indicators": np.zeros((4, 3), int)} if modes else {}
    inputs = {u: values[:4] for u, values in INPUTS.items()}
    estimates = filter.run(TIMES[:4], y, inputs=inputs, seed=0, **options)
    assert estimates.diverged.tolist() == [False, True, False]
    assert np.isneginf(estimates.loglik[1, 1])
    assert np.isfinite(estimates.mean).all()
    state = filter.initial((3,))
    for k in range(4):
        shown = (np.zeros(3, int),) if modes else ()
        state = filter.step(state, TIMES[k], y[k], *shown, inputs=dict.fromkeys(INPUTS, 0.5))
        assert filter.report(state).diverged.tolist() == [False, k > 0, False]
        assert state.diverged.tolist() == [False, k > 0, False]
    assert filter.forecast(state, TIMES[4], inputs=dict.fromkeys(INPUTS, 0.5)).diverged is None


def test_measurement_far_from_all_particles_is_warned_about():
    filter = ParticleFilter(discrete_system(), 100)
    y, inputs = np.zeros((4, 2)), {u: values[:4] for u, values in INPUTS.items()}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        filter.run(TIMES[:4], y, inputs=inputs)
    y[2, 0] = 1e4
    with pytest.warns(UserWarning, match=r"^y: .* at time 2\.7"):
        filter.run(TIMES[:4], y, inputs=inputs)


def test_estimates_of_angles_are_mean_directions():
    """Of weighted particles, from whatever turn their numbers are."""
    a, b, c = sp.symbols("a b c", real=True)
    noise = sp.symbols("v1:4", real=True)
    moved = [s + q for s, q in zip((a, b, c), noise, strict=True)]
    dynamics = StochasticMap((a, b, c), moved, Noise(noise), period={1: 7.0, 2: 5.0})
    sensor = StochasticMap((a, b, c), [a + w], Noise((w,)))
    filter = ParticleFilter(DiscreteSystem(dynamics, sensor, [0, 0, 0], np.eye(3)), 5)
    rng = np.random.default_rng(8)
    x = 0.5 * rng.standard_normal((3, 5, 50)) + np.array([0.3, 3.4, -7.2])[:, None, None]
    weight = rng.random((5, 50))
    weight /= weight.sum(axis=0)
    mean, cov, prob = filter.estimate(x, weight)
    turned = x + np.array([0.0, 7.0, -10.0])[:, None, None] * rng.integers(-2, 3, (3, 5, 50))
    again = filter.estimate(turned, weight)
    np.testing.assert_allclose(again[0], mean, atol=1e-12)
    np.testing.assert_allclose(again[1], cov, atol=1e-12)
    plain = np.einsum("ipb,pb->ib", x, weight)
    shift = np.array([[1.0], [7.0], [5.0]])
    turns = (mean - plain) / shift
    np.testing.assert_allclose(turns[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    assert (np.abs(mean[1:]) <= [[3.5], [2.5]]).all()
    apart = x - plain[:, None]
    np.testing.assert_allclose(cov, np.einsum("ipb,jpb,pb->ijb", apart, apart, weight), atol=1e-12)
    assert prob is None
