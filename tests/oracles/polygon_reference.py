"""Reference moments over polygons in high precision, written to ``polygon_reference.json``.

Run by hand (two minutes): ``python tests/oracles/polygon_reference.py``. An independent
route: Green's theorem in the whitened plane with 90 decimal digits, the mass as winding number
less a numerical integral along each edge, the other moments in closed form. Digits lost to
cancellation are paid for by precision; a second run with 130 digits must agree to 1e-24.
"""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import mpmath as mp
import numpy as np

FILE = Path(__file__).with_suffix(".json")


def reference(mean, cov, vertices, rays=None, digits=90):
    """ln P, mean, covariance of the conditioned law as mpmath numbers."""
    with mp.workdps(digits):
        m = [mp.mpf(v) for v in mean]
        a, b, c = mp.mpf(cov[0][0]), mp.mpf(cov[0][1]), mp.mpf(cov[1][1])
        l11 = mp.sqrt(a)
        l21 = b / l11
        l22 = mp.sqrt((a * c - b * b) / a)

        def white(d):
            z1 = d[0] / l11
            return (z1, (d[1] - l21 * z1) / l22)

        z = [white((mp.mpf(v[0]) - m[0], mp.mpf(v[1]) - m[1])) for v in vertices]
        area = sum(p[0] * q[1] - p[1] * q[0] for p, q in zip(z, z[1:] + z[:1], strict=True))
        edges, winding = [], mp.mpf(0)
        if rays is None:
            if area < 0:
                z = z[::-1]
            pairs = list(zip(z, z[1:] + z[:1], strict=True))
        else:
            pairs = list(itertools.pairwise(z))
            into, out = (unit(white((mp.mpf(r[0]), mp.mpf(r[1])))) for r in rays)
            edges.append(line(z[0], (-into[0], -into[1]), -mp.inf, 0))
            edges.append(line(z[-1], out, 0, mp.inf))
            angle = mp.atan2(
                out[0] * into[1] - out[1] * into[0], out[0] * into[0] + out[1] * into[1]
            )
            if abs(angle) < mp.mpf(10) ** (-digits + 20):
                side = out[0] * (z[0][1] - z[-1][1]) - out[1] * (z[0][0] - z[-1][0])
                angle = mp.mpf(0) if side > 0 else 2 * mp.pi
            winding += (angle if angle >= 0 else angle + 2 * mp.pi) / (2 * mp.pi)
        for p, q in pairs:
            length = mp.hypot(q[0] - p[0], q[1] - p[1])
            if length > 0:
                edges.append(line(p, ((q[0] - p[0]) / length, (q[1] - p[1]) / length), 0, length))
        mass = mp.mpf(0)
        s = [mp.mpf(0), mp.mpf(0)]
        q11 = q12 = q22 = mp.mpf(0)
        for h, tau, t1, t2 in edges:
            winding += (arctan(t2, h) - arctan(t1, h)) / (2 * mp.pi)
            mass -= edge_mass(h, t1, t2)
            nu = (-tau[1], tau[0])
            flow = density(h) * normal(t1, t2)
            along = density(h) * (density(t1) - density(t2))
            s = [s[0] + nu[0] * flow, s[1] + nu[1] * flow]
            q11 += -h * flow * nu[0] ** 2 + along * tau[0] * nu[0]
            q22 += -h * flow * nu[1] ** 2 + along * tau[1] * nu[1]
            q12 += -h * flow * nu[0] * nu[1] + along * (tau[0] * nu[1] + tau[1] * nu[0]) / 2
        whole = mp.nint(winding)
        mass += whole if abs(winding - whole) < mp.mpf(10) ** (-digits // 2) else winding
        mu = [s[0] / mass, s[1] / mass]
        c11 = 1 + q11 / mass - mu[0] ** 2
        c22 = 1 + q22 / mass - mu[1] ** 2
        c12 = q12 / mass - mu[0] * mu[1]
        centre = [m[0] + l11 * mu[0], m[1] + l21 * mu[0] + l22 * mu[1]]
        spread = [
            l11**2 * c11,
            l11 * (l21 * c11 + l22 * c12),
            l21**2 * c11 + 2 * l21 * l22 * c12 + l22**2 * c22,
        ]
        return mp.log(mass), centre, spread


def unit(v):
    norm = mp.hypot(*v)
    return (v[0] / norm, v[1] / norm)


def line(p, tau, begin, end):
    """Signed distance, direction, and positions of the ends along it."""
    h = p[0] * tau[1] - p[1] * tau[0]
    t = p[0] * tau[0] + p[1] * tau[1]
    return h, tau, t + begin, t + end


def arctan(t, h):
    """Angle seen from the origin, with the sign of the side on which the origin lies."""
    return mp.atan2(t, abs(h)) * (1 if h > 0 else -1 if h < 0 else 0) if h != 0 else mp.mpf(0)


def density(t):
    return mp.mpf(0) if mp.isinf(t) else mp.exp(-t * t / 2) / mp.sqrt(2 * mp.pi)


def normal(t1, t2):
    """Normal probability of (t1, t2), from the tail that does not cancel."""
    if t2 < 0:
        t1, t2 = -t2, -t1
    upper = [mp.mpf(0) if t == mp.inf else mp.erfc(t / mp.sqrt(2)) / 2 for t in (t1, t2)]
    return upper[0] - upper[1]


def edge_mass(h, t1, t2):
    """Integral of ``h exp(-r^2/2) / (2 pi r^2)`` along the edge."""
    if h == 0 or t1 == t2:
        return mp.mpf(0)
    nearest = mp.mpf(0) if t1 < 0 < t2 else min(abs(t1), abs(t2))
    reach = mp.sqrt(nearest**2 + 2 * (mp.mp.dps * 2.4 + 60))
    t1, t2 = max(t1, -reach), min(t2, reach)

    def marks(begin, end):
        """Panels from a point outwards on one side of zero, 0 <= begin < end."""
        points = [begin]
        while points[-1] < end:
            t = points[-1]
            step = min(max(abs(h), t) * 0.7, 3 / max(mp.mpf(1), t))
            points.append(min(end, t + step))
        return points

    points = []
    if t1 < 0:
        points += [-t for t in reversed(marks(max(-t2, 0), -t1))]
    if t2 > 0:
        points += marks(max(t1, 0), t2)[1 if t1 < 0 else 0 :]

    # the rule stops at an absolute error: bring the integrand to the order of one first
    scale = abs(h) / max(h * h + nearest**2, abs(h))

    def integrand(t):
        return h / scale * mp.exp((nearest - t) * (nearest + t) / 2) / (h * h + t * t)

    whole = mp.quad(integrand, points, method="gauss-legendre")
    return whole * scale * mp.exp(-(h * h + nearest**2) / 2) / (2 * mp.pi)


def box(x0, x1, y0, y1):
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]


