"""The four covariance recursions behind one `start` and `advance`, their table and their state."""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from seedslib.delay import array, chandrasekhar, dense, structured
from seedslib.delay.gains import DelayGains, StepGains, advanced, empty_gains
from seedslib.delay.system import DelaySystem

RECURSIONS: dict[str, ModuleType] = {
    "structured": structured,
    "array": array,
    "chandrasekhar": chandrasekhar,
    "augmented": dense,
}


class DelayState(NamedTuple):
    """The filter at instant k = `time`.

    mean (N+1, n, *batch): block s is the estimate of x_{k-s}; cov (n, n): covariance of its block
    0; loglik (*batch): log density of the last measurement; recursion: the covariance recursion's
    own state after the last instant whose measurement is known; ahead: the same and the gains for
    a complete measurement at `time`, while it may still come.
    """

    time: float
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray
    recursion: Any
    ahead: tuple[Any, StepGains] | None = None


def gains_up_to(
    system: DelaySystem, method: str, steps: int, missing: np.ndarray | None
) -> DelayGains:
    """Table of gains up to K = `steps`, by another recursion where the fast one breaks down."""
    label = method
    while True:
        engine, n = RECURSIONS[method], system.state_size
        blocks, m = system.max_delay + 1, system.measurement_size
        table = empty_gains(steps, blocks, system.cov0[:n, :n], m, label)
        state = engine.start(system)
        try:
            for k in range(1, steps + 1):
                lost = None if missing is None else missing[k]
                state, now = advanced(engine, system, state, lost, k)
                parts = table.gain, table.innovation_cov, table.predicted, table.cov
                for whole, part in zip(parts, now, strict=True):
                    whole[k] = part
            return table
        except chandrasekhar.BreakdownError as why:
            method, label = "structured", f"structured, because {why}"
