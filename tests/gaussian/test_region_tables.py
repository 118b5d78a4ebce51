"""Regions of a Gaussian law: what guards and speeds the sums, by numbers and by symmetry."""

import numpy as np
import pytest

from seedslib.gaussian import interval, lift, polygon
from seedslib.gaussian.regions import convex
from seedslib.gaussian.regions.edges import edge_moments
from seedslib.gaussian.regions.geometry import outline
from seedslib.gaussian.regions.law import Cases
from seedslib.gaussian.regions.nodes import reach_of
from seedslib.gaussian.regions.polygon import pad_regions

CHEVRON = np.array([[0.0, 0.1], [2.1, -1.2], [1.1, 0.9], [1.9, 3.2], [-1.3, 1.1]])
KITE = np.array([[0.4, -0.7], [1.7, 0.3], [1.7, 0.3], [0.9, 1.4], [-0.6, 0.8]])
LAW = (np.array([0.31, -0.17]), np.array([[1.3, 0.47], [0.47, 0.61]]))
THIN = (np.array([0.9, 1.1]), np.array([[2.1, 1.4], [1.4, 0.9334]]))
FAR = (np.array([5.2, -1.7]), np.array([[0.7, -0.3], [-0.3, 1.9]]))
WEDGE = [[-0.7, 2.3], [1.9, 0.8]]  # the ray back from the first vertex, the one out of the last
STRIP = [[0.6, 1.7], [0.3, 0.85]]


def closed(law, vertices, rays=None):
    shape = outline(vertices[..., None], None if rays is None else np.array(rays)[..., None])
    mean, cov = law
    return edge_moments(
        Cases(mean[:, None], cov[..., None], shape.x, shape.y, shape.rays, shape.convex)
    )


REGIONS = {
    "chevron": (LAW, CHEVRON, None), "kite": (LAW, KITE, None), "thin law": (THIN, CHEVRON, None),
    "far": (FAR, CHEVRON, None), "wedge": (LAW, CHEVRON[:1], WEDGE),
    "wedge of three": (FAR, CHEVRON[[4, 0, 1]], WEDGE), "around": (THIN, KITE[:1], WEDGE[::-1]),
    "strip": (LAW, np.array([[-0.4, 0.9], [1.1, 0.2]]), STRIP),
    "far wedge": (FAR, CHEVRON[:1], WEDGE),
}  # fmt: skip
ESTIMATES = {
    "chevron": 2.4568218e-13, "kite": 1.1812981e-13, "thin law": 5.3941016e-12,
    "far": 1.0593062e-08, "wedge": 9.448294e-14, "wedge of three": 2.5494128e-13,
    "around": 2.0489249e-12, "strip": 5.2410092e-13, "far wedge": 1.6527938e-11,
}  # fmt: skip


@pytest.mark.parametrize("name", REGIONS)
def test_the_estimate_of_the_closed_form(name):
    law, vertices, rays = REGIONS[name]
    found = closed(law, vertices, rays)
    assert found.estimate[0] == pytest.approx(ESTIMATES[name], rel=1e-6)
    fine = polygon(*law, vertices, rays=rays, tolerance=0.0)
    for part, wanted in (
        (found.log_mass[0], fine.log_mass), (found.mean[:, 0], fine.mean),
        (found.cov[..., 0], fine.cov),
    ):  # fmt: skip
        np.testing.assert_allclose(part, wanted, rtol=0.0, atol=4.0 * found.estimate[0])


@pytest.mark.parametrize("name", REGIONS)
@pytest.mark.parametrize("tolerance", [0.0, 1e-3])
def test_units_and_lengths_of_rays_change_no_digit(name, tolerance):
    law, vertices, rays = REGIONS[name]
    unit = np.array([2.0**7, 2.0**-5])
    scaled = law[0] * unit, law[1] * np.outer(unit, unit)
    moved = None if rays is None else np.array(rays) * unit * [[2.0**9], [2.0**-6]]
    plain = polygon(*law, vertices, rays=rays, tolerance=tolerance)
    found = polygon(*scaled, vertices * unit, rays=moved, tolerance=tolerance)
    assert found.log_mass == plain.log_mass
    np.testing.assert_array_equal(found.mean, plain.mean * unit)
    np.testing.assert_array_equal(found.cov, plain.cov * np.outer(unit, unit))
    if tolerance:
        before = closed(law, vertices, rays).estimate
        np.testing.assert_array_equal(closed(scaled, vertices * unit, moved).estimate, before)