def ring(radius, thickness, points, start, stop):
    """Part of an annulus: a non-convex polygon around the origin."""
    angles = np.linspace(start, stop, points)
    outer = [[(radius + thickness) * np.cos(t), (radius + thickness) * np.sin(t)] for t in angles]
    inner = [[radius * np.cos(t), radius * np.sin(t)] for t in angles[::-1]]
    return [[float(x), float(y)] for x, y in outer + inner]


def star(points, inner, outer, centre=(0.0, 0.0), turn=0.1):
    angles = turn + np.pi * np.arange(2 * points) / points
    radii = np.where(np.arange(2 * points) % 2 == 0, outer, inner)
    return [
        [float(centre[0] + r * np.cos(t)), float(centre[1] + r * np.sin(t))]
        for r, t in zip(radii, angles, strict=True)
    ]


def nearly_singular(rho, s1=1.0, s2=1.0):
    return [[s1 * s1, rho * s1 * s2], [rho * s1 * s2, s2 * s2]]


def hard_cases():
    one = [[1.0, 0.0], [0.0, 1.0]]
    tilted = [[1.0, 0.3], [0.3, 1.0]]
    skew = [[2.0, -1.1], [-1.1, 0.9]]
    near = nearly_singular(1 - 1e-14)
    square = [[0.1, 0.9], [-0.7, 0.1], [0.2, -0.8], [1.0, 0.0]]
    comb = [
        [0, 0],
        [5, 0],
        [5, 3],
        [4, 3],
        [4, 1],
        [3, 1],
        [3, 3],
        [2, 3],
        [2, 1],
        [1, 1],
        [1, 3],
        [0, 3],
    ]
    chevron = [
        [-3.0, 2.0],
        [0.0, 0.0],
        [3.0, 2.0],
        [3.0, 2.0 + 1e-10],
        [0.0, 1e-10],
        [-3.0, 2.0 + 1e-10],
    ]
    case = {
        "square": ([0.03, 0.07], tilted, square),
        "square clockwise": ([0.03, 0.07], tilted, square[::-1]),
        "square padded": ([0.03, 0.07], tilted, [*square, square[-1], square[-1]]),
        "mean on a vertex": ([0.0, 0.0], skew, box(0.0, 1.0, 0.0, 2.0)),
        "mean on an edge": ([0.5, 0.0], skew, box(0.0, 1.0, 0.0, 2.0)),
        "mean at 1e-9 from a vertex": ([1e-9, -2e-9], tilted, box(0.0, 1.0, 0.0, 2.0)),
        "mean at 1e-6 from an oblique vertex": ([0.1 + 1e-6, 0.9 - 3e-6], tilted, square),
        "tiny": ([0.3, -0.4], tilted, box(1.0, 1.0 + 1e-8, 2.0, 2.0 + 1e-8)),
        "strip": ([0.2, 0.1], one, box(0.0, 1.0, 0.0, 1e-10)),
        "strip, mean far": ([0.2, -3.0], tilted, box(0.0, 1.0, 0.0, 1e-10)),
        "strip, long": ([0.2, 0.1], skew, box(-50.0, 70.0, 0.3, 0.3 + 1e-10)),
        "strip, oblique": (
            [0.2, 0.1],
            skew,
            [[-2.0, -1.0], [3.0, 2.0], [3.0, 2.0 + 1e-10], [-2.0, -1.0 + 1e-10]],
        ),
        "strip in the tail": ([0.0, 0.0], tilted, box(5.0, 5.0 + 1e-10, -20.0, 3.0)),
        "strip pointing at the mean": ([0.0, 0.0], one, box(7.0, 90.0, -1e-10, 2e-10)),
        "needle": ([0.0, 0.0], skew, [[-1.0, -1.0], [30.0, 2.0], [30.0, 2.0 + 1e-9]]),
        "needle tip near": ([0.0, 0.0], tilted, [[0.5, 0.5], [40.0, 3.0], [40.0, 3.000001]]),
        "huge square": ([0.3, 0.2], skew, box(-1e9, 1e9, -1e9, 1e9)),
        "huge, an edge near": (
            [0.0, 0.0],
            tilted,
            [[-1e9, -1e9 + 0.5], [1e9, 1e9 + 0.5], [-1e9, 1e9]],
        ),
        "huge, a vertex near": ([0.0, 0.0], skew, [[0.3, 0.7], [1e9, -3e8], [1e9, 2e9]]),
        "huge strip": ([0.0, 0.0], tilted, box(-1e9, 1e9, 0.5, 0.5 + 1e-7)),
        "huge oblique strip": (
            [0.0, 0.0],
            tilted,
            [[-1e9, -1e9], [1e9, 1e9], [1e9, 1e9 + 1e-6], [-1e9, -1e9 + 1e-6]],
        ),
        "tail": ([0.0, 0.0], tilted, box(9.0, 10.0, -1.0, 1.0)),
        "tail, vertex": ([0.0, 0.0], one, [[30.0, 40.0], [33.0, 41.0], [32.0, 45.0]]),
        "ln P = -5e5": ([0.0, 0.0], one, box(1000.0, 1001.0, -1.0, 1.0)),
        "ln P = -1e8": ([0.0, 0.0], one, box(14142.0, 14143.0, -3.0, 1.0)),
        "ln P = -1e8, oblique": (
            [0.0, 0.0],
            one,
            [[1e4, 1e4], [10100.0, 9900.5], [10100.0, 10100.0]],
        ),
        "ln P = -1e8, edge across": (
            [0.0, 0.0],
            one,
            [[10007.0, 9993.0], [10100.0, 10100.0], [9992.0, 10008.0]],
        ),
        "1 - rho = 1e-6": ([0.1, 0.2], nearly_singular(1 - 1e-6), box(-1.0, 1.0, -0.5, 2.0)),
        "1 - rho = 1e-10": (
            [0.1, 0.2],
            nearly_singular(1 - 1e-10, 2.0, 0.5),
            box(-1.0, 1.0, -0.5, 2.0),
        ),
        "1 - rho = 1e-14": ([0.1, 0.2], near, box(-1.0, 1.0, -0.5, 2.0)),
        "1 + rho = 1e-14": ([0.1, 0.2], nearly_singular(-1 + 1e-14), box(-1.0, 1.0, -0.5, 2.0)),
        "1 - rho = 1e-14, off the ridge": ([0.0, 0.0], near, box(0.5, 1.0, 0.5 - 1e-6, 0.5 - 5e-7)),
        "1 - rho = 1e-14, corner on the ridge": ([0.0, 0.0], near, box(0.5, 1.0, -3.0, 0.5)),
        "1 - rho = 1e-14, unequal": (
            [3.0, -2.0],
            nearly_singular(1 - 1e-14, 1e3, 1e-3),
            box(-500.0, 900.0, -2.002, -1.9995),
        ),
        "1 - rho = 1e-14, tail": (
            [0.0, 0.0],
            near,
            [[20.0, 20.0], [21.0, 20.0], [21.0, 21.0], [20.5, 21.0]],
        ),
        "far from zero": (
            [1e6, 1e6],
            [[1e-4, 5e-5], [5e-5, 1e-4]],
            box(1e6 + 0.01, 1e6 + 0.02, 1e6 - 0.01, 1e6),
        ),
        "small law, large box": (
            [0.0, 0.0],
            [[1e-12, 0.0], [0.0, 1e-10]],
            box(-1.0, 1e-6, -1e-5, 1.0),
        ),
        "disc of 40 edges": ([0.3, 0.1], tilted, ring(0.0, 1.5, 41, 0.0, 2 * np.pi)[:40]),
        "disc of 40 edges, tail": ([30.0, 4.0], tilted, ring(0.0, 1.5, 41, 0.0, 2 * np.pi)[:40]),
        "comb": ([1.5, 2.0], skew, comb),
        "comb, mean outside": ([7.0, 8.0], tilted, comb),
        "star": ([0.1, 0.0], tilted, star(5, 0.4, 1.5)),
        "star in the tail": ([0.0, 0.0], skew, star(5, 0.1, 1.0, centre=(12.0, 3.0))),
        "thin star": ([0.0, 0.0], one, star(3, 1e-6, 2.0)),
        "ring around the mean": ([0.0, 0.0], one, ring(30.0, 1.0, 12, 0.3, 5.8)),
        "ring around the mean, thin": ([0.1, -0.2], one, ring(1.0, 1e-9, 9, 0.3, 5.8)),
        "chevron 1e-10 wide": ([0.1, 0.0], tilted, chevron),
        "collinear vertices": (
            [0.2, 0.1],
            skew,
            [[0, 0], [0.5, 0.0], [1, 0], [1, 1], [0.25, 0.75], [0, 0.5]],
        ),
        "quadrant": ([0.0, 0.0], one, [[1.0, 1.0]], [[0.0, 1.0], [1.0, 0.0]]),
        "quadrant, far": ([0.0, 0.0], one, [[9.0, 9.0]], [[0.0, 1.0], [1.0, 0.0]]),
        "three quarters": ([0.2, 0.4], skew, [[0.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]]),
        "half-plane": ([0.2, 0.4], skew, [[1.0, 0.0]], [[-1.0, -2.0], [1.0, 2.0]]),
        "half-plane, tail": ([0.2, 0.4], tilted, [[-20.0, 10.0]], [[-1.0, -2.0], [1.0, 2.0]]),
        "half-strip": ([0.0, 0.0], tilted, [[0.0, 1.0], [0.3, 0.0]], [[1.0, 0.1], [1.0, 0.1]]),
        "all but a half-strip": (
            [0.0, 0.0],
            tilted,
            [[0.3, 0.0], [0.0, 1.0]],
            [[1.0, 0.1], [1.0, 0.1]],
        ),
        "narrow wedge": ([0.5, 0.0], one, [[0.0, 0.0]], [[1.0, 1e-8], [1.0, -1e-8]]),
        "wedge, 1 - rho = 1e-12": (
            [0.0, 0.1],
            nearly_singular(1 - 1e-12),
            [[-1.0, -1.0]],
            [[0.0, 1.0], [1.0, 0.9]],
        ),
        "unbounded, non-convex": (
            [0.5, 0.5],
            skew,
            [[0, 2], [1, 1], [0, 0], [1, -1]],
            [[-1.0, 0.5], [3.0, -1.0]],
        ),
    }
    return {name: with_rays(*value) for name, value in case.items()}


