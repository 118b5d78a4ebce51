"""Smoothing against regression on all data, and published errors of a pendulum."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from oracles.linear import Linear, Regression, along, discretised, histories, kalman, moments
from seedslib.filters import (
    CovarianceFilter,
    KalmanFilter,
    KnownModeFilter,
    ParticleFilter,
    assumed_density,
    cubature_kalman,
    draw_trajectories,
    extended_kalman,
    smooth,
    unscented_kalman,
)
from seedslib.linearization import GaussHermite
from seedslib.models import DiscreteSystem, JumpDiffusion, LinearSystem, Noise, StochasticMap
from systems import (
    COV0,
    EVEN,
    INDICATORS,
    INPUTS,
    MEAN0,
    NOISE,
    NOISE_COV,
    NOISE_MEAN,
    STATE,
    STEP,
    TIMES,
    U,
    coefficients,
    continuous_numbers,
    continuous_system,
    discrete_system,
    linear_formulas,
    linear_numbers,
    linear_system,
    noises,
    pendulum,
    record,
    switching_numbers,
    switching_system,
)

DATA = Path(__file__).resolve().parents[1] / "data"
MODES = np.array([0, 2, 1, 1, 0, 2, 1])
KNOWN = {"modes": MODES, "indicators": INDICATORS}
CASES = {
    "Kalman": lambda: (KalmanFilter(linear_system()), linear_numbers(means=False)),
    "Kalman, functions, even": lambda: (
        KalmanFilter(linear_system("functions")),
        linear_numbers(EVEN, means=False),
    ),
    "extended": lambda: (extended_kalman(discrete_system()), linear_numbers()),
    "unscented": lambda: (unscented_kalman(discrete_system()), linear_numbers()),
    "known modes, old, even": lambda: (
        KnownModeFilter(switching_system(step=STEP)),
        along(switching_numbers(EVEN), MODES),
    ),
    "known modes, new, even": lambda: (
        KnownModeFilter(switching_system("new", step=STEP)),
        along(switching_numbers(EVEN), MODES, "new"),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_smoothing_equals_regression(name):
    """Fixed interval and fixed lag, in blocks; the likelihood is that of the filter."""
    filter, model = CASES[name]()
    times = EVEN if "even" in name else TIMES
    options = KNOWN if "known" in name else {}
    exact, y = Regression(model), record(model)[1]
    for lag in (None, 1, 3):
        smoothed = smooth(filter, times, y, inputs=INPUTS, lag=lag, **options)
        for k in range(7):
            mean, cov = exact.estimate(y, k, 6 if lag is None else min(k + lag, 6))
            np.testing.assert_allclose(smoothed.mean[k], mean, atol=1e-12)
            np.testing.assert_allclose(smoothed.cov[k], cov, atol=1e-12)
    run = filter.run(times, y, inputs=INPUTS, **options)
    np.testing.assert_allclose(smoothed.loglik, run.loglik, rtol=1e-13)
    assert not smoothed.diverged
    if options:
        np.testing.assert_array_equal(smoothed.modes, MODES)
        np.testing.assert_array_equal(smoothed.mode_prob, run.mode_prob)
    # records with inputs and gaps of their own, in blocks
    many = np.stack([y, np.nan_to_num(y), y - 1.0], axis=-1)
    inputs = {u: values[:, None] * [1.0, -0.5, 2.0] for u, values in INPUTS.items()}
    options = {key: np.repeat(part[:, None], 3, axis=1) for key, part in options.items()}
    whole = smooth(filter, times, many, inputs=inputs, **options)
    filter.block = lambda *_: 2
    for i, lag in ((0, None), (2, None)):
        one = {key: part[:, i] for key, part in options.items()}
        given = {u: values[:, i] for u, values in inputs.items()}
        alone = smooth(filter, times, many[..., i], inputs=given, lag=lag, **one)
        np.testing.assert_allclose(whole.mean[..., i], alone.mean, atol=1e-12)
        np.testing.assert_allclose(whole.cov[..., i], alone.cov, atol=1e-12)
    folded = smooth(
        filter,
        times,
        many.reshape(7, 2, 1, 3),
        inputs={u: values.reshape(7, 1, 3) for u, values in inputs.items()},
        **{key: part.reshape(7, 1, 3) for key, part in options.items()},
    )
    for a, b in zip(folded, whole, strict=True):
        if b is not None:
            np.testing.assert_allclose(a, b.reshape(a.shape), atol=1e-12)


def test_smoothed_covariance_common_to_all_records_is_given_once():
    filter, y = extended_kalman(discrete_system()), record(linear_numbers())[1]
    many = np.stack([y, y + 1.0], axis=-1)
    one, two = (smooth(filter, TIMES, part, inputs=INPUTS) for part in (many, y))
    assert one.cov.shape == (7, 3, 3)
    np.testing.assert_allclose(one.cov, two.cov, atol=1e-14)


@pytest.mark.parametrize("make", [extended_kalman, unscented_kalman])
def test_smoothing_between_measurements_equals_the_exact_discretisation(make):
    model = discretised(continuous_numbers(jumps=False), TIMES, INPUTS[U])
    y, filter = record(model)[1], make(continuous_system(jumps=False))
    many = np.stack([y, y + 0.5], axis=-1)
    many[4, 1, 1] = np.nan  # until then the covariance is common to both records
    smoothed = smooth(filter, TIMES, many, inputs={U: INPUTS[U]})
    for i in range(2):
        mean, cov = Regression(model).smoothed(many[..., i])
        np.testing.assert_allclose(smoothed.mean[..., i], mean, atol=1e-7)
        np.testing.assert_allclose(smoothed.cov[..., i], cov, atol=1e-7)
    one = smooth(filter, TIMES, y, inputs={U: INPUTS[U]})
    np.testing.assert_allclose(one.mean, smoothed.mean[..., 0], atol=1e-12)


def test_smoothing_with_jumps_equals_the_backward_recursion():
    """The covariance with the next state is P Fᵀ, F the slope of the mean of the next state."""
    model, push, y = continuous_numbers(), INPUTS[U], record(linear_numbers())[1]
    sensor = Linear(None, None, None, *model.sensor(TIMES, push), model.mean0, model.cov0)
    forward = kalman(sensor, y, lambda k, m, P: moments(model, *TIMES[k : k + 2], m, P, push[k]))
    F = discretised(model, TIMES, push).F
    smoothed = smooth(assumed_density(continuous_system(step=0.025)), TIMES, y, inputs={U: push})
    mean, cov = forward.mean[-1], forward.cov[-1]
    for k in range(5, -1, -1):
        gain = np.linalg.solve(forward.predicted_cov[k + 1], F[k] @ forward.cov[k]).T
        mean = forward.mean[k] + gain @ (mean - forward.predicted_mean[k + 1])
        cov = forward.cov[k] + gain @ (cov - forward.predicted_cov[k + 1]) @ gain.T
        np.testing.assert_allclose(smoothed.mean[k], mean, rtol=1e-5)
        np.testing.assert_allclose(smoothed.cov[k], cov, rtol=1e-5)


@pytest.mark.parametrize(
    ("make", "filtered", "smoothed"),
    [
        (extended_kalman, 0.16830859061153763, 0.057446202494837),
        (cubature_kalman, 0.1141966031380275, 0.04064624229594188),
        (lambda s: unscented_kalman(s, kappa=1), 0.09524392125923083, 0.036617555415464256),
        (lambda s: CovarianceFilter(s, GaussHermite(5)), 0.0998062421916222, 0.03710181978632009),
    ],
)
def test_published_errors_of_the_pendulum(make, filtered, smoothed):
    """Of Särkkä and Svensson, to all their digits."""
    data = json.loads((DATA / "pendulum.json").read_text())
    dt, g = 0.01, 9.81
    x1, x2, q1, q2, r = sp.symbols("x1 x2 q1 q2 r")
    noise = Noise((q1, q2), cov=0.01 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
    move = StochasticMap((x1, x2), [x1 + dt * x2 + q1, x2 - g * dt * sp.sin(x1) + q2], noise)
    see = StochasticMap((x1, x2), [sp.sin(x1) + r], Noise((r,), cov=[[0.1]]))
    filter = make(DiscreteSystem(move, see, [0, 0], np.eye(2)))
    times, y = np.arange(501.0), np.concatenate([[np.nan], data["Y"]])[:, None]
    for part, wanted in ((filter.run(times, y), filtered), (smooth(filter, times, y), smoothed)):
        error = np.sqrt(np.mean((part.mean[1:, 0] - np.array(data["X"])[0]) ** 2))
        assert error == pytest.approx(wanted, rel=1e-11)


@pytest.mark.parametrize(
    ("make", "system"), [(extended_kalman, discrete_system), (KalmanFilter, linear_system)]
)
def test_record_beyond_the_bound_has_diverged_when_smoothed(make, system):
    y = record(linear_numbers())[1]
    many = np.stack([y, y + 3.0, y - 3.0, 2 * y], axis=-1)
    run = make(system()).run(TIMES, many, inputs=INPUTS)
    largest = np.abs(run.mean).max(axis=(0, 1))
    filter = make(system(), bound=np.sort(largest)[1:3].mean())
    smoothed = smooth(filter, TIMES, many, inputs=INPUTS)
    np.testing.assert_array_equal(smoothed.diverged, largest > filter.bound)
    assert smoothed.diverged.sum() == 2


# Particles: trajectories drawn backwards

RUNS = 20


def within(parts, exact, count=4.5):
    """Independent runs, last axis, have the exact mean within so many of its standard errors."""
    error = parts.std(axis=-1, ddof=1) / np.sqrt(parts.shape[-1])
    return (np.abs(parts.mean(axis=-1) - exact) < count * error + 2e-3).all()


def even_noise():
    """The reference system with noise that does not depend on the length of the step."""
    move, show = linear_formulas()
    fixed = linear_formulas(step=STEP)[0]
    zero = dict.fromkeys(NOISE, 0)
    move = [a.xreplace(zero) + b - b.xreplace(zero) for a, b in zip(move, fixed, strict=True)]
    noise, sensor_noise = noises()
    sensor = StochasticMap(STATE, show, sensor_noise)
    system = DiscreteSystem(StochasticMap(STATE, move, noise), sensor, MEAN0, COV0)
    model = linear_numbers()
    root = np.array([coefficients(now).G for now in TIMES[:-1]])
    b = linear_numbers(means=False).b + root @ NOISE_MEAN
    return system, model._replace(b=b, Q=root @ NOISE_COV @ root.swapaxes(1, 2))


@pytest.mark.parametrize("lag", [None, 1])
def test_smoothed_particles_come_to_regression(lag):
    """With inputs, unequal steps and gaps; inputs of another time would be far off."""
    system, model = even_noise()
    exact, y = Regression(model), record(model)[1]
    filter, many = ParticleFilter(system, 300), np.repeat(y[..., None], RUNS, axis=-1)
    options = {"inputs": INPUTS, "seed": 3}
    smoothed = smooth(filter, TIMES, many, trajectories=60, lag=lag, **options)
    laws = [exact.estimate(y, k, 6 if lag is None else min(k + lag, 6)) for k in range(7)]
    means, covs = map(np.array, zip(*laws, strict=True))
    assert within(smoothed.mean, means, count=5.5)
    assert within(smoothed.cov, covs * 59 / 60, count=6)
    plain = filter.run(TIMES, many, **options)
    np.testing.assert_array_equal(smoothed.loglik, plain.loglik)
    assert not within(plain.mean[:3], means[:3])
    if lag is not None:
        return
    drawn = draw_trajectories(filter, TIMES, many, 60, **options)
    np.testing.assert_allclose(drawn.mean(axis=2), smoothed.mean, atol=1e-12)
    apart = drawn - drawn.mean(axis=2, keepdims=True)
    across = np.einsum("kitb,kjtb->kijb", apart[:-1], apart[1:]) / 59
    pairs = np.array([exact.pair(y, k, 6)[1][:3, 3:] for k in range(6)])
    assert within(across, pairs, count=6)


@pytest.mark.parametrize("drives", ["old", "new"])
def test_smoothed_particles_of_modes_come_to_the_sum_over_histories(drives):
    y, rows = record(linear_numbers())[1], [0, 4, 2, 5]
    y, shown, times = y[rows], np.array([0, -1, 1, 0]), EVEN[:4]
    inputs = {u: values[:4] for u, values in INPUTS.items()}
    filter = ParticleFilter(switching_system(drives, step=STEP), 200)
    many, indicators = np.repeat(y[..., None], RUNS, axis=-1), np.repeat(shown[:, None], RUNS, 1)
    given = {"indicators": indicators, "inputs": inputs, "trajectories": 50, "seed": 4}
    smoothed = smooth(filter, times, many, **given)
    for k in range(4):
        law = histories(switching_numbers(EVEN), y, shown, k, 3, drives)
        assert within(smoothed.mode_prob[k], law.mode_prob, count=5)
        assert within(smoothed.mean[k], law.mean, count=5)
    drawn = draw_trajectories(filter, times, many, **given)
    np.testing.assert_allclose((drawn[:, 3] == 2).mean(axis=1), smoothed.mode_prob[:, 2])
    np.testing.assert_array_equal(smoothed.modes, smoothed.mode_prob.argmax(axis=1))


def test_trajectories_do_not_depend_on_their_number_and_have_the_shape_of_the_records():
    y = record(linear_numbers())[1]
    filter, many = ParticleFilter(even_noise()[0], 30), np.repeat(y[..., None], 6, axis=-1)
    draw = partial(draw_trajectories, filter, TIMES, inputs=INPUTS)
    nine, four = draw(many, 9, 2), draw(many, 4, 2)
    assert nine.shape == (7, 3, 9, 6)
    np.testing.assert_array_equal(nine[:, :, :4], four)
    assert not np.array_equal(four, draw(many, 4, 3))
    assert draw(y, 5, 2).shape == (7, 3, 5)
    assert draw(many.reshape(7, 2, 2, 3), 5, 2).shape == (7, 3, 5, 2, 3)
    filter.block = lambda *_: 4
    parts = draw(many, 4, 2)
    assert parts.shape == four.shape
    assert np.isfinite(parts).all()
    smoothed = smooth(filter, TIMES, y, trajectories=5, seed=2, inputs=INPUTS)
    assert smoothed.mean.shape == (7, 3)
    assert smoothed.cov.shape == (7, 3, 3)


def test_particles_without_a_density_of_moves_are_not_smoothed():
    x, v, w = sp.symbols("x v w")
    see = StochasticMap((x,), [x + w], Noise((w,)))
    bent = StochasticMap((x,), [x + v**2], Noise((v,)))
    for system in (
        JumpDiffusion((x,), [-x], [[1]], [x + w], Noise((w,)), [0], [[1]]),
        DiscreteSystem(bent, see, [0], [[1]]),
        pendulum(),
        LinearSystem(np.eye(2), np.diag([1, 0]), [[1, 0]], 1, [0, 0], np.eye(2)),
    ):
        with pytest.raises(ValueError, match=r"^filter: "):
            smooth(ParticleFilter(system, 10), [0, 1], np.zeros((2, 1)))
