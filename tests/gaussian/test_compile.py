"""From terms to numbers: norms, coefficients, batches, conjugate pairs of waves."""

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from seedslib.gaussian import expectation_function, norm_mean
from seedslib.gaussian.means.classes import PLAIN, Key, Plane
from seedslib.gaussian.means.compile import Norm, compile_terms
from seedslib.gaussian.means.parse import Parsed, parse

x, y = VARIABLES = sp.symbols("x y", real=True)
MEAN = np.array([0.4, -0.7])
ROOT = np.array([[1.1, 0.0], [-0.4, 0.7]])
COV = ROOT @ ROOT.T
FACTOR = np.array([[0.3, 1.0, -2.0], [1.7, 0.1, 0.6], [0.0, -0.9, 0.2]])


def given(*components):
    """A function that was read, from dictionaries of keys and polynomials."""
    polys = [{key: sp.Poly(p, x, y) for key, p in terms.items()} for terms in components]
    return Parsed(VARIABLES, (), tuple(polys), len(polys) == 1)


def test_the_law_under_a_norm():
    """Mean A x + b and covariance A P A', symmetric to the last bit; for one law and for many."""
    norm, slope = Norm(np.ones(1), FACTOR), FACTOR[:, 1:]
    means = np.stack([MEAN, 3 * MEAN, -MEAN], axis=1)
    covs = COV[..., None] * np.array([1.0, 0.3, 7.0])
    for mean, cov in [(MEAN, COV), (means, COV), (means, covs)]:
        centre, spread = norm.law(mean, cov)
        scale = 1.0 if cov.ndim == 2 else np.array([1.0, 0.3, 7.0])
        origin = FACTOR[:, 0].reshape(-1, *[1] * (mean.ndim - 1))
        assert_allclose(centre, origin + slope @ mean, rtol=1e-14)
        exact = np.multiply.outer(slope @ COV @ slope.T, scale)
        assert_allclose(spread, exact.reshape(spread.shape), rtol=1e-13, atol=1e-15)
        assert np.array_equal(spread, spread.swapaxes(0, 1))


def test_norms_in_numbers():
    """2 |A x + b| in the second of two components: the mean, the value, and for many laws."""
    rows = FACTOR @ sp.Matrix([1, x, y])
    length = sp.sqrt(sp.expand((rows.T * rows)[0]))
    compiled = compile_terms(parse([x, 2 * length + y], VARIABLES))
    (norm,) = compiled.norms
    assert_allclose(norm.coefficient, [0.0, 2.0])
    assert_allclose(norm.factor.T @ norm.factor, FACTOR.T @ FACTOR, atol=1e-14)
    slope = FACTOR[:, 1:]
    exact = 2 * norm_mean(FACTOR[:, 0] + slope @ MEAN, slope @ COV @ slope.T) + MEAN[1]
    assert_allclose(compiled.mean(MEAN, COV), [MEAN[0], exact], rtol=1e-13)
    many = compiled.mean(np.stack([MEAN] * 3, axis=1), COV)
    assert_allclose(many, np.array([[MEAN[0]] * 3, [exact] * 3]), rtol=1e-13)
    points = np.stack([MEAN, -MEAN, 2 * MEAN], axis=1)
    lengths = np.linalg.norm(FACTOR[:, :1] + slope @ points, axis=0)
    assert_allclose(compiled.value(points), [points[0], 2 * lengths + points[1]], rtol=1e-13)
    # rows of rounding size are left out
    (flat,) = compile_terms(parse(sp.sqrt((x + 2 * y) ** 2 + (x - 1) ** 2), VARIABLES)).norms
    assert flat.factor.shape == (2, 3)


def test_batch_axes_of_mean_and_covariance_fit_one_another():
    """A mean (n, 1, 4) and covariances (n, n, 3, 1), or fewer axes, give values (p, 3, 4)."""
    f = [x * y, sp.sin(x), abs(x - y), sp.sqrt(x**2 + y**2 + 1), sp.exp(-(x**2)) * y]
    compiled = compile_terms(parse(f, VARIABLES))
    shifts, scales = np.array([0.0, 1.0, -2.0, 0.3]), np.array([1.0, 0.5, 2.0])
    means, covs = MEAN[:, None] + shifts, COV[..., None] * scales
    whole = compiled.mean(means[:, None], covs[..., None])
    assert whole.shape == (5, 3, 4)
    for k, covs_k in enumerate(np.moveaxis(covs, -1, 0)):
        assert_allclose(compiled.mean(means, covs_k), whole[:, k], rtol=1e-12)
        for j, mean in enumerate(means.T):
            assert_allclose(compiled.mean(mean, covs_k), whole[:, k, j], rtol=1e-12)
    assert_allclose(compiled.mean(means, covs[..., None]), whole, rtol=1e-12)
    assert_allclose(compiled.mean(means[:, 0], covs), whole[..., 0], rtol=1e-12)
    grid = np.stack([means[:, :3], means[:, 1:]], axis=1)
    diagonals = [whole[:, range(3), range(k, k + 3)] for k in range(2)]
    assert_allclose(compiled.mean(grid, covs), np.stack(diagonals, axis=1), rtol=1e-12)
    # means are linear, whatever the kinds of the terms
    together = compile_terms(parse(sum(reversed(f)), VARIABLES)).mean(
        means[:, None], covs[..., None]
    )
    assert_allclose(together[0], whole.sum(axis=0), rtol=1e-12)


