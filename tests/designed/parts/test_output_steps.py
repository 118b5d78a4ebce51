"""Filters of functions written by hand: what is looked at, remembered, claimed, and left out."""

from dataclasses import replace

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal

from seedslib import zoo
from seedslib.designed import Memory
from seedslib.designed.memory import Past
from seedslib.designed.outputs.filter import OutputFilter
from seedslib.designed.outputs.lookup import Output, Step, arguments, prior, require_letters
from seedslib.designed.prediction import Design, HeldOut, Prediction
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, y, v, w, r = sympy.symbols("x y v w r", real=True)
TIMES = np.array([0.0, 1.0, 3.0, 4.0])
NODES = tuple(np.array([t]) for t in (0.5, 2.0, 3.25))
STAMPS = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 3.25, 4.0])
EXACT = Design(0, 0, None, (), exact=True)


def plane():
    """Two components, of which the first is estimated, and two measurements."""
    return DiscreteSystem(
        StochasticMap([x, y], [x + v, y], Noise((v,))),
        StochasticMap([x, y], [x + w, y + r], Noise((w, r))), [0.25, 0.0], np.eye(2),
    )  # fmt: skip


def read(points):
    """Sums of arguments with powers of ten: first the measurement, then the memory."""
    return Output(np.stack([sum(10.0**k * part for k, part in enumerate(points))]))


def half(points):
    return Output(np.stack([points[0] / 2]))


def node(points):
    return Output(np.stack([points[0] - 1.0]))


def made(memory=None, **changes):
    steps = (Step(read, prior(plane(), 1)), *(Step(read, half),) * 3)
    cov = np.array([1.0, 2.0, 3.0, 4.0])[:, None, None]
    predicted = Prediction(STAMPS, np.arange(7.0)[:, None], np.zeros((7, 1)))
    filter = OutputFilter(
        plane(), memory or Memory(2), TIMES.copy(), steps, "hand", predicted, cov, EXACT, NODES,
        ((node,),) * 3, np.arange(8.0).reshape(2, 4),
    )  # fmt: skip
    return replace(filter, **changes) if changes else filter


def test_states_from_step_to_step():
    filter = made()
    start = filter.initial((3,))
    assert (start.index, start.time, start.past) == (-1, None, Past())
    assert start.mean.shape == (1, 3)
    assert np.isnan(start.mean).all()
    assert start.gap is start.corrected is False
    assert start.group == 0
    first = filter.predict(start, 0.0)
    assert (first.index, first.time, first.before) == (0, 0.0, None)
    assert_array_equal(first.mean, [[0.25, 0.25, 0.25]])
    assert first.cov is first.mode is first.mode_prob is None
    assert first.corrected is False
    shown = np.array([[1.0, 2.0, 3.0], [0.1, 0.2, 0.3]])
    zero = filter.correct(first, shown)
    assert_allclose(zero.mean, [[2.0, 4.0, 6.0]], rtol=1e-14)
    assert_array_equal(zero.cov, [[1.0]])
    assert zero.corrected is True
    assert_array_equal(zero.past.vector, zero.mean)
    ahead = filter.predict(zero, 1.0)
    assert (ahead.index, ahead.time) == (1, 1.0)
    assert_array_equal(ahead.mean, zero.mean / 2)
    assert ahead.past is zero.past
    assert ahead.before.mean is zero.mean
    assert ahead.before.before is None
    one = filter.correct(ahead, shown)
    assert_allclose(one.mean, [[202.0, 404.0, 606.0]], rtol=1e-14)
    assert_array_equal(one.past.vector, [one.mean[0], zero.mean[0]])
    two = filter.step(one, 3.0, shown)
    assert_allclose(two.mean, 2.0 * shown[:1] + 100.0 * one.mean + 1000.0 * zero.mean, rtol=1e-14)
    assert two.before.before is None
    assert two.before.index == 1
    with pytest.raises(ValueError, match=r"^t: wanted the next measurement time 4, got 5$"):
        filter.predict(two, 5.0)
    with pytest.raises(ValueError, match=r"^t: wanted at most the last measurement time 4$"):
        filter.predict(filter.step(two, 4.0, shown), 5.0)
    with pytest.raises(ValueError, match=r"^state: wanted a state after a correction"):
        filter.predict(ahead, 3.0)
    assert_allclose(filter.output(1, shown[:, 0], [5.0]).mean, [502.0])