def with_rays(mean, cov, vertices, rays=None):
    return {"mean": mean, "cov": cov, "vertices": vertices, "rays": rays}


def random_cases(count, seed=20):
    """Star-shaped polygons, mostly non-convex, of all sizes, under laws of all shapes."""
    rng = np.random.default_rng(seed)
    cases = {}
    for k in range(count):
        corners = int(rng.integers(3, 9))
        angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
        while np.max(np.diff(angles, append=angles[0] + 2 * np.pi)) > 0.95 * np.pi:
            angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
        size = 10.0 ** rng.uniform(-4, 3)
        radii = size * rng.uniform(0.1, 1.0, corners)
        squash = 10.0 ** rng.uniform(-6, 0) if k % 3 == 0 else 1.0
        centre = rng.normal(size=2) * 3.0 * rng.choice([0.1, 1.0, 5.0])
        x = centre[0] + radii * np.cos(angles)
        y = centre[1] + squash * radii * np.sin(angles)
        rho = rng.choice([rng.uniform(-0.95, 0.95), 1 - 10.0 ** rng.uniform(-12, -2)])
        s = 10.0 ** rng.uniform(-0.7, 0.7, 2)
        cases[f"random {k}"] = with_rays(
            [float(v) for v in rng.normal(size=2)],
            [
                [float(s[0] ** 2), float(rho * s[0] * s[1])],
                [float(rho * s[0] * s[1]), float(s[1] ** 2)],
            ],
            [[float(a), float(b)] for a, b in zip(x, y, strict=True)],
        )
    return cases


