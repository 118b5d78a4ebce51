"""A filter that the library does not have, in one class: all that takes means works with it.

The second-order extended filter takes two terms of the expansion about the mean: it is exact for
quadratic maps.
"""

import pickle
from dataclasses import dataclass

import numpy as np
import pytest
import sympy as sp

from seedslib import zoo
from seedslib.design import synthesize
from seedslib.designed import Memory, load, save
from seedslib.evaluation import compare
from seedslib.filters import CovarianceFilter, assumed_density, extended_kalman
from seedslib.linearization import ExactGaussian
from seedslib.linearization.formulas import Formulas
from seedslib.models import DiscreteSystem, Noise, StochasticMap

TIMES = np.arange(12.0)


@dataclass(frozen=True)
class SecondOrder(Formulas):
    """Means and covariances by the expansion to second order, without terms of a third moment."""

    def formulas(self, map, mean, cov, spread=True):
        conditional, noise_cov, _ = map.conditional_expressions
        here = dict(zip(map.state, mean, strict=True))
        curvature = [sp.hessian(part, map.state).subs(here) * cov for part in conditional]

        def average(part):
            return (part + (sp.hessian(part, map.state) * cov).trace() / 2).subs(here)

        y = sp.Matrix([average(part) for part in conditional])
        cross = cov * sp.Matrix(conditional).jacobian(map.state).subs(here).T
        if not spread:
            return y, cross, None
        square = sp.Matrix(noise_cov).applyfunc(average)
        square += sp.Matrix(conditional).jacobian(map.state).subs(here) * cross
        for i, j in np.ndindex(square.shape):
            square[i, j] += (curvature[i] * curvature[j]).trace() / 2
        return y, cross, square


@pytest.fixture(scope="module")
def quadratic():
    x, u, w, v = sp.symbols("x u w v", real=True)
    state = (x, u)
    move = StochasticMap(state, [0.9 * x + 0.1 * u**2 - 0.1, 0.8 * u + w], Noise((w,), cov=[[0.1]]))
    sensor = StochasticMap(state, [x + 0.2 * x * u + v], Noise((v,), cov=[[0.2]]))
    return DiscreteSystem(move, sensor, [0.2, -0.1], [[1.0, 0.2], [0.2, 0.5]])


def test_it_is_exact_where_the_map_is_quadratic(quadratic):
    y = quadratic.simulate(TIMES, 5, 3).measurements
    found, exact = (
        CovarianceFilter(quadratic, rule).run(TIMES, y) for rule in (SecondOrder(), ExactGaussian())
    )
    for one, two in zip(found[:2], exact[:2], strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-10, atol=1e-12)


def test_it_is_compared_with_the_others(quadratic):
    filters = {
        "first": extended_kalman(quadratic),
        "second": CovarianceFilter(quadratic, SecondOrder()),
        "exact": assumed_density(quadratic),
    }
    found = compare(filters, quadratic, TIMES, 4000, 5)
    gain = found.difference("first", "second")
    assert gain.average_square > 3 * gain.average_square_error
    assert found["second"].rms == pytest.approx(found["exact"].rms, rel=1e-9)


def test_it_integrates_in_continuous_time():
    system = zoo.van_der_pol()
    grid = np.arange(0.0, 1.01, 0.25)
    y = system.simulate(grid, 3, 1).measurements
    rules = SecondOrder(), ExactGaussian()
    first, second = (CovarianceFilter(system, rule).run(grid, y) for rule in rules)
    # the drift is cubic: of the exact mean only the term of the fourth moment is missing in P
    assert np.abs(first.mean - second.mean).max() < 0.1 * np.abs(second.mean).max()


def test_it_is_designed_for_written_and_read(quadratic, tmp_path):
    made = synthesize(quadratic, Memory(2), SecondOrder(), TIMES, paths=4000, seed=1)
    save(made, tmp_path / "second.npz")
    with pytest.raises(ValueError, match="'SecondOrder' is not the library's"):
        load(tmp_path / "second.npz", quadratic)
    again = load(tmp_path / "second.npz", quadratic, linearization=SecondOrder())
    y = quadratic.simulate(TIMES, 5, 3).measurements
    np.testing.assert_array_equal(again.run(TIMES, y).mean, made.run(TIMES, y).mean)


def test_it_travels(quadratic):
    made = CovarianceFilter(quadratic, SecondOrder())
    y = quadratic.simulate(TIMES, 5, 3).measurements
    again = pickle.loads(pickle.dumps(made))
    np.testing.assert_array_equal(again.run(TIMES, y).mean, made.run(TIMES, y).mean)
    assert "SecondOrder" in repr(made)


def test_its_cross_covariances_are_there_to_smooth_by(quadratic):
    """What a smoother takes of a step, cov(x_k, x_{k+1}) P_{k+1}⁻¹, against Monte Carlo."""
    rng, count = np.random.default_rng(2), 400_000
    mean, cov = quadratic.mean0, quadratic.cov0
    step = SecondOrder().moments(quadratic.dynamics)(0.0, mean, cov)
    x = mean[:, None] + np.linalg.cholesky(cov) @ rng.standard_normal((2, count))
    ahead = quadratic.dynamics.sample(0.0, x, rng)
    products = (x - mean[:, None])[:, None] * ahead[None]
    doubt = products.std(axis=2) / np.sqrt(count)
    assert (np.abs(products.mean(axis=2) - step.cross) < 5 * doubt + 1e-12).all()
