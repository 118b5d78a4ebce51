"""What is refused: the type of the error, and the argument that its message names."""

import numpy as np
import pytest
import sympy as sp

from oracles.piecewise import lozi, tent, wave
from seedslib.models import Noise
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem, examples, line_cells

INF, NAN = np.inf, np.nan
X, Z, V, W = sp.symbols("x z v w")
TENT, HALF = PiecewiseLinearFilter(tent()), type(line_cells([[1.0], [0.0]], [0.0]).cells[0])
LEFT, RIGHT = line_cells([[1.0], [0.0]], [0.0]).cells
START = TENT.predict(TENT.initial(), 2.0)
LEANING = PiecewiseLinearSystem(
    [-INF, 0.0, INF], ([0.0, 0.0], [[0.5, 1e-9], [0.0, 1.0]]), ([0.0], [[1.0, 0.0]]), [[1.0]],
    [0.1, 0.2], np.eye(2),
)  # fmt: skip
FOLLOWING = wave(6, dynamics=[2 * sp.sin(X)], noise=V, support="estimate")


def system(**changes):
    return lambda: tent(**changes)


def cells(*regions):
    return lambda: PiecewiseLinearSystem(
        list(regions), lozi().dynamics, lozi().sensor, [[0.3]], [0.1, 0.1], np.eye(2)
    )


def functions(**changes):
    return lambda: wave(4, **changes)


def filter_(model=None, **options):
    return lambda: PiecewiseLinearFilter(model or tent(), **options)


def run(*y, model=None, **options):
    return lambda: PiecewiseLinearFilter(model or tent(), **options).run(
        len(y), np.array([NAN, *y])[:, None]
    )


