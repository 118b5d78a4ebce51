"""No number hangs on what a linear-algebra kernel is free to choose.

Eigenvectors are free in sign, and by a rotation where eigenvalues repeat; orthogonal factors are
free in sign. Here the kernels choose at random, and every result must stay.
"""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base import correct
from seedslib.delay import DelayKalmanFilter, DelaySystem
from seedslib.design import Polynomial, synthesize
from seedslib.designed import Memory, SwitchingFilter, large_order
from seedslib.evaluation import compare
from seedslib.filters import extended_kalman, unscented_kalman
from seedslib.gaussian import (
    approximate_errors,
    elevation_moments,
    expectation_function,
    gauss_hermite,
    hermite_expansion,
    max_errors,
    mean_of,
    mean_square_errors,
    norm_mean,
)
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.linearization.moments import Moments
from seedslib.models import DiscreteSystem, Noise, StochasticMap
from seedslib.riemann import wiener_gain
from seedslib.two_step import LinearDiffusion, TwoStepEstimator

EYE = np.eye(3)
X = x, y, z = sympy.symbols("x y z", real=True)
V = sympy.symbols("v1:4", real=True)
W = sympy.symbols("w1:4", real=True)


def turned(vectors, values, rng):
    """Eigenvectors with other signs, and rotated where eigenvalues agree."""
    vectors = vectors.copy()
    for place in np.ndindex(values.shape[:-1]):
        own = values[place]
        gaps = np.diff(own) > 1e-10 * np.abs(own).max(initial=1e-300)
        for group in np.split(np.arange(own.size), np.flatnonzero(gaps) + 1):
            free = np.linalg.qr.__wrapped__(rng.standard_normal((group.size, group.size)))[0]
            block = vectors[place]
            block[:, group] = block[:, group] @ free
    return vectors


@pytest.fixture
def free_kernels(monkeypatch):
    """Switch on kernels that choose anew at every call."""
    eigh, qr, rng = np.linalg.eigh, np.linalg.qr, np.random.default_rng(7)

    def any_eigh(matrix, *rest):
        values, vectors = eigh(matrix, *rest)
        return np.linalg._linalg.EighResult(values, turned(vectors, values, rng))

    def any_qr(matrix, mode="reduced"):
        if mode == "r":
            triangle = qr(matrix, mode)
            return rng.choice([-1.0, 1.0], triangle.shape[-2])[:, None] * triangle
        basis, triangle = qr(matrix, mode)
        signs = rng.choice([-1.0, 1.0], triangle.shape[-2])
        return basis * signs, signs[:, None] * triangle

    any_qr.__wrapped__ = qr

    def switch():
        monkeypatch.setattr(np.linalg, "eigh", any_eigh)
        monkeypatch.setattr(np.linalg, "qr", any_qr)

    return switch


def plane():
    """Three equal components in discrete time, seen alike: every eigenvalue repeats."""
    move = StochasticMap(
        X, [0.9 * s + sympy.sin(s) / 5 + w for s, w in zip(X, W, strict=True)], Noise(W)
    )
    sensor = StochasticMap(X, [s + v for s, v in zip(X, V, strict=True)], Noise(V))
    return DiscreteSystem(move, sensor, [0, 0, 0], EYE)


def flow():
    return LinearDiffusion(-EYE, EYE, EYE, 0.1 * EYE, [0, 0, 0], 4 * EYE)


def delayed():
    return DelaySystem({0: 0.5 * EYE, 2: 0.3 * EYE}, EYE, EYE, EYE, EYE, history_cov=EYE)


def design(predictor=None):
    more = {} if predictor is None else {"predictor": predictor}
    return synthesize(
        plane(), Memory(1), Taylor(), np.arange(4), paths=2000, seed=1, nodes=0, **more
    )


def run(filter, steps=4, paths=3):
    data = plane().simulate(np.arange(steps), paths, 5)
    found = filter.run(np.arange(steps), data.measurements)
    return found.mean, found.loglik


def switching_design():
    made = synthesize(
        zoo.manoeuvring_target("noisy"), large_order(2), ExactGaussian(), np.arange(4),
        paths=4000, seed=3,
    )  # fmt: skip
    data = made.system.simulate(np.arange(4), 20, 5)
    found = made.run(np.arange(4), data.measurements, indicators=data.indicators)
    return found.mean, found.mode_prob


def mixture():
    system = zoo.manoeuvring_target("noisy")
    data = system.simulate(np.arange(4), 20, 5)
    filter = SwitchingFilter(system, Taylor())
    return filter.run(np.arange(4), data.measurements, indicators=data.indicators).mean


