import numpy as np
import pytest
from scipy.linalg import expm

from seedslib.filters.integration import adaptive, euler, rk4

MATRIX = np.array([[0.0, 1.0], [-4.0, -0.3]])


def rate(t, y):
    """Linear oscillator driven by sin t, on a list of components."""
    return [y[1], MATRIX[1, 0] * y[0] + MATRIX[1, 1] * y[1] + np.sin(t)]


def exact(start, stop, y):
    """Solution by the matrix exponential of the system extended by sin t and cos t."""
    whole = np.zeros((4, 4))
    whole[:2, :2] = MATRIX
    whole[1, 2], whole[2, 3], whole[3, 2] = 1, 1, -1
    return (expm(whole * (stop - start)) @ [*y, np.sin(start), np.cos(start)])[:2]


@pytest.mark.parametrize(("method", "order"), [(euler, 1), (rk4, 4)])
def test_order_of_fixed_steps(method, order):
    want = exact(0.5, 2.5, [1.0, 0.0])
    errors = [
        np.abs(np.array(method(rate, [1.0, 0.0], 0.5, 2.5, step)) - want).max()
        for step in (0.02, 0.01)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)


def test_steps_divide_the_interval_evenly():
    one = rk4(rate, [1.0, 0.0], 0.0, 1.0, 0.4)
    np.testing.assert_array_equal(one, rk4(rate, [1.0, 0.0], 0.0, 1.0, 1 / 3))


@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-11])
def test_adaptive_steps_keep_the_tolerance(rtol):
    got = adaptive(rate, [1.0, 0.0], 0.5, 6.5, 1.0, rtol=rtol, atol=rtol)
    np.testing.assert_allclose(got, exact(0.5, 6.5, [1.0, 0.0]), atol=30 * rtol)


def test_stiff_start_is_followed():
    """A rate of 2000 forces small steps at first; the sum of both exponentials is exact."""

    def stiff(t, y):
        return [-2000.0 * y[0], -y[1]]

    got = adaptive(stiff, [1.0, 1.0], 0.0, 0.5, 0.5)
    np.testing.assert_allclose(got, [0.0, np.exp(-0.5)], atol=1e-6)


def test_path_that_explodes_is_given_up_and_does_not_hold_the_others():
    """Y' = Y² from 3 is infinite at 1/3; from 0.1 it is 0.1 / (1 - 0.1 t)."""
    start = np.array([0.1, 3.0, np.nan])
    with np.errstate(over="ignore", invalid="ignore"):
        (got,) = adaptive(lambda t, y: [y[0] * y[0]], [start], 0.0, 1.0, 0.1)
    assert got[0] == pytest.approx(0.1 / 0.9, rel=1e-6)
    assert np.isnan(got[1:]).all()


def test_dormand_and_prince_are_of_order_five():
    """Steps of a given size, with tolerances that no step exceeds; y' = y cos t, z' = y z cos t."""

    def error(step):
        y, z = adaptive(
            lambda t, y: [y[0] * np.cos(t), y[1] * np.cos(t) * y[0]], [1.0, 1.0], 0.0, 2.0, step,
            rtol=1e9,
        )  # fmt: skip
        y_true = np.exp(np.sin(2.0))
        return np.abs(np.array([y / y_true, z / np.exp(y_true - 1.0)]) - 1.0)

    assert np.log2(error(0.05) / error(0.025)) == pytest.approx([5, 5], abs=0.4)
