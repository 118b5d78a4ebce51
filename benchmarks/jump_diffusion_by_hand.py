"""The jump-diffusion examples by a second route: plain NumPy and SciPy, nothing of the library.

Run by hand, ``python benchmarks/jump_diffusion_by_hand.py`` (a few minutes); writes
``benchmarks/jump_diffusion_by_hand.csv`` beside itself: the references of the ledger's own claims.
Filters are written out from (6.2) and (6.3), steps of 0.01 by Euler and Maruyama; what needs no
random numbers is in `jump_diffusion_exact.py`.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from jump_diffusion_exact import flip_errors, linear_errors

DT = 0.01


# Affine filters of simulated signals: regressions on the memory, closed-form corrections


def regression(x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gamma, kappa, T of (6.3)."""
    dx, du = x - x.mean(axis=1, keepdims=True), u - u.mean(axis=1, keepdims=True)
    gain = np.linalg.lstsq(du.T, dx.T, rcond=1e-8)[0].T
    rest = dx - gain @ du
    return gain, x.mean(axis=1) - gain @ u.mean(axis=1), rest @ rest.T / x.shape[1]


def forecast(fit: tuple, u: np.ndarray) -> np.ndarray:
    return fit[0] @ u + fit[1][:, None]


def oscillator_step(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    w = np.sqrt(DT) * rng.standard_normal(x.shape[1])
    pull = -((0.1 * np.pi) ** 2) * x[0] + 2 * x[1] * (1 - x[0] ** 2)
    return np.array([x[0] + x[1] * DT, x[1] + pull * DT + x[0] * w])


def oscillator_correction(m: np.ndarray, d: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Z of (6.2) for Y = (X1² + V1, X2 + V2), Gaussian version."""
    h = np.array([m[0] ** 2 + d[0, 0], m[1]])
    f11, f12 = 4 * m[0] ** 2 * d[0, 0] + 2 * d[0, 0] ** 2 + 1, 2 * m[0] * d[0, 1]
    f22, (r1, r2) = d[1, 1] + 1, y - h
    det = f11 * f22 - f12**2
    s1, s2 = (f22 * r1 - f12 * r2) / det, (f11 * r2 - f12 * r1) / det
    return np.array([m[i] + 2 * m[0] * d[i, 0] * s1 + d[i, 1] * s2 for i in range(2)])


def oscillator_pass(paths: int, rng: np.random.Generator, design: dict | None):
    """One pass: the design is made on the way, or used; estimates at nodes and true positions."""
    fits = {} if design is None else design
    x = np.array([[2.0], [0.0]]) + np.sqrt(0.15) * rng.standard_normal((2, paths))
    truth, nodes, m = np.empty((301, paths)), np.empty((7, 6, paths)), None
    for k in range(7):
        y = np.array([x[0] ** 2, x[1]]) + rng.standard_normal((2, paths))
        if k == 0:
            if design is None:
                fits[0] = regression(x, y)
            z = forecast(fits[0], y)
        else:
            z = oscillator_correction(m, fits[k - 1, 5][2], y)
        nodes[k, 0], truth[50 * k] = z[0], x[0]
        for i in range(1, 6 if k < 6 else 1):
            for j in range(10):
                x = oscillator_step(x, rng)
                truth[50 * k + 10 * (i - 1) + j + 1] = x[0]
            if design is None:
                fits[k, i] = regression(x, z)
            m = forecast(fits[k, i], z)
            nodes[k, i] = m[0]
    return fits, truth, nodes


def course(nodes: np.ndarray, kind: str) -> np.ndarray:
    """Estimate of the position on the grid of 301 times by a kind of forecast."""
    found = np.empty((301, nodes.shape[-1]))
    for j in range(301):
        k, s = min(j // 50, 6), j % 50
        i, w = s // 10, (s % 10) / 10
        here, back = nodes[k, i], nodes[k, i - 1] if i else None
        if kind == "constant" or (kind == "linear" and k == 0):
            found[j] = nodes[k, 0]
        elif kind == "linear":
            found[j] = nodes[k, 0] + (nodes[k, 0] - nodes[k - 1, 0]) * s / 50
        elif kind == "interpolated":
            found[j] = (1 - w) * here + (w * nodes[k, i + 1] if w else 0.0)
        elif kind == "piecewise constant" or not w or (back is None and kind != "literal"):
            found[j] = here
        else:
            if back is None:  # the slope across the measurement
                back = nodes[k - 1, 4] if k else here
            found[j] = here + (here - back) * w
    return found


KINDS = ("interpolated", "literal", "first constant", "constant", "linear")


def forecast_kinds(train: int, test: int, seed: int) -> list[tuple[str, float, float]]:
    """Time-averaged RMS error less that of the piecewise constant forecast; by 40 batches."""
    one, two = np.random.SeedSequence(seed).spawn(2)
    fits = oscillator_pass(train, np.random.default_rng(one), None)[0]
    _, truth, nodes = oscillator_pass(test, np.random.default_rng(two), fits)
    squares = {
        kind: ((course(nodes, kind) - truth) ** 2).mean(axis=0)
        for kind in ("piecewise constant", *KINDS)
    }
    return [(kind, *apart(squares[kind], squares["piecewise constant"])) for kind in KINDS]


def apart(one: np.ndarray, two: np.ndarray) -> tuple[float, float]:
    """Difference of two root-mean-squares on the same paths, and its standard error."""
    a, b = np.sqrt(one.mean()), np.sqrt(two.mean())
    each = (one - one.mean()) / (2 * a) - (two - two.mean()) / (2 * b)
    return float(a - b), float(each.std() / np.sqrt(len(one)))


# Kicked Duffing oscillator


def duffing_rates(m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Velocity with the mean of the kicks, and the intensity."""
    mu = 0.2 + 0.2 * m[0] ** 2
    return np.array([m[1], m[0] - m[0] ** 3 - 0.5 * m[1] + 0.5 * mu]), mu


def duffing_step(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    b, mu = duffing_rates(x)
    kicked = rng.random(x.shape[1]) < 1 - np.exp(-mu * DT)
    kick = kicked * (0.5 + 3 * rng.standard_normal(x.shape[1]))
    noise = 0.2 * np.sqrt(DT) * rng.standard_normal(x.shape[1])
    return x + DT * np.array([b[0], b[1] - 0.5 * mu]) + np.array([0 * kick, noise + kick])


def duffing_correction(m, d, y, gaussian=True):
    """Z and its covariance for Y = X1 (1 + 0.2 V1) + V2; d may have a path axis."""
    f = d[0, 0] + 0.04 * (m[0] ** 2 + (d[0, 0] if gaussian else 0)) + 1
    gain = np.array([d[0, 0] / f, d[1, 0] / f])
    cov = np.array([[d[i, j] - gain[i] * d[0, j] for j in range(2)] for i in range(2)])
    return m + gain * (y - m[0]), cov


def ekf_slope(m: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    b, mu = duffing_rates(m)
    a21 = 1 - 3 * m[0] ** 2 + 0.2 * m[0]
    p12 = p[1, 1] + a21 * p[0, 0] - 0.5 * p[0, 1]
    p22 = 2 * (a21 * p[0, 1] - 0.5 * p[1, 1]) + 0.04 + 9.25 * mu
    return b, np.array([[2 * p[0, 1], p12], [p12, p22]])


def duffing_pass(paths: int, rng: np.random.Generator, design: dict | None):
    """Squared errors of the position at 13 measurements for four filters."""
    fits = {} if design is None else design
    x = np.array([[1.0], [0.0]]) + np.sqrt(0.1) * rng.standard_normal((2, paths))
    m = np.broadcast_to(np.array([[1.0], [0.0]]), x.shape)
    p = np.broadcast_to(0.1 * np.eye(2)[:, :, None], (2, 2, paths))
    squares = {name: np.empty((13, paths)) for name in ("both", "position", "continuous", "EKF")}
    wild, u = np.zeros(paths, bool), {}
    for k in range(13):
        y = x[0] * (1 + 0.2 * rng.standard_normal(paths)) + rng.standard_normal(paths)
        if k == 0 and design is None:
            fits["start"] = regression(x, y[None])
        for name in ("both", "position", "continuous"):
            if k == 0:
                z = forecast(fits["start"], y[None])
            else:
                fit = fits[name, k]
                z, _ = duffing_correction(forecast(fit, u[name]), fit[2], y, name != "continuous")
            u[name] = z[:1] if name == "position" else z
            squares[name][k] = (z[0] - x[0]) ** 2
        m, p = duffing_correction(m, p, y, gaussian=False)
        squares["EKF"][k] = (m[0] - x[0]) ** 2
        wild |= ~(np.abs(m).max(axis=0) < 20)
        m = np.where(wild, 0.0, m)
        p = np.where(wild, np.eye(2)[:, :, None], p)
        for j in range(50 if k < 12 else 0):
            if design is None:
                fits["flow", k, j] = regression(x, u["continuous"])
            rate, _ = duffing_rates(forecast(fits["flow", k, j], u["continuous"]))
            u["continuous"] = u["continuous"] + DT * rate
            a = ekf_slope(m, p)
            b = ekf_slope(m + DT / 2 * a[0], p + DT / 2 * a[1])
            c = ekf_slope(m + DT / 2 * b[0], p + DT / 2 * b[1])
            d = ekf_slope(m + DT * c[0], p + DT * c[1])
            m, p = (
                old + DT / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i]) for i, old in enumerate((m, p))
            )
            x = duffing_step(x, rng)
        if design is None and k < 12:
            for name, memory in u.items():
                fits[name, k + 1] = regression(x, memory)
    return fits, {name: row[4:, ~wild].mean(axis=0) for name, row in squares.items()}


def duffing_differences(train: int, test: int, seed: int) -> list[tuple[str, float, float]]:
    """RMS error from the fifth measurement on, less that of the affine filter of order one."""
    one, two = np.random.SeedSequence(seed).spawn(2)
    fits = duffing_pass(train, np.random.default_rng(one), None)[0]
    squares = duffing_pass(test, np.random.default_rng(two), fits)[1]
    return [
        (name, *apart(squares[name], squares["both"])) for name in ("position", "continuous", "EKF")
    ]


SHOWN = [0, 1, 2, 4, 6, 8, 12]


def main() -> None:
    rows: list[tuple[str, str, float, float]] = []
    state = linear_errors("state", 1)
    rows += [("JD-X1", f"Kalman, k = {k}", state[k], 0.0) for k in (0, 1, 2, 5, 10, 20)]
    for kind, orders in (("position", (1, 2, 3, 4, 6)), ("measurements", (1, 2, 4, 8))):
        for l in orders:
            rows.append(("JD-X1", f"last {kind}, l = {l}", linear_errors(kind, l)[-1], 0.0))
    for name, value, error in duffing_differences(40_000, 100_000, 1):
        rows.append(("JD-X3", name, value, error))
    for name, value, error in forecast_kinds(60_000, 60_000, 1):
        rows.append(("JD-X4", name, value, error))
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
