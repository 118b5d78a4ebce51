"""Parts that do not fit in a filter of finite order, and arguments that it refuses, by name."""

from dataclasses import replace

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import Continuous, Polynomial, synthesize
from seedslib.designed import Memory
from seedslib.designed.shapes import check_array, check_errors, check_nodes, check_start
from seedslib.linearization import Taylor

TIMES = np.arange(3.0)
WRONG = np.ones((4, 9))


def design(memory, **options):
    return synthesize(
        zoo.linear_gaussian(), memory, Taylor(), TIMES, paths=500, seed=1, step=0.25, **options
    )


@pytest.fixture(scope="module")
def plain():
    return design(Memory(2, 1), nodes=1, horizon=2.5)


def put(parts, k, part):
    return (*parts[:k], part, *parts[k + 1 :])


def refused(filter, message, kind=ValueError, **changes):
    with pytest.raises(kind, match=f"^{message}"):
        replace(filter, **changes)


SHAPES = {"gain": r"\(2, {}\)", "offset": r"\(2\)", "cov": r"\(2, 2\)"}


@pytest.mark.parametrize("part", SHAPES)
def test_forecasts_of_another_shape(plain, part):
    """U_0 holds 2 + 1 numbers, all later ones 4 + 1."""
    for k, size in enumerate((3, 5)):
        bad = plain.fits[k]._replace(**{part: WRONG})
        shape = SHAPES[part].format(size)
        refused(plain, rf"fits\[{k}\]\.{part}: wanted shape {shape}, got",
                fits=put(plain.fits, k, bad))  # fmt: skip
    for k, size in enumerate((3, 5, 5)):
        bad = plain.node_fits[k][-1]._replace(**{part: WRONG})
        shape = SHAPES[part].format(size)
        row = put(plain.node_fits[k], len(plain.node_fits[k]) - 1, bad)
        refused(plain, rf"node_fits\[{k}\]\[{len(row) - 1}\]\.{part}: wanted shape {shape}, got",
                node_fits=put(plain.node_fits, k, row))  # fmt: skip


def test_forecasts_of_another_number_or_kind(plain):
    refused(plain, "fits: wanted 2, got 1", fits=plain.fits[:1])
    refused(plain, "fits: wanted 2, got 3", fits=(*plain.fits, plain.fits[1]))
    one, two = plain.node_fits[0], plain.node_fits[2]
    refused(plain, r"node_fits\[0\]: wanted 1, got 2", node_fits=put(plain.node_fits, 0, one * 2))
    refused(plain, r"node_fits\[2\]: wanted 2, got 1", node_fits=(one, one, two[:1]))
    refused(plain, "node_times, node_fits: wanted 2 intervals, or one more for a horizon, got 3 "
            "and 2", node_fits=plain.node_fits[:2])  # fmt: skip
    what = "wanted something with forecast, got float"
    refused(plain, rf"fits\[1\]: {what}", TypeError, fits=put(plain.fits, 1, 0.5))
    refused(plain, rf"node_fits\[1\]\[0\]: {what}", TypeError,
            node_fits=put(plain.node_fits, 1, (0.5,)))  # fmt: skip
    bad = plain.node_fits[2][1]
    bad = put(plain.node_fits, 2, (two[0], bad._replace(cov=-np.eye(2))))
    refused(plain, "fits: wanted positive semidefinite covariances", node_fits=bad)
    bad = put(plain.fits, 1, plain.fits[1]._replace(cov=-np.eye(2)))
    refused(plain, "fits: wanted positive semidefinite covariances", fits=bad)


def test_forecasts_of_nodes_that_see_the_measurement():
    """One of two components is estimated: they look at Z and Y, or at a memory of both."""
    for memory in (Memory(1), Memory(1, 1)):
        made = design(memory, nodes=1, components=1, measured_nodes=True)
        assert made.node_fits[1][0].gain.shape == (1, 2)
        bad = made.node_fits[1][0]._replace(gain=np.ones((2, 2)))
        refused(made, r"node_fits\[1\]\[0\]\.gain: wanted shape \(1, 2\), got \(2, 2\)",
                node_fits=put(made.node_fits, 1, (bad,)))  # fmt: skip


