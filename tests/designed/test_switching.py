"""Filters of switching systems: limits that are known, designs, and what they refuse."""

import warnings

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base import correct
from seedslib.design import stationary, synthesize
from seedslib.design.cells import cells_from_moments
from seedslib.designed import Memory, SwitchingFilter, large_order
from seedslib.designed.switching.fits import CellFit
from seedslib.linearization import ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import Noise, SwitchingSystem

X1, X2, V, W = sympy.symbols("x1 x2 v w", real=True)


def one_mode():
    """Linear system of one mode: the ordinary discrete-time problem."""
    return SwitchingSystem(
        state=(X1, X2),
        dynamics=[[X1 + X2 + V / 2, 0.9 * X2 + V + 0.3]],
        noise=Noise((V,), cov=[[0.3]]),
        switching=[[1]],
        sensor=[[X1 + W]],
        sensor_noise=Noise((W,), cov=[[2.0]]),
        initial=[(1.0, [1.0, -0.5], [[4, 0.5], [0.5, 1]])],
    )


def kalman(y, modes=None):
    """Textbook Kalman filter of the one-mode system, (K+1, 2, N) and (K+1, 2, 2)."""
    f, g = np.array([[1, 1], [0, 0.9]]), np.array([[0.5], [1.0]])
    h, mean, cov = np.array([[1.0, 0.0]]), np.array([[1.0], [-0.5]]), np.array([[4, 0.5], [0.5, 1]])
    means, covs = [], []
    for k, shown in enumerate(y):
        if k:
            mean, cov = f @ mean + np.array([[0], [0.3]]), f @ cov @ f.T + 0.3 * g @ g.T
        s = h @ cov @ h.T + 2.0
        gain = cov @ h.T / s
        mean, cov = mean + gain @ (shown - h @ mean), cov - gain @ h @ cov
        means.append(mean)
        covs.append(cov)
    return np.array(means), np.array(covs)


@pytest.mark.parametrize("linearization", [Taylor(), ExactGaussian(), Unscented(), GaussHermite(3)])
def test_one_mode_linear_gaussian_is_the_kalman_filter(linearization):
    system = one_mode()
    data = system.simulate(np.arange(16.0), 50, 3)
    found = SwitchingFilter(system, linearization).run(
        data.times, data.measurements, covariances=True
    )
    mean, cov = kalman(data.measurements)
    np.testing.assert_allclose(found.mean, mean, atol=1e-12 * np.abs(mean).max())
    np.testing.assert_allclose(
        found.cov, np.broadcast_to(cov[..., None], found.cov.shape), atol=1e-12
    )
    assert (found.modes == 0).all()


def test_designs_of_one_mode_come_to_the_kalman_filter_with_the_root_of_the_paths():
    system, times = one_mode(), np.arange(16.0)
    data = system.simulate(times, 2000, 3)
    mean, _ = kalman(data.measurements)

    def distance(paths, memory):
        apart = [
            synthesize(system, memory, ExactGaussian(), times, paths=paths, seed=seed)
            .run(times, data.measurements).mean[8:] - mean[8:]
            for seed in (1, 2, 3)
        ]  # fmt: skip
        return np.sqrt(np.mean(np.square(apart)))

    for memory in (large_order(1), large_order(2)):
        few, many = distance(600, memory), distance(16_000, memory)
        assert 2.5 < few / many < 10.0  # the root of 27, within the noise of three designs
        assert many < 0.04


def known_modes(switch=((0.9, 0.1), (0.3, 0.7))):
    """Modes are shown exactly, and only the inputs depend on them."""
    return SwitchingSystem(
        state=(X1, X2),
        dynamics=[[X1 + X2 + V / 2, 0.9 * X2 + V + drive] for drive in (0.0, 1.0)],
        noise=Noise((V,), cov=[[0.3]]),
        switching=switch,
        sensor=[[X1 + W]] * 2,
        sensor_noise=Noise((W,), cov=[[2.0]]),
        initial=[(0.5, [1.0, -0.5], [[4, 0.5], [0.5, 1]])] * 2,
        indicator=[[1, 0], [0, 1]],
    )


