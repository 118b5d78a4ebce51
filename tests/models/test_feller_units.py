"""A chain on a grid moves as far in every unit of time."""

from itertools import pairwise

import numpy as np
import pytest
import sympy

from seedslib.base import Axis
from seedslib.models import FellerChain, JumpDiffusion, Noise

x, v = sympy.symbols("x v")


@pytest.mark.parametrize("unit", [1.0, 1e-12, 1e-13, 1e9])
def test_intervals_keep_their_own_transitions(unit):
    system = JumpDiffusion(
        (x,), [-x / unit], [[(2 / unit) ** 0.5]], [x + v], Noise((v,)), [2], [[0.01]],
        step=0.01 * unit,
    )  # fmt: skip
    chain = FellerChain(system, Axis(-4, 4, 81))
    for t in (0.25, 1.0, 1.0001):
        mean = chain.values[0] @ chain.law(t * unit)
        assert mean == pytest.approx(2 * np.exp(-t), abs=1.2e-3)


def test_an_even_grid_wants_one_transition():
    system = JumpDiffusion((x,), [-x], [[1]], [x + v], Noise((v,)), [0], [[1]])
    chain = FellerChain(system, Axis(-4, 4, 21))
    times = 1e-13 * np.linspace(0, 1, 101)
    found = [chain.transition(a, b) for a, b in pairwise(times)]
    assert all(part is found[0] for part in found)