def test_forecasts_of_each_step_of_a_continuous_one():
    """One more than nodes where a measurement follows, as many where none does; of all of X."""
    made = design(Memory(1), predictor=Continuous(), components=1, horizon=2.5)
    assert [len(row) for row in made.node_fits] == [4, 4, 2]
    for k, row in enumerate(made.node_fits):
        refused(made, rf"node_fits\[{k}\]: wanted {len(row)}, got {len(row) - 1}",
                node_fits=put(made.node_fits, k, row[:-1]))  # fmt: skip
    bad = made.node_fits[0][1]._replace(gain=np.ones((1, 1)))
    refused(made, r"node_fits\[0\]\[1\]\.gain: wanted shape \(2, 1\), got \(1, 1\)",
            node_fits=put(made.node_fits, 0, put(made.node_fits[0], 1, bad)))  # fmt: skip


def test_polynomials_of_another_shape():
    """In d = 2 numbers 9 monomials up to degree 3, and 5 up to degree 2; 3 entries of T."""
    made = design(Memory(1), nodes=0, predictor=Polynomial(3, 2))
    shapes = {
        "centre": "(2)", "scale": "(2)", "gain": "(2, 9)", "offset": "(2)", "residual": "(2, 2)",
        "cov_gain": "(3, 5)", "cov_offset": "(3)",
    }  # fmt: skip
    for part, shape in shapes.items():
        bad = made.fits[1]._replace(**{part: np.ones((7, 7))})
        shape = shape.replace("(", r"\(").replace(")", r"\)")
        refused(made, rf"fits\[1\]\.{part}: wanted shape {shape}, got", fits=(made.fits[0], bad))
    # no more monomials are counted than there are gains: 2 times 9 and 3 times 5
    none = r"fits\[1\]: gains that are not those of the degrees \("
    for degrees, message in (
        ({"mean_degree": -1}, none),
        ({"mean_degree": 3.0}, none),
        ({"cov_degree": 34}, none),
        ({"cov_degree": 33}, r"fits\[1\]\.cov_gain: wanted shape \(3, 594\), got \(3, 5\)"),
        ({"mean_degree": 0}, r"fits\[1\]\.gain: wanted shape \(2, 0\), got \(2, 9\)"),
    ):
        refused(made, message, fits=(made.fits[0], made.fits[1]._replace(**degrees)))


def test_a_start_of_another_shape(plain):
    start = plain.start
    for part, shape in (("cov", r"\(2, 2\)"), ("mean", r"\(any\)")):
        refused(plain, rf"start\.{part}: wanted shape {shape}, got",
                start=start._replace(**{part: WRONG}))  # fmt: skip
    for part, shape in (("cov", r"\(1, 1\)"), ("cross", r"\(2, 1\)"), ("mean", r"\(any\)")):
        bad = start.moments._replace(**{part: WRONG})
        refused(plain, rf"start\.moments\.{part}: wanted shape {shape}, got",
                start=start._replace(moments=bad))  # fmt: skip
    refused(plain, "start: wanted positive semidefinite", start=start._replace(cov=-start.cov))
    bad = start.moments._replace(cov=-start.moments.cov)
    refused(plain, "start: wanted positive semidefinite", start=start._replace(moments=bad))
    assert check_start("start", start) == (2, 1)


def test_numbers_and_words_out_of_range(plain):
    refused(plain, "components: wanted 1 to 2, got 0", components=0)
    refused(plain, "components: wanted 1 to 2, got 3", components=3)
    for cycle in (3, -1, 1.0, True):
        refused(plain, f"cycle: wanted 0 to 2 of the steps, got {cycle}", cycle=cycle)
    assert replace(plain, cycle=2).horizon == np.inf
    refused(plain, "between: wanted one of interpolated, piecewise constant", between="cubic")
    refused(plain, "times: wanted an increasing grid, got", times=TIMES[::-1].copy())
    refused(plain, "times: wanted an array of float64, got list", TypeError, times=[0.0, 1.0, 2.0])
    refused(plain, r"times: wanted shape \(any\)", times=TIMES[:, None])
    with pytest.raises(ValueError, match=r"^t: wanted a time from 1 to 2, got 2\.5$"):
        plain.forecast(stepped(plain, 2), 2.5)
    with pytest.raises(ValueError, match=r"^kind: wanted one of .* got 'cubic'$"):
        plain.forecast(stepped(plain, 2), 1.5, "cubic")


