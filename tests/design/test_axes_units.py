"""Axes that a design lays about its paths are the same in every unit of the state."""

import numpy as np
import pytest
import sympy

from seedslib.design import simulated_synthesis
from seedslib.design.tables.simulated import _about
from seedslib.designed import Memory
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, w, v = sympy.symbols("x w v")


def table(unit):
    system = DiscreteSystem(
        StochasticMap((x,), [0.9 * x + unit * w], Noise((w,))),
        StochasticMap((x,), [x + unit * v], Noise((v,))), mean0=[0], cov0=[[unit**2]],
    )  # fmt: skip
    return simulated_synthesis(system, Memory(1), np.arange(2.0), paths=2000, seed=1, nodes=0)


@pytest.fixture(scope="module")
def plain():
    return table(1.0)


@pytest.mark.parametrize("unit", [1e-9, 1e-12, 1e9])
def test_axes_follow_the_unit(plain, unit):
    found = table(unit)
    one, other = (made.steps[1].blind.axes[0] for made in (plain, found))
    np.testing.assert_allclose([other.low, other.high], [unit * one.low, unit * one.high], 1e-9)
    np.testing.assert_allclose(found.predicted.rms, unit * plain.predicted.rms, rtol=1e-3)


@pytest.mark.parametrize("value", [0.0, 5e-13, -3e8])
def test_values_that_are_all_one_have_an_axis_about_them(value):
    axis = _about(np.full(10, value), 7)
    assert axis.low < value < axis.high
