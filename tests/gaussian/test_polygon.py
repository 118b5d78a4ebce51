import importlib.util
import json
from decimal import Decimal, localcontext
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.special import ndtr

from oracles import literal_lemmas as literal
from oracles import polygon_reference
from seedslib.gaussian import interval, polygon
from seedslib.gaussian.regions.edges import edge_moments
from seedslib.gaussian.regions.geometry import outline
from seedslib.gaussian.regions.law import Cases

KNOWN = json.loads(Path(polygon_reference.__file__).with_suffix(".json").read_text())
pad_regions = importlib.import_module("seedslib.gaussian.regions.polygon").pad_regions

UNIT = np.eye(2)
TILTED = np.array([[1.0, 0.3], [0.3, 1.0]])
SQUARE = np.array([[0.1, 0.9], [-0.7, 0.1], [0.2, -0.8], [1.0, 0.0]])
CHEVRON = np.array([[0.0, 0.0], [2.0, -1.0], [1.0, 1.0], [2.0, 3.0], [-1.0, 1.0]])


def box(x0, x1, y0, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def errors(found, case):
    """Errors of ln P (relative beyond one), mean (in sd, less 4 last bits), covariance (in sd)."""
    with localcontext() as context:
        context.prec = 60
        log_mass = Decimal(case["log_mass"])
        mean = [Decimal(text) for text in case["moment_mean"]]
        cov = [Decimal(text) for text in case["moment_cov"]]
        sd = [cov[0].sqrt(), cov[2].sqrt()]
        units = [cov[0], sd[0] * sd[1], cov[2]]
        entries = [found.cov[0, 0], found.cov[0, 1], found.cov[1, 1]]
        of_mass = abs(Decimal(float(found.log_mass)) - log_mass) / max(1, abs(log_mass))
        of_mean = max(
            (abs(Decimal(float(a)) - b) - Decimal(4 * float(np.spacing(abs(float(b)))))) / s
            for a, b, s in zip(found.mean, mean, sd, strict=True)
        )
        of_cov = max(
            abs(Decimal(float(a)) - b) / u for a, b, u in zip(entries, cov, units, strict=True)
        )
        return float(of_mass), float(of_mean), float(of_cov)


def solve(case, **options):
    return polygon(case["mean"], case["cov"], case["vertices"], rays=case["rays"], **options)


@pytest.mark.parametrize("name", KNOWN)
def test_hard_list_by_quadrature(name):
    of_mass, of_mean, of_cov = errors(solve(KNOWN[name], tolerance=0.0), KNOWN[name])
    assert of_mass < 2e-15
    assert of_mean < 2e-15
    assert of_cov < 2e-14


@pytest.mark.parametrize("name", KNOWN)
def test_hard_list_by_either_route(name):
    assert max(errors(solve(KNOWN[name]), KNOWN[name])) < 1e-13


@pytest.mark.parametrize("name", KNOWN)
def test_error_estimate_on_the_hard_list(name):
    case = KNOWN[name]
    shape = outline(np.array(case["vertices"]), case["rays"] and np.array(case["rays"]))
    rays = None if shape.rays is None else shape.rays[..., None]
    law = np.array(case["mean"])[:, None], np.array(case["cov"])[..., None]
    closed = edge_moments(Cases(*law, shape.x[:, None], shape.y[:, None], rays, shape.convex[None]))
    if np.isfinite(closed.estimate[0]):
        found = type("Found", (), {})()
        found.log_mass, found.mean, found.cov = (item[..., 0] for item in closed[:3])
        assert max(errors(found, case)) <= closed.estimate[0]


def star_polygons(kind, size, rng):
    """Random polygons (V, 2, size), mostly non-convex, and laws, of a kind."""
    corners = int(rng.integers(3, 9))
    step = 2 * np.pi / corners
    angles = step * (np.arange(corners)[:, None] + rng.uniform(-0.45, 0.45, (corners, size)))
    radii = rng.uniform(0.1, 1.0, (corners, size)) * 10.0 ** rng.uniform(-3, 2.5, size)
    x, y = radii * np.cos(angles), radii * np.sin(angles)
    centre = rng.normal(size=(2, size)) * rng.choice([1.0, 3.0], size)
    if kind == "slender":
        y = y * 10.0 ** rng.uniform(-6, 0, size)
    nudge = 10.0 ** rng.uniform(-14, 0, size) * rng.normal(size=(2, size))
    if kind == "vertex at the mean":
        centre = nudge - [x[0], y[0]]
    if kind == "edge at the mean":
        share = rng.uniform(size=size)
        centre = nudge - [share * v[0] + (1 - share) * v[1] for v in (x, y)]
    rho = rng.uniform(-0.95, 0.95, size)
    if kind == "nearly singular":
        rho = (1 - 10.0 ** rng.uniform(-13, -1, size)) * rng.choice([-1, 1], size)
    s = 10.0 ** rng.uniform(-0.5, 0.5, (2, size))
    cov = np.array([[s[0] ** 2, rho * s[0] * s[1]], [rho * s[0] * s[1], s[1] ** 2]])
    origin = 10.0 ** rng.integers(0, 6) if kind == "far from zero" else 0.0
    vertices = np.stack([x + centre[0], y + centre[1]], axis=1) + origin
    return np.full((2, size), origin), cov, vertices


@pytest.mark.parametrize(
    "kind",
    [
        "any",
        "slender",
        "vertex at the mean",
        "edge at the mean",
        "nearly singular",
        "far from zero",
    ],
)
def test_error_estimate_is_never_below_the_error(kind):
    rng = np.random.default_rng(sum(map(ord, kind)))
    accepted = 0
    for _ in range(6):
        mean, cov, vertices = star_polygons(kind, 200, rng)
        shape = outline(vertices, None)
        closed = edge_moments(Cases(mean, cov, shape.x, shape.y, None, shape.convex))
        robust = polygon(mean, cov, vertices, tolerance=0.0)
        judged = np.isfinite(closed.estimate)
        sd = np.sqrt(np.array([robust.cov[0, 0], robust.cov[1, 1]]))[:, judged]
        exact_mean, exact_cov = robust.mean[:, judged], robust.cov[:, :, judged]
        of_mass = np.abs(closed.log_mass - robust.log_mass)[judged]
        last_bits = 4 * np.spacing(np.abs(exact_mean))
        of_mean = (np.abs(closed.mean[:, judged] - exact_mean) - last_bits) / sd
        of_cov = np.abs(closed.cov[:, :, judged] - exact_cov) / (sd[:, None] * sd)
        error = np.maximum(of_mass, np.maximum(of_mean.max(axis=0), of_cov.max(axis=(0, 1))))
        assert (error <= closed.estimate[judged] + 2e-14).all()
        accepted += (closed.estimate <= 1e-12).sum()
    assert accepted > 50


def test_dblquad_agrees():
    mean, cov = np.array([0.2, -0.1]), np.array([[0.8, -0.3], [-0.3, 0.5]])
    precision = np.linalg.inv(cov)
    factor = np.sqrt(np.linalg.det(precision)) / (2 * np.pi)

    def integrand(y, x, i, j):
        d = np.array([x, y]) - mean
        return factor * x**i * y**j * np.exp(-0.5 * d @ precision @ d)

    found = polygon(mean, cov, [[0, 0], [1, 0], [0, 1]])
    second = found.second
    values = [found.mass, *found.first, second[0, 0], second[0, 1], second[1, 1]]
    powers = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
    for value, power in zip(values, powers, strict=True):
        direct = dblquad(integrand, 0, 1, 0, lambda x: 1 - x, args=power, epsabs=1e-12)[0]
        np.testing.assert_allclose(value, direct, atol=1e-12)


def test_monte_carlo_agrees_on_a_non_convex_region():
    rng = np.random.default_rng(3)
    count = 400_000
    x, y = rng.multivariate_normal([0.5, 0.5], TILTED, size=count).T
    # the chevron: a kite less the triangle bitten out of its right side
    inside = np.zeros(count, dtype=bool)
    for (a, b), (c, d) in zip(CHEVRON, np.roll(CHEVRON, -1, axis=0), strict=True):
        crossing = (b > y) != (d > y)
        if b != d:
            inside ^= crossing & (x < a + (c - a) * (y - b) / (d - b))
    found = polygon([0.5, 0.5], TILTED, CHEVRON)
    assert abs(inside.mean() - found.mass) < 4 * inside.std() / np.sqrt(count)
    for value, draws in ((found.mean[0], x[inside]), (found.mean[1], y[inside])):
        assert abs(draws.mean() - value) < 4 * draws.std() / np.sqrt(draws.size)
    product = (x[inside] - found.mean[0]) * (y[inside] - found.mean[1])
    assert abs(product.mean() - found.cov[0, 1]) < 4 * product.std() / np.sqrt(product.size)


def test_literal_lemma_3_on_random_polygons():
    rng = np.random.default_rng(5)
    for _ in range(300):
        corners = int(rng.integers(3, 7))
        angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
        if np.max(np.diff(angles, append=angles[0] + 2 * np.pi)) > 3:
            continue
        radii = rng.uniform(0.5, 2.0, corners)
        vertices = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)
        mean, s = rng.normal(size=2) * 0.7, rng.uniform(0.5, 1.5, 2)
        rho = rng.uniform(-0.8, 0.8)
        cov = np.array([[s[0] ** 2, rho * s[0] * s[1]], [rho * s[0] * s[1], s[1] ** 2]])
        points, _ = literal.change_of_variables(mean, cov, vertices)
        run = np.abs(np.roll(points, -1, axis=0) - points)
        if (run.min(axis=1) < 1e-3 * run.max(axis=1)).any():
            continue  # edges almost along an axis: the printed form loses its digits there
        mass, first, second = literal.lemma_3(mean, cov, vertices)
        found = polygon(mean, cov, vertices, about=mean)
        np.testing.assert_allclose(found.mass, mass, atol=2e-15)
        np.testing.assert_allclose(found.first, first, atol=1e-13)
        np.testing.assert_allclose(found.second, second, atol=5e-12)


