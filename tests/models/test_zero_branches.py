"""A move that never happens is no branch, however its probability is written."""

import sympy

from seedslib.models import Noise, SwitchingSystem


def test_a_zero_may_be_written_as_a_float():
    x, v, u = sympy.symbols("x v u")

    def system(zero, one):
        return SwitchingSystem(
            (x,), [[x + v], [x / 2 + v]], Noise((v,)), [[one, zero], [zero, one]],
            [[x + u], [x + u]], Noise((u,)), [(0.5, [0], [[1]])] * 2,
        )  # fmt: skip

    for zero, one in ((0, 1), (0.0, 1.0), (sympy.Float(0), 1)):
        moves = system(zero, one).branches
        assert [[branch is None for branch in row] for row in moves] == [
            [False, True], [True, False],
        ]  # fmt: skip
