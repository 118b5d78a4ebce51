"""Linear constraints against minimisation, elimination of components, and small noise."""

import numpy as np
import pytest
from scipy.linalg import null_space

from seedslib.filters import KalmanFilter, constrain
from seedslib.models import LinearSystem

rng = np.random.default_rng(4)
ROOT = rng.normal(size=(4, 4))
P, M = ROOT @ ROOT.T, rng.normal(size=4)
D, VALUES = rng.normal(size=(2, 4)), np.array([1.5, -0.7])
SINGULAR = ROOT[:, :3] @ ROOT[:, :3].T
close = np.testing.assert_allclose


def in_null_space(mean, cov, D, d):
    """With a solution x0 of D x = d, x = x0 + N z: least squares for z, and their covariance."""
    x0, N = np.linalg.lstsq(D, d)[0], null_space(D)
    weight = np.linalg.inv(cov)
    spread = np.linalg.inv(N.T @ weight @ N)
    return x0 + N @ spread @ N.T @ weight @ (mean - x0), N @ spread @ N.T


def test_the_mean_is_the_nearest_state_that_satisfies_the_equations():
    """The optimality conditions: the gradient 2 P⁻¹ (x - m) is a combination of the rows of D."""
    weight = np.linalg.inv(P)
    conditions = np.block([[weight, D.T], [D, np.zeros((2, 2))]])
    inverse = np.linalg.inv(conditions)
    mean, cov = constrain(M, P, D, VALUES)
    close(mean, (inverse @ np.concatenate([weight @ M, VALUES]))[:4], rtol=1e-10)
    close(cov, inverse[:4, :4], atol=1e-12)


def test_states_that_satisfy_the_equations_as_a_family():
    mean, cov = constrain(M, P, D, VALUES)
    wanted = in_null_space(M, P, D, VALUES)
    close(mean, wanted[0], rtol=1e-10)
    close(cov, wanted[1], atol=1e-12)
    close(D @ mean, VALUES, rtol=1e-12)
    close(D @ cov, 0.0, atol=1e-12)


def test_redundant_rows_and_what_is_known_change_nothing():
    wanted = constrain(M, P, D, VALUES)
    rows, values = np.vstack([D, D[0] - 2 * D[1]]), [*VALUES, VALUES @ [1, -2]]
    again = constrain(*wanted, D[::-1], VALUES[::-1])
    for found in (constrain(M, P, rows, values), again, constrain(*wanted, rows, values)):
        for part, exact in zip(found, wanted, strict=True):
            close(part, exact, atol=1e-12)
    assert np.linalg.eigvalsh(wanted[1])[0] > -1e-14


def test_a_singular_covariance_is_that_of_its_free_components():
    """x = m + R z with z ~ N(0, I) of three components, which D R z = d - D m constrains."""
    R = ROOT[:, :3]
    z, spread = in_null_space(np.zeros(3), np.eye(3), D @ R, VALUES - D @ M)
    mean, cov = constrain(M, SINGULAR, D, VALUES)
    close(mean, M + R @ z, rtol=1e-9)
    close(cov, R @ spread @ R.T, atol=1e-11)
    # all of the state follows from three equations
    mean, cov = constrain(M, SINGULAR, np.eye(4)[:3], (M + R @ [1, 2, 3])[:3])
    close(mean, M + R @ [1, 2, 3], rtol=1e-8)
    close(cov, 0.0, atol=1e-12)


def test_a_measurement_whose_noise_vanishes_says_the_same():
    """The difference falls as the variance of the noise."""
    exact, gaps = constrain(M, P, D, VALUES), []
    for variance in (1e-2, 1e-4, 1e-6):
        gain = P @ D.T @ np.linalg.inv(D @ P @ D.T + variance * np.eye(2))
        near = M + gain @ (VALUES - D @ M), P - gain @ D @ P
        gaps.append([np.abs(a - b).max() for a, b in zip(near, exact, strict=True)])
    ratios = np.divide(gaps[:-1], gaps[1:])
    assert (ratios[0] > 50).all()
    close(ratios[1], 100, rtol=0.05)


def test_what_is_constrained_is_known_afterwards():
    """Rounding leaves no variance, of either sign, that a later step would take for one."""
    root = rng.normal(size=(4, 4, 200))
    covs = np.einsum("ijN,kjN->ikN", root, root)
    for rows in (np.eye(4)[1:3], np.eye(4)[:2] @ [[1, 1, 0, 0], [0, 2, 0, 1], [0] * 4, [0] * 4]):
        mean, cov = constrain(np.zeros((4, 200)), covs, rows, [1.0, 2.0])
        assert (np.diagonal(cov) >= 0).all()
        again = constrain(mean, cov, rows, [1.0, 2.0])
        close(again[0], mean, atol=1e-9)
        close(again[1], cov, atol=1e-12)
        with pytest.raises(ValueError, match=r"^d\b"):
            constrain(mean, cov, rows, [1.0, 2.1])
    cov = constrain(np.zeros((4, 200)), covs, np.eye(4)[1:3], [1.0, 2.0])[1]
    assert not cov[1:3].any()