def test_literal_lemma_3_with_special_edges():
    mean, cov = np.array([0.1, -0.2]), np.diag([1.0, 2.0])
    # parallel to the axes of (11): the four special rows of the table
    vertices = np.array([[0.0, -1.5], [1.5, 0.0], [0.0, 1.5], [-1.5, 0.0]]) * np.sqrt([1.0, 2.0])
    vertices = vertices + mean
    mass, first, second = literal.lemma_3(mean, cov, vertices)
    found = polygon(mean, cov, vertices, about=mean)
    np.testing.assert_allclose(found.mass, mass, rtol=1e-14)
    np.testing.assert_allclose(found.first, first, atol=1e-15)
    np.testing.assert_allclose(found.second, second, atol=1e-14)


def test_lemma_3_about_a_reference_point():
    """Q of (1) about Delta by quadrature: the sums alone are another matrix, moved they are it."""
    mean, cov = np.array([0.2, -0.1]), np.array([[0.8, -0.3], [-0.3, 0.5]])
    vertices, about = np.array([[0.0, 0.1], [1.3, -0.4], [1.0, 1.5]]), np.array([0.6, 0.9])
    u, w = (part / 2 for part in np.polynomial.legendre.leggauss(30))
    u = u + 0.5
    a, b = vertices[1] - vertices[0], vertices[2] - vertices[0]
    points = vertices[0] + u[:, None, None] * (a + u[:, None] * (b - a))
    white = points.reshape(-1, 2) - mean
    mass = ((u * w)[:, None] * w).ravel() * (a[0] * b[1] - a[1] * b[0])
    mass = mass * np.exp(-0.5 * (white @ np.linalg.inv(cov) * white).sum(axis=1))
    mass = mass / (2 * np.pi * np.sqrt(np.linalg.det(cov)))
    away = points.reshape(-1, 2) - about
    direct = (away * mass[:, None]).T @ away
    p, first, second = literal.lemma_3(mean, cov, vertices)
    moved = literal.about_a_point(p, first, second, mean, about)
    np.testing.assert_allclose(moved, direct, atol=1e-12)
    np.testing.assert_allclose(polygon(mean, cov, vertices, about).second, direct, atol=1e-12)
    assert np.abs(second - direct).max() > 0.05
    for faulty in np.diag([-2.0] * 5) + 1.0:  # the sign of each of the five sums
        found = literal.lemma_3(mean, cov, vertices, signs=faulty)
        moved = literal.about_a_point(*found, mean, about)
        assert np.abs(moved - direct).max() > 1e-3