SLABS = {
    "within reach": (np.zeros(2), np.array([[0.3, -1.1], [2.2, 0.4], [1.2, 3.0], [-1.4, 0.7]])),
    "wide": (np.zeros(2), np.array([[-90.0, -3.1], [140.0, -0.4], [-20.0, 70.0]])),
    "tall": (np.zeros(2), np.array([[-2.0, -80.0], [3.0, -90.0], [11.0, 120.0]])),
    "beside": (np.array([-30.0, 4.0]), np.array([[0.0, -70.0], [110.0, 3.0], [2.0, 60.0]])),
    "sliver": (np.zeros(2), np.array([[-40.0, -0.2], [60.0, 0.3], [61.0, 0.32], [-39.0, -0.1]])),
    "opening": (np.zeros(2), np.array([[-2.0, -3.0], [3.0, -3.1], [9.0, 5.0], [-8.0, 6.0]])),
    "funnel": (np.array([1.0, 2.0]), np.array([[0.0, -1.0], [2.5, -9.0], [40.0, 3.0], [1.0, 4.0]])),
    "corner": (np.array([-21.0, -17.0]), np.array([[0.0, 0.0], [90.0, -20.0], [30.0, 80.0]])),
}


PANELS = {
    "opening": (5, -8.69085924882, 94.05, 0, 0),
    "funnel": (7, -10.9544511501, 126.318486571, 0, 0),
    "within reach": (3, -2.8865175216, 7.515, 0, 0),
    "wide": (1, -10.9544511501, 1392.64657586, 0, 0),
    "tall": (1, -10.9544511501, 70.8306829765, -3.19326134561, -1.34969170503e-30),
    "beside": (2, -10.9544511501, 2183.74637883, -31.1347771674, -1.76569257301e-30),
    "sliver": (1, -10.9544511501, 1.3977760857, 0, 0),
    "corner": (3, 0, 37.5401069519, -21.1507196373, 16.8121104809),
}


