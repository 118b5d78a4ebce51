"""What is refused: the type of the error, and the argument that its message names."""

import numpy as np
import pytest

from seedslib.riemann import circle, solve_riemann, solve_rotations, wiener_gain, winding

Z, T = circle(16), circle(64)
GOOD = {"transition": [[0.8]], "sensor": [1.0], "state_noise": [[1.0]], "sensor_noise": 1.0}


def filtered(**changes):
    return lambda: wiener_gain(**{**GOOD, **changes})


def lost(size):
    return lambda: solve_riemann(lambda t: np.exp(size * (t - 1 / t)), lambda t: 1 / (t - 2))


REFUSALS = [
    (lambda: solve_riemann(np.ones(4), np.ones(4)), ValueError, "coefficient"),
    (lambda: solve_riemann(np.ones((16, 2)), np.ones(16)), ValueError, "coefficient"),
    (lambda: solve_riemann(Z * np.nan, Z), ValueError, "coefficient"),
    (lambda: solve_riemann("G", Z), TypeError, "coefficient"),
    (lambda: solve_riemann(Z - 1, Z), ValueError, "coefficient.* zero"),
    (lambda: solve_riemann(Z**8, Z), ValueError, "coefficient.* phase"),
    (lambda: solve_riemann(lambda t: t**56, lambda t: t, nodes=64), ValueError, "coefficient"),
    (lost(50), ValueError, "coefficient.* residual"),
    (lost(800), ValueError, "coefficient.* 700"),
    (lambda: solve_riemann(np.ones(16), np.ones(8)), ValueError, "right"),
    (lambda: solve_riemann(T, np.zeros((64, 0))), ValueError, "right"),
    (lambda: solve_riemann(Z, lambda t: t), TypeError, "right"),
    (lambda: solve_riemann(Z, Z, [1.0, 2.0]), ValueError, "polynomial"),
    (lambda: solve_riemann(1 / Z, Z, [1.0]), ValueError, "polynomial"),
    (lambda: solve_riemann(T, np.ones((64, 2, 3)), np.ones((1, 3, 2))), ValueError, "polynomial"),
    (lambda: solve_riemann(Z, Z, at_infinity="pole"), ValueError, "at_infinity"),
    (lambda: solve_riemann(Z, Z, nodes=16), ValueError, "nodes"),
    (lambda: solve_riemann(lambda t: t, lambda t: t, nodes=7), ValueError, "nodes"),
    (lambda: solve_riemann(Z, 1 / (Z - 0.01)).inside(2.0), ValueError, "z"),
    (lambda: solve_riemann(Z, 1 / (Z - 0.01)).outside(0.5), ValueError, "z"),
    (lambda: solve_riemann(1 / Z, 1 / (Z - 0.01)).outside(2.0), ValueError, "solution"),
    (lambda: winding(circle(22) ** 10), ValueError, "coefficient"),
    (lambda: winding(np.r_[0.5e-12, np.ones(20)]), ValueError, "coefficient"),
    (lambda: winding(np.r_[5e-9, 1e4 * np.ones(20)]), ValueError, "coefficient"),
    (lambda: solve_rotations(Z, Z), ValueError, "coefficients"),
    (lambda: solve_rotations(np.ones((3, 32)), np.ones(32)), ValueError, "coefficients"),
    (lambda: solve_rotations([Z, Z], Z), ValueError, "coefficients.* coefficient 0"),
    (lambda: solve_rotations(np.ones((2, 16)), np.ones(8)), ValueError, "right"),
    (lambda: solve_rotations([Z**2, 0 * Z], Z, [[1.0]]), ValueError, "polynomials"),
    (lambda: solve_rotations([Z], Z, 5), TypeError, "polynomials"),
    (filtered(transition=[0.8]), ValueError, "transition"),
    (filtered(transition=[[1.0]]), ValueError, "transition.* on the unit circle"),
    (filtered(transition=np.diag([0.5, 1.1]), sensor=[1.0, 0], state_noise=np.diag([1.0, 0])),
     ValueError, "transition.* unit circle: 1"),
    (filtered(transition=[[0.9999]], nodes=1024), ValueError, "nodes"),
    (filtered(nodes=2), ValueError, "nodes"),
    (filtered(sensor=[1.0, 0.0]), ValueError, "sensor"),
    (filtered(sensor=[[1.0], [1.0]]), ValueError, "sensor"),
    (filtered(sensor=[1e160]), ValueError, "state_noise, sensor"),
    (filtered(state_noise=[[-1.0]]), ValueError, "state_noise"),
    (filtered(sensor_noise=0.0), ValueError, "sensor_noise"),
    (filtered(sensor_noise=[1.0, 2.0]), ValueError, "sensor_noise"),
    (filtered(lags=-1), ValueError, "lags"),
    (filtered(lags=10**8), ValueError, "lags"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "error", "name"), REFUSALS)
def test_a_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()


def test_data_that_are_not_analytic_warn():
    with pytest.warns(UserWarning, match="last Fourier coefficients"):
        solve_riemann(np.exp(np.abs(T.real)), np.abs(T.imag))
    t = circle(48)
    jump = np.where((t**3).imag > 0, 0.5, 0.2)
    with pytest.warns(UserWarning, match="last Fourier coefficients"):
        solve_rotations(np.stack([2 + 0 * t, jump, 0 * t]), 1 / (t - 2))