def test_literal_lemma_3_fails_on_almost_special_edges():
    mean = np.array([0.03, 0.07])
    _, first, second = literal.lemma_3(mean, TILTED, SQUARE)
    found = polygon(mean, TILTED, SQUARE, about=mean)
    np.testing.assert_allclose(found.log_mass, -1.56673754436, atol=5e-12)
    assert np.abs(first - found.first).max() > 0.05
    assert np.abs(second - found.second).max() > 0.1


def test_order_of_vertices_decides_the_sign_in_the_literal_formulas_only():
    mean = np.array([0.03, 0.07])
    forward, backward = (literal.lemma_3(mean, TILTED, v)[0] for v in (SQUARE, SQUARE[::-1]))
    np.testing.assert_allclose(backward, -forward, rtol=1e-13)
    assert forward > 0
    one, other = (polygon(mean, TILTED, v) for v in (SQUARE, SQUARE[::-1]))
    np.testing.assert_allclose(other.log_mass, one.log_mass, rtol=1e-14)
    np.testing.assert_allclose(other.cov, one.cov, rtol=1e-13)


def test_first_and_second_moments_follow_from_the_mass():
    """Given P, the rest of lemma 3 is elementary and linear in it."""
    mean, cov = np.array([0.3, -0.2]), np.array([[1.2, 0.4], [0.4, 0.7]])
    vertices = np.array([[0.0, 0.1], [1.3, -0.4], [1.0, 1.5], [-0.6, 0.9]])
    found = polygon(mean, cov, vertices, about=mean)
    _, first, second = literal.lemma_3(mean, cov, vertices, p=float(found.mass))
    np.testing.assert_allclose(found.first, first, atol=1e-15)
    np.testing.assert_allclose(found.second, second, atol=1e-14)
    _, moved_first, moved_second = literal.lemma_3(mean, cov, vertices, p=found.mass + 0.01)
    np.testing.assert_allclose(moved_first - first, 0.01 * mean, atol=1e-15)
    np.testing.assert_allclose(moved_second - second, 0.01 * cov, atol=1e-15)


