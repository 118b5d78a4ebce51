"""Drawn histories of modes against all of them; exactness and inputs are in test_filter.py."""

import numpy as np
import pytest
import sympy

from oracles.linear import Linear, Switching, histories
from seedslib.base import assigned
from seedslib.filters import KnownModeFilter, RaoBlackwellFilter
from seedslib.models import Noise, SwitchingSystem
from seedslib.zoo import manoeuvring_target
from systems import INPUTS, TIMES, linear_numbers, record, switching_numbers, switching_system

x, v, w = sympy.symbols("x v w", real=True)
SHORT = [0, 4, 2, 5]
SHOWN = np.array([0, -1, 1, 0])


@pytest.mark.parametrize("drives", ["old", "new"])
def test_likelihood_of_drawn_histories_is_unbiased(drives):
    """Over 1500 runs of 5 histories, for each of two courses of the inputs; so are the means."""
    y = record(linear_numbers())[1][SHORT]
    factors = np.repeat([1.0, -0.5], 1500)
    inputs = {u: values[:4, None] * factors for u, values in INPUTS.items()}
    filter = RaoBlackwellFilter(switching_system(drives), 5)
    many, shown = np.repeat(y[..., None], 3000, axis=-1), np.repeat(SHOWN[:, None], 3000, axis=1)
    estimates = filter.run(TIMES[:4], many, indicators=shown, inputs=inputs, seed=3)
    for part, factor in ((slice(0, 1500), 1.0), (slice(1500, 3000), -0.5)):
        given = {u: values * factor for u, values in INPUTS.items()}
        law = histories(switching_numbers(TIMES, given), y, SHOWN, 3, 3, drives)
        ratio = np.exp(estimates.loglik[:, part].sum(axis=0) - law.loglik)
        assert ratio.std() > 0.01
        assert abs(ratio.mean() - 1) < 4 * ratio.std() / np.sqrt(1500)
        weights = ratio / ratio.sum()
        error = 5 * np.sqrt((weights**2).sum()) * estimates.mean[3, :, part].std(axis=-1)
        assert (np.abs(estimates.mean[3, :, part] @ weights - law.mean) < error).all()
        assert (np.abs(estimates.mode_prob[3, :, part] @ weights - law.mode_prob) < 0.05).all()
    assert estimates.mode_prob.sum(axis=1) == pytest.approx(1.0)
    assert not estimates.diverged.any()


def test_more_histories_come_closer():
    system, times = manoeuvring_target("none"), np.arange(9.0)
    data = system.simulate(times, 60, 5)
    exact = RaoBlackwellFilter(system, 256).run(times, data.measurements, seed=1)
    distance = []
    for count in (4, 64):
        estimates = RaoBlackwellFilter(system, count).run(times, data.measurements, seed=2)
        distance.append(np.sqrt(((estimates.mode_prob - exact.mode_prob)[5:] ** 2).mean()))
    assert distance[1] < 0.03
    assert distance[0] > 3 * distance[1]


def test_exact_indicator_gives_the_filter_with_known_modes():
    """Also of a mode without probability, in which nothing is known."""
    system, times = manoeuvring_target("exact"), np.arange(12.0)
    data = system.simulate(times, 40, 6)
    given = {"indicators": data.indicators}
    estimates = RaoBlackwellFilter(system, 3).run(times, data.measurements, seed=1, **given)
    known = KnownModeFilter(system).run(times, data.measurements, modes=data.modes, **given)
    np.testing.assert_allclose(estimates.mean, known.mean, atol=1e-9)
    np.testing.assert_allclose(estimates.cov, known.cov, atol=1e-9)
    np.testing.assert_array_equal(estimates.modes, data.modes)


def test_threads_and_streams_of_drawn_histories():
    system, y = switching_system(), record(linear_numbers())[1]
    filter, many = RaoBlackwellFilter(system, 100), np.repeat(y[..., None], 20, axis=-1)
    filter.block = lambda *_: 7
    shown = np.zeros((7, 20), int)
    one, two, other = (
        filter.run(TIMES, many, indicators=shown, inputs=INPUTS, seed=seed, workers=count)
        for seed, count in ((7, 1), (7, 2), (8, 1))
    )
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(one.mean, other.mean)
    few = RaoBlackwellFilter(system, 4)
    state = few.initial((20,), seed=7)
    with assigned(dict.fromkeys(INPUTS, 0.5)):
        for k, now in enumerate(TIMES):
            ahead = few.forecast(state, now)
            state = few.step(state, now, many[k], shown[k])
            assert ahead.mode_prob.sum(axis=0) == pytest.approx(1.0)
        later = (few.step(state, 5.0, many[1], shown[1]) for _ in range(2))
        np.testing.assert_array_equal(*(each.mean for each in later))