def test_a_wide_prior_is_constrained_to_a_narrow_one():
    """Of equal components the narrow one says what both are."""
    mean, cov = constrain([1e6, 2.0], np.diag([1e14, 1.0]), [[1, -1]], [0.0])
    close(mean, [2.0, 2.0], rtol=1e-6)
    close(cov, np.ones((2, 2)), rtol=1e-6)


@pytest.mark.parametrize("own_rows", [False, True])
@pytest.mark.parametrize("own_cov", [False, True])
def test_runs_are_constrained_one_by_one(own_rows, own_cov):
    runs = (3, 2)
    means, values = rng.normal(size=(4, *runs)), rng.normal(size=(2, *runs))
    scales = np.exp(rng.normal(size=runs))
    covs = P[..., None, None] * scales if own_cov else P
    rows = rng.normal(size=(2, 4, *runs)) if own_rows else D
    mean, cov = constrain(means, covs, rows, values)
    assert cov.shape == ((4, 4, *runs) if own_rows or own_cov else (4, 4))
    for run in np.ndindex(runs):
        where = (..., *run)
        own = covs[where] if own_cov else P, rows[where] if own_rows else D
        wanted = in_null_space(means[where], *own, values[where])
        close(mean[where], wanted[0], rtol=1e-9)
        close(cov[where] if cov.ndim > 2 else cov, wanted[1], atol=1e-11)
    common = constrain(M, P, D, values)
    close(common[0][..., 2, 1], constrain(M, P, D, values[..., 2, 1])[0], rtol=1e-12)
    assert common[0].shape == (4, *runs)
    assert common[1].shape == (4, 4)


def test_the_estimates_of_a_whole_run():
    """Each time of each record by itself; a filter goes on from the constrained state."""
    system = LinearSystem(0.9 * np.eye(4), P, np.eye(4)[:2], np.eye(2), M, P)
    filter, times, y = KalmanFilter(system), np.arange(3.0), rng.normal(size=(3, 2, 5))
    run = filter.run(times, y)
    mean, cov = constrain(np.moveaxis(run.mean, 0, -1), np.moveaxis(run.cov, 0, -1), D, VALUES)
    for k in range(3):
        wanted = constrain(run.mean[k], run.cov[k], D, VALUES)
        close(mean[..., k], wanted[0], atol=1e-12)
        close(cov[..., 0, k], wanted[1], atol=1e-12)  # common to all records
    state = filter.step(filter.initial((5,)), 0.0, y[0])
    before = dict(zip(("mean", "cov"), constrain(state.mean, state.cov, D, VALUES), strict=True))
    later = filter.predict(state._replace(**before), 1.0)
    close(later.mean, 0.9 * before["mean"], rtol=1e-12)
    close(later.cov, 0.81 * before["cov"] + P, rtol=1e-12)


def test_units_of_components_do_not_matter():
    unit = np.array([1e-9, 1.0, 1e6, 1e-3])
    mean, cov = constrain(M, P, D, VALUES)
    scaled = constrain(unit * M, np.outer(unit, unit) * P, D / unit, VALUES)
    close(scaled[0] / unit, mean, rtol=1e-9)
    close(scaled[1] / np.outer(unit, unit), cov, atol=1e-11)


KNOWN = constrain(M, P, D, VALUES)
INFINITE = np.diag([np.inf, 1, 1, 1])
ROWS = [
    (lambda: constrain(M, P, [D[0], 2 * D[0]], [1, 3]), ValueError, "d"),
    (lambda: constrain(*KNOWN, D, VALUES + 1e-3), ValueError, "d"),
    (lambda: constrain(*KNOWN, D[0] + D[1], VALUES.sum()), ValueError, "D"),
    (lambda: constrain(*KNOWN, [D[0] + D[1]], [VALUES.sum() + 0.1]), ValueError, "d"),
    (lambda: constrain(M, SINGULAR, null_space(SINGULAR).T, [99.0]), ValueError, "d"),
    (lambda: constrain(M, P, np.zeros((1, 4)), [1.0]), ValueError, "d"),
    (lambda: constrain([M, M], P, D, VALUES), ValueError, "cov"),
    (lambda: constrain([np.nan, 0, 0, 0], P, D, VALUES), ValueError, "mean"),
    (lambda: constrain(M, INFINITE, D, VALUES), ValueError, "cov"),
    (lambda: constrain(M, -P, D, VALUES), ValueError, "cov"),
    (lambda: constrain(M, P, D * np.nan, VALUES), ValueError, "D"),
    (lambda: constrain(M, P, D[:, :3], VALUES), ValueError, "D"),
    (lambda: constrain(M, P, D, [1.0]), ValueError, "d"),
    (lambda: constrain(M, P, D, [1.0, np.nan]), ValueError, "d"),
    (lambda: constrain(M, P, D, "ab"), TypeError, "d"),
    (lambda: constrain(np.ones((4, 3)), P, D, np.ones((2, 2))), ValueError, "mean"),
]


@pytest.mark.parametrize(("call", "error", "name"), ROWS)
def test_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=rf"^{name}\b"):
        call()


def test_a_contradiction_in_one_of_many_runs_is_found():
    values = np.repeat(VALUES[:, None], 3, axis=1)
    constrain(*KNOWN, D, values)
    values[1, 2] += 1e-3
    with pytest.raises(ValueError, match=r"^d\b"):
        constrain(*KNOWN, D, values)
