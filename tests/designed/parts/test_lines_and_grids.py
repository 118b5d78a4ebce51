"""Straight lines of code for one path, and where the times of a record lie in a design."""

import warnings

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal

from seedslib.base import correct
from seedslib.base.clock import Clock
from seedslib.designed.between import Interval, at, known_kind
from seedslib.designed.guards import (
    freeze,
    moment,
    positions,
    want_corrected,
    want_forecast,
    want_next,
    warn_of_mended,
)
from seedslib.designed.predictors import range_roots
from seedslib.designed.traced import WIDEST, law_symbols, mean_velocity, traced_correction
from seedslib.linearization import Cubature, ExactGaussian, Taylor
from seedslib.models import JumpDiffusion, Noise, StochasticMap

a, b, v, w, t = sympy.symbols("a b v w t", real=True)
CLOCK = Clock(np.array([0.0, 0.5, 2.0]))


# Lines


@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian()])
def test_lines_of_a_sensor_that_changes_with_time(rule):
    """Two states and two measurements, of which one or both states are corrected."""
    map = StochasticMap((a, b), [t * a * b + v, a + t**2 + (1 + t) * w], Noise((v, w)), time=t)
    rng = np.random.default_rng(7)
    for rows in (1, 2):
        lines = traced_correction(map, rule, rows)
        for now in (0.4, 3.0):
            mean, root, y = rng.normal(size=2), rng.normal(size=(2, 3)), rng.normal(size=2)
            cov = root @ root.T
            wanted = correct(mean, cov, y, rule.moments(map)(now, mean, cov), rows)
            estimate, rest, loglik = lines(now, mean, cov, y, True)
            assert estimate.shape == (rows,)
            assert_allclose(estimate, wanted[0], rtol=1e-11)
            assert_allclose(rest, wanted[1], rtol=1e-10)
            assert loglik == pytest.approx(float(wanted[2]), rel=1e-11)
            again, none, other = lines(now, mean, cov, y, False)
            assert none is None
            assert_allclose(again, estimate, rtol=1e-13)
            assert other == pytest.approx(loglik, rel=1e-13)


def test_lines_of_a_scalar_by_hand():
    """P - P² / (P + R) and the density of the innovation."""
    lines = traced_correction(StochasticMap((a,), [a + v], Noise((v,), cov=[[0.5]])), Taylor(), 1)

    def found(variance, y=1.0):
        return lines(0.0, np.array([0.25]), np.array([[variance]]), np.array([y]), True)

    mean, cov, loglik = found(2.0)
    assert mean[0] == pytest.approx(0.25 + 0.8 * 0.75, rel=1e-14)
    assert cov[0, 0] == pytest.approx(0.4, rel=1e-13)
    assert loglik == pytest.approx(-0.5 * (0.75**2 / 2.5 + np.log(2 * np.pi * 2.5)), rel=1e-13)
    # a state that is known stays; a measurement that is missing is the general correction's
    mean, cov, _ = found(0.0)
    assert mean[0] == 0.25
    assert cov[0, 0] == 0.0
    assert found(2.0, np.nan) is None
    # where the noise is rounded off, or where numbers end, lines are no use
    for variance in (1e20, 0.5 / WIDEST, 2.0 * WIDEST, -1.0):
        assert found(variance) is None
    assert found(1e-12) is not None


def test_which_sensors_have_lines():
    """At most four states and two measurements, with formulas."""
    names = sympy.symbols("q0:5")

    def sensor(n, m):
        return StochasticMap(names[:n], list(names[:m]), Noise(()))

    for n, m, there in ((4, 2, True), (5, 1, False), (4, 3, False), (1, 1, True)):
        assert (traced_correction(sensor(n, m), Taylor(), 1) is not None) is there
    assert traced_correction(sensor(2, 1), Cubature(), 1) is None
    plain = StochasticMap.from_functions(1, 1, lambda t, x, v: x + v, Noise(1))
    assert traced_correction(plain, Taylor(), 1) is None
    mean, lower, cov = law_symbols(3)
    assert len(mean) == 3
    assert len(lower) == 6
    assert cov == cov.T
    assert [cov[i, j] for i in range(3) for j in range(i + 1)] == list(lower)


@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian(), Cubature()])
def test_mean_velocities_of_a_time(rule):
    """E t a b of a normal law, jumps included."""
    system = JumpDiffusion(
        (a, b), [t * b, t * a * b], [[1], [0]], [a + v], Noise((v,)), [0, 0], np.eye(2),
        intensity=2 + t, jump=[w, 0], marks=Noise((w,), mean=0.5), time=t, step=0.1,
    )  # fmt: skip
    cov = np.array([[0.3, 0.1], [0.1, 0.5]])
    mean = [np.array([0.2, -1.0]), np.array([0.7, 0.4])]
    first, second = mean_velocity(system, rule)(3.0, mean, cov)
    assert_allclose(first, 3 * mean[1] + 2.5, rtol=1e-12)
    product = mean[0] * mean[1] + (0.0 if isinstance(rule, Taylor) else 0.1)
    assert_allclose(second, 3 * product, rtol=1e-12)


