"""Filters of switching systems against a bank of Kalman filters in plain matrices, and limits."""

import pickle
from contextlib import nullcontext

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal

from oracles.switching import SwitchingOracle, merged
from seedslib import zoo
from seedslib.base import ELAPSED, Input
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.linearization import ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import Noise, SwitchingSystem

x, y, v, w, p, q = sympy.symbols("x y v w p q", real=True)
t = sympy.Symbol("t")
u = Input("u")
pytestmark = pytest.mark.filterwarnings("ignore:paths. .* too few paths of their own")

# Jump-linear, with all that there is: time in every function, an input, two unlike components
# and measurements, correlated noises with means, a noisy indicator of three values, a late start,
# unequal steps.

TIMES = np.array([1.5, 2.0, 3.5, 3.75, 5.0])
INPUT = np.array([0.5, -1.0, 2.0, 0.25, -0.5])
INITIAL = [(0.6, [0.4, -0.3], [[1.0, 0.3], [0.3, 0.8]]), (0.4, [-1.0, 0.5], [[0.5, 0], [0, 2.0]])]
CHAIN = [[1 - ELAPSED / (2 + t), ELAPSED / (2 + t)], [t / 20, 1 - t / 20]]
MOVES = [
    [t * x / 8 + ELAPSED * y / 2 + u + v, 0.8 * y - x / 4 + w],
    [0.5 * x - y + 2 * v, x / 3 + t * y / 10 - u / 2 + 1 + v - w / 2],
]
SENSORS = [[x + y / 3 + p, t * y / 5 + u / 2 + p / 2 + q], [2 * x - 1 + q, y - x / 2 + t + 3 * p]]
TELLS = [[1 / (1 + t), t / (2 + 2 * t), t / (2 + 2 * t)], [0.1, 0.3, 0.6]]
NOISE = {"mean": [0.2, -0.1], "cov": [[0.5, 0.1], [0.1, 0.3]]}


def linear(drives="old", indicator=True, course=u):
    moves, sensors = (
        [[sympy.sympify(entry).subs(u, course) for entry in row] for row in table]
        for table in (MOVES, SENSORS)
    )
    return SwitchingSystem(
        (x, y),
        moves,
        Noise((v, w), **NOISE),
        CHAIN,
        sensors,
        Noise((p, q), **NOISE),
        INITIAL,
        drives=drives,
        indicator=TELLS if indicator else None,
        time=t,
    )


def oracle(drives="old", indicator=True, course=INPUT):
    mean, cov = np.array(NOISE["mean"]), np.array(NOISE["cov"])

    def moves(k, i):
        now, held, span = TIMES[k], course[k], TIMES[k + 1] - TIMES[k]
        if i == 0:
            matrix, shift, mix = [[now / 8, span / 2], [-0.25, 0.8]], [held, 0], [[1, 0], [0, 1]]
        else:
            matrix, shift = [[0.5, -1], [1 / 3, now / 10]], [0, 1 - held / 2]
            mix = [[2, 0], [1, -0.5]]
        mix = np.array(mix)
        return np.array(matrix), np.array(shift) + mix @ mean, mix @ cov @ mix.T

    def sensors(k, i):
        now, held = TIMES[k], course[k]
        if i == 0:
            matrix, offset, mix = [[1, 1 / 3], [0, now / 5]], [0, held / 2], [[1, 0], [0.5, 1]]
        else:
            matrix, offset, mix = [[2, 0], [-0.5, 1]], [-1, now], [[0, 1], [3, 0]]
        mix = np.array(mix)
        return np.array(matrix), np.array(offset) + mix @ mean, mix @ cov @ mix.T

    def chain(k):
        leave = (TIMES[k + 1] - TIMES[k]) / (2 + TIMES[k])
        return np.array([[1 - leave, leave], [TIMES[k] / 20, 1 - TIMES[k] / 20]])

    def tells(k):
        one = 1 / (1 + TIMES[k])
        return np.array([[one, (1 - one) / 2, (1 - one) / 2], [0.1, 0.3, 0.6]])

    initial = [(share, np.array(m), np.array(c)) for share, m, c in INITIAL]
    return SwitchingOracle(initial, moves, chain, sensors, tells if indicator else None, drives)


