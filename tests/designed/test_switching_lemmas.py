"""Lemmas 1 to 6 of the switching paper and their corollaries: mixtures by hand, by quadrature.

The second routes know the models only through densities that are written out here.
"""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

from oracles.linear import mixed
from seedslib import zoo
from seedslib.design import cells_from_moments
from seedslib.designed import SwitchingFilter, SwitchingRules, lemmas
from seedslib.linearization import (
    GaussHermite,
    Gaussian,
    Moments,
    Taylor,
    Weighted,
)
from seedslib.models import Noise, SwitchingSystem

x, y, v, w, u = sympy.symbols("x y v w u", real=True)
ModeDistribution, Sensed = lemmas.ModeDistribution, lemmas.Sensed
TIGHT = {"rtol": 1e-12, "atol": 1e-13}
CLOSE = {"rtol": 1e-8, "atol": 1e-8}


# Mixtures, path by path


def semidefinite(rng, n, *batch):
    root = rng.normal(size=(n, n + 1, *batch))
    return np.einsum("ia...,ja...->ij...", root, root)


def random_dist(rng, n, *shape):
    """Modes first, then their parts and paths; probabilities over the modes add up to one."""
    prob = rng.dirichlet(np.ones(shape[0]), shape[1:])
    prob = np.moveaxis(prob, -1, 0)
    return ModeDistribution(
        np.log(prob), rng.normal(size=(n, *shape)), semidefinite(rng, n, *shape)
    )


def branch(rng, n, m, batch, bare=False):
    """A weighted distribution of a state and a value; a bare one has no axes of paths but its
    mass."""
    inner = () if bare else batch
    joint = semidefinite(rng, n + m, *inner)
    state = Gaussian(rng.normal(size=(n, *inner)), joint[:n, :n])
    value = Moments(rng.normal(size=(m, *inner)), joint[:n, n:], joint[n:, n:])
    return Weighted(rng.uniform(0.1, 0.9, size=batch), state, value)


def at(part, core, path):
    """One path of an array with or without axes of paths."""
    return part[(..., *path)] if part.ndim > core else part


def together(weights, means, covs):
    return mixed(np.array(weights), np.array(means), np.array(covs))


@pytest.mark.parametrize("batch", [(), (2,), (3, 2)])
def test_forecast_is_the_mixture_over_the_old_modes(batch):
    """Two parts of each mode; some switches never happen, some moments are those of all paths."""
    rng = np.random.default_rng(1)
    before = random_dist(rng, 2, 3, *batch)
    made = [
        [[branch(rng, 2, 2, batch, bare=(i + l + g) % 2 == 0) for g in range(2)] for l in range(3)]
        for i in range(3)
    ]
    made[0][1][0] = made[2][1][0] = None  # one old mode is left
    for i in range(3):
        made[i][2][1] = None  # none
    asked = []

    def row(i):
        def found(t, mean, cov):
            asked.append((t, i))
            assert_array_equal(mean, before.mean[:, i])
            assert_array_equal(cov, before.cov[:, :, i])
            return made[i]

        return found

    found = lemmas.propagate([row(i) for i in range(3)], 0.7, before)
    assert asked == [(0.7, 0), (0.7, 1), (0.7, 2)]
    assert found.log_prob.shape == (3, 2, *batch)
    for l, g, *path in np.ndindex(3, 2, *batch):
        here = (..., l, g, *path)
        parts = [(i, made[i][l][g]) for i in range(3) if made[i][l][g] is not None]
        if not parts:  # a distribution that nothing depends on
            assert found.log_prob[here] == -np.inf
            assert_array_equal(found.mean[here], 0.0)
            assert_array_equal(found.cov[here], np.eye(2))
            continue
        weights = [before.prob[(i, *path)] * w.mass[tuple(path)] for i, w in parts]
        means = [at(w.value.mean, 1, path) for _, w in parts]
        mean, cov = together(weights, means, [at(w.value.cov, 2, path) for _, w in parts])
        assert_allclose(found.prob[here], sum(weights), **TIGHT)
        assert_allclose(found.mean[here], mean, **TIGHT)
        assert_allclose(found.cov[here], cov, **TIGHT)


