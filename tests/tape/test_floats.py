"""Programs as Python functions: memory, choices, loops, refusals, what floats do not have."""

import math

import numpy as np
import pytest

from seedslib.tape import Tape, as_function, choose


def of_one(record):
    """A program that turns a number into a number."""
    tape = Tape()
    y, result = tape.array("y", (), owner="argument"), tape.array("result", (), owner="state")
    result.store(record(tape, y.all))
    function = as_function(tape)
    return lambda x: function((0.0,), [x])[0]


@pytest.mark.parametrize(
    ("formula", "wanted"),
    [
        (lambda x: -((x - 3.0) ** 2) / (2.0 - -x), lambda x: -((x - 3.0) ** 2) / (2.0 + x)),
        (lambda x: choose((x > 1.0) & ~(x > 2.0), x, -x), lambda x: x if 1 < x <= 2 else -x),
        (lambda x: choose((x < 0.0) | np.isnan(x), 1.0, np.sqrt(x)), lambda x: math.sqrt(x)),
        (lambda x: np.floor(x) + np.arctan2(x, 2.0) + abs(-x), None),
        (lambda x: np.float64(2.0) * x + 1.0 / x - np.exp(x) ** 0.5, None),
    ],
)
@pytest.mark.parametrize("x", [0.5, 1.5, 2.5])
def test_operations_are_those_of_numpy(formula, wanted, x):
    found = of_one(lambda tape, y: formula(y))(x)
    assert found == pytest.approx(float((wanted or formula)(x)), rel=1e-15)


def test_a_choice_takes_its_own_arm_alone():
    """The other one may be what floats cannot do."""
    function = of_one(lambda tape, y: choose(y > 0.0, 1.0 / y, 7.0))
    assert (function(0.0), function(4.0)) == (7.0, 0.25)


def test_what_is_missing_has_no_whole_part():
    assert math.isnan(of_one(lambda tape, y: np.floor(y))(math.nan))
    with pytest.raises(ArithmeticError):
        of_one(lambda tape, y: np.exp(y))(1e4)


def test_memory_is_zero_at_first_and_inner_blocks_carry_on_through_it():
    """Where a block is passed over, and in a loop whose length is known when it runs."""

    def record(tape, y):
        seldom, total = tape.array("seldom"), tape.array("total", (2, 2))
        with tape.when(y > 10.0):
            seldom.store(1.0)
        with tape.loop(y) as k:
            total.store(total[1, 1] + k, 1, 1)
            total.store(total[k * 0.0, 0] + 2.0, k * 0.0, 0)
        return seldom.all + total[1, 1] + 100.0 * total[0, 0]

    function = of_one(record)
    assert [function(x) for x in (0.0, 3.0, 4.0, 11.0)] == [0.0, 603.0, 806.0, 2256.0]


def test_a_refusal_gives_its_code_and_the_state_is_left_as_it_is():
    tape = Tape()
    total, y = tape.array("total", (2,), owner="state"), tape.array("y", (), owner="argument")
    total.store(total.all + y.all)
    tape.refuse(y.all > 3.0, "LARGE")
    function, state = as_function(tape), (1.0, 2.0)
    assert function(state, [1.0]) == (2.0, 3.0)
    assert (function(state, [4.0]), state) == ("LARGE", (1.0, 2.0))


def test_a_tape_has_a_limit():
    tape = Tape(limit=3)
    y = tape.array("y", (4,), owner="argument")
    with pytest.raises(ValueError, match="program of at most 3 values"):
        _ = y.all
