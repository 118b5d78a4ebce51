"""Numbers behind the means of terms: tilted laws, masses of half-spaces, values of terms."""

import mpmath as mp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import erfcx, ndtr

from seedslib.gaussian.means.kernels import (
    Group,
    HalfSpace,
    group_mean,
    group_value,
    half_space_means,
    indicator,
    inner_product,
    tilted,
    times,
)

MEAN = np.array([0.4, -0.7, 1.1])
ROOT = np.array([[1.0, 0.0, 0.0], [-0.4, 0.7, 0.0], [0.3, 0.5, 0.6]])
COV = ROOT @ ROOT.T
LINEAR = np.array([0.3, -0.2, 0.5])
BEND = np.array([[0.8, 0.3, 0.0], [0.3, -0.2, 0.1], [0.0, 0.1, 0.5]])
WAVE = np.array([[0.5, 1.4, 0.2], [1.4, -0.9, 0.0], [0.2, 0.0, 2.0]])
MEANS = np.stack([MEAN, -2.0 * MEAN], axis=1)
COVS = np.stack([COV, 0.3 * COV], axis=-1)


def by_precisions(bend, linear, mean, cov):
    """Mean, covariance and log-mass by the sum of the precisions, all in complex numbers."""
    new_cov = np.linalg.inv(np.linalg.inv(cov) + bend)
    pull = np.linalg.solve(cov, mean) + linear
    mass = pull @ new_cov @ pull / 2 - mean @ np.linalg.solve(cov, mean) / 2
    turns = np.log(np.linalg.eigvals(np.eye(len(mean)) + cov @ bend).astype(complex)).sum()
    return new_cov @ pull, new_cov, mass - turns / 2


@pytest.mark.parametrize("bend", [BEND, 1j * WAVE, BEND + 1j * WAVE], ids=["real", "wave", "both"])
@pytest.mark.parametrize("linear", [LINEAR, None, LINEAR - 1j * LINEAR[::-1]])
def test_a_tilted_law(bend, linear):
    """One law, laws of one covariance, and laws with a covariance each."""
    pull = np.zeros(3) if linear is None else linear
    for covs in (COV, COVS):
        found = tilted(bend, linear, MEANS, covs)
        for k in range(2):
            cov = covs if covs.ndim == 2 else covs[..., k]
            wanted = by_precisions(bend, pull, MEANS[:, k], cov)
            alone = tilted(bend, linear, MEANS[:, k], cov)
            for part, one, exact in zip(found, alone, wanted, strict=True):
                assert_allclose(one, exact, rtol=1e-13, atol=1e-13)
                shared = covs.ndim == 2 and part.ndim == 2 and part.shape == (3, 3)
                assert_allclose(part if shared else part[..., k], exact, rtol=1e-13, atol=1e-13)
    assert np.iscomplexobj(tilted(bend, linear, MEAN, COV)[2]) == np.iscomplexobj(bend + pull)


def test_a_tilt_of_some_coordinates_alone():
    """The others follow through the covariance; without spread the tilt is a factor."""
    bend = np.zeros((3, 3))
    bend[1, 1] = 0.8
    mean, cov, mass = tilted(bend, None, MEAN, COV)
    wanted = by_precisions(bend, np.zeros(3), MEAN, COV)
    for part, exact in zip((mean, cov, mass), wanted, strict=True):
        assert_allclose(part, exact, rtol=1e-13)
    mean, cov, mass = tilted(BEND, LINEAR, MEAN, np.zeros((3, 3)))
    assert_allclose(mean, MEAN, rtol=1e-15)
    assert not cov.any()
    assert mass == pytest.approx(LINEAR @ MEAN - MEAN @ BEND @ MEAN / 2, rel=1e-14)


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_the_phase_of_a_determinant_is_that_of_its_eigenvalues(n):
    """det(1 + ik)^(-1/2) in n dimensions: its phase -n atan(k) / 2 goes on beyond pi."""
    for k in (0.2, 1.0, 50.0, -50.0):
        mass = tilted(1j * k * np.eye(n), None, np.zeros(n), np.eye(n))[2]
        assert mass == pytest.approx(-0.5 * n * np.log(1 + 1j * k), rel=1e-13)
    k = np.array([0.2, 1.0, 50.0])
    mass = tilted(1j * np.eye(n), None, np.zeros((n, 1)), np.eye(n)[..., None] * k)[2]
    assert_allclose(mass, -0.5 * n * np.log(1 + 1j * k), rtol=1e-13)


