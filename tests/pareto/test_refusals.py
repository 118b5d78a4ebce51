"""What is refused: the type of the error, and the argument that its message names."""

import numpy as np
import pytest

from seedslib.pareto import bisect, choose, compromise

X, Y = (lambda x: x), (lambda x: -x)

REFUSALS = [
    (lambda: compromise([X, Y], 1.0, 1.0), ValueError, "upper"),
    (lambda: compromise([X, Y], 0.0, [1.0]), ValueError, "upper"),
    (lambda: compromise([X, Y], 0.0, np.inf), ValueError, "upper"),
    (lambda: compromise([X, Y], 0.0, 1.0, scan=4), ValueError, "scan"),
    (lambda: compromise([X], 0.0, 1.0), ValueError, "criteria"),
    (lambda: compromise(lambda x: [x], 0.0, 1.0), ValueError, "criteria"),
    (lambda: compromise(lambda x: [[x, 1 - x]], 0.0, 1.0), ValueError, "criteria"),
    (lambda: compromise([X, lambda x: np.nan], 0.0, 1.0), ValueError, "criteria"),
    (lambda: bisect([X, Y], 1.0, 0.0), ValueError, "start"),
    (lambda: bisect([X, X], 0.0, 1.0), ValueError, "end"),
    (lambda: bisect([X, Y], 0.0, [1.0]), ValueError, "end"),
    (lambda: bisect([X, Y], 0.0, 1.0, tolerance=0.0), ValueError, "tolerance"),
    (lambda: bisect([X, Y], 0.0, 1.0, steps=0), ValueError, "steps"),
    (lambda: bisect([X, Y, X], 0.0, 1.0), ValueError, "criteria"),
    (lambda: choose(np.zeros((0, 2))), ValueError, "criteria"),
    (lambda: choose([[1.0], [2.0]]), ValueError, "criteria"),
    (lambda: choose([1.0, 2.0]), ValueError, "criteria"),
]


@pytest.mark.parametrize(("call", "error", "name"), REFUSALS)
def test_a_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()
