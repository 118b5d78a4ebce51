"""Steps of a jump-diffusion: Euler-Maruyama or Heun for the diffusion, thinning for the jumps."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.random import Generator

from seedslib.base.blocks import BLOCK
from seedslib.base.bundles import Source, drawn, parts
from seedslib.base.checks import as_positive
from seedslib.base.clock import step_count, when
from seedslib.base.values import on_paths

if TYPE_CHECKING:
    from seedslib.models.jump_diffusion import JumpDiffusion

SCHEMES = ("euler", "heun")
CHUNK = 16
"""Normal numbers drawn at a time for each path: a block of them stays in the cache."""

LARGEST_LOSS = 0.05
"""Share of jumps lost by the rule of one jump per step above which the step is too coarse."""


def advance(
    system: JumpDiffusion, x: np.ndarray, start: float, stop: float, rng: Source, step: float,
    scheme: str,
) -> np.ndarray:  # fmt: skip
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
        raise ValueError(f"stop: wanted a time after {when(start)}, got {when(stop)}")
    step = as_positive("step", step, infinite=True)
    increment = system.increment(scheme)
    steps = step_count(start, stop, step)
    h = (stop - start) / steps
    root = math.sqrt(h)
    shape = np.shape(x)
    x = np.array(x, dtype=float).reshape(shape[0], -1)
    state, count = list(x), x.shape[1]
    clock = _JumpClock(system, rng, count) if system.jump is not None else None
    with np.errstate(over="ignore", invalid="ignore"), on_paths(shape[1:]):
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


def compiled_increment(system: JumpDiffusion, scheme: str) -> Callable[..., Any]:
    """Code of one step of a symbolic system; see `JumpDiffusion.increment`."""
    import sympy

    from seedslib.models.codegen import compile_components

    drift, matrix = system.drift_expressions, system.diffusion_expressions
    rows, columns = range(matrix.shape[0]), range(matrix.shape[1])
    if scheme == "heun":
        # a - (1/2) sum_j (dB_j/dx) B_j
        pairs = [(j, k, x) for j in columns for k, x in enumerate(system.state)]
        drift = [
            drift[i] - sum(sympy.diff(matrix[i, j], x) * matrix[k, j] for j, k, x in pairs) / 2
            for i in rows
        ]
    h, root = sympy.Dummy("h"), sympy.Dummy("root")
    z = [sympy.Dummy(f"z{j}") for j in columns]
    moves = [drift[i] * h + root * sum(matrix[i, j] * z[j] for j in columns) for i in rows]
    return compile_components((system.time, h, root, system.state, z), moves)


def numeric_increment(
    system: JumpDiffusion, t: float, h: float, root: float, x: list[np.ndarray], z: np.ndarray
) -> list[np.ndarray]:
    """Euler increment of a system of array functions; see `JumpDiffusion.increment`."""
    state = np.stack(x)
    noise = np.einsum("ij...,j...->i...", system.diffusion(t, state), root * z)
    return list(system.drift(t, state) * h + noise)


def compiled_jumps(system: JumpDiffusion) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Intensity ``(t, x) -> component`` and jump ``(t, x, z) -> list`` on lists of components.

    The intensity comes as a plain number where it is constant.
    """
    if not system.symbolic:
        return (
            lambda t, x: system.intensity(t, np.stack(x)),
            lambda t, x, z: list(system.jump.value(t, np.stack(x), np.stack(z))),
        )
    from seedslib.models.codegen import compile_components

    given = (system.time, system.state)
    rate = compile_components(given, [system.intensity_expression])
    kick = compile_components((*given, system.jump.noise.symbols), system.jump.expressions.tolist())
    return lambda t, x: rate(t, x)[0], kick


def _normals(rng: Source, steps: int, size: int, count: int) -> Iterator[np.ndarray]:
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


def _bad_intensity(value: float, t: float) -> ValueError:
    return ValueError(
        f"intensity: wanted finite nonnegative numbers, got {value:g} at time {when(t)}"
    )


class _JumpClock:
    """Unit exponential clocks of the paths of one block over one interval."""

    def __init__(self, system: JumpDiffusion, rng: Source, count: int):
        self.count, self.noise = count, system.jump.noise
        self.rate, self.kick = system.jumps
        self.rng = rng.spawn(1)[0]
        self.jumped = np.zeros(count, dtype=int)
        self.hazards = []
        self.marks = np.empty((4, self.noise.size, count))
        self.clocks = np.empty((4, count))
        self.ready = 0
        self._extend()
        self.left = self.clocks[0].copy()

    def _extend(self) -> None:
        """Draw the clocks and marks of every path's next jump, when the first path needs them."""
        if self.ready == len(self.clocks):
            self.clocks, self.marks = (np.concatenate([a, a]) for a in (self.clocks, self.marks))
        waiting, marking = self.rng.spawn(2)
        self.clocks[self.ready] = drawn(waiting, self.count, Generator.standard_exponential)
        self.marks[self.ready] = self.noise.draw(marking, self.count)
        self.ready += 1

    @property
    def lost(self) -> float:
        """Share of the jumps that would have come second in a step.

        Jumps come in proportion to the hazard of a step, so the mean hazard at the jumps is
        E hazard² / E hazard; half of it is the share.
        """
        met = np.concatenate(self.hazards) if self.hazards else np.zeros(1)
        return 0.5 * float(met.mean())

    def jump(self, t: float, h: float, before: list, after: list) -> None:
        """Run the clocks for one step and add the jumps to the states after it, in place."""
        hazard = self.rate(t, before) * h
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
        with on_paths((self.count,), due):
            kicks = self.kick(t, [c[due] for c in before], list(marks.T))
        for component, kick in zip(after, kicks, strict=True):
            if isinstance(kick, np.ndarray) or kick != 0:
                component[due] += kick
        number += 1
        left[due] = self.clocks[number, due]
        self.jumped[due] = number
