"""Weights of branches, which of them are evaluated, and the moments of their mixture."""

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm, truncnorm

from oracles.piecewise_branches import branches
from seedslib.piecewise.branches import Branches
from seedslib.piecewise.clipping import box
from seedslib.piecewise.coefficients import Coefficients
from seedslib.piecewise.geometry import PolygonRegions
from seedslib.piecewise.weights import (
    CellLaw,
    Weighed,
    by_cell,
    cell_probabilities,
    log_peak,
    log_sum,
    mixture,
    prune,
    weigh_branches,
)

INF = np.inf


def on_the_line(log_unit, ends=(-INF, INF), mean=0.0, var=1.0):
    """Branches with given ln U, (B,) or (B, N); on the whole line their mass is one."""
    log_unit = np.reshape(np.asarray(log_unit, dtype=float), (len(log_unit), -1))
    ends = np.broadcast_to(ends, (len(log_unit), 2))
    found = branches(ends, mean * np.ones_like(log_unit), var, 1.0)[0]
    return found._replace(log_unit=log_unit)


def pairs(found):
    return sorted(zip(found.branch.tolist(), found.dataset.tolist(), strict=True))


def test_a_dropped_branch_does_not_make_hopeless_ones_worth_an_integral():
    """Two data sets; the third branch is hopeless in one of them, the second one dropped there."""
    log_unit = [[0.3, -0.2], [-INF, -1.0], [-5000.0, -4.0]]
    found = weigh_branches(on_the_line(log_unit), 1e-30)
    np.testing.assert_allclose(found.log_joint, [[0.3, -0.2], [-INF, -1.0], [-INF, -4.0]])
    assert pairs(found) == [(0, 0), (0, 1), (1, 1), (2, 1)]


def test_without_neglect_all_but_the_dropped_branches_are_evaluated():
    found = weigh_branches(on_the_line([[0.3, -0.2], [-INF, -1.0], [-5000.0, -4.0]]), 0.0)
    assert pairs(found) == [(0, 0), (0, 1), (1, 1), (2, 0), (2, 1)]
    assert found.log_joint[2, 0] == -5000.0


def test_a_data_set_without_branches_has_no_weight():
    found = weigh_branches(on_the_line([[0.0, -INF], [-1.0, -INF]]), 1e-30)
    assert pairs(found) == [(0, 0), (1, 0)]
    assert (found.log_joint[:, 1] == -INF).all()
    np.testing.assert_allclose(log_sum(found.log_joint), [np.log(1 + np.exp(-1)), -INF])
    none = weigh_branches(on_the_line([[-INF], [-INF]]), 1e-30)
    assert (none.mean.shape, none.cov.shape) == ((1, 0), (1, 1, 0))


@pytest.mark.parametrize(("second", "mass"), [(-3.0, 1 + np.exp(-3)), (-3.001, 1.0)])
def test_what_is_left_out_is_a_share_of_the_mass_of_the_best(second, mass):
    """One of three branches holds at most a third of the share; those a factor e^3 off count."""
    floor = np.log(1e-4 / 3 * mass)
    for third, evaluated in ((floor + 1e-9, 3), (floor - 1e-9, 2)):
        found = weigh_branches(on_the_line([0.0, second, third]), 1e-4)
        assert (found.log_joint > -INF).sum() == evaluated
        assert len(found.branch) == evaluated


def test_joint_weights_are_those_of_the_regions():
    ends = [(-1.0, 0.5), (0.5, INF), (-INF, -1.0), (2.0, 2.5)]
    mean, var = np.array([[0.1, 0.7], [0.3, -0.2], [0.0, 0.4], [1.0, 0.0]]), 0.6
    log_unit = np.array([[0.3, -0.2], [1.0, -1.0], [0.0, 0.4], [-2.0, 0.1]])
    found = weigh_branches(on_the_line(log_unit, ends, mean, var), 1e-30)
    mass = np.diff(norm.cdf(np.array(ends)[:, :, None], mean[:, None], var**0.5), axis=1)[:, 0]
    np.testing.assert_allclose(found.log_joint, log_unit + np.log(mass), rtol=1e-12)


