"""What does not fit in filters of tables or of regressions, by the names of its parts."""

import re
from dataclasses import replace

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base.tables import Axis, Labels
from seedslib.design import grid_synthesis, minimax_synthesis
from seedslib.designed import Memory, TableFilter
from seedslib.designed.outputs.lookup import Output, Step, Table
from seedslib.designed.outputs.minimax import BoundedFit, BoundedPolynomial, Minimax, MinimaxFit
from seedslib.designed.outputs.patterns import ByPattern
from seedslib.designed.prediction import Design, Prediction
from seedslib.models import DiscreteSystem, Noise, StochasticMap

TIMES = np.arange(3.0)


def put(parts, k, part):
    return (*parts[:k], part, *parts[k + 1 :])


def refused(message, kind=ValueError):
    return pytest.raises(kind, match=f"^{message}")


# Tables


@pytest.fixture(scope="module")
def table():
    axes = {"x": (-5, 5, 31), "z": (-3, 3, 9), "y": (-12, 12, 25)}
    return grid_synthesis(zoo.flip_process(), Memory(2), [0.0, 0.25, 0.5], **axes, nodes=1)


@pytest.mark.filterwarnings("ignore:y. the axes miss")
def test_tables_of_another_shape(table):
    """Named by their step, by what they look at, and by the interval of their node."""

    def make(**changes):
        return replace(table, **changes)

    steps, nodes = table.steps, table.node_fits
    wide = [np.ones((2, *fit.estimate.shape[1:])) for fit in (steps[1].shown, steps[1].blind)]
    for name, bad in (
        ("shown", Step(steps[1].shown._replace(estimate=wide[0]), steps[1].blind)),
        ("blind", Step(steps[1].shown, steps[1].blind._replace(estimate=wide[1]))),
    ):
        with refused(rf"steps\[1\]\.{name}\.estimate: wanted shape \(1, "):
            make(steps=put(steps, 1, bad))
    for k, name in ((0, "shown"), (2, "blind"), (2, "shown")):
        bad = steps[k]._replace(**{name: getattr(steps[1], name)})
        with refused(rf"steps\[{k}\]\.{name} has other axes than the memory 2 estimates"):
            make(steps=put(steps, k, bad))
    bad = put(nodes, 1, nodes[0])
    with refused(r"node_fits\[1\] has other axes than the memory"):
        make(node_fits=bad)
    with refused("steps: wanted 3, got 2"):
        make(steps=steps[:2])
    shape = r"covariances: wanted shape \(3, 1, 1\), got"
    with refused(shape):
        make(covariances=table.covariances[:2])
    nan = np.full((1, 1), np.nan)
    with refused("covariances: wanted finite numbers"):
        make(covariances=np.stack([nan] * 3))
    with refused(r"changes: wanted shape \(2, 3\), got \(2, 2\)"):
        make(changes=np.ones((2, 2)))
    make(changes=np.full((2, 3), np.nan))
    with refused("node_times, node_fits: wanted 2 intervals"):
        make(node_times=table.node_times[:1], node_fits=nodes[:1])
    three = (*nodes, nodes[1])
    with refused("node_times, node_fits: wanted 2 intervals"):
        make(node_times=(*table.node_times, np.array([0.7])), node_fits=three)
    with refused("between: wanted one of interpolated"):
        make(between="cubic")
    for name in ("shown", "blind"):
        bad = put(steps, 1, steps[1]._replace(**{name: 0.5}))
        with refused(rf"steps\[1\]\.{name}: wanted something with __call__, got float", TypeError):
            make(steps=bad)


