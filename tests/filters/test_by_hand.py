"""The small rules that filters are made of, each against its formula on ordinary numbers."""

import numpy as np
import pytest

from seedslib.filters import (
    Gated,
    KalmanFilter,
    ParticleFilter,
    draw_trajectories,
    extended_kalman,
)
from seedslib.filters.backward import gain_of, stepped_back, wide
from seedslib.filters.covariance import BLOCK
from seedslib.filters.estimates import as_record
from seedslib.filters.mixture import mix
from seedslib.filters.particle import _direction
from seedslib.filters.weights import TIE, logarithm, most_probable, normalised, relative
from seedslib.models import LinearSystem

RNG = np.random.default_rng(8)


def covariances(n, *batch):
    root = RNG.standard_normal((n, n, *batch))
    return np.einsum("ik...,jk...->ij...", root, root)


# Weights


@pytest.mark.parametrize("axis", [0, 1])
def test_the_most_probable_is_the_first_of_equal_ones(axis):
    prob = np.array([[0.2, 0.5, 0.1], [0.2 * (1 + 0.5 * TIE), 0.1, 0.3], [0.1, 0.5 + 1e-12, 0.3]])
    prob[2, 0] = 0.2 * (1 - 0.4 * TIE)
    if axis == 0:
        assert most_probable(prob).tolist() == [0, 0, 1]
        assert most_probable(prob * 7.0).tolist() == [0, 0, 1]
        prob[1, 0] = 0.2 * (1 + 2 * TIE)
        assert most_probable(prob).tolist() == [1, 0, 1]
    else:
        assert most_probable(prob.T, axis=1).tolist() == [0, 0, 1]


def test_logarithms_of_weights():
    found = logarithm(np.array([2.0, 0.0, -3.0, 0.5]))
    np.testing.assert_array_equal(found, [np.log(2.0), -np.inf, -np.inf, np.log(0.5)])


@pytest.mark.parametrize("shift", [0.0, -2000.0, 1e12])
def test_scores_become_weights_of_sum_one(shift):
    """However small or large they are; what has no finite weight is returned as it is."""
    score = np.array([[0.3, -np.inf], [-1.2, -np.inf], [2.0, -np.inf]])
    given = score + shift
    plain = np.exp(score[:, 0] - 2.0)
    found, total = normalised(given, 0)
    np.testing.assert_allclose(np.exp(found[:, 0]), plain / plain.sum(), rtol=1e-3)
    assert total[0] - shift == pytest.approx(np.log(np.exp(score[:, 0]).sum()), abs=2e-4)
    np.testing.assert_array_equal(found[:, 1], -np.inf)
    assert total[1] == -np.inf
    weight, highest, lost = relative(given, 0)
    np.testing.assert_allclose(weight[:, 0], plain, rtol=1e-3)
    np.testing.assert_array_equal(weight[:, 1], 0.0)
    np.testing.assert_array_equal(highest, [2.0 + shift, -np.inf])
    np.testing.assert_array_equal(lost, [False, True])
    weight, highest, lost = relative(given[None], (0, 1))
    np.testing.assert_allclose(weight[0, :, 0], plain, rtol=1e-3)


# Mixtures


def test_moments_of_a_mixture_are_those_of_its_raw_moments():
    mass = np.array([[0.5, 2.0], [0.2, 0.0], [0.4, 1.0]])
    mean, cov = RNG.standard_normal((2, 3, 2)), covariances(2, 3, 2)
    cov[:, :, 1, 1] = mean[:, 1, 1] = np.nan  # of no mass: not looked at
    found = mix(mass, mean, cov)
    np.testing.assert_allclose(found.mass, mass.sum(axis=0))
    for b in range(2):
        share = mass[:, b] / mass[:, b].sum()
        parts = [k for k in range(3) if share[k] > 0]
        middle = sum(share[k] * mean[:, k, b] for k in parts)
        raw = sum(share[k] * (cov[..., k, b] + np.outer(mean[:, k, b], mean[:, k, b]))
                  for k in parts)  # fmt: skip
        np.testing.assert_allclose(found.mean[:, b], middle, rtol=1e-13)
        np.testing.assert_allclose(found.cov[..., b], raw - np.outer(middle, middle), atol=1e-14)
    np.testing.assert_array_equal(found.cov, np.swapaxes(found.cov, 0, 1))


def test_a_mixture_of_nothing_is_harmless_and_stays_alone():
    mass = np.array([[0.0, 0.3], [-0.2, 0.6]])
    found = mix(mass, np.full((2, 2, 2), 5.0), covariances(2, 2, 2))
    assert found.mass.tolist() == pytest.approx([0.0, 0.9])
    np.testing.assert_array_equal(found.mean[:, 0], 0.0)
    np.testing.assert_array_equal(found.cov[..., 0], np.eye(2))
    np.testing.assert_allclose(found.mean[:, 1], 5.0)


# Steps back


