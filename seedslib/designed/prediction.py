"""What the design of a switching filter says of it, in numbers and words."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

ROWS = 12


class SwitchingPrediction(NamedTuple):
    """What the design says about the filter's accuracy, on the paths it was fitted to.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
    rms, error : ndarray, shape (K+1, n)
        Root-mean-square errors and their standard errors.
    mode_rate, mode_error : ndarray, shape (K+1,)
        Part of wrong modes, and its standard error.
    """

    times: np.ndarray
    rms: np.ndarray
    error: np.ndarray
    mode_rate: np.ndarray
    mode_error: np.ndarray


class SwitchingDesign(NamedTuple):
    """How a filter was designed: paths, paths per block, seed, and what had to be mended.

    ``thin`` of ``pairs`` pairs of cell and mode had too few paths of their own; the eigenvalues
    of ``floored`` covariances were raised; ``diverged`` paths were left out.
    """

    paths: int
    block: int
    entropy: object
    spawn_key: tuple
    thin: int
    pairs: int
    floored: int
    diverged: int = 0


def summary(filter) -> str:
    """Page of text: what the filter is, how it was designed, how accurate it says it is."""
    held = "carries the laws of all modes" if filter.memory is None else f"of {filter.memory}"
    lines = [
        f"Filter of {filter.system.modes} modes, {held}; {filter.linearization}",
        f"  order        {filter.order}",
    ]
    if filter.design is not None:
        design = filter.design
        lines.append(f"  designed on  {design.paths} paths, seed {design.entropy}")
        lines.append(
            f"  mended       {design.thin} of {design.pairs} thin pairs of cell and mode, "
            f"{design.floored} covariances"
            + (f", {design.diverged} diverged paths left out" if design.diverged else "")
        )
    if filter.lasting:
        lines.append("  used past its last design time, where its fits have converged")
    if filter.predicted is not None:
        lines.append("  predicted errors of state and part of wrong modes (in-sample)")
        count = len(filter.predicted.times)
        for k in np.unique(np.linspace(0, count - 1, min(ROWS, count)).astype(int)):
            t, rms, error, rate, doubt = (part[k] for part in filter.predicted)
            row = "  ".join(f"{a:.4f} ± {e:.4f}" for a, e in zip(rms, error, strict=True))
            lines.append(f"    t = {t:<8g} {row}  modes {rate:.4f} ± {doubt:.4f}")
    return "\n".join(lines)