def test_tables_of_modes_have_them():
    """Decisions of two modes and their probabilities, in tables of estimates and indicators."""
    labels, axis = Labels(3), Axis(-1.0, 1.0, 4)

    def of(*axes, modes=True):
        shape = tuple(axis.count for axis in axes)
        mode = np.zeros(shape, np.int8) if modes else None
        return Table(axes, np.zeros((1, *shape)), mode, np.full((2, *shape), 0.5))

    held = Labels(2), axis
    steps = Step(of(labels, axis), of(labels)), Step(of(labels, axis, *held), of(labels, *held))
    system = zoo.dependent_switching()
    predicted = Prediction(TIMES[:2], np.ones((2, 1)), np.zeros((2, 1)))

    def make(k, **changes):
        given = put(steps, k, steps[k]._replace(**changes))
        return TableFilter(system, Memory(1), TIMES[:2], given, "hand", predicted,
                           np.ones((2, 1, 1)), Design(0, 0, None, (), exact=True))  # fmt: skip

    assert make(0).order == 2
    first, second = steps[0].shown, steps[1].shown
    with refused(r"steps\[0\]\.shown\.prob: wanted shape \(2, 3, 4\), got"):
        make(0, shown=first._replace(prob=np.ones((3, 3, 4))))
    with refused(r"steps\[0\]\.shown\.mode: wanted the decided modes, got none"):
        make(0, shown=first._replace(mode=None))
    with refused(r"steps\[1\]\.shown\.mode: a number that is no mode"):
        make(1, shown=second._replace(mode=second.mode + np.int8(2)))
    axes, bare = (labels, axis, *held), second._replace(mode=None)
    assert ByPattern((second,)).check("t.shown", axes, 0, 1, 2, Memory(1)) is None
    with refused(r"t\.shown\.tables\[0\]\.mode: wanted the decided modes, got none"):
        ByPattern((bare,)).check("t.shown", axes, 0, 1, 2, Memory(1))
    with refused(r"steps\[1\]\.blind has other axes than the memory 1 estimate"):
        make(1, blind=of(labels, Labels(3), axis))
    assert make(1, blind=steps[1].blind._replace(mode=None, prob=None)).horizon == 1.0


def test_tables_of_patterns_of_another_shape():
    """Of two components: three tables, each of the components that its number says."""
    first, second = Axis(-1.0, 1.0, 4), Axis(-2.0, 2.0, 3)

    def of(*axes):
        return Table(axes, np.zeros((1, *(axis.count for axis in axes))))

    held = Labels(2)
    good = ByPattern((of(first, held), of(second, held), of(first, second, held)))
    axes = first, second, held
    good.check("t", axes, 0, 1, 0, Memory(1))
    ByPattern((None, good.tables[1], None)).check("t", axes, 0, 1, 0, Memory(1))
    for k in range(3):
        bad = good.tables[k]._replace(estimate=np.zeros(7))
        with refused(rf"t\.tables\[{k}\]\.estimate: wanted shape \(1, "):
            ByPattern(put(good.tables, k, bad)).check("t", axes, 0, 1, 0, Memory(1))
    swapped = ByPattern((of(held, first), *good.tables[1:]))
    with refused(r"t\.tables\[0\] has other axes than the memory 1 estimate"):
        swapped.check("t", axes, 0, 1, 0, Memory(1))
    with refused(r"t: wanted 2\^m - 1 tables, got 2"):
        ByPattern(good.tables[:2]).check("t", axes, 0, 1, 0, Memory(1))


@pytest.mark.filterwarnings("ignore:y. the axes miss")
def test_tables_of_patterns_of_a_system_without_modes_have_none(table):
    """Of one component there is one pattern, and the table of it."""
    steps = table.steps
    shown = steps[1].shown

    def make(shown):
        pattern = Step(ByPattern((shown,)), steps[1].blind)
        return replace(table, steps=put(steps, 1, pattern))

    assert make(shown).steps[1].shown.fullest is shown
    with refused(r"steps\[1\]\.shown\.tables\[0\]\.mode: a number that is no mode"):
        make(shown._replace(mode=np.zeros(shown.estimate.shape[1:], np.int8)))
    with refused(r"steps\[1\]\.shown\.tables\[0\]\.estimate: wanted shape"):
        make(shown._replace(estimate=np.zeros(3)))
    with refused(r"steps\[1\]\.shown: wanted 1 tables"):
        replace(table, steps=put(steps, 1, Step(ByPattern((shown,) * 3), steps[1].blind)))


def test_a_table_of_what_was_found_at_all_nodes():
    """In the order of the axes; probabilities of the modes where they are wanted."""
    axes = Axis(0.0, 1.0, 3), Labels(2)
    found = Output(np.arange(6.0), np.array([0, 1, 1, 0, 1, 0]), np.arange(12.0).reshape(2, 6))
    made = Table.of(axes, found)
    assert made.axes is axes
    np.testing.assert_array_equal(made.estimate, [[[0, 1], [2, 3], [4, 5]]])
    np.testing.assert_array_equal(made.mode, [[0, 1], [1, 0], [1, 0]])
    assert made.prob is None
    more = Table.of(axes, found, True)
    np.testing.assert_array_equal(more.prob, np.arange(12.0).reshape(2, 3, 2))
    bare = Table.of(axes, Output(np.arange(6.0)), True)
    assert bare.mode is bare.prob is None


# Regressions


