"""Fits of forecasts by their formulas, and classes of histories from one fit to the next."""

from itertools import combinations_with_replacement
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
import sympy

from seedslib.design import stationary, synthesize
from seedslib.designed import Memory
from seedslib.designed.patterns import (
    Chosen,
    PatternFit,
    chosen,
    distances,
    loose,
    pattern_ways,
    regrouped,
)
from seedslib.designed.predictors import (
    FLOOR,
    AffineFit,
    PolynomialFit,
    bounded_below,
    monomial_recipe,
    monomials,
    standardised,
)
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

rng = np.random.default_rng(5)


def law(n, scale=1.0):
    """A covariance without symmetry."""
    root = rng.normal(size=(n, n)) + 1.5 * np.eye(n)
    return scale * root @ root.T


def affine_fit(n=2, d=3):
    return AffineFit(rng.normal(size=(n, d)), rng.normal(size=n), law(n))


def polynomial_fit(mean_degree, cov_degree):
    """Of two components from two numbers."""
    sizes = [len(monomial_recipe(2, degree)) for degree in (mean_degree, cov_degree)]
    return PolynomialFit(
        np.array([0.3, -0.4]), np.array([0.8, 1.7]), rng.normal(size=(2, sizes[0])),
        rng.normal(size=2), law(2), rng.normal(size=(3, sizes[1])), rng.normal(size=3),
        mean_degree, cov_degree,
    )  # fmt: skip


# Fits


def test_an_affine_forecast_for_any_batch():
    fit, u = affine_fit(), rng.normal(size=(3, 4, 5))
    mean, cov = fit.forecast(u)
    assert cov is fit.cov
    for place in np.ndindex(4, 5):
        wanted = [sum(g * c for g, c in zip(row, u[:, *place], strict=True)) for row in fit.gain]
        np.testing.assert_allclose(mean[:, *place], wanted + fit.offset, rtol=1e-13)
    np.testing.assert_allclose(fit.mean(u[:, 0]), mean[:, 0], rtol=1e-13)
    np.testing.assert_allclose(fit.mean(u[:, 0, 2]), mean[:, 0, 2], rtol=1e-13)


def test_monomials_are_all_products():
    point = rng.normal(size=(3, 4))
    wanted = [
        np.prod(point[list(powers)], axis=0)
        for total in (1, 2, 3)
        for powers in combinations_with_replacement(range(3), total)
    ]
    np.testing.assert_allclose(monomials(point, 3), wanted, rtol=1e-14)
    assert monomials(point, 0).shape == (0, 4)
    found = standardised(np.array([[9.0, 0.5, -9.0]]), np.array([1.0]), np.array([2.0]))
    assert found.tolist() == [[3.5, -1.0, -3.5]]


@pytest.mark.parametrize("degrees", [(3, 2), (1, 2), (2, 0)])
def test_a_polynomial_forecast(degrees):
    fit, u = polynomial_fit(*degrees), rng.normal(size=(2, 3, 4))
    mean, cov = fit.forecast(u)
    np.testing.assert_array_equal(fit.mean(u), mean)
    assert fit.cov is fit.residual
    for place in np.ndindex(3, 4):
        point = np.clip((u[:, *place] - fit.centre) * fit.scale, -3.5, 3.5)
        powers = [
            np.array([point[list(p)].prod() for total in range(1, degree + 1)
                      for p in combinations_with_replacement(range(2), total)])
            for degree in degrees
        ]  # fmt: skip
        np.testing.assert_allclose(mean[:, *place], fit.gain @ powers[0] + fit.offset, rtol=1e-12)
        if not degrees[1]:
            continue
        a, b, c = fit.cov_gain @ powers[1] + fit.cov_offset
        raw = np.array([[a, b], [b, c]])
        # the eigenvalues relative to the mean covariance, cut from below
        root = np.linalg.cholesky(fit.residual)
        back = np.linalg.inv(root)
        values, axes = np.linalg.eigh(back @ raw @ back.T)
        wanted = root @ (axes * np.maximum(values, 0.05)) @ axes.T @ root.T
        np.testing.assert_allclose(cov[..., *place], wanted, rtol=1e-10, atol=1e-12)
    assert degrees[1] or cov is fit.residual


