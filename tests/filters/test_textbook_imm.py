"""The new mode drives the step: the textbook IMM written out, filterpy's numbers, quadrature.

And the exact filter of the same timing, all histories of modes; modes of different state size.
"""

from itertools import product

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from oracles.wave import BUMP, wave
from seedslib.design import synthesize
from seedslib.designed import SwitchingFilter, small_order
from seedslib.filters import (
    KnownModeFilter,
    ParticleFilter,
    RaoBlackwellFilter,
)
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import Noise, SwitchingSystem

a, b, w, x, v = sympy.symbols("a b w x v", real=True)
F = np.array([[[1.0, 1], [0, 0.95]], [[1, 0.5], [-0.2, 0.8]], [[0.9, 0], [0.1, 0.7]]])
Q = np.array([[[0.1, 0], [0, 0.2]], [[0.5, 0.2], [0.2, 1]], [[2, 0], [0, 0.3]]])
H, R = np.array([1.0, 0.5]), np.array([0.5, 1.0, 2.0])
P = np.array([[0.9, 0.06, 0.04], [0.1, 0.8, 0.1], [0.2, 0.1, 0.7]])
MU = np.array([0.5, 0.3, 0.2])
START = np.array([[0.0, 1], [1, 0], [-1, 0.5]])
COVS = np.array([np.eye(2), 2 * np.eye(2), [[1, 0.3], [0.3, 2]]])
RECORD = [np.nan, 0.7, -1.2, 2.5, 3.1, 0.4, -2.2]


def linear():
    """Three modes with noises of their own, each two rows of one vector of noises."""
    q = sympy.symbols("q:6", real=True)
    cov = np.zeros((6, 6))
    for j in range(3):
        cov[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] = Q[j]
    state = sympy.Matrix([a, b])
    moves = [
        list(sympy.Matrix(F[j]) * state + sympy.Matrix(q[2 * j : 2 * j + 2])) for j in range(3)
    ]
    shows = [[a + b / 2 + sympy.sqrt(r) * w] for r in R]
    law = list(zip(MU, START, COVS, strict=True))
    return SwitchingSystem(
        (a, b), moves, Noise(q, cov=cov), P.tolist(), shows, Noise((w,)), law, drives="new"
    )


def kalman(mean, cov, y, r):
    s = H @ cov @ H + r
    gain = cov @ H / s
    return (
        mean + gain * (y - H @ mean),
        cov - np.outer(gain, H @ cov),
        norm.pdf(y, H @ mean, s**0.5),
    )


def textbook(record):
    """Mix, move each filter by its own mode, correct, weigh: mean, covariance, probabilities."""
    mu, means, covs, out = MU.copy(), START.copy(), COVS.copy(), []
    for k, y in enumerate(record):
        if k:
            share = P * mu[:, None] / (mu @ P)
            mixed = share.T @ means
            apart = means[:, None] - mixed[None]
            inner = covs[:, None] + apart[..., :, None] * apart[..., None, :]
            covs = np.einsum("il,ilab->lab", share, inner)
            means = np.einsum("lab,lb->la", F, mixed)
            covs = F @ covs @ F.transpose(0, 2, 1) + Q
            mu = mu @ P
        if not np.isnan(y):
            for l in range(3):
                means[l], covs[l], likely = kalman(means[l], covs[l], y, R[l])
                mu[l] *= likely
            mu /= mu.sum()
        mean = mu @ means
        apart = means - mean
        cov = np.einsum("l,lab->ab", mu, covs + apart[:, :, None] * apart[:, None, :])
        out.append((*mean, *cov.ravel(), *mu))
    return np.array(out)


def said(found):
    return np.concatenate(
        [found.mean, found.cov.reshape(len(found.mean), -1), found.mode_prob], axis=1
    )


FILTERPY = """
.4939396491211316 .38074229858041253 .7445268022100829 -.3102264564332505 -.3102264564332505
1.133842656272466 .5429474043206246 .2946686843049695 .1623839113744058
-.35938527712839574 -.5227261878609993 .6977582723906821 -.2962991940889201 -.2962991940889201
1.183136254025041 .3818983013570488 .3836367669991516 .23446493164379964
1.1140733988953182 .5839148186589039 .8667527532679203 -.27685230747899103 -.27685230747899103
1.1879779923762905 .1829395698589289 .3629808637756039 .45407956636546726
2.2304100322967932 .8999737693750376 .693955384949731 -.15278810338242535 -.15278810338242535
.967480008888034 .3780480405649801 .3445535851403734 .27739837429464653
1.2122774620353756 -.1179682560330203 .9212409683756544 -.33737449702911393 -.33737449702911393
1.184162879210701 .1400868536477672 .4075807467779991 .45233239957423366
-.6690091866287822 -.9797757975214688 .972415301781393 -.5345028508902798 -.5345028508902798
1.953187003566366 .17463074322958913 .38377453645937804 .4415947203110328
"""
"""Mean, covariance and mode probabilities that filterpy 2.0.0's IMMEstimator gives for RECORD."""


