"""Branches whose weight depends on the noise, and rows of branches."""

import numpy as np
import pytest
import sympy
from scipy.special import ndtr

from seedslib import zoo
from seedslib.gaussian import NoClosedForm
from seedslib.linearization import (
    Cubature,
    ExactGaussian,
    GaussHermite,
    Linearization,
    Taylor,
    Unscented,
    Weighted,
)
from seedslib.linearization.points import _conditional
from seedslib.models import Noise, StochasticMap

x, y, v, w = sympy.symbols("x y v w", real=True)
RULES = (Taylor(), ExactGaussian(), Unscented(), Cubature(), GaussHermite(7))

# The constants of the dependent-noise model, typed here once more
ALPHA, BETA, RHO = (1.2, -0.3), (-0.8, 0.5), (0.6, -0.4)
A0, A1, S = (0.2, -0.5), (0.9, 0.5), (0.6, 0.8)
TAU, DELTA, RHO_W = (1.0, -0.2), (-0.7, 0.4), (0.5, -0.3)
B0, B1, B2, R = (0.0, 1.0), (1.0, 0.7), (0.1, -0.05), (0.7, 0.5)


def flatten(result):
    assert isinstance(result, Weighted)
    return [result.mass, *result.state, *result.value]


def assert_close(got, want, **tolerance):
    for a, b in zip(flatten(got), flatten(want), strict=True):
        a, b = np.broadcast_arrays(a, b)
        np.testing.assert_allclose(a, b, **tolerance)


def laws(n=1, count=6, seed=0):
    rng = np.random.default_rng([seed, n])
    root = rng.standard_normal((n, n, count))
    return rng.standard_normal((n, count)), 0.4 * np.einsum("ik...,jk...->ij...", root, root)


def as_functions(map):
    """The same branch without its formulas, so that nodes must cover its noise."""
    return StochasticMap.from_functions(
        map.state_size, map.size, map.value, map.noise, weight=map.weight
    )


# Dependent noises: the closed forms of the review, built by hand


def normal_powers(m, d, count):
    """E X^n, n < count, for X ~ N(m, d)."""
    powers = [np.ones_like(m), m]
    while len(powers) < count:
        powers.append(m * powers[-1] + (len(powers) - 1) * d * powers[-2])
    return powers


def threshold_powers(m, d, tau, delta, count):
    """e_n = E X^n Phi(-t) and p_n = E X^n phi(t), t = tau + delta X, n < count."""
    q = 1 + delta**2 * d
    far = (tau + delta * m) / np.sqrt(q)
    density = np.exp(-(far**2) / 2) / np.sqrt(2 * np.pi * q)
    p = [density * part for part in normal_powers((m - delta * tau * d) / q, d / q, count)]
    e = [ndtr(-far)]
    for n in range(count - 1):
        below = n * e[n - 1] if n else 0.0
        e.append(m * e[n] + d * (below - delta * p[n]))
    return e, p


def reading_by_hand(i, j, offset, m, d):
    """Raw moments (1, x, x², y, xy, y²) with the indicator, from nu and H of the review."""
    tau, delta, rho, r = TAU[i], DELTA[i], RHO_W[i], R[i]
    e, p = threshold_powers(m, d, tau, delta, 6)
    whole = normal_powers(m, d, 6)
    b = np.array([B0[i] + offset, B1[i], B2[i]])
    square = np.convolve(b, b)

    def against(coefficients, powers, shift=0):
        return sum(c * powers[k + shift] for k, c in enumerate(coefficients))

    high = [
        e[0], e[1], e[2],
        against(b, e) + r * rho * p[0],
        against(b, e, 1) + r * rho * p[1],
        against(square, e) + 2 * r * rho * against(b, p)
        + r**2 * (e[0] + rho**2 * (tau * p[0] + delta * p[1])),
    ]  # fmt: skip
    if j == 1:
        return high
    both = [
        whole[0], whole[1], whole[2],
        against(b, whole), against(b, whole, 1), against(square, whole) + r**2,
    ]  # fmt: skip
    return [a - b for a, b in zip(both, high, strict=True)]


