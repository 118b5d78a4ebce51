import mpmath as mp
import numpy as np
import pytest
from scipy.special import ellipe, elliprg, erf, gammaln, hyp1f1, hyp2f1

from seedslib.gaussian import norm_errors, norm_mean
from seedslib.gaussian.means.norm import NODES, WEIGHTS

PAPER = np.array([[1.5, -0.5], [-0.5, 1.5]])


def thirty_digits(spread, centre):
    """The defining integral in another variable, s = c tan u, by adaptive quadrature."""
    with mp.workdps(30):
        spread = [mp.mpf(float(v)) for v in spread]
        centre = [mp.mpf(float(b)) for b in centre]
        scale = 1 / mp.sqrt(2 * max(spread) + sum(b * b for b in centre))

        def inner(v):
            s = scale * mp.exp(v)
            product, total = mp.mpf(1), mp.mpf(0)
            for λ, b in zip(spread, centre, strict=True):
                d = 1 + 2 * λ * s * s
                product *= mp.exp(-s * s * b * b / d) / mp.sqrt(d)
                total += λ / d + b * b / d**2
            return product * total * s

        step = mp.mpf(1) / 16
        total = sum(inner(k * step) for k in range(-80 * 16, 80 * 16))
        return float(2 / mp.sqrt(mp.pi) * step * total)


RNG = np.random.default_rng(5)
WILD = [
    (10.0 ** RNG.uniform(-8, 0, n), RNG.normal(size=n) * 10.0 ** RNG.uniform(-4, 3))
    for n in (1, 2, 2, 3, 4, 5, 6, 7)
]
WILD += [([1.0, 1e-12], [1e3, -2.0]), ([2.0, 0.0, 0.0], [0.1, 3.0, 0.0]), ([1.0, 0.0], [0.0, 0.0])]


@pytest.mark.parametrize(("spread", "centre"), WILD)
def test_against_thirty_digits(spread, centre):
    exact = thirty_digits(spread, centre)
    assert norm_mean(centre, np.diag(spread)) == pytest.approx(exact, rel=2e-15)


def test_rotated_covariances():
    spread, centre = WILD[5]
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(5, 5)))[0]
    cov = turn @ np.diag(spread) @ turn.T
    exact = thirty_digits(spread, centre)
    assert norm_mean(turn @ centre, 0.5 * (cov + cov.T)) == pytest.approx(exact, rel=1e-13)


def test_three_closed_forms_in_the_plane():
    """Formula (2.6) with the constant 2√π, and two forms that survive a singular covariance."""
    ours = norm_mean([0, 0], PAPER)
    high, low = 2.0, 1.0
    share = (high - low) / (high + low)
    assert hyp2f1(0.75, 1.25, 1, 1 / 9) == pytest.approx(1.1169735, abs=5e-8)
    printed = 2 * np.sqrt(np.pi) * low * high / (low + high) ** 1.5
    assert ours == pytest.approx(printed * hyp2f1(0.75, 1.25, 1, share**2), rel=1e-14)
    second = 0.5 * np.sqrt(np.pi * (low + high)) * hyp2f1(-0.25, 0.25, 1, share**2)
    assert ours == pytest.approx(second, rel=1e-14)
    third = np.sqrt(2 * high / np.pi) * ellipe(1 - low / high)
    assert ours == pytest.approx(third, rel=1e-14)
    assert ours == pytest.approx(1.5240384175392, abs=5e-14)


def test_carlson_form_in_three_dimensions():
    spread = np.random.default_rng(1).uniform(0, 3, (3, 50))
    spread[2, ::5] = 0.0
    cov = np.einsum("ik,ij->ijk", spread, np.eye(3))
    exact = np.sqrt(8 / np.pi) * elliprg(*spread)
    np.testing.assert_allclose(norm_mean(np.zeros((3, 1)), cov), exact, rtol=2e-15)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 10, 30])
def test_isotropic_law(n):
    centre = np.full(n, 0.4)
    length = np.exp(gammaln((n + 1) / 2) - gammaln(n / 2))
    exact = np.sqrt(2) * 1.5 * length * hyp1f1(-0.5, n / 2, -n * 0.16 / (2 * 1.5**2))
    assert norm_mean(centre, 2.25 * np.eye(n)) == pytest.approx(exact, rel=1e-13)
    ratio = norm_mean(np.zeros(n), np.eye(n)) / np.sqrt(n)
    table = {1: 0.798, 2: 0.886, 3: 0.921, 5: 0.952, 10: 0.975, 30: 0.992}
    assert ratio == pytest.approx(table[n], abs=5e-4)


def test_degenerate_laws():
    assert norm_mean([0, 0], np.zeros((2, 2))) == 0.0
    assert norm_mean([3, 4], np.zeros((2, 2))) == pytest.approx(5.0, rel=2e-15)
    assert norm_mean([0, 0], np.diag([4.0, 0.0])) == pytest.approx(np.sqrt(8 / np.pi), rel=2e-15)
    assert norm_mean([3e180, 4e180], np.eye(2)) == pytest.approx(5e180, rel=2e-15)
    assert norm_mean([3e-200, 0], 1e-300 * np.eye(2)) == pytest.approx(
        np.sqrt(np.pi / 2) * 1e-150, rel=2e-15, abs=0
    )