@pytest.mark.parametrize("batch", [(), (3,)])
def test_gain_and_step_back(batch):
    """m + G (m' - E m') and P + G (P' - E P') G^T with G = C / P."""
    n, c = 2, 3
    cross, ahead = RNG.standard_normal((n, n, *batch)), covariances(n, *batch) + 0.1
    now, later = covariances(n, *batch), covariances(n, *batch)
    means = [RNG.standard_normal((n, *batch, c)) for _ in range(3)]
    gain = gain_of(cross, ahead)
    columns, cov = stepped_back(means[0], now, means[1], ahead, gain, means[2], later)
    for i in np.ndindex(batch):
        at = (..., *i)
        G = cross[at] @ np.linalg.inv(ahead[at])
        np.testing.assert_allclose(gain[at], G, rtol=1e-8, atol=1e-9)
        one = [m[(slice(None), *i)] for m in means]
        np.testing.assert_allclose(columns[(slice(None), *i)], one[0] + G @ (one[2] - one[1]),
                                   rtol=1e-8, atol=1e-9)  # fmt: skip
        np.testing.assert_allclose(cov[at], now[at] + G @ (later[at] - ahead[at]) @ G.T,
                                   rtol=1e-8, atol=1e-9)  # fmt: skip


def test_a_common_matrix_has_axes_of_length_one():
    cov = covariances(2)
    assert wide(cov, (3, 4)).shape == (2, 2, 1, 1)
    assert wide(cov, ()).shape == (2, 2)
    full = covariances(2, 3)
    assert wide(full, (3,)) is full


# Records, blocks, states


def test_records_of_any_number_type():
    record = as_record([[[1, 2], [3, 4]]], 1, 2)
    assert record.dtype == np.float64
    assert record.tolist() == [[[1.0, 2.0], [3.0, 4.0]]]
    assert np.isnan(as_record(np.float32([[np.nan]]), 1, 1)).all()
    whole = np.ones((2, 1))
    assert as_record(whole, 2, 1) is whole
    for wrong in (np.ones((3, 1)), np.ones((2, 2)), np.ones(2)):
        with pytest.raises(ValueError, match=r"wanted shape \(2, 1, \*batch\)"):
            as_record(wrong, 2, 1)
    with pytest.raises(TypeError, match="measurements: wanted"):
        as_record(np.array([["a"], ["b"]]), 2, 1)


def test_blocks_of_paths_for_each_worker():
    filter = extended_kalman(LinearSystem(0.5, 1, 1, 1, 0, 1))
    times = np.arange(3.0)
    assert filter.block(times, 10, 2) == BLOCK
    assert filter.block(times, 6 * BLOCK + 1, 3) == 2 * BLOCK + 1
    assert filter.block(times, 100 * BLOCK, 2) == 4 * BLOCK
    for workers in (0, 1.5):
        with pytest.raises((TypeError, ValueError), match=r"^workers: wanted"):
            filter.block(times, 10, workers)


def test_a_gate_shows_the_time_of_its_filter():
    gated = Gated(KalmanFilter(LinearSystem(0.5, 1, 1, 1, 0, 1)), 0.99)
    state = gated.initial((2,))
    assert state.time is None
    state = gated.predict(state, 3.5)
    assert state.time == 3.5


# Where paths have gone


@pytest.mark.parametrize("make", [KalmanFilter, extended_kalman])
def test_a_mean_beyond_the_bound_has_diverged(make):
    """One that is as far as the bound has not."""
    filter = make(LinearSystem(np.eye(2), np.eye(2), np.eye(2), np.eye(2), [0, 0], np.eye(2)),
                  bound=3.0)  # fmt: skip
    state = filter.initial((4,))._replace(
        mean=np.array([[3.0, -3.5, 1.0, 0.0], [2.0, 1.0, -3.0, np.nextafter(3.0, 4.0)]])
    )
    assert filter.report(state).diverged.tolist() == [False, True, False, True]


def test_mean_directions_of_circular_components():
    """The direction of the sum of the unit vectors, whatever turn the numbers are from."""
    x = RNG.standard_normal((3, 5, 2)) + np.array([0.0, 3.9, -7.2])[:, None, None]
    weight = RNG.random((5, 2))
    weight /= weight.sum(axis=0)
    found = _direction(x, weight, ((1, 7.0), (2, 5.0)))
    np.testing.assert_array_equal(found[0], 0.0)
    for k, period in ((1, 7.0), (2, 5.0)):
        turn = np.angle((weight * np.exp(2j * np.pi * x[k] / period)).sum(axis=0))
        np.testing.assert_allclose(found[k], period * turn / (2 * np.pi), rtol=1e-12)


def test_trajectories_of_several_blocks_stand_side_by_side(monkeypatch):
    filter = ParticleFilter(LinearSystem(0.5, 1, 1, 1, 0, 1), 8)
    y = RNG.standard_normal((3, 1, 5))
    whole = draw_trajectories(filter, np.arange(3.0), y, 4, seed=2)
    assert whole.shape == (3, 1, 4, 5)
    monkeypatch.setattr(ParticleFilter, "block", lambda *_: 2)
    parts = draw_trajectories(filter, np.arange(3.0), y, 4, seed=2)
    assert parts.shape == whole.shape
    assert np.isfinite(parts).all()