REFUSALS = [
    (system(regions=[1.0]), ValueError, "regions"),
    (system(regions=[-INF, 1.0, 0.0, INF]), ValueError, "regions"),
    (system(regions=[-INF, 1.0, 1.0, INF]), ValueError, "regions"),
    (system(regions=[0.0, INF]), ValueError, "regions"),
    (system(regions=[-INF, 1.0]), ValueError, "regions"),
    (system(regions=[(-INF, 0.0), (0.5, INF)]), ValueError, "regions.* gap .* 0 and 1"),
    (system(regions=[(-INF, 0.5), (0.0, INF)]), ValueError, "regions.* overlapping .* 0 and 1"),
    (system(regions=[(0.0, INF), (-INF, 0.0)]), ValueError, "regions.* out of order .* 0 and 1"),
    (system(regions=np.zeros((0, 2))), ValueError, "regions"),
    (system(regions=lambda x: x), TypeError, "regions"),
    (cells("a", "b"), TypeError, "regions"),
    (cells(LEFT, LEFT._replace(offsets=np.array([-1.0]))), ValueError, "regions.* overlap"),
    (cells(LEFT, RIGHT._replace(offsets=np.array([-2.0]))), ValueError, "regions.* 0.111 of"),
    (cells(LEFT, RIGHT, LEFT), ValueError, "regions.* 0 and 2 "),
    (cells(LEFT, HALF(np.array([[1.0, -1], [0, 0]]), np.array([-1.0, 0])), RIGHT), ValueError,
     "regions.* cell 1 is empty"),
    (cells(LEFT, [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]), ValueError, r"regions\[1\]"),
    (cells([[0, 0], [2, 0], [1, 0.2], [1, 2]]), ValueError, r"regions\[0\].* convex"),
    (cells(LEFT, HALF(np.ones((3, 1)), np.zeros(1))), ValueError, r"regions\[1\].normals"),
    (cells(HALF(np.zeros((2, 1)), np.zeros(1))), ValueError, r"regions\[0\].normals"),
    (cells(LEFT, HALF(np.ones((2, 1)), np.zeros(2))), ValueError, r"regions\[1\].offsets"),
    (lambda: line_cells([[1.0, 0.0]], [0.0, 0.0]), ValueError, "normals"),
    (lambda: line_cells([[1.0, 0.0], [0.0, 1.0]], [0.0]), ValueError, "offsets"),
    (system(mean0=[[0.1]]), ValueError, "mean0"),
    (system(mean0=[0.0, 1.0]), ValueError, "mean0, cov0"),
    (system(mean0=[], cov0=np.zeros((0, 0))), ValueError, "mean0"),
    (system(regions=[LEFT, RIGHT]), ValueError, "mean0"),
    (system(cov0=[[-1.0]]), ValueError, "cov0"),
    (system(dynamics=([[1.0, 1.0]], [[[1.8, -1.8, 0.0]]])), ValueError, r"dynamics \(matrix\)"),
    (system(dynamics=([1.0, 1.0], [[1.0]])), ValueError, r"dynamics \(offset\)"),
    (system(noise=[0.3]), ValueError, r"dynamics \(noise\)"),
    (system(sensor=([0.0], [[1.0, 2.0]])), ValueError, r"sensor \(matrix\)"),
    (system(sensor_noise=[[NAN]]), ValueError, r"sensor \(noise\)"),
    (system(sensor_noise=None), ValueError, "sensor"),
    (functions(dynamics=[X + Z]), ValueError, "dynamics"),
    (functions(dynamics=[X, X]), ValueError, "dynamics"),
    (functions(dynamics=[W * W]), ValueError, "dynamics"),
    (functions(sensor=[]), ValueError, "sensor"),
    (functions(sensor=[X + V + W]), ValueError, "noise"),
    (functions(noise=Noise((V, W), cov=[[1.0, 0.5], [0.5, 1.0]])), ValueError, "noise"),
    (functions(noise=Noise(2)), ValueError, "noise"),
    (functions(noise=(X, V, W)), ValueError, ".*noise"),
    (functions(breakpoints=[1.0]), ValueError, "breakpoints"),
    (functions(breakpoints=[1.0, 0.0]), ValueError, "breakpoints"),
    (functions(breakpoints=[(-INF, 0.0), (0.0, INF)]), ValueError, "support"),
    (functions(support="middle"), ValueError, "support"),
    (functions(support=np.zeros(4)), ValueError, "support"),
    (functions(support=[0.5]), ValueError, "support"),
    (functions(initial=([1.0, 2.0], np.eye(2))), ValueError, r"initial\[0\]"),
    (lambda: tent().simulate(2, 4, 1, start=[0.7, 1.0]), ValueError, "start"),
    (lambda: tent().simulate([0.0], 4, 1), ValueError, "times"),
    (lambda: examples.falling_body(span=(5.0, 5.0)), ValueError, "span"),
    (lambda: examples.falling_body(partition="even"), ValueError, "partition"),
    (lambda: examples.falling_body(0), ValueError, "cells"),
    (lambda: PiecewiseLinearFilter("tent"), TypeError, "system"),
    (filter_(method="fast"), ValueError, "method"),
    (filter_(prune=1.0), ValueError, "prune"),
    (filter_(prune=[0.1]), ValueError, "prune"),
    (filter_(neglect=-1e-30), ValueError, "neglect"),
    (filter_(merge=-0.5), ValueError, "merge"),
    (filter_(lozi(), merge=0.1), ValueError, "merge"),
    (filter_(keep=0), ValueError, "keep"),
    (filter_(keep=2.5), TypeError, "keep"),
    (filter_(max_branches=1), ValueError, "max_branches"),
    (run(0.0, 0.0, max_branches=7), ValueError, "max_branches.* 8 .* t = 2"),
    (run(0.1, model=tent(noise=[[0.1]]), method="exact"), ValueError, "method.* noise"),
    (run(0.1, model=LEANING, method="exact"), ValueError, "method.* depend on the others"),
    (lambda: PiecewiseLinearFilter(FOLLOWING, method="exact").run(2, np.full((3, 1, 2), 0.3)
     + np.array([0.0, 1.0])), ValueError, "method.* differ"),
    (run(0.2, model=tent(sensor_noise=[[0.0]], cov0=[[0.0]])), ValueError, "sensor_noise"),
    (run(0.2, model=tent(sensor_noise=[[0.0]]), prune=1e-3), ValueError, "prune"),
    (run(1e200), ValueError, "y"),
    (run(INF), ValueError, "measurements"),
    (lambda: TENT.run(3, np.zeros((3, 1))), ValueError, "measurements"),
    (lambda: TENT.run([0.0, 2.0, 1.0], np.zeros((3, 1))), ValueError, "times"),
    (lambda: TENT.step(TENT.initial(), 0.0, [1.0, 2.0]), ValueError, "y"),
    (lambda: TENT.correct(TENT.predict(TENT.initial((2,)), 0.0), [0.0]), ValueError, "y"),
    (lambda: TENT.correct(TENT.initial(), [1.0]), ValueError, "state"),
    (lambda: TENT.predict(START, 1.0), ValueError, "t"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "error", "name"), REFUSALS)
def test_a_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()


def test_as_many_branches_as_allowed_are_taken():
    assert len(PiecewiseLinearFilter(tent(), max_branches=8).run(2, np.zeros((3, 1))).mean) == 3
