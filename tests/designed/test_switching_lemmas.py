"""Lemmas 1 to 6 of the switching paper and their corollaries, by brute-force quadrature.

The formulas under test are those of `seedslib.designed.switching` (`lemmas`, `fits`) and the
linearizations; the routes of this file know the models only through densities written out here.
"""

import numpy as np
import pytest
import sympy
from scipy.optimize import minimize_scalar
from scipy.special import ndtr
from scipy.stats import multivariate_normal

from seedslib import zoo
from seedslib.design.cells import cells_from_moments
from seedslib.designed import Memory, Past, SwitchingFilter, large_order
from seedslib.designed.switching.lemmas import ModeLaw, Sensed, decide, propagate, sense, weigh
from seedslib.designed.switching.rules import SwitchingRules
from seedslib.linearization import ExactGaussian, GaussHermite, Moments, Taylor
from seedslib.models import Noise, StochasticMap, SwitchingSystem

x, y, v, w, u = sympy.symbols("x y v w u", real=True)
CLOSE = {"rtol": 1e-8, "atol": 1e-8}


def bell(at, mean, variance):
    return np.exp(-((at - mean) ** 2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)


def line(mean, variance, count=301):
    """Points and weights of the trapezoidal rule on nine deviations of a normal law."""
    points = mean + np.sqrt(variance) * np.linspace(-9, 9, count)
    return points, bell(points, mean, variance) * (points[1] - points[0])


UNIT = line(0.0, 1.0)


def random_law(shape, seed, scale=1.0):
    """Scalar law of modes (and parts) with the given shape of components and batch."""
    rng = np.random.default_rng(seed)
    prob = rng.uniform(0.2, 1.0, shape)
    prob /= prob.sum(axis=tuple(range(len(shape) - 1)), keepdims=True)
    return ModeLaw.of(
        prob, scale * rng.standard_normal((1, *shape)), rng.uniform(0.2, 1.5, (1, 1, *shape))
    )


def joint_gaussian(rng, n, m):
    root = rng.standard_normal((n + m, n + m + 1))
    return rng.standard_normal(n + m), root @ root.T / 3


def centred(mass, mean, second):
    """Covariance from raw moments, all arrays of components last."""
    return second / mass - np.multiply.outer(mean, mean)


# Lemma 1 and lemma 2: posterior law of mode and state


@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 2), (2, 1)])
def test_lemma_1_and_2(n, m):
    """(6.15) to (6.18): integrals of the joint density (6.14) over the state."""
    rng = np.random.default_rng([n, m])
    chance, parts = np.array([0.5, 0.3, 0.2]), [joint_gaussian(rng, n, m) for _ in range(3)]
    seen = rng.standard_normal(m)
    sensed = Sensed(
        np.log(chance),
        np.stack([mean[:n] for mean, _ in parts], axis=-1),
        np.stack([cov[:n, :n] for _, cov in parts], axis=-1),
        Moments(
            np.stack([mean[n:] for mean, _ in parts], axis=-1),
            np.stack([cov[:n, n:] for _, cov in parts], axis=-1),
            np.stack([cov[n:, n:] for _, cov in parts], axis=-1),
        ),
    )
    law, loglik = weigh(sensed, seen)
    mode, estimate = decide(law)
    evidence, first = np.empty(3), np.empty((n, 3))
    for i, (mean, cov) in enumerate(parts):
        axes = [mean[k] + np.sqrt(cov[k, k]) * np.linspace(-11, 11, 401) for k in range(n)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, n)
        both = np.hstack([grid, np.broadcast_to(seen, (len(grid), m))])
        volume = np.prod([axis[1] - axis[0] for axis in axes])
        density = chance[i] * multivariate_normal(mean, cov).pdf(both) * volume
        evidence[i] = density.sum()
        first[:, i] = density @ grid / evidence[i]
        apart = grid - first[:, i]
        spread = (apart.T * density) @ apart / evidence[i]
        np.testing.assert_allclose(law.cov[:, :, i], spread, **CLOSE)
    np.testing.assert_allclose(law.prob, evidence / evidence.sum(), **CLOSE)
    np.testing.assert_allclose(law.mean, first, **CLOSE)
    assert loglik == pytest.approx(np.log(evidence.sum()), abs=1e-8)
    assert mode == evidence.argmax()
    np.testing.assert_allclose(estimate, first @ evidence / evidence.sum(), **CLOSE)


