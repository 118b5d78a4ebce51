"""Choice under noise and least values, against plain loops and finite differences."""

import numpy as np
import pytest

from seedslib.pareto import bisect, choose, compromise
from seedslib.pareto.least import box_scan, least_in_box, least_on_segment, minimax_in_box


def relative(values, minimizers):
    """Losses of all choices where it is known which choices are least."""
    columns = range(values.shape[1])
    utopia = np.array([values[minimizers[k], k] for k in columns])
    nadir = np.array([max(values[i, k] for i in minimizers) for k in columns])
    return (values - utopia) / (nadir - utopia)


def slopes(values, found):
    """Derivatives of each choice's worst loss, less that of the best, by the table's entries."""
    worst = relative(values, found.minimizers).argmax(axis=1)
    rows, out = np.arange(len(values)), np.zeros((len(values), *values.shape))
    for place in np.ndindex(values.shape):
        sides = []
        for step in (-1e-6, 1e-6):
            moved = values.copy()
            moved[place] += step
            sides.append(relative(moved, found.minimizers)[rows, worst])
        out[(slice(None), *place)] = (sides[1] - sides[0]) / 2e-6
    return out - out[found.index]


def improving(values, errors):
    """Choices that are not dominated and not worse beyond the noise than one that is kept."""
    count, columns = values.shape
    beaten = [any(all(other <= row) and any(other < row) for other in values) for row in values]
    rows = [i for i in range(count) if not beaten[i]]
    part = np.array([[errors[i, k] / np.ptp(values[:, k]) for k in range(columns)] for i in rows])
    quiet, kept = int(part.max(axis=0).argmin()), []
    for i in sorted(rows, key=lambda i: (values[i, quiet], i)):
        gaps = [(values[i] - values[j], 2 * np.hypot(errors[i], errors[j])) for j in kept]
        if not any(all(gap >= -noise) and any(gap > noise) for gap, noise in gaps):
            kept.append(i)
    return sorted(kept)


@pytest.mark.parametrize("columns", [2, 3])
def test_noisy_tables_against_plain_loops(columns):
    rng = np.random.default_rng(columns)
    several = 0
    for _ in range(30):
        values = rng.gamma(2.0, size=(7, columns)) * np.array([3.0, 0.2, 11.0])[:columns]
        errors = rng.uniform(0.01, 0.2, size=(7, columns)) * np.array([3.0, 0.1, 2.0])[:columns]
        found, kept = choose(values, errors=errors), improving(values, errors)
        best = choose(values[kept])
        assert found.index == kept[best.index]
        np.testing.assert_array_equal(found.minimizers, np.array(kept)[best.minimizers])
        np.testing.assert_array_equal(found.utopia, best.utopia)
        np.testing.assert_array_equal(found.nadir, best.nadir)
        np.testing.assert_allclose(found.losses, best.losses, rtol=1e-12, atol=1e-15)
        if len(set(found.minimizers)) < 2 or (found.nadir == found.utopia).any():
            continue
        losses = relative(values, found.minimizers).max(axis=1)
        noise = np.sqrt(((slopes(values, found) * errors) ** 2).sum(axis=(1, 2)))
        excess = losses - losses[found.index]
        assert found.inseparable == tuple(np.flatnonzero(excess <= 2 * noise + 1e-12))
        several += len(found.inseparable) > 1
        left = {
            np.delete(np.arange(7), i)[choose(np.delete(values, i, axis=0)).index]
            for i in set(choose(values).minimizers)
        }
        plain = choose(values)
        assert plain.sensitivity == tuple(sorted(left - {plain.index}))
    assert several > 10


def test_draws_against_the_scatter_of_their_differences():
    rng = np.random.default_rng(5)
    for _ in range(10):
        centre = np.array([[1.0, 0.1], [0.62, 0.33], [0.5, 0.52], [0.31, 0.6], [0.1, 1.2]])
        draws = centre + 0.4 * rng.standard_normal((9, 1, 2)) + 0.2 * rng.standard_normal((9, 5, 2))
        values = draws.mean(axis=0)
        found = choose(draws)
        losses = relative(values, found.minimizers).max(axis=1)
        forms = np.einsum("ikl,dkl->di", slopes(values, found), draws - values)
        noise = forms.std(axis=0, ddof=1) / 3.0
        assert found.inseparable == tuple(
            np.flatnonzero(losses - losses[found.index] <= 2 * noise + 1e-12)
        )
    with pytest.raises(ValueError, match="at least 8 draws, got 7"):
        choose(draws[:7])
    assert choose(draws[:8]).index in range(5)


