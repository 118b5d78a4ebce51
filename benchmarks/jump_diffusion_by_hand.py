"""Linear example and flip process by a second route: plain NumPy and SciPy, no random numbers.

Run by hand, ``python benchmarks/jump_diffusion_by_hand.py``; writes the references of two claims,
``benchmarks/jump_diffusion_by_hand.csv``, beside itself. Nothing of the library is used.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.linalg import expm
from scipy.sparse import csr_matrix
from scipy.stats import norm

# Linear example: every variable is a vector of coefficients of independent unit variables


def linear_errors(kind: str, l: int, count: int = 21) -> np.ndarray:
    """Mean-square errors of the position; `kind` is "state", "position" or "measurements"."""
    drift = np.array([[0.0, 1.0], [-1.0, -0.4]])
    wide = expm(0.5 * np.block([[-drift, np.diag([0.0, 1.0])], [np.zeros((2, 2)), drift.T]]))
    move = wide[2:, 2:].T
    root = np.linalg.cholesky(move @ wide[:2, 2:])
    size = 3 * count  # x_0 or w_k, and v_k
    x, memory, found = np.zeros((2, size)), [], []
    for k in range(count):
        own = np.zeros((2, size))
        own[:, 3 * k : 3 * k + 2] = root if k else np.eye(2)
        x = move @ x + own
        y = x[:1].copy()
        y[0, 3 * k + 2] = 0.5
        if memory:
            u = np.concatenate(memory)
            gain = np.linalg.lstsq(u.T, x.T, rcond=1e-11)[0].T
            mean = gain @ u
        else:
            mean = 0 * x
        spread = (x - mean) @ (x - mean).T
        z = mean + spread[:, :1] / (spread[0, 0] + 0.25) @ (y - mean[:1])
        kept = {"state": z, "position": z[:1], "measurements": y}[kind]
        memory = [kept, *memory][:l]
        found.append(((x - z)[0] ** 2).sum())
    return np.array(found)


# Flip process: the recursion (4.4) to (4.10) on a grid


def flip_chain(nodes: int, span: float = 0.25) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States, start and transition over a time: fitted fluxes, jumps by landing probabilities."""
    x = np.linspace(-3.5, 3.5, nodes)
    h = x[1] - x[0]
    face = (x[1:] + x[:-1]) / 2
    q = (face - face**3) * h / 0.125
    ahead = np.where(np.abs(q) < 1e-9, 1.0, q / np.expm1(np.where(np.abs(q) < 1e-9, 1.0, q)))
    up, down = 0.125 / h**2 * (ahead + q), 0.125 / h**2 * ahead
    rates = np.diag(up, -1) + np.diag(down, 1)
    edges = np.concatenate([[-np.inf], face, [np.inf]])
    landing = np.diff(norm.cdf(edges[:, None], -x, 0.3), axis=0)
    rates = rates + (0.3 + 0.2 * x**2) * landing
    rates -= np.diag(rates.sum(axis=0))
    return x, np.diff(norm.cdf(edges, 1.0, 0.5)), expm(span * rates)


def split(values: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower neighbour and upper weight that keep the mean."""
    place = np.clip((values - axis[0]) / (axis[1] - axis[0]), 0, len(axis) - 1)
    low = np.minimum(place.astype(int), len(axis) - 2)
    return low, place - low


def flip_errors(rule: str, l: int, sizes: tuple[int, int, int], count: int = 13) -> np.ndarray:
    """E(X - Z)² after each measurement; `rule` is "exact", "gaussian" or "linearised"."""
    x, dist, move = flip_chain(sizes[0])
    axis, y = np.linspace(-3, 3, sizes[1]), np.linspace(-8, 8, sizes[2])
    spread = 0.25 + 0.09 * x**2
    likely = np.exp(-0.5 * (y[:, None] - x) ** 2 / spread) / np.sqrt(2 * np.pi * spread)
    likely *= (y[1] - y[0]) * np.where(np.isin(np.arange(len(y)), [0, len(y) - 1]), 0.5, 1)[:, None]
    joint, memory, found = dist[None], np.zeros((0, 1)), []  # (cells, states), (blocks, cells)
    for k in range(count):
        if k:
            joint = joint @ move.T
        mass = likely @ joint.T  # (measurements, cells)
        if rule == "exact":
            f = (likely * x) @ joint.T / np.where(mass > 1e-300, mass, np.inf)
        else:
            weight = joint.sum(axis=1)
            u = np.concatenate([np.ones((1, len(weight))), memory])
            gain = np.linalg.lstsq((u * weight) @ u.T, u @ (joint @ x), rcond=1e-12)[0]
            m = gain @ u
            t = (joint * (x - m[:, None]) ** 2).sum()
            s = t + 0.09 * (m**2 + (t if rule == "gaussian" or k == 0 else 0)) + 0.25
            f = m + t / s * (y[:, None] - m)
        found.append(0.0)
        new = np.zeros((len(axis) ** min(k + 1, l), len(x)))
        older = len(axis) ** (min(k + 1, l) - 1)
        cells = np.arange(joint.shape[0])
        kept = cells // (joint.shape[0] // older)  # newest block first: the oldest is dropped
        for j in range(len(y)):
            low, upper = split(f[j], axis)
            part = joint * likely[j]
            rows = np.concatenate([low * older + kept, (low + 1) * older + kept])
            push = csr_matrix(
                (np.concatenate([1 - upper, upper]), (rows, np.tile(cells, 2))),
                shape=(len(new), len(cells)),
            )
            new += push @ part
            found[-1] += (part * (x - f[j][:, None]) ** 2).sum()
        joint = new
        blocks = np.meshgrid(*[axis] * min(k + 1, l), indexing="ij")
        memory = np.array([block.ravel() for block in blocks])
    return np.array(found)


SHOWN = [0, 1, 2, 4, 6, 8, 12]


def main() -> None:
    rows: list[tuple[str, str, float, float]] = []
    state = linear_errors("state", 1)
    rows += [("JD-X1", f"Kalman, k = {k}", state[k], 0.0) for k in (0, 1, 2, 5, 10, 20)]
    for kind, orders in (("position", (1, 2, 3, 4, 6)), ("measurements", (1, 2, 4, 8))):
        for l in orders:
            rows.append(("JD-X1", f"last {kind}, l = {l}", linear_errors(kind, l)[-1], 0.0))
    for rule, l, sizes in (
        ("exact", 1, (281, 601, 241)),
        ("gaussian", 1, (281, 601, 241)),
        ("linearised", 1, (281, 601, 241)),
        ("exact", 2, (141, 121, 97)),
    ):
        errors = flip_errors(rule, l, sizes)
        rows += [("JD-X2", f"{rule} {l}, k = {k}", errors[k], 0.0) for k in SHOWN]
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["claim", "quantity", "value", "standard_error"])
        for claim, quantity, value, error in rows:
            writer.writerow([claim, quantity, f"{value:.12g}", f"{error:.3g}"])
            print(claim, quantity, f"{value:.10g}", f"{error:.2g}")


if __name__ == "__main__":
    main()