def test_forecast_weights_that_are_too_small_for_numbers():
    """The new mode 1 is reached from modes that one of two paths has almost left."""
    rng = np.random.default_rng(2)
    logs = np.array([[0.0, -1.0], [-1000.0, -2.0], [-1001.0, -1.5]])
    before = random_dist(rng, 2, 3, 2)._replace(log_prob=logs)
    made = [[[branch(rng, 2, 2, (2,))], [branch(rng, 2, 2, (2,)) if i else None]] for i in range(3)]
    for i, row in enumerate(made):
        row.append([branch(rng, 2, 2, (2,))._replace(mass=np.array([0.5, 0.0])) if i > 1 else None])
    found = lemmas.propagate([lambda t, mean, cov, i=i: made[i] for i in range(3)], 0.0, before)
    for l, olds, path in ((1, (1, 2), 0), (1, (1, 2), 1), (2, (2,), 0)):
        parts = [made[i][l][0] for i in olds]
        scores = np.array([logs[i, path] + np.log(made[i][l][0].mass[path]) for i in olds])
        means = [w.value.mean[:, path] for w in parts]
        weights = np.exp(scores - scores.max())
        mean, cov = together(weights, means, [w.value.cov[..., path] for w in parts])
        wanted = scores.max() + np.log(weights.sum())
        assert found.log_prob[l, 0, path] == pytest.approx(wanted, rel=1e-13)
        assert_allclose(found.mean[:, l, 0, path], mean, **TIGHT)
        assert_allclose(found.cov[:, :, l, 0, path], cov, **TIGHT)
    assert found.log_prob[2, 0, 1] == -np.inf
    assert_array_equal(found.mean[:, 2, 0, 1], 0.0)
    assert_array_equal(found.cov[:, :, 2, 0, 1], np.eye(2))


@pytest.mark.parametrize("batch", [(), (2,), (3, 2)])
@pytest.mark.parametrize("parts", [1, 3])
def test_measurement_is_the_mixture_over_the_parts(batch, parts):
    """State and measurement together; a mode that cannot show it has no probability."""
    rng = np.random.default_rng(3)
    ahead = random_dist(rng, 2, 4, parts, *batch)
    made = [branch(rng, 2, 1, (parts, *batch), bare=i == 3) for i in range(4)]
    made[1] = None
    readings = [w and (lambda t, mean, cov, w=w: w) for w in made]
    found = lemmas.sense(readings, 0.0, ahead)
    for i, *path in np.ndindex(4, *batch):
        here, w = (..., i, *path), made[i]
        if w is None:
            assert found.log_prob[here] == -np.inf
            dist = found.mean, found.cov, *found.moments
            values = np.zeros(2), np.eye(2), [0.0], np.zeros((2, 1)), [[1.0]]
            for part, value in zip(dist, values, strict=True):
                assert_array_equal(part[here], value)
            continue
        weights, means, covs = [], [], []
        for g in range(parts):
            inside = g, *path
            weights.append(ahead.prob[(i, *inside)] * w.mass[inside])
            means.append([*at(w.state.mean, 1, inside), *at(w.value.mean, 1, inside)])
            cross = at(w.value.cross, 2, inside)
            covs.append(
                np.block(
                    [[at(w.state.cov, 2, inside), cross], [cross.T, at(w.value.cov, 2, inside)]]
                )
            )
        mean, cov = together(weights, means, covs)
        assert_allclose(found.prob[here], sum(weights), **TIGHT)
        wanted = mean[:2], cov[:2, :2], mean[2:], cov[:2, 2:], cov[2:, 2:]
        for part, value in zip((found.mean, found.cov, *found.moments), wanted, strict=True):
            assert_allclose(part[here], value, **TIGHT)


def test_printed_form_divides_by_the_forecast_probability():
    """(6.21): sums over the parts, with the distribution of the state that the forecast has for a
    value."""
    rng, column = np.random.default_rng(4), 1
    ahead = random_dist(rng, 2, 2, 3, 2)
    made = [branch(rng, 2, 1, (3, 2)) for _ in range(2)]
    ahead.log_prob[1, column, 0] = -np.inf  # which is never shown there
    found = lemmas.sense([lambda t, mean, cov, w=w: w for w in made], 0.0, ahead, column)
    assert_array_equal(found.log_prob, ahead.log_prob[:, column])
    dist = found.mean, found.cov, *found.moments
    for i, path in np.ndindex(2, 2):
        if ahead.log_prob[i, column, path] == -np.inf:
            values = np.zeros(2), np.eye(2), [0.0], np.zeros((2, 1)), [[1.0]]
        else:
            w, q = made[i], ahead.prob[i, :, path]
            share = q * w.mass[:, path] / q[column]
            state, value = w.state.mean[..., path], w.value.mean[..., path]
            mean, shown = ahead.mean[:, i, column, path], value @ share
            cross = w.value.cross[..., path] @ share + np.einsum("g,ig,jg->ij", share, state, value)
            square = w.value.cov[..., path] @ share + np.einsum("g,ig,jg->ij", share, value, value)
            values = (
                mean,
                ahead.cov[:, :, i, column, path],
                shown,
                cross - np.outer(mean, shown),
                square - np.outer(shown, shown),
            )
        for part, wanted in zip(dist, values, strict=True):
            assert_allclose(part[..., i, path], wanted, **TIGHT)