def mode_conditioned_kalman(data):
    f, g = np.array([[1, 1], [0, 0.9]]), np.array([0.5, 1.0])
    cov, mean = np.array([[4, 0.5], [0.5, 1.0]]), np.array([[1.0], [-0.5]])
    means, covs = [], []
    for k, shown in enumerate(data.measurements):
        if k:
            mean, cov = f @ mean, f @ cov @ f.T + 0.3 * np.outer(g, g)
            mean = mean + np.array([[0.0], [1.0]]) * data.modes[k - 1]
        gain = cov[:, :1] / (cov[0, 0] + 2.0)
        mean, cov = mean + gain * (shown - mean[:1]), cov - gain @ cov[:1]
        means.append(mean)
        covs.append(cov)
    return np.array(means), np.array(covs)


def test_known_modes_and_common_covariances_give_the_kalman_filter():
    """FBP(1) with exact parameters: the error does not depend on the mode path."""
    system = known_modes()
    data = system.simulate(np.arange(13.0), 40, 5)
    mean, covs = mode_conditioned_kalman(data)
    fits = []
    for cov in covs[:-1]:
        # state and estimate given the mode: gain one, error covariance P; the decided mode is right
        log_weight = np.array([[0.0, -np.inf], [-np.inf, 0.0]])
        both, eye = np.ones((1, 1, 2, 2)), np.eye(2)[:, :, None, None]
        fits.append(
            CellFit(
                log_weight,
                np.zeros((2, 2, 2)),
                np.zeros((2, 2, 2, 2)),
                eye * both,
                np.zeros((2, 2, 2)),
                cov[:, :, None, None] * both,
            )
        )
    designed = SwitchingFilter(system, ExactGaussian(), large_order(1), times=data.times, fits=fits)
    for filter in (designed, SwitchingFilter(system, ExactGaussian())):
        found = filter.run(data.times, data.measurements, indicators=data.indicators)
        np.testing.assert_array_equal(found.modes, data.modes)
        np.testing.assert_allclose(found.mean, mean, atol=1e-12 * np.abs(mean).max())


def test_sampled_fit_is_the_injected_one():
    """Moments given as numbers make the same forecasts as samples with those moments."""
    rng = np.random.default_rng(3)
    root = rng.standard_normal((3, 3, 2, 4))
    cov = np.einsum("ikLC,jkLC->ijLC", root, root)
    mean, prob = rng.standard_normal((3, 2, 4)), rng.dirichlet(np.ones(8)).reshape(2, 4)
    fit = cells_from_moments(prob, mean, cov, 1, jitter=0.0)
    cell, z = rng.integers(0, 4, 30), rng.standard_normal((2, 30))
    law = fit.forecast(cell, z)
    for k in range(30):
        score = []
        for i in range(2):
            m, d = mean[:, i, cell[k]], cov[:, :, i, cell[k]]
            gain = np.linalg.solve(d[1:, 1:], d[1:, :1]).T
            apart = z[:, k] - m[1:]
            score.append(
                np.log(prob[i, cell[k]]) - 0.5 * np.linalg.slogdet(d[1:, 1:])[1]
                - 0.5 * apart @ np.linalg.solve(d[1:, 1:], apart)
            )  # fmt: skip
            np.testing.assert_allclose(law.mean[:, i, k], m[:1] + gain @ apart, rtol=1e-9)
            np.testing.assert_allclose(
                law.cov[:, :, i, k], d[:1, :1] - gain @ d[1:, :1], rtol=1e-8, atol=1e-12
            )
        weight = np.exp(score - np.max(score))
        np.testing.assert_allclose(law.prob[:, k], weight / weight.sum(), rtol=1e-8)


