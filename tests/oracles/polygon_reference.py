"""Reference moments over polygons in high precision, written to ``polygon_reference.json``.

Run by hand (two minutes): ``python tests/oracles/polygon_reference.py`` solves the cases of that
file again. An independent route: Green's theorem in the whitened plane with 90 decimal digits, the
mass as winding number less a numerical integral along each edge, the other moments in closed form.
Digits lost to cancellation are paid for by precision; a second run with 130 digits must agree to
1e-24.
"""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import mpmath as mp

FILE = Path(__file__).with_suffix(".json")


def reference(mean, cov, vertices, rays=None, digits=90):
    """ln P, mean, covariance of the conditioned distribution as mpmath numbers."""
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
    known = {name: solved(case) for name, case in json.loads(FILE.read_text()).items()}
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(case)}" for name, case in known.items())
    FILE.write_text("{\n" + lines + "\n}\n")
