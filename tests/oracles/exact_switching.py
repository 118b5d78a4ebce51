"""The exact filter of order one of the scalar switching system, on grids.

Written from [R-SW 3.1, 4.1-4.8] alone; nothing of the library. The distribution of the memory (a
decided mode and an estimate) and of the object (mode and state) moves from measurement to
measurement; an estimate is split between the two nearest nodes of its axis.
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
