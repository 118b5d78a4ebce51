"""Exact filters of the scalar switching system, of order one and with remembered measurements.

Written from [R-SW 3.1, 4.1-4.8] alone, for the references that come from outside of the project.
The distribution of the memory (a decided mode and an estimate) and of the object (mode and state)
moves from measurement to measurement; an estimate is split between the two nearest nodes of its
axis.
"""

from __future__ import annotations

import numpy as np

NOISE = {"A1H": 2.0, "A1L": 0.5, "A2": 1.0}
MEASURED = {"A1H": (-18, 20), "A1L": (-11, 13), "A2": (-8, 26)}


def bell(away, deviation):
    return np.exp(-0.5 * (away / deviation) ** 2) / (deviation * np.sqrt(2 * np.pi))


def model(sensor, states, measurements):
    """Nodes and their modes' shared values, transition, likelihoods with the step, the start."""
    x = np.linspace(-8, 8, states)
    y, step = np.linspace(*MEASURED[sensor], measurements, retstep=True)
    leave, back = 0.35 - 0.3 * np.exp(-(x**2) / 8), 0.1 + 0.5 * np.exp(-(x**2) / 2)
    moves = [bell(x - mean[:, None], 0.5) for mean in (x + 1.8 * np.sin(x), 0.6 * x)]
    still, fall = (move / move.sum(axis=1, keepdims=True) for move in moves)
    transition = np.block(
        [
            [(1 - leave)[:, None] * still, leave[:, None] * still],
            [back[:, None] * fall, (1 - back)[:, None] * fall],
        ]
    )
    shown = [x / 2 + x**2 / 5] * 2 if sensor == "A2" else [x, 2 + x]
    likely = np.hstack([bell(y[:, None] - mean, NOISE[sensor]) * step for mean in shown])
    start = bell(x, 1.0)
    return (
        np.concatenate([x, x]),
        transition,
        likely,
        np.concatenate([start, start]) / (2 * start.sum()),
    )


def errors(sensor, steps, states=121, estimates=161, measurements=301):
    """Mean squares of the error and probabilities of a wrong mode, at k = 0 to steps - 1."""
    z = np.linspace(-6, 6, estimates)
    both, transition, likely, start = model(sensor, states, measurements)
    dist, found = start[None], []
    for k in range(steps):
        dist = dist @ transition if k else dist
        ahead, square, right = (
            np.zeros((2 * estimates, 2 * states)),
            dist.sum(axis=0) @ both**2,
            0.0,
        )
        for weight in likely:
            joint = dist * weight
            modes = joint.reshape(len(dist), 2, states).sum(axis=2)
            mass, right = modes.sum(axis=1), right + modes.max(axis=1).sum()
            first = joint @ both
            mean = np.divide(first, mass, out=np.zeros_like(mass), where=mass > 1e-300)
            square -= mean @ first
            place = np.clip((mean - z[0]) / (z[1] - z[0]), 0, estimates - 1 - 1e-9)
            low = place.astype(int)
            share, cell = place - low, low + estimates * modes.argmax(axis=1)
            np.add.at(ahead, cell, joint * (1 - share)[:, None])
            np.add.at(ahead, cell + 1, joint * share[:, None])
        found.append((square, 1 - right))
        dist = ahead[ahead.sum(axis=1) > 1e-14]
        dist /= dist.sum()
    return np.array(found).T


def remembered(sensor, length, k, states=65, measurements=81):
    """Mean square of the error and share of wrong modes at k, with y_k and `length` before it.

    Nothing is remembered but measurements, so the sums run over all of their nodes; those before
    do not matter.
    """
    both, transition, likely, dist = model(sensor, states, measurements)
    for _ in range(k - length):
        dist = dist @ transition
    dists = dist[None]  # joint distribution of the remembered measurements and of the object
    square, right = 0.0, 0.0
    for _ in range(length):
        dists = (dists[:, None] * likely).reshape(-1, len(dist)) @ transition
    for part in np.array_split(dists, max(1, len(dists) // 100)):
        joint = part[:, None] * likely
        mass, first = joint.sum(axis=2), joint @ both
        mean = np.divide(first, mass, out=np.zeros_like(mass), where=mass > 1e-300)
        square += (joint @ both**2).sum() - (mean * first).sum()
        right += joint.reshape(*mass.shape, 2, -1).sum(axis=3).max(axis=2).sum()
    return square, 1 - right