def two_step():
    estimator = TwoStepEstimator(flow(), x**2 + y * z, variables=X)
    return estimator.errors([0.0, 0.5, 2.0])


def delay_run(method):
    system = delayed()
    data = system.simulate(6, 4, 2)
    found = DelayKalmanFilter(system, method=method).run(data.times, data.measurements)
    return data.states, found.mean


def singular():
    spread = np.diag([1.0, 1.0, 0.0]) + np.outer([1, 1, 0], [1, 1, 0])
    cross = 0.5 * spread
    found = correct(
        np.zeros(3), EYE, np.array([1.0, -1.0, 0.0]), Moments(np.zeros(3), cross, spread)
    )
    return tuple(found)


def compared():
    scores = compare(
        {"ekf": extended_kalman(plane()), "ukf": unscented_kalman(plane())}, plane(),
        np.arange(3), 300, 1, consistency=True,
    )  # fmt: skip
    return scores["ekf"].average, scores["ukf"].average


LAW = ([0.3, 0.3, 0.3], 2 * EYE, 0.5 * EYE)
CASES = {
    "paths of a linear diffusion": lambda: flow().simulate([0.0, 0.5, 1.0], 5, 1).increments,
    "paths of a system with delay, chandrasekhar": lambda: delay_run("chandrasekhar"),
    "array": lambda: delay_run("array"),
    "structured": lambda: delay_run("structured"),
    "paths of a discrete system": lambda: plane().simulate(np.arange(4), 5, 1).states,
    "two steps": two_step,
    "a cubature mean": lambda: mean_of(
        lambda p: np.abs(p[0] + 2 * p[1] - p[2]), LAW[0], LAW[1], gauss_hermite(3, 5)
    ),
    "norm": lambda: norm_mean(LAW[0], LAW[1]),
    "elevation": lambda: elevation_moments([0.3, 0.4, 0.5], EYE),
    "maximum": lambda: max_errors(LAW[0][:2], LAW[1][:2, :2], LAW[2][:2, :2]),
    "polynomial": lambda: mean_square_errors(x**2 * y + z, X)(*LAW),
    "norm's errors": lambda: mean_square_errors(sympy.sqrt(x**2 + y**2 + z**2), X)(*LAW),
    "modulus": lambda: mean_square_errors(abs(x + y) * z, X)(*LAW),
    "complex exponentials": lambda: expectation_function(
        sympy.exp(-(x**2) - y**2 - z**2) * sympy.cos(x + y), X
    )(*LAW[:2]),
    "a cut expansion": lambda: approximate_errors(
        sympy.tanh(x + y / 2), (x, y), degree=4, nodes=12
    )([0.3, 0.3], 2 * np.eye(2), 0.5 * np.eye(2)),
    "its coefficients": lambda: hermite_expansion(
        sympy.tanh(x + y / 2), (x, y), LAW[0][:2], 2 * np.eye(2), 0.5 * np.eye(2), degree=4,
        nodes=12,
    ).coefficients,
    "wiener": lambda: wiener_gain(0.5 * EYE, [[1.0, 1.0, 1.0]], EYE, 1.0).gain,
    "an affine design": lambda: run(design()),
    "a polynomial design": lambda: run(design(Polynomial(2, 2))),
    "a switching design": switching_design,
    "a switching filter": mixture,
    "a redundant sensor": singular,
    "errors and consistency": compared,
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
@pytest.mark.filterwarnings("ignore:f. the quadrature rule:UserWarning")
@pytest.mark.filterwarnings("ignore:paths:UserWarning")
def test_free_choices_of_kernels_change_nothing(free_kernels, name):
    before = CASES[name]()
    free_kernels()
    after = CASES[name]()
    before, after = ([part] if hasattr(part, "dtype") else part for part in (before, after))
    for one, two in zip(before, after, strict=True):
        scale = np.nanmax(np.abs(one))
        np.testing.assert_allclose(two, one, rtol=1e-8, atol=1e-9 * scale)


def test_the_choices_are_made(free_kernels):
    """The planted kernels do choose: twice the same matrix, two bases, both right."""
    free_kernels()
    first, second = (np.linalg.eigh(EYE)[1] for _ in range(2))
    assert np.abs(first - second).max() > 0.1
    for basis in (first, second):
        np.testing.assert_allclose(basis.T @ basis, EYE, atol=1e-14)
    cov = np.random.default_rng(1).standard_normal((4, 4))
    cov = cov @ cov.T
    values, vectors = np.linalg.eigh(cov)
    np.testing.assert_allclose((vectors * values) @ vectors.T, cov, rtol=1e-12)
    basis, triangle = np.linalg.qr(cov)
    np.testing.assert_allclose(basis @ triangle, cov, rtol=1e-12)
