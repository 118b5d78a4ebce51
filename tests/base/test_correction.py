import numpy as np
import pytest
import sympy
from scipy.stats import multivariate_normal

from seedslib.base import correct
from seedslib.base.semidefinite import factor
from seedslib.linearization import Moments


def joint_cases(n, m, count, rank=None, seed=0):
    """Random predictions whose joint covariance of (x, y) is positive semidefinite."""
    rng = np.random.default_rng([seed, n, m, count])
    roots = rng.standard_normal((count, n + m, n + m))
    if rank is not None:
        roots[:, n:] = rng.standard_normal((count, m, rank)) @ rng.standard_normal(
            (count, rank, n + m)
        )
    joint = np.moveaxis(roots @ np.swapaxes(roots, 1, 2), 0, -1)
    mean, y, predicted = (rng.standard_normal((k, count)) for k in (n, m, m))
    return mean, joint[:n, :n], y, Moments(predicted, joint[:n, n:], joint[n:, n:])


def item(case, i):
    mean, cov, y, moments = case
    return mean[:, i], cov[..., i], y[:, i], Moments(*(part[..., i] for part in moments))


def oracle(mean, cov, y, moments):
    """The textbook formulas with an explicit pseudo-inverse."""
    predicted, cross, spread = moments
    inverse = np.linalg.pinv(spread, rcond=1e-11, hermitian=True)
    e = y - predicted
    loglik = multivariate_normal(predicted, spread, allow_singular=True).logpdf(y)
    return mean + cross @ inverse @ e, cov - cross @ inverse @ cross.T, loglik


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 2), (3, 1), (4, 3), (8, 3), (2, 5)])
def test_agrees_with_matrix_formulas(n, m):
    case = joint_cases(n, m, 7)
    mean, cov, loglik = correct(*case)
    for i in range(7):
        for got, want in zip(
            (mean[:, i], cov[..., i], loglik[i]), oracle(*item(case, i)), strict=True
        ):
            np.testing.assert_allclose(got, want, rtol=1e-8, atol=1e-9)


def test_one_item_equals_the_same_item_of_a_batch():
    case = joint_cases(3, 2, 5)
    whole = correct(*case)
    for i in range(5):
        for got, want in zip(correct(*item(case, i)), whole, strict=True):
            np.testing.assert_allclose(got, want[..., i], rtol=1e-13, atol=1e-14)


def test_two_batch_axes_and_broadcasting():
    mean, cov, y, moments = joint_cases(2, 2, 12)
    fold = [a.reshape(*a.shape[:-1], 3, 4) for a in (mean, cov, y, *moments)]
    got = correct(fold[0], fold[1], fold[2], fold[3:])
    for part, flat in zip(got, correct(mean, cov, y, moments), strict=True):
        np.testing.assert_array_equal(part.reshape(flat.shape), flat)
    # one measurement for all items, one covariance for all items
    common = Moments(moments.mean, moments.cross[..., 0], moments.cov[..., 0])
    mean1, cov1, loglik1 = correct(mean, cov[..., 0], y[:, 0], common)
    assert mean1.shape == (2, 12)
    assert cov1.shape == (2, 2)
    assert loglik1.shape == (12,)
    np.testing.assert_allclose(
        mean1[:, 3],
        correct(mean[:, 3], cov[..., 0], y[:, 0], Moments(moments.mean[:, 3], *common[1:]))[0],
        rtol=1e-13,
    )


def test_covariance_alone_may_carry_the_batch():
    mean, cov, y, moments = joint_cases(2, 1, 4)
    one = Moments(*(part[..., 0] for part in moments))
    new_mean, new_cov, loglik = correct(mean[:, 0], cov, y[:, 0], one)
    assert new_mean.shape == (2,)
    assert new_cov.shape == (2, 2, 4)
    assert loglik.shape == ()
    np.testing.assert_allclose(
        new_cov[..., 2], correct(mean[:, 0], cov[..., 2], y[:, 0], one)[1], rtol=1e-13
    )


def test_inputs_are_left_alone():
    case = joint_cases(2, 2, 3)
    copies = [np.copy(a) for a in (case[0], case[1], case[2], *case[3])]
    correct(*case)
    for before, after in zip(copies, (case[0], case[1], case[2], *case[3]), strict=True):
        np.testing.assert_array_equal(before, after)