def test_covariances_bounded_on_the_range_of_a_singular_one():
    direction = np.array([0.6, -1.1, 0.4])
    mean_cov = np.outer(direction, direction)
    covs = np.stack([0.5 * mean_cov, 0.01 * mean_cov, -2.0 * mean_cov], axis=-1)
    found = bounded_below(covs, mean_cov)
    wanted = [share * mean_cov for share in (0.5, FLOOR, FLOOR)]
    np.testing.assert_allclose(np.moveaxis(found, -1, 0), wanted, atol=1e-13)


# Classes


@pytest.fixture(scope="module")
def pattern_fit():
    """Three classes, of the four patterns of two components, after two classes."""
    table = np.array([[2, 0, 1, 0], [2, 1, 1, 0]])
    fits = [affine_fit() for _ in range(3)]
    return PatternFit.of(table, np.stack([law(2), law(2)]), np.array([0.5, 0.3, 0.2]), fits)


def test_each_path_has_the_fit_of_its_class(pattern_fit):
    u, group = rng.normal(size=(3, 2, 4)), np.array([[0, 2, 1, 0], [1, 1, 2, 0]])
    found = chosen(pattern_fit, group)
    assert isinstance(found, Chosen)
    mean, cov = found.forecast(u)
    np.testing.assert_array_equal(found.mean(u), mean)
    for place in np.ndindex(2, 4):
        fit = pattern_fit.one(group[place])
        np.testing.assert_allclose(mean[:, *place], fit.mean(u[:, *place]), rtol=1e-13)
        np.testing.assert_array_equal(cov[..., *place], fit.cov)
        alone = chosen(pattern_fit, group[place])
        np.testing.assert_allclose(alone.mean(u[:, *place]), mean[:, *place], rtol=1e-13)
        one, spread = alone.forecast(u[:, *place])
        np.testing.assert_allclose(one, mean[:, *place], rtol=1e-13)
        np.testing.assert_array_equal(spread, fit.cov)
    fit = affine_fit()
    assert chosen(fit, group) is fit
    weighed = sum(p * c for p, c in zip(pattern_fit.prob, pattern_fit.covs, strict=True))
    np.testing.assert_allclose(pattern_fit.cov, weighed, rtol=1e-14)


def test_covariances_that_depend_on_the_memory_and_the_class():
    fits = [polynomial_fit(2, 1), polynomial_fit(2, 1)]
    both = PatternFit.of(np.zeros((1, 2), int), np.empty((0, 2, 2)), np.array([0.6, 0.4]), fits)
    u, group = rng.normal(size=(2, 3)), np.array([1, 0, 1])
    mean, cov = chosen(both, group).forecast(u)
    for k, c in enumerate(group):
        one = fits[c].forecast(u[:, k : k + 1])
        np.testing.assert_allclose(mean[:, k : k + 1], one[0], rtol=1e-13)
        np.testing.assert_allclose(cov[..., k : k + 1], one[1], rtol=1e-13)


def test_distances_are_ratios_of_variances():
    """Against generalised eigenvalues; and in any basis, with any units."""
    one, other = np.stack([law(3), law(3, 4.0)]), np.stack([law(3), law(3, 0.2), law(3)])
    found = distances(one, other)
    assert found.shape == (2, 3)
    for i, j in np.ndindex(2, 3):
        ratios = scipy.linalg.eigh(one[i], other[j], eigvals_only=True)
        assert found[i, j] == pytest.approx(np.abs(np.log(ratios)).max(), rel=1e-6)
    unit = np.diag([1e-4, 3.0, 1e5])
    np.testing.assert_allclose(distances(unit @ one @ unit, unit @ other @ unit), found, rtol=1e-6)
    # a component that is known under all of them does not count
    gap = np.zeros((2, 4, 4))
    gap[:, :3, :3] = one
    np.testing.assert_allclose(distances(gap, gap)[0, 1], distances(one, one)[0, 1], rtol=1e-6)


