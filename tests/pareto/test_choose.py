"""The compromise within a list of choices."""

import numpy as np

from seedslib.pareto import choose

# squared errors of a filter that keeps the J oldest innovations, J = 0..10
TRUNCATION = [
    1.938729,
    1.879386,
    1.869233,
    1.866560,
    1.865813,
    1.865606,
    1.865440,
    1.864595,
    1.862608,
    1.860317,
    1.858970,
]


def brute_choice(values):
    below = (values[:, None] <= values[None]).all(axis=2)  # [j, i]: j is no worse than i
    keep = np.flatnonzero(~(below & ~below.T).any(axis=0))
    low = values[keep].min(axis=0)
    ends = values[keep][(values[keep] == low).any(axis=1)].max(axis=0)
    losses = (values - low) / np.where(ends > low, ends - low, np.inf)
    return min(keep, key=lambda i: (losses[i].max(), losses[i].sum(), i))


def test_tables_against_brute_force():
    rng = np.random.default_rng(3)
    for trial in range(200):
        n = int(rng.integers(1, 40))
        values = rng.random((n, 2))
        if trial % 2:  # with ties
            values = values.round(1)
        if trial % 3 == 0:
            values = np.c_[np.sort(values[:, 0])[::-1], np.sort(values[:, 1])]
        found = choose(values)
        assert found.x == brute_choice(values)
        np.testing.assert_array_equal(found.values, values[found.x])
        np.testing.assert_array_equal(found.utopia, values[found.minimizers].diagonal())
        np.testing.assert_array_equal(found.nadir, values[found.minimizers].max(axis=0))
        scale = np.where(found.nadir > found.utopia, found.nadir - found.utopia, np.inf)
        np.testing.assert_allclose(found.losses, (found.values - found.utopia) / scale)


def test_of_equal_choices_the_first_is_taken():
    twice = [[0.0, 1.0], [0.0, 1.0], [1.0, 0.0], [1.0, 0.0], [0.4, 0.4], [0.4, 0.4]]
    found = choose(twice)
    assert (found.x, found.minimizers.tolist()) == (4, [0, 2])
    assert choose(np.c_[[1.0, 0.625, 0.375, 0.0], [0.0, 0.375, 0.625, 1.0]]).x == 1
    assert choose(np.c_[[0.0, 1.0, 0.5], [1.0, 0.0, 0.5], [2.0, 2.0, 2.0]]).x == 2


def test_orders_of_a_filter_by_error_and_cost():
    table = np.c_[TRUNCATION, np.arange(11.0)]
    found = choose(table)
    assert found.x == 2
    np.testing.assert_allclose(found.losses, [0.12867, 0.2], atol=1e-5)
    assert (found.utopia.tolist(), found.nadir.tolist()) == ([1.858970, 0.0], [1.938729, 10.0])
    # a useless choice stretches the cost; a dominated one is dropped
    assert choose(np.r_[table, [[TRUNCATION[-1] - 1e-9, 60.0]]]).x > 2
    assert choose(np.r_[table, [[TRUNCATION[-1], 60.0]]]).x == 2


def test_a_choice_that_is_best_for_all():
    assert choose([[1.0, 2.0]]).losses.tolist() == [0.0, 0.0]
    assert choose([[3.0, 2.0], [1.0, 1.0]]).x == 1