def test_lemma_1_with_a_singular_measurement():
    """A component measured twice without noise of its own: the pseudo-inverse of (6.17)."""
    cross, spread = np.array([[0.6]]), np.array([[0.9]])
    twice = Moments(
        np.array([[0.2], [0.2]]),
        np.repeat(cross[:, :, None], 2, axis=1),
        np.full((2, 2, 1), spread[0, 0]),
    )
    once = Moments(np.array([[0.2]]), cross[:, :, None], spread[:, :, None])
    prior = np.ones(1), np.array([[0.5]]), np.array([[[1.0]]])
    got, _ = weigh(Sensed(*prior, twice), np.array([1.0, 1.0]))
    want, _ = weigh(Sensed(*prior, once), np.array([1.0]))
    np.testing.assert_allclose(got.mean, want.mean, rtol=1e-12)
    np.testing.assert_allclose(got.cov, want.cov, rtol=1e-12)
    gain = cross @ np.ones((1, 2)) @ np.linalg.pinv(np.full((2, 2), 0.9))
    np.testing.assert_allclose(got.mean[:, 0], 0.5 + gain @ [0.8, 0.8], rtol=1e-12)


def test_lemma_2_takes_the_first_of_equal_modes():
    mode, _ = decide(ModeLaw.of(np.array([0.2, 0.4, 0.4]), np.zeros((1, 3)), np.ones((1, 1, 3))))
    assert mode == 1


def test_decision_and_estimate_minimise_the_criterion():
    """(3.1), (3.2): the criterion (1.7) itself, minimised without any formula, is least there."""
    rng = np.random.default_rng(12)
    chance, parts = np.array([0.45, 0.35, 0.2]), [joint_gaussian(rng, 1, 1) for _ in range(3)]
    seen, axis = np.array([0.3]), np.linspace(-14, 14, 4001)
    sensed = Sensed(
        np.log(chance),
        np.array([[mean[0] for mean, _ in parts]]),
        np.array([[[cov[0, 0] for _, cov in parts]]]),
        Moments(
            np.array([[mean[1] for mean, _ in parts]]),
            np.array([[[cov[0, 1] for _, cov in parts]]]),
            np.array([[[cov[1, 1] for _, cov in parts]]]),
        ),
    )
    mode, estimate = decide(weigh(sensed, seen)[0])
    both = np.stack([axis, np.full_like(axis, seen[0])], axis=-1)
    density = np.array(
        [c * multivariate_normal(*part).pdf(both) for c, part in zip(chance, parts, strict=True)]
    )
    density /= density.sum()
    for weight in (0.1, 1.0, 20.0):
        found = {}
        for i in range(3):

            def loss(at, i=i, weight=weight):
                return (density * weight * (axis - at) ** 2).sum() + 1 - density[i].sum()

            best = minimize_scalar(loss, bracket=(-3, 3))
            found[i] = best.fun
            assert best.x == pytest.approx(estimate[0], abs=1e-5)
            assert loss(estimate[0] + 0.1) == pytest.approx(
                loss(estimate[0]) + 0.01 * weight, rel=1e-6
            )
        assert min(found, key=found.__getitem__) == mode


# Lemma 3: the measurement, dependent noises (6.23) and corollary 1 (6.24)

SWC = zoo.dependent_switching()
# thresholds, slopes and correlations of the model, typed once more
ALPHA, BETA, RHO = (1.2, -0.3), (-0.8, 0.5), (0.6, -0.4)
A0, A1, S = (0.2, -0.5), (0.9, 0.5), (0.6, 0.8)
TAU, DELTA, RHO_W = (1.0, -0.2), (-0.7, 0.4), (0.5, -0.3)
B0, B1, B2, R = (0.0, 1.0), (1.0, 0.7), (0.1, -0.05), (0.7, 0.5)


def beyond(threshold, slope, correlation, at, noise, value):
    """Pr[1{N' > threshold + slope x} = value | x, noise]."""
    far = (correlation * noise - threshold - slope * at) / np.sqrt(1 - correlation**2)
    return ndtr(far if value else -far)


@pytest.fixture(scope="module")
def sensors():
    """For each mode a function that gives the branches of all values of the indicator."""
    return [ExactGaussian().row([branch.map for branch in row]) for row in SWC.readings]


@pytest.fixture(scope="module")
def moves():
    return [ExactGaussian().row([branch.map for branch in row]) for row in SWC.branches]


