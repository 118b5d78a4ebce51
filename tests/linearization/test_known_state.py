"""Exact Gaussian means where the state is known: on a kink, beside it, in one direction only."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose

from seedslib.filters import assumed_density
from seedslib.linearization import ExactGaussian
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, y, v, w = sympy.symbols("x y v w", real=True)
TIMES = np.arange(6.0)
RECORD = np.array([np.nan, 0.3, -0.2, 1.1, np.nan, 0.4])[:, None, None]
SWITCHED = (
    sympy.Abs(x),
    sympy.Min(x, 0) + 1,
    sympy.Min(x, 0) ** 3,
    sympy.Piecewise((sympy.exp(x), x < 0), (1, True)),
)
JUMPS = sympy.sign(x), sympy.Piecewise((x + 1, x >= 0), (0, True))


def moved(value, mean, cov):
    state = (x, y)[: len(mean)]
    found = ExactGaussian().moments(StochasticMap(state, [value + v], Noise((v,), cov=[[0.25]])))
    return found(0.0, np.array(mean), np.array(cov))


def started(value, mean, variance):
    """Estimates of a system that is known, or all but known, to begin with."""
    system = DiscreteSystem(
        StochasticMap([x], [value + v], Noise((v,), cov=[[0.25]])),
        StochasticMap([x], [x + w], Noise((w,), cov=[[0.25]])),
        mean0=mean, cov0=variance,
    )  # fmt: skip
    return assumed_density(system).run(TIMES, RECORD)


@pytest.mark.parametrize("value", SWITCHED, ids=str)
@pytest.mark.parametrize("place", [0.0, 1.0, -1.0, 1e-200, 60.0, 3.7])
def test_a_known_state_is_moved_as_it_is(value, place):
    found = moved(value, [place], [[0.0]])
    want = float(value.subs(x, sympy.Float(place)))
    assert found.mean[0] == pytest.approx(want, rel=1e-14, abs=1e-150)
    assert found.cov[0, 0] == pytest.approx(0.25, rel=1e-14)
    assert found.cross[0, 0] == 0.0


@pytest.mark.parametrize(("value", "sides"), zip(JUMPS, [(-1, 1), (0, 1)], strict=True), ids=str)
def test_a_state_known_to_be_on_a_jump_is_on_either_side(value, sides):
    """The limit of a variance that vanishes: one half of the mass goes each way."""
    for place, (low, high) in ((0.0, sides), (0.5, 2 * [value.subs(x, 0.5)])):
        found = moved(value, [place], [[0.0]])
        assert found.mean[0] == pytest.approx(float(low + high) / 2)
        assert found.cov[0, 0] == pytest.approx(0.25 + float(high - low) ** 2 / 4)
        near = moved(value, [place], [[1e-30]])
        assert_allclose(found.mean, near.mean, atol=1e-14)
        assert_allclose(found.cov, near.cov, atol=1e-14)


@pytest.mark.parametrize("value", [*SWITCHED, *JUMPS], ids=str)
@pytest.mark.parametrize("place", [0.0, 1.0])
def test_a_filter_goes_on_from_a_known_state(value, place):
    known = started(value, place, 0.0)
    close = started(value, place, 1e-24)
    for part in ("mean", "cov", "loglik"):
        found = getattr(known, part)
        assert np.isfinite(found).all()
        assert_allclose(found, getattr(close, part), rtol=1e-9, atol=1e-9)


def test_a_variance_that_dies_away_leaves_the_filter_alive():
    """A state that halves without noise: its variance passes every size down to zero."""
    system = DiscreteSystem(
        StochasticMap([x], [sympy.Max(x, 0) / 2]),
        StochasticMap([x], [x + w], Noise((w,))),
        mean0=0.5, cov0=1.0,
    )  # fmt: skip
    found = assumed_density(system).run(np.arange(1500.0), np.full((1500, 1, 1), np.nan))
    assert np.isfinite(found.mean).all()
    assert (found.cov >= 0.0).all()
    assert (np.diff(found.mean.ravel()) <= 0.0).all()
    assert found.cov[-1] == 0.0


@pytest.mark.parametrize("cov", [np.ones((2, 2)), np.array([[0.1, 0.3], [0.3, 0.9]])])
def test_two_states_whose_difference_is_known(cov):
    """The larger of x and c x + d is one of them if the one is known from the other."""
    slope = np.sqrt(cov[1, 1] / cov[0, 0])
    plane = sympy.Float(slope) * x
    for mean in ([0.2, 0.2 * slope], [0.2, 0.2 * slope + 0.5], [0.2, 0.2 * slope - 0.5]):
        found = moved(sympy.Max(plane, y), mean, cov)
        assert found.mean[0] == pytest.approx(max(slope * mean[0], mean[1]), rel=1e-7)
        assert found.cov[0, 0] == pytest.approx(0.25 + cov[1, 1], rel=1e-7)
        assert_allclose(found.cross[:, 0], cov @ [0.0, 1.0], rtol=1e-7)


def test_one_of_two_states_is_known():
    """The other one is averaged as if it were alone."""
    for mean in ([0.0, 0.4], [0.3, -0.2]):
        found = moved(sympy.Abs(y - 1) * x + y, mean, np.diag([0.0, 0.8]))
        alone = moved(sympy.Abs(x - 1) * mean[0] + x, mean[1:], [[0.8]])
        assert_allclose(found.mean, alone.mean, rtol=1e-13)
        assert_allclose(found.cov, alone.cov, rtol=1e-13)
        assert found.cross[0, 0] == 0.0
