"""A prior so wide that the noise is rounded off beside it: what a designed filter claims then."""

import numpy as np
import pytest
import sympy

from seedslib.design import synthesize
from seedslib.designed import large_order
from seedslib.linearization import Cubature, Taylor
from seedslib.models import JumpDiffusion, Noise

x, v = sympy.symbols("x v")
TIMES = np.arange(3.0)
VARIANCES = 1e-8 / np.arange(1.0, 4.0)


def constant(prior, noise=1e-8):
    """A constant that is measured three times: 1 / P = 1 / P0 + k / R."""
    sensor = Noise((v,), cov=[[noise]])
    return JumpDiffusion((x,), [0], [[0]], [x + v], sensor, [0.0], [[prior]], step=0.5)


@pytest.mark.parametrize("rule", [Taylor(), Cubature()])
@pytest.mark.parametrize("prior", [1e-2, 1e8, 1e12, 1e20])
def test_it_hears_every_measurement_and_claims_what_is_left(prior, rule):
    filter = synthesize(constant(prior), large_order(1), rule, TIMES, nodes=0, paths=4000, seed=1)
    alone = filter.run(TIMES, [[5.0], [6.0], [7.0]], covariances=True)
    many = filter.run(TIMES, np.full((3, 1, 2), [[[5.0]], [[6.0]], [[7.0]]]), covariances=True)
    # the prior of 1e20 holds the noise in its last two digits only
    wanted = pytest.approx(VARIANCES, rel=0.05)
    assert alone.cov[:, 0, 0] == wanted
    assert many.cov[:, 0, 0].reshape(3, -1)[:, 0] == wanted
    assert filter.predicted.rms[:, 0] ** 2 == wanted
    np.testing.assert_allclose(alone.mean[:, 0], [5.0, 5.5, 6.0], atol=0.01)
    np.testing.assert_allclose(many.mean[:, 0, 1], alone.mean[:, 0], rtol=1e-9)


def test_exact_moments_say_that_their_digits_are_lost():
    with pytest.warns(UserWarning, match="cov0: the variance of x1 given the memory"):
        synthesize(constant(1e12), large_order(1), Taylor(), TIMES, nodes=0, exact_moments=True)


@pytest.mark.filterwarnings("error")
def test_what_is_known_exactly_is_no_wide_prior():
    exact = constant(1.0, 0.0)
    filter = synthesize(exact, large_order(1), Taylor(), TIMES, nodes=0, paths=1000, seed=1)
    assert (filter.run(TIMES, [[5.0], [5.0], [5.0]], covariances=True).cov == 0).all()
    synthesize(exact, large_order(1), Taylor(), TIMES, nodes=0, exact_moments=True)


def test_the_noise_beside_a_wide_prior_is_that_of_its_time():
    """Measured at the time 1 with a deviation of 2e-4, at 2 with one of 3e-4."""
    t = sympy.Symbol("t")
    system = JumpDiffusion(
        (x,), [0], [[0]], [x + (1 + t) * v], Noise((v,), cov=[[1e-8]]), [0.0], [[1e20]], step=0.5,
        time=t,
    )  # fmt: skip
    times = np.array([1.0, 2.0])
    filter = synthesize(system, large_order(1), Taylor(), times, nodes=0, paths=4000, seed=1)
    wanted = pytest.approx([4e-8, 1 / (1 / 4e-8 + 1 / 9e-8)], rel=0.05)
    alone = filter.run(times, [[5.0], [6.0]], covariances=True)
    many = filter.run(times, np.full((2, 1, 3), [[[5.0]], [[6.0]]]), covariances=True)
    assert alone.cov[:, 0, 0] == wanted
    assert many.cov[:, 0, 0].reshape(2, -1)[:, -1] == wanted
