"""Filters of output functions: modes, gaps and times between together; models told apart."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal

from seedslib import zoo
from seedslib.base import Input
from seedslib.base.tables import Axis, Labels
from seedslib.base.values import assigned
from seedslib.design import grid_synthesis
from seedslib.designed import Memory
from seedslib.designed.identity import difference, probe, probe_points
from seedslib.designed.outputs.lookup import Output, Step, Table, recalled
from seedslib.designed.outputs.minimax import _found
from seedslib.designed.outputs.patterns import ByPattern, by_pattern, components
from seedslib.models import DiscreteSystem, Noise, StochasticMap

TIMES = np.arange(3.0)
AXES = {"x": (-8, 8, 41), "z": (-6, 6, 31), "y": (-16, 18, 35)}
rng = np.random.default_rng(8)


@pytest.fixture(scope="module")
def switching():
    return grid_synthesis(zoo.scalar_switching("A1H"), Memory(1), TIMES, **AXES, probabilities=True)


@pytest.fixture(scope="module")
def patterned():
    return grid_synthesis(
        zoo.flip_process(), Memory(1), [0.0, 0.25, 0.5], x=(-3.5, 3.5, 41), z=(-3, 3, 31),
        y=(-8, 8, 41), nodes=1, availability=0.7,
    )  # fmt: skip


def test_with_modes_all_times_are_those_of_measurements(switching):
    shown = np.array([[0.3], [np.nan], [-1.2], [0.8]])
    with pytest.raises(ValueError, match=r"times: wanted those of measurements alone.* got 0\.5"):
        switching.run([0.0, 0.5, 1.0, 2.0], shown)
    found = switching.run(TIMES, shown[[0, 2, 3]])
    assert np.isfinite(found.mean).all()


def test_a_forecast_with_modes_is_that_for_the_next_measurement(switching):
    state = switching.initial((2,))
    state = switching.correct(switching.predict(state, 0.0), np.array([[0.3, -2.5]]))
    ahead, found = switching.predict(state, 1.0), switching.forecast(state, 1.0)
    for name, wanted in (
        ("mean", ahead.mean),
        ("modes", ahead.mode),
        ("mode_prob", ahead.mode_prob),
    ):
        assert_array_equal(getattr(found, name), wanted)
    assert found.mode_prob.shape == (2, 2)
    assert_allclose(found.mode_prob.sum(axis=0), 1.0, atol=1e-12)


def test_nothing_is_claimed_between_measurements(patterned):
    """With classes of histories: the covariance of each history, and none between."""
    times = np.array([0.0, 0.1, 0.25, 0.375, 0.5])
    shown = np.full((5, 1, 3), np.nan)
    shown[::2] = rng.normal(size=(3, 1, 3))
    shown[2, 0, 1] = np.nan
    found = patterned.run(times, shown, covariances=True)
    assert np.isnan(found.cov[[1, 3]]).all()
    group = np.zeros(3, dtype=int)
    for k, row in enumerate((0, 2, 4)):
        number = (~np.isnan(shown[row, 0])).astype(int)
        assert_array_equal(found.cov[row, 0, 0], patterned.arrivals[k].covs[group, number, 0, 0])
        group = patterned.ways[k][group, number]
    alone = patterned.run(times, shown[..., 1], covariances=True)
    assert_array_equal(alone.cov, found.cov[..., 1])
    assert_allclose(alone.mean, found.mean[..., 1], rtol=1e-12)
    # at a node the forecast is the node's function of the memory and its class
    state = patterned.initial()
    for k, t in enumerate((0.0, 0.25)):
        state = patterned.correct(patterned.predict(state, t), shown[2 * k, :, 1])
    (fit,) = patterned.node_fits[1]
    assert_allclose(found.mean[3, 0, 1], fit([np.asarray(state.group), state.mean[0]]).mean[0])


def test_the_change_of_a_step(switching):
    moved, modes = switching.change
    assert moved == switching.changes[0, -1] / np.sqrt(np.trace(switching.covariances[-1]))
    assert modes == switching.changes[1, -1]
    lone = switching.taking([0, 1])
    assert lone.changes.shape == (2, 2)
    object.__setattr__(lone, "changes", None)
    assert np.isnan(lone.change).all()
    kept = sum(part.nbytes for step in switching.steps for table in step for part in table[1:])
    assert switching.bytes == kept


def table(*axes, size=1):
    shape = tuple(axis.count for axis in axes)
    return Table(axes, rng.normal(size=(size, *shape)))


def test_functions_of_patterns_look_at_what_is_there():
    """Function i is that of the components whose powers of two add up to i."""
    axes = Axis(-1.0, 1.0, 4), Axis(-2.0, 3.0, 5), Axis(0.0, 1.5, 3)
    assert [components(i, 3) for i in range(8)] == [
        [], [0], [1], [0, 1], [2], [0, 2], [1, 2], [0, 1, 2]
    ]  # fmt: skip
    tables = [table(*(axes[j] for j in components(i, 3))) for i in range(1, 8)]
    blind = Table((), np.array([0.7]))
    step = Step(ByPattern(tuple(tables)), blind)
    y = rng.uniform(-0.8, 0.8, size=(3, 8))
    y[[[0], [1], [2]], np.arange(8)] = [
        [value if k >> j & 1 else np.nan for k, value in enumerate(y[j])] for j in range(3)
    ]
    found = by_pattern(step, y, lambda function, points: function(points).filling((8,)))
    for k in range(8):
        wanted = tables[k - 1](y[components(k, 3), k]).mean if k else blind.estimate
        assert_allclose(found.mean[:, k], wanted, rtol=1e-14)
    assert step.shown.fullest is tables[-1]
    assert_array_equal(step.shown(y[:, 7]).mean, tables[-1](y[:, 7]).mean)
    none = ByPattern((None, None, None))
    assert none.fullest is None
    with pytest.raises(ValueError, match="wanted no measurement, the schedule has none"):
        none([0.3])
    with pytest.raises(ValueError, match="y: wanted what the schedule of the design has"):
        by_pattern(Step(none, blind), np.array([0.3, np.nan]), lambda function, points: blind([]))


def test_what_is_refused_of_a_table():
    axes = Axis(-1.0, 1.0, 4), Labels(3)
    good = Table(axes, rng.normal(size=(1, 4, 3)), np.zeros((4, 3), np.int8), np.ones((2, 4, 3)))
    good.check("t", axes, 1, 2, Memory(1))
    for part, match in (
        ({"axes": axes[::-1]}, "t has other axes than the memory"),
        ({"axes": (axes[0], Labels(4))}, "t has other axes"),
        ({"estimate": good.estimate[:, :3]}, "t.estimate"),
        ({"prob": good.prob[:1]}, "t.prob"),
        ({"mode": good.mode.astype(int)}, "t.mode: wanted bytes of shape"),
        ({"mode": good.mode[:3]}, "t.mode: wanted bytes of shape"),
        ({"mode": good.mode + np.int8(2)}, "t.mode: a number that is no mode"),
        ({"mode": good.mode - np.int8(1)}, "t.mode: a number that is no mode"),
    ):
        with pytest.raises(ValueError, match=match):
            good._replace(**part).check("t", axes, 1, 2, Memory(1))
    good._replace(mode=good.mode + np.int8(1)).check("t", axes, 1, 2, Memory(1))


def test_outputs_fill_the_axes_of_the_paths():
    flat = Output(np.array([1.5]), np.array(1), np.array([0.3, 0.7]))
    full = flat.filling((2, 3))
    assert full.mean.shape == (1, 2, 3)
    assert full.mode.shape == (2, 3)
    assert_array_equal(full.prob[1], np.full((2, 3), 0.7))
    assert full.filling((2, 3)) is full
    assert Output(np.array([1.5])).filling((4,)).mode is None


def test_the_memory_is_called_back_from_its_arguments():
    """Each block, newest first: its mode, its indicator, its numbers."""
    rows = np.array([[1.0, 0.0], [0.3, 0.4], [0.0, 1.0], [-0.5, 0.6]])
    found = recalled(zoo.scalar_switching("A1H"), Memory(2), 1, 1, rows)
    assert_array_equal(found.modes, [[1, 0], [0, 1]])
    assert found.modes[0].dtype.kind == "i"
    assert_array_equal(found.estimates, [[[0.3, 0.4]], [[-0.5, 0.6]]])
    short = recalled(zoo.scalar_switching("A1H"), Memory(2), 1, 0, rows[:2])
    assert len(short.estimates) == 1
    told = recalled(zoo.dependent_switching(), Memory(2, 0, 2), 1, 1, rows[[0, 2, 1, 2, 0, 3]])
    assert_array_equal(told.modes, [[1, 0], [0, 1]])
    assert_array_equal(told.indicators, [[0, 1], [1, 0]])
    assert told.indicators[0].dtype.kind == "i"
    assert_array_equal(told.estimates, [[[0.3, 0.4]], [[-0.5, 0.6]]])
    (alone,) = recalled(zoo.linear_gaussian(), Memory(0, 1), 1, 0, rows[1:2]).measurements
    assert_array_equal(alone, rows[1:2])


def test_functions_of_ones_own_give_numbers():
    """Whatever kind they are given as."""
    found = _found("prediction", [[sympy.Rational(1, 2), 2]], np.zeros((3, 2)))
    assert found.dtype == np.float64
    assert_array_equal(found, [[0.5, 2.0]])
    for value in (np.zeros(2), np.zeros((1, 3)), np.zeros((1, 1, 2))):
        with pytest.raises(ValueError, match=r"prediction: wanted \(rows, 2\) from the function"):
            _found("prediction", value, np.zeros((3, 2)))


# Models


x, v, w = sympy.symbols("x v w")
u = Input("u")


def told(u):
    moves = StochasticMap([x], [0.8 * sympy.sin(x) + u + 0.3 * v], Noise((v,)))
    return DiscreteSystem(moves, StochasticMap([x], [x + u * x / 5 + w], Noise((w,))), [0], [[1]])


def test_a_model_is_looked_at_with_an_input_of_its_own():
    """An input has no value; where a model is only looked at, it is 0.37."""
    points = probe_points(told(u), 0.0, 2.0)
    found, wanted = probe(told(u), points), probe(told(0.37), points)
    assert difference(wanted, found, points) == ""
    with assigned({u: 2.0}):  # whatever it is now
        assert difference(wanted, probe(told(u), points), points) == ""
    assert "mean" in difference(probe(told(0.38), points), found, points)


def test_what_differs_is_named():
    points = np.array([[0.0, 1.0, 2.0], [0.3, -0.4, 0.6]])
    one = {"drift": np.array([[0.1], [0.2], [np.nan]]), "diffusion": np.ones((3, 1, 1))}
    assert difference(one, dict(one), points) == ""
    less = {"drift": one["drift"]}
    assert difference(one, less, points) == "its diffusion is there in only one of them"
    assert difference(less, one, points) == "its diffusion is there in only one of them"
    wide = {**one, "drift": np.ones((3, 2))}
    assert difference(one, wide, points) == "its drift has shape (3, 2), not (3, 1)"
    gap = {**one, "drift": np.array([[0.1], [np.nan], [np.nan]])}
    wanted = "its drift has a value in only one of them at some points"
    assert difference(one, gap, points) == wanted
    other = {**one, "drift": np.array([[0.1], [0.25], [np.nan]])}
    assert difference(one, other, points) == "its drift differs by up to 0.05 of 0.2"
    infinite = {**one, "drift": np.array([[0.1], [0.2], [np.inf]])}
    assert "drift" in difference(one, infinite, points)
    assert difference(infinite, dict(infinite), points) == ""