def column(sensors, j):
    return [lambda t, mean, cov, f=f: f(t, mean, cov)[j] for f in sensors]


def sensed_by_hand(law, i, j, b):
    """Raw moments of (6.19) times (1.4): sums over the parts, states and noises."""
    noise, weights = UNIT
    total = np.zeros(6)
    for g in range(law.prob.shape[1]):
        points, density = line(law.mean[0, i, g, b], law.cov[0, 0, i, g, b])
        at, shock = points[:, None], noise[None]
        share = law.prob[i, g, b] * density[:, None] * weights
        share = share * beyond(TAU[i], DELTA[i], RHO_W[i], at, shock, j)
        shown = B0[i] + B1[i] * at + B2[i] * at**2 + R[i] * shock
        for k, part in enumerate((1.0, at, at**2, shown, at * shown, shown**2)):
            total[k] += (share * part).sum()
    return total


@pytest.mark.parametrize("j", [0, 1])
def test_lemma_3_with_dependent_noises(sensors, j):
    """Consistent form: exact moments of the mixture (6.19) seen through (1.4)."""
    law = random_law((2, 2, 3), seed=3)
    got = sense(column(sensors, j), 0.0, law)
    for i in range(2):
        for b in range(3):
            mass, first, second, shown, cross, square = sensed_by_hand(law, i, j, b)
            want = (
                mass,
                first / mass,
                second / mass - (first / mass) ** 2,
                shown / mass,
                cross / mass - first * shown / mass**2,
                square / mass - (shown / mass) ** 2,
            )
            here = (got.prob, got.mean[0], got.cov[0, 0], *(part.squeeze() for part in got.moments))
            np.testing.assert_allclose([part[i, b] for part in here], want, **CLOSE)


def telling(sensor, noise=(u,)):
    """System of one mode whose indicator depends on the state, not on the noise."""
    tell = sympy.Rational(3, 10) + sympy.Rational(2, 5) * sympy.exp(-(x**2) / 4)
    return SwitchingSystem(
        state=(x,),
        dynamics=[[x + v]],
        noise=Noise((v,)),
        switching=[[1]],
        sensor=[sensor],
        sensor_noise=Noise(noise),
        initial=[(1.0, [0], [[1]])],
        indicator=[[tell, 1 - tell]],
    )


def test_corollary_1():
    """(6.24): with independent noises nu = B E b and H = B E b b'."""
    system = telling([x + x**2 / 5 + u / 2])
    points, density = line(0.4, 0.8)
    chance = 0.3 + 0.4 * np.exp(-(points**2) / 4)
    shown = points + points**2 / 5
    mean, cov = np.array([0.4]), np.array([[0.8]])
    for branch, b in zip(system.readings[0], (chance, 1 - chance), strict=True):
        got = ExactGaussian().weighted(branch.map)(0.0, mean, cov)
        mass, h = (density * b).sum(), (density * b * shown).sum()
        f = (density * b * (shown**2 + 0.25)).sum()
        g = (density * b * points * shown).sum()
        np.testing.assert_allclose(got.mass, mass, **CLOSE)
        np.testing.assert_allclose(got.mass * got.value.mean[0], h, **CLOSE)
        second = got.mass * (got.value.cov + got.value.mean**2)
        np.testing.assert_allclose(second.squeeze(), f, **CLOSE)
        product = got.mass * (got.value.cross[0, 0] + got.state.mean[0] * got.value.mean[0])
        np.testing.assert_allclose(product, g, **CLOSE)


def test_gain_function_by_stein():
    """(6.22): G = m h' + D dh'/dm against a central difference of h."""
    mean, cov = np.array([0.3]), np.array([[0.7]])
    for branch in SWC.readings[0]:
        f = ExactGaussian().weighted(branch.map)

        def h(shift, f=f):
            got = f(0.0, mean + shift, cov)
            return got.mass * got.value.mean[0]

        got, step = f(0.0, mean, cov), 1e-5
        product = got.mass * (got.value.cross[0, 0] + got.state.mean[0] * got.value.mean[0])
        slope = (h(step) - h(-step)) / (2 * step)
        assert product == pytest.approx(0.3 * h(0.0) + 0.7 * slope, abs=1e-9)


# Lemma 4 and lemma 6: the forecast, dependent noises (6.27), corollaries 2, 3, 4