def partition(rng, sectors):
    """A star polygon cut into triangles at an apex, and the unbounded cells around it."""
    step = 2 * np.pi / sectors
    angles = step * (np.arange(sectors) + rng.uniform(-0.3, 0.3, sectors))
    away = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    apex = rng.normal(size=2)
    rim = apex + away * rng.uniform(0.3, 3.0, (sectors, 1))
    cells = []
    for i in range(sectors):
        j = (i + 1) % sectors
        cells.append((np.array([apex, rim[i], rim[j]]), None))
        cells.append((np.array([rim[j], rim[i]]), np.array([away[j], away[i]])))
    return cells


LAWS = {
    "regular": np.array([[1.5, -0.6], [-0.6, 0.8]]),
    "nearly singular": np.array([[1.0, 1.0 - 1e-12], [1.0 - 1e-12, 1.0]]),
    "on a line": np.outer([1.2, -0.5], [1.2, -0.5]),
    "on a horizontal line": np.diag([2.0, 0.0]),
    "a point": np.zeros((2, 2)),
}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("tolerance", [0.0, 1e-12])
def test_partition_of_the_plane_sums_to_the_law(law, tolerance):
    rng = np.random.default_rng(11)
    cov = LAWS[law]
    for sectors in (3, 4, 5, 8):
        mean, about = rng.normal(size=2), np.array([0.5, -1.0])
        total = [0.0, np.zeros(2), np.zeros((2, 2))]
        for vertices, rays in partition(rng, sectors):
            found = polygon(mean, cov, vertices, about, rays=rays, tolerance=tolerance)
            total = [
                a + b for a, b in zip(total, (found.mass, found.first, found.second), strict=True)
            ]
        np.testing.assert_allclose(total[0], 1.0, rtol=1e-13)
        np.testing.assert_allclose(total[1], mean, atol=1e-13)
        np.testing.assert_allclose(total[2], cov + np.outer(mean - about, mean - about), atol=1e-13)


@pytest.mark.parametrize("tolerance", [0.0, 1e-12])
def test_wedges_at_one_apex_sum_to_one(tolerance):
    rays = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    wedges = np.stack([[rays[(i + 1) % 4], rays[i]] for i in range(4)], axis=-1)
    found = polygon([0.1, -0.7], TILTED, [[0.3, 0.2]], rays=wedges, tolerance=tolerance)
    np.testing.assert_allclose(found.mass.sum(), 1.0, rtol=1e-15)


@pytest.mark.parametrize("rho", [-0.9, -0.5, 0.0, 0.3, 0.99])
def test_quadrant_at_the_mean_has_sheppard_s_probability(rho):
    cov = [[4.0, 2 * rho], [2 * rho, 1.0]]
    found = polygon([1.0, 2.0], cov, [[1.0, 2.0]], rays=[[0, 1], [1, 0]])
    np.testing.assert_allclose(found.mass, 0.25 + np.arcsin(rho) / (2 * np.pi), rtol=1e-14)


