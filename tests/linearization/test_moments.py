"""Moments by every linearization, of one map that depends on the time and on all its noises."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose
from scipy.special import ndtr

from oracles.gaussian import branch_moments, random_dist
from seedslib import zoo
from seedslib.base import Input, Parameter
from seedslib.filters import CovarianceFilter
from seedslib.gaussian import NoClosedForm
from seedslib.linearization import (
    Cubature,
    ExactGaussian,
    GaussHermite,
    Linearization,
    Matrices,
    Moments,
    Taylor,
    Unscented,
)
from seedslib.models import DiscreteSystem, JumpDiffusion, LinearSystem, Noise, StochasticMap

t = sympy.Symbol("t")
x, y, v, w = sympy.symbols("x y v w", real=True)
NOISE = Noise((v, w), mean=[0.7, -1.3], cov=[[0.5, 0.2], [0.2, 0.8]])
VALUE = [x * y / 2 + t * x + v + 0.5 * w, y**2 / 3 + x * w - t, x - 0.2 * t * v * y]
MAP = StochasticMap((x, y), VALUE, NOISE)
AT = 1.7
VALUE_AT = [sympy.lambdify((x, y, v, w), part.subs(t, AT)) for part in VALUE]
RULES = (Taylor(), ExactGaussian(), Unscented(), Unscented(0.5, 2, 1), Cubature(), GaussHermite(4))


def hidden(map):
    """The same map as an array function: points are laid in the joint space of x and the noise."""
    return StochasticMap.from_functions(map.state_size, map.size, map.value, map.noise)


def dists(n, count=4, seed=0, scale=0.7):
    rng = np.random.default_rng(seed)
    pairs = [random_dist(rng, n, scale) for _ in range(count)]
    return tuple(np.stack(part, axis=-1) for part in zip(*pairs, strict=True))


def value(points, noise):
    return [part(*points, *noise) for part in VALUE_AT]


def by_nodes(mean, cov):
    """Exact: of degree two in all variables."""
    dist = NOISE.mean, NOISE.cov
    return branch_moments(value, lambda points, noise: 1.0, mean, cov, *dist, 4)[3:]


def by_slopes(mean, cov):
    """First order: central differences at the means, which are exact here."""
    place = np.concatenate([mean, NOISE.mean])
    slope = np.array(
        [
            np.subtract(value(*np.split(place + e, [2])), value(*np.split(place - e, [2]))) / 2
            for e in np.eye(4)
        ]
    ).T
    c, g = slope[:, :2], slope[:, 2:]
    return value(mean, NOISE.mean), cov @ c.T, c @ cov @ c.T + g @ NOISE.cov @ g.T


def by_sigma_points(reach, first, centre, mean, cov, given):
    """Points along the columns of a root, in the space of x or in the joint one."""
    size = 2 if given else 4
    root = np.linalg.cholesky(cov)
    if not given:
        zero = np.zeros((2, 2))
        root = np.block([[root, zero], [zero, np.linalg.cholesky(NOISE.cov)]])
    place = mean if given else np.concatenate([mean, NOISE.mean])
    points = place[:, None] + np.hstack([np.zeros((size, 1)), reach * root, -reach * root])
    weights = np.full(2 * size + 1, (1 - first) / (2 * size))
    weights[0] = first
    squares = weights.copy()
    squares[0] += centre
    if given:
        values, inner = given_the_state(points)
    else:
        values, inner = np.array(value(points[:2], points[2:])), np.zeros((3, 3, 2 * size + 1))
    h = values @ weights
    dx, dy = points[:2] - mean[:, None], values - h[:, None]
    return h, (dx * squares) @ dy.T, (dy * squares) @ dy.T + inner @ weights


def given_the_state(points):
    """Mean and covariance of the value given the state, which is affine in the noise."""
    flat = [np.array(value(points, NOISE.mean + e)) for e in (np.zeros(2), *np.eye(2))]
    g = np.stack([flat[1] - flat[0], flat[2] - flat[0]], axis=1)
    return flat[0], np.einsum("ias,ab,jbs->ijs", g, NOISE.cov, g)


def expected(rule, mean, cov, given=True):
    if isinstance(rule, Taylor):
        return by_slopes(mean, cov)
    if isinstance(rule, Unscented | Cubature):
        size = 2 if given else 4
        if isinstance(rule, Cubature):
            return by_sigma_points(np.sqrt(size), 0.0, 0.0, mean, cov, given)
        kappa = 3 - size if rule.kappa is None else rule.kappa
        reach = rule.alpha**2 * (size + kappa)
        extra = 1 - rule.alpha**2 + rule.beta
        return by_sigma_points(np.sqrt(reach), 1 - size / reach, extra, mean, cov, given)
    return by_nodes(mean, cov)


CASES = [(rule, True) for rule in RULES] + [(rule, False) for rule in RULES[2:]]


@pytest.mark.parametrize(("rule", "given"), CASES)
def test_moments_of_a_map_that_has_it_all(rule, given):
    """For single distributions, batches, and many means of one covariance."""
    map = MAP if given else hidden(MAP)
    means, covs = dists(2)
    found = rule.moments(map)(AT, means, covs)
    shared = rule.moments(map)(AT, means, covs[..., 0])
    folded = rule.moments(map)(AT, means.reshape(2, 2, 2), covs.reshape(2, 2, 2, 2))
    without = rule.moments(map, spread=False)(AT, means, covs)
    assert without.cov is None
    for k in range(4):
        exact = expected(rule, means[:, k], covs[..., k], given)
        alone = rule.moments(map)(AT, means[:, k], covs[..., k])
        common = expected(rule, means[:, k], covs[..., 0], given)
        for slot, (part, one) in enumerate(zip(found, alone, strict=True)):
            whole = np.broadcast_to(part, (*one.shape, 4))
            assert_allclose(one, exact[slot], rtol=1e-11, atol=1e-12)
            assert_allclose(whole[..., k], exact[slot], rtol=1e-11, atol=1e-12)
            whole = np.broadcast_to(folded[slot], (*one.shape, 2, 2))
            assert_allclose(whole[..., k // 2, k % 2], exact[slot], rtol=1e-11, atol=1e-12)
            of_shared = np.broadcast_to(shared[slot].T, (4, *one.shape[::-1])).T
            assert_allclose(of_shared[..., k], common[slot], rtol=1e-11, atol=1e-12)
        assert_allclose(without.mean[:, k], exact[0], rtol=1e-11)
        assert_allclose(without.cross[..., k], exact[1], rtol=1e-11, atol=1e-12)


DRIFT = [y + t * x - x * y, -x + 0.5 * y**2 - t]
DIFFUSION = [[0.3 + 0.1 * t, 0.2 * x], [0, 0.5 * y]]
JUMP, INTENSITY = [w * y, 0.3 * w - x / 2], 0.4 + 0.1 * t


@pytest.mark.parametrize("rule", RULES)
def test_rates_of_a_jump_diffusion(rule):
    """dm = E b, dP = cov(b, x) + cov(x, b) + E Sigma, with b and Sigma by hand."""
    system = JumpDiffusion(
        (x, y),
        DRIFT,
        DIFFUSION,
        [x + v],
        Noise((v,)),
        [0, 0],
        np.eye(2),
        intensity=INTENSITY,
        jump=JUMP,
        marks=Noise((w,), mean=0.6, cov=[[0.5]]),
    )
    mean_jump = [part.subs(w, 0.6) for part in JUMP]
    slope = [part.diff(w) for part in JUMP]
    b = [a + INTENSITY * s for a, s in zip(DRIFT, mean_jump, strict=True)]
    B = sympy.Matrix(DIFFUSION)
    sigma = B * B.T + INTENSITY * (
        sympy.Matrix(2, 2, lambda i, j: mean_jump[i] * mean_jump[j] + 0.5 * slope[i] * slope[j])
    )
    whole = [*b, sigma[0, 0], sigma[1, 0], sigma[1, 1]]
    numbers = [sympy.lambdify((x, y), sympy.sympify(part).subs(t, AT)) for part in whole]

    def rates(mean, cov):
        if isinstance(rule, Taylor):
            slope = sympy.Matrix(b).jacobian((x, y)).subs({t: AT, x: mean[0], y: mean[1]})
            h = np.array([f(*mean) for f in numbers])
            cross = cov @ np.array(slope.tolist(), dtype=float).T
        else:  # all of the others are exact for quadratic functions
            unused = np.zeros(0), np.zeros((0, 0))
            found = branch_moments(
                lambda p, _: [f(*p) for f in numbers], lambda p, _: 1.0, mean, cov, *unused, 5
            )
            h, cross = found[3], found[4][:, :2]
        spread = np.array([[h[2], h[3]], [h[3], h[4]]])
        change = cross + cross.T + spread
        return h[:2], cross, spread, [*h[:2], change[0, 0], change[1, 0], change[1, 1]]

    means, covs = dists(2)
    components = [*means, covs[0, 0], covs[1, 0], covs[1, 1]]
    found = [np.broadcast_to(part, 4) for part in rule.rate(system)(AT, components)]
    flow = rule.flow(system)(AT, means, covs)
    for k in range(4):
        velocity, cross, spread, exact = rates(means[:, k], covs[..., k])
        assert_allclose([part[k] for part in found], exact, rtol=1e-10, atol=1e-12)
        assert_allclose(flow.mean[:, k], velocity, rtol=1e-10)
        lean = np.broadcast_to(flow.cross, (2, 2, 4))[..., k]
        assert_allclose(lean, cross, rtol=1e-10, atol=1e-12)
        assert_allclose(flow.cov[..., k], spread, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("rule", RULES)
def test_moments_of_a_dist_of_lower_rank(rule):
    """A known component, two that move together, and a map without noise."""
    for cov in (np.diag([0.0, 0.3]), np.array([[1.0, 2.0], [2.0, 4.0]]), np.zeros((2, 2))):
        mean = np.array([1.0, -0.5])
        found = rule.moments(MAP)(AT, mean, cov)
        near = rule.moments(MAP)(AT, mean, cov + 1e-9 * np.eye(2))
        for part, close in zip(found, near, strict=True):
            assert_allclose(part, close, atol=2e-4 if cov.any() else 1e-6)
        assert_allclose(found.cross, cov @ np.linalg.pinv(cov) @ found.cross, atol=1e-12)
    still = rule.moments(StochasticMap((x, y), [2 * x - t * y]))(AT, np.ones(2), np.eye(2))
    assert_allclose(still.mean, [2 - AT], rtol=1e-14)
    assert_allclose(still.cov, [[4 + AT**2]], rtol=1e-12)


def test_parameters_are_taken_at_the_moment():
    a = Parameter("a", 2.0)
    map = StochasticMap((x,), [a * x**2 + v], Noise((v,)))
    m, p = 0.3, 0.7
    for rule in (ExactGaussian(), Unscented(), GaussHermite(4)):
        moments = rule.moments(map)
        for number in (2.0, -0.5):
            found = moments(0.0, np.array([m]), np.array([[p]]), (number,))
            assert_allclose(found.mean, [number * (m**2 + p)], rtol=1e-12)
            exact = 1 + number**2 * (4 * m**2 * p + 2 * p**2)
            assert_allclose(found.cov, [[exact]], rtol=1e-12)


def test_maps_that_differ_in_one_thing_have_moments_of_their_own():
    """In a coefficient, the noise, the weight, or the order of the state; made again they agree."""
    mean, cov = np.array([0.4, -1.0]), np.array([[0.3, 0.1], [0.1, 0.5]])
    for state, a, extra, shift, spread in [
        ((x, y), 2.0, 0, 0.5, 0.7),
        ((x, y), 3.0, 0, 0.5, 0.7),
        ((x, y), 2.0, 1, 0.5, 0.7),
        ((x, y), 2.0, 0, -0.5, 0.7),
        ((x, y), 2.0, 0, 0.5, 0.2),
        ((y, x), 2.0, 0, 0.5, 0.7),
    ] * 2:
        map = StochasticMap(state, [a * x**2 + extra + v], Noise((v,), mean=shift, cov=[[spread]]))
        found = ExactGaussian().moments(map)(0.0, mean, cov)
        k = state.index(x)
        m, p = mean[k], cov[k, k]
        assert_allclose(found.mean, [a * (m**2 + p) + shift + extra], rtol=1e-13)
        assert_allclose(found.cov, [[a**2 * (4 * m**2 * p + 2 * p**2) + spread]], rtol=1e-13)


class Scaled(Taylor):
    """A subclass that says nothing of being frozen."""

    factor = 1.0

    def formulas(self, map, mean, cov, spread=True):
        y, cross, rest = super().formulas(map, mean, cov, spread)
        return self.factor * y, cross, rest


def test_a_rule_that_can_change_derives_whenever_it_is_asked():
    rule = Scaled()
    for factor in (1.0, 2.0):
        object.__setattr__(rule, "factor", factor)
        found = rule.moments(MAP)(AT, np.zeros(2), np.eye(2)).mean
        assert_allclose(found, factor * np.array(value([0.0, 0.0], NOISE.mean)), rtol=1e-13)


def test_moments_of_matrices():
    """Functions of time and driven by an input; a sensor with more rows than the state."""
    u = Input("u")

    def matrices(t):
        G = np.array([[0.5, -0.2 * t], [0.1, 0.8]])
        H = np.array([[0.9, 0.3 * t], [0.2, 0.7], [-0.4, 0.5 * t**2]])
        R = np.array([[0.4, 0.1, 0], [0.1, 0.3 * t, 0], [0, 0, 2]])
        B, D = np.array([[0.5], [t]]), np.array([[t], [0.3], [-0.7]])
        return [(G, t * np.array([[1.0, 0.3], [0.3, 0.5]]), B), (H, R, D)]

    (G, Q), (H, R) = ([lambda t, i=i, j=j: matrices(t)[i][j] for j in range(2)] for i in range(2))
    b, d = (push @ [u] for _, _, push in matrices(sympy.Symbol("t")))
    system = LinearSystem(G, Q, H, R, [0, 0], np.eye(2), b=b, d=d)
    means, covs = dists(2)
    for map, (slope, noise, push) in zip(
        (system.dynamics, system.sensor), matrices(AT), strict=True
    ):
        for mean, cov in ((means, covs), (means, covs[..., 2]), (means[:, 1], covs[..., 2])):
            found = Matrices().moments(map)(AT, mean, cov, (-0.6,))
            without = Matrices().moments(map, spread=False)(AT, mean, cov, (-0.6,))
            shift = -0.6 * push.reshape(-1, *(1,) * (mean.ndim - 1))
            assert_allclose(found.mean, slope @ mean + shift, rtol=1e-13)
            assert_allclose(found.cross, np.einsum("ij...,kj->ik...", cov, slope), atol=1e-14)
            square = np.einsum("ij,jk...,lk->il...", slope, cov, slope)
            noises = noise.reshape(*noise.shape, *(1,) * (square.ndim - 2))
            assert_allclose(found.cov, square + noises, rtol=1e-13)
            assert without.cov is None
            assert_allclose(without.mean, found.mean, rtol=1e-15)


class Lattice(Linearization):
    """A new linearization: a dense lattice over the state and the noise, `moments` alone."""

    def moments(self, map, spread=True):
        grid = np.linspace(-6, 6, 41)
        size = map.state_size + map.noise.size
        nodes = np.array(np.meshgrid(*[grid] * size)).reshape(size, -1)
        weights = np.exp(-0.5 * (nodes**2).sum(axis=0))
        weights /= weights.sum()

        def f(t, mean, cov, p):
            batch = np.shape(mean)[1:]
            root = np.linalg.cholesky(np.moveaxis(cov, (0, 1), (-2, -1)))
            root = np.moveaxis(root, (-2, -1), (0, 1))
            root = root.reshape(*root.shape, *(1,) * (len(batch) + 2 - root.ndim))
            states = mean[:, None] + np.einsum("ij...,js->is...", root, nodes[: len(mean)])
            noise = map.noise.mean[:, None] + map.noise.root @ nodes[len(mean) :]
            noise = noise.reshape(-1, len(weights), *(1,) * len(batch))
            values = map.value(t, states, np.broadcast_to(noise, noise.shape[:2] + batch), p)
            h = np.einsum("is...,s->i...", values, weights)
            centre, apart = values - h[:, None], states - mean[:, None]
            rule = "is...,js...,s->ij..."
            square = np.einsum(rule, centre, centre, weights) if spread else None
            return Moments(h, np.einsum(rule, apart, centre, weights), square)

        return f


def test_a_new_linearization_works_in_filters():
    """The sensor of the process has two noises, so that the lattice has three axes."""
    lattice, exact = Lattice(), ExactGaussian()
    process = zoo.flip_process()
    times = 0.25 * np.arange(4)
    record = process.simulate(times, 4, 2).measurements
    found, same = (
        CovarianceFilter(process, rule, step=0.05).run(times, record) for rule in (lattice, exact)
    )
    assert_allclose(found.mean, same.mean, atol=1e-5)
    assert_allclose(found.cov, same.cov, atol=1e-5)
    steps = DiscreteSystem(
        StochasticMap((x,), [x + sympy.sin(x) + v / 2], Noise((v,))),
        StochasticMap((x,), [x + x**2 / 5 + w], Noise((w,))),
        [0.5],
        [[1.0]],
    )
    record = steps.simulate(np.arange(5.0), 6, 1).measurements
    found, same = (
        CovarianceFilter(steps, rule).run(np.arange(5.0), record) for rule in (lattice, exact)
    )
    assert_allclose(found.mean, same.mean, atol=1e-5)
    with pytest.raises(NotImplementedError, match="Lattice"):
        lattice.weighted(steps.dynamics)


def test_means_need_no_squares_of_drift_and_spread():
    """dX = erf dt + sqrt(2 + erf) dB: the means have closed forms, those of squares have none."""
    step = sympy.erf(x / sympy.sqrt(2))
    system = JumpDiffusion(
        (x,), [step], [[sympy.sqrt(2 + step)]], [x + w], Noise((w,)), [0.0], [[1.0]]
    )
    for map in (system.drift_map, system.spread_map):
        with pytest.raises(NoClosedForm):
            ExactGaussian().moments(map)
    m, p = np.array([0.3, -1.1]), np.array([0.7, 0.2])
    far = m / np.sqrt(1 + p)
    mean, density = 2 * ndtr(far) - 1, np.exp(-(far**2) / 2) / np.sqrt(2 * np.pi * (1 + p))
    found = ExactGaussian().rate(system)(0.0, [m, p])
    assert_allclose(found, [mean, 4 * p * density + 2 + mean], rtol=1e-12)