def test_missing_measurements_of_some_paths():
    """They have the forecast of the memory, and nothing is claimed of them any more."""
    filter = made()
    shown = np.array([[1.0, np.nan, 3.0], [0.1, np.nan, 0.3]])
    zero = filter.step(filter.initial((3,)), 0.0, shown)
    assert_allclose(zero.mean, [[2.0, 0.25, 6.0]], rtol=1e-14)
    assert_array_equal(zero.cov, [[[1.0, np.nan, 1.0]]])
    assert_array_equal(zero.gap, [False, True, False])
    shown[:, 0] = np.nan
    shown[:, 1] = [5.0, 0.5]
    one = filter.step(zero, 1.0, shown)
    assert_allclose(one.mean, [[1.0, 10.0 + 25.0, 606.0]], rtol=1e-14)
    assert_array_equal(one.cov, [[[np.nan, np.nan, 2.0]]])
    none = filter.step(filter.initial(), 0.0, [np.nan, np.nan])
    assert_array_equal(none.mean, [0.25])
    assert np.isnan(none.cov).all()
    shown[0, 2] = np.nan
    with pytest.raises(ValueError, match=r"^y: wanted all components of a measurement or none"):
        filter.step(zero, 1.0, shown)
    kept = made(Memory(measurements=1))
    with pytest.raises(ValueError, match=r"^y: wanted a measurement, it is to be remembered"):
        kept.step(kept.initial(), 0.0, [np.nan, np.nan])
    state = kept.step(kept.initial(), 0.0, [1.0, 0.1])
    assert_array_equal(state.past.vector, [1.0, 0.1])
    assert_allclose(kept.step(state, 1.0, [0.0, 0.0]).mean, [100.0 + 100.0], rtol=1e-14)


@pytest.mark.filterwarnings("ignore:measurements. .* records have gaps")
def test_a_run_is_its_steps():
    filter = made()
    times = np.array([0.0, 0.25, 0.5, 1.0, 2.5, 3.0, 4.0])
    shown = np.full((7, 2, 4), np.nan)
    at = [0, 3, 5, 6]
    shown[at] = np.random.default_rng(1).normal(size=(4, 2, 4))
    shown[3, :, 2] = np.nan
    found = filter.run(times, shown, covariances=True)
    assert found.loglik is found.modes is found.mode_prob is None
    assert not found.diverged.any()
    state = filter.initial((4,))
    for j, t in enumerate(times):
        if j in at:
            state = filter.step(state, t, shown[j])
            assert_array_equal(found.mean[j], state.mean)
            cov = np.broadcast_to(state.cov.reshape(1, 1, -1), (1, 1, 4))
            assert_array_equal(found.cov[j], cov)
        else:
            assert_array_equal(found.mean[j], filter.forecast(state, t).mean)
            assert np.isnan(found.cov[j]).all()
    for other in (
        filter.run(times, shown.reshape(7, 2, 2, 2), covariances=True),
        filter.run(times, shown, covariances=True, workers=2),
    ):
        assert_array_equal(other.mean.reshape(7, 1, 4), found.mean)
        assert_array_equal(other.cov.reshape(7, 1, 1, 4), found.cov)
    alone = filter.run(times, shown[..., 1], covariances=True)
    assert_allclose(alone.mean, found.mean[..., 1], rtol=1e-14)
    assert alone.cov.shape == (7, 1, 1)
    assert filter.run(times, shown[..., 1]).cov is None
    whole = made().run(times[at], shown[at][..., 1], covariances=True)
    assert_array_equal(whole.cov[:, 0, 0], [1.0, 2.0, 3.0, 4.0])
    wild = shown[at]
    wild[0, 0, 3] = 1e308
    with np.errstate(over="ignore"):
        assert filter.run(times[at], wild).diverged.tolist() == [False, False, False, True]


def test_forecasts_go_by_nodes_to_the_next_measurement():
    filter = made()
    state = filter.step(filter.initial((2,)), 0.0, np.array([[1.0, 2.0], [0.0, 0.0]]))
    z = state.mean
    times, values, (end, last) = filter.nodes(state)
    assert times == [0.0, 0.5]
    assert_array_equal(values[1], z - 1.0)
    assert end == 1.0
    assert_array_equal(last, z / 2)
    assert filter.nodes(state, end=False)[2] is None
    for t, wanted in ((0.25, z - 0.5), (0.5, z - 1.0), (0.75, 0.75 * z - 0.5), (1.0, z / 2)):
        assert_allclose(filter.forecast(state, t).mean, wanted, rtol=1e-14)
    assert_array_equal(filter.forecast(state, 0.75, "piecewise constant").mean, z - 1.0)
    with pytest.raises(ValueError, match=r"^t: wanted a time from 0 to 1, got 1\.5$"):
        filter.forecast(state, 1.5)
    for t in TIMES[1:]:
        state = filter.step(state, t, np.zeros((2, 2)))
    times, values, end = filter.nodes(state)
    assert times == [4.0]
    assert end is None
    assert_array_equal(filter.forecast(state, 4.0).mean, state.mean)
    assert filter.horizon == 4.0
    # without nodes, straight to the next measurement
    bare = made(node_times=(), node_fits=())
    state = bare.step(bare.initial(), 0.0, [1.0, 0.0])
    assert bare.forecast(state, 0.5).mean == pytest.approx(0.75)


