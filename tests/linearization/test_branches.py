"""Branches of switching maps: mass, state and value in a branch, by nodes and closed forms."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose
from scipy.special import ndtr

from oracles.gaussian import branch_moments, random_dist
from seedslib import zoo
from seedslib.linearization import (
    Cubature,
    ExactGaussian,
    GaussHermite,
    Taylor,
    Unscented,
    Weighted,
)
from seedslib.models import Noise, StochasticMap

t = sympy.Symbol("t")
x, y, v = sympy.symbols("x y v", real=True)
RULES = (Taylor(), ExactGaussian(), Unscented(), Cubature(), GaussHermite(7))
NOISE = Noise((v,), mean=0.3, cov=[[0.7]])
VALUES = [1 + 2 * x - y + v, y**2 / 3 + x * v - t]
AT = 1.7
WEIGHTS = {
    "constant": sympy.Rational(1, 4),
    "time": 0.2 + 0.1 * t,
    "bump of the state": 0.35 - 0.3 * sympy.exp(-(x**2) / 8) * sympy.cos(t),
    "side of a blurred line": (1 - sympy.erf(x / 2 - y + t / 3)) / 2,
    "linear": 0.5 + 0.05 * x - 0.02 * t * y,
    "bump of state and noise": sympy.exp(-((v - x / 2) ** 2) / 2),
    "side of a line with noise": (1 + sympy.erf(x - y / 2 + v / 3)) / 2,
}


def dists(n, count=3, seed=0, scale=0.5):
    rng = np.random.default_rng([seed, n])
    pairs = [random_dist(rng, n, scale) for _ in range(count)]
    return tuple(np.stack(part, axis=-1) for part in zip(*pairs, strict=True))


def flatten(found):
    assert isinstance(found, Weighted)
    return [found.mass, *found.state, *found.value]


def by_nodes(map, mean, cov, nodes=30, at=AT):
    return branch_moments(
        lambda p, noise: map.value(at, p, noise),
        lambda p, noise: map.weight(at, p, noise),
        mean,
        cov,
        map.noise.mean,
        map.noise.cov,
        nodes,
    )


def assert_branch(found, map, means, covs, rtol, at=AT, nodes=30):
    """Each distribution of a batch against the nodes."""
    for k in range(means.shape[-1]):
        for part, exact in zip(
            flatten(found), by_nodes(map, means[:, k], covs[..., k], nodes, at), strict=True
        ):
            one = np.broadcast_to(part.T, (means.shape[-1], *np.shape(exact)[::-1])).T[..., k]
            assert_allclose(one, exact, rtol=rtol, atol=rtol)


def as_functions(map):
    """The same branch without its formulas, so that nodes must cover its noise."""
    return StochasticMap.from_functions(
        map.state_size, map.size, map.value, map.noise, weight=map.weight
    )


@pytest.mark.parametrize("name", WEIGHTS)
def test_branch_of_every_kind_of_weight_against_nodes(name):
    branch = StochasticMap((x, y), VALUES, NOISE, weight=WEIGHTS[name])
    dist = dists(2)
    assert_branch(ExactGaussian().weighted(branch)(AT, *dist), branch, *dist, 1e-8)
    assert_branch(GaussHermite(30).weighted(branch)(AT, *dist), branch, *dist, 1e-8)
    hidden = as_functions(branch)
    assert_branch(GaussHermite(24).weighted(hidden)(AT, *dist), branch, *dist, 1e-7)


@pytest.mark.parametrize("name", ["scalar", "target", "dependent"])
def test_rows_of_switching_systems_against_nodes(name):
    """The masses of a row add up to one; readings come with an indicator."""
    system = {
        "scalar": lambda: zoo.scalar_switching("A2"),
        "target": zoo.manoeuvring_target,
        "dependent": zoo.dependent_switching,
    }[name]()
    dist = dists(system.state_size, 4)
    nodes = {"target": 8}.get(name, 60)
    for row in (system.branches[0], system.readings[1]):
        maps = [branch.map for branch in row]
        for rule in (ExactGaussian(), GaussHermite(nodes)):
            found = rule.row(maps)(0.0, *dist)
            for branch, map in zip(found, maps, strict=True):
                assert_branch(branch, map, *dist, 1e-7, at=0.0, nodes=nodes)
            assert_allclose(sum(branch.mass for branch in found), 1.0, rtol=1e-12)


@pytest.mark.parametrize("rule", RULES)
def test_row_is_its_branches_one_by_one(rule):
    """In any order; those of equal value share it, where the weight leaves the noise alone."""
    rows = [[branch.map for branch in zoo.scalar_switching("A2").branches[0]]]
    if not isinstance(rule, Taylor):
        rows.append([branch.map for branch in zoo.dependent_switching().readings[1]])
    dist = dists(1, 5)
    for maps in rows:
        for order in (maps, maps[::-1]):
            for found, map in zip(rule.row(order)(0.0, *dist), order, strict=True):
                alone = rule.weighted(map)(0.0, *dist)
                for part, exact in zip(flatten(found), flatten(alone), strict=True):
                    assert_allclose(*np.broadcast_arrays(part, exact), rtol=1e-13, atol=1e-14)
    if len(rows) == 2:
        one, two = rule.row(rows[1])(0.0, *dist)
        assert np.abs(one.value.mean - two.value.mean).min() > 0.01


@pytest.mark.parametrize("rule", RULES)
def test_constant_weight_leaves_the_plain_moments(rule):
    """Sigma points take the weights of means for squares as well: their covariance differs."""
    plain = StochasticMap((x, y), VALUES, NOISE)
    branch = StochasticMap((x, y), VALUES, NOISE, weight=sympy.Rational(1, 4))
    means, covs = dists(2)
    found, moments = rule.weighted(branch)(AT, means, covs), rule.moments(plain)(AT, means, covs)
    assert_allclose(found.mass, 0.25)
    assert_allclose(found.state.mean, means, rtol=1e-12)
    state_cov = np.broadcast_to(found.state.cov, covs.shape)
    assert_allclose(state_cov, covs, rtol=1e-10, atol=1e-13)
    assert_allclose(found.value.mean, moments.mean, rtol=1e-12)
    assert_allclose(found.value.cross, moments.cross, rtol=1e-10, atol=1e-12)
    if not isinstance(rule, Unscented):
        assert_allclose(found.value.cov, moments.cov, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("name", ["constant", "time", "bump of the state", "linear"])
def test_taylor_in_a_branch_is_the_exact_mean_of_the_expansions(name):
    """(7.3) of the switching paper, with the linear weight and value as a branch of their own."""
    branch = StochasticMap((x, y), VALUES, NOISE, weight=WEIGHTS[name])
    means, covs = dists(2, scale=0.3)
    found = Taylor().weighted(branch)(AT, means, covs)
    for k in range(3):
        here = {t: AT, x: means[0, k], y: means[1, k], v: 0.3}

        def expanded(f, symbols, here=here):
            f = sympy.sympify(f)
            parts = [(f.diff(s).subs(here)) * (s - here[s]) for s in symbols]
            return f.subs(here) + sum(parts)

        flat = StochasticMap(
            (x, y),
            [expanded(f, (x, y, v)) for f in VALUES],
            NOISE,
            weight=expanded(WEIGHTS[name], (x, y)),
        )
        exact = by_nodes(flat, means[:, k], covs[..., k], 6)
        for part, wanted in zip(flatten(found), exact, strict=True):
            one = np.broadcast_to(part.T, (3, *np.shape(wanted)[::-1])).T[..., k]
            assert_allclose(one, wanted, rtol=1e-9, atol=1e-10)


def test_guard_keeps_the_variance_of_weighted_taylor_positive():
    """m = 0.9, D = 2 gives the variance -1.51 by (7.3) as printed."""
    bump = 0.35 - 0.3 * sympy.exp(-(x**2) / 8)
    branch = StochasticMap((x,), [x + 1.8 * sympy.sin(x) + v / 2], Noise((v,)), weight=bump)
    m, d = 0.9, 2.0
    weight, slope = float(bump.subs(x, m)), float(bump.diff(x).subs(x, m))
    stretch = 1 + 1.8 * np.cos(m)
    assert stretch**2 * (d - (slope * d / weight) ** 2) + 0.25 == pytest.approx(-1.51, abs=0.005)
    found = Taylor().weighted(branch)(0, np.array([m]), np.array([[d]]))
    assert_allclose(found.value.cov, stretch**2 * d + 0.25, rtol=1e-12)
    assert_allclose(found.state.mean, m)


def test_branch_far_from_the_origin_keeps_its_digits():
    """What is linear in the value is known exactly, at positions of 1e6 as at zero."""
    for weight in (sympy.Rational(1, 2), (3 + sympy.erf(x)) / 4):
        near = StochasticMap((x,), [2 * x + v], Noise((v,)), weight=weight)
        moved = sympy.sympify(weight).subs(x, x - 10**6)
        far = StochasticMap((x,), [2 * x + v], Noise((v,)), weight=moved)
        cov = np.array([[[0.3]]])
        exact = ExactGaussian().weighted(near)(0, np.array([[0.5]]), cov)
        found = ExactGaussian().weighted(far)(0, np.array([[1e6 + 0.5]]), cov)
        assert_allclose(found.state.mean - 1e6, exact.state.mean, atol=1e-9)
        assert_allclose(found.state.cov, exact.state.cov, rtol=1e-9)
        assert_allclose(found.value.cov, 4 * found.state.cov + 1, rtol=1e-14)
        assert_allclose(found.value.cross, 2 * found.state.cov, rtol=1e-14)


@pytest.mark.parametrize("sign", [1, -1])
def test_branch_in_the_far_tail(sign):
    """A mass of 1e-40: moments of a normal distribution cut off by a blurred line."""
    weight = (1 - sympy.erf(sign * x / sympy.sqrt(2))) / 2
    branch = StochasticMap((x,), [x + v], Noise((v,)), weight=weight)
    found = ExactGaussian().weighted(branch)(0, np.array([[sign * 19.0]]), np.ones((1, 1, 1)))
    far = 19.0 / np.sqrt(2)
    ratio = np.exp(-(far**2) / 2) / np.sqrt(2 * np.pi) / ndtr(-far)
    assert_allclose(found.mass, ndtr(-far), rtol=1e-12)
    assert_allclose(found.state.mean, [[sign * (19 - ratio / np.sqrt(2))]], rtol=1e-12)
    assert_allclose(found.state.cov, [[[1 - ratio * (ratio - far) / 2]]], rtol=1e-9)


def test_branch_without_mass_has_no_moments_and_no_warning():
    weight, cov = (1 - sympy.erf(x)) / 2, np.array([[[0.1]]])
    for chance, place in ((weight, 60.0), (sympy.Integer(0), 0.3)):
        closed = StochasticMap((x,), [x + v], Noise((v,)), weight=chance)
        for rule in (ExactGaussian(), GaussHermite()):
            found = rule.weighted(closed)(0, np.array([[place]]), cov)
            assert (np.asarray(found.mass) < 1e-300).all()
    branch = ExactGaussian().weighted(StochasticMap((x,), [x + v], Noise((v,)), weight=weight))
    empty, full = (branch(0, np.array([[m]]), cov) for m in (60.0, -60.0))
    assert np.isnan(empty.value.mean).all()
    assert_allclose([full.mass[0], full.value.cov[0, 0, 0]], [1.0, 1.1])


def test_nodes_without_weight_are_left_out():
    """Far nodes, where the chance of the branch is zero in numbers, leave no NaN."""
    cliff = StochasticMap((x,), [x + v], Noise((v,)), weight=(1 + sympy.erf(40 * x + v)) / 2)
    found = GaussHermite(31).weighted(cliff)(0, np.zeros((1, 1)), np.ones((1, 1, 1)))
    assert all(np.isfinite(part).all() for part in flatten(found))
    assert found.mass[0] == pytest.approx(0.5, abs=1e-6)