def test_batches():
    rng = np.random.default_rng(2)
    mean = rng.normal(size=(2, 3, 400))
    ours = norm_mean(mean, PAPER)
    assert ours.shape == (3, 400)
    assert ours[1, 7] == pytest.approx(float(norm_mean(mean[:, 1, 7], PAPER)), rel=1e-15)
    cov = np.einsum("ij,k->ijk", PAPER, rng.uniform(0, 2, 400))
    ours = norm_mean(mean, cov)
    assert ours.shape == (3, 400)
    assert ours[2, 9] == pytest.approx(float(norm_mean(mean[:, 2, 9], cov[..., 9])), rel=1e-15)
    assert norm_mean(np.empty((2, 0)), PAPER).shape == (0,)


def test_every_member_of_a_large_batch_is_as_good_as_alone():
    """Blocks of a batch are joined without a seam; a point of no spread may lie among them."""
    mean = np.random.default_rng(3).normal(size=(2, 700))
    mean[:, [0, 255, 256, 699]] = 0.0
    scales = np.linspace(0.5, 2.0, 700)
    scales[[0, 256]] = 0.0
    cov = PAPER[..., None] * scales
    ours = norm_mean(mean, cov)
    pieces = [norm_mean(mean[:, k : k + 70], cov[..., k : k + 70]) for k in range(0, 700, 70)]
    np.testing.assert_allclose(ours, np.concatenate(pieces), rtol=1e-14)
    assert ours[0] == ours[256] == 0.0
    alone = float(norm_mean([0.0, 0.0], PAPER))
    assert ours[255] == pytest.approx(alone * np.sqrt(scales[255]), rel=1e-14)
    # one mean of many covariances
    many = norm_mean([0.3, -0.4], cov)
    assert many[0] == pytest.approx(0.5, rel=1e-15)
    assert many[9] == pytest.approx(float(norm_mean([0.3, -0.4], cov[..., 9])), rel=1e-14)
    # an eigenvalue of minus a rounding counts as zero
    thin = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-16]])
    assert norm_mean([0, 0], thin) == pytest.approx(np.sqrt(4 / np.pi), rel=2e-15)


def test_a_batch_of_two_axes_and_a_number():
    scales = np.array([[0.5, 1.0, 2.0], [3.0, 0.1, 0.7]])
    found = norm_mean([0.0, 0.0], np.multiply.outer(PAPER, scales))
    alone = norm_mean([0.0, 0.0], PAPER)
    assert isinstance(alone, float)
    np.testing.assert_allclose(found, alone * np.sqrt(scales), rtol=4e-15)
    assert norm_mean([3e-200, -4e-200], np.zeros((2, 2))) == pytest.approx(5e-200, rel=2e-15, abs=0)
    assert NODES.shape == WEIGHTS.shape == (153,)


def test_the_mean_length_of_one_number():
    """E |X| = m erf(m / sqrt(2 P)) + sqrt(2 P / pi) exp(-m² / (2 P)), in a batch of both."""
    m, P = np.array([0.0, 0.3, -2.0, 9.0]), np.array([1.0, 0.0, 0.7, 4.0])
    exact = [np.sqrt(2 / np.pi), 0.3]
    for a, b in zip(m[2:], P[2:], strict=True):
        bell = np.sqrt(2 * b / np.pi) * np.exp(-a * a / (2 * b))
        exact.append(a * erf(a / np.sqrt(2 * b)) + bell)
    np.testing.assert_allclose(norm_mean(m[None], P[None, None]), exact, rtol=4e-15)


def test_errors_of_the_length():
    """Example 5: the estimates differ by 13.6 %, their errors by 6.4 %."""
    optimal, rough = norm_errors(PAPER)
    assert optimal == pytest.approx(0.677307, abs=5e-7)
    assert rough == pytest.approx(0.720576, abs=5e-7)
    assert optimal == pytest.approx(3 - 1.5240384175392**2, rel=1e-12)
    assert 100 * (rough / optimal - 1) == pytest.approx(6.388, abs=5e-4)
    draws = np.linalg.norm(
        np.random.default_rng(0).multivariate_normal([0, 0], PAPER, 400_000), axis=1
    )
    for value, constant in ((optimal, 1.5240384175392), (rough, np.sqrt(3))):
        squares = (draws - constant) ** 2
        assert abs(squares.mean() - value) < 4 * squares.std() / np.sqrt(squares.size)
    assert norm_errors(np.zeros((2, 2))) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("mean", "cov", "message"),
    [
        ([0, 0, 0], PAPER, "cov: wanted shape"),
        ([0, np.nan], PAPER, "mean: wanted finite"),
        ([0, 0], [[1, 0.1], [0, 1]], "cov: wanted a symmetric"),
        ([0, 0], [[1, 2], [2, 1]], "cov: wanted a positive semidefinite"),
        ([[0] * 4, [0] * 4], np.ones((2, 2, 3)), "cov: batch axes"),
        ([0, 0], np.stack([PAPER, -PAPER], axis=-1), "cov: wanted positive semidefinite"),
        ([0, 0], np.stack([PAPER, [[1, 0.1], [0, 1]]], axis=-1), "cov: wanted symmetric"),
        (0.0, [[1.0]], "mean: wanted shape"),
    ],
)
def test_bad_input(mean, cov, message):
    with pytest.raises(ValueError, match=message):
        norm_mean(mean, cov)


def test_input_that_is_not_real():
    with pytest.raises(TypeError, match="cov"):
        norm_mean([0, 0], PAPER.astype(complex))
    with pytest.raises(TypeError, match="mean"):
        norm_mean(np.array([0, None]), PAPER)
