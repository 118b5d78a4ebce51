import mpmath as mp
import numpy as np
import pytest
import sympy

from oracles import literal_lemmas as literal
from seedslib.gaussian import interval
from seedslib.gaussian.regions.nodes import unit_nodes

INF = np.inf
CASES = [
    (0, 1, -INF, INF), (0, 1, -INF, 0), (0, 1, 0, INF), (0, 1, -1, 1), (0, 1, -40, 40),
    (0, 1, 8, 9), (0, 1, -9, -8), (0, 1, 3, 3 + 1e-7), (0, 1, 30, 31), (0, 1, 30, INF),
    (0, 1, 1e4, 1e4 + 1), (0, 1, 14142, INF), (0, 1, -14142, -14141.9), (0, 1, -1e-9, 1e-9),
    (0, 1, -1e-9, 3), (0, 1, -1e-300, INF), (0, 1, -8.94, INF), (0, 1, -8.95, 8.94),
    (0, 1, -6, -6 + 1e-12), (5, 2.3, -INF, 5.1), (1e9, 1e-3, 1e9, 1e9 + 1), (3, 0.5, -7, -6),
    (27.5, 126.5625, 5, 5.024935298), (0, 1e20, 1, 2), (0, 1e-8, -1, 1), (0, 1, 0.1, 8.5),
    (0, 1, -0.1, 8), (0, 1, 2, 12), (0, 1, 5, INF), (-3e5, 7e-6, -3e5 + 0.02, INF),
    (0, 1, 0, 3.9), (0, 1, 0, 4.1), (0, 1, 0, 7.7), (0, 1, 0, 7.8), (0, 1, -3.9, 4.0),
]  # fmt: skip


def exact(mean, var, lower, upper):
    """ln P, mean, variance of the conditioned law; the digits pay for the tails' cancellation."""
    reach = max([abs(t - mean) / np.sqrt(var) for t in (lower, upper) if np.isfinite(t)] + [1])
    with mp.workdps(80 + min(int(reach * reach / 4), 60)):
        m, v = mp.mpf(mean), mp.mpf(var)
        a, b = ((mp.mpf(t) - m) / mp.sqrt(v) for t in (lower, upper))
        sign = 1
        if b <= 0:
            a, b, sign = -b, -a, -1
        tail = [mp.erfc(t / mp.sqrt(2)) / 2 if mp.isfinite(t) else mp.mpf(t < 0) for t in (a, b)]
        bell = [mp.npdf(t) if mp.isfinite(t) else mp.mpf(0) for t in (a, b)]
        edge = [t * p if mp.isfinite(t) else mp.mpf(0) for t, p in zip((a, b), bell, strict=True)]
        mass = tail[0] - tail[1]
        centre = (bell[0] - bell[1]) / mass
        spread = 1 + (edge[0] - edge[1]) / mass - centre**2
        return mp.log(mass), m + sign * mp.sqrt(v) * centre, v * spread


def assert_exact(found, case):
    log_mass, mean, var = exact(*case)
    assert abs(float(found.log_mass) - log_mass) <= 1e-15 * max(1, abs(log_mass))
    last_bits = 2 * np.spacing(abs(float(mean)))
    assert abs(float(found.mean) - mean) <= 2e-14 * mp.sqrt(var) + last_bits
    assert abs(float(found.cov) / var - 1) <= 2e-14


@pytest.mark.parametrize("case", CASES)
def test_against_many_digits(case):
    assert_exact(interval(*case), case)


def test_random_intervals_against_many_digits():
    rng = np.random.default_rng(4)
    for _ in range(300):
        mean, sigma = rng.normal() * 10 ** rng.uniform(-3, 3), 10 ** rng.uniform(-3, 3)
        lower = mean + sigma * rng.normal() * 10 ** rng.uniform(-6, 2)
        upper = lower + sigma * 10 ** rng.uniform(-10, 2)
        case = (float(mean), float(sigma**2), float(lower), float(upper))
        if rng.uniform() < 0.1:
            case = (*case[:3], INF)
        if case[2] < case[3]:
            assert_exact(interval(*case), case)