def test_coefficients_of_a_polynomial():
    compiled = compile_terms(parse([x**2 * y - 3, 2 * y], VARIABLES))
    found = {alpha: c.tolist() for alpha, c in compiled.polynomial().items()}
    assert found == {(2, 1): [1.0, 0.0], (0, 0): [-3.0, 0.0], (0, 1): [0.0, 2.0]}
    assert all(c.dtype == float for c in compiled.polynomial().values())
    nothing = compile_terms(parse([x - x, sp.S.Zero], VARIABLES)).polynomial()
    assert {alpha: c.tolist() for alpha, c in nothing.items()} == {(0, 0): [0.0, 0.0]}


def test_of_two_conjugate_waves_one_is_kept():
    compiled = compile_terms(parse(3 * sp.cos(x - 2 * y) * y, VARIABLES))
    (group,) = compiled.groups
    assert group.polynomial[0, 1].tolist() == [3.0]
    assert (group.linear / group.linear[0]).tolist() == [1.0, -2.0]
    assert group.linear[0] == 1j
    assert group.quadratic is None
    (bell,) = compile_terms(parse(sp.exp(-(x**2) / 2 + x * y), VARIABLES)).groups
    assert bell.linear is None
    assert bell.quadratic.tolist() == [[1.0, -1.0], [-1.0, 0.0]]
    assert bell.quadratic.dtype == float
    (growth,) = compile_terms(parse(sp.exp(x / 2 - y), VARIABLES)).groups
    assert growth.linear.tolist() == [0.5, -1.0]
    assert growth.linear.dtype == float


WAVE, BACK = Key((((1, 0), sp.I),)), Key((((1, 0), -sp.I),))
HALF = Plane((sp.S.One, sp.S.Zero), sp.S.Zero, sp.S.Half)
SQUARES = Key((((0, 2), sp.I), ((1, 0), sp.S(2))))
BOTH = tuple((place, sp.S(-1) / max(place)) for place in ((0, 2), (1, 1), (2, 0)))
LITTLE, ROUNDING = sp.Rational(1, 10**9), sp.Rational(1, 10**14)


@pytest.mark.parametrize(
    "terms",
    [
        {WAVE: 1},
        {BACK: x, PLAIN: 1},
        {SQUARES: y},
        {WAVE: 1, BACK: 2},
        {WAVE: sp.I, BACK: sp.I},
        {WAVE: 1, BACK: 1 + LITTLE},
        {WAVE: x, BACK: y},
        {WAVE: LITTLE, BACK: 2 * LITTLE},
        {WAVE: 1, Key((((1, 0), -sp.I), *BOTH)): 1},
        {Key((((1, 0), sp.I * LITTLE),)): 1, Key((((1, 0), -sp.I * LITTLE * (1 + LITTLE)),)): 1},
        {WAVE: 1, Key((((1, 0), -sp.I), ((0, 1), sp.S.One))): 1},
        {WAVE: 1, Key((((1, 0), -sp.I * (1 + LITTLE)),)): 1},
        {WAVE: 1, BACK._replace(plane=HALF): 1},
        {WAVE._replace(plane=HALF): 1, BACK._replace(plane=HALF._replace(offset=sp.S(1))): 1},
        {WAVE._replace(plane=HALF): 1, BACK._replace(plane=HALF._replace(blurred=True)): 1},
    ],
    ids=str,
)
def test_a_wave_without_its_conjugate_is_refused(terms):
    with pytest.raises(
        ValueError, match="f: wanted real values, got a complex exponential without"
    ):
        compile_terms(given(terms))