@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian(), Unscented(), Cubature()])
def test_for_linear_modes_it_is_the_imm_of_the_textbooks(rule):
    found = SwitchingFilter(linear(), rule).run(np.arange(7.0), np.array(RECORD)[:, None],
                                                covariances=True)  # fmt: skip
    wanted = np.array(FILTERPY.split(), dtype=float).reshape(6, 9)
    np.testing.assert_allclose(said(found)[1:], wanted, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(said(found), textbook(RECORD), rtol=1e-12, atol=1e-13)


def test_many_records_at_once_with_gaps():
    system, times = linear(), np.arange(30.0)
    y = system.simulate(times, 8, 1).measurements
    y[3:6, 0, ::2] = np.nan
    found = SwitchingFilter(system, Taylor()).run(times, y, covariances=True)
    for path in range(8):
        one = found.mean[..., path], found.cov[..., path].reshape(30, 4), found.mode_prob[..., path]
        np.testing.assert_allclose(
            np.concatenate(one, axis=1), textbook(y[:, 0, path]), rtol=1e-11, atol=1e-12
        )


def test_mode_that_cannot_be_reached_or_cannot_be_left():
    """Zeros in the table of probabilities: the formulas with the mode left out."""
    chain = [[sympy.Rational(9, 10), sympy.Rational(1, 10)], [0, 1]]
    moves = [[x / 2 + v], [x + 1 + 2 * v]]

    def made(initial, drives="new"):
        return SwitchingSystem(
            (x,), moves, Noise((v,)), chain, [[x + w]] * 2, Noise((w,)), initial, drives=drives
        )

    y = made([(0.5, [0], [[1]])] * 2).simulate(np.arange(6.0), 5, 1).measurements
    rest = SwitchingFilter(made([(0, [7], [[3]]), (1, [0], [[1]])]), Taylor())
    alone = SwitchingFilter(made([(0, [7], [[3]]), (1, [0], [[1]])], "old"), Taylor())
    one, two = (each.run(np.arange(6.0), y) for each in (rest, alone))
    np.testing.assert_allclose(one.mean, two.mean, rtol=1e-13)
    assert (one.mode_prob[:, 0] == 0).all()
    assert np.isfinite(one.mean).all()
    np.testing.assert_allclose(one.loglik, two.loglik, rtol=1e-13)


# Probabilities that depend on the state

NODES = np.linspace(-12.0, 12.0, 4801)


def chance(i, l, place):
    bump = np.exp(-(place**2) / 8)
    stay = 0.2 + 0.6 * bump if i == 0 else bump / 2
    return stay if l == 0 else 1 - stay


def moments(weight, place):
    mass = weight.sum()
    mean = weight @ place / mass
    return mass, mean, weight @ (place - mean) ** 2 / mass


def test_the_state_in_each_branch_and_then_the_move_of_the_new_mode():
    """Two steps: moments given the switch, mixed, and then the Gaussian law moved by its mode."""
    filter = SwitchingFilter(wave(), ExactGaussian())
    y = [0.4, 1.3]
    law = [(0.6, 0.0, 1.0), (0.4, 0.5, 0.5)]
    state = filter.initial()
    for k in range(3):
        state = filter.predict(state, float(k))
        if k:
            mixed = []
            for l in (0, 1):
                weight = sum(
                    p * chance(i, l, NODES) * norm.pdf(NODES, m, d**0.5)
                    for i, (p, m, d) in enumerate(law)
                )
                mixed.append(moments(weight, NODES))
            total, law = sum(part[0] for part in mixed), []
            for l, (p, m, d) in enumerate(mixed):
                moved = NODES + 1.8 * np.sin(NODES) if l == 0 else 0.6 * NODES
                _, m, d = moments(norm.pdf(NODES, m, d**0.5), moved)
                law.append((p / total, m, d + 0.25))
        for l, (p, m, d) in enumerate(law):
            assert state.law.prob[l, 0] == pytest.approx(p, rel=1e-9)
            assert state.law.mean[0, l, 0] == pytest.approx(m, rel=1e-9)
            assert state.law.cov[0, 0, l, 0] == pytest.approx(d, rel=1e-9)
        if k == 2:
            break
        state = filter.correct(state, [y[k]])
        found = []
        for l, (p, m, d) in enumerate(law):
            error, gain = y[k] - m - 2 * l, d / (d + 1)
            found.append((p * norm.pdf(error, 0, (d + 1) ** 0.5), m + gain * error, d - gain * d))
        total = sum(part[0] for part in found)
        law = [(p / total, m, d) for p, m, d in found]


def test_forecasts_split_by_an_indicator_of_the_new_state():
    """(6.19) for this timing: moments of the next state together with what will be shown."""
    tell = [[BUMP, 1 - BUMP], [sympy.Rational(1, 2), sympy.Rational(1, 2)]]
    filter = SwitchingFilter(wave(indicator=tell), GaussHermite(25))
    state = filter.correct(filter.predict(filter.initial(), 0.0), [0.4], -1)
    before, state = state.law, filter.predict(state, 1.0)
    for l in (0, 1):
        weight = sum(
            before.prob[i] * chance(i, l, NODES)
            * norm.pdf(NODES, before.mean[0, i], before.cov[0, 0, i] ** 0.5)
            for i in (0, 1)
        )  # fmt: skip
        p, m, d = moments(weight * (NODES[1] - NODES[0]), NODES)
        moved = NODES + 1.8 * np.sin(NODES) if l == 0 else 0.6 * NODES
        for j in (0, 1):
            # the law of the next place: the Gaussian law before the move, moved and blurred
            density = norm.pdf(NODES, m, d**0.5) * (NODES[1] - NODES[0])
            push = np.linspace(-4, 4, 41) / 2
            mass = norm.pdf(push, 0, 0.5)
            there = moved[::4, None] + push
            told = np.exp(-(there**2) / 8) if l == 0 else np.full(there.shape, 0.5)
            told = told if j == 0 else 1 - told
            both = 4 * density[::4, None] * (mass / mass.sum()) * told
            share, mean, spread = moments(both.ravel(), there.ravel())
            assert state.law.prob[l, j] == pytest.approx(p * share, rel=1e-4)
            assert state.law.mean[0, l, j] == pytest.approx(mean, rel=1e-4, abs=1e-4)
            assert state.law.cov[0, 0, l, j] == pytest.approx(spread, rel=1e-3)


def histories(record):
    """Mean, covariance and mode probabilities by a Kalman filter for each history of modes."""
    parts = [((i,), MU[i], START[i], COVS[i]) for i in range(3)]
    out = []
    for k, y in enumerate(record):
        if k:
            parts = [
                ((*path, l), p * P[path[-1], l], F[l] @ m, F[l] @ c @ F[l].T + Q[l])
                for (path, p, m, c), l in product(parts, range(3))
            ]
        if not np.isnan(y):
            found = []
            for path, p, m, c in parts:
                m, c, likely = kalman(m, c, y, R[path[-1]])
                found.append((path, p * likely, m, c))
            parts = found
        weight = np.array([p for _, p, _, _ in parts])
        weight /= weight.sum()
        mean = sum(p * m for p, (_, _, m, _) in zip(weight, parts, strict=True))
        cov = sum(
            p * (c + np.outer(m - mean, m - mean))
            for p, (_, _, m, c) in zip(weight, parts, strict=True)
        )
        prob = [weight[[path[-1] == l for path, *_ in parts]].sum() for l in range(3)]
        out.append((*mean, *cov.ravel(), *prob))
    return np.array(out)


def test_rao_blackwell_is_the_sum_over_histories():
    found = RaoBlackwellFilter(linear(), 3**5).run(np.arange(6.0), np.array(RECORD[:6])[:, None])
    np.testing.assert_allclose(said(found), histories(RECORD[:6]), rtol=1e-11, atol=1e-12)


def test_rao_blackwell_that_draws_stays_close():
    exact = histories(RECORD)
    found = RaoBlackwellFilter(linear(), 300).run(np.arange(7.0), np.array(RECORD)[:, None])
    assert 0 < np.abs(said(found) - exact).max() < 0.03
    assert np.abs(textbook(RECORD) - exact).max() > 0.03  # what mixing costs is seen beside it


def test_known_modes_are_a_kalman_filter_of_the_new_modes():
    course, (mean, cov) = np.array([1, 0, 2, 2, 0, 1, 1]), (START[1], COVS[1])
    found = KnownModeFilter(linear()).run(
        np.arange(7.0), np.array(RECORD)[:, None], modes=course
    )  # fmt: skip
    for k, l in enumerate(course):
        if k:
            mean, cov = F[l] @ mean, F[l] @ cov @ F[l].T + Q[l]
            mean, cov, likely = kalman(mean, cov, RECORD[k], R[l])
            assert found.loglik[k] == pytest.approx(np.log(likely), rel=1e-12)
        np.testing.assert_allclose(found.mean[k], mean, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(found.cov[k], cov, rtol=1e-12, atol=1e-13)


def test_a_switch_that_is_seen_says_where_the_state_was():
    filter = KnownModeFilter(wave(), ExactGaussian())
    state = filter.predict(filter.initial((4,), mode=[0, 0, 1, 1]), 0.0)
    later = filter.predict(state, 1.0, [0, 1, 0, 1])
    for path, (i, l) in enumerate(product((0, 1), repeat=2)):
        start = norm.pdf(NODES, 0.5 * i, (1 - 0.5 * i) ** 0.5)
        _, m, d = moments(start * chance(i, l, NODES), NODES)
        moved = NODES + 1.8 * np.sin(NODES) if l == 0 else 0.6 * NODES
        _, mean, spread = moments(norm.pdf(NODES, m, d**0.5), moved)
        assert later.mean[0, path] == pytest.approx(mean, rel=1e-9)
        assert later.cov[0, 0, path] == pytest.approx(spread + 0.25, rel=1e-9)


# Modes of different state size


def test_missing_components_have_mean_and_variance_zero():
    """Two and three components: the mode of two gives zero for the third, and is given zero."""
    c, q = sympy.Symbol("c", real=True), sympy.symbols("q:2", real=True)
    big = [
        np.array([[1, 1, 0], [0, 1, 0], [0, 0, 0.0]]),
        np.array([[1, 1, 0.5], [0, 1, 1], [0, 0, 1]]),
    ]
    push = [np.array([[0.3, 0.5, 0]]).T, np.array([[0.1, 0.4, 1.0]]).T]
    state = sympy.Matrix([a, b, c])
    moves = [list(sympy.Matrix(f) * state + sympy.Matrix(g) * q[j]) for j, (f, g) in
             enumerate(zip(big, push, strict=True))]  # fmt: skip
    assert moves[0][2] == 0
    chain, start = np.array([[0.95, 0.05], [0.1, 0.9]]), np.array([0.9, 0.1])
    laws = [(0.9, [0, 1, 0], np.diag([1.0, 1, 0])), (0.1, [0, 1, 0], np.eye(3))]
    system = SwitchingSystem(
        (a, b, c), moves, Noise(q), chain.tolist(), [[a + w]] * 2, Noise((w,)), laws, drives="new"
    )
    times = np.arange(25.0)
    y = system.simulate(times, 4, 3).measurements
    # the recursion with a law of two components and one of three
    want, sizes = np.empty((25, 3, 4)), (2, 3)
    for path in range(4):
        mu = start.copy()
        means = [np.array([0.0, 1]), np.array([0.0, 1, 0])]
        covs = [np.eye(2), np.eye(3)]
        for k in range(25):
            if k:
                wide = [np.pad(means[0], (0, 1)), means[1]]
                square = [np.pad(covs[0], (0, 1)), covs[1]]
                share, mu = chain * mu[:, None] / (mu @ chain), mu @ chain
                means, covs = [], []
                for l, size in enumerate(sizes):
                    mean = share[0, l] * wide[0] + share[1, l] * wide[1]
                    cov = sum(
                        share[i, l] * (square[i] + np.outer(wide[i] - mean, wide[i] - mean))
                        for i in (0, 1)
                    )
                    f, g = big[l][:size, :size], push[l][:size]
                    means.append(f @ mean[:size])
                    covs.append(f @ cov[:size, :size] @ f.T + g @ g.T)
            for l in (0, 1):
                s = covs[l][0, 0] + 1
                error, gain = y[k, 0, path] - means[l][0], covs[l][:, 0] / s
                mu[l] *= norm.pdf(error, 0, s**0.5)
                means[l] = means[l] + gain * error
                covs[l] = covs[l] - np.outer(gain, covs[l][0])
            mu /= mu.sum()
            want[k, :, path] = mu[0] * np.pad(means[0], (0, 1)) + mu[1] * means[1]
    for rule in (Taylor(), ExactGaussian(), Unscented(), Cubature(), GaussHermite(3)):
        found = SwitchingFilter(system, rule).run(times, y)
        np.testing.assert_allclose(found.mean, want, rtol=1e-10, atol=1e-11)
        assert not found.diverged.any()
    quiet = np.zeros((25, 4), int)
    known = KnownModeFilter(system, Unscented()).run(times, y, modes=quiet)
    assert (known.mean[:, 2] == 0).all()
    assert np.isfinite(known.loglik).all()
    drawn = RaoBlackwellFilter(system, 200).run(times, y)
    swarm = ParticleFilter(system, 4000).run(times, y)
    assert np.abs(drawn.mean[:, 0] - swarm.mean[:, 0]).mean() < 0.06
    made = synthesize(system, small_order(), Taylor(), times[:6], paths=4000, seed=1)
    close = made.run(times[:6], y[:6])
    assert np.isfinite(close.mean).all()
    assert not close.diverged.any()
    assert np.sqrt(((close.mean - want[:6]) ** 2).mean()) < 0.35