def test_first_step_is_the_exact_bayes_rule_of_a_linear_sensor():
    system = zoo.scalar_switching("A1H")
    y = np.linspace(-6, 8, 9)[None]
    filter = SwitchingFilter(system, ExactGaussian())
    state = filter.step(filter.initial((9,)), 0.0, y)
    x = np.linspace(-12, 12, 4001)
    law = np.exp(-(x**2) / 2)[None, :, None]
    shown = np.array([0.0, 2.0])[:, None, None] + x[None, :, None]
    joint = law * np.exp(-((y[0] - shown) ** 2) / 8)
    mass = joint.sum(axis=1)
    np.testing.assert_allclose(state.law.prob, mass / mass.sum(axis=0), rtol=1e-10)
    mean = (joint * x[None, :, None]).sum(axis=(0, 1)) / mass.sum(axis=0)
    np.testing.assert_allclose(state.mean[0], mean, atol=1e-10)


def test_orders_agree_until_the_memory_is_full():
    system, times = zoo.scalar_switching("A1H"), np.arange(5.0)
    data = system.simulate(times, 300, 6)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = [
            synthesize(system, large_order(l), ExactGaussian(), times, paths=3000, seed=1)
            .run(times, data.measurements)
            for l in (1, 2, 3)
        ]  # fmt: skip
    np.testing.assert_array_equal(found[0].mean[:2], found[1].mean[:2])
    assert np.abs(found[0].mean[2] - found[1].mean[2]).max() > 1e-3
    np.testing.assert_array_equal(found[1].mean[:3], found[2].mean[:3])
    assert np.abs(found[1].mean[3] - found[2].mean[3]).max() > 1e-3


@pytest.mark.filterwarnings("ignore:paths:UserWarning")
def test_design_does_not_depend_on_threads():
    system, times = zoo.manoeuvring_target("noisy"), np.arange(6.0)
    one, two = (
        synthesize(
            system,
            Memory(1, 1, 1, True),
            ExactGaussian(),
            times,
            paths=20_000,
            seed=2,
            workers=workers,
        )
        for workers in (1, 2)
    )
    for a, b in zip(one.fits, two.fits, strict=True):
        for p, q in zip(a, b, strict=True):
            np.testing.assert_array_equal(p, q)


@pytest.mark.filterwarnings("ignore:paths:UserWarning")
def test_run_is_the_same_as_steps_for_single_paths_and_batches():
    system, times = zoo.manoeuvring_target("noisy"), np.arange(6.0)
    data = system.simulate(times, 6, 3)
    filter = synthesize(system, large_order(2), ExactGaussian(), times, paths=4000, seed=1)
    whole = filter.run(times, data.measurements, indicators=data.indicators, covariances=True)
    boxed = filter.run(
        times, data.measurements.reshape(6, 1, 2, 3), indicators=data.indicators.reshape(6, 2, 3)
    )
    np.testing.assert_array_equal(boxed.mean.reshape(6, 2, 6), whole.mean)
    for p in range(6):
        state = filter.initial()
        for k, t in enumerate(times):
            state = filter.step(state, t, data.measurements[k, :, p], data.indicators[k, p])
            np.testing.assert_allclose(state.mean, whole.mean[k, :, p], rtol=1e-12)
            np.testing.assert_allclose(state.loglik, whole.loglik[k, p], rtol=1e-12)
            assert state.mode == whole.modes[k, p]


def test_missing_measurements_and_indicators_are_left_out():
    """No measurement and no indicator leave the forecast; the likelihood of nothing is one."""
    system, times = zoo.manoeuvring_target("noisy"), np.arange(4.0)
    data = system.simulate(times, 5, 3)
    filter = SwitchingFilter(system, ExactGaussian())
    state = filter.step(filter.initial((5,)), 0.0, data.measurements[0], data.indicators[0])
    forecast = filter.predict(state, 1.0)
    after = filter.correct(forecast, np.full((1, 5), np.nan), np.full(5, -1))
    np.testing.assert_allclose(after.law.prob, forecast.law.prob[:, 0], rtol=1e-12)
    np.testing.assert_allclose(after.law.mean, forecast.law.mean[:, :, 0], rtol=1e-12)
    np.testing.assert_allclose(after.loglik, 0.0, atol=1e-12)
    # some paths only
    seen = data.indicators[1].copy()
    seen[2] = -1
    mixed = filter.correct(forecast, data.measurements[1], seen)
    full = filter.correct(forecast, data.measurements[1], data.indicators[1])
    np.testing.assert_array_equal(np.delete(mixed.mean, 2, 1), np.delete(full.mean, 2, 1))
    # given no indicator, modes are weighed by the measurement alone
    blind = filter.correct(forecast, data.measurements[1], np.full(5, -1))
    np.testing.assert_allclose(mixed.mean[:, 2], blind.mean[:, 2], rtol=1e-12)