@pytest.mark.parametrize("centre", [1.1, 1.7, 2.9])
def test_smooth_minima_have_more_digits_than_values_show(centre):
    x = least_on_segment(lambda x: x - centre * np.log(x), None, np.linspace(0.1, 3.7, 33))
    assert x == pytest.approx(centre, abs=1e-12)


@pytest.mark.parametrize(("width", "flat"), [(0.9e-3, False), (1.1e-3, True), (0.3, True)])
def test_a_plateau_is_a_thousandth_of_the_segment(width, flat):
    centre, length = 2.63, 3.0
    f = lambda x: max(abs(x - centre) - 0.5 * width * length, 0.0)  # noqa: E731
    nodes = np.linspace(1.0, 1.0 + length, 5)
    for sign in (1.0, -1.0):
        x = least_on_segment(f, lambda x, sign=sign: sign * x, nodes)
        end = centre - sign * 0.5 * width * length
        assert f(x) == 0.0
        assert (abs(x - end) < 1e-11) == flat


def test_no_plateau_reaches_over_a_bump():
    f = lambda x: max(0.0, abs(x - 0.5) - 0.4) + max(0.0, 0.01 - abs(x - 0.375))  # noqa: E731
    for goal in (0.375, 0.625):
        x = least_on_segment(f, lambda x, goal=goal: (x - goal) ** 2, np.linspace(0, 1, 17))
        assert f(x) <= 1e-15
        assert abs(x - goal) == pytest.approx(0.01 if goal < 0.5 else 0.0, abs=1e-9)


def test_extra_points_are_preferred_to_equal_ones():
    nodes = np.linspace(-1.0, 1.0, 5)
    f = lambda x: (x * x - 0.36) ** 2  # noqa: E731
    assert least_on_segment(f, None, nodes, [0.6]) == 0.6
    assert least_on_segment(f, None, nodes) == pytest.approx(-0.6, abs=1e-9)
    assert least_on_segment(f, lambda x: -x, nodes) == pytest.approx(0.6, abs=1e-9)
    assert least_on_segment(f, None, nodes, [0.9]) == pytest.approx(-0.6, abs=1e-9)


@pytest.mark.parametrize("size", [1, 2, 3])
def test_points_of_a_box_step_by_the_generalised_golden_ratio(size):
    ratio = np.roots([1.0, *[0.0] * (size - 1), -1.0, -1.0])
    ratio = ratio[np.isreal(ratio) & (ratio.real > 1)].real.item()
    lower, upper = np.array([-2.0, 0.3, 5.0])[:size], np.array([1.5, 0.9, 17.0])[:size]
    points = box_scan(lower, upper, 6)
    assert points.shape == (6, size)
    for k in range(6):
        for i in range(size):
            share = (0.5 + k * ratio ** -(i + 1)) % 1.0
            wanted = lower[i] + share * (upper[i] - lower[i])
            assert points[k, i] == pytest.approx(wanted, abs=1e-12)


def test_least_points_of_a_box_and_their_ties():
    lower, upper = np.array([-1.0, 2.0]), np.array([3.0, 2.5])
    scan = box_scan(lower, upper, 20)
    goal = np.array([1.3, 2.2])
    x, good = least_in_box(
        lambda x: float(((x - goal) ** 2 * [1.0, 9.0]).sum()), lambda x: 0.0, lower, upper, scan
    )
    np.testing.assert_allclose(x, goal, atol=1e-7)
    assert good
    # least on a whole edge of the box: the tie decides along it
    x, good = least_in_box(
        lambda x: float(x[1]), lambda x: float((x[0] - 0.7) ** 2), lower, upper, scan
    )
    np.testing.assert_allclose(x, [0.7, 2.0], atol=1e-5)
    assert good
    point, good, settled = minimax_in_box(
        lambda x: np.array([(x[0] - 0.4) ** 2, (x[0] - 1.4) ** 2, 0.1 * (x[1] - 2.3) ** 2]),
        lower, upper, list(scan[:2]),
    )  # fmt: skip
    np.testing.assert_allclose(point, [0.9, 2.3], atol=1e-3)
    assert good
    assert settled


