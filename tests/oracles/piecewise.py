"""Piecewise-linear systems, and their posterior by summing over starting points.

Given the restricted components at the start, these are known at all times and the others are
linear and Gaussian: one plain Kalman filter for each point of a quadrature rule whose panels end
where a path meets an edge. No distribution is restricted to a region here.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import sympy as sp

from seedslib.piecewise import PiecewiseLinearSystem, line_cells

INF = np.inf
TIMES = np.array([2.0, 2.5, 3.0, 3.5, 4.0])  # a late start


def at_time(t, shape, seed, scale=1.0):
    """Numbers of a random table that vary with time."""
    one, two = scale * np.random.default_rng(seed).standard_normal((2, *shape))
    return one + 0.3 * np.sin(t) * two


def line_parts(slopes=(1.1, -0.6, -1.7)):
    """Three states of which one is restricted, two sensors, two noises; all varies with time."""

    def dynamics(t):
        matrix = at_time(t, (3, 3, 3), 2, 0.4)
        matrix[0, 1:] = 0.0
        matrix[0, 0] = np.array(slopes) * (1 + 0.1 * np.cos(t))
        return at_time(t, (3, 3), 1, 0.5), matrix

    def noise(t):
        gain = at_time(t, (3, 2, 3), 3, 0.4)
        gain[0] = 0.0
        return gain

    return {
        "regions": np.array([-INF, -0.4, 0.7, INF]),
        "dynamics": dynamics,
        "noise": noise,
        "sensor": lambda t: (at_time(t, (2, 3), 4), at_time(t, (2, 3, 3), 5)),
        "sensor_noise": lambda t: np.eye(2)[..., None] * 0.6 + at_time(t, (2, 2, 3), 6, 0.2),
        "mean0": [0.15, -0.3, 0.4],
        "cov0": [[0.6, 0.1, -0.2], [0.1, 0.5, 0.05], [-0.2, 0.05, 0.4]],
    }


def product_parts():
    """Two independent systems on lines, whose product is a system in the plane; varying with time.

    The first has a second state with noise; each is seen by a sensor of its own.
    """
    first = {
        "regions": np.array([-INF, 0.1, INF]),
        "dynamics": lambda t: (
            at_time(t, (2, 2), 11, 0.4),
            [[[1.3, -0.9 - 0.1 * np.sin(t)], [0.0, 0.0]], *at_time(t, (1, 2, 2), 12, 0.6)],
        ),
        "noise": lambda t: [[0.0], [0.3 + 0.1 * t]],
        "sensor": lambda t: (at_time(t, (1, 2), 14, 0.5), at_time(t, (1, 2, 2), 15)),
        "sensor_noise": lambda t: [[0.5 + 0.1 * t]],
        "mean0": [0.1, -0.2],
        "cov0": [[0.3, 0.1], [0.1, 0.5]],
    }
    second = {
        "regions": np.array([-INF, -0.2, INF]),
        "dynamics": lambda t: (at_time(t, (1, 2), 21, 0.4), [[[0.6 + 0.1 * np.cos(t), -1.2]]]),
        "noise": lambda t: np.zeros((1, 0)),
        "sensor": lambda t: (at_time(t, (1, 2), 24, 0.5), at_time(t, (1, 1, 2), 25)),
        "sensor_noise": lambda t: [[0.4]],
        "mean0": [0.2],
        "cov0": [[0.4]],
    }
    return first, second


TURN = np.array([[1.0, 0.5, 0.0], [-0.3, 0.8, 0.0], [0.2, -0.4, 1.0]])


def plane_system():
    """The product of two lines in oblique coordinates ``TURN (x1, x2, z)``; four cells, z free."""
    first, second = product_parts()
    back = np.linalg.inv(TURN)
    low, high = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])  # cells of both lines

    def dynamics(t):
        (a, A), (b, B) = first["dynamics"](t), second["dynamics"](t)
        A, B = np.asarray(A)[:, :, low], np.asarray(B)[:, :, high]
        matrix = np.zeros((3, 3, 4))
        matrix[0, 0], matrix[2, 0], matrix[2, 2], matrix[1, 1] = A[0, 0], A[1, 0], A[1, 1], B[0, 0]
        offset = np.stack([a[0, low], b[0, high], a[1, low]])
        return TURN @ offset, np.einsum("ij,jkn,kl->iln", TURN, matrix, back)

    def sensor(t):
        (a, A), (b, B) = first["sensor"](t), second["sensor"](t)
        matrix = np.zeros((2, 3, 4))
        matrix[0, 0], matrix[0, 2], matrix[1, 1] = A[0, 0, low], A[0, 1, low], B[0, 0, high]
        return np.stack([a[0, low], b[0, high]]), np.einsum("mjn,jk->mkn", matrix, back)

    cov0 = np.zeros((3, 3))
    cov0[np.ix_([0, 2], [0, 2])], cov0[1, 1] = first["cov0"], second["cov0"][0][0]
    return PiecewiseLinearSystem(
        line_cells(back[:2, :2].T, [first["regions"][1], second["regions"][1]]),
        dynamics,
        sensor,
        lambda t: np.diag([first["sensor_noise"](t)[0][0], second["sensor_noise"](t)[0][0]]),
        TURN @ [first["mean0"][0], second["mean0"][0], first["mean0"][1]],
        TURN @ cov0 @ TURN.T,
        noise=lambda t: TURN @ [[0.0], [0.0], first["noise"](t)[1]],
    )


class Posterior(NamedTuple):
    """Moments (K+1, k), (K+1, k, k), log densities (K+1,), cell probabilities (K+1, n)."""

    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray
    mode_prob: np.ndarray


def panels(edges, order):
    """Gauss-Legendre nodes and weights between consecutive edges."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    half, middle = 0.5 * np.diff(edges), 0.5 * (edges[:-1] + edges[1:])
    return (middle[:, None] + half[:, None] * nodes).ravel(), (half[:, None] * weights).ravel()


