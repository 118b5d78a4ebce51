"""What is refused: the type of the error, and the argument that its message names."""

import numpy as np
import pytest

from seedslib.riemann import circle, solve_riemann, wiener_gain, winding

Z, T = circle(16), circle(64)
GOOD = {"transition": [[0.8]], "sensor": [1.0], "state_noise": [[1.0]], "sensor_noise": 1.0}


def filtered(**changes):
    return lambda: wiener_gain(**{**GOOD, **changes})


def lost(size):
    t = circle(8192)
    return lambda: solve_riemann(np.exp(size * (t - 1 / t)), 1 / (t - 2))


REFUSALS = [
    (lambda: solve_riemann(np.ones(4), np.ones(4)), ValueError, "coefficient"),
    (lambda: solve_riemann(np.ones((16, 2)), np.ones(16)), ValueError, "coefficient"),
    (lambda: solve_riemann(Z * np.nan, Z), ValueError, "coefficient"),
    (lambda: solve_riemann(Z - 1, Z), ValueError, "coefficient.* zero"),
    (lambda: solve_riemann(Z**8, Z), ValueError, "coefficient.* phase"),
    (lost(50), ValueError, "coefficient.* digits"),
    (lost(800), ValueError, "coefficient.* digits"),
    (lambda: solve_riemann(np.ones(16), np.ones(8)), ValueError, "right"),
    (lambda: solve_riemann(T, np.zeros((64, 0))), ValueError, "right"),
    (lambda: solve_riemann(Z, Z, [1.0, 2.0]), ValueError, "polynomial"),
    (lambda: solve_riemann(1 / Z, Z, [1.0]), ValueError, "polynomial"),
    (lambda: solve_riemann(T, np.ones((64, 2, 3)), np.ones((1, 3, 2))), ValueError, "polynomial"),
    (lambda: solve_riemann(Z, Z, at_infinity="pole"), ValueError, "at_infinity"),
    (lambda: winding(circle(22) ** 10), ValueError, "coefficient"),
    (lambda: winding(np.r_[0.5e-12, np.ones(20)]), ValueError, "coefficient"),
    (lambda: winding(np.r_[5e-9, 1e4 * np.ones(20)]), ValueError, "coefficient"),
    (filtered(transition=[0.8]), ValueError, "transition"),
    (filtered(transition=[[1.0]]), ValueError, "transition"),
    (
        filtered(transition=np.diag([0.5, 1.1]), sensor=[1.0, 0], state_noise=np.diag([1.0, 0])),
        ValueError,
        "transition",
    ),
    (filtered(transition=[[0.9999]], nodes=1024), ValueError, "nodes"),
    (filtered(nodes=2), ValueError, "nodes"),
    (filtered(sensor=[1.0, 0.0]), ValueError, "sensor"),
    (filtered(sensor=[[1.0], [1.0]]), ValueError, "sensor"),
    (filtered(state_noise=[[-1.0]]), ValueError, "state_noise"),
    (filtered(sensor_noise=0.0), ValueError, "sensor_noise"),
    (filtered(sensor_noise=[1.0, 2.0]), ValueError, "sensor_noise"),
]


@pytest.mark.parametrize(("call", "error", "name"), REFUSALS)
def test_a_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()


def test_data_that_are_not_analytic_warn():
    with pytest.warns(UserWarning, match="last Fourier coefficients"):
        solve_riemann(np.exp(np.abs(T.real)), np.abs(T.imag))
