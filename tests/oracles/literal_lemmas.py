"""The paper's lemmas and its example as printed (signs ours), a second route for the tests.

They are fit for easy regions only: differences of nearly equal numbers, and a division by the
horizontal extent of an edge.
"""

from __future__ import annotations

import numpy as np
from scipy.special import erf, owens_t


def lemma_1(lead, mean, cov, about):
    """(4) to (9): P, S, Q of all components from P, S, Q-about-the-mean of the leading ones."""
    p, s_lead, q_lead = lead
    k1 = len(s_lead)
    m1, m2, d1, d2 = mean[:k1], mean[k1:], about[:k1], about[k1:]
    g12, g22 = cov[:k1, k1:], cov[k1:, k1:]
    gain = np.linalg.solve(cov[:k1, :k1], g12)
    s_bar = s_lead - p * m1
    first = np.concatenate([s_lead, p * m2 + gain.T @ s_bar])
    e1, e2 = m1 - d1, m2 - d2
    q11 = q_lead + np.outer(e1, s_bar) + np.outer(s_bar, e1) + p * np.outer(e1, e1)
    q12 = (q_lead + np.outer(e1, s_bar)) @ gain + np.outer(s_lead - p * d1, e2)
    q22 = (
        p * (g22 - g12.T @ gain + np.outer(e2, e2))
        + gain.T @ q_lead @ gain
        + np.outer(e2, s_bar) @ gain
        + gain.T @ np.outer(s_bar, e2)
    )
    return p, first, np.block([[q11, q12], [q12.T, q22]])


def lemma_2(mean, var, lower, upper):
    """P, S and Q about the mean over an interval, as printed."""
    a, b = lower - mean, upper - mean
    scale = np.sqrt(var / (2 * np.pi))
    ea, eb = np.exp(-a * a / (2 * var)), np.exp(-b * b / (2 * var))
    p = 0.5 * (erf(b / np.sqrt(2 * var)) - erf(a / np.sqrt(2 * var)))
    ra, rb = (np.where(np.isinf(t), 0.0, t) for t in (a, b))
    return p, p * mean - scale * (eb - ea), p * var - scale * (rb * eb - ra * ea)


def about_a_point(p, first, second, mean, about):
    """Q about a point from Q about the mean, as (6) has it: what lemmas 2 and 3 leave out."""
    mean, away = np.atleast_1d(mean), np.atleast_1d(mean) - np.atleast_1d(about)
    s = np.atleast_1d(first) - p * mean
    return np.atleast_2d(second) + np.outer(away, s) + np.outer(s, away) + p * np.outer(away, away)


def formula_30(mean, cov, lower, upper, about):
    """(30): P, S and Q of the pair of range and angle, the range between two edges.

    Means (2, n) and covariances (2, 2, n) of n windows; `about` is the reference point (2,).
    """
    (m1, m2), (d1, d2) = mean, about
    g11, g12, g22 = cov[0, 0], cov[0, 1], cov[1, 1]
    p, s1, q_bar = lemma_2(m1, g11, lower, upper)
    s, gain = s1 - p * m1, g12 / g11
    q11 = q_bar + 2 * (m1 - d1) * s + p * (m1 - d1) ** 2
    q12 = (q_bar + (m1 - d1) * s) * gain + (s1 - p * d1) * (m2 - d2)
    q22 = p * (g22 - g12 * gain + (m2 - d2) ** 2) + q_bar * gain**2 + 2 * (m2 - d2) * s * gain
    return p, np.array([s1, p * m2 + s * gain]), np.array([[q11, q12], [q12, q22]])


def falling_body(y, cells, noise, *, late=0.0, mass=True):
    """(26) to (30): mean (2,) and covariance (2, 2) of range and angle after each angle of y.

    Two faults can be planted: K_t taken `late` seconds later, and U_i taken for the weights,
    without the masses P_i of the windows.
    """
    share = np.arange(cells + 1) / cells
    edges = 5.0 * 50.0 / np.sqrt(share * 5.0**2 + (1 - share) * 50.0**2)
    middle = (edges[:-1] + edges[1:]) / 2
    edges[0], edges[-1] = -np.inf, np.inf
    m = np.array([27.5, 0.1])[:, None] + np.zeros(cells)
    cov = np.diag([11.25**2, 1e-12])[:, :, None] + np.zeros(cells)
    unit, zero, found = np.ones(cells), np.zeros(cells), []
    for t, angle in enumerate(y, start=1):
        k = 0.01 * (t - 0.5 + late)
        matrix = np.array([[zero + 1, zero], [k / middle**2, zero + 1]])
        e = np.array([zero, -2 * k / middle]) + np.einsum("ijn,jn->in", matrix, m)
        v = np.einsum("ijn,jkn,lkn->iln", matrix, cov, matrix)
        w = noise**2 + v[1, 1]
        m = e + v[:, 1] / w * (angle - e[1])
        cov = v - v[:, None, 1] * v[None, 1] / w
        unit = unit * np.exp(-0.5 * (angle - e[1]) ** 2 / w) / np.sqrt(w)
        p, first, _ = formula_30(m, cov, edges[:-1], edges[1:], (0.0, 0.0))
        factor = unit if mass else unit / np.where(p > 0, p, np.inf)
        total = (factor * p).sum()
        mean = (factor * first).sum(axis=1) / total
        spread = formula_30(m, cov, edges[:-1], edges[1:], mean)[2]
        found.append((mean, (factor * spread).sum(axis=2) / total))
        unit = unit / (unit * p).sum()
    return found


