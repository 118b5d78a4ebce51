"""Identity of a model: what its functions do at fixed points, however they were written."""

from __future__ import annotations

import dataclasses

import numpy as np

SAME = 1e-9
"""Largest difference between equal models, in units of each component of each quantity."""

ROUNDING = 1e-14
"""What rounding makes of a component that should be zero, in units of what it comes from."""

POINTS = 12

PROBED = "probe_values/"
"""How the names of a probe's arrays begin in a file."""

OF_STATE = ("dynamics", "jump", "drift", "mean0", "switching", "initial")
"""How the names of quantities begin whose components are those of the state."""


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
    n, m = system.state_size, system.sensor.size
    found: dict[str, list] = {}

    def note(name, value, *shape):
        found.setdefault(name, []).append(np.reshape(np.asarray(value, dtype=float), shape))

    def note_moments(name, map, t, x):
        mean, cov = map.conditional_moments(t, x)
        note(f"{name} (mean)", mean, map.size)
        note(f"{name} (cov)", cov, map.size, map.size)

    for t, *x in points.T:
        x = np.array(x)[:, None]
        if hasattr(system, "dynamics"):
            note_moments("dynamics", system.dynamics, t, x)
        else:
            matrix = system.diffusion(t, x)
            note("drift", system.drift(t, x), n)
            note("diffusion", np.einsum("ikN,jkN->ijN", matrix, matrix), n, n)
            note("intensity", system.intensity(t, x))
            if system.jump is not None:
                note_moments("jump", system.jump, t, x)
        note_moments("sensor", system.sensor, t, x)
        mean, cross, cov = sensor(t, x, system.cov0)
        note("moments of the sensor (mean)", mean, m)
        note("moments of the sensor (cross)", cross, n, m)
        note("moments of the sensor (cov)", cov, m, m)
    values = {name: np.stack(parts) for name, parts in found.items()}
    values["mean0"], values["cov0"] = np.array([system.mean0]), np.array([system.cov0])
    return values


def difference(expected: dict, found: dict, points: np.ndarray) -> str:
    """What differs between two probes, in words; empty where nothing does.

    Parameters
    ----------
    expected, found : dict of str to ndarray
        The first axis of every array is over points; then come modes, where there are any, and
        components.
    points : ndarray, shape (1 + n, P)
    """
    for name in sorted(expected.keys() | found.keys()):
        if name not in expected or name not in found:
            return f"its {name} is there in only one of them"
        a, b = expected[name], found[name]
        if a.shape != b.shape:
            return f"its {name} has shape {b.shape}, not {a.shape}"
        # where neither has a value, such as the root of a negative state, they are equal
        known = np.isfinite(a)
        if (known != np.isfinite(b)).any():
            return f"its {name} has a value in only one of them at some points"
        with np.errstate(invalid="ignore"):
            unequal = ~((a == b) | (np.isnan(a) & np.isnan(b)))
            apart = np.where(unequal, np.abs(a - b), 0.0)
        beyond = apart > _room(name, expected, points)
        if beyond.any() or np.isnan(apart).any():
            size = np.where(beyond, np.where(known, np.abs(a), 0.0), 0.0).max()
            worst = np.where(beyond, apart, 0.0).max()
            quantity, bracket, part = name.partition(" (")
            return f"its {quantity} differs{bracket}{part} by up to {worst:.3g} of {size:.3g}"
    return ""


def _room(name, values, points) -> np.ndarray:
    """How far each component of a quantity may differ between equal models, without points.

    Each has its own unit: a mean is held against its size and its deviation, a covariance against
    the deviations of its two components, never against components in other units. Rounding
    enters through the mean, and through the state that it is computed from. A quantity without a
    covariance, such as an intensity, is held against itself.
    """
    span, state = float(np.ptp(points[0])) or 1.0, np.abs(points[1:]).max(axis=1)
    mean, cov = _pair(name)
    if cov not in values or name.endswith("(probability)"):
        least = {"intensity": ROUNDING / span, "likelihood": SAME}.get(name, ROUNDING)
        return SAME * _largest(values[name]) + least
    # rates are held against what they add up to over the time of the design
    time = span if name in ("drift", "diffusion") else 1.0
    size, deviation = time * _largest(values[mean]), np.sqrt(time) * _deviation(values[cov])
    lost = ROUNDING * np.maximum(size, state if mean.startswith(OF_STATE) else 0.0)
    if name == mean:
        return (SAME * (size + deviation) + lost) / time
    rows, rows_lost, rows_size = deviation, lost, size
    if name.endswith("(cross)"):
        rows, rows_lost, rows_size = _deviation(values["cov0"]), ROUNDING * state, state
    room = SAME * _outer(rows, deviation)
    room = room + _outer(rows_lost, deviation) + _outer(rows + rows_lost, lost)
    if name.startswith("moments"):  # perhaps the difference of a second moment and a square
        room = room + ROUNDING * _outer(rows_size, size)
    return room / time


def _pair(name) -> tuple[str, str]:
    """Names of the mean and the covariance that a quantity belongs to."""
    for pair in (("drift", "diffusion"), ("mean0", "cov0")):
        if name in pair:
            return pair
    quantity = name.rpartition(" (")[0]
    return f"{quantity} (mean)", f"{quantity} (cov)"


def _largest(part):
    """Largest finite size over the points."""
    return np.where(np.isfinite(part), np.abs(part), 0.0).max(axis=0, initial=0.0)


def _deviation(cov):
    """Largest deviation of each component over the points."""
    return np.sqrt(_largest(np.diagonal(cov, axis1=-2, axis2=-1)))


def _outer(a, b):
    return a[..., :, None] * b[..., None, :]


def probe_arrays(points: np.ndarray, values: dict) -> dict[str, np.ndarray]:
    """Arrays of a file that keep a probe."""
    return {"probe_x": points, **{f"{PROBED}{name}": part for name, part in values.items()}}


def probe_values(arrays: dict, size: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points and values of the probe in a file of a model with `size` state components.

    Raises
    ------
    KeyError, ValueError
        No points, or others than `probe_points` makes.
    """
    points = arrays["probe_x"]
    if points.shape != (size + 1, POINTS) or not np.isfinite(points).all():
        raise ValueError(f"probe_x of shape {points.shape}")
    kept = {n.removeprefix(PROBED): part for n, part in arrays.items() if n.startswith(PROBED)}
    return points, kept


def described(thing) -> dict:
    """Name and options of a linearization or a predictor, for a header."""
    options = dataclasses.asdict(thing) if dataclasses.is_dataclass(thing) else {}
    return {"name": type(thing).__name__, **options}
