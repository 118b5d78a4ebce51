"""What a design says of itself: errors on other paths, and what it warns of, number by number."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
import sympy

from seedslib import zoo
from seedslib.design import synthesize
from seedslib.design.paths import held_out
from seedslib.design.paths.held_out import _by_chance, _findings, _reach, _tail, forecast_errors
from seedslib.design.tables.carriers import Carriers, prediction_of
from seedslib.design.tables.simulated import _about, _axes
from seedslib.designed import Memory
from seedslib.designed.outputs.lookup import Output
from seedslib.designed.prediction import HeldOut, Prediction
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

TIMES = np.array([0.0, 0.5, 1.0, 1.5])
STATE = np.array([[50.0, 2.0]] * 4)
RMS = np.array([[0.5, 0.3], [0.4, 0.3], [0.35, 0.25], [0.3, 0.2]])
ERROR = 0.01 * RMS
NODES = Prediction(np.linspace(0, 1.5, 7), np.repeat(RMS, 2, axis=0)[:7], np.full((7, 2), 0.004))
# nodes lie between; rows 0, 2, 4, 6 are those of the measurements
PREDICTED = NODES._replace(rms=np.repeat(RMS, 2, axis=0)[:7] * np.array([[1, 9] * 4])[0, :7, None])


def found(rms=RMS, share=1.0, forecasts=None, astray=False, deviation=4.0, **changes):
    """Sentences on held-out errors, beside predictions that they agree with."""
    held = HeldOut(TIMES, rms, ERROR, np.full((4, 2), deviation), 2000, 3)
    held = held._replace(**changes)
    return list(_findings(PREDICTED, held, STATE, share, forecasts, astray))


def test_errors_as_predicted_are_no_news():
    assert found() == []
    assert found(RMS + 0.015) == []  # within the doubt: 4 standard errors and more
    # few design paths: the standard error on as many as the held-out ones is what counts
    assert found(RMS + 0.1)
    assert found(RMS + 0.1, share=10.0) == []


@pytest.mark.parametrize("change", [0.1, -0.1])
def test_other_errors_than_predicted(change):
    rms = RMS.copy()
    rms[1, 1] += change
    rms[2, 1] += 0.5 * change
    (text,) = found(rms)
    shown = rms[1, 1] if change > 0 else rms[2, 1]
    assert text.startswith("held out: root-mean-square errors on 2000 other paths")
    assert "at 2 of 4 times from 0.5 to 1 (component 1), most of component 1" in text
    wanted = max(((k, rms[k, 1] / RMS[k, 1]) for k in (1, 2)), key=lambda pair: pair[1])[0]
    told = f"at time {TIMES[wanted]:g}: {rms[wanted, 1]:.4g} ± {ERROR[wanted, 1]:.2g} for "
    assert told + f"{RMS[wanted, 1]:.4g}" in text
    assert shown


def test_several_components_are_named():
    (text,) = found(RMS * np.array([1.5, 1.3]))
    assert "at 4 of 4 times from 0 to 1.5 (components 0, 1), most of component 0" in text


def test_small_differences_are_none():
    """Two parts in a hundred, however sure; and what is rounding beside the state."""
    held = HeldOut(TIMES, RMS * 1.019, 1e-9 * RMS, np.full((4, 2), 4.0), 2000, 0)
    exact = PREDICTED._replace(error=0.0 * PREDICTED.error)
    assert list(_findings(exact, held, STATE, 1.0, None, False)) == []
    assert list(_findings(exact, held._replace(rms=RMS * 1.021), STATE, 1.0, None, False))
    tiny = exact._replace(rms=1e-12 * exact.rms)
    held = held._replace(rms=2e-9 * STATE[0] * [1, 1] / 4 * np.ones((4, 2)), error=1e-15 * RMS)
    assert list(_findings(tiny, held, STATE, 1.0, None, False)) == []
    assert list(_findings(tiny, held._replace(rms=3.0 * held.rms), STATE, 1.0, None, False))


def test_worse_than_a_constant():
    texts = found(deviation=0.25)
    assert len(texts) == 1
    assert "worse than the mean of the state, a constant, at 4 of 4 times" in texts[0]
    assert "for 0.25" in texts[0]
    assert found(deviation=0.49) == []  # not beyond the doubt of both


def test_worse_than_the_forecasts():
    """A quarter of the corrections may be."""
    forecasts = RMS * 1.2
    assert found(forecasts=forecasts) == []
    forecasts[0], forecasts[2, 0] = np.nan, RMS[2, 0] / 2
    (text,) = found(forecasts=forecasts)
    assert "worse than the forecast that it corrects" in text
    assert "at 1 of 4 times from 1 to 1 (component 0)" in text
    forecasts = np.vstack([np.full((1, 2), np.nan), RMS[1:]])
    assert found(forecasts=forecasts) == []


def test_lost_paths():
    (text,) = found(astray=True)
    assert "the filter diverged on 3 of 2000 other paths" in text


def test_modes():
    rate, error = np.array([0.2, 0.1, 0.05, 0.02]), np.array([0.009, 0.007, 0.005, 0.003])
    predicted = PREDICTED._replace(mode_rate=rate, mode_error=error)
    modes = {"mode_rate": rate + np.array([0.0, 0.0, -0.04, 0.06]), "mode_error": error}
    held = HeldOut(TIMES, RMS, ERROR, np.full((4, 2), 4.0), 2000, 0, **modes)
    (text,) = _findings(predicted, held, STATE, 1.0, None, False)
    assert "the part of wrong modes on 2000 other paths" in text
    assert "at 2 of 4 times, most at time 1.5: 0.08 ± 0.003 for 0.02" in text
    assert list(_findings(predicted, held, STATE, 20.0, None, False)) == []
    held = held._replace(mode_rate=rate * 1.019, mode_error=0 * error)
    exact = predicted._replace(mode_error=0 * error)
    assert list(_findings(exact, held, STATE, 1.0, None, False)) == []


def test_stray_paths_by_chance():
    for count, mean in ((1, 0.3), (3, 0.3), (5, 2.5), (0, 1.0)):
        assert _tail(count, mean) == pytest.approx(scipy.stats.poisson.sf(count - 1, mean))
    # of 0.3 expected beyond 1: one is chance, one at 3 is not likely but may be, one at 9 is not
    assert _by_chance(np.array([]), 0.3)
    assert _by_chance(np.array([1.5]), 0.3)
    assert _by_chance(np.array([3.0]), 0.3)  # 0.3 / 81 = 0.0037
    assert not _by_chance(np.array([9.0]), 0.3)  # 0.3 / 6561 = 5e-5
    assert not _by_chance(np.array([1.1, 9.0]), 0.3)  # the largest first, whatever the order
    assert not _by_chance(np.full(4, 1.2), 0.3)  # P(at least 4) of 0.14
    assert _by_chance(np.full(2, 1.2), 0.3)
    assert not _by_chance(np.array([1.8, 1.8, 1.8]), 0.3)


def test_reach_of_an_error():
    """(N m C)^(1/4), with the mean fourth power m of a normal error by its standard errors."""
    paths = 900
    error = RMS / math.sqrt(2 * paths)  # of a normal law: m = 3 rms^4
    filter = SimpleNamespace(times=TIMES, predicted=Prediction(TIMES, RMS, error))
    wanted = (paths * RMS.size * 3.0 * RMS**4) ** 0.25
    np.testing.assert_allclose(_reach(filter, paths), wanted, rtol=1e-12)


def test_blocks_of_held_out_paths(monkeypatch):
    """Their sizes add up, and what they find is what one block finds of all of them."""
    sizes = []
    own = held_out._block

    def counted(filter, stream, count, *rest):
        sizes.append(count)
        return own(filter, stream, count, *rest)

    monkeypatch.setattr(held_out, "_block", counted)
    monkeypatch.setattr(held_out, "BLOCK", 300)
    filter = synthesize(zoo.linear_gaussian(), Memory(1), Taylor(), TIMES[:2], paths=800, seed=1,
                        nodes=0)  # fmt: skip
    assert sizes == [300, filter.held_out.paths - 300]
    assert 0 < sizes[1] < 300
    wanted = np.sqrt(np.diagonal(filter.fits[0].cov))
    np.testing.assert_allclose(forecast_errors(filter)[1], wanted, rtol=1e-14)
    assert np.isnan(forecast_errors(filter)[0]).all()


# Tables on paths


@pytest.fixture(scope="module")
def carriers():
    flip = zoo.flip_process()

    def made(system=flip, sets=2, **changes):
        arguments = {"times": TIMES, "components": None, "paths": 40, "nodes": 1, "seed": 3,
                     "workers": 1, **changes}  # fmt: skip
        return Carriers(system, Memory(1), sets=sets, **arguments)

    return made


@pytest.mark.parametrize("sets", [2, 3])
def test_functions_are_examined_on_the_set_after_their_own(carriers, sets):
    given = carriers(sets=sets)
    for k in range(4):
        lesson = given.lesson()
        own, after = given.sets[k % sets], given.sets[(k + 1) % sets]
        np.testing.assert_array_equal(lesson.states, own.states[TIMES[k]])
        np.testing.assert_array_equal(lesson.measurements, own.measurements[k])
        given.take(lambda points: Output(0.3 * points[0][None]))
        square = (after.states[TIMES[k]] - 0.3 * after.measurements[k]) ** 2
        assert given.scores[-1][0] == TIMES[k]
        np.testing.assert_allclose(given.scores[-1][1], square, rtol=1e-13)
        np.testing.assert_allclose(given.errors[-1], [[square.mean()]], rtol=1e-13)
        for which in range(sets):
            shown = 0.3 * given.sets[which].measurements[k]
            np.testing.assert_array_equal(given.past(which).vector, shown)
        if k < 3:
            node = given.stops[k][0]
            ahead = given.forecast_lesson(node)
            taught, tried = given.sets[(k + 1) % sets], given.sets[(k + 2) % sets]
            np.testing.assert_array_equal(ahead.states, taught.states[node])
            assert ahead.measurements is None
            given.score(node, lambda points: Output(0.5 * points[0][None]))
            square = (tried.states[node] - 0.15 * tried.measurements[k]) ** 2
            np.testing.assert_allclose(given.scores[-1][1], square, rtol=1e-13)
    predicted = given.prediction()
    assert predicted.times.tolist() == np.linspace(0.0, 1.5, 7).tolist()
    assert given.covariances.shape == (4, 1, 1)


def test_a_function_of_nothing_fills_the_paths(carriers):
    given = carriers()
    given.take(lambda points: Output(np.array([0.7])))
    assert given.past(0).vector.shape == given.past(1).vector.shape == (1, 40)
    square = (given.sets[1].states[0.0] - 0.7) ** 2
    np.testing.assert_allclose(given.scores[0][1], square, rtol=1e-14)
    np.testing.assert_allclose(given.covariances, [[[square.mean()]]], rtol=1e-14)


def test_scores_are_errors_with_standard_errors():
    squares = np.array([[1.0, 4.0, 2.5, 0.5], [0.0, 0.0, 0.0, 0.0]])
    found = prediction_of([(0.7, squares)], [np.array([True, False, False, True, False])])
    mean = squares[0].mean()
    assert found.rms.tolist() == [[math.sqrt(mean), 0.0]]
    standard = squares[0].std() / 2.0 / (2.0 * math.sqrt(mean))
    np.testing.assert_allclose(found.error, [[standard, 0.0]], rtol=1e-14)
    assert found.mode_rate == 0.4
    assert found.mode_error == pytest.approx(math.sqrt(0.4 * 0.6 / 5))
    assert not found.in_sample
    assert prediction_of([(0.7, squares)], [], in_sample=True).in_sample


def test_axes_are_laid_about_the_paths(carriers):
    """A tenth of the range beyond either end, for each component its own."""
    given = carriers()
    y, z = _axes(given, None, None)
    shown = given.sets[0].measurements
    (axis,) = y
    reach = 0.1 * np.ptp(shown)
    np.testing.assert_allclose([axis.low, axis.high], [shown.min() - reach, shown.max() + reach])
    assert axis.count == z[0].count == 201
    states = np.concatenate([given.sets[0].states[t] for t in TIMES], axis=1)
    reach = 0.1 * np.ptp(states)
    np.testing.assert_allclose([z[0].low, z[0].high], [states.min() - reach, states.max() + reach])
    given.memory = Memory(2)
    assert _axes(given, None, None)[0][0].count == 81
    # more arguments: as many nodes as a table has room for, and at least seven
    given.memory = Memory(3)
    assert _axes(given, None, None)[0][0].count == int((1 << 25) ** 0.225)
    given.memory = Memory(9)
    assert _axes(given, None, None)[0][0].count == 7
    assert _about(np.array([3.0, 3.0]), 5).high == pytest.approx(3.0 + 3e-9, rel=1e-15)
    assert (_about(np.zeros(2), 5).low, _about(np.zeros(2), 5).high) == (-1.0, 1.0)


def test_axes_of_a_sensor_of_two_components(carriers):
    p, q, a, b, r, s = sympy.symbols("p q a b r s")
    moves = StochasticMap([p, q], [p + q / 2 + a, q - p / 3 + b], Noise((a, b)))
    sensor = StochasticMap([p, q], [p + r, 5 * q + s], Noise((r, s)))
    system = DiscreteSystem(moves, sensor, [1.0, -2.0], [[1.0, 0.2], [0.2, 2.0]])
    given = carriers(system, times=TIMES[:3], nodes=0)
    y, z = _axes(given, None, None)
    shown = given.sets[0].measurements
    assert len(y) == given.system.measurement_size == 2
    assert len(z) == given.system.state_size
    for axis, part in zip(y, shown.swapaxes(0, 1), strict=True):
        assert axis.low == pytest.approx(part.min() - 0.1 * np.ptp(part))
        assert axis.high == pytest.approx(part.max() + 0.1 * np.ptp(part))
    for i, axis in enumerate(z):
        part = np.array([given.sets[0].states[t][i] for t in TIMES[:3]])
        assert axis.low == pytest.approx(part.min() - 0.1 * np.ptp(part))