@pytest.mark.parametrize("tolerance", [0.0, 1e-12])
@pytest.mark.parametrize("angle", [0.0, 0.4, 2.0, 3.9])
@pytest.mark.parametrize("offset", [-2.0, 0.0, 3.0, 25.0])
def test_half_plane_is_an_interval_across_it(angle, offset, tolerance):
    mean, cov = np.array([0.5, -0.3]), np.array([[1.3, 0.4], [0.4, 0.6]])
    normal = np.array([np.cos(angle), np.sin(angle)])
    along = np.array([normal[1], -normal[0]])  # the region, normal . x > offset, on the left
    found = polygon(mean, cov, [offset * normal], rays=[-along, along], tolerance=tolerance)
    sigma2 = normal @ cov @ normal
    line = interval(normal @ mean, sigma2, offset, np.inf)
    gain = cov @ normal / sigma2
    np.testing.assert_allclose(found.log_mass, line.log_mass, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(found.mean, mean + gain * (line.mean - normal @ mean), atol=1e-13)
    np.testing.assert_allclose(
        found.cov, cov - np.outer(gain, gain) * (sigma2 - line.cov), atol=1e-13
    )


def test_boxes_are_products_of_intervals():
    rng = np.random.default_rng(2)
    lower = rng.normal(size=(2, 400)) * 3
    upper = lower + 10.0 ** rng.uniform(-9, 1, size=(2, 400))
    vertices = np.array(
        [[lower[0], lower[1]], [upper[0], lower[1]], [upper[0], upper[1]], [lower[0], upper[1]]]
    )
    var = np.array([1.0, 2.5])
    found = polygon([0.2, -0.1], np.diag(var), vertices)
    sides = [
        interval(m, v, a, b) for m, v, a, b in zip([0.2, -0.1], var, lower, upper, strict=True)
    ]
    np.testing.assert_allclose(found.log_mass, sides[0].log_mass + sides[1].log_mass, rtol=3e-14)
    for i in range(2):
        off = np.abs(found.mean[i] - sides[i].mean) - 2 * np.spacing(np.abs(found.mean[i]))
        assert (off < 3e-13 * np.sqrt(sides[i].cov)).all()
        np.testing.assert_allclose(found.cov[i, i], sides[i].cov, rtol=1e-12)
    assert (np.abs(found.cov[0, 1]) < 1e-12 * np.sqrt(sides[0].cov * sides[1].cov)).all()


def test_quadrant_far_out():
    found = polygon([0, 0], UNIT, [[9, 9]], rays=[[0, 1], [1, 0]])
    np.testing.assert_allclose(found.log_mass, 2 * np.log(ndtr(-9.0)), rtol=1e-14)


def test_affine_maps_carry_the_moments_along():
    rng = np.random.default_rng(6)
    mean = np.array([0.4, 0.1])
    for _ in range(20):
        matrix, shift = rng.normal(size=(2, 2)), rng.normal(size=2)
        here = polygon(mean, TILTED, CHEVRON)
        there = polygon(
            matrix @ mean + shift, matrix @ TILTED @ matrix.T, CHEVRON @ matrix.T + shift
        )
        np.testing.assert_allclose(there.log_mass, here.log_mass, atol=1e-12)
        np.testing.assert_allclose(there.mean, matrix @ here.mean + shift, atol=1e-12)
        np.testing.assert_allclose(there.cov, matrix @ here.cov @ matrix.T, atol=1e-12)


@pytest.mark.parametrize("tolerance", [0.0, 1e-12])
def test_first_vertex_orientation_and_padding_do_not_matter(tolerance):
    mean = [0.4, 0.1]
    here = polygon(mean, TILTED, CHEVRON, tolerance=tolerance)
    padded = np.repeat(CHEVRON, [1, 3, 1, 2, 4], axis=0)
    for vertices in (np.roll(CHEVRON, 2, axis=0), CHEVRON[::-1], padded, padded[::-1]):
        there = polygon(mean, TILTED, vertices, tolerance=tolerance)
        np.testing.assert_allclose(there.log_mass, here.log_mass, atol=3e-15)
        np.testing.assert_allclose(there.mean, here.mean, atol=1e-14)
        np.testing.assert_allclose(there.cov, here.cov, atol=1e-14)


def test_batch_axes_broadcast_and_agree_with_single_calls():
    rng = np.random.default_rng(7)
    regions = pad_regions([SQUARE, CHEVRON, box(4, 5, -1, 1)])
    assert regions.shape == (5, 2, 3)
    mean = rng.normal(size=(2, 3, 4))
    scale = np.array([1.0, 1e-3, 5.0, 0.2])
    cov = TILTED[:, :, None] * scale
    found = polygon(mean, cov, regions[..., None], about=[1.0, 2.0])
    assert found.log_mass.shape == (3, 4)
    assert found.mean.shape == found.first.shape == (2, 3, 4)
    assert found.cov.shape == found.second.shape == (2, 2, 3, 4)
    for r in range(3):
        for k in range(4):
            one = polygon(mean[:, r, k], cov[:, :, k], regions[:, :, r], about=[1.0, 2.0])
            assert one.log_mass.shape == ()
            np.testing.assert_allclose(found.log_mass[r, k], one.log_mass, rtol=1e-13)
            np.testing.assert_allclose(found.mean[:, r, k], one.mean, rtol=1e-12)
            np.testing.assert_allclose(
                found.second[:, :, r, k], one.second, rtol=1e-12, atol=1e-300
            )


def test_bounded_and_unbounded_regions_in_one_batch():
    vertices = np.stack([box(0, 1, 0, 1), np.repeat([[1.0, 0.0]], 4, axis=0)], axis=-1)
    rays = np.zeros((2, 2, 2))
    rays[:, :, 1] = [[0.0, 1.0], [1.0, 0.0]]
    for tolerance in (0.0, 1e-12):
        found = polygon([0, 0], UNIT, vertices, rays=rays, tolerance=tolerance)
        inside, beyond = interval(0, 1, 0, 1).mass, interval(0, 1, 1, np.inf).mass
        np.testing.assert_allclose(found.mass, [inside**2, beyond / 2], rtol=1e-14)


def test_batch_larger_than_a_block():
    mean = np.zeros((2, 9000))
    mean[0] = np.linspace(-3, 3, 9000)
    for tolerance, size in ((1e-12, 9000), (0.0, 2500)):
        found = polygon(mean[:, :size], UNIT, SQUARE, tolerance=tolerance)
        one = polygon(mean[:, size - 1], UNIT, SQUARE, tolerance=tolerance)
        np.testing.assert_allclose(found.cov[..., -1], one.cov, rtol=1e-13)


@pytest.mark.parametrize("shape", [(0,), (3, 0)])
def test_empty_batches(shape):
    found = polygon(np.zeros((2, *shape)), UNIT, SQUARE)
    assert found.mean.shape == (2, *shape)
    assert polygon([0, 0], UNIT, np.zeros((4, 2, *shape))).cov.shape == (2, 2, *shape)


def sliced(mean, direction, vertices):
    """Intervals of the parameter s in which ``mean + s direction`` is inside, in fractions."""
    m, g = ([Fraction(float(v)) for v in pair] for pair in (mean, direction))
    points = [[Fraction(float(v)) - c for v, c in zip(p, m, strict=True)] for p in vertices]
    crossings = []
    for a, b in zip(points, points[1:] + points[:1], strict=True):
        side_a, side_b = (g[0] * p[1] - g[1] * p[0] for p in (a, b))
        if (side_a > 0) != (side_b > 0):
            share = side_a / (side_a - side_b)
            at = [p + share * (q - p) for p, q in zip(a, b, strict=True)]
            crossings.append(at[0] / g[0] if g[0] else at[1] / g[1])
    crossings.sort()
    return [(float(a), float(b)) for a, b in zip(crossings[::2], crossings[1::2], strict=True)]


@pytest.mark.parametrize("direction", [(1.2, -0.5), (0.3, 2.0), (1.0, 0.0), (0.0, 0.7)])
def test_law_on_a_line_is_a_sum_of_intervals(direction):
    comb = np.array(KNOWN["comb"]["vertices"], dtype=float)
    direction = np.array(direction)
    for mean in ([1.3, 2.1], [2.7, 0.4], [-9.0, 3.1], [2.2, 13.0]):
        found = polygon(mean, np.outer(direction, direction), comb)
        pieces = [interval(0.0, 1.0, *ends) for ends in sliced(mean, direction, comb)]
        if not pieces:
            assert found.log_mass == -np.inf
            assert np.isnan(found.mean).all()
            continue
        mass = sum(p.mass for p in pieces)
        centre = sum(p.first for p in pieces) / mass
        square = sum(p.referred_to(centre).second for p in pieces) / mass
        np.testing.assert_allclose(found.mass, mass, rtol=1e-13)
        np.testing.assert_allclose(found.mean, mean + direction * centre, rtol=1e-12)
        np.testing.assert_allclose(found.cov, square * np.outer(direction, direction), rtol=1e-11)


def test_law_on_a_line_in_the_tail():
    found = polygon([0, 0], np.outer([1.0, 1.0], [1.0, 1.0]), box(500.0, 501.0, 400.0, 600.0))
    line = interval(0.0, 1.0, 500.0, 501.0)
    np.testing.assert_allclose(found.log_mass, line.log_mass, rtol=1e-15)
    np.testing.assert_allclose(found.mean, [line.mean] * 2, rtol=1e-15)
    np.testing.assert_allclose(found.cov, np.full((2, 2), line.cov), rtol=1e-13)


def test_singular_law_is_the_limit_of_regular_ones():
    direction = np.array([1.2, -0.5])
    line = polygon([0.3, 0.2], np.outer(direction, direction), CHEVRON)
    for tiny in (1e-6, 1e-8, 1e-10):
        near = polygon([0.3, 0.2], np.outer(direction, direction) + tiny * UNIT, CHEVRON)
        assert abs(near.mass - line.mass) < 3 * np.sqrt(tiny)
        assert np.abs(near.cov - line.cov).max() < 3 * np.sqrt(tiny)


def test_unbounded_regions_under_singular_laws():
    line = interval(0.3, 1.0, 0.0, np.inf)
    cov = np.array([[1.0, 1.0], [1.0, 1.0]])
    found = polygon([0.3, 0.4], cov, [[0.0, 0.0]], rays=[[0, 1], [1, 0]])
    np.testing.assert_allclose(found.mass, line.mass, rtol=1e-14)
    whole = polygon([0.3, 0.4], cov, [[-1.0, 5.0]], rays=[[-1, -1], [1, 1]])
    assert whole.mass == 0.0
    other = polygon([0.3, 0.4], cov, [[-1.0, 5.0]], rays=[[1, 1], [-1, -1]])
    assert other.mass == 1.0


def test_a_point_on_a_corner_belongs_to_one_cell():
    cells = np.stack([box(x, x + 1, y, y + 1) for x in (-1.0, 0.0) for y in (-1.0, 0.0)], axis=-1)
    for point in ([0.0, 0.0], [0.5, 0.0], [0.0, -0.5], [0.25, 0.75]):
        found = polygon(point, np.zeros((2, 2)), cells)
        assert found.mass.sum() == 1.0
        kept = found.mass == 1.0
        np.testing.assert_array_equal(found.mean[:, kept][:, 0], point)
        assert not found.cov[:, :, kept].any()


def test_law_along_a_common_edge_belongs_to_one_cell():
    cells = np.stack([box(-1, 1, -1, 0), box(-1, 1, 0, 1)], axis=-1)
    found = polygon([0.2, 0.0], np.diag([1.0, 0.0]), cells)
    whole = interval(0.2, 1.0, -1, 1).mass
    np.testing.assert_allclose(np.sort(found.mass), [0.0, whole], rtol=1e-14)


def test_conditioned_law_is_inside_the_hull_and_has_a_covariance():
    rng = np.random.default_rng(9)
    for _ in range(5):
        mean, cov, vertices = star_polygons("slender", 200, rng)
        found = polygon(mean, cov, vertices)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        margin = 1e-12 * (high - low) + 4 * np.spacing(np.abs(vertices).max(axis=0))
        assert (found.mean >= low - margin).all()
        assert (found.mean <= high + margin).all()
        assert (found.cov[0, 0] > 0).all()
        assert (found.cov[0, 1] ** 2 <= found.cov[0, 0] * found.cov[1, 1] * (1 + 1e-11)).all()
        assert (found.log_mass <= 0).all()


def test_collinear_vertices():
    finer = np.array([[0, 0], [0.25, 0], [1, 0], [1, 0.5], [1, 1], [0, 1.0]])
    np.testing.assert_allclose(
        polygon([0.2, 0.1], TILTED, finer).cov,
        polygon([0.2, 0.1], TILTED, box(0, 1, 0, 1)).cov,
        rtol=1e-13,
    )


def test_beyond_all_exponents():
    for tolerance in (0.0, 1e-12):
        found = polygon([0, 0], 1e-60 * UNIT, [[1, -1], [3, -1], [3, 1]], tolerance=tolerance)
        assert found.log_mass == -np.inf
        assert np.isnan(found.mean).all()
        np.testing.assert_array_equal(found.first, [0.0, 0.0])
        sure = polygon([0, 0], 1e-60 * UNIT, [[-1, -1], [3, -1], [1, 3]], tolerance=tolerance)
        np.testing.assert_allclose(sure.cov, 1e-60 * UNIT, rtol=1e-13, atol=1e-75)


def test_very_distant_vertices():
    for size in (1e12, 1e15, 1e17):
        wedge = polygon([0, 0], TILTED, [[0.3, 0.7], [size, -0.3 * size], [size, 2 * size]])
        limit = polygon([0, 0], TILTED, [[0.3, 0.7]], rays=[[1, 2], [1, -0.3]])
        np.testing.assert_allclose(wedge.log_mass, limit.log_mass, atol=3 / size + 1e-13)
    with pytest.raises(ValueError, match="given by rays"):
        polygon([0, 0], TILTED, [[0.3, 0.7], [1e30, -3e29], [1e30, 2e30]])


REFUSED = {
    "bow tie": ([[0, 0], [1, 1], [1, 0], [0, 1]], "touches or crosses"),
    "touching vertex": ([[0, 0], [2, 0], [2, 2], [1, 0], [0, 2]], "touches or crosses"),
    "pentagram": ([[0, 3], [2, -2], [-3, 1], [3, 1], [-2, -2]], "touches or crosses"),
    "vertex twice": ([[0, 0], [1, 1], [2, 0], [2, 3], [1, 1], [0, 3]], "touches or crosses"),
    "edge twice": ([[0, 0], [2, 0], [2, 1], [3, 1], [3, 0], [1, 0], [1, -1]], "touches or crosses"),
    "two vertices": ([[0, 0], [1, 1]], "degenerate"),
    "one vertex": ([[1, 1]], "degenerate"),
    "repeated": ([[0, 0], [1, 1], [1, 1], [0, 0]], "degenerate"),
    "no area": ([[0, 0], [1, 1], [3, 3]], "degenerate"),
    "spike": ([[0, 0], [2, 0], [1, 0], [1, 1]], "degenerate"),
    "slit of width zero": ([[0, 0], [3, 0], [3, 3], [1, 1], [2, 2], [0, 3]], "degenerate|touches"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_polygons_that_are_refused(name):
    vertices, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        polygon([0, 0], UNIT, vertices)
    with pytest.raises(ValueError, match=message):
        polygon([0, 0], UNIT, np.array(vertices[::-1]) * 1e-9 + 5.0)


@pytest.mark.parametrize(
    ("vertices", "rays", "message"),
    [
        ([[0, 0]], [[1, 0], [1, 0]], "degenerate"),
        ([[0, 0], [0, 1]], [[1, 1], [1, -1]], "touches or crosses"),
        ([[0, 0], [0, 1]], [[1, 1e-9], [1, -1e-9]], "touches or crosses"),
        ([[0, 1], [0, 0], [2, 0]], [[1, 0], [0, 1]], "touches or crosses"),
        ([[0, 0], [1, 0], [-1, 0]], [[0, 1], [0, -1]], "degenerate"),
        ([[0, 0], [1, 0]], [[1, 0], [0, 0]], "rays: wanted two nonzero"),
    ],
)
def test_unbounded_regions_that_are_refused(vertices, rays, message):
    with pytest.raises(ValueError, match=message):
        polygon([0, 0], UNIT, vertices, rays=rays)


def test_refusal_names_the_element_of_the_batch():
    batch = np.repeat(box(0, 1, 0, 1)[:, :, None, None], 3, axis=2)
    batch[:, :, 2, 0] = [[0, 0], [1, 1], [1, 0], [0, 1]]
    with pytest.raises(ValueError, match=r"batch index \(2, 0\)"):
        polygon([0, 0], UNIT, batch)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mean": [0.0, np.nan]}, "mean"),
        ({"mean": [0.0, 0.0, 0.0]}, "mean: wanted shape"),
        ({"mean": 0.0}, "mean: wanted shape"),
        ({"cov": [[1.0, 0.0], [0.0, np.inf]]}, "cov"),
        ({"cov": np.eye(3)}, "cov: wanted shape"),
        ({"cov": [[1.0, 0.5], [0.4, 1.0]]}, "cov: wanted a symmetric"),
        ({"cov": [[1.0, 1.1], [1.1, 1.0]]}, "cov: wanted a positive semidefinite"),
        ({"cov": [[-1.0, 0.0], [0.0, 1.0]]}, "cov: wanted nonnegative variances"),
        ({"cov": [[0.0, 0.5], [0.5, 1.0]]}, "cov: wanted a positive semidefinite"),
        ({"vertices": [[0.0, 0.0], [1.0, np.nan], [0.0, 1.0]]}, "vertices"),
        ({"vertices": [[0.0, 0.0, 0.0]]}, "vertices: wanted shape"),
        ({"vertices": [0.0, 1.0]}, "vertices: wanted shape"),
        ({"vertices": np.zeros((0, 2))}, "vertices: wanted shape"),
        (
            {"vertices": box(0, 1, 0, 1)[:, :, None] * np.ones(4), "mean": np.zeros((2, 3))},
            "broadcast",
        ),
        ({"rays": [[1.0, 0.0]]}, "rays: wanted shape"),
        ({"rays": [[1.0, 0.0], [np.inf, 0.0]]}, "rays"),
        ({"about": [1.0, 2.0, 3.0]}, "about"),
        ({"about": np.zeros((2, 5)), "mean": np.zeros((2, 3))}, "about"),
        ({"tolerance": np.nan}, "tolerance"),
        ({"tolerance": -1.0}, "tolerance"),
    ],
)
def test_bad_values(change, message):
    arguments = {"mean": [0.0, 0.0], "cov": UNIT, "vertices": SQUARE, **change}
    with pytest.raises(ValueError, match=message):
        polygon(**arguments)


def test_bad_types():
    with pytest.raises(TypeError, match="vertices"):
        polygon([0, 0], UNIT, [["a", "b"]] * 3)
    with pytest.raises(TypeError, match="vertices"):
        polygon([0, 0], UNIT, [[0, 1], [2]])
    with pytest.raises(TypeError, match="mean"):
        polygon([0, 1j], UNIT, SQUARE)


def test_padding_of_regions():
    padded = pad_regions([SQUARE[:3], CHEVRON])
    assert padded.shape == (5, 2, 2)
    np.testing.assert_array_equal(padded[3:, :, 0], SQUARE[[2, 2]])
    with pytest.raises(ValueError, match="at least one region"):
        pad_regions([])
    with pytest.raises(ValueError, match=r"regions\[1\]"):
        pad_regions([SQUARE, [[1.0, 2.0, 3.0]]])