def forecast_by_hand(law, l, f, b):
    """Raw moments (6.26) of the next state with next mode l and indicator f (None: any)."""
    noise, weights = UNIT
    total = np.zeros(3)
    for i in range(2):
        points, density = line(law.mean[0, i, b], law.cov[0, 0, i, b])
        at, shock = points[:, None], noise[None]
        share = law.prob[i, b] * density[:, None] * weights
        share = share * beyond(ALPHA[i], BETA[i], RHO[i], at, shock, l)
        after = A0[i] + A1[i] * at + S[i] * shock
        if f is not None:
            far = TAU[l] + DELTA[l] * after
            share = share * ndtr(-far if f else far)
        total += [(share * part).sum() for part in (1.0, after, after**2)]
    return total


def assert_forecast(got, law, parts):
    for l in range(2):
        for g, f in enumerate(parts):
            for b in range(law.prob.shape[1]):
                mass, first, second = forecast_by_hand(law, l, f, b)
                want = (mass, first / mass, second / mass - (first / mass) ** 2)
                here = got.prob[l, g, b], got.mean[0, l, g, b], got.cov[0, 0, l, g, b]
                np.testing.assert_allclose(here, want, **CLOSE)


def test_lemmas_4_and_6_with_dependent_noises(moves):
    """(6.35) without an indicator, in closed form."""
    law = random_law((2, 3), seed=4)
    rows = [lambda t, m, c, f=f: [[w] for w in f(t, m, c)] for f in moves]
    assert_forecast(propagate(rows, 0.0, law), law, [None])


def test_lemmas_4_and_6_with_an_indicator_of_the_next_state():
    """(6.35) with every factor of (6.27), by nodes in state and noise."""
    law = random_law((2, 3), seed=5)
    got = SwitchingRules(SWC, GaussHermite(60)).predict(0.0, law)
    assert got.prob.shape == (2, 2, 3)
    assert_forecast(got, law, [0, 1])


def two_modes(indicator):
    """State-dependent switching with independent noises, and an indicator to be given."""
    leave = sympy.Rational(7, 20) - sympy.Rational(3, 10) * sympy.exp(-(x**2) / 8)
    return SwitchingSystem(
        state=(x,),
        dynamics=[[1 + 9 * x / 10 + v / 2], [3 * x / 5 + v / 2]],
        noise=Noise((v,)),
        switching=[[1 - leave, leave], [0.2, 0.8]],
        sensor=[[x + u], [2 + x + u]],
        sensor_noise=Noise((u,)),
        initial=[(0.5, [0], [[1]])] * 2,
        indicator=indicator,
    )


TELL = sympy.Rational(1, 5) + sympy.Rational(3, 5) * sympy.exp(-(x**2) / 6)


def test_corollary_2():
    """(6.28): the factor A(x), and B at the next state, averaged over the noise alone."""
    system = two_modes([[TELL, 1 - TELL], [0.3, 0.7]])
    law = random_law((2, 1), seed=6)
    got = SwitchingRules(system, ExactGaussian()).predict(0.0, law)
    noise, weights = UNIT
    for l in range(2):
        for f in range(2):
            raw = np.zeros(3)
            for i in range(2):
                points, density = line(law.mean[0, i, 0], law.cov[0, 0, i, 0])
                leave = 0.35 - 0.3 * np.exp(-(points**2) / 8) if i == 0 else 0.2
                flat = 1 + 0.9 * points if i == 0 else 0.6 * points
                after = flat[:, None] + noise / 2
                tell = 0.2 + 0.6 * np.exp(-(after**2) / 6) if l == 0 else 0.3 + 0 * after
                shown = 1 - tell if f else tell
                share = law.prob[i, 0] * density * (leave if l != i else 1 - leave)
                for k in range(3):
                    raw[k] += share @ (after**k * shown @ weights)
            want = raw[0], raw[1] / raw[0], raw[2] / raw[0] - (raw[1] / raw[0]) ** 2
            here = got.prob[l, f, 0], got.mean[0, l, f, 0], got.cov[0, 0, l, f, 0]
            np.testing.assert_allclose(here, want, **CLOSE)