def start_nodes(parts, times):
    """Starting points (S,) of the restricted component between all kinks, and prior weights."""
    edges, sd = parts["regions"][1:-1], np.sqrt(parts["cov0"][0][0])
    low, high = parts["mean0"][0] - 9.5 * sd, parts["mean0"][0] + 9.5 * sd
    pieces = [(low, high, 0.0, 1.0)]  # between two starting points x = p + q s
    for t in times:
        cut = []
        for a, b, p, q in pieces:
            roots = (edges - p) / q if q else np.zeros(0)
            ends = [a, *np.sort(roots[(a < roots) & (roots < b)]), b]
            cut += [(c, d, p, q) for c, d in pairwise(ends)]
        offset, matrix = (np.asarray(part) for part in parts["dynamics"](t))
        pieces = []
        for a, b, p, q in cut:
            i = np.searchsorted(edges, p + 0.5 * (a + b) * q, side="right")
            move = matrix[0, 0, i]
            pieces.append((a, b, offset[0, i] + move * p, move * q))
    kinks = [a for a, *_ in pieces]
    s, weight = panels(np.unique([*kinks, *np.linspace(low, high, 40)]), 16)
    weight = weight * np.exp(-0.5 * ((s - parts["mean0"][0]) / sd) ** 2)
    return s, weight / weight.sum()


def posterior(parts, y, times=TIMES):
    """Posterior of one record y (K+1, m), NaN missing, by one Kalman filter for each start."""
    edges, mean0, cov0 = parts["regions"], np.array(parts["mean0"]), np.array(parts["cov0"])
    x, weight = start_nodes(parts, times)
    gain = cov0[1:, 0] / cov0[0, 0]
    z = mean0[1:, None] + gain[:, None] * (x - mean0[0])
    var = np.repeat((cov0[1:, 1:] - np.outer(gain, cov0[0, 1:]))[:, :, None], x.size, axis=2)
    cell, found = np.searchsorted(edges[1:-1], x, side="right"), []
    for k, t in enumerate(times):
        if k:
            a, A = (np.asarray(part)[..., cell] for part in parts["dynamics"](times[k - 1]))
            G = by_cell(parts["noise"](times[k - 1]), cell)[1:]
            z = a[1:] + np.einsum("ijs,js->is", A[1:], np.concatenate([x[None], z]))
            x = a[0] + A[0, 0] * x
            var = np.einsum("ijs,jks,lks->ils", A[1:, 1:], var, A[1:, 1:])
            var = var + np.einsum("ips,jps->ijs", G, G)
            cell = np.searchsorted(edges[1:-1], x, side="right")
        seen, total = np.flatnonzero(~np.isnan(y[k])), 1.0
        if seen.size:
            b, B = (np.asarray(part)[seen][..., cell] for part in parts["sensor"](t))
            root = by_cell(parts["sensor_noise"](t), cell)[seen]
            error = y[k, seen, None] - b - np.einsum("ijs,js->is", B, np.concatenate([x[None], z]))
            cross = np.einsum("ijs,mjs->ims", var, B[:, 1:])
            spread = np.einsum("mis,ins->mns", B[:, 1:], cross)
            spread = np.moveaxis(spread + np.einsum("mps,nps->mns", root, root), 2, 0)
            scaled = np.linalg.solve(spread, error.T[:, :, None])[..., 0]
            density = -0.5 * (error.T * scaled).sum(axis=1)
            density = np.exp(density - 0.5 * np.linalg.slogdet(2 * np.pi * spread)[1])
            gain = np.swapaxes(np.linalg.solve(spread, np.moveaxis(cross, 2, 0).mT), 1, 2)
            z = z + np.einsum("sim,ms->is", gain, error)
            var = var - np.einsum("sim,jms->ijs", gain, cross)
            total = (weight * density).sum()
            weight = weight * density / total
        states = np.concatenate([x[None], z])
        mean = states @ weight
        cov = (weight * (states - mean[:, None])) @ (states - mean[:, None]).T
        cov[1:, 1:] += var @ weight
        prob = np.bincount(cell, weight, minlength=len(edges) - 1)
        found.append((mean, cov, np.log(total), prob))
    return Posterior(*(np.stack(part) for part in zip(*found, strict=True)))