@pytest.mark.parametrize("depth", [1, 3])
def test_moments_of_a_branch_in_coordinates_of_an_earlier_time(depth):
    """x1 = shift + slope s with s in an interval; x2 follows s. The law of s by SciPy."""
    rng = np.random.default_rng(0)
    ends, slope, shift = np.array([(-1.0, 0.5), (0.2, 2.0)]), [-0.4, 1.7], [0.3, -1.0]
    mean = rng.standard_normal((2, 2, 3))
    cov = np.array([[0.8, 0.3], [0.3, 0.5]])[:, :, None, None] * rng.uniform(1, 2, (2, depth))
    plain = branches(ends, mean[0], 1.0, 1.0, slope=np.array(slope), shift=np.array(shift))[0]
    found = weigh_branches(plain._replace(mean=mean, cov=cov, log_unit=np.zeros((2, 3))), 1e-30)
    assert len(found.branch) == 6
    for f, (b, n) in enumerate(zip(found.branch, found.dataset, strict=True)):
        m, c = mean[:, b, n], cov[:, :, b, min(n, depth - 1)]
        sd = np.sqrt(c[0, 0])
        law = truncnorm(*((ends[b] - m[0]) / sd), m[0], sd)
        along = c[0, 1] / c[0, 0]
        first = np.array([shift[b] + slope[b] * law.mean(), m[1] + along * (law.mean() - m[0])])
        np.testing.assert_allclose(found.mean[:, f], first, rtol=1e-9, atol=1e-11)
        turn = np.array([slope[b], along])
        second = law.var() * np.outer(turn, turn)
        second[1, 1] += c[1, 1] - along * c[0, 1]
        np.testing.assert_allclose(found.cov[:, :, f], second, rtol=1e-7, atol=1e-10)
        mass = norm.cdf(ends[b], m[0], sd)
        np.testing.assert_allclose(found.log_joint[b, n], np.log(np.diff(mass))[0], rtol=1e-12)