def test_corollaries_3_and_4():
    """(6.29): a blind indicator only multiplies the forecast probabilities."""
    table = np.array([[0.9, 0.1], [0.2, 0.8]])
    blind = SwitchingRules(two_modes(table.tolist()), ExactGaussian())
    none = SwitchingRules(two_modes(None), ExactGaussian())
    law = random_law((2, 5), seed=7)
    forecast = none.predict(0.0, law)
    for a, b in zip(blind.predict(0.0, law), forecast, strict=True):
        assert np.array_equal(a, b)
    whole = none.sense(1.0, forecast, None)
    np.testing.assert_allclose(whole.prob, forecast.prob[:, 0], rtol=1e-15)
    for f in range(2):
        seen = blind.sense(1.0, forecast, np.full(5, f))
        np.testing.assert_allclose(seen.prob, table[:, f, None] * whole.prob, rtol=1e-14)
        both = [(part.mean, part.cov, *part.moments) for part in (seen, whole)]
        for a, b in zip(*both, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-14, atol=1e-15)


# Lemma 5: law of mode and state given the memory


def test_lemma_5_by_the_information_form():
    """(6.32) to (6.34): blocks of the inverse of the joint covariance, no Schur complement."""
    rng, n, d, modes = np.random.default_rng(8), 2, 3, 3
    prob = np.array([0.5, 0.3, 0.2])
    parts = [joint_gaussian(rng, n, d) for _ in range(modes)]
    fit = cells_from_moments(
        prob[:, None],
        np.stack([mean for mean, _ in parts], axis=-1)[..., None],
        np.stack([cov for _, cov in parts], axis=-1)[..., None],
        n,
        jitter=0.0,
    )
    z = rng.standard_normal((d, 7))
    got = fit.forecast(np.zeros(7, dtype=int), z)
    score = np.empty((modes, 7))
    for i, (mean, cov) in enumerate(parts):
        information = np.linalg.inv(cov)
        spread = np.linalg.inv(information[:n, :n])
        apart = z - mean[n:, None]
        want = mean[:n, None] - spread @ information[:n, n:] @ apart
        np.testing.assert_allclose(got.mean[:, i], want, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(
            got.cov[:, :, i], np.broadcast_to(spread[..., None], (n, n, 7)), rtol=1e-12, atol=1e-13
        )
        inner = information[n:, n:] - information[n:, :n] @ spread @ information[:n, n:]
        score[i] = np.log(prob[i]) + 0.5 * np.linalg.slogdet(inner)[1]
        score[i] -= 0.5 * np.einsum("kb,kl,lb->b", apart, inner, apart)
    want = np.exp(score - score.max(axis=0))
    np.testing.assert_allclose(got.prob, want / want.sum(axis=0), rtol=1e-12, atol=1e-13)


# Section 7: expansions, and the guard of erratum E2


def test_expansions_in_two_dimensions():
    """(7.2), (7.3): a product rule exact to degree nine on the product of the expansions."""
    state = (x, y)
    leave = 0.35 - 0.2 * sympy.exp(-(x**2) / 8 - (y - x / 3) ** 2 / 6)
    values = [x + sympy.sin(y) + v / 2, x * y / 3 - y + (1 + x / 4) * w]
    noise = Noise((v, w), cov=[[1.0, 0.3], [0.3, 0.5]])
    branch = StochasticMap(state, values, noise, weight=leave)
    mean, cov = np.array([0.7, -0.4]), np.array([[0.5, 0.2], [0.2, 0.3]])
    here = {x: mean[0], y: mean[1], v: 0, w: 0}

    def expanded(expression):
        slopes = [sympy.diff(expression, s).subs(here) for s in (x, y, v, w)]
        moved = (x - mean[0], y - mean[1], v, w)
        return expression.subs(here) + sum(a * s for a, s in zip(slopes, moved, strict=True))

    flat = StochasticMap(state, [expanded(e) for e in values], noise, weight=expanded(leave))
    whole = StochasticMap.from_functions(2, 2, flat.value, noise, weight=flat.weight)
    got = Taylor().weighted(branch)(0.0, mean, cov)
    want = GaussHermite(5).weighted(whole)(0.0, mean, cov)
    for a, b in zip((got.mass, *got.state, *got.value), (want.mass, *want.state, *want.value),
                    strict=True):  # fmt: skip
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13)


