"""Steps of a jump-diffusion: Euler-Maruyama or Heun for the diffusion, thinning for the jumps."""

from __future__ import annotations

import math
import warnings

import numpy as np
from numpy.random import Generator

from seedslib.base.blocks import BLOCK
from seedslib.base.bundles import drawn, parts

SCHEMES = ("euler", "heun")
CHUNK = 16
"""Normal numbers drawn at a time for each path: a block of them stays in the cache."""

LARGEST_LOSS = 0.05
"""Share of jumps lost by the rule of one jump per step above which the step is too coarse."""


def advance(system, x, start, stop, rng, step, scheme):
    """Move states from one time to a later one.

    A jump comes in a step with probability 1 - exp(-mu(t, X) h) and is drawn at the state before
    the step. This is done by one unit exponential clock per path that runs out with the
    intensity: the same law, without a uniform number at every step. The clock needs no memory
    across calls.

    Parameters
    ----------
    system : JumpDiffusion
    x : ndarray, shape (n, *batch)
    start, stop : float
    rng : numpy.random.Generator
        Only its children are used, in a layout where the first paths of many have the numbers
        of few.
    step : float
        Largest step; the interval is divided evenly.
    scheme : {"euler", "heun"}

    Returns
    -------
    ndarray, shape (n, *batch)
        Where a path leaves the range of floating-point numbers, what arithmetic makes of it.

    Raises
    ------
    ValueError
        An intensity that is negative or not a number, an unknown scheme, an empty interval.
    """
    if not stop > start:
        raise ValueError(f"stop: wanted a time after {start:g}, got {stop:g}")
    if not step > 0:
        raise ValueError(f"step: wanted a positive number, got {step:g}")
    increment = system.increment(scheme)
    steps = max(1, math.ceil((stop - start) / step - 1e-9))
    h = (stop - start) / steps
    root = math.sqrt(h)
    shape = np.shape(x)
    x = np.array(x, dtype=float).reshape(shape[0], -1)
    state, count = list(x), x.shape[1]
    clock = _JumpClock(system, rng, count) if system.jump is not None else None
    with np.errstate(over="ignore", invalid="ignore"):
        for k, normal in enumerate(_normals(rng, steps, system.wiener_size, count)):
            t = start + k * h
            move = increment(t, h, root, state, normal)
            if scheme == "heun":
                guess = [c + d for c, d in zip(state, move, strict=True)]
                again = increment(t + h, h, root, guess, normal)
                move = [0.5 * (a + b) for a, b in zip(move, again, strict=True)]
            moved = [c + d for c, d in zip(state, move, strict=True)]
            if clock is not None:
                clock.jump(t, h, state, moved)
            state = moved
    if clock is not None and clock.lost > LARGEST_LOSS:
        warnings.warn(
            f"step: about {clock.lost:.2g} of the jumps would come second in a step and are left "
            f"out; take a step below {h:g}",
            stacklevel=2,
        )
    return np.stack(state).reshape(shape)


def compiled_increment(system, scheme):
    """Code of one step of a symbolic system; see `JumpDiffusion.increment`."""
    import sympy

    from seedslib.models.codegen import compile_components

    drift, matrix = system.drift_expressions, system.diffusion_expressions
    rows, columns = range(matrix.shape[0]), range(matrix.shape[1])
    if scheme == "heun":
        correction = [
            sum(
                sympy.diff(matrix[i, j], x) * matrix[k, j]
                for j in columns
                for k, x in enumerate(system.state)
            )
            for i in rows
        ]
        drift = [a - c / 2 for a, c in zip(drift, correction, strict=True)]
    h, root = sympy.Dummy("h"), sympy.Dummy("root")
    z = [sympy.Dummy(f"z{j}") for j in columns]
    moves = [drift[i] * h + root * sum(matrix[i, j] * z[j] for j in columns) for i in rows]
    return compile_components((system.time, h, root, system.state, z), moves)


def _normals(rng, steps, size, count):
    """Normal numbers step by step, each of shape (size, count)."""
    if size == 0:
        yield from (np.empty((0, count)) for _ in range(steps))
        return
    chunks = -(-steps // max(1, CHUNK // size))
    length = -(-steps // chunks)
    by_step = np.empty((length * size, count))
    by_path = np.empty(length * size * min(count, BLOCK))
    for first, child in zip(range(0, steps, length), rng.spawn(chunks), strict=False):
        chunk = by_step[: min(length, steps - first) * size]
        for generator, here in parts(child, count):
            # path by path, so that a path has the same numbers however many follow it
            columns = chunk[:, here]
            rows = by_path[: columns.size].reshape(columns.shape[::-1])
            generator.standard_normal(out=rows)
            columns[...] = rows.T
        yield from chunk.reshape(-1, size, count)


def _bad_intensity(value, t) -> ValueError:
    return ValueError(f"intensity: wanted finite nonnegative numbers, got {value:g} at time {t:g}")


class _JumpClock:
    """Unit exponential clocks of the paths of one block over one interval."""

    def __init__(self, system, rng, count):
        self.system, self.count = system, count
        self.rng = rng.spawn(1)[0]
        self.jumped = np.zeros(count, dtype=int)
        self.hazards = []
        self.marks = np.empty((4, system.jump.noise.size, count))
        self.clocks = np.empty((4, count))
        self.ready = 0
        self._extend()
        self.left = self.clocks[0].copy()

    def _extend(self):
        """Draw the clocks and marks of every path's next jump, when the first path needs them."""
        if self.ready == len(self.clocks):
            self.clocks, self.marks = (np.concatenate([a, a]) for a in (self.clocks, self.marks))
        waiting, marking = self.rng.spawn(2)
        self.clocks[self.ready] = drawn(waiting, self.count, Generator.standard_exponential)
        self.marks[self.ready] = self.system.jump.noise.draw(marking, self.count)
        self.ready += 1

    @property
    def lost(self) -> float:
        """Share of the jumps that would have come second in a step.

        Jumps come in proportion to the hazard of a step, so the mean hazard at the jumps is
        E hazard² / E hazard; half of it is the share.
        """
        met = np.concatenate(self.hazards) if self.hazards else np.zeros(1)
        return 0.5 * float(met.mean())

    def jump(self, t, h, before, after):
        """Run the clocks for one step and add the jumps to the states after it, in place."""
        hazard = self.system.intensity_component(t, before) * h
        least = hazard.min() if isinstance(hazard, np.ndarray) else hazard
        if not least >= 0:
            raise _bad_intensity(least / h, t)
        left = self.left
        left -= hazard
        due = (left <= 0).nonzero()[0]
        if due.size == 0:
            return
        met = hazard[due] if isinstance(hazard, np.ndarray) else np.full(1, hazard)
        if met.max() == np.inf:
            raise _bad_intensity(np.inf, t)
        self.hazards.append(met)
        number = self.jumped[due]
        while number.max() + 1 >= self.ready:
            self._extend()
        marks = self.marks[number, :, due]
        kicks = self.system.jump_components(t, [c[due] for c in before], list(marks.T))
        for component, kick in zip(after, kicks, strict=True):
            if isinstance(kick, np.ndarray) or kick != 0:
                component[due] += kick
        number += 1
        left[due] = self.clocks[number, due]
        self.jumped[due] = number
