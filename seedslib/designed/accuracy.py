"""The accuracy of a designed filter in numbers and as a page of text."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.clock import when

ROWS = 12
"""Times that a page shows at most."""


class Accuracy(NamedTuple):
    """Errors of a filter on paths: those that its design predicts, or of other paths.

    Attributes
    ----------
    times : ndarray, shape (S,)
        Measurement times (after the correction); of a prediction nodes too.
    rms : ndarray, shape (S, n')
        Root-mean-square errors; NaN where no path was left.
    error : ndarray, shape (S, n')
        Standard errors of `rms`; zero where moments were exact.
    in_sample : bool
        Whether the errors are those of the paths that the filter was fitted to, which flatters
        it a little: by about (coefficients / paths) of the mean-square error.
    mode_rate, mode_error : ndarray, shape (S,), or None
        Of a switching system: part of wrong modes and its standard error.
    paths, diverged : int
        Held-out paths, and on how many of them the filter left the range of numbers.
    """

    times: np.ndarray
    rms: np.ndarray
    error: np.ndarray
    in_sample: bool = False
    mode_rate: MaybeArray = None
    mode_error: MaybeArray = None
    paths: int = 0
    diverged: int = 0


class Design(NamedTuple):
    """How a filter was designed: paths, paths per block, seed.

    ``diverged`` paths were left out; an ``exact`` design took no paths. Of a switching system,
    ``pooled`` of ``pairs`` pairs of cell and mode had too few paths of their own.
    """

    paths: int
    block: int
    entropy: object
    spawn_key: tuple[Any, ...]
    diverged: int = 0
    exact: bool = False
    pooled: int = 0
    pairs: int = 0

    def __str__(self) -> str:
        if self.exact:
            return "exact moments or densities on a grid, without random numbers"
        text = f"{self.paths} paths, seed {self.entropy}"
        if self.diverged:
            text += f", {self.diverged} diverged paths left out"
        if self.pairs:
            text += f"; {self.pooled} of {self.pairs} pairs of cell and mode pooled"
        return text


def page(filter: Any, title: str, *lines: str) -> str:
    """Page of text: what a filter is, how it was designed, how accurate it says it is.

    Parameters
    ----------
    filter : DesignedFilter
    title : str
    *lines : str
        What is particular to this kind of filter.
    """
    design, predicted, text = filter.design, filter.predicted, [title, *lines]
    if filter.measured is not None:
        read, total = np.count_nonzero(filter.measured), filter.measured.size
        text.append(f"schedule     {read} of {total} components are read")
    if filter.availability is not None:
        rates = ", ".join(f"{rate:g}" for rate in filter.availability)
        most = max((len(fit.prob) for fit in filter.fits), default=1)
        text.append(f"availability {rates}; up to {most} classes of histories")
    if filter.cycle == 1:
        text.append("later times  the last step serves all")
    elif filter.cycle:
        text.append(f"later times  the last {filter.cycle} steps serve all in turn")
    if design is not None:
        text.append(f"designed on  {design}")
    if predicted is not None:
        simulated = design is None or not design.exact
        notes = ["in-sample"] * predicted.in_sample + ["with standard errors"] * simulated
        modes = " and part of wrong modes" * (predicted.mode_rate is not None)
        notes = f" ({', '.join(notes)})" if notes else ""
        text += [f"predicted root-mean-square errors{modes}{notes}", *_accuracy(filter, simulated)]
    return "\n  ".join(text)


def measurement_line(filter: Any) -> str:
    """Line of a page: the measurements, and the nodes between them."""
    times, nodes = filter.times, sum(len(t) for t in filter.node_times)
    return f"measurements {len(times)}, from {when(times[0])} to {when(times[-1])}; {nodes} nodes"


def _accuracy(filter, with_errors):
    """Lines of a page: predicted errors, and those on held-out paths beside them."""
    predicted, held_out, lines = filter.predicted, filter.held_out, []
    if held_out is not None:
        diverged = f", {held_out.diverged} of them diverged" if held_out.diverged else ""
        lines.append(
            f"after the bar: on {held_out.paths} paths that the design has not seen{diverged}"
        )
    rows = filter.clock.rows(predicted.times)
    for k in np.linspace(0, len(rows) - 1, min(ROWS, len(rows))).astype(int):
        j = rows[k]
        line = f"  t = {when(predicted.times[j]):<8} {_errors(predicted, j, with_errors)}"
        lines.append(line if held_out is None else f"{line} | {_errors(held_out, k, True)}")
    return lines


def _errors(accuracy, j, with_errors):
    """Errors and part of wrong modes at one time of an `Accuracy`."""

    def number(value, error):
        return f"{value:.4f} ± {error:.4f}" if with_errors else f"{value:.4f}"

    parts = [number(*pair) for pair in zip(accuracy.rms[j], accuracy.error[j], strict=True)]
    if accuracy.mode_rate is not None:
        parts.append("modes " + number(accuracy.mode_rate[j], accuracy.mode_error[j]))
    return "  ".join(parts)