def test_printed_means_of_the_expansions():
    """(7.2), (7.3) as the paper prints them, two states, against the filter's own functions.

    The route of the test above knows no formula; this one knows nothing else.
    """
    leave = 0.35 - 0.2 * sympy.exp(-(x**2) / 8 - (y - x / 3) ** 2 / 6)
    values = [x + sympy.sin(y) + v / 2, x * y / 3 - y + (1 + x / 4) * w]
    noise, blind = sympy.Matrix([[1, 0.3], [0.3, 0.5]]), 0.7
    system = SwitchingSystem(
        state=(x, y),
        dynamics=[values, values],
        noise=Noise((v, w), cov=np.array(noise, dtype=float)),
        switching=[[1 - leave, leave], [0, 1]],
        sensor=[[x**2 / 4 + y + u]] * 2,
        sensor_noise=Noise((u,), cov=[[0.8]]),
        initial=[(0.5, [0, 0], np.eye(2).tolist())] * 2,
        indicator=[[blind, 1 - blind], [0.2, 0.8]],
    )
    m, d = np.array([0.7, -0.4]), np.array([[0.5, 0.2], [0.2, 0.3]])
    here = {x: m[0], y: m[1], v: 0, w: 0, u: 0}

    def number(expression, *names):
        found = sympy.Matrix(expression)
        return np.array((found.jacobian(names) if names else found).subs(here), dtype=float)

    chance, lean = number([leave])[0, 0], number([leave], x, y)
    a, a_x, a_v = number(values), number(values, x, y), number(values, v, w)
    shown = [x**2 / 4 + y + u]
    b, b_x, b_w = number(shown), number(shown, x, y), number(shown, u)
    d_v = np.array(noise, dtype=float)
    h = blind * b
    f = blind * (b @ b.T + b_x @ d @ b_x.T + 0.8 * b_w @ b_w.T)
    g = m[:, None] @ h.T + blind * d @ b_x.T  # follows from (6.22)
    eta, pi = chance, chance * a + a_x @ d @ lean.T
    chi = a @ lean @ d @ a_x.T + a_x @ d @ lean.T @ a.T
    chi = chi + chance * (a @ a.T + a_x @ d @ a_x.T + a_v @ d_v @ a_v.T)
    rules = SwitchingRules(system, Taylor())
    gone, seen = rules.rows[0](0.0, m, d)[1][0], rules.readings[0][0](0.0, m, d)

    def raw(found):
        mean = found.value.mean[:, None]
        return found.mass * mean, found.mass * (found.value.cov + mean @ mean.T)

    tight = {"rtol": 1e-12, "atol": 1e-13}
    np.testing.assert_allclose(gone.mass, eta, **tight)
    for ours, printed in zip((*raw(gone), *raw(seen)), (pi, chi, h, f), strict=True):
        np.testing.assert_allclose(ours, printed, **tight)
    cross = seen.mass * (seen.value.cross + m[:, None] @ seen.value.mean[None])
    np.testing.assert_allclose(cross, g, **tight)


def test_guard_of_the_expanded_forecast():
    """Erratum E2: (7.3) gives the variance -1.51 at (0.9, 2); with the guard none is negative."""
    system = zoo.scalar_switching("A1H")
    m, d = 0.9, 2.0
    chance, slope = 0.35 - 0.3 * np.exp(-(m**2) / 8), 0.075 * m * np.exp(-(m**2) / 8)
    value, stretch = m + 1.8 * np.sin(m), 1 + 1.8 * np.cos(m)
    lean = slope * d * stretch
    second = 2 * value * lean + chance * (value**2 + stretch**2 * d + 0.25)
    printed = second / chance - (value + lean / chance) ** 2
    assert printed == pytest.approx(-1.51, abs=0.005)
    means, variances = np.meshgrid(np.linspace(-6, 6, 121), np.linspace(0.05, 5, 60))
    for i in range(2):
        for got in Taylor().row([b.map for b in system.branches[i]])(
            0.0, means[None], variances[None, None]
        ):
            assert (got.value.cov >= 0.25).all()
    (_, kept), _ = (
        Taylor().row([b.map for b in row])(0.0, np.array([m]), np.array([[d]]))
        for row in system.branches
    )
    np.testing.assert_allclose(kept.value.cov, stretch**2 * d + 0.25, rtol=1e-12)


# Erratum E1: the normalisation of (6.21)


def memories(scale, count=3000, seed=0):
    """Random laws given a memory, as (6.32) gives them."""
    rng = np.random.default_rng(seed)
    chance = rng.uniform(size=count)
    return ModeLaw.of(
        np.array([chance, 1 - chance]),
        scale * rng.standard_normal((1, 2, count)),
        rng.uniform(0.1, 1.0, (1, 1, 2, count)),
    )


@pytest.fixture(scope="module")
def forecast():
    return SwitchingRules(SWC, GaussHermite(12)).predict


