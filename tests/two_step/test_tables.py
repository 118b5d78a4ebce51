"""Two steps: errors by a rule of the rule, written out; and the paths of a seed."""

import numpy as np
import pytest
import sympy as sp

from seedslib.gaussian import fifth_degree, gauss_hermite
from seedslib.two_step import KalmanBucyFilter, LinearDiffusion, TwoStepEstimator, laws

X, Y = sp.symbols("x y", real=True)
SYSTEM = LinearDiffusion(
    [[-0.9, 0.4], [0.3, -1.2]], [[0.7, 0.2], [0.2, 0.5]], [[1.1, -0.3]], [[0.4]], [0.6, -0.2],
    [[0.9, 0.15], [0.15, 0.6]],
)  # fmt: skip


@pytest.mark.parametrize("block", [1, 7, 10**6])
@pytest.mark.parametrize("rule", [fifth_degree(2), gauss_hermite(2, 3)])
def test_errors_by_a_rule_are_a_double_sum(rule, block, monkeypatch):
    monkeypatch.setattr(laws, "BLOCK_POINTS", block)
    functions = [X**3 * Y - X, sp.exp(Y / 2) + X]
    ours = TwoStepEstimator(SYSTEM, functions, variables=[X, Y], quadrature=rule)
    scalar = TwoStepEstimator(SYSTEM, functions[0], variables=[X, Y], quadrature=rule)
    known = KalmanBucyFilter(SYSTEM).moments([0.4])
    mean, cov, error_cov = known.mean[0], known.cov[0], known.error_cov[0]
    spread = np.linalg.cholesky(cov - error_cov)
    root = np.linalg.cholesky(error_cov)
    f = sp.lambdify((X, Y), functions)
    optimal, plugin = np.zeros((2, 2)), np.zeros((2, 2))
    for w, u in zip(rule.weights, rule.points.T, strict=True):
        centre = mean + spread @ u
        values = np.array([f(*(centre + root @ v)) for v in rule.points.T])
        first = rule.weights @ values
        gap = first - np.array(f(*centre))
        inner = (values - first).T @ ((values - first) * rule.weights[:, None])
        optimal += w * inner
        plugin += w * (inner + np.outer(gap, gap))
    found = ours.errors([0.4])
    # another root of a covariance turns the points of a rule: here that of Cholesky
    law = laws.quadrature_law(functions, [X, Y], rule)
    monkeypatch.setattr(laws, "square_root", np.linalg.cholesky)
    monkeypatch.setattr("seedslib.gaussian.quadrature.square_root", np.linalg.cholesky)
    pair = law.errors(mean, cov, error_cov)
    np.testing.assert_allclose(pair.optimal, optimal, rtol=1e-11)
    np.testing.assert_allclose(pair.plugin, plugin, rtol=1e-11)
    assert found.optimal.shape == (1, 2, 2)
    one = scalar.errors([0.4])
    np.testing.assert_allclose(one.optimal, found.optimal[:, 0, 0], rtol=1e-12)
    np.testing.assert_allclose(one.plugin, found.plugin[:, 0, 0], rtol=1e-12)


def test_options_are_named():
    with pytest.raises(TypeError, match="positional"):
        TwoStepEstimator(SYSTEM, X * Y, [X, Y])
    with pytest.raises(TypeError, match="positional"):
        TwoStepEstimator(SYSTEM, X * Y, 0.3)
    with pytest.raises(TypeError, match=r"quadrature: wanted a Rule.*got str"):
        TwoStepEstimator(SYSTEM, X * Y, variables=[X, Y], quadrature="hermite")


def test_the_paths_of_a_seed():
    found = SYSTEM.simulate([0.0, 0.3, 0.7], 2, 11)
    states = [[1.013124067763, -0.092001166505], [0.324120449313, -0.36270738057]]
    increments = [[-0.039007234448, 0.175190432093], [0.415597453215, -0.853736067903]]
    np.testing.assert_allclose(found.states[2], states, atol=1e-11)
    np.testing.assert_allclose(found.increments[:, 0], increments, atol=1e-11)