def test_the_last_steps_serve_in_turn():
    """The last two, of lengths 2 and 1: measurements at 6 and 7, and nodes as before them."""
    filter = made(cycle=2, availability=None)
    assert filter.horizon == np.inf
    assert filter.reach == (0.0, 4.0)
    assert [filter.served(k) for k in range(8)] == [0, 1, 2, 3, 2, 3, 2, 3]
    shown = np.array([0.5, 0.0])
    state = filter.initial()
    for k, t in enumerate((0.0, 1.0, 3.0, 4.0, 6.0, 7.0)):
        state = filter.step(state, t, shown)
        assert_array_equal(state.cov, [[(1.0, 2.0, 3.0, 4.0, 3.0, 4.0)[k]]])
        if k == 3:
            assert_allclose(filter.nodes(state)[0], [4.0, 5.0])
            assert filter.nodes(state)[2][0] == 6.0
        if k == 4:
            assert_allclose(filter.nodes(state)[0], [6.0, 6.25])
    found = filter.run([0, 1, 3, 4, 6, 7, 9], np.tile(shown, (7, 1)), covariances=True)
    assert_array_equal(found.cov[:, 0, 0], [1.0, 2.0, 3.0, 4.0, 3.0, 4.0, 3.0])
    assert_array_equal(found.mean[5], state.mean)


def test_some_steps_of_a_design():
    """Each comes as long after the one before as it did; of the others nothing is left."""
    mask = np.array([[True, True], [True, False], [False, True], [True, True]])
    held = HeldOut(TIMES, np.ones((4, 1)), np.ones((4, 1)), np.ones((4, 1)), 5, 0)
    filter = made(measured=mask, held_out=held, cycle=1)
    some = filter.taking([0, 2, 3])
    assert_array_equal(some.times, [0.0, 2.0, 3.0])
    assert_array_equal(some.measured, mask[[0, 2, 3]])
    assert_array_equal(some.predicted.times, [0.0, 1.0, 2.0, 2.25, 3.0])
    assert_array_equal(some.predicted.rms[:, 0], [0.0, 3.0, 4.0, 5.0, 6.0])
    assert_array_equal(np.concatenate(some.node_times), [1.0, 2.25])
    assert len(some.node_fits) == 2
    assert_array_equal(some.covariances[:, 0, 0], [1.0, 3.0, 4.0])
    assert_array_equal(some.changes, [[0.0, 2.0, 3.0], [4.0, 6.0, 7.0]])
    assert some.steps == (filter.steps[0], *filter.steps[2:])
    assert some.held_out is None
    assert some.cycle == 0
    later = replace(filter, node_times=(), node_fits=(), predicted=None).taking([1, 2])
    assert_array_equal(later.times, [0.0 + 1.0, 3.0])
    assert later.node_times == ()
    assert later.predicted is None


def test_what_the_schedule_leaves_out_is_refused_by_the_name_of_the_argument():
    mask = np.array([[True, True], [True, False], [True, True], [True, True]])
    filter = made(measured=mask)
    state = filter.predict(filter.step(filter.initial(), 0.0, [1.0, 0.0]), 1.0)
    match = r"^y: wanted what the schedule of the design has, got component 1 of a measurement"
    with pytest.raises(ValueError, match=match):
        filter.correct(state, [1.0, 0.0])
    match = r"^measurements: wanted what the schedule of the design has, got component 1 .* row 1$"
    with pytest.raises(ValueError, match=match):
        filter.run(TIMES, np.zeros((4, 2)))


def test_arguments_in_the_order_of_the_axes():
    """Indicator, measurement, class, and blocks of memory with their mode and indicator."""
    system, nan = zoo.dependent_switching(), np.array([-1, 1])
    past = Past((np.array([[3.0, 4.0]]), np.array([[5.0, 6.0]])), (), (np.array([1, 0]),
                np.array([0, 0])), (np.array([0, 1]), np.array([1, 1])))  # fmt: skip
    points = arguments(system, np.array([[1.0, 2.0]]), nan, past, np.array([7, 8]))
    wanted = [[2, 1], [1, 2], [7, 8], [1, 0], [0, 1], [3, 4], [0, 0], [1, 1], [5, 6]]
    assert [np.asarray(part).tolist() for part in points] == wanted
    assert [int(part) for part in arguments(system, (), None, Past())] == [2]
    assert arguments(plane(), (), None, Past()) == []


def test_memories_whose_blocks_are_not_alike():
    alone = "memory: wanted estimates or measurements alone"
    for memory in (Memory(1, 1), Memory(1, log_odds=True), Memory(2, 0, 1)):
        with pytest.raises(ValueError, match=f"^{alone} for tables, got {memory}"):
            require_letters(memory, 2, " for tables")
    with pytest.raises(ValueError, match=r"^memory: wanted estimates or measurements alone, got"):
        require_letters(Memory(2, 0, 2), 0)
    require_letters(Memory(2, 0, 2), 2)
    require_letters(Memory(0, 3), 0)
