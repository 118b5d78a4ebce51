"""The state of a finite-order filter: what is kept, in which order, how it grows."""

import numpy as np
import pytest

from seedslib.designed import Memory, Past, finite_memory, large_order, small_order


def blocks(count, size, start=0):
    rng = np.random.default_rng(start)
    return rng.standard_normal((count, size, 3))


@pytest.mark.parametrize("l", [1, 2, 3, 5])
def test_lemma_dimension_and_state_equation_of_the_large_order_filter(l):
    memory, past, u = large_order(l), Past(), None
    n = 2
    cut = np.eye((l - 1) * n, l * n)  # the matrix C of (3.2)
    for k, z in enumerate(blocks(8, n)):
        past = memory.push(past, estimate=z)
        if k == 0:
            u = z
        elif k <= l - 1:
            u = np.concatenate([z, u])
        else:
            u = np.concatenate([z, np.tensordot(cut, u, 1)])
        np.testing.assert_array_equal(past.vector, u)
        assert len(past.vector) == memory.dimension(k, n) == n * min(k + 1, l)
    assert memory.order(n) == l * n


def test_finite_memory_keeps_measurements_newest_first():
    memory, past = finite_memory(2), Past()
    shown = blocks(4, 1)
    for z, y in zip(blocks(4, 2, 1), shown, strict=True):
        past = memory.push(past, estimate=z, measurement=y)
    np.testing.assert_array_equal(past.vector, np.concatenate([shown[3], shown[2]]))
    assert past.estimates == ()
    assert memory.order(2, 1) == 2


def test_mixed_memory_has_estimates_above_measurements():
    memory, past = Memory(2, 1), Past()
    z, y = blocks(3, 2), blocks(3, 1, 5)
    for k in range(3):
        past = memory.push(past, estimate=z[k], measurement=y[k])
        assert len(past.vector) == memory.dimension(k, 2, 1)
    np.testing.assert_array_equal(past.vector, np.concatenate([z[2], z[1], y[2]]))
    assert memory.order(2, 1) == 5


def test_memory_of_decisions_indicators_and_log_odds():
    memory, past = Memory(2, indicators=1, log_odds=True), Past()
    z, odds = blocks(3, 2), blocks(3, 1, 7)
    for k in range(3):
        past = memory.push(
            past, estimate=z[k], mode=np.array(k), indicator=np.array(10 + k), log_odds=odds[k]
        )
    np.testing.assert_array_equal(past.vector, np.concatenate([z[2], odds[2], z[1], odds[1]]))
    assert [int(m) for m in past.modes] == [2, 1]
    assert [int(j) for j in past.indicators] == [12]
    assert memory.order(2, modes=2) == 6
    with pytest.raises(ValueError, match="log_odds: wanted by this memory"):
        memory.push(past, estimate=z[0], indicator=np.array(0))


def test_small_order_is_large_order_one():
    assert small_order() == large_order(1) == Memory(1)
    assert hash(small_order()) == hash(Memory(1))
    assert str(Memory(2, 1)) == "2 estimates, 1 measurement"


@pytest.mark.parametrize("make", [large_order, finite_memory])
@pytest.mark.parametrize(
    ("l", "error"), [(0, ValueError), (-1, ValueError), (1.5, TypeError), (True, TypeError)]
)
def test_multiplicity_is_a_natural_number(make, l, error):
    with pytest.raises(error, match=r"^l: wanted"):
        make(l)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"estimates": 0}, ValueError, "memory: wanted at least one"),
        ({"estimates": -1}, ValueError, "estimates: wanted at least 0"),
        ({"estimates": 0, "indicators": 2}, ValueError, "memory: wanted at least one"),
        ({"measurements": 2.0}, TypeError, "measurements: wanted a whole number"),
        ({"log_odds": 1}, TypeError, "log_odds: wanted True or False"),
        ({"estimates": 0, "measurements": 1, "log_odds": True}, ValueError, "log_odds: wanted"),
    ],
)
def test_memories_that_make_no_sense(options, error, message):
    with pytest.raises(error, match=message):
        Memory(**options)


def test_a_kept_block_must_be_given():
    with pytest.raises(ValueError, match="measurement: wanted by this memory"):
        Memory(1, 1).push(Past(), estimate=np.zeros(2))


def test_what_is_named_is_remembered_and_nothing_else():
    assert Memory(measurements=2) == finite_memory(2) == Memory(0, 2)
    assert Memory(estimates=2) == large_order(2) == Memory(2)
    for words in ({}, {"indicators": 1}):
        with pytest.raises(ValueError, match="wanted at least one estimate or measurement"):
            Memory(**words)


def test_dimensions_of_what_is_remembered():
    assert Memory(1, 1).dimension(0, 2) == 2
    assert Memory(3, 2).dimension(1, 5, 7) == 5 * 2 + 7 * 2
    assert Memory(3, 2).dimension(2, 5, 7) == 5 * 3 + 7 * 2
    assert Memory(2, 1, log_odds=True).dimension(4, 5, 7, 3) == 7 * 2 + 7
    assert Memory(2, 1).order(5) == 10
    assert Memory(2, 3, 4).depth == 4
    assert Memory(2, 5, 4).depth == 5
    assert Memory(6, 5, 4).order(2, 3) == 12 + 15


def test_words_of_a_memory():
    assert str(Memory(1, 2, 3)) == "1 estimate, 2 measurements, 3 indicators"
    assert str(Memory(2, log_odds=True)) == "2 estimates, log-odds of the modes"


def test_modes_are_kept_where_none_is_told():
    past = Memory(2).push(Past(), estimate=np.ones(2), mode=np.array(1))
    assert Memory(2).push(past, estimate=np.ones(2)).modes == past.modes


@pytest.mark.parametrize(
    ("given", "name"),
    [({"measurement": 1.0, "indicator": 1}, "estimate"), ({"estimate": 1.0, "indicator": 1},
     "measurement"), ({"estimate": 1.0, "measurement": 1.0}, "indicator")],
)  # fmt: skip
def test_a_block_that_is_kept_has_to_be_given(given, name):
    with pytest.raises(ValueError, match=f"^{name}: wanted by this memory, got none"):
        Memory(1, 1, 1).push(Past(), **given)
