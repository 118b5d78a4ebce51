"""Identity of a model: the values of its functions at fixed points, however they were written."""

from __future__ import annotations

import numpy as np

from seedslib.base.values import Values
from seedslib.models.kinds import AnySystem, in_steps, switches
from seedslib.models.switching import SwitchingSystem

SAME = 1e-9
"""Largest difference between equal models, in units of each component of each quantity."""

ROUNDING = 1e-5
"""Part of a mean that counts as a deviation: rounding moves the covariance beside a large mean."""

POINTS = 12

NODES = 5
"""Gauss-Hermite nodes of the noise at which a branch of a switching system is evaluated."""


def probe_points(system: AnySystem, start: float, stop: float) -> np.ndarray:
    """Times and states (1 + n, 12) where the model is evaluated, about its initial state."""
    n = system.state_size
    spread = np.sqrt(np.diagonal(system.cov0))
    # where the initial state is known, the points are within one unit of it
    spread = np.where(spread > 0, spread, 1.0)
    # additive recurrences of irrational steps: even, and the same on every machine
    steps = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0])
    share = np.outer(np.arange(1, POINTS + 1), np.resize(steps, n + 1)) % 1.0
    times = start + (stop - start) * share[:, 0]
    states = np.asarray(system.mean0) + spread * (6.0 * share[:, 1:] - 3.0)
    return np.concatenate([times[:, None], states], axis=1).T


@np.errstate(all="ignore")  # a model may have no value at a point
def probe(system: AnySystem, points: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the model's functions at the points, by name; the first axis is over points.

    Diffusions are compared by B Bᵀ and noises by their effect, so that equal distributions are
    equal models. Of each branch of a switching system its probability, and mean and covariance of
    its value weighed by it, over nodes of the noise.

    Parameters
    ----------
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem
    points : ndarray, shape (1 + n, P)
    likelihood : bool
        Whether densities of measurements count, where the sensor has them.
    """
    p = system.nominal_values()
    if switches(system):
        return _branches(system, points, p)
    rows = [_values(system, t, np.array(x)[:, None], p) for t, *x in points.T]
    values = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    for part in ("mean", "cov"):
        values[f"mean0, cov0 ({part})"] = np.array([getattr(system, f"{part}0")])
    return values


def _values(system, t, x, p):
    """Values of one that does not switch at one time and state (n, 1)."""
    maps, values = {"sensor": system.sensor}, {}
    if in_steps(system):
        maps["dynamics"] = system.dynamics
    else:
        matrix = system.diffusion(t, x, p)
        values["drift, diffusion (mean)"] = np.reshape(system.drift(t, x, p), -1)
        values["drift, diffusion (cov)"] = np.einsum("ikN,jkN->ij", matrix, matrix)
        values["intensity"] = np.reshape(system.intensity(t, x, p), ())
        if system.jump is not None:
            maps["jump"] = system.jump
    for name, map in maps.items():
        mean, cov = map.conditional_moments(t, x, p)
        values[f"{name} (mean)"] = np.reshape(mean, map.size)
        values[f"{name} (cov)"] = np.reshape(cov, (map.size, map.size))
    return {name: np.asarray(value, dtype=float) for name, value in values.items()}


def _branches(system: SwitchingSystem, points: np.ndarray, p: Values) -> dict[str, np.ndarray]:
    """Values of a switching system: of all its branches, and of its initial modes."""
    # filters of the two drives differ even where the distributions do not
    values = {} if system.drives == "old" else {"drive by the new mode": np.ones((1, 1))}
    for name, table, noise in (
        ("switching", system.branches, system.noise),
        ("readings", system.readings, system.sensor_noise),
    ):
        v, weights = noise.rule(NODES)
        branches = [branch for row in table for branch in row]
        size = next(branch.map.size for branch in branches if branch is not None)
        shape = (points.shape[1], len(branches))
        prob, mean = np.zeros(shape), np.zeros((*shape, size))
        cov = np.zeros((*shape, size, size))
        for place in np.ndindex(*shape):
            branch, (t, *x) = branches[place[1]], points[:, place[0]]
            if branch is None:
                continue
            x = np.repeat(np.array(x)[:, None], len(weights), axis=1)
            y, share = branch.map.value(t, x, v, p), branch.map.weight(t, x, v, p) * weights
            prob[place], mean[place] = share.sum(), y @ share
            # about the mean: beside a large mean a small variance would not be seen
            residual = y - (mean[place] / prob[place])[:, None] if prob[place] else y
            cov[place] = (residual * share) @ residual.T
        values |= {f"{name} (probability)": prob, f"{name} (mean)": mean, f"{name} (cov)": cov}
    for name in ("probability", "mean", "cov"):
        values[f"initial ({name})"] = np.array([[getattr(part, name) for part in system.initial]])
    return values


def difference(expected: dict[str, np.ndarray], given: dict[str, np.ndarray]) -> str:
    """How two probes differ, in words; empty where they do not.

    Each component has its own unit: a mean is compared by its size and its deviation, a
    covariance by the deviations of its two components, anything else by itself.
    """
    for name in sorted(expected.keys() | given.keys()):
        if name not in expected or name not in given:
            return f"its {name} is in only one of them"
        a, b = expected[name], given[name]
        if a.shape != b.shape:
            return f"its {name} has shape {b.shape}, not {a.shape}"
        # where neither has a value, such as the root of a negative state, they are equal
        if (np.isfinite(a) != np.isfinite(b)).any():
            return f"its {name} has a value in only one of them at some points"
        with np.errstate(invalid="ignore"):
            distance = np.where((a == b) | ~np.isfinite(a), 0.0, np.abs(a - b))
        beyond = distance > SAME * _units(name, expected)
        if beyond.any():
            size, worst = np.abs(a[beyond]).max(), distance[beyond].max()
            return f"its {name} differs by up to {worst:.3g} of {size:.3g}"
    return ""


def _units(name: str, values: dict[str, np.ndarray]) -> np.ndarray:
    """Unit of each component of a quantity, without points."""
    quantity, part = name.partition(" (")[::2]
    size, cov = _largest(values[name]), values.get(f"{quantity} (cov)")
    if part not in ("mean)", "cov)") or cov is None:
        return size + ROUNDING
    deviation = np.sqrt(np.diagonal(_largest(cov), axis1=-2, axis2=-1))
    if part == "mean)":
        return size + deviation
    deviation = deviation + ROUNDING * _largest(values[f"{quantity} (mean)"])
    return deviation[..., :, None] * deviation[..., None, :]


def _largest(values: np.ndarray) -> np.ndarray:
    """Largest finite size over the points."""
    return np.where(np.isfinite(values), np.abs(values), 0.0).max(axis=0, initial=0.0)