def solved(case):
    first, second = (
        reference(case["mean"], case["cov"], case["vertices"], case["rays"], digits)
        for digits in (90, 130)
    )
    sd = [mp.sqrt(second[2][0]), mp.sqrt(second[2][2])]
    units = [sd[0] * sd[0], sd[0] * sd[1], sd[1] * sd[1]]
    assert abs(first[0] - second[0]) < 1e-24 * max(1, abs(second[0]))
    for k in range(2):
        assert abs(first[1][k] - second[1][k]) < 1e-24 * sd[k]
    for k in range(3):
        assert abs(first[2][k] - second[2][k]) < 1e-24 * units[k]
    text = lambda value: mp.nstr(value, 45, strip_zeros=False)  # noqa: E731
    return {
        **case,
        "log_mass": text(second[0]),
        "moment_mean": [text(v) for v in second[1]],
        "moment_cov": [text(v) for v in second[2]],
    }


if __name__ == "__main__":
    import sys

    known = json.loads(FILE.read_text()) if FILE.exists() else {}
    for name, case in {**hard_cases(), **random_cases(40)}.items():
        if any(known.get(name, {}).get(key) != value for key, value in case.items()):
            print(name, file=sys.stderr, flush=True)
            known[name] = solved(case)
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(case)}" for name, case in known.items())
    FILE.write_text("{\n" + lines + "\n}\n")