def test_missing_components_are_left_out_exactly():
    mean, cov, y, moments = joint_cases(3, 3, 8)
    rng = np.random.default_rng(5)
    y = np.where(rng.random(y.shape) < 0.4, np.nan, y)
    y[:, 2] = np.nan
    y[:, 3] = 1.0
    got = correct(mean, cov, y, moments)
    for i in range(8):
        kept = np.isfinite(y[:, i])
        one_mean, one_cov, one_y, one = item((mean, cov, y, moments), i)
        if kept.any():
            part = Moments(one.mean[kept], one.cross[:, kept], one.cov[np.ix_(kept, kept)])
            want = correct(one_mean, one_cov, one_y[kept], part)
        else:
            want = (one_mean, one_cov, 0.0)
        for a, b in zip((got[0][:, i], got[1][..., i], got[2][i]), want, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


def test_component_missing_everywhere_keeps_a_common_covariance_common():
    mean, cov, y, moments = joint_cases(3, 2, 6)
    common = Moments(moments.mean, moments.cross[..., 0], moments.cov[..., 0])
    y[1] = np.nan
    _, new_cov, _ = correct(mean, cov[..., 0], y, common)
    assert new_cov.shape == (3, 3)
    y[0, 2] = np.nan
    _, new_cov, _ = correct(mean, cov[..., 0], y, common)
    assert new_cov.shape == (3, 3, 6)
    np.testing.assert_array_equal(new_cov[..., 2], cov[..., 0])


def test_nothing_measured_changes_nothing():
    mean, cov, y, moments = item(joint_cases(2, 2, 1), 0)
    got = correct(mean, cov, y * np.nan, moments)
    np.testing.assert_array_equal(got[0], mean)
    np.testing.assert_array_equal(got[1], cov)
    assert got[2] == 0


def test_leading_rows_and_mean_alone():
    mean, cov, y, moments = joint_cases(4, 2, 5)
    whole = correct(mean, cov, y, moments)
    part = correct(mean, cov, y, moments, rows=2)
    np.testing.assert_array_equal(part[0], whole[0][:2])
    np.testing.assert_array_equal(part[1], whole[1][:2, :2])
    np.testing.assert_array_equal(part[2], whole[2])
    alone = correct(mean, None, y, moments, rows=2)
    assert alone[1] is None
    np.testing.assert_array_equal(alone[0], part[0])


@pytest.mark.parametrize(("m", "rank"), [(2, 1), (3, 2), (4, 2), (2, 0)])
def test_singular_innovation_gets_the_pseudo_inverse(m, rank):
    case = joint_cases(2, m, 6, rank=rank)
    got = correct(*case)
    for i in range(6):
        mean, cov, _ = oracle(*item(case, i)) if rank else (*item(case, i)[:2], 0.0)
        np.testing.assert_allclose(got[0][:, i], mean, rtol=1e-7, atol=1e-8)
        np.testing.assert_allclose(got[1][..., i], cov, rtol=1e-7, atol=1e-8)
        if rank == 0:
            assert got[2][i] == 0
    if rank:
        # the likelihood is the density on the range: compare where y lies in it
        mean, cov, _, moments = item(case, 0)
        y = moments.mean + moments.cov @ np.ones(m)
        got = correct(mean, cov, y, moments)[2]
        values, vectors = np.linalg.eigh(moments.cov)
        values, vectors = values[-rank:], vectors[:, -rank:]
        z = vectors.T @ (y - moments.mean)
        want = -0.5 * (z**2 / values + np.log(2 * np.pi * values)).sum()
        np.testing.assert_allclose(got, want, rtol=1e-8)


def test_singular_items_do_not_disturb_regular_ones():
    regular, singular = joint_cases(2, 2, 4), joint_cases(2, 2, 4, rank=1)
    mixed = [
        np.concatenate([a, b], -1)
        for a, b in zip((*regular[:3], *regular[3]), (*singular[:3], *singular[3]), strict=True)
    ]
    got = correct(*mixed[:3], mixed[3:])
    for part, alone in zip(got, correct(*regular), strict=True):
        np.testing.assert_array_equal(part[..., :4], alone)


def test_singular_with_a_missing_component():
    mean, cov, y, moments = item(joint_cases(2, 3, 1, rank=1), 0)
    y[1] = np.nan
    kept = [0, 2]
    part = Moments(moments.mean[kept], moments.cross[:, kept], moments.cov[np.ix_(kept, kept)])
    batch = [np.stack([a, a], -1) for a in (mean, cov, y, *moments)]
    batch[2][1, 1] = 0.3  # not missing in the other item
    got = correct(*batch[:3], batch[3:])
    want = correct(mean, cov, y[kept], part)
    for a, b in zip(got, want, strict=True):
        np.testing.assert_allclose(a[..., 0], b, rtol=1e-8, atol=1e-10)


def test_badly_scaled_sensors_are_not_taken_for_singular():
    scale = np.array([1.0, 1e-12])
    mean, cov, y, moments = item(joint_cases(2, 2, 1), 0)
    scaled = Moments(
        moments.mean * scale, moments.cross * scale, moments.cov * np.outer(scale, scale)
    )
    plain, tiny = correct(mean, cov, y, moments), correct(mean, cov, y * scale, scaled)
    np.testing.assert_allclose(plain[0], tiny[0], rtol=1e-9)
    np.testing.assert_allclose(plain[1], tiny[1], rtol=1e-9, atol=1e-12)
    # with a copy of the tiny one beside it the rank is found in spite of the scale
    pick = [0, 1, 1]
    twice = Moments(scaled.mean[pick], scaled.cross[:, pick], scaled.cov[np.ix_(pick, pick)])
    again = correct(mean, cov, (y * scale)[pick], twice)
    np.testing.assert_allclose(again[0], tiny[0], rtol=1e-8)
    np.testing.assert_allclose(again[1], tiny[1], rtol=1e-7, atol=1e-10)


def test_indefinite_or_undefined_items_are_nan_and_stay_alone():
    mean, cov, y, moments = joint_cases(2, 2, 3)
    moments.cov[..., 1] = [[1.0, 2.0], [2.0, 1.0]]
    moments.mean[:, 2] = np.nan
    got = correct(mean, cov, y, moments)
    assert np.isnan(got[0][:, 1]).all()
    assert np.isnan(got[1][..., 1]).all()
    assert np.isnan(got[2][1:]).all()
    assert np.isfinite(got[0][:, 0]).all()
    moments.cov[0, 0, 1] = np.nan
    assert np.isnan(correct(mean, cov, y, moments)[2][1])


def test_precise_sensor_leaves_a_positive_variance():
    """Scalar closed form 1 / (1 / P + 1 / R) down to R = 1e-10 P."""
    for ratio in 10.0 ** -np.arange(0, 11, 2.0):
        moments = Moments(np.zeros(1), np.ones((1, 1)), np.array([[1.0 + ratio]]))
        _, cov, _ = correct(np.zeros(1), np.ones((1, 1)), np.zeros(1), moments)
        np.testing.assert_allclose(cov[0, 0], ratio / (1 + ratio), rtol=4e-16 / ratio + 1e-15)


def test_symbols_go_through_the_same_lines():
    n, m = 2, 2
    names = sympy.symbols("m1 m2 p11 p12 p22 h1 h2 y1 y2 c11 c12 c21 c22 s11 s12 s22")
    m1, m2, p11, p12, p22, h1, h2, y1, y2, c11, c12, c21, c22, s11, s12, s22 = names
    cov, cross, spread = (
        [[p11, p12], [p12, p22]],
        [[c11, c12], [c21, c22]],
        [[s11, s12], [s12, s22]],
    )
    mean, new_cov, loglik = correct([m1, m2], cov, [y1, y2], Moments([h1, h2], cross, spread))
    C, S, e = sympy.Matrix(cross), sympy.Matrix(spread), sympy.Matrix([y1 - h1, y2 - h2])
    want = sympy.Matrix([m1, m2]) + C * S.inv() * e
    assert all(sympy.simplify(a - b) == 0 for a, b in zip(mean, want, strict=True))
    difference = sympy.Matrix(new_cov.tolist()) - (sympy.Matrix(cov) - C * S.inv() * C.T)
    assert difference.applyfunc(sympy.simplify).is_zero_matrix
    case = item(joint_cases(n, m, 1), 0)
    values = [
        *case[0], *case[1][np.tril_indices(2)], *case[3].mean, *case[2], *case[3].cross.ravel(),
        *case[3].cov[np.tril_indices(2)],
    ]  # fmt: skip
    np.testing.assert_allclose(
        float(loglik.subs(dict(zip(names, values, strict=True)))), correct(*case)[2], rtol=1e-12
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"y": [0.0, np.inf]}, "y: wanted finite numbers or NaN, got inf at index \\(1,\\)"),
        ({"y": [0.0]}, "y: wanted shape \\(2, \\*batch\\), got \\(1,\\)"),
        ({"cov": np.eye(3)}, "cov: wanted shape \\(2, 2, \\*batch\\), got \\(3, 3\\)"),
        ({"rows": 3}, "rows: wanted a whole number from 1 to 2, got 3"),
        ({"rows": 0}, "rows: wanted"),
        ({"mean": 1.0}, "mean: wanted shape"),
        ({"moments": Moments(np.zeros(2), np.zeros((2, 3)), np.eye(2))}, "moments.cross"),
        ({"moments": Moments(np.zeros(2), np.zeros((2, 2)), np.eye(3))}, "moments.cov"),
    ],
)
def test_bad_arguments_are_named(change, message):
    given = {
        "mean": np.zeros(2), "cov": np.eye(2), "y": np.zeros(2),
        "moments": Moments(np.zeros(2), np.eye(2), 2 * np.eye(2)),
    }  # fmt: skip
    with pytest.raises(ValueError, match=message):
        correct(**(given | change))


def test_not_numbers_are_refused():
    with pytest.raises(TypeError, match="mean: wanted real numbers, got an array of dtype complex"):
        correct([1j], [[1.0]], [0.0], ([0.0], [[1.0]], [[2.0]]))


def test_factor_of_semidefinite_batches():
    rng = np.random.default_rng(3)
    root = rng.standard_normal((5, 3, 3))
    root[1, :, 2] = 0  # rank two
    root[2] = 0
    cov = np.moveaxis(root @ np.swapaxes(root, 1, 2), 0, -1)
    cov[:, :, 3] = np.diag([1.0, -1.0, 1.0])
    lower = factor(cov)
    back = np.einsum("ik...,jk...->ij...", lower, lower)
    np.testing.assert_allclose(back[..., [0, 1, 2, 4]], cov[..., [0, 1, 2, 4]], atol=1e-12)
    assert np.isnan(lower[..., 3]).any()
    assert (lower[np.triu_indices(3, 1)] == 0).all()
    np.testing.assert_allclose(factor(cov[..., 0]), np.linalg.cholesky(cov[..., 0]), rtol=1e-12)