def test_roots_on_the_range_of_a_covariance():
    direction = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 2.0]])
    cov = direction.T @ direction
    root, back = range_roots(cov)
    assert root.shape == back.shape == (3, 2)
    assert_allclose(root @ root.T, cov, atol=1e-13)
    assert_allclose(back.T @ root, np.eye(2), atol=1e-13)
    assert range_roots(np.zeros((2, 2)))[0].shape == (2, 0)
    for unit in (1e-30, 1.0, 1e30):  # in any unit
        assert range_roots(unit * np.diag([1.0, 2e-13]))[0].shape == (2, 2)
        assert range_roots(unit * np.diag([1.0, 0.5e-13]))[0].shape == (2, 1)


# Grids


def test_where_the_times_of_a_record_lie():
    times = np.array([0.0, 0.25, 0.5 + 1e-11, 1.0, 2.0, 2.5])
    y = np.full((6, 1, 2), np.nan)
    y[[0, 2, 4]] = 1.0
    assert positions(times, y, CLOCK, 2.5).tolist() == [0, -1, 1, -1, 2, -1]
    assert positions(times[:4], y[:4], CLOCK, 2.0).tolist() == [0, -1, 1, -1]
    assert positions(times[:1], y[:1], CLOCK, 2.0).tolist() == [0]
    # a measurement time that is the last one but for rounding is there
    short = np.array([0.0, 0.5 - 1e-11])
    assert positions(short, y[[0, 2]], CLOCK, 2.0).tolist() == [0, 1]
    near = CLOCK.tolerance / 2
    assert positions(times, y, CLOCK, 2.5 - near).tolist()[-1] == -1
    for given, shown, end, message in (
        (times + 0.1, y, 9.0, "times: wanted to begin at 0, got 0.1$"),
        (times, y, 2.0, "times: wanted at most 2, where the design ends, got 2.5; seedslib"),
        (times[[0, 1, 3]], y[[1, 1, 1]], 9.0, "times: wanted all measurement times of the design, "
         "0.5 is not among them$"),
        (times, np.ones_like(y), 9.0, "measurements: wanted NaN at 0.25, which is no measurement"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=f"^{message}"):
            positions(given, shown, CLOCK, end)


def test_the_next_measurement_and_no_other():
    assert [moment(CLOCK, k, 0) for k in range(3)] == [0.0, 0.5, 2.0]
    assert [moment(CLOCK, k, 2) for k in (3, 4, 5)] == [2.5, 4.0, 4.5]
    with pytest.raises(ValueError, match=r"^t: wanted at most the last measurement time 2$"):
        moment(CLOCK, 3, 0)
    want_next(CLOCK, 1, 0.5 + CLOCK.tolerance / 2, 0)
    want_next(CLOCK, 3, 2.5, 2)
    with pytest.raises(ValueError, match=r"^t: wanted the next measurement time 0\.5, got 0\.6$"):
        want_next(CLOCK, 1, 0.6, 0)


class State:
    def __init__(self, index, corrected):
        self.index, self.corrected = index, corrected


def test_steps_in_their_order():
    want_forecast(State(0, False))
    want_corrected(State(0, True))
    for state in (State(-1, False), State(0, True), State(3, True)):
        with pytest.raises(ValueError, match=r"^state: wanted a forecast, got a state without"):
            want_forecast(state)
    for state in (State(-1, False), State(2, False)):
        with pytest.raises(ValueError, match=r"^state: wanted a state after a correction, got a"):
            want_corrected(state)


def test_mended_covariances_are_told_if_there_are_any():
    with pytest.warns(UserWarning, match=r"^covariances: eigenvalues of 3 were raised to 1e-12"):
        warn_of_mended(3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_mended(0)


def test_arrays_in_tuples_are_frozen():
    parts = np.ones(2), (np.ones(3), (np.ones(1), "word", None)), [np.ones(1)]
    freeze(parts)
    for part in (parts[0], parts[1][0], parts[1][1][0]):
        with pytest.raises(ValueError, match="read-only"):
            part[0] = 2.0
    parts[2][0][0] = 2.0


def test_forecasts_at_the_ends_of_an_interval():
    """With an end that is known, and without one; beyond it the last value stays."""
    values = [np.array([1.0]), np.array([3.0]), np.array([2.0])]
    whole = Interval(np.array([1.0, 2.0, 4.0]), values, 1, None, None)
    open_end = Interval(np.array([1.0, 2.0]), values[:2], 1, None, None)
    for interval, moments in (
        (whole, ((1.0, 1.0), (1.5, 2.0), (2.0, 3.0), (3.0, 2.5), (4.0, 2.0))),
        (open_end, ((1.0, 1.0), (1.5, 2.0), (2.0, 3.0), (2.0 + 1e-12, 3.0))),
    ):
        for now, value in moments:
            assert at(interval, now, "interpolated")[0] == pytest.approx(value, rel=1e-11)
    assert at(whole, 4.0, "piecewise constant")[0] == 3.0
    assert at(whole, 4.0, "piecewise linear, first constant")[0] == 7.0
    alone = Interval(np.array([1.0]), values[:1], 0)
    assert_array_equal(at(alone, 1.0, "interpolated"), values[0])
    assert alone.last is alone.last_node is None
    assert known_kind("between", "linear") == "linear"
    with pytest.raises(ValueError, match=r"^name: wanted one of interpolated, piecewise constant"):
        known_kind("name", "cubic")
