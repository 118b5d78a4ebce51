"""The compromise within a list of choices, by a table or by bisection, also under noise."""

import numpy as np
import pytest

from seedslib.pareto import choose

# squared errors of a filter that keeps the J oldest innovations, J = 0..10
TRUNCATION = [
    1.938729, 1.879386, 1.869233, 1.866560, 1.865813, 1.865606, 1.865440, 1.864595, 1.862608,
    1.860317, 1.858970,
]  # fmt: skip


def brute_choice(values):
    below = (values[:, None] <= values[None]).all(axis=2)  # [j, i]: j is no worse than i
    keep = np.flatnonzero(~(below & ~below.T).any(axis=0))
    low = values[keep].min(axis=0)
    ends = values[keep][(values[keep] == low).any(axis=1)].max(axis=0)
    losses = (values - low) / np.where(ends > low, ends - low, np.inf)
    return min(keep, key=lambda i: (losses[i].max(), losses[i].sum(), i))


def test_tables_and_bisections_of_monotone_lists_against_brute_force():
    rng = np.random.default_rng(3)
    for trial in range(200):
        n = int(rng.integers(1, 40))
        falling, rising = np.sort(rng.random(n))[::-1], np.sort(rng.random(n))
        if trial % 2:  # with ties
            falling, rising = falling.round(1), rising.round(1)
        table = np.c_[falling, rising]
        whole, halved = choose(table), choose([falling.__getitem__, rising.__getitem__], range(n))
        assert whole.index == brute_choice(table)
        np.testing.assert_array_equal(table[halved.index], table[whole.index])
        np.testing.assert_allclose(halved.losses, whole.losses, atol=1e-15)
        assert whole.efficiency == halved.efficiency == "full"
        assert halved.unimodal
        if trial % 2 == 0:
            assert halved.evaluations <= np.ceil(np.log2(max(n, 2))) + 6


def test_of_equal_choices_the_first_is_taken():
    twice = [[0.0, 1.0], [0.0, 1.0], [1.0, 0.0], [1.0, 0.0], [0.4, 0.4], [0.4, 0.4]]
    found = choose(twice)
    assert (found.index, found.minimizers.tolist()) == (4, [0, 2])
    exact = choose(twice, errors=np.zeros((6, 2)))
    assert (exact.index, exact.minimizers.tolist()) == (4, [0, 2])
    falling, rising = [1.0, 0.625, 0.375, 0.0], [0.0, 0.375, 0.625, 1.0]
    assert choose(np.c_[falling, rising]).index == 1
    assert choose([falling.__getitem__, rising.__getitem__], range(4)).index == 1
    assert choose(np.c_[[0.0, 1.0, 0.5], [1.0, 0.0, 0.5], [2.0, 2.0, 2.0]]).index == 2


def test_orders_of_a_filter_by_error_and_cost():
    table = np.c_[TRUNCATION, np.arange(11.0)]
    found = choose(table, [f"J={j}" for j in range(11)])
    assert (found.index, found.x, found.status) == (2, "J=2", "minimax")
    np.testing.assert_allclose(found.losses, [0.12867, 0.2], atol=1e-5)
    np.testing.assert_array_equal(found.values, table[2])
    assert (found.utopia.tolist(), found.nadir.tolist()) == ([1.858970, 0.0], [1.938729, 10.0])
    halved = choose([TRUNCATION.__getitem__, lambda j: j], range(11))
    assert (halved.x, halved.index) == (2, 2)
    assert halved.evaluations < 11
    # a useless choice stretches the cost; a dominated one, or within the noise, is dropped
    longer = np.r_[table, [[TRUNCATION[-1] - 1e-9, 60.0]]]
    assert choose(longer).index > 2
    assert choose(longer).sensitivity != ()
    assert choose(np.r_[table, [[TRUNCATION[-1], 60.0]]]).index == 2
    assert choose(longer, errors=np.c_[np.full(12, 1e-6), np.zeros(12)]).index == 2


def test_ideal_choices_and_lists_that_are_not_monotone():
    assert choose([[1.0, 2.0]]).status == "ideal point"
    assert choose([[3.0, 2.0], [1.0, 1.0]], "ab").x == "b"
    assert choose([lambda j: -j, lambda j: -2 * j], range(9)).index == 8
    assert choose(lambda z: (z[0], -z[0]), [[1], [2], [3]]).x == [2]
    assert not choose([lambda j: (j - 5) ** 2, lambda j: j], list(range(11))).unimodal


def relative(values, minimizers):
    """Losses of all choices where it is known which choices are least."""
    low = values[minimizers].diagonal()
    return (values - low) / (values[minimizers].max(axis=0) - low)


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
    rows = [
        i for i, row in enumerate(values)
        if not any(all(other <= row) and any(other < row) for other in values)
    ]  # fmt: skip
    part = errors[rows] / np.ptp(values, axis=0)
    quiet, kept = int(part.max(axis=0).argmin()), []
    for i in sorted(rows, key=lambda i: (values[i, quiet], i)):
        gaps = [(values[i] - values[j], 2 * np.hypot(errors[i], errors[j])) for j in kept]
        if not any(all(gap >= -noise) and any(gap > noise) for gap, noise in gaps):
            kept.append(i)
    return sorted(kept)


@pytest.mark.parametrize("columns", [2, 3])
def test_noisy_tables_against_plain_loops(columns):
    rng, several = np.random.default_rng(columns), 0
    for _ in range(20):
        values = rng.gamma(2.0, size=(7, columns)) * np.array([3.0, 0.2, 11.0])[:columns]
        errors = rng.uniform(0.01, 0.2, size=(7, columns)) * np.array([3.0, 0.1, 2.0])[:columns]
        found, kept, plain = (
            choose(values, errors=errors),
            improving(values, errors),
            choose(values),
        )
        best = choose(values[kept])
        assert found.index == kept[best.index]
        np.testing.assert_array_equal(found.minimizers, np.array(kept)[best.minimizers])
        np.testing.assert_allclose(found.losses, best.losses, rtol=1e-12, atol=1e-15)
        left = {
            np.delete(np.arange(7), i)[choose(np.delete(values, i, axis=0)).index]
            for i in set(plain.minimizers)
        }
        assert plain.sensitivity == tuple(sorted(left - {plain.index}))
        if len(set(found.minimizers)) < 2 or (found.nadir == found.utopia).any():
            continue
        losses = relative(values, found.minimizers).max(axis=1)
        noise = np.sqrt(((slopes(values, found) * errors) ** 2).sum(axis=(1, 2)))
        near = losses - losses[found.index] <= 2 * noise + 1e-12
        assert found.inseparable == tuple(np.flatnonzero(near))
        several += len(found.inseparable) > 1
    assert several > 5


def test_draws_are_compared_in_pairs():
    """Against the scatter of the differences of the losses over the draws."""
    rng = np.random.default_rng(5)
    centre = np.array([[1.0, 0.1], [0.62, 0.33], [0.5, 0.52], [0.31, 0.6], [0.1, 1.2]])
    for _ in range(8):
        draws = centre + 0.4 * rng.standard_normal((9, 1, 2)) + 0.2 * rng.standard_normal((9, 5, 2))
        found, values = choose(draws), draws.mean(axis=0)
        losses = relative(values, found.minimizers).max(axis=1)
        forms = np.einsum("ikl,dkl->di", slopes(values, found), draws - values)
        near = losses - losses[found.index] <= 2 * forms.std(axis=0, ddof=1) / 3.0 + 1e-12
        assert found.inseparable == tuple(np.flatnonzero(near))
