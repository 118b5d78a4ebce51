"""What is refused: the type of the error, and the argument that its message names."""

import numpy as np
import pytest

from seedslib.pareto import bisect, choose, compromise

X, Y, NOISE = (lambda x: x), (lambda x: -x), np.random.default_rng(0)

REFUSALS = [
    (lambda: compromise([X, Y], 1.0, 1.0), ValueError, "upper"),
    (lambda: compromise([X, Y], [0.0, 0.0], [1.0]), ValueError, "upper"),
    (lambda: compromise([X, Y], 0.0, np.inf), ValueError, "upper"),
    (lambda: compromise([X, Y], 0.0, 1.0, scan=4), ValueError, "scan"),
    (lambda: compromise([X], 0.0, 1.0), ValueError, "criteria"),
    (lambda: compromise(lambda x: [x], 0.0, 1.0), ValueError, "criteria"),
    (lambda: compromise(lambda x: [x] * (2 + (x > 0.7)), 0.0, 1.0), ValueError, "criteria"),
    (lambda: compromise(lambda x: [[x, 1 - x]], 0.0, 1.0), ValueError, "criteria"),
    (lambda: compromise([X, 3], 0.0, 1.0), TypeError, "criteria"),
    (lambda: compromise(3, 0.0, 1.0), TypeError, "criteria"),
    (lambda: compromise([X, lambda x: np.nan], 0.0, 1.0), ValueError, "criteria.* x = 0"),
    (lambda: compromise([lambda x: 1e308 * x, Y], -1, 1), ValueError, "criteria"),
    (lambda: compromise([X, lambda x: NOISE.normal()], 0.0, 1.0), ValueError, r"criteria\[1\]"),
    (
        lambda: compromise([lambda x: x + (x > 0.3) * NOISE.normal(), Y], 0.0, 1.0),
        ValueError,
        r"criteria\[0\]",
    ),
    (lambda: bisect([X, Y], 1.0, 0.0), ValueError, "start"),
    (lambda: bisect([X, X], 0.0, 1.0), ValueError, "end"),
    (lambda: bisect([X, Y], 0.0, [1.0]), ValueError, "end"),
    (lambda: bisect([X, Y], 0.0, 1.0, tolerance=0.0), ValueError, "tolerance"),
    (lambda: bisect([X, Y], 0.0, 1.0, steps=0), ValueError, "steps"),
    (lambda: bisect([X, Y, X], 0.0, 1.0), ValueError, "criteria"),
    (lambda: choose(np.zeros((0, 2))), ValueError, "criteria"),
    (lambda: choose([[1.0], [2.0]]), ValueError, "criteria"),
    (lambda: choose([1.0, 2.0]), ValueError, "criteria"),
    (lambda: choose(np.zeros((7, 2, 2))), ValueError, "criteria"),
    (lambda: choose([X, Y, X], [1, 2]), ValueError, "criteria"),
    (lambda: choose([X, 3], [1, 2]), TypeError, "criteria"),
    (lambda: choose([[1.0, 2.0]], [1, 2]), ValueError, "choices"),
    (lambda: choose([[1, 2], [2, 1]], {1, 2}), TypeError, "choices"),
    (lambda: choose([X, Y]), ValueError, "choices"),
    (lambda: choose([X, Y], [1, 2], errors=[[0, 0], [0, 0]]), ValueError, "errors"),
    (lambda: choose([[1.0, 2.0]], errors=[[-1.0, 0.0]]), ValueError, "errors"),
    (lambda: choose(np.zeros((9, 2, 2)), errors=np.zeros((2, 2))), ValueError, "errors"),
]


@pytest.mark.parametrize(("call", "error", "name"), REFUSALS)
def test_a_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()