def test_an_infinite_mass_is_refused():
    for size, told in [(1.0, "0"), (1.5, "-0.5")]:
        with pytest.raises(
            ValueError, match=rf"the mean of the exponential.*I \+ P M, got {told}$"
        ):
            tilted(-size * np.eye(1), None, np.zeros(1), np.eye(1))
    assert tilted(-0.75 * np.eye(1), None, np.zeros(1), np.eye(1))[2] == pytest.approx(np.log(2.0))
    with pytest.raises(ValueError, match=r"got -1$"):  # of several laws the worst is told
        tilted(-np.eye(1), None, np.zeros((1, 3)), np.array([[[0.5, 2.0, 1.5]]]))
    # waves do not make it finite: the eigenvalues with them have positive real parts
    wave = np.array([[-1.5, 10j], [10j, 3.0]])
    with pytest.raises(ValueError, match=r"got -0.5$"):
        tilted(wave, None, np.zeros(2), np.eye(2))


@pytest.mark.parametrize("blur", [0.0, 0.5, 2.0])
def test_means_over_a_half_space(blur):
    """q, E x 1, E x² 1 of one variable and a boundary with a deviation of its own."""
    mean, var = np.array([[0.4, -1.0, 3.0]]), 0.7
    plane = HalfSpace(np.array([2.0]), -0.3, 0.5, blur)
    means, log_scale = half_space_means(((2,), (1,)), plane, mean, np.array([[var]]))
    deviation = np.sqrt(4 * var + blur**2)
    z = (2 * mean[0] - 0.3) / deviation
    bell = np.exp(-z * z / 2) / np.sqrt(2 * np.pi)
    lean = 2 * var / deviation
    first = mean[0] * ndtr(z) + lean * bell
    second = (mean[0] ** 2 + var) * ndtr(z) + lean * bell * (2 * mean[0] - lean * z)
    for index, exact in [((0,), ndtr(z)), ((1,), first), ((2,), second)]:
        assert_allclose(means[index] * np.exp(log_scale), exact, rtol=1e-13)


@pytest.mark.parametrize("blur", [0.0, 1.0])
def test_means_over_a_half_space_of_several_laws(blur):
    """Third moments over x = m + c t + r, t > -z, where r is independent of the normal t."""
    plane = HalfSpace(np.array([1.0, -2.0, 0.5]), 0.2, 0.5, blur)
    factors = [(0, 1, 2), (0, 0, 2), (1, 1, 1), (1, 2, 2)]
    indices = tuple(tuple(f.count(i) for i in range(3)) for f in factors)
    for covs in (COV, COVS):
        means, log_scale = half_space_means(indices, plane, MEANS, covs)
        for k in range(2):
            cov, mean = covs if covs.ndim == 2 else covs[..., k], MEANS[:, k]
            s = np.sqrt(plane.normal @ cov @ plane.normal + blur**2)
            z, c = (plane.normal @ mean + 0.2) / s, cov @ plane.normal / s
            bell = np.exp(-z * z / 2) / np.sqrt(2 * np.pi)
            truncated = [ndtr(z), bell, ndtr(z) - z * bell, (2 + z * z) * bell]
            rest = cov - np.outer(c, c)
            x = [np.polynomial.Polynomial(pair) for pair in zip(mean, c, strict=True)]
            for index, (i, j, l) in zip(indices, factors, strict=True):
                whole = x[i] * x[j] * x[l]
                whole += x[i] * rest[j, l] + x[j] * rest[i, l] + x[l] * rest[i, j]
                exact = whole.coef @ truncated
                found = means[index][k] * np.exp(log_scale[k])
                assert found == pytest.approx(exact, rel=1e-12, abs=1e-14)


def test_a_tail_comes_with_its_scale():
    """Phi(-50) is 0.5 erfcx(50 / sqrt 2) times exp(-1250); what is likely has no scale."""
    plane = HalfSpace(np.array([1.0]), 0.0, 0.5)
    mean = np.array([[-50.0, 0.0, 50.0, -1e200, 1e200]])
    means, log_scale = half_space_means(((1,),), plane, mean, np.eye(1))
    assert log_scale[[0, 1, 2, 4]].tolist() == [-1250.0, 0.0, 0.0, 0.0]
    tail = 0.5 * erfcx(50 / np.sqrt(2))
    assert_allclose(means[0,][[0, 1, 2, 4]], [tail, 0.5, 1.0, 1.0], rtol=1e-15)
    assert_allclose(means[1,][1:3], [1 / np.sqrt(2 * np.pi), 50.0], rtol=1e-15)
    assert np.isfinite(log_scale[3])
    # far inside nothing of a correlated component is lost, however far
    cov = np.array([[1.0, 0.5], [0.5, 2.0]])
    plane = HalfSpace(np.array([1.0, 0.0]), 0.0, 0.5)
    means, _ = half_space_means(((0, 3),), plane, np.array([1e200, 3.0]), cov)
    assert means[0, 3] == pytest.approx(27.0 + 3 * 3 * 2.0, rel=1e-15)


def test_masses_of_a_shifted_law_are_complex():
    """The distribution function in the complex plane, with a scale where its real part is low."""
    mean = np.array([[-8.0 + 2.0j, 0.5 - 1.5j, 6.0 + 0.5j]])
    means, log_scale = half_space_means(((0,),), HalfSpace(np.ones(1), 0.0, 0.5), mean, np.eye(1))
    exact = [complex(mp.erfc(-z / mp.sqrt(2)) / 2) for z in mean[0].tolist()]
    assert_allclose(means[0,] * np.exp(log_scale), exact, rtol=1e-13)
    assert log_scale.tolist() == [-30.0, 0.0, 0.0]