def stepped(filter, count):
    state = filter.initial()
    for t in TIMES[:count]:
        state = filter.step(state, t, [0.3])
    return state


def test_nodes_are_numbers_on_one_axis(plain):
    for k in range(3):
        bad = put(plain.node_times, k, plain.node_times[k][:, None])
        refused(plain, rf"node_times\[{k}\]: wanted shape \(any\), got", node_times=bad)
        bad = put(plain.node_times, k, plain.node_times[k] - 0.75)
        refused(plain, rf"node_times\[{k}\]: outside of their interval", node_times=bad)
    # the last interval has no end, the one before it has
    check_nodes(plain, 2, 3)
    bad = put(plain.node_times, 1, np.array([2.25]))
    refused(plain, r"node_times\[1\]: outside of their interval", node_times=bad)
    replace(plain, node_times=put(plain.node_times, 2, np.array([2.25, 99.0])))


def test_what_a_step_is_given(plain):
    """A measurement as an array of floats, or as a list of numbers, and nothing else."""
    state = plain.predict(plain.initial((3,)), 0.0)
    for y, message in (
        (np.zeros((2, 3)), r"y: wanted shape \(1, 3\), got \(2, 3\)"),
        (np.array([[0.0, np.inf, 0.0]]), "y: wanted finite numbers, got inf"),
        ([[0.0, -np.inf, 0.0]], "y: wanted finite numbers, got -inf"),
    ):
        with pytest.raises(ValueError, match=f"^{message}"):
            plain.correct(state, y)
    with pytest.raises(TypeError, match=r"^y: "):
        plain.correct(state, [["a", "b", "c"]])
    with pytest.raises(ValueError, match=r"^indicator: wanted none, the system has no modes"):
        plain.admitted(np.zeros((1, 3)), np.zeros(3, dtype=int), (3,), 0)
    whole = plain.correct(state, np.array([[1.0, 2.0, 3.0]]))
    assert np.array_equal(plain.correct(state, [[1, 2, 3]]).mean, whole.mean)
    hidden = plain.correct(state, np.ma.array([[1.0, 2.0, 3.0]], mask=[[False, True, False]]))
    assert np.array_equal(hidden.mean[:, 1], plain.start.mean)
    assert np.array_equal(hidden.gap, [False, True, False])


def test_errors_that_are_no_numbers_may_be_held(plain):
    """Of a design whose paths diverge; but its times, and arrays of other parts, are numbers."""
    nan = np.full_like(plain.predicted.rms, np.nan)
    held = plain.held_out
    lost = np.full_like(held.rms, np.nan)
    rates = {"mode_rate": nan[:, 0], "mode_error": nan[:, 0]}
    predicted = plain.predicted._replace(rms=nan, error=nan, **rates)
    shares = {"mode_rate": lost[:, 0], "mode_error": lost[:, 0]}
    held = held._replace(rms=lost, error=lost, deviation=lost, **shares)
    check_errors(predicted, held, TIMES, 2)
    made = replace(plain, predicted=predicted._replace(mode_rate=None, mode_error=None))
    assert np.isnan(made.predicted.rms).all()
    times = np.append(predicted.times[:-1], np.nan)
    with pytest.raises(ValueError, match=r"^predicted\.times: wanted finite numbers, got others"):
        check_errors(predicted._replace(times=times), None, TIMES, 2)
    with pytest.raises(ValueError, match=r"^predicted\.times: wanted shape \(any\)"):
        check_errors(predicted._replace(times=times[:, None]), None, TIMES, 2)
    with pytest.raises(ValueError, match=r"^part: wanted finite numbers, got others"):
        check_array("part", lost, None, 2)