@pytest.mark.parametrize("count", [16, 20, 24, 48])
def test_nodes_are_relatively_accurate(count):
    nodes, weights = unit_nodes(count)
    with mp.workdps(50):
        for node, weight in zip(nodes, weights, strict=True):
            root = mp.findroot(lambda u: mp.legendre(count, 2 * u - 1), mp.mpf(float(node)))
            slope = mp.diff(lambda u: mp.legendre(count, 2 * u - 1), root)
            assert abs(float(node) / root - 1) < 4e-16
            assert abs(float(weight) * root * (1 - root) * slope**2 - 1) < 1e-14


@pytest.mark.parametrize(
    "case", [(0.3, 2.0, -1.0, 1.5), (1.0, 0.5, 0.0, INF), (-2.0, 1.0, -INF, -1.0)]
)
def test_literal_lemma_2_about_the_mean(case):
    mass, first, second = literal.lemma_2(*case)
    found = interval(*case, about=case[0])
    np.testing.assert_allclose(found.mass, mass, rtol=1e-14)
    np.testing.assert_allclose(found.first, first, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(found.second, second, rtol=1e-13)


def test_literal_lemma_2_fails_where_it_must():
    assert literal.lemma_2(0.0, 1.0, 30.0, 31.0)[0] == 0.0
    mass, first, second = literal.lemma_2(0.0, 1.0, 8.0, 9.0)
    assert abs(mass / interval(0, 1, 8, 9).mass - 1) > 0.01
    assert second / mass - (first / mass) ** 2 < 0.0


def test_lemma_2_is_the_integral():
    x, m = sympy.symbols("x m", real=True)
    g = sympy.symbols("Gamma", positive=True)
    density = sympy.exp(-((x - m) ** 2) / (2 * g)) / sympy.sqrt(2 * sympy.pi * g)
    bell = lambda t: sympy.sqrt(g / (2 * sympy.pi)) * sympy.exp(-((t - m) ** 2) / (2 * g))  # noqa: E731
    mass = sympy.erf((x - m) / sympy.sqrt(2 * g)) / 2
    # primitives of the density, of x times it, and of (x - m)^2 times it
    for primitive, integrand in (
        (mass, density),
        (m * mass - bell(x), x * density),
        (g * mass - (x - m) * bell(x), (x - m) ** 2 * density),
    ):
        assert sympy.simplify(sympy.diff(primitive, x) - integrand) == 0


def test_lemma_2_about_a_reference_point():
    """Q of (1) about Delta: lemma 2 alone is another number, with the moved terms it is the one."""
    node, share = np.polynomial.legendre.leggauss(40)
    mean, var, lower, upper, about = 0.3, 2.0, -1.0, 1.5, -0.7
    x = lower + (upper - lower) * (node + 1) / 2
    mass = (upper - lower) / 2 * share * np.exp(-((x - mean) ** 2) / (2 * var))
    direct = ((x - about) ** 2 * mass).sum() / np.sqrt(2 * np.pi * var)
    p, first, second = literal.lemma_2(mean, var, lower, upper)
    moved = literal.about_a_point(p, first, second, mean, about)[0, 0]
    np.testing.assert_allclose(moved, direct, rtol=1e-13)
    np.testing.assert_allclose(interval(mean, var, lower, upper, about).second, direct, rtol=1e-13)
    turned = literal.about_a_point(p, first, second, mean, 2 * mean - about)[0, 0]
    assert min(abs(second - direct), abs(turned - direct)) > 0.05


def test_partition_of_the_line_sums_to_the_law():
    rng = np.random.default_rng(1)
    edges = np.concatenate([[-INF], np.sort(rng.normal(size=30) * 3), [INF]])
    mean, var = rng.normal(size=200), rng.uniform(0.1, 5, size=200)
    cells = interval(mean, var, edges[:-1, None], edges[1:, None], about=0.7)
    np.testing.assert_allclose(cells.mass.sum(axis=0), 1.0, rtol=1e-14)
    np.testing.assert_allclose(cells.first.sum(axis=0), mean, atol=1e-14)
    np.testing.assert_allclose(cells.second.sum(axis=0), var + (mean - 0.7) ** 2, rtol=1e-13)


def test_mirror_image():
    right, left = interval(0.4, 2.0, 3.0, 3.5), interval(-0.4, 2.0, -3.5, -3.0)
    assert right.log_mass == left.log_mass
    assert right.mean == -left.mean
    assert right.cov == left.cov


def test_shapes_broadcast_and_agree_with_single_calls():
    mean, var = np.linspace(-2, 2, 5), np.array([0.3, 1.0, 4.0])[:, None]
    lower = np.array([-INF, -1.0, 6.0])[:, None, None]
    upper = np.array([-1.0, 6.0, INF])[:, None, None]
    found = interval(mean, var, lower, upper, about=mean)
    for array in (found.log_mass, found.mean, found.cov, found.mass, found.first, found.second):
        assert array.shape == (3, 3, 5)
    single = interval(mean[3], var[1, 0], lower[2, 0, 0], upper[2, 0, 0], about=mean[3])
    assert single.log_mass.shape == ()
    np.testing.assert_allclose(found.second[2, 1, 3], single.second, rtol=5e-15)
    assert interval(np.zeros((0, 3)), 1.0, 0.0, 1.0).mean.shape == (0, 3)


def test_many_intervals_cross_block_boundaries():
    lower = np.linspace(-30, 30, 40_001)
    found = interval(0.0, 1.0, lower[:-1], lower[1:])
    np.testing.assert_allclose(found.mass.sum(), 1.0, rtol=1e-13)
    some = interval(0.0, 1.0, lower[17_000], lower[17_001])
    np.testing.assert_allclose(found.cov[17_000], some.cov, rtol=5e-15)


def test_a_point_belongs_to_one_half_open_interval():
    cells = interval(1.0, 0.0, [-INF, 0.0, 1.0, 2.0], [0.0, 1.0, 2.0, INF])
    np.testing.assert_array_equal(cells.mass, [0.0, 0.0, 1.0, 0.0])
    assert cells.mean[2] == 1.0
    assert cells.cov[2] == 0.0
    assert np.isnan(cells.mean[[0, 1, 3]]).all()
    np.testing.assert_array_equal(cells.first, [0.0, 0.0, 1.0, 0.0])


@pytest.mark.parametrize(("lower", "upper"), [(1.0, 1.0), (INF, INF), (-INF, -INF)])
def test_empty_interval(lower, upper):
    found = interval(0.0, 1.0, lower, upper)
    assert found.log_mass == -INF
    assert np.isnan(found.mean)
    assert found.second == 0.0


def test_extreme_scales():
    assert interval(0.0, 1e-320, -1.0, 1.0).log_mass == 0.0
    assert interval(0.0, 1e-320, 1.0, 2.0).log_mass == -INF
    assert interval(1e308, 1.0, -1e308, 0.0).log_mass == -INF
    np.testing.assert_allclose(interval(0.0, 1e300, 1e150, INF).log_mass, np.log(0.158655253931457))


def test_second_moment_about_another_point():
    found = interval(0.3, 1.2, -1.0, 2.0, about=0.3)
    moved = found.referred_to(5.0)
    bar = found.first - found.mass * 0.3
    np.testing.assert_allclose(
        moved.second, found.second + 2 * (0.3 - 5.0) * bar + found.mass * (0.3 - 5.0) ** 2
    )
    with pytest.raises(ValueError, match="about"):
        found.referred_to([1.0, 2.0, np.nan])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.nan, 1, 0, 1), "mean"),
        ((0, -1, 0, 1), "var: wanted nonnegative"),
        ((0, INF, 0, 1), "var"),
        ((0, 1, np.nan, 1), "lower"),
        ((0, 1, 0, np.nan), "upper"),
        ((0, 1, 2, 1), "lower <= upper"),
        (([0, 1, 2], 1, [0, 0], 1), "broadcast"),
    ],
)
def test_bad_values(arguments, message):
    with pytest.raises(ValueError, match=message):
        interval(*arguments)


def test_bad_types():
    with pytest.raises(TypeError, match="mean"):
        interval("a", 1, 0, 1)
    with pytest.raises(TypeError, match="upper"):
        interval(0, 1, 0, 1j)
