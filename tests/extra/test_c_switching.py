"""Filters of systems with modes in C against the same filters in Python."""

from functools import lru_cache

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base.parameters import ELAPSED
from seedslib.design import simulated_synthesis, stationary, synthesize
from seedslib.designed import Memory, SwitchingFilter, finite_memory, large_order
from seedslib.extra import to_c
from seedslib.linearization import Cubature, ExactGaussian, Taylor
from seedslib.models import Noise, SwitchingSystem

x, v, w = sympy.symbols("x v w", real=True)
pytestmark = pytest.mark.filterwarnings("ignore:paths:UserWarning")

TIMES, PATHS = np.arange(40.0), 40


def three():
    """Three ways to drift, which last; no indicator, one component of two sometimes missing."""
    stay = [[0.9, 0.05, 0.05], [0.1, 0.8, 0.1], [0.0, 0.2, 0.8]]
    return SwitchingSystem(
        (x,), [[0.9 * x + v / 2], [0.5 * x + 2 + v], [0.5 * x - 2 + v / 3]], Noise((v,)), stay,
        [[x + w, x**2 / 5], [x + 2 * w, x**2 / 5], [x + w / 2, x**2 / 5 + w]], Noise((w,)),
        [(0.5, [0.0], [[1.0]]), (0.3, [1.0], [[2.0]]), (0.2, [-1.0], [[2.0]])],
    )  # fmt: skip


@lru_cache
def tells():
    """An indicator that tells whether the state is large, so that forecasts have two parts."""
    above = sympy.exp(-((x - 1) ** 2) / 4)
    return SwitchingSystem(
        (x,), [[0.9 * x + v], [0.3 * x + 1 + v]], Noise((v,)), [[0.9, 0.1], [0.3, 0.7]],
        [[x + w], [x / 2 + w]], Noise((w,)),
        [(0.5, [0.0], [[1.0]]), (0.5, [1.0], [[1.0]])],
        indicator=[[1 - above / 2, above / 2], [above / 3, 1 - above / 3]],
    )  # fmt: skip


@lru_cache
def driven(told=False):
    """The new mode drives the step, and the state moves the switch; perhaps an indicator of it."""
    far = sympy.exp(-((x - 1) ** 2) / 4)
    return SwitchingSystem(
        (x,), [[0.9 * x + v], [0.3 * x + 1 + v / 2]], Noise((v,)),
        [[1 - far / 2, far / 2], [0.4, 0.6]], [[x + w], [x / 2 + w]], Noise((w,)),
        [(0.5, [0.0], [[1.0]]), (0.5, [1.0], [[1.0]])], drives="new",
        indicator=[[1 - far / 2, far / 2], [far / 3, 1 - far / 3]] if told else None,
    )  # fmt: skip


def textbook():
    """Three modes that last, one of them never left for another; the new one drives the step."""
    stay = [[0.9, 0.05, 0.05], [0.1, 0.9, 0.0], [0.0, 0.2, 0.8]]
    moves = [[0.9 * x + v / 2], [0.5 * x + 2 + v], [0.5 * x - 2 + v / 3]]
    return SwitchingSystem(
        (x,), moves, Noise((v,)), stay, [[x + w], [x + 2 * w], [x + w / 2]], Noise((w,)),
        [(0.5, [0.0], [[1.0]]), (0.3, [1.0], [[2.0]]), (0.2, [-1.0], [[2.0]])], drives="new",
    )  # fmt: skip


CASES = {
    "the new mode drives": (textbook, ExactGaussian(), None),
    "the new mode drives, moved by the state": (driven, Taylor(), None),
    "the new mode drives, an indicator": (lambda: driven(True), ExactGaussian(), None),
    "the new mode drives, designed": (driven, Taylor(), large_order(1)),
    "IMM, three modes": (three, ExactGaussian(), None),
    "indicator": (zoo.manoeuvring_target, Taylor(), None),
    "state moves the modes": (zoo.scalar_switching, ExactGaussian(), None),
    "state moves the modes, Taylor": (zoo.scalar_switching, Taylor(), None),
    "an indicator moved by the state": (tells, ExactGaussian(), None),
    "an indicator moved by the state, designed": (tells, ExactGaussian(), Memory(1)),
    "large order": (zoo.scalar_switching, ExactGaussian(), large_order(2)),
    "finite memory": (zoo.manoeuvring_target, Taylor(), finite_memory(2)),
    "indicators and log-odds": (
        zoo.manoeuvring_target, Taylor(), Memory(1, 0, 1, log_odds=True),
    ),
    "estimates and measurements": (three, Taylor(), Memory(1, 2)),
}  # fmt: skip


@lru_cache
def made(name):
    model, rule, memory = CASES[name]
    if memory is None:
        return SwitchingFilter(model(), rule)
    return synthesize(model(), memory, rule, TIMES[:12], paths=800, seed=1)