def test_likelihood_sums_to_one_over_the_indicator():
    system = zoo.manoeuvring_target("noisy")
    filter = SwitchingFilter(system, ExactGaussian())
    y = np.array([[0.7]])
    state = filter.predict(filter.initial((1,)), 0.0)
    alone = filter.correct(state, y, np.array([-1])).loglik
    both = [filter.correct(state, y, np.array([j])).loglik for j in (0, 1)]
    np.testing.assert_allclose(np.logaddexp(*both), alone, rtol=1e-12)


def test_sum_of_log_likelihoods_is_right_for_one_mode():
    system = one_mode()
    data = system.simulate(np.arange(6.0), 3, 4)
    found = SwitchingFilter(system, Taylor()).run(data.times, data.measurements)
    for p in range(3):
        mean, cov = np.array([1.0, -0.5]), np.array([[4, 0.5], [0.5, 1]])
        for k in range(6):
            if k:
                f, g = np.array([[1, 1], [0, 0.9]]), np.array([0.5, 1.0])
                mean, cov = f @ mean + [0, 0.3], f @ cov @ f.T + 0.3 * np.outer(g, g)
            moments = (mean[:1], cov[:, :1], cov[:1, :1] + 2.0)
            mean, cov, loglik = correct(mean, cov, data.measurements[k, :, p], moments)
            assert found.loglik[k, p] == pytest.approx(float(loglik), rel=1e-12)


def test_positions_far_from_the_origin_lose_no_digits():
    system = zoo.manoeuvring_target("noisy")
    near = system.simulate(np.arange(8.0), 50, 9)
    filter = SwitchingFilter(system, ExactGaussian())
    state = filter.initial((50,))
    far = state._replace(
        law=state.law._replace(mean=state.law.mean + np.array([1e7, 0])[:, None, None, None])
    )
    for k in range(8):
        state = filter.step(state, float(k), near.measurements[k], near.indicators[k])
        far = filter.step(far, float(k), near.measurements[k] + 1e7, near.indicators[k])
    np.testing.assert_allclose(far.mean[0] - 1e7, state.mean[0], atol=1e-6)
    np.testing.assert_allclose(far.law.cov, state.law.cov, rtol=1e-6)


def test_thin_cells_are_counted_and_unmet_cells_work():
    system, times = zoo.manoeuvring_target("noisy"), np.arange(4.0)
    with pytest.warns(UserWarning, match="pairs of cell and mode"):
        designed = synthesize(system, large_order(2), ExactGaussian(), times, paths=60, seed=1)
    assert 0 < designed.design.thin <= designed.design.pairs
    state = designed.initial((4,))
    y = np.array([[500.0, -500.0, 0.0, 3.0]])
    for k in range(4):
        state = designed.step(state, float(k), y, np.array([0, 1, 1, 0]))
        assert np.isfinite(state.mean).all()
        assert np.isfinite(state.law.prob).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s, t: synthesize(s, None, ExactGaussian(), t, paths=100, seed=1), "memory: wanted"),
        (lambda s, t: synthesize(s, large_order(1), "taylor", t, paths=9, seed=1), "linearization"),
        (lambda s, t: synthesize(s, large_order(3), Taylor(), t, paths=7, seed=1), "paths: wanted"),
        (lambda s, t: synthesize(s, large_order(1), Taylor(), [1, 0], paths=99, seed=1), "times"),
        (lambda s, t: SwitchingFilter(s, Taylor(), normalisation="other"), "normalisation"),
        (lambda s, t: SwitchingFilter(s, Taylor(), large_order(1)), "times: wanted"),
        (lambda s, t: SwitchingFilter(s, Taylor(), large_order(1), times=t), "fits: wanted 2"),
        (
            lambda s, t: SwitchingFilter(
                zoo.scalar_switching(), Taylor(), Memory(1, indicators=1), times=t, fits=[1, 2]
            ),
            "memory: wanted no indicators",
        ),
    ],
)  # fmt: skip
def test_bad_arguments_are_refused_by_name(call, message):
    with pytest.raises((ValueError, TypeError), match=message):
        call(zoo.manoeuvring_target(), np.arange(3.0))


