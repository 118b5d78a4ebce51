"""The falling body by the paper's own formulas (26) to (30), typed out, against other routes."""

import numpy as np
import pytest

from oracles import literal_lemmas as literal
from oracles import piecewise_routes as routes
from seedslib.gaussian import interval, lift
from seedslib.piecewise import PiecewiseLinearFilter, examples

MEAN, COV = np.array([1.3, -0.4]), np.array([[0.8, 0.5], [0.5, 1.1]])
ABOUT, EDGES = np.array([0.7, 0.9]), (0.2, 1.9)


def by_quadrature():
    """P, S, Q of (1) in the plane: Gauss-Legendre in the range, Gauss-Hermite in the angle."""
    node, share = np.polynomial.legendre.leggauss(40)
    x = EDGES[0] + (EDGES[1] - EDGES[0]) * (node + 1) / 2
    weight = (EDGES[1] - EDGES[0]) / 2 * share
    weight = weight * np.exp(-0.5 * (x - MEAN[0]) ** 2 / COV[0, 0]) / np.sqrt(2 * np.pi * COV[0, 0])
    tilt, part = np.polynomial.hermite_e.hermegauss(10)
    gain = COV[0, 1] / COV[0, 0]
    rest = np.sqrt(COV[1, 1] - gain * COV[0, 1])
    points = np.array(
        [x + 0 * tilt[:, None], MEAN[1] + gain * (x - MEAN[0]) + rest * tilt[:, None]]
    )
    mass = (part / part.sum())[:, None] * weight
    away = points - ABOUT[:, None, None]
    return mass.sum(), (points * mass).sum(axis=(1, 2)), np.einsum("iab,jab,ab", away, away, mass)


def printed(**changes):
    values = {"mean": MEAN, "cov": COV, "lower": EDGES[0], "upper": EDGES[1], "about": ABOUT}
    return literal.formula_30(**(values | changes))


def agree(one, other):
    return all(np.allclose(a, b, rtol=1e-12, atol=1e-13) for a, b in zip(one, other, strict=True))


def test_formula_30_is_the_integral():
    assert agree(printed(), by_quadrature())
    whole = lift(interval(MEAN[0], COV[0, 0], *EDGES), MEAN, COV, ABOUT)
    assert agree(printed(), (whole.mass, whole.first, whole.second))


@pytest.mark.parametrize(
    "fault",
    [
        {"cov": COV * [[1, -1], [-1, 1]]},
        {"cov": COV + np.diag([0.0, 1e-6])},
        {"about": ABOUT + np.array([0.0, 1e-6])},
        {"about": MEAN},
    ],
    ids=["sign of the covariance", "variance of the angle", "reference point", "about the mean"],
)
def test_formula_30_with_a_fault_is_not_the_integral(fault):
    assert not agree(printed(**fault), by_quadrature())


def test_last_exponent_of_formula_30_needs_its_2():
    """exp{-(x - m)^2 / 2 Gamma} once with Gamma for 2 Gamma changes Q."""
    lower = EDGES[0] - MEAN[0]
    bell = np.exp(-(lower**2) / (2 * COV[0, 0]))
    fault = lower * np.sqrt(COV[0, 0] / (2 * np.pi)) * (bell**2 - bell)
    assert abs(fault) > 0.01
    mass, first, second = printed()
    second = second + fault * np.outer([1, COV[0, 1] / COV[0, 0]], [1, COV[0, 1] / COV[0, 0]])
    assert not agree((mass, first, second), by_quadrature())


def farthest(y, **faults):
    """Largest distance of typed formulas and library, in posterior deviations."""
    found = PiecewiseLinearFilter(examples.falling_body(100)).run(10, y)
    worst = 0.0
    for t, (mean, cov) in enumerate(literal.falling_body(y[1:, 0, 0], 100, 1e-3, **faults), 1):
        deviation = np.sqrt(np.diag(found.cov[t, :, :, 0]))
        worst = max(worst, np.abs((mean - found.mean[t, :, 0]) / deviation).max())
        scale = np.outer(deviation, deviation)
        worst = max(worst, np.abs((cov - found.cov[t, :, :, 0]) / scale).max())
    return worst


@pytest.mark.parametrize("start", [5.0, 12.0, 50.0])
def test_typed_filter_is_the_library_s(start):
    y = routes.falling(start, np.random.default_rng(7).standard_normal((1, 10)))
    assert farthest(y) < 1e-8
    assert farthest(y, mass=False) > 0.05
    assert farthest(y, late=1.0) > 0.05


def test_speed_and_deviation_of_a_reading():
    """A body thrown upwards with g times one second falls by g t (t - 2) / 2."""
    system = examples.falling_body(4, deviation=7.0, speed=-1.0)
    assert system.cov0[0, 0] == 49.0
    state = np.array([[20.0], [0.1]])
    for t in range(10):
        state = system.functions.transition.value(float(t), state, np.zeros((0, 1)))
        fallen = 0.005 * (t + 1) * (t - 1) / 20.0
        np.testing.assert_allclose(state[1], 0.1 - fallen, rtol=1e-13)
