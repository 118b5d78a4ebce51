"""Random vectors: what is drawn, averaged and compared."""

import numpy as np
import pytest
import sympy

from seedslib.gaussian import NoClosedForm
from seedslib.models import Noise

x, v, w = sympy.symbols("x v w")
MEAN, COV = np.array([0.2, -0.1]), np.array([[1.2, 0.3], [0.3, 0.5]])


def uniform(rng, count):
    return rng.uniform(-1, 1, (1, count))


def test_draws_have_the_stated_moments():
    draws = Noise((v, w), mean=[1.0, -2.0], cov=COV).draw(np.random.default_rng(1), 100_000)
    error = 4 / np.sqrt(100_000)
    np.testing.assert_allclose(draws.mean(axis=1), [1, -2], atol=error)
    np.testing.assert_allclose(np.cov(draws), COV, atol=2 * error)
    scalar_mean = Noise(2, mean=3.0).draw(np.random.default_rng(1), 10_000)
    np.testing.assert_allclose(scalar_mean.mean(axis=1), 3.0, atol=0.04)


def test_draws_of_a_singular_dist_stay_on_its_line():
    draws = Noise((v, w), cov=[[1, 2], [2, 4]]).draw(np.random.default_rng(0), 50)
    np.testing.assert_allclose(draws[1], 2 * draws[0], rtol=1e-14)
    still = Noise((v,), mean=[0.7], cov=[[0.0]]).draw(np.random.default_rng(0), 3)
    np.testing.assert_array_equal(still, [[0.7] * 3])


def test_first_draws_of_many_are_the_draws_of_few():
    few, many = (Noise(2, cov=COV).draw(np.random.default_rng(4), n) for n in (3, 100))
    np.testing.assert_array_equal(few, many[:, :3])


def test_noise_with_a_sampler_knows_its_first_two_moments_only():
    noise = Noise((v,), cov=[[1 / 3]], sample=uniform)
    assert not noise.gaussian
    draws = noise.draw(np.random.default_rng(0), 10_000)
    assert 0.99 < np.abs(draws).max() <= 1
    assert float(noise.expectation(x * v**2 + v).subs(x, 3)) == pytest.approx(1)
    with pytest.raises(NoClosedForm):
        noise.expectation(v**4)
    bad = Noise((v,), sample=lambda rng, count: np.zeros(count))
    with pytest.raises(ValueError, match=r"noise.sample"):
        bad.draw(np.random.default_rng(0), 5)


def test_noises_are_equal_where_names_and_dists_are():
    noise = Noise((v, w), cov=COV)
    same = Noise([v, w], [0.0, -0.0], COV.tolist())
    assert noise == same
    assert hash(noise) == hash(same)
    others = (
        Noise((w, v), cov=COV),
        Noise((v, w)),
        Noise((v, w), [0.0, 1.0], COV),
        Noise(2, cov=COV),
        Noise((v,)),
        Noise((v, w), cov=COV, sample=uniform),
        Noise((v, w), cov=COV, sample=uniform, log_density=abs),
        "noise",
    )
    assert not any(noise == other for other in others)
    assert len({noise, *others}) == 9