def test_a_search_in_a_box_stays_in_the_valley_where_it_starts():
    lower, upper = np.array([-3.0]), np.array([7.0])
    wells = lambda x: float((x[0] + 1.2) ** 2 * (x[0] - 5.1) ** 2 + 0.4 * x[0])  # noqa: E731
    for start, end in ((-2.0, -1.205), (5.9, 5.095)):
        x, good = least_in_box(wells, wells, lower, upper, np.array([[start]]))
        assert x[0] == pytest.approx(end, abs=2e-3)
        point, ended, _ = minimax_in_box(
            lambda x: np.array([wells(x), wells(x) - 0.1]), lower, upper, [np.array([start])]
        )
        assert point[0] == pytest.approx(end, abs=2e-3)
        assert good
        assert ended
    # of two starts the better end, whatever breaks ties
    scan = np.array([[5.9], [-2.0]])
    x = least_in_box(wells, lambda x: -x[0], lower, upper, scan)[0]
    assert x[0] == pytest.approx(-1.205, abs=2e-3)
    point = minimax_in_box(
        lambda x: np.array([wells(x)] * 2), lower, upper, [np.array([5.9]), np.array([-2.0])]
    )[0]
    assert point[0] == pytest.approx(-1.205, abs=2e-3)


def test_bisection_in_the_plane_and_its_trace():
    first, second = np.array([0.0, 1.0]), np.array([2.0, -1.0])
    criteria = [lambda x: ((x - first) ** 2).sum() + 1.0, lambda x: 3 * np.abs(x - second).sum()]
    found = bisect(criteria, first, second, tolerance=1e-3)
    # on the segment at share s the losses are s^2 and 1 - s: the golden section
    share = (np.sqrt(5.0) - 1) / 2
    np.testing.assert_allclose(found.x, first + share * (second - first), atol=2e-3)
    np.testing.assert_allclose(found.losses[0], [0.25, 0.5], rtol=1e-14)
    np.testing.assert_allclose(found.points[:3], [[1.0, 0.0], [1.5, -0.5], [1.25, -0.25]])
    np.testing.assert_allclose(found.gaps, found.losses[:, 0] - found.losses[:, 1])
    assert found.converged
    assert (np.abs(found.gaps[:-1]) > 1e-3).all()
    short = bisect(criteria, first, second, steps=4)
    assert (len(short.points), short.converged) == (4, False)


def test_of_several_balances_the_least_is_named():
    found = compromise([lambda x: np.cos(x), lambda x: np.sin(x) + 0.1 * x], 0.0, 9.0, scan=41)
    x = np.linspace(0.0, 9.0, 90001)
    values = np.stack([np.cos(x), np.sin(x) + 0.1 * x])
    low, ends = values.min(axis=1), values.argmin(axis=1)
    losses = (values - low[:, None]) / (values[:, ends].max(axis=1) - low)[:, None]
    gap = losses[0] - losses[1]
    roots = x[:-1][gap[:-1] * gap[1:] < 0]
    worst = np.interp(roots, x, losses[0])
    assert len(roots) > 2
    assert found.balanced == pytest.approx(roots[worst.argmin()], abs=2e-4)
    assert found.x == pytest.approx(x[losses.max(axis=0).argmin()], abs=2e-4)
    np.testing.assert_allclose(found.utopia, low, atol=1e-7)
    np.testing.assert_allclose(found.minimizers, x[ends], atol=2e-4)


def test_what_is_given_when_nothing_is_said():
    criteria = [lambda x: np.cos(x) + 0.1 * x, lambda x: np.sin(x) + 0.1 * x]
    plain, said = compromise(criteria, 0.0, 9.0), compromise(criteria, 0.0, 9.0, scan=33)
    assert (plain.x, plain.evaluations) == (said.x, said.evaluations)
    trace = bisect([lambda x: x, lambda x: (1 - x) ** 3], 0.0, 1.0)
    assert len(trace.points) < 60
    assert abs(trace.gaps[-1]) <= 1e-12 < abs(trace.gaps[:-1]).min()
    step = bisect([lambda x: x, lambda x: float(x < 0.7)], 0.0, 1.0)
    assert (len(step.points), step.converged) == (60, False)
    for wrong in (lambda x: [[x, 1 - x]], lambda x: x):
        with pytest.raises((TypeError, ValueError), match="criteria"):
            compromise(wrong, 0.0, 1.0)