def data(filter, holes=True):
    times = TIMES if filter.memory is None else TIMES[:12]
    found = filter.system.simulate(times, PATHS, 2)
    y, told = found.measurements.copy(), found.indicators
    rng = np.random.default_rng(0)
    if holes:
        y[rng.random(y.shape) < 0.1] = np.nan
        if told is not None and not (filter.memory and filter.memory.indicators):
            told = np.where(rng.random(told.shape) < 0.1, -1, told)
    return times, y, told


def near(found, wanted, part=1e-9):
    lost = ~np.isfinite(wanted)
    assert np.array_equal(np.isnan(wanted), np.isnan(found))
    size = np.abs(np.where(lost, 0.0, wanted)).max()
    np.testing.assert_allclose(found[~lost], wanted[~lost], rtol=part, atol=part * size)


def agree(found, wanted):
    """What C gives of records, and the estimates of Python."""
    mean, cov, loglik, prob, modes = found
    near(mean, wanted.mean)
    near(cov, wanted.cov)
    near(loglik, wanted.loglik)
    near(prob, wanted.mode_prob)
    assert np.array_equal(modes, wanted.modes)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
@pytest.mark.filterwarnings("ignore:covariances:UserWarning")
def test_switching_filters(name, compiled):
    filter = made(name)
    times, y, told = data(filter)
    options = {} if told is None else {"indicators": told}
    wanted = filter.run(times, y, covariances=True, **options)
    agree(compiled(filter).run(times, y, told), wanted)


def test_one_mode_that_never_changes_is_the_bayes_factor(compiled):
    """Two modes that do not switch: log-odds are sums of two Kalman filters' likelihoods."""
    system = SwitchingSystem(
        (x,), [[0.9 * x + v], [0.9 * x + v]], Noise((v,)), [[1, 0], [0, 1]], [[x + w], [x + 3 * w]],
        Noise((w,)), [(0.5, [0.0], [[1.0]]), (0.5, [0.0], [[1.0]])],
    )  # fmt: skip
    y = system.simulate(TIMES, 3, 1).measurements
    _, _, loglik, prob, _ = compiled(SwitchingFilter(system, Taylor())).run(TIMES, y)
    for i in range(3):
        total = np.log([0.5, 0.5])
        for k, noise in enumerate((1.0, 9.0)):
            m, p = 0.0, 1.0
            for j, shown in enumerate(y[:, 0, i]):
                if j:
                    m, p = 0.9 * m, 0.81 * p + 1.0
                s = p + noise
                total[k] += -0.5 * ((shown - m) ** 2 / s + np.log(2 * np.pi * s))
                m, p = m + p / s * (shown - m), p * noise / s
        wanted = np.logaddexp(*total)
        np.testing.assert_allclose(loglik[:, i].sum(), wanted, rtol=1e-11)
        np.testing.assert_allclose(prob[-1, :, i], np.exp(total - wanted), rtol=1e-9)


def test_the_new_mode_drives_as_in_the_textbook(compiled):
    """The recursion of the interacting multiple model filter, written out by hand."""
    system = textbook()
    y = system.simulate(TIMES, 1, 4).measurements
    mean, cov, loglik, prob, _ = compiled(SwitchingFilter(system, Taylor())).run(TIMES, y)
    stay = np.array([[0.9, 0.05, 0.05], [0.1, 0.9, 0.0], [0.0, 0.2, 0.8]])
    gain, shift = np.array([0.9, 0.5, 0.5]), np.array([0.0, 2.0, -2.0])
    push, noise = np.array([0.25, 1.0, 1 / 9]), np.array([1.0, 4.0, 0.25])
    mu, m, p = np.array([0.5, 0.3, 0.2]), np.array([0.0, 1.0, -1.0]), np.array([1.0, 2.0, 2.0])
    for k, shown in enumerate(y[:, 0, 0]):
        if k:
            mix = mu[:, None] * stay
            ahead = mix.sum(axis=0)
            mix = mix / ahead
            mixed = m @ mix
            spread = ((p[:, None] + (m[:, None] - mixed) ** 2) * mix).sum(axis=0)
            mu, m, p = ahead, gain * mixed + shift, gain**2 * spread + push
        s = p + noise
        e = shown - m
        each = mu * np.exp(-0.5 * e**2 / s) / np.sqrt(2 * np.pi * s)
        mu, m, p = each / each.sum(), m + p / s * e, p * noise / s
        np.testing.assert_allclose(loglik[k, 0], np.log(each.sum()), rtol=1e-11)
        np.testing.assert_allclose(prob[k, :, 0], mu, rtol=1e-10)
        np.testing.assert_allclose(mean[k, 0, 0], mu @ m, rtol=1e-10)
        whole = mu @ (p + (m - mu @ m) ** 2)
        np.testing.assert_allclose(cov[k, 0, 0, 0], whole, rtol=1e-10)