def move_by_hand(i, l, m, d):
    """Raw moments (1, x, x², y, xy, y²) with the switch: 400 nodes of the next state."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(200)
    weights = weights[:, None] / np.sqrt(2 * np.pi)
    spread = A1[i] ** 2 * d + S[i] ** 2
    after = A0[i] + A1[i] * m + np.sqrt(spread) * nodes[:, None]
    # R = V' - beta X - alpha and X are normal given the next state
    lean = (RHO[i] * S[i] - BETA[i] * A1[i] * d) / spread
    middle = -ALPHA[i] - BETA[i] * m + lean * (after - A0[i] - A1[i] * m)
    rest = 1 + BETA[i] ** 2 * d - lean**2 * spread
    chance = ndtr((middle if l else -middle) / np.sqrt(rest))
    slope = A1[i] * d / spread
    x_mean, x_var = m + slope * (after - A0[i] - A1[i] * m), d - slope**2 * spread
    # cov(X, R | next state) tilts X once more: E X 1{R > 0} = P(R > 0) E X + cov phi
    tilt = (-BETA[i] * d - slope * lean * spread) * (1 if l else -1)
    ratio = middle / np.sqrt(rest)
    density = np.exp(-(ratio**2) / 2) / np.sqrt(2 * np.pi * rest)
    first = x_mean * chance + tilt * density
    signed = middle if l else -middle
    second = (x_mean**2 + x_var) * chance
    second = second + density * (2 * x_mean * tilt - tilt**2 * signed / rest)
    parts = (chance, first, second, after * chance, after * first, after**2 * chance)
    return [(weights * part).sum(axis=0) for part in parts]


def assert_raw_moments(got, want):
    mass, first, second, value, cross, square = want
    assert_close(
        got,
        Weighted(
            mass,
            (np.array([first / mass]), np.array([[second / mass - (first / mass) ** 2]])),
            (
                np.array([value / mass]),
                np.array([[cross / mass - first * value / mass**2]]),
                np.array([[square / mass - (value / mass) ** 2]]),
            ),
        ),
        rtol=1e-12,
        atol=1e-12,
    )


SWC = zoo.dependent_switching()


@pytest.mark.parametrize("i", [0, 1])
def test_dependent_readings(i):
    """(6.21) to (6.23) for every value of the indicator against the recursions of e_n and p_n."""
    (m,), cov = laws(count=8)
    rows = ExactGaussian().row([branch.map for branch in SWC.readings[i]])(0, m[None], cov)
    for j, got in enumerate(rows):
        assert_raw_moments(got, reading_by_hand(i, j, 0.0, m, cov[0, 0]))


@pytest.mark.parametrize("i", [0, 1])
def test_dependent_moves(i):
    """(6.27), (6.36) without an indicator; given the next state the switch is normal."""
    (m,), cov = laws(count=8, seed=1)
    rows = ExactGaussian().row([branch.map for branch in SWC.branches[i]])(0, m[None], cov)
    for l, got in enumerate(rows):
        assert_raw_moments(got, move_by_hand(i, l, m, cov[0, 0]))


def test_offset_of_the_sensor_costs_no_digits():
    """A constant enters the mean alone: covariances are those without it to the last digits."""
    law = laws(count=8)
    near = ExactGaussian().weighted(SWC.readings[0][1].map)(0, *law)
    far = ExactGaussian().weighted(zoo.dependent_switching(1e6).readings[0][1].map)(0, *law)
    np.testing.assert_allclose(far.value.mean - 1e6, near.value.mean, atol=1e-9)
    for got, want in zip(flatten(far), flatten(near), strict=True):
        if got is not far.value.mean:
            np.testing.assert_allclose(got, want, rtol=1e-13, atol=1e-15)


def test_points_cover_only_the_state_where_the_noise_has_a_closed_form():
    branch = SWC.readings[1][0].map
    law = laws(count=4)
    assert _conditional(branch) is not None
    want = ExactGaussian().weighted(branch)(0, *law)
    assert_close(GaussHermite(40).weighted(branch)(0, *law), want, rtol=1e-10, atol=1e-11)
    joint = GaussHermite(40).weighted(as_functions(branch))(0, *law)
    assert_close(joint, want, rtol=1e-8, atol=1e-9)


def test_points_without_weight_are_left_out():
    """Far nodes, where the chance of the branch is zero in numbers, leave no NaN."""
    cliff = StochasticMap((x,), [x + v], Noise((v,)), weight=(1 + sympy.erf(40 * x + v)) / 2)
    mean, cov = np.zeros((1, 1)), np.ones((1, 1, 1))
    got = GaussHermite(31).weighted(cliff)(0, mean, cov)
    assert all(np.isfinite(part).all() for part in flatten(got))
    assert got.mass[0] == pytest.approx(0.5, abs=1e-6)


def test_dependence_in_two_dimensions():
    """Noise with a mean, two measurements, a weight of state and noise: joint nodes."""
    noise = Noise((v,), mean=[0.3], cov=[[0.7]])
    bump = sympy.exp(-((v - x / 2) ** 2) / 2)
    step = (1 + sympy.erf(x - y / 2 + v / 3)) / 2
    values = [1 + 2 * x - y + v, y**2 / 3 + x * v - 2]
    law = laws(2, 3)
    law = law[0], law[1] / 4
    for weight in (bump, step):
        branch = StochasticMap((x, y), values, noise, weight=weight)
        want = GaussHermite(30).weighted(as_functions(branch))(0, *law)
        assert_close(ExactGaussian().weighted(branch)(0, *law), want, rtol=1e-8, atol=1e-9)


def test_no_closed_form_names_a_rule_with_points():
    law = laws()
    product = StochasticMap(
        (x,), [x + v], Noise((v,)), weight=(1 + sympy.erf(x)) * (1 + sympy.erf(x + v)) / 4
    )
    with pytest.raises(NoClosedForm, match=r"erf\(.*wanted one error function.*GaussHermite"):
        ExactGaussian().weighted(product)
    wave = StochasticMap((x,), [sympy.sin(x) + v], Noise((v,)), weight=(1 + sympy.erf(x)) / 2)
    with pytest.raises(NoClosedForm, match=r"without complex numbers.*GaussHermite"):
        ExactGaussian().weighted(wave)
    for branch in (product, wave):
        got = GaussHermite(25).weighted(branch)(0, *law)
        want = GaussHermite(40).weighted(as_functions(branch))(0, *law)
        assert_close(got, want, rtol=1e-3, atol=1e-3)
    heavy = Noise((v,), sample=lambda rng, count: rng.laplace(size=(1, count)))
    loud = StochasticMap((x,), [x + v], heavy, weight=(1 + sympy.erf(v)) / 2)
    with pytest.raises(NoClosedForm, match="wanted Gaussian noise where the weight depends on it"):
        ExactGaussian().weighted(loud)


# Weights of the state alone


def test_state_dependent_indicator_in_two_dimensions():
    """A branch that is taken on one side of a blurred line, with a quadratic value."""
    weight = (1 - sympy.erf(x - 2 * y + sympy.Rational(1, 2))) / 2
    branch = StochasticMap((x, y), [x * y + v, x - 3 * y], Noise((v,)), weight=weight)
    law = laws(2, 4)
    law = law[0], law[1] / 4
    want = GaussHermite(40).weighted(as_functions(branch))(0, *law)
    assert_close(ExactGaussian().weighted(branch)(0, *law), want, rtol=1e-7, atol=1e-7)


def test_linear_value_far_from_the_origin():
    """State-dependent weight at positions of 1e6: what the value adds is known exactly."""
    weight = (3 + sympy.erf(x - 10**6)) / 4
    branch = StochasticMap((x,), [2 * x + v], Noise((v,)), weight=weight)
    got = ExactGaussian().weighted(branch)(0, np.array([[1e6 + 0.5]]), np.array([[[0.3]]]))
    near = StochasticMap((x,), [2 * x + v], Noise((v,)), weight=weight.subs(x, x + 10**6))
    want = ExactGaussian().weighted(near)(0, np.array([[0.5]]), np.array([[[0.3]]]))
    np.testing.assert_allclose(got.state.cov, want.state.cov, rtol=1e-9)
    np.testing.assert_allclose(got.value.cov, 4 * got.state.cov + 1, rtol=1e-14)
    np.testing.assert_allclose(got.value.cross, 2 * got.state.cov, rtol=1e-14)


@pytest.mark.parametrize("sign", [1, -1])
def test_branch_in_the_far_tail_is_sane(sign):
    """A mass of 1e-40: moments of a truncated normal law, by the quadrature of its density."""
    weight = (1 - sympy.erf(sign * x / sympy.sqrt(2))) / 2
    branch = StochasticMap((x,), [x + v], Noise((v,)), weight=weight)
    got = ExactGaussian().weighted(branch)(0, np.array([[sign * 19.0]]), np.ones((1, 1, 1)))
    far = 19.0 / np.sqrt(2)
    ratio = np.exp(-(far**2) / 2) / np.sqrt(2 * np.pi) / ndtr(-far)
    np.testing.assert_allclose(got.mass, ndtr(-far), rtol=1e-12)
    np.testing.assert_allclose(got.state.mean, [[sign * (19 - ratio / np.sqrt(2))]], rtol=1e-12)
    want = 1 - ratio * (ratio - far) / 2
    np.testing.assert_allclose(got.state.cov, [[[want]]], rtol=1e-9)


def test_branch_below_the_range_of_numbers_is_empty():
    weight = (1 - sympy.erf(x)) / 2
    branch = StochasticMap((x,), [x + v], Noise((v,)), weight=weight)
    empty, full = (
        ExactGaussian().weighted(branch)(0, np.array([[m]]), np.full((1, 1, 1), 0.1))
        for m in (60.0, -60.0)
    )
    assert empty.mass[0] == 0
    assert np.isnan(empty.value.mean).all()
    np.testing.assert_allclose(full.mass, 1)
    np.testing.assert_allclose(full.value.cov, 1.1)


# Rows of branches


SYSTEMS = {
    "scalar": zoo.scalar_switching("A2"),
    "target": zoo.manoeuvring_target(),
}


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: type(rule).__name__)
@pytest.mark.parametrize("name", SYSTEMS)
def test_row_is_its_branches(rule, name):
    system = SYSTEMS[name]
    law = laws(system.state_size)
    for table in (system.branches, system.readings):
        maps = [branch.map for branch in table[0]]
        rows = rule.row(maps)(0.0, *law)
        assert len(rows) == len(maps)
        for got, map in zip(rows, maps, strict=True):
            want = Linearization.row(rule, [map])(0.0, *law)[0]
            assert_close(got, want, rtol=1e-13, atol=1e-14)


def test_row_of_constant_weights_shares_its_moments():
    maps = [branch.map for branch in SYSTEMS["target"].branches[1]]
    law = laws(2)
    stay, leave = ExactGaussian().row(maps)(0, *law)
    for left, right in zip(flatten(stay)[1:], flatten(leave)[1:], strict=True):
        assert left is right
    np.testing.assert_allclose([stay.mass[0], leave.mass[0]], [0.15, 0.85])


def test_row_of_points_takes_a_value_once():
    calls = []

    class Counted(StochasticMap):
        def value(self, t, x, v):
            calls.append(1)
            return super().value(t, x, v)

    noise = Noise((v,))
    row = [Counted((x,), [1 / (1 + (x + v) ** 2)], noise, q) for q in (0.25, 0.75)]
    first, second = GaussHermite(5).row(row)(0, *laws())
    assert len(calls) == 1
    np.testing.assert_allclose(first.value.mean, second.value.mean, rtol=1e-14)


def test_row_refuses_maps_of_different_states():
    maps = [StochasticMap((s,), [s], weight=sympy.Rational(1, 2)) for s in (x, y)]
    with pytest.raises(ValueError, match="maps: wanted maps of the same state and time"):
        ExactGaussian().row(maps)


def test_row_weights_sum_to_one():
    """Masses add up, and the branches together are the plain moments (law of total covariance)."""
    maps = [branch.map for branch in SYSTEMS["scalar"].branches[0]]
    law = laws(count=9)
    rows = ExactGaussian().row(maps)(0, *law)
    whole = ExactGaussian().moments(maps[0].whole())(0, *law)
    mass = np.array([part.mass for part in rows])
    np.testing.assert_allclose(mass.sum(axis=0), 1, rtol=1e-14)
    mean = sum(part.mass * part.value.mean for part in rows)
    np.testing.assert_allclose(mean, whole.mean, rtol=1e-12, atol=1e-14)
    second = sum(part.mass * (part.value.cov + part.value.mean**2) for part in rows)
    np.testing.assert_allclose(second - mean**2, whole.cov, rtol=1e-11)