def test_indicator_that_no_mode_shows_is_marked_for_good():
    """In a run and step by step; the estimate stays a number."""
    system = SwitchingSystem(
        (x,), [[x / 2 + v]] * 2, Noise((v,)), [[1, 0], [0, 1]], [[x + w]] * 2, Noise((w,)),
        [(1, [0], [[1]]), (0, [0], [[1]])], indicator=[[1, 0], [0.5, 0.5]],
    )  # fmt: skip
    filter, y = RaoBlackwellFilter(system, 5), np.ones((3, 1, 2))
    shown = np.array([[0, 0], [0, 1], [-1, 0]])
    estimates = filter.run(range(3), y, indicators=shown)
    assert estimates.diverged.tolist() == [False, True]
    assert np.isneginf(estimates.loglik[1, 1])
    assert np.isfinite(estimates.mean).all()
    state = filter.initial((2,))
    for k in range(3):
        state = filter.step(state, k, y[k], shown[k])
        assert filter.report(state).diverged.tolist() == [False, k > 0]
        np.testing.assert_allclose(state.mean, estimates.mean[k])


def test_log_odds_of_histories_may_be_of_any_size():
    """Eight histories of three steps are all kept; their weights differ by e to the 1400."""
    system = SwitchingSystem(
        (x,), [[v]] * 2, Noise((v,), cov=[[1e-6]]), [[0.5, 0.5]] * 2, [[x + w], [40 + x + w]],
        Noise((w,)), [(0.5, [0], [[1e-6]])] * 2,
    )  # fmt: skip
    filter = RaoBlackwellFilter(system, 100)
    state = filter.initial()
    for k in range(3):
        state = filter.step(state, float(k), [0.0])
    total = np.logaddexp.reduce(state.log_prob[1], axis=None)
    np.testing.assert_allclose(total, -800 / 1.000001, rtol=1e-9)


def test_components_that_a_mode_lacks_have_mean_and_variance_zero():
    """A mode of one component beside one of two, against the sum over histories."""
    a, b, *noise = sympy.symbols("a b p q", real=True)
    moves = [[0.9 * a + noise[0], 0], [a + 0.5 * b + noise[0], b + noise[1]]]
    chain, covs = np.array([[0.9, 0.1], [0.2, 0.8]]), (np.diag([1.0, 0.0]), np.eye(2))
    initial = [(0.7, [0, 0], covs[0]), (0.3, [1, -1], covs[1])]
    system = SwitchingSystem(
        (a, b), moves, Noise(noise), chain.tolist(), [[a + w]] * 2, Noise((w,)), initial,
        drives="new",
    )  # fmt: skip
    y = np.array([[0.3], [1.2], [-0.4], [2.0]])
    slopes = np.array([[[0.9, 0], [0, 0]], [[1, 0.5], [0, 1]]])
    sensor = np.tile([[[1.0, 0.0]]], (4, 1, 1)), np.zeros((4, 1)), np.ones((4, 1, 1))
    modes = [
        Linear(np.tile(F, (3, 1, 1)), np.zeros((3, 2)), np.tile(Q, (3, 1, 1)), *sensor, mean, cov)
        for F, Q, mean, cov in zip(slopes, covs, np.array([[0.0, 0], [1, -1]]), covs, strict=True)
    ]
    model = Switching(modes, np.array([0.7, 0.3]), np.tile(chain, (3, 1, 1)), None)
    law = histories(model, y, None, 3, 3, "new")
    estimates = RaoBlackwellFilter(system, 16).run(range(4), y)
    np.testing.assert_allclose(estimates.mean[3], law.mean, rtol=1e-11)
    np.testing.assert_allclose(estimates.cov[3], law.cov, rtol=1e-11)
    np.testing.assert_allclose(estimates.mode_prob[3], law.mode_prob, rtol=1e-11)
    known = KnownModeFilter(system).run(range(4), y, modes=np.zeros(4, int))
    assert (known.mean[:, 1] == 0).all()
    assert np.isfinite(known.loglik).all()


GIVEN = {
    "state": (x,), "dynamics": [[x + v]], "noise": Noise((v,)), "switching": [[1]],
    "sensor": [[x + w]], "sensor_noise": Noise((w,)), "initial": [(1, [0], [[1]])],
}  # fmt: skip
HALF = [[1 / (1 + sympy.exp(x)), 1 - 1 / (1 + sympy.exp(x))]] * 2
TWO = {"dynamics": [[x + v]] * 2, "sensor": [[x + w]] * 2, "initial": [(0.5, [0], [[1]])] * 2}
UNIFORM = Noise((v,), cov=[[1 / 3]], sample=lambda rng, n: rng.uniform(-1, 1, (1, n)))


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"dynamics": [[sympy.sin(x) + v]]}, "dynamics"),
        ({"dynamics": [[x * v]]}, "dynamics"),
        ({"sensor": [[x**2 + w]]}, "sensor"),
        ({"sensor": [[x * w]]}, "sensor"),
        ({"noise": UNIFORM}, "dynamics"),
        (TWO | {"switching": HALF}, "switching"),
        (TWO | {"switching": [[0.5, 0.5]] * 2, "indicator": HALF}, "indicator"),
    ],
)
def test_system_that_is_not_jump_linear_is_refused(change, name):
    RaoBlackwellFilter(SwitchingSystem(**GIVEN))
    with pytest.raises(ValueError, match=f"^{name}: "):
        RaoBlackwellFilter(SwitchingSystem(**GIVEN | change))