@pytest.fixture(scope="module")
def short_target():
    """A designed filter of the target for three instants."""
    return synthesize(
        zoo.manoeuvring_target(),
        large_order(1),
        ExactGaussian(),
        np.arange(3.0),
        paths=4000,
        seed=1,
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"indicators": None}, "indicators: wanted, the system has"),
        ({"indicators": np.full((3, 4), 2)}, "indicators: wanted 0 to 1"),
        ({"indicators": np.zeros((3, 4))}, "indicators: wanted whole numbers"),
        ({"indicators": np.zeros((3, 5), dtype=int)}, "indicators: wanted shape"),
        ({"measurements": np.full((3, 1, 4), np.inf)}, "measurements: wanted finite"),
        ({"measurements": np.zeros((3, 2, 4))}, "measurements: wanted shape"),
        ({"times": [0.0, 2.0, 1.0]}, "times: wanted strictly increasing"),
        ({"times": [0.0, 1.0, 3.0]}, "t: wanted the next measurement time 2, got 3"),
    ],
)
def test_bad_records_are_refused_by_name(short_target, changes, message):
    given = {
        "times": np.arange(3.0),
        "measurements": np.zeros((3, 1, 4)),
        "indicators": np.zeros((3, 4), dtype=int),
    }
    given.update(changes)
    with pytest.raises((ValueError, TypeError), match=message):
        short_target.run(**given)


def test_a_design_that_has_settled_serves_later_steps():
    system = zoo.scalar_switching("A1H")
    short = synthesize(
        system, large_order(1), ExactGaussian(), np.arange(4.0), paths=20_000, seed=1
    )
    data = system.simulate(np.arange(30.0), 2000, 8)
    with pytest.raises(ValueError, match="at most the last measurement time"):
        short.run(data.times, data.measurements)
    long = synthesize(
        system, large_order(1), ExactGaussian(), np.arange(16.0), paths=40_000, seed=1
    )
    lasting = stationary(long, 0.1)
    assert "the last step serves all" in str(lasting)
    full = synthesize(system, large_order(1), ExactGaussian(), data.times, paths=40_000, seed=1)
    a, b = (f.run(data.times, data.measurements).mean[-1] for f in (lasting, full))
    truth = data.states[-1]
    apart = (a - truth) ** 2 - (b - truth) ** 2
    assert abs(apart.mean()) < 4 * apart.std() / 2000**0.5 + 0.01


def test_fits_of_another_memory_are_refused():
    system, times = zoo.manoeuvring_target("noisy"), np.arange(3.0)
    made = synthesize(system, large_order(1), ExactGaussian(), times, paths=4000, seed=1)
    with pytest.raises(
        ValueError, match=r"fits\[1\]\.gain: wanted shape \(2, 4, 2, 4\), got \(2, 2, 2, 2\)"
    ):
        SwitchingFilter(system, ExactGaussian(), large_order(2), times=times, fits=made.fits)


def test_summary_says_what_was_mended():
    system = zoo.scalar_switching("A1H")
    made = synthesize(system, large_order(1), ExactGaussian(), np.arange(3.0), paths=4000, seed=1)
    text = str(made)
    assert "order        2" in text
    assert "thin pairs" in text
    assert "modes 0." in text
    assert made.predicted.rms.shape == (3, 1)


