"""No number hangs on which eigenvectors a linear-algebra kernel chooses.

They are free in sign, and by a rotation where eigenvalues repeat. Here the kernel chooses at
random, and every result must stay.
"""

import numpy as np
import pytest
import sympy

from seedslib.base import update
from seedslib.design import Polynomial, synthesize
from seedslib.designed import Memory
from seedslib.gaussian import (
    elevation_moments,
    expectation_function,
    mean_square_errors,
    norm_mean,
)
from seedslib.linearization import Moments, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

EYE = np.eye(3)
X = x, y, z = sympy.symbols("x y z", real=True)
V, W = sympy.symbols("v1:4", real=True), sympy.symbols("w1:4", real=True)
LAW = ([0.3, 0.3, 0.3], 2 * EYE, 0.5 * EYE)


@pytest.fixture
def free_eigenvectors(monkeypatch):
    """Switch on a kernel that chooses anew at every call."""
    eigh, rng = np.linalg.eigh, np.random.default_rng(7)

    def any_eigh(matrix, *rest):
        values, vectors = eigh(matrix, *rest)
        vectors = vectors.copy()
        for place in np.ndindex(values.shape[:-1]):
            own = values[place]
            gaps = np.diff(own) > 1e-10 * np.abs(own).max(initial=1e-300)
            for group in np.split(np.arange(own.size), np.flatnonzero(gaps) + 1):
                free = np.linalg.qr(rng.standard_normal((group.size, group.size)))[0]
                vectors[place][:, group] = vectors[place][:, group] @ free
        return type(eigh(EYE))(values, vectors)

    def switch():
        monkeypatch.setattr(np.linalg, "eigh", any_eigh)
        first, second = (np.linalg.eigh(EYE)[1] for _ in range(2))
        assert np.abs(first - second).max() > 0.1
        np.testing.assert_allclose(first @ first.T, EYE, atol=1e-14)

    return switch


def plane():
    """Three equal components in discrete time, measured alike: every eigenvalue repeats."""
    move = [0.9 * s + sympy.sin(s) / 5 + w for s, w in zip(X, W, strict=True)]
    sensor = StochasticMap(X, [s + v for s, v in zip(X, V, strict=True)], Noise(V))
    return DiscreteSystem(StochasticMap(X, move, Noise(W)), sensor, [0, 0, 0], EYE)


def designed():
    given = {"paths": 2000, "seed": 1, "nodes": 0, "predictor": Polynomial(2, 2)}
    filter = synthesize(plane(), Memory(1), Taylor(), np.arange(4), **given)
    found = filter.run(np.arange(4), plane().simulate(np.arange(4), 3, 5).measurements)
    return found.mean, found.loglik


def redundant_sensor():
    spread = np.diag([1.0, 1.0, 0.0]) + np.outer([1, 1, 0], [1, 1, 0])
    joint = Moments(np.zeros(3), 0.5 * spread, spread)
    return tuple(update(np.zeros(3), EYE, np.array([1.0, -1.0, 0.0]), joint))


FUNCTIONS = x**2 * y + z, sympy.sqrt(x**2 + y**2 + z**2), abs(x + y) * z
BELL = sympy.exp(-(x**2) - y**2 - z**2) * sympy.cos(x + y)
CASES = {
    "paths": lambda: plane().simulate(np.arange(4), 5, 1).states,
    "norm": lambda: norm_mean(*LAW[:2]),
    "elevation": lambda: elevation_moments([0.3, 0.4, 0.5], EYE),
    "errors": lambda: tuple(mean_square_errors(f, X)(*LAW) for f in FUNCTIONS),
    "expectation": lambda: expectation_function(BELL, X)(*LAW[:2]),
    "design": designed,
    "redundant sensor": redundant_sensor,
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.filterwarnings("ignore:paths:UserWarning")
def test_a_result_does_not_depend_on_the_choice_of_eigenvectors(free_eigenvectors, name):
    before = CASES[name]()
    free_eigenvectors()
    after = CASES[name]()
    before, after = ([part] if hasattr(part, "dtype") else part for part in (before, after))
    for one, two in zip(before, after, strict=True):
        np.testing.assert_allclose(two, one, rtol=1e-8, atol=1e-9 * np.nanmax(np.abs(one)))
