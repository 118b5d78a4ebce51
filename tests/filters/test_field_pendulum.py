"""Why a designed filter loses on a pendulum that may start anywhere."""

import numpy as np
import pytest
import sympy as sp

from seedslib.design import minimax_synthesis, synthesize
from seedslib.designed import Memory
from seedslib.filters import extended_kalman
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

TIMES = np.arange(121.0)


@pytest.fixture(scope="module")
def errors():
    """Root mean square errors of the angle, for wide and narrow starts, of three filters."""
    angle, speed, push, v = sp.symbols("x1 x2 q v", real=True)
    move = StochasticMap(
        (angle, speed),
        [angle + speed / 50, speed - 9.81 / 50 * sp.sin(angle) + push],
        Noise((push,), cov=[[2e-4]]),
    )
    see = StochasticMap((angle, speed), [sp.sin(angle) + v], Noise((v,), cov=[[0.05]]))
    found = {}
    for width in (0.1, 1.0):
        system = DiscreteSystem(move, see, [0, 0], width * np.eye(2))
        data = system.simulate(TIMES, 300, 11)
        for name, filter in (
            ("extended", extended_kalman(system)),
            ("lines", synthesize(system, Memory(1), Taylor(), TIMES, paths=2000, seed=12)),
            ("own step", minimax_synthesis(system, Memory(1), TIMES, paths=2000, seed=12)),
        ):
            mean = filter.run(TIMES, data.measurements).mean
            found[width, name] = np.sqrt(((mean - data.states)[:, 0] ** 2).mean())
    return found


def test_a_design_around_the_models_step_loses_less(errors):
    """Another step, sensor and noise than on the page, and other paths: the order is the same."""
    assert errors[1.0, "lines"] > 1.2 * errors[1.0, "own step"]
    assert errors[0.1, "lines"] < 1.03 * errors[0.1, "own step"]
    assert errors[0.1, "own step"] < 1.03 * errors[0.1, "extended"]