def leakage(sensors, law):
    """r: mass of the mixture over the forecast probability, (L, M, batch)."""
    return np.stack(
        [sense(column(sensors, j), 0.0, law).prob / law.prob[:, j] for j in range(2)], axis=1
    )


@pytest.mark.parametrize(
    ("scale", "low", "high"), [(0.5, 0.97, 1.04), (1.5, 0.3, 1.6), (3.0, 0.05, 2.0)]
)
def test_mass_of_the_mixture_is_not_the_forecast_probability(sensors, forecast, scale, low, high):
    """r of erratum E1 leaves one the farther, the wider the memories are."""
    r = leakage(sensors, forecast(0.0, memories(scale)))
    assert low < r.min() < 1.0 < r.max() < high


@pytest.mark.parametrize("scale", [0.5, 1.5, 3.0])
def test_consistent_joint_covariance_is_semidefinite(sensors, forecast, scale):
    law = forecast(0.0, memories(scale, seed=1))
    for j in range(2):
        got = sense(column(sensors, j), 0.0, law)
        determinant = got.cov[0, 0] * got.moments.cov[0, 0] - got.moments.cross[0, 0] ** 2
        assert (got.cov[0, 0] > 0).all()
        assert (determinant > 0).all()


def test_printed_normalisation_depends_on_the_origin(sensors, forecast):
    """A memory with r = 1.009: at the offset 100 the printed variance is about -89."""
    laws = forecast(0.0, memories(0.7, count=5000, seed=2))
    r = leakage(sensors, laws)[0, 1]
    b = int(np.argmin(np.abs(r - 1.009)))
    law = ModeLaw(*(part[..., b : b + 1] for part in laws))
    r = r[b]
    assert r == pytest.approx(1.009, abs=5e-4)
    far = ExactGaussian().weighted(zoo.dependent_switching(100.0).readings[0][1].map)
    readings = {0.0: column(sensors, 1)[0], 100.0: far}
    found = {
        (name, offset): sense([reading, None], 0.0, law, j).moments
        for offset, reading in readings.items()
        for name, j in (("consistent", None), ("printed", 1))
    }
    right = [found["consistent", offset] for offset in (0.0, 100.0)]
    np.testing.assert_allclose(right[0].cov[..., 0, :], right[1].cov[..., 0, :], rtol=1e-11)
    np.testing.assert_allclose(right[0].mean[:, 0] + 100, right[1].mean[:, 0], rtol=1e-13)
    spread, mean = right[1].cov[0, 0, 0, 0], right[1].mean[0, 0, 0]
    printed = found["printed", 100.0]
    assert printed.mean[0, 0, 0] == pytest.approx(r * mean, rel=1e-12)
    assert printed.cov[0, 0, 0, 0] == pytest.approx(r * spread + r * (1 - r) * mean**2, rel=1e-9)
    assert -110 < printed.cov[0, 0, 0, 0] < -80
    assert 0.5 < spread < 2.0


