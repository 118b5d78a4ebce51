"""Two modes that the state itself switches, with either timing: a model of several tests."""

import sympy

from seedslib.models import Noise, SwitchingSystem

x, v, w = sympy.symbols("x v w", real=True)
BUMP = sympy.exp(-(x**2) / 8)
CHAIN = [[sympy.Rational(1, 5) + 3 * BUMP / 5, sympy.Rational(4, 5) - 3 * BUMP / 5],
         [BUMP / 2, 1 - BUMP / 2]]  # fmt: skip


def wave(drives="new", indicator=None):
    return SwitchingSystem(
        (x,), [[x + 1.8 * sympy.sin(x) + v / 2], [0.6 * x + v / 2]], Noise((v,)), CHAIN,
        [[x + w], [x + 2 + w]], Noise((w,)), [(0.6, [0], [[1]]), (0.4, [0.5], [[0.5]])],
        indicator=indicator, drives=drives,
    )  # fmt: skip
