import numpy as np
import pytest
import sympy as sp

from seedslib.two_step import AugmentedDiffusion, LinearDiffusion

X, Y, Z = sp.symbols("x y z", real=True)
SCALAR = LinearDiffusion(-1, 0.5, 1, 0.1, [0.3], 4)
PLANAR = LinearDiffusion(
    [[0.0, 1.0], [-2.0, -0.5]], [[0.4]], [[1, 0]], 0.2, [1, 0], np.eye(2), [[0.0], [1.5]]
)


def test_both_drifts_of_the_power():
    power = AugmentedDiffusion(SCALAR, X**2, [X], Z)
    assert sp.expand(power.drift - (-2 * X**2 + sp.Rational(1, 2))) == 0
    assert sp.expand(power.rewritten().drift - (-2 * Z + sp.Rational(1, 2))) == 0
    assert power.noise == sp.Matrix([[X]])
    first, mixed, spread = power.initial_moments()
    assert first == pytest.approx(4.09)
    np.testing.assert_allclose(mixed, [2 * 0.3 * 4])
    assert spread == pytest.approx(2 * 16 + 4 * 4 * 0.09)


@pytest.mark.parametrize("f", [X**2 * Y, sp.sin(X) * Y, sp.exp(X - Y)])
def test_drift_is_the_derivative_of_the_mean(f):
    """E f(x(h)) from one point, to first order in h, by the exact Gaussian mean."""
    from seedslib.gaussian import expectation_function

    augmented = AugmentedDiffusion(PLANAR, f, [X, Y], Z)
    point, mean = np.array([0.7, -0.4]), expectation_function(f, [X, Y])
    slopes = []
    for step in (1e-3, 5e-4):
        move, noise = PLANAR.transition(0.0, step)
        slopes.append((mean(move @ point, noise) - mean(point, np.zeros((2, 2)))) / step)
    exact = float(augmented.drift.subs({X: 0.7, Y: -0.4}))
    assert 2 * slopes[1] - slopes[0] == pytest.approx(exact, rel=1e-5)


def test_numeric_functions_against_symbols():
    augmented = AugmentedDiffusion(PLANAR, X * Y, [X, Y], Z, drift=None)
    state, value = np.array([[0.3, 1.0], [0.5, -2.0]]), np.array([0.1, 4.0])
    drift, by_state, by_value, noise, power = augmented.functions(state, value)
    x, y = state
    rate = 0.4 * 1.5**2
    np.testing.assert_allclose(drift, y * y + x * (-2 * x - 0.5 * y))
    np.testing.assert_allclose(by_state, [-4 * x - 0.5 * y, 2 * y - 0.5 * x])
    np.testing.assert_allclose(by_value, 0.0)
    np.testing.assert_allclose(noise, [0 * x, rate * x])
    np.testing.assert_allclose(power, rate * x * x)


def test_rewriting_a_function_of_several_variables():
    augmented = AugmentedDiffusion(PLANAR, X * Y, [X, Y], Z).rewritten()
    assert Z in augmented.drift.free_symbols
    assert sp.expand(augmented.drift.subs(Z, X * Y) - augmented.ito_drift) == 0


def test_bad_input():
    with pytest.raises(ValueError, match="drift: wanted Ito"):
        AugmentedDiffusion(SCALAR, X**2, [X], Z, drift=-2 * Z)
    with pytest.raises(ValueError, match="f: wanted known symbols, got y"):
        AugmentedDiffusion(SCALAR, X * Y, [X], Z)
    with pytest.raises(ValueError, match="drift: wanted known symbols, got y"):
        AugmentedDiffusion(SCALAR, X**2, [X], Z, drift=Y)
    with pytest.raises(ValueError, match="variables: wanted 1"):
        AugmentedDiffusion(SCALAR, X, [X, Y], Z)
    with pytest.raises(ValueError, match="symbol: wanted distinct symbols"):
        AugmentedDiffusion(SCALAR, X, [X], X)
    with pytest.raises(ValueError, match="f: wanted a polynomial"):
        AugmentedDiffusion(SCALAR, sp.sin(X), [X], Z).rewritten()
    varying = LinearDiffusion(lambda t: -1, 0.5, 1, 0.1, [0.3], 4)
    with pytest.raises(ValueError, match="system: wanted constant"):
        AugmentedDiffusion(varying, X**2, [X], Z)


@pytest.mark.parametrize("f", [sp.Abs(X), sp.sign(X), sp.Max(X, 0) ** 2 * sp.Heaviside(X - 1)])
def test_a_kink_has_no_ito_formula(f):
    with pytest.raises(ValueError, match="f: wanted a twice differentiable function"):
        AugmentedDiffusion(SCALAR, f, [X], Z)
