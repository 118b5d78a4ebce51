"""The causal Wiener filter against the Riccati equation."""

import mpmath
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from seedslib.riemann import wiener_gain


def riccati(a, c, w, r):
    """Steady Kalman filter of the stack: F, H, gain, innovation variance, error covariance."""
    last, n = len(a) - 1, a.shape[1]
    size = (last + 1) * n
    f, h, q = np.eye(size, k=-n), np.zeros((1, size)), np.zeros((size, size))
    f[:n], h[0, :n], q[:n, :n] = np.concatenate(a, axis=1), c, w
    p = solve_discrete_are(f.T, h.T, q, [[r]])
    s = (h @ p @ h.T).item() + r
    k = p @ h.T / s
    return f, h, k, s, p - s * k @ k.T


def delayed(last):
    a = np.zeros((last + 1, 2, 2))
    a[0] = 0.6 * np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    a[last] += np.array([[0.1, 0.3], [-0.2, 0.1]])
    return a


@pytest.mark.parametrize(
    ("last", "lags", "nodes"),
    [(0, 0, None), (0, 6, 512), (1, None, 1023), (3, 5, None), (10, 10, 4096)],
)
def test_gains_and_impulse_are_those_of_the_stationary_kalman_filter(last, lags, nodes):
    """Of the fixed-lag smoothers as well, by a stack that reaches as far."""
    reach = last if lags is None else max(lags, last)
    a = np.concatenate([delayed(last), np.zeros((reach - last, 2, 2))])
    c, w, r = np.array([1.0, 0.3]), np.array([[0.2, 0.1], [0.1, 1.0]]), 0.5
    f, h, k, s, cov = riccati(a, c, w, r)
    found = wiener_gain(a if lags else delayed(last), c, w, r, nodes=nodes)
    np.testing.assert_allclose(
        found.lag_gains, k.reshape(-1, 2)[: len(found.lag_gains)], atol=1e-13
    )
    np.testing.assert_array_equal(found.gain, found.lag_gains[0])
    np.testing.assert_allclose(found.cov, cov[:2, :2], atol=1e-13)
    assert found.innovation == pytest.approx(s, abs=1e-13)
    assert found.impulse.shape == (found.nodes // 2, 2)
    assert found.nodes == (nodes or found.nodes)
    state, closed = k[:, 0], (np.eye(len(f)) - k @ h) @ f
    for j in range(40):
        np.testing.assert_allclose(found.impulse[j], state[:2], atol=1e-13)
        state = closed @ state
    np.testing.assert_allclose(found.impulse[-20:], 0.0, atol=1e-13)


@pytest.mark.parametrize("seed", range(6))
def test_random_systems_are_filtered_or_refused_for_their_unstable_roots(seed):
    rng = np.random.default_rng(seed)
    n, last = int(rng.integers(1, 4)), int(rng.integers(0, 5))
    a = rng.standard_normal((last + 1, n, n)) * rng.uniform(0.1, 0.6)
    c = rng.standard_normal(n)
    f, _, k, _, cov = riccati(a, c, np.eye(n), 1.0)
    if np.abs(np.linalg.eigvals(f)).max() > 1:
        with pytest.raises(ValueError, match=r"^transition"):
            wiener_gain(a, c, np.eye(n), 1.0)
    else:
        found = wiener_gain(a, c, np.eye(n), 1.0)
        np.testing.assert_allclose(found.lag_gains, k.reshape(-1, n), atol=1e-11)
        np.testing.assert_allclose(found.cov, cov[:n, :n], atol=1e-11)


@pytest.mark.parametrize("noise", [1e-12, 1.0])
def test_a_slow_autoregression_keeps_the_digits_of_a_small_error(noise):
    found = wiener_gain([[0.999]], [[1.0]], [[1.0]], [[noise]])
    with mpmath.workdps(40):
        r = mpmath.mpf(noise)
        half = (1 - r + mpmath.mpf(0.999) ** 2 * r) / 2
        predicted = half + mpmath.sqrt(half**2 + r)
        exact = float(predicted * r / (predicted + r))
    assert found.cov[0, 0] == pytest.approx(exact, rel=1e-11)
    still = wiener_gain([[0.5]], [1.0], [[0.0]], 1.0)
    np.testing.assert_allclose([still.gain[0], still.cov[0, 0]], 0.0, atol=1e-15)


def test_nodes_are_doubled_until_the_spectra_are_resolved():
    dist = {"sensor": [1.0], "state_noise": [[1.0]], "sensor_noise": 1.0}
    assert wiener_gain([[0.8]], **dist).nodes == 512
    coarse = wiener_gain([[0.8]], **dist, nodes=256)
    assert coarse.tail == pytest.approx(0.8**120, rel=0.01, abs=0.0)
    longer = np.zeros((41, 1, 1))
    longer[0] = 0.1
    assert wiener_gain(longer[:20], **dist, nodes=80).nodes == 80
    assert wiener_gain(longer, **dist).nodes == 1024
