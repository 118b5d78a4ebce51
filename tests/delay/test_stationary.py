"""Stationary gains by a spectral factor against the Riccati equation."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from seedslib.delay import DelaySystem, examples, stationary_gains

SYSTEMS = {
    "rotation": examples.rotation(0.6, 10),
    "precise sensor": examples.precise_sensor(),
    "without delay": examples.scalar(0.6, 0.3, 0.7, 0),
    "several delays": DelaySystem({0: 0.4, 2: 0.2, 5: -0.3}, 1.3, 0.8, 0.5, 1.0),
    "without noise": DelaySystem({0: 0.5, 1: 0.2}, 1.0, 0.0, 1.0, 1.0),
}


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("nodes", [None, 4096])
def test_stationary_gains_solve_the_riccati_equation(name, nodes):
    system = SYSTEMS[name]
    found, step, n = stationary_gains(system, nodes), system.augmented(), system.state_size
    predicted = solve_discrete_are(step.transition.T, step.sensor.T, step.noise, step.sensor_cov)
    inner = step.sensor @ predicted @ step.sensor.T + step.sensor_cov
    gain = predicted @ step.sensor.T / inner
    cov = predicted - gain @ inner @ gain.T
    np.testing.assert_allclose(found.gain, gain.reshape(-1, n, 1), atol=2e-11)
    np.testing.assert_allclose(found.innovation_cov, inner, atol=2e-11)
    np.testing.assert_allclose(found.predicted, predicted[:n, :n], atol=2e-11)
    np.testing.assert_allclose(found.cov, cov[:n, :n], atol=2e-11)
    assert nodes in (None, found.nodes)
