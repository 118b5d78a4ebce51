"""Identity of a model: what its functions do at fixed points, however they were written."""

from __future__ import annotations

import dataclasses

import numpy as np

SAME = 1e-9
"""Largest difference, relative to the size of the quantity, between equal models."""

POINTS = 12

PROBED = "probe_values/"
"""How the names of a probe's arrays begin in a file."""


def probe_points(system, start: float, stop: float) -> np.ndarray:
    """Times and states (1 + n, 12) where the model is looked at, about its initial law."""
    n = system.state_size
    spread = np.sqrt(np.diagonal(system.cov0))
    # where the initial state is known, the model is looked at within one unit of it
    spread = np.where(spread > 0, spread, 1.0)
    # additive recurrences of irrational steps: even, and the same on every machine
    steps = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0])
    share = np.outer(np.arange(1, POINTS + 1), np.resize(steps, n + 1)) % 1.0
    times = start + (stop - start) * share[:, 0]
    states = np.asarray(system.mean0) + spread * (6.0 * share[:, 1:] - 3.0)
    return np.concatenate([times[:, None], states], axis=1).T


def probe(system, linearization, points: np.ndarray) -> dict[str, np.ndarray]:
    """What the model's functions give at the points, by name.

    Diffusions are compared by B Bᵀ and noises by their effect, so that equal laws are equal
    models.

    Parameters
    ----------
    system : JumpDiffusion
    linearization : Linearization
        The moments of the sensor that the filter takes are part of the identity.
    points : ndarray, shape (1 + n, P)
    """
    sensor = linearization.moments(system.sensor)
    found: dict[str, list] = {}

    def note(name, value):
        found.setdefault(name, []).append(np.asarray(value, dtype=float))

    for t, *x in points.T:
        x = np.array(x)[:, None]
        if hasattr(system, "dynamics"):
            note("dynamics", _moments(system.dynamics, t, x))
        else:
            matrix = system.diffusion(t, x)
            note("drift", system.drift(t, x))
            note("diffusion", np.einsum("ikN,jkN->ijN", matrix, matrix))
            note("intensity", system.intensity(t, x))
            if system.jump is not None:
                note("jump", _moments(system.jump, t, x))
        note("sensor", _moments(system.sensor, t, x))
        for name, part in zip(("mean", "cross", "cov"), sensor(t, x, system.cov0), strict=True):
            note(f"moments of the sensor ({name})", part)
    values = {name: np.stack(parts) for name, parts in found.items()}
    values["mean0"], values["cov0"] = np.asarray(system.mean0), np.asarray(system.cov0)
    return values


def _moments(map, t, x):
    """Conditional mean and covariance of a map at one point, as one column."""
    mean, cov = map.conditional_moments(t, x)
    return np.concatenate([mean, cov.reshape(-1, 1)])


def difference(expected: dict, found: dict) -> str:
    """What differs between two probes, in words; empty where nothing does."""
    for name in sorted(expected.keys() | found.keys()):
        if name not in expected or name not in found:
            return f"its {name} is there in only one of them"
        a, b = expected[name], found[name]
        if a.shape != b.shape:
            return f"its {name} has shape {b.shape}, not {a.shape}"
        # where neither has a value, such as the root of a negative state, they are equal
        unequal = ~((a == b) | (np.isnan(a) & np.isnan(b)))
        if (np.isfinite(a) != np.isfinite(b)).any():
            return f"its {name} has a value in only one of them at some points"
        scale = np.abs(a[np.isfinite(a)]).max(initial=0.0)
        apart = np.abs(a[unequal] - b[unequal])
        if not (apart <= SAME * scale).all():
            return f"its {name} differs by up to {apart.max():.3g} of {scale:.3g}"
    return ""


def probe_arrays(points: np.ndarray, values: dict) -> dict[str, np.ndarray]:
    """Arrays of a file that keep a probe."""
    return {"probe_x": points, **{f"{PROBED}{name}": part for name, part in values.items()}}


def probe_values(arrays: dict, size: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points and values of the probe in a file of a model with `size` state components.

    Raises
    ------
    KeyError, ValueError
        No points, or points of another shape.
    """
    points = arrays["probe_x"]
    if points.ndim != 2 or len(points) != size + 1:
        raise ValueError(f"probe_x of shape {points.shape}")
    kept = {n.removeprefix(PROBED): part for n, part in arrays.items() if n.startswith(PROBED)}
    return points, kept


def described(thing) -> dict:
    """Name and options of a linearization or a predictor, for a header."""
    options = dataclasses.asdict(thing) if dataclasses.is_dataclass(thing) else {}
    return {"name": type(thing).__name__, **options}