def by_cell(table, cell):
    """A noise matrix of the cell of each point, from one with or without an axis of cells."""
    table = np.asarray(table)
    return table[..., cell] if table.ndim == 3 else np.repeat(table[..., None], cell.size, axis=2)


def plane_posterior(y, times=TIMES):
    """Posterior of `plane_system`, from those of the two lines."""
    one, two = (posterior(part, y[:, [j]], times) for j, part in enumerate(product_parts()))
    mean = np.stack([one.mean[:, 0], two.mean[:, 0], one.mean[:, 1]], axis=1)
    cov = np.zeros((len(times), 3, 3))
    cov[:, [[0], [2]], [0, 2]], cov[:, 1, 1] = one.cov, two.cov[:, 0, 0]
    prob = (one.mode_prob[:, :, None] * two.mode_prob[:, None]).reshape(len(times), 4)
    return Posterior(mean @ TURN.T, TURN @ cov @ TURN.T, one.loglik + two.loglik, prob)


def line_system(**changes):
    return PiecewiseLinearSystem(**(line_parts() | changes))


def records(system, count=3):
    """Records (K+1, m, count): complete, partly missing, and with whole times missing."""
    y = system.simulate(TIMES, count, 7).measurements
    y[0] = 0.4  # nothing is measured at the first time by itself
    if len(y[0]) > 1:
        y[1, 0, 1] = y[3, 1, 1] = np.nan
    y[[0, 2, 3], :, 2] = np.nan
    return y


def tent(**changes):
    """The tent map ``1 - 1.8 |x|``, whose modulus is seen."""
    parts = {
        "regions": [-INF, 0.0, INF],
        "dynamics": ([[1.0, 1.0]], [[[1.8, -1.8]]]),
        "sensor": ([[0.0, 0.0]], [[[-1.0, 1.0]]]),
        "sensor_noise": [[0.2]],
        "mean0": [0.1],
        "cov0": [[0.25]],
    }
    return PiecewiseLinearSystem(**(parts | changes))


def wave(cells, **changes):
    """Tangents of ``2 sin x + w / 2``, seen through ``x² / 5 + 0.3 v``."""
    x, v, w = sp.symbols("x v w")
    parts = {
        "state": (x,),
        "dynamics": [2 * sp.sin(x) + w / 2],
        "sensor": [x**2 / 5 + 3 * v / 10],
        "noise": (v, w),
        "breakpoints": np.linspace(-4, 4, cells + 1),
        "initial": ([1.0], [[0.5]]),
    }
    return PiecewiseLinearSystem.from_functions(**(parts | changes))


def lozi():
    """The Lozi map ``(1 - 1.7 |x| + z, x / 2)``, of which x is seen."""
    return PiecewiseLinearSystem(
        regions=line_cells([[1.0], [0.0]], [0.0]),
        dynamics=([1.0, 0.0], [[[1.7, -1.7], [1.0, 1.0]], [[0.5, 0.5], [0.0, 0.0]]]),
        sensor=([0.0], [[1.0, 0.0]]),
        sensor_noise=[[0.3]],
        mean0=[0.1, 0.1],
        cov0=[[0.3, 0.05], [0.05, 0.2]],
    )