@pytest.mark.parametrize("drives", ["old", "new"])
@pytest.mark.parametrize("memory", [None, Memory(1)])
def test_modes_at_irregular_times(drives, memory, compiled):
    """The longer a step, the farther the state goes, and the likelier is a switch."""
    times = np.array([0.0, 0.5, 0.7, 1.5, 2.5, 2.75])
    leave = 1 - sympy.exp(-ELAPSED / 4)
    system = SwitchingSystem(
        (x,), [[x + sympy.sqrt(ELAPSED) * v], [x - ELAPSED + sympy.sqrt(ELAPSED) * v]], Noise((v,)),
        [[1 - leave, leave], [leave, 1 - leave]], [[x + w], [x + 2 * w]], Noise((w,)),
        [(0.5, [0.0], [[1.0]])] * 2, drives=drives,
    )  # fmt: skip
    filter = SwitchingFilter(system, Taylor())
    if memory is not None:
        filter = synthesize(system, memory, Taylor(), times, paths=400, seed=1)
    y = np.random.default_rng(1).normal(size=(len(times), 1, 5))
    wanted = filter.run(times, y)
    mean, _, loglik, prob, _ = compiled(filter).run(times, y)
    for one, other in zip((mean, loglik, prob), (wanted.mean, wanted.loglik, wanted.mode_prob),
                          strict=True):  # fmt: skip
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-12)


def test_a_design_without_an_end(compiled):
    design = synthesize(three(), Memory(1), Taylor(), TIMES[:14], paths=600, seed=1)
    filter = stationary(design, tolerance=2.0, paths=100, cycle=2)
    times = np.arange(400.0)
    y = filter.system.simulate(times, 2, 5).measurements
    wanted = filter.run(times, y, covariances=True)
    agree(compiled(filter).run(times, y), wanted)


def test_what_no_mode_can_show(compiled):
    never = SwitchingSystem(
        (x,), [[x + v]], Noise((v,)), [[1]], [[x + w]], Noise((w,)), [(1, [0.0], [[1.0]])],
        indicator=[[1, 0]],
    )  # fmt: skip
    filter = SwitchingFilter(never, Taylor())
    y, told = np.ones((4, 1, 1)), np.array([[0], [1], [-1], [0]])
    wanted = filter.run(TIMES[:4], y, indicators=told)
    mean, _, loglik, _, _ = compiled(filter).run(TIMES[:4], y, told)
    near(mean, wanted.mean)
    np.testing.assert_allclose(loglik, wanted.loglik, rtol=1e-12)
    assert loglik[1, 0] == -np.inf


def test_refused(compiled):
    filter = made("indicator")
    _, y, told = data(filter, holes=False)
    library = compiled(filter)
    assert library.run(TIMES, np.where(np.isfinite(y), np.inf, y), told) == 2
    assert library.run(TIMES, y, told + 5) == 5
    assert library.run(TIMES[::-1], y, told) == 4
    kept = made("indicators and log-odds")
    assert compiled(kept).run(TIMES[:12], y[:12], np.full((12, PATHS), -1)) == 3
    with pytest.raises(TypeError, match="linearization: wanted formulas"):
        to_c(SwitchingFilter(zoo.scalar_switching(), Cubature()))
    printed = SwitchingFilter(tells(), ExactGaussian(), normalisation="printed")
    with pytest.raises(ValueError, match="normalisation: wanted 'consistent'"):
        to_c(printed)


TABLES = {
    "no indicator": (zoo.scalar_switching, large_order(1), {"probabilities": True}),
    "indicator, exact": (zoo.manoeuvring_target, large_order(1), {}),
    "memory of indicators": (zoo.manoeuvring_target, Memory(1, 0, 1), {}),
    "measurements": (zoo.scalar_switching, finite_memory(2), {}),
}


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_tables_that_decide_modes(name, compiled):
    model, memory, options = TABLES[name]
    system = model()
    paths = simulated_synthesis(
        system, memory, TIMES[:12], y=(-12, 12, 9), z=[(-8, 8, 7)] * system.state_size,
        paths=4000, seed=1, nodes=0, **options,
    )  # fmt: skip
    _, y, told = data(paths, holes=bool(memory.estimates and not memory.indicators))
    told_too = {} if told is None else {"indicators": told}
    wanted = paths.run(TIMES[:12], y, covariances=True, **told_too)
    mean, cov, _, prob, modes = compiled(paths).run(TIMES[:12], y, told)
    near(mean, wanted.mean, 1e-13)
    near(cov, wanted.cov if wanted.cov.ndim == 4 else wanted.cov[..., None] * np.ones(PATHS))
    assert np.array_equal(modes, wanted.modes)
    if wanted.mode_prob is not None:
        near(prob, wanted.mode_prob, 1e-13)