def test_steps_are_joined_by_the_nearest_covariances(pattern_fit):
    covs = pattern_fit.covs
    near = np.stack([covs[2] * 1.01, covs[0] * 0.99, covs[1] * 1.02])
    table = np.array([[0, 1], [1, 2], [2, 0]])
    fits = [affine_fit() for _ in range(3)]
    apart = PatternFit.of(table, near, np.array([0.2, 0.5, 0.3]), fits)
    follows = PatternFit.of(table[::-1], covs, np.array([0.2, 0.5, 0.3]), fits)
    fresh = PatternFit.of(table[1:2], np.empty((0, 2, 2)), np.array([0.2, 0.5, 0.3]), fits)
    found = pattern_ways((pattern_fit, apart), 0)
    assert len(found) == 2
    assert found[0].tolist() == pattern_fit.table[:1].tolist()
    assert found[1].tolist() == [[1, 2], [2, 0], [0, 1]]
    assert pattern_ways((pattern_fit, follows), 0)[1] is follows.table
    assert pattern_ways((pattern_fit, fresh), 0)[1].tolist() == [[1, 2]] * 3
    # in a cycle of two steps, of one, of none
    turned = pattern_ways((pattern_fit, follows), 2)
    assert len(turned) == 3
    nearest = np.argmin(distances(follows.covs, pattern_fit.before), axis=1)
    assert turned[2].tolist() == pattern_fit.table[nearest].tolist()
    once = pattern_ways((pattern_fit, follows), 1)[2]
    assert once.tolist() == follows.table[np.argmin(distances(follows.covs, covs), axis=1)].tolist()
    assert pattern_ways((), 0) is None
    assert pattern_ways((affine_fit(), affine_fit()), 0) is None


class State(SimpleNamespace):
    def _replace(self, **changes):
        return State(**{**vars(self), **changes})


def test_a_path_goes_to_the_class_of_its_pattern():
    """Of components 0 and 2, of which component 1, that is always there, tells nothing."""
    table = np.array([[3, 2, 1, 0], [0, 1, 2, 3]])
    other, last = table + 4, table + 8
    filter = SimpleNamespace(
        times=np.arange(3.0), cycle=0, ways=(table, other, last), served=lambda k: (0, 1, 2)[k],
        availability=np.array([0.6, 1.0, 0.3, 0.0]),
    )  # fmt: skip
    nan = np.nan
    y = np.array([[1.0, nan, 1.0, nan], [nan, 2.0, nan, 2.0], [nan, nan, 3.0, 4.0], [nan] * 4])
    numbers = [1, 0, 3, 2]
    assert loose(filter.availability).tolist() == [0, 2]
    groups = np.array([0, 1, 1, 0])
    found = regrouped(filter, State(index=0, group=groups), y)
    assert found.group.tolist() == table[groups, numbers].tolist()
    found = regrouped(filter, State(index=1, group=groups), y)
    assert found.group.tolist() == other[groups, numbers].tolist()
    state = State(index=2, group=groups)
    assert regrouped(filter, state, y) is state  # nothing follows
    # where the last two steps are a cycle, the first of them follows every second time
    filter.cycle, filter.served = 2, lambda k: k if k < 3 else 1 + (k - 3) % 2
    for index, way in ((1, other), (2, last), (3, other), (4, last)):
        found = regrouped(filter, State(index=index, group=groups), y)
        assert found.group.tolist() == way[groups, numbers].tolist(), index