def test_predicted_errors_are_those_on_other_paths():
    system, times = zoo.scalar_switching("A1H"), np.arange(8.0)
    made = synthesize(system, large_order(1), ExactGaussian(), times, paths=20_000, seed=1)
    data = system.simulate(times, 20_000, 2)
    found = made.run(times, data.measurements)
    square = (found.mean - data.states)[:, 0] ** 2
    rms, error = np.sqrt(square.mean(axis=1)), square.std(axis=1) / 2 / 20_000**0.5
    error = np.hypot(error / np.sqrt(square.mean(axis=1)), made.predicted.error[:, 0])
    assert (np.abs(rms - made.predicted.rms[:, 0]) < 4 * error).all()
    wrong = (found.modes != data.modes).mean(axis=1)
    assert (np.abs(wrong - made.predicted.mode_rate) < 6 * made.predicted.mode_error).all()


def test_forecast_is_the_law_of_the_next_state():
    """Against draws of the next state from the filter's own law."""
    system = zoo.scalar_switching("A1H")
    filter = SwitchingFilter(system, ExactGaussian())
    state = filter.step(filter.initial(), 0.0, np.array([1.3]))
    found = filter.forecast(state, 1.0)
    rng, count = np.random.default_rng(3), 200_000
    mode = (rng.random(count) > state.law.prob[0]).astype(float)
    spread = np.sqrt(state.law.cov[0, 0, mode.astype(int)])
    x = state.law.mean[0, mode.astype(int)] + spread * rng.standard_normal(count)
    moved = system.hybrid.advance(np.stack([x, mode]), 0.0, 1.0, rng)
    assert abs(moved[0].mean() - found.mean[0]) < 4 * moved[0].std() / count**0.5
    assert moved[0].var() == pytest.approx(found.cov[0, 0], rel=0.02)
    assert abs(moved[1].mean() - found.mode_prob[1]) < 4 * 0.5 / count**0.5


def test_impossible_indicator_says_nothing_and_has_no_likelihood():
    system = known_modes(switch=((1, 0), (0, 1)))
    filter = SwitchingFilter(system, ExactGaussian())
    y = np.array([[0.3, 0.3]])
    state = filter.step(filter.initial((2,)), 0.0, y, np.array([0, 0]))
    found = filter.step(state, 1.0, y, np.array([0, 1]))  # mode 1 cannot follow mode 0
    np.testing.assert_array_equal(found.mode, [0, 0])
    assert np.isneginf(found.loglik[1])
    np.testing.assert_allclose(found.mean[:, 1], found.mean[:, 0], rtol=1e-12)


def test_soft_memory_remembers_the_log_odds_within_bounds():
    system, times = zoo.manoeuvring_target("noisy"), np.arange(4.0)
    filter = synthesize(
        system, Memory(1, log_odds=True), ExactGaussian(), times, paths=20_000, seed=1
    )
    assert filter.order == 4
    state = filter.initial((3,))
    for k, y in enumerate([0.0, 1.0, [500.0, 0.0, 3.0]]):
        state = filter.step(state, float(k), np.broadcast_to(y, (1, 3)), np.array([1, 0, 0]))
    odds = np.log(state.law.prob[1] / np.maximum(state.law.prob[0], 1e-300))
    np.testing.assert_allclose(state.past.vector[2], np.clip(odds, -8, 8), atol=1e-9)
    np.testing.assert_array_equal(state.past.vector[:2], state.mean)


def test_finite_memory_forgets_what_is_older():
    """Two records that agree on the last measurements and indicators end in the same estimate."""
    system, times = zoo.manoeuvring_target("noisy"), np.arange(7.0)
    filter = synthesize(
        system, Memory(0, 2, indicators=2), ExactGaussian(), times, paths=20_000, seed=1
    )
    data = system.simulate(times, 2, 4)
    y, seen = data.measurements.copy(), data.indicators.copy()
    y[-3:, :, 1], seen[-3:, 1] = y[-3:, :, 0], seen[-3:, 0]
    found = filter.run(times, y, indicators=seen)
    assert np.abs(found.mean[-2, :, 0] - found.mean[-2, :, 1]).max() > 1e-6
    np.testing.assert_allclose(found.mean[-1, :, 0], found.mean[-1, :, 1], rtol=1e-12)