def data(system, paths=6, gaps=True, **inputs):
    found = system.simulate(TIMES, paths, 3, **inputs)
    record, shown = np.array(found.measurements), found.indicators
    if gaps:
        record[1, 0, 1] = record[3, :, 2] = record[0, 1, 3] = record[4, :, 0] = np.nan
    if shown is not None:
        shown = np.array(shown)
        if gaps:
            shown[2, 1] = shown[3, 2] = shown[4, 4] = -1
    return record, shown


def assert_dists(found, path, dists, logliks):
    """A run against the distributions of an oracle, of one record."""
    for k, dist in enumerate(dists):
        mean, cov = merged(dist)
        assert_allclose(found.mode_prob[k, :, path], [part[0] for part in dist], rtol=1e-9)
        assert_allclose(found.mean[k, :, path], mean, rtol=1e-9, atol=1e-10)
        if found.cov is not None:
            assert_allclose(found.cov[k, ..., path], cov, rtol=1e-8, atol=1e-10)
        assert found.modes[k, path] == int(dist[1][0] > dist[0][0])
    assert_allclose(found.loglik[:, path], logliks, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("indicator", [True, False])
@pytest.mark.parametrize("drives", ["old", "new"])
@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian(), Unscented(), GaussHermite(3)])
def test_run_of_a_jump_linear_system_equals_a_bank_of_kalman_filters(rule, drives, indicator):
    """Missing components, measurements and indicators are left out exactly."""
    system, expected = linear(drives, indicator), oracle(drives, indicator)
    record, shown = data(system, inputs={u: INPUT})
    options = {"inputs": {u: INPUT}, "indicators": shown, "covariances": True}
    filter = SwitchingFilter(system, rule)
    found = filter.run(TIMES, record, **options)
    for path in range(6):
        told = None if shown is None else shown[:, path]
        dists, _, logliks = expected.run(record[..., path], told)
        assert_dists(found, path, dists, logliks)
    if rule != Taylor():
        return
    alone = filter.run(
        TIMES, record[..., 1], **{**options, "indicators": None if shown is None else shown[:, 1]}
    )
    plane = filter.run(
        TIMES,
        record.reshape(5, 2, 3, 2),
        workers=2,
        **{**options, "indicators": None if shown is None else shown.reshape(5, 3, 2)},
    )
    for name in ("mean", "cov", "mode_prob", "loglik"):
        whole = getattr(found, name)
        assert_allclose(getattr(alone, name), whole[..., 1], rtol=1e-11, atol=1e-13)
        assert_allclose(getattr(plane, name).reshape(whole.shape), whole, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("drives", ["old", "new"])
def test_steps_of_a_jump_linear_system_equal_its_run(drives):
    """Predict, forecast and correct with the inputs of their times; and each path its own."""
    system, expected = linear(drives), oracle(drives)
    record, shown = data(system, inputs={u: INPUT})
    filter = SwitchingFilter(system, Taylor())
    course = INPUT[:, None] + 0.3 * np.arange(6) * (np.arange(6) != 4)
    found = filter.run(TIMES, record, indicators=shown, inputs={u: course}, covariances=True)
    for path in (0, 4):
        alone = filter.run(
            TIMES, record[..., path], indicators=shown[:, path], inputs={u: course[:, path]}
        )
        assert_allclose(alone.mean, found.mean[..., path], rtol=1e-10)
        assert_allclose(alone.loglik, found.loglik[..., path], rtol=1e-10)
    dists, forecasts, _ = expected.run(record[..., 4], shown[:, 4])
    state = filter.initial((2,))
    for k, now in enumerate(TIMES):
        if k:
            ahead = filter.forecast(state, now, inputs={u: INPUT[max(k - 1, 0)]})
            mean, cov = merged(forecasts[k])
            assert_allclose(ahead.mean[:, 1], mean, rtol=1e-9)
            assert_allclose(ahead.cov[..., 1], cov, rtol=1e-9)
            prob = [part[0] for part in forecasts[k]]
            assert_allclose(ahead.mode_prob[:, 1], prob, rtol=1e-9)
            assert ahead.modes[1] == np.argmax(prob)
        state = filter.predict(state, now, inputs={u: INPUT[max(k - 1, 0)]})
        state = filter.correct(state, record[k][:, [0, 4]], shown[k][[0, 4]], inputs={u: INPUT[k]})
        for name in ("mean", "cov", "mode_prob", "loglik"):
            said, wanted = getattr(filter.report(state), name), getattr(found, name)[k]
            assert_allclose(said[..., [1]], wanted[..., [4]], rtol=1e-10, atol=1e-13)
        assert state.mode[1] == int(dists[k][1][0] > dists[k][0][0])
        assert (state.index, state.time, state.corrected) == (k, now, True)
    assert filter.order == 2 * (1 + 2 + 3) - 1


MEMORIES = [Memory(1), Memory(2, 1, 1, True), Memory(0, 2, indicators=2), Memory(2, 2)]


def recall_of(filter, shown):
    """The distribution that the memory stands for, from the arrays of the design: (6.32) to
    (6.34)."""
    memory, blocks = filter.memory, []

    def recall(k, dist, expected, y):
        prob = np.array([part[0] for part in dist])
        estimate = sum(part[0] * part[1] for part in dist)
        odds = np.clip(np.log(prob[1] / prob[0]), -8, 8)
        y = np.where(np.isnan(y), expected, y)
        blocks.insert(0, (estimate, odds, y, int(prob[1] > prob[0]), shown[k]))
        vector, cell = [], 0
        for estimate, odds, *_ in blocks[: memory.estimates]:
            vector += [*estimate, *([odds] if memory.log_odds else [])]
        for block in blocks[: memory.measurements]:
            vector += [*block[2]]
        for block in blocks[: memory.estimates]:
            cell = 2 * cell + block[3]
        for block in blocks[: memory.indicators]:
            cell = 3 * cell + block[4]
        fit, z = filter.fits[k], np.array(vector)
        score = []
        for i in range(2):
            apart = fit.white[:, :, i, cell] @ (z - fit.centre[:, i, cell])
            score.append(fit.log_weight[i, cell] - 0.5 * apart @ apart)
        weight = np.exp(np.array(score) - max(score))
        return [
            (
                weight[i] / weight.sum(),
                fit.gain[..., i, cell] @ z + fit.offset[:, i, cell],
                fit.cov[..., i, cell],
            )
            for i in range(2)
        ]

    return recall


@pytest.mark.parametrize("drives", ["old", "new"])
@pytest.mark.parametrize("memory", MEMORIES)
def test_run_with_a_memory_equals_the_corrected_steps_of_theorem_3(memory, drives):
    """Correct, decide, remember, take the cell, forecast: with the arrays of the design."""
    system, expected = linear(drives, course=1 - t / 3), oracle(drives, course=1 - TIMES / 3)
    filter = synthesize(system, memory, Taylor(), TIMES, paths=6000, seed=1)
    record, shown = data(system, gaps=False)
    if memory.measurements:
        record[1, 0, 1] = np.nan  # remembered as what was expected
    with pytest.warns(UserWarning, match="1 of 6") if memory.measurements else nullcontext():
        found = filter.run(TIMES, record, indicators=shown, covariances=True)
    for path in range(6):
        recall, y = recall_of(filter, shown[:, path]), record[..., path]
        dists, _, logliks = expected.run(
            y, shown[:, path], lambda k, dist, mean, recall=recall, y=y: recall(k, dist, mean, y[k])
        )
        gap = memory.measurements and path == 1
        logliks[2 if gap else 9 :] = np.nan
        assert np.isnan(found.cov[1 if gap else 9 :, ..., path]).all()
        assert_dists(found._replace(cov=None), path, dists, logliks)
        _, cov = merged(dists[-1])
        if not gap:
            assert_allclose(found.cov[-1, ..., path], cov, rtol=1e-8, atol=1e-10)
    assert filter.order == memory.order(2, 2, 2) + memory.estimates + memory.indicators
    single = filter.run(TIMES, record[..., 2], indicators=shown[:, 2])
    assert_allclose(single.mean, found.mean[..., 2], rtol=1e-10)
    state = filter.initial((6,))
    for k, now in enumerate(TIMES):
        state = filter.correct(filter.predict(state, now), record[k], shown[k])
        assert_allclose(state.mean, found.mean[k], rtol=1e-11)
        assert_allclose(filter.report(state).cov, found.cov[k], rtol=1e-9, atol=1e-12)
        assert_allclose(state.loglik, found.loglik[k], rtol=1e-11, atol=1e-12)


# Limits, and what is not linear


def telling(**options):
    """A scalar system whose indicator depends on the state; its value 2 is never shown."""
    near = 1 / (1 + x**2)
    told = [[0.2 + 0.6 * near, 0.8 - 0.6 * near, 0], [0, 1, 0]]
    return SwitchingSystem(
        (x,),
        [[0.9 * x + 0.4 + 0.3 * v], [0.5 * x - 0.7 + 0.8 * v]],
        Noise((v,)),
        [[0.9, 0.1], [0.3, 0.7]],
        [[x + 0.5 * w], [2 * x - 1 + (1 + x / 2) * w]],
        Noise((w,)),
        [(0.6, [0.3], [[1.2]]), (0.4, [-0.5], [[0.7]])],
        indicator=told,
        **options,
    )


@pytest.mark.parametrize("batch", [(7,), (7, 1), (1, 7)])
def test_paths_with_unlike_indicators_do_not_know_each_other(batch):
    """Each value, a missing one, and one that only one of the modes shows."""
    filter = SwitchingFilter(telling(), GaussHermite(3))
    shown = np.array([0, 1, 1, -1, 1, 0, -1])
    record = np.array([0.3, -1.0, np.nan, 2.0, 0.7, np.nan, np.nan])
    turned = [(np.roll(record, k), np.roll(shown, k)) for k in (0, 2, 3)]
    state = filter.initial(batch)
    for k, (y, told) in enumerate(turned):
        state = filter.step(state, float(k), y.reshape(1, *batch), told.reshape(batch))
    for path in range(7):
        one = filter.initial()
        for k, (y, told) in enumerate(turned):
            one = filter.step(one, float(k), [y[path]], told[path])
        assert_allclose(state.mean.reshape(1, 7)[:, path], one.mean, rtol=1e-11)
        assert_allclose(state.loglik.reshape(7)[path], one.loglik, rtol=1e-11, atol=1e-13)
        assert_allclose(state.dist.prob.reshape(2, 7)[:, path], one.dist.prob, rtol=1e-11)
        assert state.mode.reshape(7)[path] == one.mode


def test_indicator_that_no_mode_shows_leaves_the_forecast_and_has_no_likelihood():
    filter = SwitchingFilter(telling(), GaussHermite(3))
    state = filter.predict(filter.initial((2,)), 0.0)
    y = np.array([[0.4, 0.4]])
    found = filter.correct(state, y, np.array([2, 1]))
    blind = filter.correct(state, y, np.array([-1, -1]))
    assert found.loglik[0] == -np.inf
    assert np.isfinite(found.loglik[1])
    assert_allclose(found.mean[:, 0], blind.mean[:, 0], rtol=1e-13)
    assert_allclose(found.dist.prob[:, 0], blind.dist.prob[:, 0], rtol=1e-13)
    alone = filter.correct(filter.predict(filter.initial(), 0.0), [0.4], 2)
    assert alone.loglik == -np.inf
    assert_allclose(alone.mean, blind.mean[:, 0], rtol=1e-13)
    run = filter.run([0.0, 1.0], np.zeros((2, 1, 2)), indicators=np.array([[2, 1], [1, 1]]))
    assert run.diverged.tolist() == [True, False]


def test_angles_are_taken_nearest_to_what_is_expected():
    """A turn more or less in a measurement changes nothing, also where it is remembered."""

    def system(period):
        return SwitchingSystem(
            (x, y),
            [[x + v, y], [x - v / 2, y / 2 + v]],
            Noise((v,)),
            [[0.8, 0.2], [0.3, 0.7]],
            [[x + 0.4 * p, y + q], [x + 0.7 * p, y - q / 2]],
            Noise((p, q)),
            [(0.5, [3.0, 0.5], np.eye(2))] * 2,
            period=period,
        )

    angles, times = system({0: 2 * np.pi}), np.arange(4.0)
    record = system(None).simulate(times, 30, 1).measurements
    turned = record.copy()
    turned[:, 0] += 2 * np.pi * np.random.default_rng(0).integers(-2, 3, size=(4, 30))
    for filter in (
        SwitchingFilter(angles, Taylor()),
        synthesize(angles, Memory(1), Taylor(), times, paths=2000, seed=1),
    ):
        one, two = (filter.run(times, y) for y in (record, turned))
        assert_allclose(two.mean, one.mean, rtol=1e-9, atol=1e-9)
        assert_allclose(two.loglik, one.loglik, rtol=1e-9, atol=1e-9)
    flat = SwitchingFilter(system(None), Taylor()).run(times, record)
    near = (np.abs(record[:2, 0] - 3.0) < 1.0).all(axis=0)
    bank = SwitchingFilter(angles, Taylor()).run(times, record)
    assert near.sum() > 3
    assert_allclose(bank.mean[1][:, near], flat.mean[1][:, near], rtol=1e-9)


@pytest.mark.parametrize("indicator", [False, True])
def test_paths_that_are_lost_are_marked_and_leave_the_others_alone(indicator):
    system = SwitchingSystem(
        (x,),
        [[x**3 + v], [x / 2 + v]],
        Noise((v,)),
        [[0.9, 0.1], [0.5, 0.5]],
        [[x + w]] * 2,
        Noise((w,)),
        [(0.5, [0], [[1]])] * 2,
        indicator=[[0.9, 0.1], [0.2, 0.8]] if indicator else None,
    )
    filter, times = SwitchingFilter(system, Taylor()), np.arange(12.0)
    record = np.zeros((12, 1, 3))
    record[:, 0, 1] = 1e110
    shown = np.zeros((12, 3), dtype=int) if indicator else None
    found = filter.run(times, record, indicators=shown, covariances=True)
    rest = None if shown is None else shown[:, :1]
    whole = filter.run(times, record[..., :1], indicators=rest, covariances=True)
    assert_array_equal(found.diverged, [False, True, False])
    assert_array_equal(found.mean[..., 0], whole.mean[..., 0])
    none = filter.run(times, record[..., :0], indicators=None if shown is None else shown[:, :0])
    assert none.mean.shape == (12, 1, 0)
    assert none.modes.shape == (12, 0)


def test_threads_give_equal_bits():
    system = zoo.scalar_switching("A1H")
    data = system.simulate(np.arange(3.0), 8194, 1)
    for filter in (
        SwitchingFilter(system, ExactGaussian()),
        synthesize(system, Memory(1, 1), Taylor(), np.arange(3.0), paths=2000, seed=1),
    ):
        whole = filter.run(data.times, data.measurements)
        found = filter.run(data.times, data.measurements[..., :8193], workers=2)
        assert_array_equal(found.mean, whole.mean[..., :8193])
        again = pickle.loads(pickle.dumps(filter))
        assert_array_equal(
            again.run(data.times, data.measurements[..., :9]).mean,
            filter.run(data.times, data.measurements[..., :9]).mean,
        )


def test_fits_of_ones_own_forecast():
    """Anything that forecasts from a cell and a vector will do, also where the memory is empty."""

    class Foreign:
        def __init__(self, fit):
            self.forecast = fit.forecast

    system, times = zoo.scalar_switching("A1H"), np.arange(4.0)
    record = system.simulate(times, 5, 1).measurements
    made = synthesize(system, Memory(1, 1), Taylor(), times, paths=2000, seed=1)
    foreign = SwitchingFilter(
        system, Taylor(), made.memory, times=times, fits=[Foreign(fit) for fit in made.fits]
    )
    assert_array_equal(foreign.run(times, record).mean, made.run(times, record).mean)
    none = made.run(times, record[..., :0])
    assert none.mean.shape == (4, 1, 0)
