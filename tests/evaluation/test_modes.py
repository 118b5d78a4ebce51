"""Evaluation of filters of switching systems: wrong modes, totals, windows, what filters get."""

import numpy as np
import pytest

from seedslib import zoo
from seedslib.base.blocks import as_seed_sequence, child
from seedslib.evaluation import compare, evaluate
from seedslib.evaluation.scoring import FILTERS
from seedslib.filters import Estimates, KnownModeFilter, RaoBlackwellFilter

TIMES = np.arange(6.0)


@pytest.fixture(scope="module")
def target():
    return zoo.manoeuvring_target("noisy")


class Guess:
    """Estimates zero, and decides the mode that the indicator shows."""

    takes = ("indicators",)

    def __init__(self, system, components=2):
        self.system, self.components = system, components

    def run(self, times, measurements, *, indicators):
        mean = np.zeros((len(times), self.components, measurements.shape[2]))
        return Estimates(mean, modes=indicators)


class Silent:
    """Estimates zero and decides nothing."""

    def run(self, times, measurements):
        return Estimates(np.zeros((len(times), 2, measurements.shape[2])))


def test_errors_are_those_of_the_paths(target):
    """Recomputed by hand from the same simulated blocks of 2048 and 452 paths."""
    filters = {"guess": Guess(target), "drawn": RaoBlackwellFilter(target, 4)}
    found = compare(filters, target, TIMES, 2500, 5, window=(2, 4))
    errors = {name: [] for name in filters}
    wrong = {name: [] for name in filters}
    for stream, count in zip(as_seed_sequence(5).spawn(2), (2048, 452), strict=True):
        data = target.simulate(TIMES, count, stream)
        for name, filter in filters.items():
            own = {"seed": child(stream, FILTERS, 1)} if name == "drawn" else {}
            got = filter.run(TIMES, data.measurements, indicators=data.indicators, **own)
            errors[name].append((got.mean - data.states) ** 2)
            wrong[name].append((got.modes != data.modes).astype(float))
    errors = {name: np.concatenate(part, axis=2) for name, part in errors.items()}
    wrong = {name: np.concatenate(part, axis=1) for name, part in wrong.items()}
    root = np.sqrt(2500)
    for name, row in found.items():
        square, miss = errors[name], wrong[name]
        np.testing.assert_allclose(row.mode_error, miss.mean(axis=1), rtol=1e-12)
        np.testing.assert_allclose(row.mode_error_error, miss.std(axis=1) / root, rtol=1e-9)
        late = miss[2:5].mean(axis=0)
        assert row.average_mode_error == pytest.approx(late.mean(), rel=1e-12)
        assert row.average_mode_error_error == pytest.approx(late.std() / root, rel=1e-9)
        total = square.sum(axis=1)
        np.testing.assert_allclose(row.total, np.sqrt(total.mean(axis=1)), rtol=1e-12)
        np.testing.assert_allclose(
            row.total_error, total.std(axis=1) / root / (2 * row.total), rtol=1e-9
        )
        late = total[2:5].mean(axis=0)
        assert row.average_total == pytest.approx(np.sqrt(late.mean()), rel=1e-12)
        spread = late.std() / root / (2 * row.average_total)
        assert row.average_total_error == pytest.approx(spread, rel=1e-9)
        np.testing.assert_allclose(row.average, np.sqrt(square[2:5].mean(axis=(0, 2))), rtol=1e-12)
    apart = found.difference("guess", "drawn")
    gap = wrong["guess"] - wrong["drawn"]
    np.testing.assert_allclose(apart.mode, gap.mean(axis=1), atol=1e-14)
    np.testing.assert_allclose(apart.mode_error, gap.std(axis=1) / root, rtol=1e-9)
    late = gap[2:5].mean(axis=0)
    assert apart.average_mode == pytest.approx(late.mean(), rel=1e-9)
    assert apart.average_mode_error == pytest.approx(late.std() / root, rel=1e-9)
    gap = (errors["guess"] - errors["drawn"]).sum(axis=1)
    np.testing.assert_allclose(apart.square, gap.mean(axis=1), rtol=1e-9)
    np.testing.assert_allclose(apart.square_error, gap.std(axis=1) / root, rtol=1e-7)
    late = gap[2:5].mean(axis=0)
    assert apart.average_square == pytest.approx(late.mean(), rel=1e-9)
    assert apart.average_square_error == pytest.approx(late.std() / root, rel=1e-7)
    assert "wrong mode 0." in str(found)


def test_filters_that_decide_nothing_have_no_mode_error(target):
    found = compare({"guess": Guess(target), "silent": Silent()}, target, TIMES, 200, 1)
    assert found["silent"].mode_error is None
    assert found["silent"].average_mode_error is None
    # the indicator is wrong with probability 0.1 or 0.2
    assert 0.1 < found["guess"].average_mode_error < 0.2
    apart = found.difference("guess", "silent")
    assert apart.mode is None
    assert apart.average_square == 0
    assert str(found).splitlines()[2].count("wrong") == 0


def test_systems_without_modes_have_none():
    system = zoo.linear_gaussian()

    class Still:
        def run(self, times, measurements):
            return Estimates(np.zeros((len(times), 2, measurements.shape[2])))

    found = compare({"a": Still(), "b": Still()}, system, [0.0, 0.5], 50, 1, step=0.1)
    assert found["a"].mode_error is None
    assert found.difference("a", "b").mode is None
    np.testing.assert_allclose(found["a"].total, np.sqrt((found["a"].rms ** 2).sum(axis=1)))


def test_filters_get_indicators_and_modes_where_they_take_them(target):
    """A filter for a system without an indicator gets none, one with known modes gets them."""
    blind = zoo.manoeuvring_target("none")
    filters = {
        "known": KnownModeFilter(target),
        "blind": RaoBlackwellFilter(blind, 8),
        "blind, known": KnownModeFilter(blind),
        "seeing": RaoBlackwellFilter(target, 8),
    }
    found = compare(filters, target, TIMES, 400, 2)
    assert found["known"].average_mode_error == 0
    apart = found.difference("known", "blind, known")
    assert apart.average_square == pytest.approx(0, abs=1e-12)
    assert found["seeing"].average_mode_error < found["blind"].average_mode_error


def test_windows_say_the_same_in_three_ways(target):
    mask = np.zeros(6, bool)
    mask[2:] = True
    ways = [slice(2, None), mask, (2, 5), (2, -1), (2, None)]
    rows = [evaluate(Guess(target), target, TIMES, 100, 3, window=w) for w in ways]
    for row in rows[1:]:
        assert row.average_mode_error == rows[0].average_mode_error
        np.testing.assert_array_equal(row.average, rows[0].average)
    whole = evaluate(Guess(target), target, TIMES, 100, 3)
    np.testing.assert_array_equal(whole.rms, rows[0].rms)
    assert whole.average_mode_error == pytest.approx(whole.mode_error.mean())


@pytest.mark.parametrize(
    ("window", "message"),
    [
        ((6, 9), "window: wanted at least one of 6 times, got none"),
        (np.ones(5, bool), r"window: wanted a mask of shape \(6,\)"),
        ([7], "window: wanted indices from 0 to 5"),
    ],
)
def test_bad_windows(target, window, message):
    with pytest.raises(ValueError, match=message):
        evaluate(Guess(target), target, TIMES, 10, 3, window=window)
