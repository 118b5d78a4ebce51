"""Moments of Gaussian distributions in the plane over polygons and unbounded regions."""

import json
from decimal import Decimal, localcontext
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from oracles import polygon_reference
from seedslib.gaussian import interval, pad_regions, polygon

KNOWN = json.loads(Path(polygon_reference.__file__).with_suffix(".json").read_text())
ABSURD = "strip", "needle", "huge", "thin", "1e-10", "1e-12", "1e-14", "1e8"
EXTREME = {name for name in KNOWN if any(part in name for part in ABSURD)}
EXTREME |= {f"random {k}" for k in (0, 3, 5, 6, 7, 9, 20, 21, 22, 24, 29, 30, 33)}
"""A rounding of a vertex or of the distribution changes the moments in the twelfth digit or
before."""

UNIT = np.eye(2)
TILTED = np.array([[1.0, 0.3], [0.3, 1.0]])
SQUARE = np.array([[0.1, 0.9], [-0.7, 0.1], [0.2, -0.8], [1.0, 0.0]])
CHEVRON = np.array([[0.0, 0.0], [2.0, -1.0], [1.0, 1.0], [2.0, 3.0], [-1.0, 1.0]])


def box(x0, x1, y0, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def largest_error(found, case):
    """Error of ln P (relative beyond one), of the mean (in deviations), of the covariance."""
    with localcontext() as context:
        context.prec = 60
        log_mass = Decimal(case["log_mass"])
        mean = [Decimal(text) for text in case["moment_mean"]]
        cov = [Decimal(text) for text in case["moment_cov"]]
        sd = [cov[0].sqrt(), cov[2].sqrt()]
        units = [cov[0], sd[0] * sd[1], cov[2]]
        entries = [found.cov[0, 0], found.cov[0, 1], found.cov[1, 1]]
        of_mass = abs(Decimal(float(found.log_mass)) - log_mass) / max(1, abs(log_mass))
        of_mean = (  # less four last bits
            (abs(Decimal(float(a)) - b) - Decimal(4 * float(np.spacing(abs(float(b)))))) / s
            for a, b, s in zip(found.mean, mean, sd, strict=True)
        )
        of_cov = (
            abs(Decimal(float(a)) - b) / u for a, b, u in zip(entries, cov, units, strict=True)
        )
        return float(max(of_mass, *of_mean, *of_cov))


@pytest.mark.parametrize("name", KNOWN)
def test_polygon_against_fifty_digits(name):
    case = KNOWN[name]
    found = polygon(case["mean"], case["cov"], case["vertices"], rays=case["rays"])
    assert largest_error(found, case) < (1e-6 if name in EXTREME else 1e-13)


def partition(rng, sectors):
    """A star polygon cut into triangles at an apex, and the unbounded cells around it."""
    step = 2 * np.pi / sectors
    angles = step * (np.arange(sectors) + rng.uniform(-0.3, 0.3, sectors))
    away = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    apex = rng.normal(size=2)
    rim = apex + away * rng.uniform(0.3, 3.0, (sectors, 1))
    for i in range(sectors):
        j = (i + 1) % sectors
        yield np.array([apex, rim[i], rim[j]]), None
        yield np.array([rim[j], rim[i]]), np.array([away[j], away[i]])


LAWS = {
    "regular": np.array([[1.5, -0.6], [-0.6, 0.8]]),
    "nearly singular": np.array([[1.0, 1.0 - 1e-9], [1.0 - 1e-9, 1.0]]),
    "on a line": np.outer([1.2, -0.5], [1.2, -0.5]),
    "on a horizontal line": np.diag([2.0, 0.0]),
    "a point": np.zeros((2, 2)),
}


@pytest.mark.parametrize("dist", LAWS)
def test_cells_of_a_partition_of_the_plane_sum_to_the_distribution(dist):
    rng = np.random.default_rng(11)
    cov = LAWS[dist]
    for sectors in (3, 4, 5, 8):
        mean, about = rng.normal(size=2), np.array([0.5, -1.0])
        cells = [
            polygon(mean, cov, vertices, rays=rays) for vertices, rays in partition(rng, sectors)
        ]
        bound = 1e-11 if dist == "nearly singular" else 1e-13
        np.testing.assert_allclose(sum(c.mass for c in cells), 1.0, rtol=bound)
        np.testing.assert_allclose(sum(c.first for c in cells), mean, atol=bound)
        exact = cov + np.outer(mean - about, mean - about)
        np.testing.assert_allclose(sum(c.second(about) for c in cells), exact, atol=bound)


@pytest.mark.parametrize("angle", [0.0, 0.4, 2.0, 3.9])
@pytest.mark.parametrize("offset", [-2.0, 0.0, 3.0, 25.0])
def test_half_plane_is_an_interval_across_it(angle, offset):
    mean, cov = np.array([0.5, -0.3]), np.array([[1.3, 0.4], [0.4, 0.6]])
    normal = np.array([np.cos(angle), np.sin(angle)])
    along = np.array([normal[1], -normal[0]])  # the region, normal . x > offset, on the left
    found = polygon(mean, cov, [offset * normal], rays=[-3e4 * along, 1e-3 * along])
    var = normal @ cov @ normal
    line = interval(normal @ mean, var, offset, np.inf)
    gain = cov @ normal / var
    np.testing.assert_allclose(found.log_mass, line.log_mass, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(found.mean, mean + gain * (line.mean - normal @ mean), atol=1e-13)
    exact = cov - np.outer(gain, gain) * (var - line.cov)
    np.testing.assert_allclose(found.cov, exact, atol=1e-13)


def test_boxes_are_products_of_intervals():
    rng = np.random.default_rng(2)
    lower = rng.normal(size=(2, 400)) * 3
    upper = lower + 10.0 ** rng.uniform(-7, 1, size=(2, 400))
    mean, var = [0.2, -0.1], np.array([1.0, 2.5])
    found = polygon(mean, np.diag(var), box(lower[0], upper[0], lower[1], upper[1]))
    sides = [interval(*side) for side in zip(mean, var, lower, upper, strict=True)]
    np.testing.assert_allclose(found.log_mass, sides[0].log_mass + sides[1].log_mass, rtol=3e-14)
    for i in range(2):
        off = np.abs(found.mean[i] - sides[i].mean) - 2 * np.spacing(np.abs(found.mean[i]))
        assert (off < 3e-13 * np.sqrt(sides[i].cov)).all()
        np.testing.assert_allclose(found.cov[i, i], sides[i].cov, rtol=1e-12)
    assert (np.abs(found.cov[0, 1]) < 1e-12 * np.sqrt(sides[0].cov * sides[1].cov)).all()


def test_first_vertex_orientation_and_padding_do_not_matter():
    mean = [0.4, 0.1]
    one = polygon(mean, TILTED, CHEVRON)
    padded = np.repeat(CHEVRON, [1, 3, 1, 2, 4], axis=0)
    finer = np.insert(CHEVRON, 1, 0.25 * CHEVRON[0] + 0.75 * CHEVRON[1], axis=0)
    for vertices in (np.roll(CHEVRON, 2, axis=0), CHEVRON[::-1], padded, padded[::-1], finer):
        other = polygon(mean, TILTED, vertices)
        np.testing.assert_allclose(other.log_mass, one.log_mass, atol=3e-15)
        np.testing.assert_allclose(other.mean, one.mean, atol=1e-14)
        np.testing.assert_allclose(other.cov, one.cov, atol=1e-14)


def test_batches_of_distributions_and_padded_regions_equal_single_calls():
    rng = np.random.default_rng(7)
    tables = [SQUARE, CHEVRON, box(4, 5, -1, 1)]
    regions = pad_regions(tables)
    assert regions.shape == (5, 2, 3)
    mean = rng.normal(size=(2, 3, 4))
    cov = TILTED[:, :, None] * np.array([1.0, 1e-3, 5.0, 0.2])
    found = polygon(mean, cov, regions[..., None])
    assert found.log_mass.shape == (3, 4)
    for r, k in np.ndindex(3, 4):
        one = polygon(mean[:, r, k], cov[:, :, k], tables[r])
        np.testing.assert_allclose(found.log_mass[r, k], one.log_mass, rtol=1e-13)
        np.testing.assert_allclose(found.mean[:, r, k], one.mean, rtol=1e-12)
        np.testing.assert_allclose(
            found.second([1.0, 2.0])[:, :, r, k], one.second([1.0, 2.0]), rtol=1e-12, atol=1e-300
        )
    for shape in ((0,), (3, 0)):
        assert polygon(np.zeros((2, *shape)), UNIT, SQUARE).mean.shape == (2, *shape)
        assert polygon([0, 0], UNIT, np.zeros((4, 2, *shape))).cov.shape == (2, 2, *shape)


def test_large_batches_and_batches_of_unlike_regions():
    size = 9000
    mean = np.stack([np.linspace(-3, 3, size), np.zeros(size)])
    found = polygon(mean, UNIT, SQUARE)
    one = polygon(mean[:, -1], UNIT, SQUARE)
    np.testing.assert_allclose(found.cov[..., -1], one.cov, rtol=1e-13)
    # bounded and unbounded ones together
    vertices = np.stack([box(0, 1, 0, 1), np.repeat([[1.0, 0.0]], 4, axis=0)], axis=-1)
    rays = np.zeros((2, 2, 2))
    rays[:, :, 1] = [[0.0, 1.0], [1.0, 0.0]]
    found = polygon([0, 0], UNIT, vertices, rays=rays)
    inside, beyond = interval(0, 1, 0, 1).mass, interval(0, 1, 1, np.inf).mass
    np.testing.assert_allclose(found.mass, [inside**2, beyond / 2], rtol=1e-14)


# Distributions on a line and at a point


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
def test_distribution_on_a_line_is_a_sum_of_intervals(direction):
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
        square = sum(p.second(centre) for p in pieces) / mass
        np.testing.assert_allclose(found.mass, mass, rtol=1e-13)
        np.testing.assert_allclose(found.mean, mean + direction * centre, rtol=1e-12)
        np.testing.assert_allclose(found.cov, square * np.outer(direction, direction), rtol=1e-11)
    tail = polygon([0, 0], np.ones((2, 2)), box(500.0, 501.0, 400.0, 600.0))
    line = interval(0.0, 1.0, 500.0, 501.0)
    np.testing.assert_allclose(tail.log_mass, line.log_mass, rtol=1e-15)
    np.testing.assert_allclose(tail.cov, np.full((2, 2), line.cov), rtol=1e-13)


def test_distribution_on_a_line_over_unbounded_regions():
    cov = np.ones((2, 2))
    found = polygon([0.3, 0.4], cov, [[0.0, 0.0]], rays=[[0, 1], [1, 0]])
    np.testing.assert_allclose(found.mass, interval(0.3, 1.0, 0.0, np.inf).mass, rtol=1e-13)
    for rays, mass in (([[-1, -1], [1, 1]], 0.0), ([[1, 1], [-1, -1]], 1.0)):
        assert polygon([0.3, 0.4], cov, [[-1.0, 5.0]], rays=rays).mass == mass


def test_points_and_lines_on_an_edge_belong_to_one_cell():
    cells = np.stack([box(x, x + 1, y, y + 1) for x in (-1.0, 0.0) for y in (-1.0, 0.0)], axis=-1)
    for point in ([0.0, 0.0], [0.5, 0.0], [0.0, -0.5], [0.25, 0.75]):
        found = polygon(point, np.zeros((2, 2)), cells)
        assert found.mass.sum() == 1.0
        chosen = found.mass == 1.0
        np.testing.assert_array_equal(found.mean[:, chosen][:, 0], point)
        assert not found.cov[:, :, chosen].any()
    found = polygon(
        [0.2, 0.0], np.diag([1.0, 0.0]), np.stack([box(-1, 1, -1, 0), box(-1, 1, 0, 1)], axis=-1)
    )
    whole = interval(0.2, 1.0, -1, 1).mass
    np.testing.assert_allclose(np.sort(found.mass), [0.0, whole], rtol=1e-14)


# Ends of the range, and what is no polygon


def test_region_beyond_all_exponents_has_no_mass():
    found = polygon([0, 0], 1e-60 * UNIT, [[1, -1], [3, -1], [3, 1]])
    assert found.log_mass == -np.inf
    assert np.isnan(found.mean).all()
    np.testing.assert_array_equal(found.first, [0.0, 0.0])
    sure = polygon([0, 0], 1e-60 * UNIT, [[-1, -1], [3, -1], [1, 3]])
    np.testing.assert_allclose(sure.cov, 1e-60 * UNIT, rtol=1e-13, atol=1e-75)


def test_distant_vertices_are_like_rays():
    limit = polygon([0, 0], TILTED, [[0.3, 0.7]], rays=[[1, 2], [1, -0.3]])
    for size in (1e12, 1e15, 1e30):
        wedge = polygon([0, 0], TILTED, [[0.3, 0.7], [size, -0.3 * size], [size, 2 * size]])
        np.testing.assert_allclose(wedge.log_mass, limit.log_mass, atol=3 / size + 1e-13)
        np.testing.assert_allclose(wedge.mean, limit.mean, atol=3 / size + 1e-13)
        np.testing.assert_allclose(wedge.cov, limit.cov, atol=3 / size + 1e-13)


CROSSED = {
    "bow tie": [[0, 0], [1, 1], [1, 0], [0, 1]],
    "plus": [[0, 1], [3, 1], [3, 3], [2, 3], [2, 0], [0, 0]],
    "pentagram": [[0, 3], [2, -2], [-3, 1], [3, 1], [-2, -2]],
}
FLAT = {
    "two vertices": [[0, 0], [1, 1]],
    "one vertex": [[1, 1]],
    "repeated": [[0, 0], [1, 1], [1, 1], [0, 0]],
    "no area": [[0, 0], [1, 1], [3, 3]],
}
TOUCHING = {  # and the simple parts that an odd number of edges separates from infinity
    "vertex twice": (
        [[0, 0], [1, 1], [2, 0], [2, 3], [1, 1], [0, 3]],
        [[[0, 0], [1, 1], [0, 3]], [[2, 0], [2, 3], [1, 1]]],
    ),
    "vertex on an edge": (
        [[0, 0], [2, 0], [2, 2], [1, 0], [0, 2]],
        [[[0, 0], [1, 0], [0, 2]], [[1, 0], [2, 0], [2, 2]]],
    ),
    "spike": ([[0, 0], [2, 0], [1, 0], [1, 1]], [[[0, 0], [1, 0], [1, 1]]]),
    "slit of width zero": (
        [[0, 0], [3, 0], [3, 3], [1, 1], [2, 2], [0, 3]],
        [[[0, 0], [3, 0], [3, 3], [2, 2], [0, 3]]],
    ),
}
CROSSED_RAYS = [
    ([[0, 0], [0, 1]], [[1, 1], [1, -1]]),
    ([[0, 1], [0, 0], [2, 0]], [[1, 0], [0, 1]]),
]


def test_boundary_that_crosses_itself_or_has_no_area_is_refused():
    for vertices in (*CROSSED.values(), *FLAT.values()):
        for given in (np.array(vertices), np.array(vertices[::-1]) * 1e-9 + 5.0):
            with pytest.raises(ValueError, match="polygon"):
                polygon([0, 0], UNIT, given)
    for vertices in CROSSED.values():
        with pytest.raises(ValueError, match="cross"):
            polygon([0, 0], np.ones((2, 2)), vertices)
    for vertices, rays in [*CROSSED_RAYS, ([[0, 0]], [[1, 0], [1, 0]])]:
        with pytest.raises(ValueError, match="polygon"):
            polygon([0, 0], UNIT, vertices, rays=rays)
    batch = np.repeat(box(0, 1, 0, 1)[:, :, None, None], 3, axis=2)
    batch[:, :, 2, 0] = CROSSED["bow tie"]
    with pytest.raises(ValueError, match="cross"):
        polygon([0, 0], UNIT, batch)


@pytest.mark.parametrize("name", TOUCHING)
def test_boundary_that_touches_itself_bounds_the_sum_of_its_parts(name):
    whole, parts = TOUCHING[name]
    found = polygon([0.3, 0.6], TILTED, whole)
    pieces = [polygon([0.3, 0.6], TILTED, part) for part in parts]
    np.testing.assert_allclose(found.mass, sum(p.mass for p in pieces), rtol=1e-12)
    np.testing.assert_allclose(found.first, sum(p.first for p in pieces), rtol=1e-12)
    total = sum(p.second([0.2, 0.1]) for p in pieces)
    np.testing.assert_allclose(found.second([0.2, 0.1]), total, rtol=1e-12)
