"""Exact Gaussian moments of maps: covariances to all digits, kinks, known states, wide
distributions."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose

from oracles.gaussian import branch_moments
from seedslib import zoo
from seedslib.filters import assumed_density
from seedslib.gaussian import NoClosedForm
from seedslib.linearization import ExactGaussian, GaussHermite
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, y, v, w = sympy.symbols("x y v w", real=True)
exp, sin, cos, Abs = sympy.exp, sympy.sin, sympy.cos, sympy.Abs
HALF = sympy.S.Half
MEAN = np.array([0.4, -0.7])
COV = np.array([[0.6, -0.25], [-0.25, 0.9]])


def moments(values, mean, cov, noise=None):
    state = (x, y)[: len(mean)]
    map = StochasticMap(state, values, noise or Noise())
    return ExactGaussian().moments(map)(0.0, np.array(mean), np.array(cov))


@pytest.mark.parametrize("name", ["van_der_pol", "kicked_duffing", "flip_process"])
def test_moments_and_rates_of_the_examples_against_nodes(name):
    system = getattr(zoo, name)()
    rng = np.random.default_rng(0)
    n = system.state_size
    root = rng.standard_normal((n, n, 4))
    dist = rng.standard_normal((n, 4)), 0.4 * np.einsum("ik...,jk...->ij...", root, root)
    for make, given in (("moments", system.sensor), ("flow", system)):
        found, exact = (
            getattr(rule, make)(given)(0.0, *dist) for rule in (ExactGaussian(), GaussHermite(10))
        )
        for part, wanted in zip(found, exact, strict=True):
            assert_allclose(*np.broadcast_arrays(part, wanted), rtol=1e-10, atol=1e-10)


def test_noise_inside_sines_and_exponentials_against_nodes():
    noise = Noise((v, w), mean=[0.7, -1.3], cov=[[0.5, 0.2], [0.2, 0.8]])
    values = [sin(x + v) * y, exp(-(x**2)) + w * v, exp(x / 2 + v)]
    numeric = [sympy.lambdify((x, y, v, w), part) for part in values]
    found = moments(values, MEAN, COV / 4, noise)
    exact = branch_moments(
        lambda p, q: [f(*p, *q) for f in numeric],
        lambda p, q: 1.0,
        MEAN,
        COV / 4,
        noise.mean,
        noise.cov,
        22,
    )[3:]
    for part, wanted in zip(found, exact, strict=True):
        assert_allclose(part, wanted, rtol=1e-9, atol=1e-10)
    small = moments([sin(x + v) * exp(v)], MEAN[:1], [[0.0]], Noise((v,), cov=[[1e-8]])).cov
    assert small[0, 0] == pytest.approx(1e-8 * (np.cos(0.4) + np.sin(0.4)) ** 2, rel=1e-7, abs=0)


@pytest.mark.parametrize("mean", [0.0, 2.0])
def test_sine_of_a_variance_beyond_all_exponents(mean):
    for value in (sin(x), cos(3 * x)):
        found = moments([value], [mean], [[1e200]])
        assert found.cov[0, 0] == pytest.approx(0.5, rel=1e-15)


def test_exponential_on_one_side_of_a_plane_has_no_formula():
    for value in (sympy.Piecewise((exp(x), x < 0), (1, True)), exp(x) * sympy.erfc(x)):
        with pytest.raises(NoClosedForm, match="GaussHermite"):
            moments([value], [0.0], [[1.0]])


# Known states

SWITCHED = (
    Abs(x),
    sympy.Min(x, 0) + 1,
    sympy.Min(x, 0) ** 3,
)
JUMPS = ((sympy.sign(x), -1, 1), (sympy.Piecewise((x + 1, x >= 0), (0, True)), 0, 1))


@pytest.mark.parametrize("value", SWITCHED, ids=str)
@pytest.mark.parametrize("place", [0.0, 1.0, -1.0, 60.0, 3.7])
def test_known_state_is_moved_as_it_is(value, place):
    """On the kink and beside it."""
    found = moments([value + v], [place], [[0.0]], Noise((v,), cov=[[0.25]]))
    exact = float(value.subs(x, sympy.Float(place)))
    assert found.mean[0] == pytest.approx(exact, rel=1e-14, abs=1e-150)
    assert found.cov[0, 0] == pytest.approx(0.25, rel=1e-14)
    assert found.cross[0, 0] == 0.0


@pytest.mark.parametrize(("value", "low", "high"), JUMPS, ids=str)
def test_state_known_to_be_on_a_jump_is_on_either_side(value, low, high):
    """The limit of a variance that vanishes: one half of the mass goes each way."""
    beside = float(value.subs(x, 0.5))
    for place, (below, above) in ((0.0, (low, high)), (0.5, (beside, beside))):
        for variance in (0.0, 1e-30):
            found = moments([value], [place], [[variance]])
            assert found.mean[0] == pytest.approx((below + above) / 2, abs=1e-14)
            assert found.cov[0, 0] == pytest.approx((above - below) ** 2 / 4, abs=1e-14)


@pytest.mark.parametrize("value", [*SWITCHED, *(jump[0] for jump in JUMPS)], ids=str)
def test_filter_goes_on_from_a_known_state(value):
    record = np.array([np.nan, 0.3, -0.2, 1.1, np.nan, 0.4])[:, None, None]
    for place in (0.0, 1.0):
        known, close = (
            assumed_density(
                DiscreteSystem(
                    StochasticMap([x], [value + v], Noise((v,), cov=[[0.25]])),
                    StochasticMap([x], [x + w], Noise((w,), cov=[[0.25]])),
                    mean0=place,
                    cov0=variance,
                )
            ).run(np.arange(6.0), record)
            for variance in (0.0, 1e-24)
        )
        for part in ("mean", "cov", "loglik"):
            found = getattr(known, part)
            assert np.isfinite(found).all()
            assert_allclose(found, getattr(close, part), rtol=1e-9, atol=1e-9)


def test_variance_that_dies_away_leaves_the_filter_alive():
    """A state that halves without noise: its variance passes every size down to zero."""
    system = DiscreteSystem(
        StochasticMap([x], [sympy.Max(x, 0) / 2]),
        StochasticMap([x], [x + w], Noise((w,))),
        mean0=0.5,
        cov0=1.0,
    )
    found = assumed_density(system).run(np.arange(1500.0), np.full((1500, 1, 1), np.nan))
    assert np.isfinite(found.mean).all()
    assert (found.cov >= 0.0).all()
    assert (np.diff(found.mean.ravel()) <= 0.0).all()
    assert found.cov[-1] == 0.0


@pytest.mark.parametrize("cov", [np.ones((2, 2)), np.array([[0.1, 0.3], [0.3, 0.9]])])
def test_two_states_whose_difference_is_known(cov):
    """The larger of x and c x + d is one of them if the one is known from the other."""
    slope = np.sqrt(cov[1, 1] / cov[0, 0])
    for mean in ([0.2, 0.2 * slope], [0.2, 0.2 * slope + 0.5], [0.2, 0.2 * slope - 0.5]):
        found = moments([sympy.Max(sympy.Float(slope) * x, y)], mean, cov)
        assert found.mean[0] == pytest.approx(max(slope * mean[0], mean[1]), rel=1e-7)
        assert found.cov[0, 0] == pytest.approx(cov[1, 1], rel=1e-7)
        assert_allclose(found.cross[:, 0], cov @ [0.0, 1.0], rtol=1e-7)


def test_one_of_two_states_is_known():
    """The other one is averaged as if it were alone."""
    for mean in ([0.0, 0.4], [0.3, -0.2]):
        found = moments([Abs(y - 1) * x + y], mean, np.diag([0.0, 0.8]))
        alone = moments([Abs(x - 1) * mean[0] + x], mean[1:], [[0.8]])
        assert_allclose(found.mean, alone.mean, rtol=1e-13)
        assert_allclose(found.cov, alone.cov, rtol=1e-13)
        assert found.cross[0, 0] == 0.0