def test_a_half_space_that_does_not_vary_is_a_constant():
    plane = HalfSpace(np.array([1.0, -1.0]), 0.5, 0.25)
    mean = np.array([[0.0, 0.0, 0.0], [0.3, 0.7, 0.5]])
    means, log_scale = half_space_means(((0, 1),), plane, mean, np.ones((2, 2)))
    assert not log_scale.any()
    assert means[0, 0].tolist() == [1.0, 0.0, 0.25]
    assert means[0, 1].tolist() == [0.3, 0.0, 0.125]


def test_an_indicator_at_points():
    plane = HalfSpace(np.array([2.0, -1.0]), 0.5, 0.25)
    points = np.array([[0.0, 1.0, -1.0, 0.25], [0.5, 0.0, 0.0, 0.0]])
    assert indicator(plane, points).tolist() == [0.25, 1.0, 0.0, 1.0]
    # moved by a number of this deviation it is one with a probability
    soft = indicator(plane._replace(blur=0.4), points)
    assert_allclose(soft, ndtr(np.array([0.0, 2.5, -1.5, 1.0]) / 0.4), rtol=1e-15)


def test_products_with_one_matrix_or_many():
    for matrix in (ROOT, COVS * [1.0, -2.0]):
        for k in range(2):
            one = matrix if matrix.ndim == 2 else matrix[..., k]
            assert_allclose(times(matrix, MEANS)[:, k], one @ MEANS[:, k], rtol=1e-14)
    assert_allclose(times(ROOT, MEAN), ROOT @ MEAN, rtol=1e-15)
    assert_allclose(inner_product(LINEAR, MEANS), MEANS.T @ LINEAR, rtol=1e-14)
    assert_allclose(inner_product(MEANS, 2 * MEANS), 2 * (MEANS**2).sum(axis=0), rtol=1e-14)
    assert inner_product(MEAN, 1j * MEAN) == pytest.approx(1j * MEAN @ MEAN)


GROUPS = {
    "a polynomial": Group({(1, 0, 0): np.array([2.0, 0.0]), (0, 1, 1): np.array([0.0, -1.0])}),
    "a real part": Group({(1, 0, 0): np.array([2.0 - 3j, 1j]), (0, 1, 1): np.array([1j, -1.0])}),
    "an exponential": Group({(0, 1, 0): np.array([1.0, 3.0])}, None, LINEAR),
    "a sine": Group({(0, 0, 0): np.array([-2.0j, 1.0])}, None, 0.7j * LINEAR),
    "a wave and a power": Group({(1, 0, 0): np.array([1 - 2j, 1.0])}, None, (1 + 2j) * LINEAR),
    "a bell": Group({(0, 0, 1): np.array([1.0, 2.0])}, BEND, LINEAR),
    "a bell with a wave": Group({(0, 0, 0): np.array([1.0, 2j])}, BEND + 0.2j * WAVE, None),
}


@pytest.mark.parametrize("name", GROUPS)
def test_the_mean_of_a_term_by_nodes(name):
    """Twenty Gauss-Hermite nodes on each axis; the law of no spread has the value itself."""
    group = GROUPS[name]
    nodes, weights = np.polynomial.hermite_e.hermegauss(20)
    grid = np.array(np.meshgrid(nodes, nodes, nodes)).reshape(3, -1)
    mass = np.einsum("i,j,k->ijk", *[weights / weights.sum()] * 3).ravel()
    narrow = 0.3 * ROOT
    found = group_mean(group, MEANS, narrow @ narrow.T, (2,))
    assert found.dtype == float
    for k in range(2):
        points = MEANS[:, k, None] + narrow @ grid
        assert_allclose(found[:, k], group_value(group, points, 2) @ mass, rtol=1e-12)
    exact = group_mean(group, MEANS, np.zeros((3, 3)), (2,))
    assert_allclose(exact, group_value(group, MEANS, 2), rtol=1e-14)
    direct = sum(c * np.prod(MEAN ** np.array(a)) for a, c in group.polynomial.items())
    bend = 0.0 if group.quadratic is None else MEAN @ group.quadratic @ MEAN
    pull = 0.0 if group.linear is None else group.linear @ MEAN
    assert_allclose(exact[:, 0], (direct * np.exp(pull - bend / 2)).real, rtol=1e-13)


def test_a_value_beside_a_half_space():
    plane = HalfSpace(np.array([1.0, 0.0, 0.0]), 0.0, 0.5)
    for group in GROUPS.values():
        whole = group_value(group, MEANS, 2)
        assert_allclose(group_value(group._replace(plane=plane), MEANS, 2), whole * [1.0, 0.0])
