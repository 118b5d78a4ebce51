"""Means of functions of a Gaussian vector by quadrature, independent of the library."""

import numpy as np

LEGENDRE = np.polynomial.legendre.leggauss(40)


def random_dist(rng, n, scale=1.0):
    """Mean (n,) and a full covariance (n, n)."""
    root = scale * rng.normal(size=(n, n))
    return rng.normal(size=n), root @ root.T


def hermite_grid(n, nodes):
    """Product rule for n standard normals: points (n, nodes**n) and weights of sum one."""
    points, weights = np.polynomial.hermite_e.hermegauss(nodes)
    weights = weights / weights.sum()
    grid = np.array(np.meshgrid(*[points] * n, indexing="ij")).reshape(n, -1)
    return grid, np.array(np.meshgrid(*[weights] * n, indexing="ij")).prod(axis=0).ravel()


def hermite_mean(f, mean, cov, nodes):
    """E f(x) of a smooth f(x1, ..., xn) by Gauss-Hermite quadrature."""
    grid, weights = hermite_grid(len(mean), nodes)
    points = np.asarray(mean)[:, None] + np.linalg.cholesky(cov) @ grid
    return weights @ np.broadcast_to(f(*points), weights.shape)


def panels(stops):
    """Gauss-Legendre nodes and weights of the intervals between several stops."""
    half = 0.5 * np.diff(stops)[:, None]
    middle = 0.5 * (stops[1:] + stops[:-1])[:, None]
    return (middle + half * LEGENDRE[0]).ravel(), (half * LEGENDRE[1]).ravel()


def panel_mean(f, mean, cov, normal, kinks=()):
    """E f(x, y) of a function with kinks where ``normal . (x, y)`` takes given values.

    With u = normal . x the vector is b u + r, b = cov(x, u) / var u, where r is independent of u.
    """
    normal = np.asarray(normal, dtype=float)
    var, centre = normal @ cov @ normal, normal @ mean
    slope = cov @ normal / var
    values, vectors = np.linalg.eigh(cov - var * np.outer(slope, slope))
    ends = centre + 9.0 * np.sqrt(var) * np.array([-1.0, -0.3, 0.0, 0.3, 1.0])
    inside = [k for k in kinks if abs(k - centre) < 9.0 * np.sqrt(var)]
    u, weights = panels(np.sort(np.append(ends, inside)))
    weights = weights * np.exp(-0.5 * (u - centre) ** 2 / var) / np.sqrt(2 * np.pi * var)
    z, masses = panels(np.linspace(-9.0, 9.0, 4))
    masses = masses * np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    away = vectors[:, 1] * np.sqrt(values[1])
    points = (mean[:, None] + np.outer(slope, u - centre))[:, :, None] + away[:, None, None] * z
    return weights @ f(*points) @ masses


def branch_moments(value, weight, mean, cov, noise_mean, noise_cov, nodes):
    """Mass of a branch, and moments in it, by nodes in the joint space of state and noise.

    `value` and `weight` are functions of points (n, N) of the state and (q, N) of the noise. The
    result is the mass, mean and covariance of the state, the mean of the value, its covariance
    with the state, and its own; with a weight of one they are the plain moments.
    """
    n, q = len(mean), len(noise_mean)
    grid, weights = hermite_grid(n + q, nodes)
    x = np.asarray(mean)[:, None] + np.linalg.cholesky(cov) @ grid[:n]
    v = np.asarray(noise_mean)[:, None]
    v = v + np.linalg.cholesky(noise_cov) @ grid[n:] if q else np.zeros((0, grid.shape[1]))
    y = np.array([np.broadcast_to(part, weights.shape) for part in value(x, v)])
    share = weights * weight(x, v)
    mass = share.sum()
    share = share / mass
    centre, h = x @ share, y @ share
    dx, dy = x - centre[:, None], y - h[:, None]
    return mass, centre, (dx * share) @ dx.T, h, (dx * share) @ dy.T, (dy * share) @ dy.T