def test_words_for_how_a_filter_was_regressed():
    text = "conditionally minimax regression on {}, then on {}"
    for prediction, first in ((None, "the mean of the dynamics"), (min, "a given function")):
        for correction, second in (
            (None, "the residual"),
            (max, "a given function"),
            (BoundedPolynomial(2), "bounded polynomials of degree 2"),
        ):
            assert str(Minimax(prediction, correction)) == text.format(first, second)


p, v, w = sympy.symbols("p v w", real=True)


@pytest.fixture(scope="module")
def regressed():
    walk = DiscreteSystem(
        StochasticMap([p], [0.9 * p + v / 2], Noise((v,))),
        StochasticMap([p], [p + w], Noise((w,))), [0.0], [[1.0]],
    )  # fmt: skip
    return {
        bounded: minimax_synthesis(walk, Memory(1), TIMES, paths=400, seed=1,
                                   correction=BoundedPolynomial(2) if bounded else None)
        for bounded in (False, True)
    }  # fmt: skip


def test_regressions_of_another_shape(regressed):
    for bounded, filter in regressed.items():
        inner = 3 if bounded else 1
        for k, fit in enumerate(filter.fits):
            for name, size in (("forecast", min(k, 1)), ("correction", inner)):
                shapes = {"gain": f"(1, {size})", "offset": "(1)", "cov": "(1, 1)"}
                for part, shape in shapes.items():
                    bad = getattr(fit, name)._replace(**{part: np.ones((4, 5))})
                    if part == "gain":  # a wrong number of columns alone
                        bad = bad._replace(gain=np.ones((1, 6)))
                    fits = put(filter.fits, k, fit._replace(**{name: bad}))
                    with refused(re.escape(f"fits[{k}].{name}.{part}: wanted shape {shape}, got")):
                        replace(filter, fits=fits)
            bad = fit.correction._replace(cov=-np.eye(1))
            fits = put(filter.fits, k, fit._replace(correction=bad))
            with refused("fits: wanted positive semidefinite"):
                replace(filter, fits=fits)
    plain, other = regressed[False], regressed[True]
    fits = put(plain.fits, 1, plain.fits[1]._replace(bounded=other.fits[1].bounded))
    with refused(r"fits\[1\]\.bounded: wanted with bounded polynomials, and only there"):
        replace(plain, fits=fits)
    fits = put(other.fits, 2, other.fits[2]._replace(bounded=None))
    with refused(r"fits\[2\]\.bounded: wanted with bounded polynomials, and only there"):
        replace(other, fits=fits)
    fit = other.fits[1]
    for part, shape in (("values", "(2, 1)"), ("states", "(2, 1)")):
        bad = fit._replace(bounded=fit.bounded._replace(**{part: np.ones((3, 1))}))
        with refused(re.escape(f"fits[1].bounded.{part}: wanted shape {shape}, got (3, 1)")):
            replace(other, fits=put(other.fits, 1, bad))
    powers = fit.bounded.powers._replace(centre=np.ones(5))
    bad = fit._replace(bounded=fit.bounded._replace(powers=powers))
    with refused(re.escape("fits[1].bounded.powers.centre: wanted shape (2), got (5,)")):
        replace(other, fits=put(other.fits, 1, bad))


def test_a_bounded_polynomial_stays_within_what_it_has_been(regressed):
    """Beyond the measurements of the design it is constant, and so is the range of estimates."""
    filter = regressed[True]
    fit = filter.fits[1]
    assert isinstance(fit, MinimaxFit)
    assert isinstance(fit.bounded, BoundedFit)
    low, high = fit.bounded.values[:, 0]
    points = np.array([[0.3, -9.0, 0.1], [0.2, 40.0, -70.0]])
    raw = fit.bounded.powers.mean(points)
    np.testing.assert_array_equal(fit.bounded(points), np.clip(raw, low, high))
    state = filter.step(filter.initial((2,)), 0.0, np.array([[0.1, -0.4]]))
    far = filter.step(state, 1.0, np.array([[900.0, -900.0]])).mean
    np.testing.assert_array_equal(far, fit.bounded.states[::-1].T)
    near = filter.step(state, 1.0, np.array([[0.2, -0.3]])).mean[0]
    xi = 0.9 * state.mean
    forecast = fit.forecast.gain @ xi + fit.forecast.offset[:, None]
    y = np.array([[0.2, -0.3]])
    zeta = np.concatenate([forecast, y, fit.bounded(np.concatenate([xi, y]))])
    wanted = forecast + fit.correction.gain @ zeta + fit.correction.offset[:, None]
    np.testing.assert_allclose(near, wanted[0], rtol=1e-12)