def test_fits_of_classes_that_do_not_fit_are_refused(pattern_fit):
    pattern_fit.check("fit", 2, 3)
    table = pattern_fit.table
    for changes, kind, match in (
        ({"fits": 1}, TypeError, "fit: wanted fits of classes, got int"),
        ({"prob": np.ones(2) / 2}, ValueError, "fit: wanted 2 classes, got 3"),
        ({"table": table[:1]}, ValueError, "fit.table: wanted classes for 2, got shape"),
        ({"table": table[0]}, ValueError, "fit.table: wanted classes for 2, got shape"),
        ({"table": table + 0.5}, ValueError, "fit.table: wanted classes for 2, got shape"),
        ({"table": table + 1}, ValueError, "fit.table: wanted classes below 3"),
        ({"table": table - 1}, ValueError, "fit.table: wanted classes below 3"),
        ({"before": np.empty((2, 3, 3))}, ValueError, "fit.before"),
        ({"before": np.empty((0, 2, 2))}, ValueError, "fit.table: wanted classes for 1"),
    ):
        with pytest.raises(kind, match=match):
            pattern_fit._replace(**changes).check("fit", 2, 3)
    with pytest.raises(ValueError, match=r"fit\[0\]"):
        pattern_fit.check("fit", 2, 4)
    pattern_fit._replace(table=table[:, :0]).check("fit", 2, 3)


# A filter of them


@pytest.fixture(scope="module")
def made():
    p, q, a, b, r, s = sympy.symbols("p q a b r s", real=True)
    moved = [0.9 * p + 0.3 * q + 0.1 + a, -0.2 * p + 0.8 * q + b]
    system = DiscreteSystem(
        StochasticMap([p, q], moved, Noise((a, b), cov=np.diag([0.05, 0.4]))),
        StochasticMap([p, q], [p + r, q + 0.5 * p + s], Noise((r, s), cov=np.diag([0.5, 0.2]))),
        [0.2, -0.3], [[1.0, 0.2], [0.2, 0.7]],
    )  # fmt: skip
    return system, synthesize(
        system, Memory(1), Taylor(), np.arange(4.0), paths=400, seed=1, availability=[0.6, 1.0]
    )


@pytest.mark.parametrize("lasting", [False, True])
def test_a_run_is_its_classes_written_out(made, lasting):
    system, filter = made
    if lasting:
        filter = stationary(filter, tolerance=10.0)
        assert filter.cycle == 1
    times = np.arange(6.0 if lasting else 4.0)
    y = system.simulate(times, 12, 3, availability=[0.6, 1.0]).measurements
    found = filter.run(times, y, covariances=True)
    for path in range(12):
        group = 0
        for k in range(1, len(times)):
            row = min(k, 3) - 1
            number = int(~np.isnan(y[k - 1, 0, path]))
            group = filter.ways[-1 if k > 3 else row][group, number]
            fit = filter.fits[row].one(group)
            mean = fit.gain @ found.mean[k - 1, :, path] + fit.offset
            there = ~np.isnan(y[k, :, path])
            look = np.array([[1.0, 0.0], [0.5, 1.0]])[there]
            noise = np.diag([0.5, 0.2])[np.ix_(there, there)]
            gain = fit.cov @ look.T @ np.linalg.inv(look @ fit.cov @ look.T + noise)
            wanted = mean + gain @ (y[k, there, path] - look @ mean)
            np.testing.assert_allclose(found.mean[k, :, path], wanted, rtol=1e-9, atol=1e-12)
            left = fit.cov - gain @ look @ fit.cov
            np.testing.assert_allclose(found.cov[k, :, :, path], left, rtol=1e-9, atol=1e-12)
        alone = filter.run(times, y[..., path], covariances=True)
        np.testing.assert_allclose(alone.mean, found.mean[..., path], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(alone.cov, found.cov[..., path], rtol=1e-9, atol=1e-12)
