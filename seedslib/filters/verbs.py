"""What the reference filters of switching systems share: modes and the run."""

from __future__ import annotations

import numpy as np

from seedslib.base.blocks import in_blocks
from seedslib.filters.estimates import Estimates, as_indicators, as_record, as_whole
from seedslib.filters.weights import most_probable
from seedslib.models.kinds import as_grid


def as_modes(name: str, value: object, shape: tuple[int, ...], count: int) -> np.ndarray:
    """Modes, whole numbers from 0 to count - 1 in the wanted shape.

    Raises
    ------
    TypeError, ValueError
        No whole numbers, another shape, or numbers out of range.
    """
    modes = as_whole(name, value, shape)
    bad = (modes < 0) | (modes >= count)
    if bad.any():
        raise ValueError(f"{name}: wanted numbers from 0 to {count - 1}, got {modes[bad][0]}")
    return modes


def run_in_blocks(
    filter, times, measurements, indicators, *, block, seed=0, workers=1
) -> Estimates:
    """Filter many records, a block at a time; the states of the filter say what is estimated.

    Parameters
    ----------
    filter : object
        With ``initial(batch, seed)``, ``step(state, t, y, indicator)``, a `system`, and states
        with ``mean, cov, mode_prob, loglik, diverged``; mode_prob may be None.
    times, measurements, indicators, seed, workers
        As in the `run` of the filter.
    block : int
        Records in a block.

    Returns
    -------
    Estimates
    """
    times = as_grid("times", times, filter.system)
    system = filter.system
    switching = hasattr(system, "modes")
    size = system.measurement_size if switching else system.sensor.size
    y = as_record(measurements, len(times), size)
    batch = y.shape[2:]
    flat, shown = y.reshape(*y.shape[:2], -1), None
    if switching:
        shown = as_indicators(indicators, system, (len(times), *batch))
    elif indicators is not None:
        raise ValueError("indicators: wanted none, the system has no modes")
    if shown is not None:
        shown = shown.reshape(len(times), -1)

    def work(start, stop, stream):
        state = filter.initial((stop - start,), stream)
        rows = []
        for k, t in enumerate(times):
            seen = None if shown is None else shown[k, start:stop]
            state = filter.step(state, t, flat[k, :, start:stop], seen)
            rows.append([state.mean, state.cov, state.loglik, state.mode_prob][: 3 + switching])
        return [np.stack(part) for part in zip(*rows, strict=True)] + [state.diverged]

    parts = in_blocks(work, flat.shape[2], seed, workers=workers, block=block)
    joined = [np.concatenate(part, axis=-1) for part in zip(*parts, strict=True)]
    joined = [part.reshape((*part.shape[:-1], *batch)) for part in joined]
    mean, cov, loglik, *prob, diverged = joined
    found = Estimates(mean, cov, loglik=loglik, diverged=diverged)
    if switching:
        found = found._replace(mode_prob=prob[0], modes=most_probable(prob[0], axis=1))
    return found