def test_consistent_form_follows_the_scale_of_the_measurement():
    """y -> A y + c: forecasts move with it, posterior laws stay, the likelihood loses log|A|."""
    a, c = np.array([[2.0, -1.0], [0.5, 3.0]]), np.array([50.0, -7.0])
    shown = [x + x**2 / 5 + u, x / 2 - w + u / 3]
    other = [sum(a[i, k] * shown[k] for k in range(2)) + c[i] for i in range(2)]
    law, seen = (
        random_law((1, 2, 4), seed=9),
        np.array([[0.3, 2.0, -1.0, 4.0], [0.1, 1.0, 0.0, 2.0]]),
    )
    results = []
    for sensor, record in ((shown, seen), (other, a @ seen + c[:, None])):
        rules = SwitchingRules(telling(sensor, (u, w)), ExactGaussian(), split=False)
        sensed = rules.sense(0.0, law, np.zeros(4, dtype=int))
        results.append((sensed, *weigh(sensed, record)))
    (one, first, fit_one), (two, second, fit_two) = results
    np.testing.assert_allclose(two.prob, one.prob, rtol=1e-12)
    np.testing.assert_allclose(
        two.moments.mean, np.einsum("ij,j...->i...", a, one.moments.mean) + c[:, None, None],
        rtol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(
        two.moments.cov, np.einsum("ij,jk...,lk->il...", a, one.moments.cov, a), rtol=1e-11
    )
    for left, right in zip(first, second, strict=True):
        np.testing.assert_allclose(left, right, rtol=1e-10)
    np.testing.assert_allclose(fit_two, fit_one - np.log(np.linalg.det(a)), rtol=1e-10)


def test_two_approximations_of_one_law(sensors):
    """Note O5: (6.19) and (6.9) keep the chances, but not the covariance with the measurement."""
    law = memories(1.0, count=12, seed=4)
    forecast = SwitchingRules(SWC, GaussHermite(40)).predict(0.0, law)
    got = sense(column(sensors, 1), 0.0, forecast)
    noise, weights = UNIT
    ratios = []
    for l in range(2):
        for b in range(12):
            raw = np.zeros(4)
            for i in range(2):
                points, density = line(law.mean[0, i, b], law.cov[0, 0, i, b])
                at, shock = points[:, None], noise[None]
                share = law.prob[i, b] * density[:, None] * weights
                share = share * beyond(ALPHA[i], BETA[i], RHO[i], at, shock, l)
                after = A0[i] + A1[i] * at + S[i] * shock
                far = TAU[l] + DELTA[l] * after
                flat = B0[l] + B1[l] * after + B2[l] * after**2
                nu = flat * ndtr(-far) + R[l] * RHO_W[l] * bell(far, 0.0, 1.0)
                parts = (ndtr(-far), after * ndtr(-far), nu, after * nu)
                raw += [(share * part).sum() for part in parts]
            mass, first, shown, cross = raw
            assert got.prob[l, b] == pytest.approx(mass, rel=0.1)
            right = cross / mass - first * shown / mass**2
            if mass > 0.02:
                ratios.append(got.moments.cross[0, 0, l, b] / right)
    assert 0.5 < min(ratios) < 0.95
    assert 1.05 < max(ratios) < 1.65


@pytest.mark.parametrize(("indicator", "ranks"), [("noisy", [1, 3, 4]), ("exact", [1, 2, 4])])
def test_rank_of_the_memory(indicator, ranks):
    """Erratum E5: estimates of the manoeuvring target, two remembered, in each met cell."""
    system, times = zoo.manoeuvring_target(indicator), np.arange(4.0)
    data = system.simulate(times, 2000, 5)
    found = SwitchingFilter(system, ExactGaussian()).run(
        times, data.measurements, indicators=data.indicators
    )
    for k, rank in enumerate(ranks):
        memory = found.mean[0] if k == 0 else np.concatenate([found.mean[k], found.mean[k - 1]])
        cell = found.modes[k] + 2 * found.modes[max(k - 1, 0)]
        for c in np.unique(cell):
            if (here := cell == c).sum() > 50:
                values = np.linalg.eigvalsh(np.cov(memory[:, here]))
                assert (values > 1e-9 * values[-1]).sum() == rank


# Theorem 1: the state function of the filter


@pytest.mark.parametrize("l", [1, 2, 4])
def test_memory_obeys_the_printed_recursion(l):
    """(2.1) to (2.4) with the cutting matrices C = [E O], growing and then full."""
    rng, n, memory, past = np.random.default_rng(l), 3, large_order(l), Past()
    vector, modes = np.empty(0), np.empty(0, dtype=int)
    cut = np.hstack([np.eye((l - 1) * n), np.zeros(((l - 1) * n, n))])
    cut_modes = np.hstack([np.eye(l - 1), np.zeros((l - 1, 1))])
    for k in range(9):
        estimate, mode = rng.standard_normal(n), int(rng.integers(3))
        past = memory.push(past, estimate=estimate, mode=mode)
        kept = (vector, modes) if k <= l - 1 else (cut @ vector, cut_modes @ modes)
        vector, modes = np.concatenate([estimate, kept[0]]), np.concatenate([[mode], kept[1]])
        assert np.array_equal(past.vector, vector)
        assert np.array_equal(np.array(past.modes), modes)
        assert len(vector) == memory.dimension(k, n) == n * min(k + 1, l)


def test_orders_of_the_filters():
    """l (n + 1) numbers for the paper's memory, and those of its relatives."""
    n, m = 2, 1
    assert Memory(3).order(n, m) == 3 * n
    assert Memory(0, 3, 3).order(n, m) == 3 * m
    assert Memory(1, 1, 1).order(n, m) == n + m
    assert Memory(2, log_odds=True).order(n, m, modes=3) == 2 * (n + 2)
