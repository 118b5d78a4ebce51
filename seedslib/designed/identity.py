"""Identity of a model: what its functions do at fixed points, however they were written."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.linearization.moments import Linearization
from seedslib.linearization.points import GaussHermite
from seedslib.models.kinds import AnySystem, in_steps, switches

SAME = 1e-9
"""Largest difference between equal models, in units of each component of each quantity."""

ROUNDING = 1e-14
"""What rounding makes of a component that should be zero, in units of what it comes from."""

POINTS = 12

NODES = 5
"""Gauss-Hermite nodes of the noise at which a branch of a switching system is looked at."""

_ANY = GaussHermite(3)
"""Any rule does to look at a sensor; this one takes every sensor there is."""

PROBED = "probe_values/"
"""How the names of a probe's arrays begin in a file."""

OF_STATE = ("dynamics", "jump", "drift", "mean0", "switching", "initial")
"""How the names of quantities begin whose components are those of the state."""


def probe_points(system: AnySystem, start: float, stop: float) -> np.ndarray:
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


@np.errstate(all="ignore")  # a model may have no value at a point
def probe(
    system: AnySystem, points: np.ndarray, linearization: Linearization | None = None
) -> dict[str, np.ndarray]:
    """What the model's functions give at the points, by name.

    Diffusions are compared by B Bᵀ and noises by their effect, so that equal laws are equal
    models. Of each branch of a switching system its probability, and mean and covariance of its
    value weighed by it, over nodes of the noise.

    Parameters
    ----------
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem
    points : ndarray, shape (1 + n, P)
    linearization : Linearization, optional
        The moments of the sensor that the filter takes are part of the identity. Without one the
        sensor is looked at by any rule, and its likelihood too where it has one.
    """
    p = system.nominal_values()
    if switches(system):
        return _branches(system, points, p)
    rule = _ANY if linearization is None else linearization
    values = _moments(system, rule.moments(system.sensor), points, p)
    if linearization is None and system.sensor.has_log_density:
        likelihoods = [_likelihood(system.sensor, t, x, p) for t, *x in points.T]
        values["likelihood"] = np.stack(likelihoods)
    return values


def _moments(system, sensor, points, p):
    n, m = system.state_size, system.sensor.size
    found: dict[str, list] = {}

    def note(name, value, *shape):
        found.setdefault(name, []).append(np.reshape(np.asarray(value, dtype=float), shape))

    def note_moments(name, map, t, x):
        mean, cov = map.conditional_moments(t, x, p)
        note(f"{name} (mean)", mean, map.size)
        note(f"{name} (cov)", cov, map.size, map.size)

    for t, *x in points.T:
        x = np.array(x)[:, None]
        if in_steps(system):
            note_moments("dynamics", system.dynamics, t, x)
        else:
            matrix = system.diffusion(t, x, p)
            note("drift", system.drift(t, x, p), n)
            note("diffusion", np.einsum("ikN,jkN->ijN", matrix, matrix), n, n)
            note("intensity", system.intensity(t, x, p))
            if system.jump is not None:
                note_moments("jump", system.jump, t, x)
        note_moments("sensor", system.sensor, t, x)
        mean, cross, cov = sensor(t, x, system.cov0, p)
        note("moments of the sensor (mean)", mean, m)
        note("moments of the sensor (cross)", cross, n, m)
        note("moments of the sensor (cov)", cov, m, m)
    values = {name: np.stack(parts) for name, parts in found.items()}
    values["mean0"], values["cov0"] = np.array([system.mean0]), np.array([system.cov0])
    return values


def _likelihood(sensor, t, x, p):
    """Log-densities of measurements up to two deviations from their mean at a state."""
    x = np.array(x)[:, None]
    mean, cov = sensor.conditional_moments(t, x, p)
    mean = np.reshape(mean, (-1, 1))
    spread = np.sqrt(np.diagonal(np.reshape(cov, (len(mean), len(mean)))))[:, None]
    y = mean + spread * np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    return sensor.log_density(t, y, np.broadcast_to(x, (len(x), 5)), p)


def _branches(system, points, p):
    # filters of the two differ even where the laws do not
    found = {} if system.drives == "old" else {"drive by the new mode": np.ones((1, 1))}
    for name, table, noise in (
        ("switching", system.branches, system.noise),
        ("readings", system.readings, system.sensor_noise),
    ):
        v, weights = noise.rule(NODES)
        branches, count = [b for row in table for b in row], points.shape[1]
        size = next(b.map.size for b in branches if b is not None)
        shape = (count, len(branches))
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
            apart = y - (mean[place] / prob[place])[:, None] if prob[place] else y
            cov[place] = (apart * share) @ apart.T
        found |= {f"{name} (probability)": prob, f"{name} (mean)": mean, f"{name} (cov)": cov}
    for name in ("probability", "mean", "cov"):
        parts = np.array([[getattr(part, name) for part in system.initial]])
        found[f"initial ({name})"] = parts
    return found


def difference(expected: dict[Any, Any], found: dict[Any, Any], points: np.ndarray) -> str:
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


def probe_arrays(points: np.ndarray, values: dict[Any, Any]) -> dict[str, np.ndarray]:
    """Arrays of a file that keep a probe."""
    return {"probe_x": points, **{f"{PROBED}{name}": part for name, part in values.items()}}


def probe_values(arrays: dict[Any, Any], size: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
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
    for name, part in {"probe_x": points, **kept}.items():
        if part.dtype != np.float64:
            raise ValueError(f"{name} of dtype {part.dtype}")
    return points, kept


def model_text(system: object) -> dict[str, str]:
    """The model in words, a label for people: nothing of it is ever read back."""
    modes = switches(system)
    if in_steps(system) and not modes:
        maps = {"dynamics": system.dynamics, "sensor": system.sensor}
        return {
            name: _lines(map.expressions) if map.symbolic else "array functions"
            for name, map in maps.items()
        }
    if not system.symbolic:
        return {"model": "array functions"}
    if modes:
        tables = {"switching": system.branches, "readings": system.readings}
        return {name: str([list(map(_branch, row)) for row in t]) for name, t in tables.items()}
    text = {
        "state": ", ".join(map(str, system.state)),
        "drift": _lines(system.drift_expressions),
        "diffusion": _lines(system.diffusion_expressions),
        "sensor": _lines(system.sensor.expressions),
    }
    if system.jump is not None:
        text["intensity"] = str(system.intensity_expression)
        text["jump"] = _lines(system.jump.expressions)
    return text


def _lines(expressions: object) -> str:
    return str(expressions.tolist())


def _branch(branch):
    """Weight and value of a branch, None where there is none."""
    return branch and [str(branch.map.weight_expression), *map(str, branch.map.expressions)]
