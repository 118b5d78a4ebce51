"""sin(x) / x in models: the value and its derivatives against arithmetic of eighty digits."""

import warnings

import mpmath
import numpy as np
import pytest
import sympy

from seedslib.linearization import Taylor, Unscented
from seedslib.models import Noise, StochasticMap
from seedslib.models.sinc import SincRatio, sinc_ratio

u, v, w, q = sympy.symbols("u v w q", real=True)
STEP = 0.1
TURN = StochasticMap(
    (u, v, w),
    [
        STEP * sympy.sinc(w * STEP) * u - w * STEP**2 / 2 * sympy.sinc(w * STEP / 2) ** 2 * v,
        sympy.cos(w * STEP) * u - sympy.sin(w * STEP) * v,
        w + q,
    ],
    Noise((q,), cov=[[0.1]]),
)


def exact_turn(*x):
    """The displacement along the first axis, (sin(w h) u - (1 - cos(w h)) v) / w."""
    a, b, rate = (mpmath.mpf(part) for part in x)
    if rate == 0:
        return a * STEP
    angle = rate * mpmath.mpf(STEP)
    return (mpmath.sin(angle) * a - (1 - mpmath.cos(angle)) * b) / rate


@pytest.mark.parametrize("rate", [0.0, 1e-300, 1e-12, -1e-7, 1e-3, 0.7, -19.99, 20.01, 60.0])
def test_a_turn_and_its_slope_at_any_rate(rate):
    mean = [3.0, 4.0, rate]
    with mpmath.workdps(80), warnings.catch_warnings():
        warnings.simplefilter("error")
        slope = mpmath.diff(exact_turn, tuple(mean), (0, 0, 1), h=mpmath.mpf(10) ** -15)
        wanted = float(exact_turn(*mean)), float(slope)
        value, cross, _ = Taylor().moments(TURN)(0.0, np.array(mean), np.diag([0, 0, 1.0]))
        points = Unscented().moments(TURN)(0.0, np.array(mean), 1e-8 * np.eye(3))
    assert value[0] == pytest.approx(wanted[0], rel=1e-14, abs=1e-15)
    assert cross[2, 0] == pytest.approx(wanted[1], rel=1e-13, abs=1e-15)
    assert points.mean[0] == pytest.approx(wanted[0], rel=1e-7)
    assert points.cross[2, 0] == pytest.approx(1e-8 * wanted[1], rel=1e-6)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_derivatives_of_any_order(order):
    x = sympy.Symbol("x", real=True)
    made = sympy.lambdify(
        x, SincRatio(0, x).diff(x, order), [{"SincRatio": sinc_ratio}, "numpy"]
    )  # fmt: skip
    with mpmath.workdps(80):
        for place in (1e-9, 0.3, 1.999, -2.001, 5.0):
            wanted = mpmath.diff(mpmath.sinc, mpmath.mpf(place), order)
            assert float(made(place)) == pytest.approx(float(wanted), rel=1e-11, abs=1e-16)
    assert float(made(0.0)) == pytest.approx({2: -1 / 3}.get(order, 0.0), abs=1e-16)
