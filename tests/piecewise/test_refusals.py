"""What is refused: the type of the error, and the argument that its message names."""

import numpy as np
import pytest
import sympy as sp

from oracles.piecewise import lozi, tent, wave
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem, line_cells
from seedslib.zoo import falling_body

INF, NAN = np.inf, np.nan
X, Z, V, W = sp.symbols("x z v w")
TENT = PiecewiseLinearFilter(tent())
START = TENT.predict(TENT.initial(), 2.0)
LEANING = PiecewiseLinearSystem(
    [-INF, 0.0, INF],
    ([0.0, 0.0], [[0.5, 1e-9], [0.0, 1.0]]),
    ([0.0], [[1.0, 0.0]]),
    [[1.0]],
    [0.1, 0.2],
    np.eye(2),
)


def system(**changes):
    """The system, and its coefficients."""
    return lambda: PiecewiseLinearFilter(tent(**changes)).run(1, [[NAN], [0.1]])


def functions(**changes):
    return lambda: wave(4, **{"noise": (V, W), **changes})


def filter_(model=None, **options):
    return lambda: PiecewiseLinearFilter(model or tent(), **options)


def run(y, model=None, **options):
    record = np.stack([np.full(np.shape(y), NAN), y, y])[:, None]
    return lambda: PiecewiseLinearFilter(model or tent(), **options).run(2, record)


REFUSALS = [
    (system(regions=[1.0]), ValueError, "regions"),
    (system(regions=[-INF, 1.0, 0.0, INF]), ValueError, "regions"),
    (system(regions=[-INF, 1.0, 1.0, INF]), ValueError, "regions"),
    (system(regions=[0.0, INF]), ValueError, "regions"),
    (system(regions=[-INF, 1.0]), ValueError, "regions"),
    (system(mean0=[[0.1]]), ValueError, "mean0"),
    (system(mean0=[0.0, 1.0]), ValueError, "cov0"),
    (system(mean0=[], cov0=np.zeros((0, 0))), ValueError, "mean0"),
    (system(cov0=[[-1.0]]), ValueError, "cov0"),
    (system(dynamics=([[1.0, 1.0]], [[[1.8, -1.8, 0.0]]])), ValueError, "dynamics"),
    (system(dynamics=([1.0, 1.0], [[1.0]])), ValueError, "dynamics"),
    (system(noise=[0.3]), ValueError, "system"),
    (system(sensor=([0.0], [[1.0, 2.0]])), ValueError, "sensor"),
    (system(sensor_noise=[[NAN]]), ValueError, "sensor"),
    (system(sensor_noise=None), TypeError, "sensor"),
    (functions(dynamics=[X + Z]), ValueError, "dynamics"),
    (functions(dynamics=[X, X]), ValueError, "dynamics"),
    (functions(dynamics=[W * W]), ValueError, "noise"),
    (functions(sensor=[X + V + W]), ValueError, "noise"),
    (functions(support="middle"), TypeError, "support"),
    (functions(support=np.zeros(4)), ValueError, "support"),
    (functions(support=[0.5]), ValueError, "support"),
    (functions(initial=([1.0, 2.0], np.eye(2))), ValueError, r"initial\[0\]"),
    (lambda: tent().simulate([0.0], 4, 1), ValueError, "times"),
    (lambda: PiecewiseLinearFilter("tent"), TypeError, "system"),
    (filter_(prune=1.0), ValueError, "prune"),
    (filter_(prune=[0.1]), ValueError, "prune"),
    (run(0.2, model=tent(sensor_noise=[[0.0]], cov0=[[0.0]])), ValueError, "sensor_noise"),
    (run(1e200), ValueError, "y"),
    (run(INF), ValueError, "measurements"),
    (lambda: TENT.run(3, np.zeros((3, 1))), ValueError, "measurements"),
    (lambda: TENT.run([0.0, 2.0, 1.0], np.zeros((3, 1))), ValueError, "times"),
    (lambda: TENT.step(TENT.initial(), 0.0, [1.0, 2.0]), ValueError, "y"),
    (lambda: TENT.correct(TENT.predict(TENT.initial((2,)), 0.0), [0.0]), ValueError, "y"),
    (lambda: TENT.correct(TENT.initial(), [1.0]), ValueError, "state"),
    (lambda: TENT.predict(START, 1.0), ValueError, "t"),
    (lambda: line_cells([[1.0, 0.0]], [0.0, 0.0]), ValueError, "normals"),
    (lambda: line_cells([[0.0], [0.0]], [0.0]), ValueError, "normals"),
    (system(regions=lozi().regions), ValueError, "mean0"),
    (run(0.1, model=tent(noise=[[0.1]])), ValueError, "system"),
    (run(0.1, model=LEANING), ValueError, "system"),
    (
        run([0.0, 1.0], model=wave(6, dynamics=[2 * sp.sin(X)], support="estimate")),
        ValueError,
        "system",
    ),
    (lambda: falling_body(0), ValueError, "cells"),
]


@pytest.mark.parametrize(("call", "error", "name"), REFUSALS)
def test_a_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()