def test_mixture_from_logarithms_of_any_size():
    rng = np.random.default_rng(5)
    means, covs, score = rng.normal(size=(2, 3)), semidefinite(rng, 2, 3), np.log([0.2, 0.5, 0.3])
    wanted = mixed(np.exp(score), means.T, np.moveaxis(covs, -1, 0))
    for shift in (0.0, -5000.0, 5000.0):
        total, mean, cov = lemmas.mix_logs(score + shift, means, covs)
        assert total == pytest.approx(shift, abs=1e-11)
        assert_allclose(mean, wanted[0], rtol=1e-10)  # 5000 leaves twelve digits of a logarithm
        assert_allclose(cov, wanted[1], rtol=1e-10)
    total, mean, cov = lemmas.mix_logs(np.full(3, -np.inf), means, covs)
    assert total == -np.inf
    assert_array_equal(mean, 0.0)
    assert_array_equal(cov, np.eye(2))


def test_decision_and_covariance_over_all_modes():
    """Equal modes: the first, where rounding is all that parts them."""
    dist = random_dist(np.random.default_rng(6), 2, 3, 5)
    prob = dist.prob
    prob[:, 3] = [0.2, 0.4 * (1 - 1e-10), 0.4]
    prob[:, 4] = [0.2, 0.4 * (1 - 1e-8), 0.4]
    dist = ModeDistribution.of(prob, dist.mean, dist.cov)
    (mode, mean), cov = lemmas.decide(dist), lemmas.total_covariance(dist)
    for path in range(5):
        means, covs = dist.mean[..., path].T, np.moveaxis(dist.cov[..., path], -1, 0)
        wanted = mixed(prob[:, path], means, covs)
        assert_allclose(mean[:, path], wanted[0], rtol=1e-7)
        assert_allclose(cov[..., path], wanted[1], rtol=1e-7)
    assert mode.tolist() == [*prob[:, :3].argmax(axis=0), 1, 2]
    one = ModeDistribution(np.zeros((1, 5)), dist.mean[:, :1], dist.cov[:, :, :1])
    assert_array_equal(lemmas.total_covariance(one), one.cov[:, :, 0])


# Lemma 1 and lemma 2, by integrals of the joint density (6.14)


def three_modes(n, m):
    rng = np.random.default_rng([n, m])
    chance = np.array([0.45, 0.35, 0.2])
    means, covs = rng.standard_normal((n + m, 3)), semidefinite(rng, n + m, 3) / 3
    moments = Moments(means[n:], covs[:n, n:], covs[n:, n:])
    return chance, means, covs, Sensed(np.log(chance), means[:n], covs[:n, :n], moments)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 2), (2, 1)])
def test_posterior_dist_is_that_of_the_joint_density(n, m):
    chance, means, covs, sensed = three_modes(n, m)
    seen = np.random.default_rng(7).standard_normal(m)
    dist, loglik = lemmas.weigh(sensed, seen)
    mode, estimate = lemmas.decide(dist)
    evidence, first = np.empty(3), np.empty((n, 3))
    for i in range(3):
        mean, cov = means[:, i], covs[..., i]
        axes = [mean[k] + np.sqrt(cov[k, k]) * np.linspace(-11, 11, 401) for k in range(n)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, n)
        both = np.hstack([grid, np.broadcast_to(seen, (len(grid), m))])
        volume = np.prod([axis[1] - axis[0] for axis in axes])
        density = chance[i] * multivariate_normal(mean, cov).pdf(both) * volume
        evidence[i] = density.sum()
        first[:, i] = density @ grid / evidence[i]
        apart = grid - first[:, i]
        assert_allclose(dist.cov[:, :, i], (apart.T * density) @ apart / evidence[i], **CLOSE)
    assert_allclose(dist.prob, evidence / evidence.sum(), **CLOSE)
    assert_allclose(dist.mean, first, **CLOSE)
    assert loglik == pytest.approx(np.log(evidence.sum()), abs=1e-8)
    assert mode == evidence.argmax()
    assert_allclose(estimate, first @ evidence / evidence.sum(), **CLOSE)
    # nothing measured, and nothing that explains what is
    assert_allclose(lemmas.weigh(sensed, np.full(m, np.nan))[0].prob, chance, rtol=1e-12)
    none = sensed._replace(log_prob=np.full(3, -np.inf))
    assert lemmas.weigh(none, seen)[1] == -np.inf