def test_moments_of_plane_branches():
    """Rectangles and independent components, so that SciPy knows the law of s; x3 follows it."""
    rng = np.random.default_rng(2)
    center, half = np.array([[0.3, -1.0], [0.5, 1.5]]), np.array([[0.5, 0.8], [1.0, 0.3]])
    slope, shift = rng.standard_normal((2, 2, 2)), rng.standard_normal((2, 2))
    mean, along = rng.standard_normal((3, 2, 2)), np.array([0.4, -0.7])
    cov = np.diag([0.5, 1.5, 2.0])
    cov[2, :2] = cov[:2, 2] = along * [0.5, 1.5]
    regions = PolygonRegions(tuple(box(center[b], half[b]) for b in range(2)))
    found = weigh_branches(
        Branches(np.array([0, 1]), regions, slope, shift, mean,
                 cov[:, :, None, None] * np.ones((2, 1)), np.array([[0.1, 0.2], [0.3, -0.4]])),
        1e-30,
    )  # fmt: skip
    assert len(found.branch) == 4
    for f, (b, n) in enumerate(zip(found.branch, found.dataset, strict=True)):
        m, sd = mean[:2, b, n], np.sqrt([0.5, 1.5])
        low, high = (center[b] - half[b] - m) / sd, (center[b] + half[b] - m) / sd
        law = truncnorm(low, high, m, sd)
        lead = np.concatenate([slope[:, :, b], along[None]])
        first = np.append(shift[:, b], mean[2, b, n] - along @ m) + lead @ law.mean()
        second = lead @ np.diag(law.var()) @ lead.T
        second[2, 2] += 2.0 - along**2 @ [0.5, 1.5]
        np.testing.assert_allclose(found.mean[:, f], first, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(found.cov[:, :, f], second, rtol=1e-8, atol=1e-10)
        mass = np.log(norm.cdf(high) - norm.cdf(low)).sum()
        unit = np.array([[0.1, 0.2], [0.3, -0.4]])[b, n]
        np.testing.assert_allclose(found.log_joint[b, n], unit + mass, rtol=1e-11)


@pytest.mark.parametrize("moved", [{"slope": np.array([1.0, 2.0])}, {"shift": np.array([0.0, 3])}])
def test_either_a_slope_or_a_shift_moves_a_branch(moved):
    plain = branches([(-1.0, 1.0)] * 2, 0.0, 1.0, [0.5, 0.5], **moved)[0]
    found = weigh_branches(plain, 1e-30)
    inner = truncnorm(-1, 1).var()
    slope, shift = moved.get("slope", np.ones(2)), moved.get("shift", np.zeros(2))
    np.testing.assert_allclose(found.mean[0], shift, atol=1e-15)
    np.testing.assert_allclose(found.cov[0, 0], slope**2 * inner, rtol=1e-12)


def test_the_logarithm_of_a_sum():
    x = np.array([[900.0, -900.0, -INF, -INF, 3.0], [899.0, -INF, -INF, 0.0, -700.0]])
    np.testing.assert_allclose(log_sum(x), logsumexp(x, axis=0), rtol=1e-15)
    assert log_sum(x)[2] == -INF


def drawn_law():
    """Six branches in cells 0, 1 and 3 of five, three data sets; two pairs are left out."""
    rng = np.random.default_rng(3)
    weight = rng.exponential(size=(6, 3))
    weight[2, 1] = weight[4, 0] = 0.0
    weight[[1, 5], 2] = 0.0
    weight /= weight.sum(axis=0)
    branch, dataset = np.nonzero(np.ones((6, 3)))
    turn = rng.permutation(18)
    branch, dataset = branch[turn], dataset[turn]
    root = rng.standard_normal((2, 2, 18))
    mean, cov = rng.standard_normal((2, 18)), np.einsum("ipf,jpf->ijf", root, root)
    nothing = weight[branch, dataset] == 0.0
    mean[:, nothing] = cov[:, :, nothing] = np.nan
    with np.errstate(divide="ignore"):
        weighed = Weighed(np.log(weight), branch, dataset, mean, cov)
    return CellLaw(weighed, weight, np.array([3, 0, 1, 3, 0, 1]))


def by_hand(law, dataset, cell=None):
    """Weight, mean and covariance of one data set from the second moments about the origin."""
    w, total, first, second = law.weighed, 0.0, 0.0, 0.0
    for f in np.flatnonzero(w.dataset == dataset):
        share = law.weight[w.branch[f], dataset]
        if share > 0.0 and cell in (None, law.cell[w.branch[f]]):
            m = w.mean[:, f]
            total, first = total + share, first + share * m
            second = second + share * (w.cov[:, :, f] + np.outer(m, m))
    if total == 0.0:
        return total, np.zeros(2), np.zeros((2, 2))
    return total, first / total, second / total - np.outer(first, first) / total**2


def test_the_moments_of_the_mixture_and_of_every_cell():
    law = drawn_law()
    mean, cov = mixture(law)
    weight, means, covs = by_cell(law, 5)
    shares = cell_probabilities(law, 5)
    assert (weight.shape, means.shape, covs.shape) == ((5, 3), (2, 5, 3), (2, 2, 5, 3))
    for n in range(3):
        _, first, second = by_hand(law, n)
        np.testing.assert_allclose(mean[:, n], first, rtol=1e-13)
        np.testing.assert_allclose(cov[:, :, n], second, rtol=1e-12)
        for i in range(5):
            total, first, second = by_hand(law, n, i)
            np.testing.assert_allclose([weight[i, n], shares[i, n]], total, rtol=1e-14)
            np.testing.assert_allclose(means[:, i, n], first, rtol=1e-13)
            np.testing.assert_allclose(covs[:, :, i, n], second, rtol=1e-11, atol=1e-14)
    assert (weight[[2, 4]] == 0.0).all()
    assert (cov == np.swapaxes(cov, 0, 1)).all()


def test_the_largest_likelihood_is_the_density_of_the_noise_at_zero():
    """In the cell where it is largest, of the components that are present."""
    noise = np.random.default_rng(4).standard_normal((2, 3, 4, 1))
    c = Coefficients(np.ones((2, 4, 1)), np.ones((2, 5, 4, 1)), noise)
    y = np.array([[0.3, np.nan, 7.0, np.nan], [-0.2, 1.0, np.nan, np.nan]])
    wanted = np.full((4, 4), 0.0)
    for i in range(4):
        cov = noise[:, :, i, 0] @ noise[:, :, i, 0].T
        wanted[i, 0] = multivariate_normal([0, 0], cov).logpdf([0, 0])
        wanted[i, 1], wanted[i, 2] = norm(0, np.sqrt(np.diag(cov)[::-1])).logpdf(0)
    np.testing.assert_allclose(log_peak(c, y), wanted.max(axis=0), rtol=1e-12)
    deep = c._replace(noise=noise * np.array([1.0, 2.0, 3.0, 4.0]))
    scaled = wanted.max(axis=0) - np.log([1.0, 2.0, 3.0, 1.0]) * [2, 1, 1, 0]
    np.testing.assert_allclose(log_peak(deep, y), scaled, rtol=1e-12)


def test_of_equal_weights_the_first_are_dropped_and_a_share_may_be_used_up():
    weight = np.array([[0.25, 0.5], [0.25, 0.125], [0.25, 0.25], [0.25, 0.125]])
    dropped, lost = prune(weight, 0.5, None)
    assert dropped.T.tolist() == [[True, True, False, False], [False, True, True, True]]
    assert lost.tolist() == [0.5, 0.5]
    dropped, lost = prune(weight, 0.0, 3)
    assert dropped.T.tolist() == [[True, False, False, False], [False, True, False, False]]
    assert lost.tolist() == [0.25, 0.125]
    for keep in (4, 9):
        assert not prune(weight, 0.0, keep)[0].any()
    assert prune(weight, 0.0, 1)[0].sum() == 6


def test_weights_that_differ_by_rounding_are_dropped_in_the_order_of_the_branches():
    weight = np.array([[0.2 + 1e-15], [0.2], [0.4], [0.2 - 1e-15]])
    assert prune(weight, 0.3, None)[0][:, 0].tolist() == [True, False, False, False]
