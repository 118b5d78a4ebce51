"""What a filter remembers: which blocks, in which order, how the memory grows."""

import numpy as np
import pytest

from seedslib.designed import Memory, Past, finite_memory, large_order, small_order


@pytest.mark.parametrize("l", [1, 2, 4])
def test_memory_of_estimates_obeys_the_printed_recursion(l):
    """(2.1) to (2.4) with the cutting matrices C = [E O]: growing, and then full."""
    rng, n, memory, past = np.random.default_rng(l), 3, large_order(l), Past()
    vector, modes = np.empty((0, 5)), np.empty((0, 5), dtype=int)
    cut, cut_modes = np.eye((l - 1) * n, l * n), np.eye(l - 1, l)
    for k in range(9):
        estimate, mode = rng.standard_normal((n, 5)), rng.integers(3, size=5)
        past = memory.push(past, estimate=estimate, mode=mode)
        if k > l - 1:
            vector, modes = cut @ vector, cut_modes @ modes
        vector, modes = np.concatenate([estimate, vector]), np.concatenate([[mode], modes])
        assert np.array_equal(past.vector, vector)
        assert np.array_equal(past.modes, modes)
        assert len(vector) == memory.dimension(k, n) == n * min(k + 1, l)
    assert memory.order(n) == l * n


def test_memory_of_all_kinds_keeps_estimates_with_log_odds_above_measurements():
    memory, past = Memory(2, 3, indicators=1, log_odds=True), Past()
    rng = np.random.default_rng(0)
    z, odds, y = (rng.standard_normal((4, size, 2)) for size in (2, 1, 3))
    for k in range(4):
        past = memory.push(
            past,
            estimate=z[k],
            measurement=y[k],
            mode=np.array([k, 0]),
            indicator=np.array([10 + k, 0]),
            log_odds=odds[k],
        )
        assert len(past.vector) == memory.dimension(k, 2, 3, modes=2)
    wanted = [z[3], odds[3], z[2], odds[2], y[3], y[2], y[1]]
    np.testing.assert_array_equal(past.vector, np.concatenate(wanted))
    assert [int(mode[0]) for mode in past.modes] == [3, 2]
    assert [int(shown[0]) for shown in past.indicators] == [13]
    assert memory.order(2, 3, modes=2) == len(past.vector) == 15
    assert memory.depth == 3
    # modes stay as they are where none is given
    again = Memory(2).push(past, estimate=z[0])
    assert again.modes == past.modes[:2]
    assert again.measurements == again.indicators == ()


@pytest.mark.parametrize(
    ("memory", "order"),
    [
        (Memory(3), 6),
        (Memory(0, 3, 3), 3),
        (Memory(1, 1, 1), 3),
        (Memory(2, log_odds=True), 8),
        (Memory(6, 5, 4), 17),
        (Memory(2, 5, 9), 9),
    ],
)
def test_order_is_the_dimension_of_the_full_memory(memory, order):
    """Of two components, one measurement and three modes."""
    assert memory.order(2, 1, modes=3) == order
    assert memory.dimension(memory.depth - 1, 2, 1, 3) == order
    assert memory.dimension(0, 2, 1, 3) == (
        (4 if memory.log_odds else 2) * bool(memory.estimates) + bool(memory.measurements)
    )


def test_memories_of_the_papers_by_name():
    assert small_order() == large_order(1) == Memory(estimates=1)
    assert hash(small_order()) == hash(Memory(1))
    assert finite_memory(2) == Memory(measurements=2) == Memory(0, 2)
    assert str(Memory(1, 2, 3)) == "1 estimate, 2 measurements, 3 indicators"
    assert str(Memory(2, log_odds=True)) == "2 estimates, log-odds of the modes"