def test_dist_given_the_memory_by_the_information_form():
    """Lemma 5, (6.32) to (6.34): blocks of the inverse covariance, no Schur complement."""
    rng, n, d, modes, cells = np.random.default_rng(8), 2, 3, 3, 2
    prob = rng.dirichlet(np.ones(modes * cells)).reshape(modes, cells)
    means, covs = rng.normal(size=(n + d, modes, cells)), semidefinite(rng, n + d, modes, cells)
    fit = cells_from_moments(prob, means, covs, n, jitter=0.0)
    cell, z = rng.integers(0, cells, (7, 2)), rng.standard_normal((d, 7, 2))
    dist = fit.forecast(cell, z)
    for path in np.ndindex(7, 2):
        score, c = np.empty(modes), cell[path]
        for i in range(modes):
            information = np.linalg.inv(covs[:, :, i, c])
            spread = np.linalg.inv(information[:n, :n])
            apart = z[(..., *path)] - means[n:, i, c]
            wanted = means[:n, i, c] - spread @ information[:n, n:] @ apart
            assert_allclose(dist.mean[(slice(None), i, *path)], wanted, rtol=1e-8)
            assert_allclose(dist.cov[(slice(None), slice(None), i, *path)], spread, rtol=1e-8)
            inner = information[n:, n:] - information[n:, :n] @ spread @ information[:n, n:]
            score[i] = np.log(prob[i, c]) + 0.5 * np.linalg.slogdet(inner)[1]
            score[i] -= 0.5 * apart @ inner @ apart
        weight = np.exp(score - score.max())
        assert_allclose(dist.prob[(..., *path)], weight / weight.sum(), rtol=1e-8)


# Section 7: the linearised filter, and the guard of erratum E2


@pytest.mark.parametrize(("variance", "mean", "left"), [(4.0, 0.0, 4.0), (3.0, 1.5, 0.75)])
def test_guard_drops_the_slope_where_the_variance_would_just_vanish(variance, mean, left):
    """A weight of 1/2 and slope 1/4 at zero: A' D A' = A² exactly for D = 4, below it for D = 3."""
    leave = (1 + sympy.sin(x / 2)) / 2
    system = SwitchingSystem(
        (x,),
        [[x + v], [x + v]],
        Noise((v,)),
        [[1 - leave, leave], [0.5, 0.5]],
        [[x + w]] * 2,
        Noise((w,)),
        [(1, [0], [[1]]), (0, [0], [[1]])],
    )
    state = SwitchingFilter(system, Taylor()).initial()
    dist = state.dist._replace(cov=np.full((1, 1, 2, 1), variance))
    found = SwitchingRules(system, Taylor()).predict(
        0.0, ModeDistribution(*(p[..., 0] for p in dist))
    )
    assert_allclose(found.prob[:, 0], 0.5, rtol=1e-12)
    assert_allclose(found.mean[0, :, 0], [-mean, mean], atol=1e-12)
    assert_allclose(found.cov[0, 0, :, 0], left + 1.0, rtol=1e-12)


# Erratum E1: the normalisation of (6.21)


def test_consistent_filter_does_not_see_the_zero_of_the_scale_and_the_printed_does():
    times = np.arange(8.0)
    runs = {}
    for offset in (0.0, 25.0):
        system = zoo.dependent_switching(offset)
        data = system.simulate(times, 300, 3)
        for form in ("consistent", "printed"):
            filter = SwitchingFilter(system, GaussHermite(5), normalisation=form)
            assert filter.rules.printed is (form == "printed")
            runs[form, offset] = filter.run(times, data.measurements, indicators=data.indicators)
    one, two = (runs["consistent", offset] for offset in (0.0, 25.0))
    assert_allclose(two.mean, one.mean, atol=1e-9)
    assert_allclose(two.mode_prob, one.mode_prob, atol=1e-9)
    errors = {key: np.square(run.mean - data.states)[3:] for key, run in runs.items()}
    gap = errors["printed", 0.0].mean() / errors["consistent", 0.0].mean()
    assert gap == pytest.approx(1.0, abs=0.02)
    assert np.median(errors["printed", 25.0]) > 1.3 * np.median(errors["consistent", 25.0])
