"""Mixtures of modes: the lemmas' steps written out path by path, for any axes of paths."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from seedslib.designed.switching.lemmas import (
    ModeLaw,
    decide,
    mix_logs,
    propagate,
    sense,
    total_covariance,
)
from seedslib.designed.switching.rules import log_odds
from seedslib.linearization import Moments
from seedslib.linearization.moments import Gaussian, Weighted

TIGHT = {"rtol": 1e-12, "atol": 1e-13}
rng = np.random.default_rng(11)


def spd(n, *batch):
    root = rng.normal(size=(n, n + 1, *batch))
    return np.einsum("ia...,ja...->ij...", root, root)


def branch(n, m, batch, bare=False):
    """A weighted law of a state and a value; a bare one has no axes of paths but its mass."""
    inner = () if bare else batch
    joint = spd(n + m, *inner)
    state = Gaussian(rng.normal(size=(n, *inner)), joint[:n, :n])
    value = Moments(rng.normal(size=(m, *inner)), joint[:n, n:], joint[n:, n:])
    return Weighted(rng.uniform(0.1, 0.9, size=batch), state, value)


def at(part, core, path):
    """One path of an array with or without axes of paths."""
    return part[..., *path] if part.ndim > core else part


def mixed(weights, means, covs):
    """Raw moments, minus the squares: of one path."""
    weights = np.array(weights) / np.sum(weights)
    mean = sum(w * m for w, m in zip(weights, means, strict=True))
    second = sum(w * (c + np.outer(m, m)) for w, m, c in zip(weights, means, covs, strict=True))
    return mean, second - np.outer(mean, mean)


def law(n, *shape):
    return ModeLaw(np.log(rng.dirichlet(np.ones(shape[0]), shape[1:]).T.reshape(shape)),
                   rng.normal(size=(n, *shape)), spd(n, *shape))  # fmt: skip


@pytest.mark.parametrize("batch", [(), (2,), (3, 2)])
def test_a_forecast_is_the_mixture_over_the_old_modes(batch):
    """Two parts of each mode; some switches never happen, some moments are those of all paths."""
    before = law(2, 3, *batch)
    made = [
        [[branch(2, 2, batch, bare=(i + l + g) % 2 == 0) for g in range(2)] for l in range(3)]
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

    found = propagate([row(i) for i in range(3)], 0.7, before)
    assert asked == [(0.7, 0), (0.7, 1), (0.7, 2)]
    assert found.log_prob.shape == (3, 2, *batch)
    for l, g in np.ndindex(3, 2):
        parts = [(i, made[i][l][g]) for i in range(3) if made[i][l][g] is not None]
        for path in np.ndindex(*batch):
            if not parts:
                assert found.log_prob[l, g, *path] == -np.inf
                assert_array_equal(found.mean[:, l, g, *path], 0.0)
                assert_array_equal(found.cov[:, :, l, g, *path], np.eye(2))
                continue
            weights = [before.prob[i, *path] * w.mass[path] for i, w in parts]
            mean, cov = mixed(
                weights,
                [at(w.value.mean, 1, path) for _, w in parts],
                [at(w.value.cov, 2, path) for _, w in parts],
            )
            assert_allclose(np.exp(found.log_prob[l, g, *path]), sum(weights), **TIGHT)
            assert_allclose(found.mean[:, l, g, *path], mean, **TIGHT)
            assert_allclose(found.cov[:, :, l, g, *path], cov, **TIGHT)


def test_weights_too_small_for_numbers_are_formed_as_logarithms():
    """The new mode 1 is reached from modes that one of two paths has almost left."""
    batch = (2,)
    logs = np.array([[0.0, -1.0], [-1000.0, -2.0], [-1001.0, -1.5]])
    before = law(2, 3, *batch)._replace(log_prob=logs)
    made = [[[branch(2, 2, batch)], [branch(2, 2, batch) if i else None]] for i in range(3)]
    made[0].append([None]), made[1].append([None]), made[2].append([branch(2, 2, batch)])
    found = propagate([lambda t, mean, cov, i=i: made[i] for i in range(3)], 0.0, before)
    for l, olds in ((1, (1, 2)), (2, (2,))):
        for path in range(2):
            parts = [made[i][l][0] for i in olds]
            scores = np.array([logs[i, path] + np.log(w.mass[path])
                               for i, w in zip(olds, parts, strict=True)])  # fmt: skip
            top = scores.max()
            wanted = top + np.log(np.exp(scores - top).sum())
            mean, cov = mixed(np.exp(scores - top), [w.value.mean[:, path] for w in parts],
                              [w.value.cov[..., path] for w in parts])  # fmt: skip
            assert found.log_prob[l, 0, path] == pytest.approx(wanted, rel=1e-13)
            assert_allclose(found.mean[:, l, 0, path], mean, **TIGHT)
            assert_allclose(found.cov[:, :, l, 0, path], cov, **TIGHT)


def test_a_branch_without_mass_leaves_a_law_that_nothing_depends_on():
    before = law(1, 1, 2)
    empty = branch(1, 1, (2,))._replace(mass=np.array([0.0, 0.5]))
    found = propagate([lambda t, mean, cov: [[empty]]], 0.0, before)
    assert found.log_prob[0, 0, 0] == -np.inf
    assert found.mean[0, 0, 0, 0] == 0.0
    assert found.cov[0, 0, 0, 0, 0] == 1.0
    assert found.mean[0, 0, 0, 1] == pytest.approx(empty.value.mean[0, 1], rel=1e-14)
    assert found.cov[0, 0, 0, 0, 1] == pytest.approx(empty.value.cov[0, 0, 1], rel=1e-14)


@pytest.mark.parametrize("batch", [(), (2,), (3, 2)])
@pytest.mark.parametrize("parts", [1, 3])
def test_what_is_measured_is_the_mixture_over_the_parts(batch, parts):
    """State and measurement together; a mode that cannot show it has no probability."""
    ahead = law(2, 3, parts, *batch)
    inner = (parts, *batch)
    made = [branch(2, 1, inner), None, branch(2, 1, inner)]
    readings = [None if w is None else lambda t, mean, cov, w=w: w for w in made]
    found = sense(readings, 0.0, ahead)
    for i, path in ((i, path) for i in range(3) for path in np.ndindex(*batch)):
        if made[i] is None:
            assert found.log_prob[i, *path] == -np.inf
            assert_array_equal(found.mean[:, i, *path], 0.0)
            assert_array_equal(found.cov[:, :, i, *path], np.eye(2))
            assert_array_equal(found.moments.mean[:, i, *path], 0.0)
            assert_array_equal(found.moments.cross[:, :, i, *path], 0.0)
            assert_array_equal(found.moments.cov[:, :, i, *path], 1.0)
            continue
        weights, means, covs = [], [], []
        for g in range(parts):
            w = made[i]
            weights.append(ahead.prob[i, g, *path] * w.mass[g, *path])
            means.append([*w.state.mean[:, g, *path], *w.value.mean[:, g, *path]])
            joint = np.empty((3, 3))
            joint[:2, :2], joint[2:, 2:] = w.state.cov[..., g, *path], w.value.cov[..., g, *path]
            joint[:2, 2:] = w.value.cross[..., g, *path]
            joint[2:, :2] = joint[:2, 2:].T
            covs.append(joint)
        mean, cov = mixed(weights, np.array(means), covs)
        assert_allclose(found.prob[i, *path], sum(weights), **TIGHT)
        assert_allclose(found.mean[:, i, *path], mean[:2], **TIGHT)
        assert_allclose(found.cov[:, :, i, *path], cov[:2, :2], **TIGHT)
        for part, wanted in zip(found.moments, (mean[2:], cov[:2, 2:], cov[2:, 2:]), strict=True):
            assert_allclose(part[..., i, *path], wanted, **TIGHT)


def test_moments_of_all_paths_need_no_axes():
    """Of the measurement, as of the next state."""
    batch = (2,)
    ahead, full = law(2, 1, 1, *batch), branch(2, 2, (1, *batch))
    bare = full.value._replace(cross=full.value.cross[..., 0, 0], cov=full.value.cov[..., 0, 0])
    state = full.state._replace(cov=full.state.cov[..., 0, 0])
    found = sense([lambda t, mean, cov: full._replace(state=state, value=bare)], 0.0, ahead)
    for path in range(2):
        assert_allclose(found.cov[:, :, 0, path], state.cov, rtol=1e-14)
        assert_allclose(found.moments.cross[..., 0, path], bare.cross, rtol=1e-14)
        assert_allclose(found.moments.cov[..., 0, path], bare.cov, rtol=1e-14)
        assert_allclose(found.moments.mean[:, 0, path], full.value.mean[:, 0, path], rtol=1e-14)


def test_the_printed_form_divides_by_the_forecast_probability():
    """(6.21): sums over the parts, with the law of the state that the forecast has for a value."""
    batch, column = (2,), 1
    ahead, made = law(2, 2, 3, *batch), [branch(2, 2, (3, 2)), branch(2, 2, (3, 2))]
    logs = ahead.log_prob.copy()
    logs[1, column, 0] = -np.inf  # which is never shown there
    ahead = ahead._replace(log_prob=logs)
    found = sense([lambda t, mean, cov, w=w: w for w in made], 0.0, ahead, column)
    assert_array_equal(found.log_prob, logs[:, column])
    for i, path in np.ndindex(2, 2):
        if logs[i, column, path] == -np.inf:
            assert_array_equal(found.mean[:, i, path], 0.0)
            assert_array_equal(found.cov[:, :, i, path], np.eye(2))
            assert_array_equal(found.moments.cross[..., i, path], 0.0)
            continue
        w, q = made[i], ahead.prob[i, :, path]
        share = q * w.mass[:, path] / q[column]
        x, shown = ahead.mean[:, i, column, path], w.value.mean[:, :, path] @ share
        second = sum(
            s * (w.value.cov[..., g, path] + np.outer(*[w.value.mean[:, g, path]] * 2))
            for g, s in enumerate(share)
        )
        product = sum(
            s * (w.value.cross[..., g, path]
                 + np.outer(w.state.mean[:, g, path], w.value.mean[:, g, path]))
            for g, s in enumerate(share)
        )  # fmt: skip
        assert_allclose(found.mean[:, i, path], x, **TIGHT)
        assert_allclose(found.cov[:, :, i, path], ahead.cov[:, :, i, column, path], **TIGHT)
        assert_allclose(found.moments.mean[:, i, path], shown, **TIGHT)
        assert_allclose(found.moments.cross[..., i, path], product - np.outer(x, shown), **TIGHT)
        assert_allclose(found.moments.cov[..., i, path], second - np.outer(shown, shown), **TIGHT)


def test_mixtures_from_logarithms_of_any_size():
    means, covs = rng.normal(size=(2, 3)), spd(2, 3)
    score = np.log([0.2, 0.5, 0.3])
    for shift in (0.0, -5000.0, 5000.0):
        total, mean, cov = mix_logs(score + shift, means, covs)
        wanted = mixed(np.exp(score), means.T, np.moveaxis(covs, -1, 0))
        assert total == pytest.approx(shift, abs=1e-11)
        assert_allclose(mean, wanted[0], rtol=1e-10)  # 5000 leaves twelve digits of a logarithm
        assert_allclose(cov, wanted[1], rtol=1e-10)
    total, mean, cov = mix_logs(np.full(3, -np.inf), means, covs)
    assert total == -np.inf
    assert_array_equal(mean, 0.0)
    assert_array_equal(cov, np.eye(2))


def test_decisions_and_the_law_over_all_modes():
    after = law(2, 3, 4)
    mode, mean = decide(after)
    cov = total_covariance(after)
    for path in range(4):
        prob = after.prob[:, path]
        wanted = mixed(prob, after.mean[..., path].T, np.moveaxis(after.cov[..., path], -1, 0))
        assert mode[path] == prob.argmax()
        assert_allclose(mean[:, path], wanted[0], **TIGHT)
        assert_allclose(cov[..., path], wanted[1], **TIGHT)
    one = ModeLaw(np.zeros((1, 4)), after.mean[:, :1], after.cov[:, :, :1])
    assert_array_equal(total_covariance(one), one.cov[:, :, 0])


def test_log_odds_are_cut_to_eight():
    logs = np.array([[0.0, 0.0, -20.0, -np.inf, -np.inf], [-3.0, -9.0, -1.0, 0.0, -np.inf],
                     [2.5, 30.0, -25.0, -np.inf, -np.inf]])  # fmt: skip
    wanted = [[-3.0, -8.0, 8.0, 8.0, 0.0], [2.5, 8.0, -5.0, 0.0, 0.0]]
    assert_array_equal(log_odds(logs), wanted)
    assert_array_equal(log_odds(np.array([0.0, -np.inf])), [-8.0])
