import numpy as np
import pytest
import sympy

from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, v, w, t = sympy.symbols("x v w t")


def test_dynamics_see_the_time_they_leave():
    system = DiscreteSystem(
        StochasticMap((x,), [x + t + 0 * w]), StochasticMap((x,), [x + v], Noise((v,))), [0], [[0]]
    )
    states = system.simulate([0, 1, 2, 3], 2, 0).states
    np.testing.assert_array_equal(states[:, 0, 0], [0, 0, 1, 3])


def test_stationary_variance_of_an_autoregression():
    system = DiscreteSystem(
        StochasticMap((x,), [0.8 * x + 0.6 * w], Noise((w,))),
        StochasticMap((x,), [x + v], Noise((v,), cov=[[0.5]])),
        mean0=[0],
        cov0=[[1]],
    )
    run = system.simulate(np.arange(4), 100_000, 3)
    error = 4 * np.sqrt(2 / 100_000)
    np.testing.assert_allclose(run.states.var(axis=2)[:, 0], 1, atol=error)
    np.testing.assert_allclose(run.measurements.var(axis=2)[:, 0], 1.5, atol=1.5 * error)


def test_maps_of_different_states_are_refused():
    y = sympy.Symbol("y")
    with pytest.raises(ValueError, match="dynamics, sensor: wanted maps of a state of 1"):
        DiscreteSystem(StochasticMap((x,), [x]), StochasticMap((x, y), [x]), [0], [[1]])