def change_of_variables(mean, cov, vertices):
    """(11): vertices in coordinates in which the density is ``exp(-|x|^2) / pi``."""
    s1, s2 = np.sqrt(cov[0, 0]), np.sqrt(cov[1, 1])
    rho = cov[0, 1] / (s1 * s2)
    u, v = (vertices[:, 0] - mean[0]) / s1, (vertices[:, 1] - mean[1]) / s2
    return np.stack(
        [(u + v) / (2 * np.sqrt(1 + rho)), -(u - v) / (2 * np.sqrt(1 - rho))], axis=1
    ), (s1, s2, rho)


def mass(points):
    """P of (12) by Owen's T: the winding number less T at both ends of each edge."""
    z = np.sqrt(2.0) * points
    total = 0.0
    for a, b in zip(z, np.roll(z, -1, axis=0), strict=True):
        tau = (b - a) / np.hypot(*(b - a))
        h = a[0] * tau[1] - a[1] * tau[0]
        for t, sign in ((b @ tau, 1.0), (a @ tau, -1.0)):
            angle = np.arctan2(t, abs(h)) / (2 * np.pi)
            total += sign * np.copysign(1.0, h) * (angle - owens_t(abs(h), t / abs(h)))
    return total


def lemma_3(mean, cov, vertices, p=None, signs=1.0):
    """(10) to (20): P, S and Q about the mean; `p` may be given, all else is elementary in it.

    `signs` multiplies the five sums over the edges: phi, chi, mu, nu, zeta.
    """
    points, (s1, s2, rho) = change_of_variables(mean, cov, vertices)
    p = mass(points) if p is None else p
    sums = np.zeros(5)
    for (u1, u2), (v1, v2) in zip(points, np.roll(points, -1, axis=0), strict=True):
        sums += signs * _edge_terms(u1, u2, v1, v2)
    phi, chi, mu, nu, zeta = sums
    c1, c2 = -phi / (4 * np.sqrt(np.pi)), chi / (4 * np.sqrt(np.pi))
    q11, q12 = np.pi * p / 2 + mu / 4, zeta / 4
    q22 = np.pi * p / 2 - nu / 4
    plus, minus = np.sqrt(1 + rho), np.sqrt(1 - rho)
    first = np.array(
        [
            p * mean[0] + s1 * (plus * c1 - minus * c2),
            p * mean[1] + s2 * (plus * c1 + minus * c2),
        ]
    )
    even, odd = (1 + rho) * q11 + (1 - rho) * q22, 2 * plus * minus * q12
    cross = s1 * s2 * ((1 + rho) * q11 - (1 - rho) * q22) / np.pi
    second = np.array(
        [[s1 * s1 * (even - odd) / np.pi, cross], [cross, s2 * s2 * (even + odd) / np.pi]]
    )
    return p, first, second


def _edge_terms(u1, u2, v1, v2):
    if u1 != v1:
        slope = (v2 - u2) / (v1 - u1)
        phi, mu, zeta = _regular((u2 * v1 - u1 * v2) / (v1 - u1), slope, u1, v1)
    else:
        gap = np.exp(-u1 * u1) * (erf(v2) - erf(u2))
        phi, mu = gap, -np.sqrt(np.pi) * u1 * gap
        zeta = np.exp(-u1 * u1) * (np.exp(-v2 * v2) - np.exp(-u2 * u2))
    if u2 != v2:
        slope = (v1 - u1) / (v2 - u2)
        chi, nu, _ = _regular((u1 * v2 - u2 * v1) / (v2 - u2), slope, u2, v2)
    else:
        gap = np.exp(-u2 * u2) * (erf(v1) - erf(u1))
        chi, nu = gap, -np.sqrt(np.pi) * u2 * gap
    return np.array([phi, chi, mu, nu, zeta])


def _regular(alpha, beta, x, y):
    """X, Y, Z of an edge that is not special."""
    g = np.sqrt(1 + beta * beta)
    shift = alpha * beta / g
    big_phi = erf(g * y + shift) - erf(g * x + shift)
    big_psi = np.exp(-((g * y + shift) ** 2)) - np.exp(-((g * x + shift) ** 2))
    fall = np.exp(-alpha * alpha / (g * g))
    return (
        beta * fall * big_phi / g,
        beta * fall * (big_psi + np.sqrt(np.pi) * shift * big_phi) / g**2,
        fall * (beta * beta * big_psi - np.sqrt(np.pi) * shift * big_phi) / g**2,
    )
