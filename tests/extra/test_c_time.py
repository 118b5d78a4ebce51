"""Systems whose functions depend on time: C against a recursion written out by hand."""

import numpy as np
import pytest
import sympy

from seedslib.filters import assumed_density, extended_kalman
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, v, w, t = sympy.symbols("x v w t", real=True)
TIMES = 0.5 + 0.75 * np.arange(6)


@pytest.mark.parametrize("make", [extended_kalman, assumed_density])
def test_dynamics_of_the_time_they_leave(make, compiled):
    system = DiscreteSystem(
        StochasticMap((x,), [sympy.cos(t) * x + t + v], Noise((v,)), time=t),
        StochasticMap((x,), [(1 + t) * x - t**2 + w], Noise((w,)), time=t),
        [0.5], [[2.0]],
    )  # fmt: skip
    y = np.array([0.3, 1.4, np.nan, -0.8, 2.1, 0.9])
    mean, cov, _, _ = compiled(make(system)).run(TIMES, y[:, None, None])
    m, p = 0.5, 2.0
    for i, k in enumerate(TIMES):
        if i:
            old = TIMES[i - 1]
            m, p = np.cos(old) * m + old, np.cos(old) ** 2 * p + 1
        if not np.isnan(y[i]):
            gain = (1 + k) * p / ((1 + k) ** 2 * p + 1)
            m, p = m + gain * (y[i] - (1 + k) * m + k**2), p - gain * (1 + k) * p
        assert mean[i, 0, 0] == pytest.approx(m, rel=1e-13)
        assert cov[i, 0, 0, 0] == pytest.approx(p, rel=1e-12)