@pytest.mark.parametrize("name", SLABS)
def test_panels_hold_what_counts_and_no_kinks(name, monkeypatch):
    caught, integrate = [], convex.integrate
    monkeypatch.setattr(convex, "integrate", lambda *all: caught.append(all) or integrate(*all))
    mean, vertices = SLABS[name]
    polygon(mean, np.eye(2), vertices, tolerance=0.0)
    (panels, px, py), edge = caught[0], np.sqrt(120.0)
    low, height, l0, l1, r0, r1, w0, w1 = panels.sides
    assert (height > 0.0).all()
    np.testing.assert_allclose([w0, w1], [r0 - l0, r1 - l1], atol=1e-12)
    order = np.argsort(low)
    np.testing.assert_allclose((low + height)[order][:-1], low[order][1:], atol=1e-12)
    # what lies in a panel is seen from the nearest point
    share = np.linspace(0.0, 1.0, 21)[1:-1, None]
    y, left, right = low + height * share, l0 + (l1 - l0) * share, r0 + (r1 - r0) * share
    base = np.clip(-px, left, right)
    assert (base * (base + 2 * px) + y * (y + 2 * py) <= 120.0).all()
    # no side and no width passes a limit of the density inside a panel
    ends = order[[0, -1]]
    nearest = np.maximum(px + np.array([l0[ends[0]], l1[ends[1]]]),
                         -(px + np.array([r0[ends[0]], r1[ends[1]]])))  # fmt: skip
    reaches = reach_of(np.maximum(nearest, 0.0))
    for a, b, limit in ((l0, l1, -edge - px), (r0, r1, edge - px), (w0, w1, 2 * edge),
                        *((w0, w1, reach) for reach in reaches)):  # fmt: skip
        assert ((a - limit) * (b - limit) >= -1e-9 * (1 + np.abs(a) + np.abs(b))).all()
    found = low.size, low.min(), 0.5 * ((w0 + w1) * height).sum(), px[0], py[0]
    assert found == pytest.approx(PANELS[name], rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("whose", range(3))
def test_either_argument_of_a_lift_may_carry_the_batch(whose):
    law = (
        np.array([0.2, -0.4, 1.1]),
        np.array([[1.3, 0.4, 0.2], [0.4, 0.9, -0.3], [0.2, -0.3, 0.8]]),
    )
    block = polygon(law[0][:2], law[1][:2, :2], KITE)
    alone = lift(block, *law)
    mean, cov = (np.repeat(part[..., None], 4, axis=-1) for part in law)
    many = polygon(mean[:2], cov[:2, :2], KITE)
    found = lift(
        many if whose == 0 else block, mean if whose == 1 else law[0],
        cov if whose == 2 else law[1],
    )  # fmt: skip
    assert found.log_mass.shape == (4,)
    np.testing.assert_allclose(found.mean, np.repeat(alone.mean[:, None], 4, 1), rtol=1e-13)
    np.testing.assert_allclose(found.cov, np.repeat(alone.cov[..., None], 4, 2), rtol=1e-13)


@pytest.mark.parametrize(
    ("vertices", "rays"),
    [
        (CHEVRON, None), (CHEVRON[[4, 0, 1]], WEDGE), (KITE[:1], WEDGE[::-1]),
        (KITE[2:3], [[0.3, -1.9], [-0.2, -0.9]]),
    ],
)  # fmt: skip
@pytest.mark.parametrize("way", [(1.3, 0.7), (-0.4, 1.1), (0.0, 0.8), (0.9, 0.0)])
def test_a_law_on_a_line_counts_its_points(vertices, rays, way):
    """Of a law on a line, the mass is that of the parts of the line whose points are inside."""
    mean, way = [0.4, 0.3], np.array(way)
    t = np.linspace(-6.0, 6.0, 801)
    points = np.array(mean)[:, None] + way[:, None] * t
    dense = polygon(points, np.zeros((2, 2)), vertices, rays=rays)
    weight = np.exp(-0.5 * t**2) * dense.mass
    total = weight.sum()
    found = polygon(mean, np.outer(way, way), vertices, rays=rays)
    assert found.mass == pytest.approx(total * (t[1] - t[0]) / np.sqrt(2 * np.pi), abs=1.2e-2)
    if total == 0.0:
        return
    centre = (weight * t).sum() / total
    np.testing.assert_allclose(found.mean, mean + way * centre, atol=2.5e-2)
    spread = (weight * (t - centre) ** 2).sum() / total
    np.testing.assert_allclose(found.cov, spread * np.outer(way, way), atol=3e-2)
    # whether a point is inside, from a law that is all but a point
    some = points[:, ::100]
    near = polygon(some, 1e-12 * np.eye(2), vertices, rays=rays)
    np.testing.assert_array_equal(dense.mass[::100], np.round(near.mass))


def test_regions_are_tables():
    for wrong in ([1.0, 2.0], np.zeros((3, 2, 1)), np.zeros((0, 2)), [[1.0, np.nan]]):
        with pytest.raises(ValueError, match=r"regions\[1\]"):
            pad_regions([KITE, wrong])
    np.testing.assert_array_equal(pad_regions([KITE[:1]])[..., 0], KITE[:1])


def test_an_empty_interval_has_no_mass_whatever_its_ends():
    for ends in ((2.0, 2.0), (-1.0, -1.0), (0.3, 0.3)):
        found = interval(0.3, 1.7, *ends)
        assert found.log_mass == -np.inf
        assert np.isnan(found.mean)
