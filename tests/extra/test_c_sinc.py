"""A model with sin(x) / x in C, at zero, where its slope is a limit, and away from it."""

import numpy as np
import sympy

from seedslib.filters import extended_kalman
from seedslib.models import DiscreteSystem, Noise, StochasticMap


def test_a_filter_that_starts_at_zero(compiled):
    x, v, w = sympy.symbols("x v w", real=True)
    move = StochasticMap((x,), [3 * x * sympy.sinc(x) + x + v], Noise((v,)))
    system = DiscreteSystem(move, StochasticMap((x,), [x + w], Noise((w,))), [0], [[1]])
    times = np.arange(8.0)
    y = system.simulate(times, 20, 1).measurements
    y[0] = np.nan  # the first forecast starts at zero
    filter = extended_kalman(system)
    mean, _, loglik, _ = compiled(filter).run(times, y)
    wanted = filter.run(times, y)
    np.testing.assert_allclose(mean, wanted.mean, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(loglik, wanted.loglik, rtol=1e-12, atol=1e-12)
    assert np.abs(y[1:]).max() > 3