@pytest.mark.parametrize(
    "terms",
    [
        {WAVE: sp.I * x, BACK: -sp.I * x},
        {WAVE: 1 + sp.I, BACK: (1 - sp.I) * (1 + sp.Rational(1, 10**14))},
        {SQUARES: y, Key((((0, 2), -sp.I), ((1, 0), sp.S(2)))): y, PLAIN: x},
        {WAVE._replace(plane=HALF): y, BACK._replace(plane=HALF): y},
        {Key((((0, 2), sp.I),)): x, Key((((0, 2), -sp.I),)): x},
        {WAVE: 1 + x * ROUNDING, BACK: 1},
        {WAVE: 1, Key((((1, 0), -sp.I * (1 + ROUNDING)),)): 1},
    ],
    ids=str,
)
def test_a_wave_beside_its_conjugate_is_a_function(terms):
    compiled = compile_terms(given(terms))
    total = 0.0
    for key, poly in terms.items():
        exponent = sum(c * x**a * y**b for (a, b), c in key.exponent)
        total += poly * sp.exp(exponent) * (1 if key.plane is None else sp.Heaviside(x))
    exact = complex(total.subs({x: 0.4, y: -0.7}))
    assert abs(exact.imag) < 1e-13
    assert compiled.value(MEAN)[0] == pytest.approx(exact.real, rel=1e-13)


def test_waves_of_several_components():
    """Each component has its own pair; what is rounding is so beside the largest coefficient."""
    with pytest.raises(
        ValueError, match="f: wanted real values, got a complex exponential without"
    ):
        compile_terms(given({WAVE: 1, BACK: 1}, {WAVE: 1, BACK: 2}))
    compiled = compile_terms(given({WAVE: 1, BACK: 1 + ROUNDING}, {PLAIN: y}))
    assert_allclose(compiled.value(MEAN), [2 * np.cos(0.4), -0.7], rtol=1e-14)


def test_roots_of_expanded_squares_are_moduli():
    """Without a constant as well; and to the third power."""
    for line, cube in [(x + 2 * y - 3, False), (2 * y - x, False), (x - y / 2 + 1, True)]:
        root = sp.expand(line**2) ** (sp.Rational(3, 2) if cube else sp.S.Half)
        modulus = abs(line) ** (3 if cube else 1)
        found, wanted = (expectation_function(f, VARIABLES)(MEAN, COV) for f in (root, modulus))
        assert found == pytest.approx(wanted, rel=1e-14)


def test_a_difference_that_is_affine_switches():
    """max(√2 (x + sin y), √2 sin y) = √2 (max(x, 0) + sin y)."""
    root = sp.sqrt(2)
    both = sp.Max(root * (x + sp.sin(y)), root * sp.sin(y)), root * (sp.Max(x, 0) + sp.sin(y))
    found, wanted = (expectation_function(f, VARIABLES)(MEAN, COV) for f in both)
    assert found == pytest.approx(wanted, rel=1e-14)


def test_exponents_on_one_side_of_a_plane():
    """e^(y 1{x > 0}) is e^y on one side and one on the other."""
    step = sp.Heaviside(x, sp.S.Half)
    apart = step * sp.exp(y) + 1 - step
    found, wanted = (
        expectation_function(f, VARIABLES)(MEAN, COV) for f in (sp.exp(y * step), apart)
    )
    assert found == pytest.approx(wanted, rel=1e-14)


def test_equal_half_spaces_are_one():
    """Whatever they were multiplied by; where no variable is left the edge is the value."""
    one, other = sp.Heaviside(3 * x - y, 0), sp.Heaviside(x - y / 3, 0)
    found = expectation_function([one, one * other], VARIABLES)(MEAN, COV)
    assert found[0] == found[1]
    gone = sp.Heaviside(x * (x + 1) - x**2 - x, sp.Rational(1, 4))
    assert expectation_function(gone, VARIABLES)(MEAN, COV) == 0.25


def test_equal_exponentials_cancel():
    """cosh(x + y) - e^x cosh y = (e^(-x - y) - e^(x - y)) / 2, where e^(x + y) is too large."""
    function = expectation_function(sp.cosh(x + y) - sp.exp(x) * sp.cosh(y), VARIABLES)
    assert function([400.0, 400.0], np.zeros((2, 2))) == -0.5


def test_coefficients_that_are_no_numbers():
    a = sp.Symbol("a")
    with pytest.raises(ValueError, match=r"f: wanted numbers as coefficients, got _?a$"):
        compile_terms(parse(a * x, [x], [a]))
    with pytest.raises(ValueError, match="f: wanted real coefficients, got "):
        compile_terms(given({PLAIN: 1 + sp.I * x}))
    big = sp.exp(sp.Integer(1000))
    for f in (big * x, sp.exp(big * x), sp.Heaviside(x - big, sp.S.Half)):
        with pytest.raises(ValueError, match="f: wanted coefficients in the range of float64, got"):
            expectation_function(f, [x])
    function = expectation_function(sp.exp(x), [x])
    with pytest.raises(ValueError, match="mean, cov: wanted arguments for which"):
        function([800.0], [[1.0]])
    with pytest.raises(ValueError, match="mean, cov: wanted arguments for which"):
        expectation_function(sp.exp(a * x), [x], parameters=[a])([1.0], [[1.0]], 800.0)
