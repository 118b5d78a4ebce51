"""What a design says of its filter, in numbers and words: errors that it predicts and finds."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.clock import when

ROWS = 12
"""Times that a page shows at most."""

WIDTH = 100
"""Longest line of a page."""


class Prediction(NamedTuple):
    """What the design says about the filter's accuracy.

    Attributes
    ----------
    times : ndarray, shape (S,)
        Measurement times (after the correction) and nodes.
    rms : ndarray, shape (S, n')
        Root-mean-square errors.
    error : ndarray, shape (S, n')
        Standard errors of `rms`; zero where moments were exact.
    in_sample : bool
        Whether the errors are those of the paths that the filter was fitted to, which flatters
        it a little: by about (coefficients / paths) of the mean-square error.
    mode_rate, mode_error : ndarray, shape (S,), or None
        Of a switching system: part of wrong modes and its standard error.
    """

    times: np.ndarray
    rms: np.ndarray
    error: np.ndarray
    in_sample: bool = False
    mode_rate: MaybeArray = None
    mode_error: MaybeArray = None

    def of(self, rows: np.ndarray, times: np.ndarray) -> Prediction:
        """Some rows, at other times."""
        parts = {name: getattr(self, name) for name in ("rms", "error", "mode_rate", "mode_error")}
        kept = {name: part if part is None else part[rows] for name, part in parts.items()}
        return self._replace(times=times, **kept)


class Design(NamedTuple):
    """How a filter was designed: paths, paths per block, seed, and what had to be mended.

    ``diverged`` paths were left out; an ``exact`` design took no paths. Of a switching system,
    ``thin`` of ``pairs`` pairs of cell and mode had too few paths of their own, and the
    eigenvalues of ``mended`` covariances were raised.
    """

    paths: int
    block: int
    entropy: object
    spawn_key: tuple[Any, ...]
    diverged: int = 0
    exact: bool = False
    thin: int = 0
    pairs: int = 0
    mended: int = 0

    def __str__(self) -> str:
        if self.exact:
            return "exact moments or densities on a grid, without random numbers"
        left_out = f", {self.diverged} diverged paths left out" if self.diverged else ""
        mended = ""
        if self.pairs:
            mended = (
                f"; mended: {self.thin} of {self.pairs} thin pairs of cell and mode, "
                f"{self.mended} covariances"
            )
        return f"{self.paths} paths, seed {self.entropy}{left_out}{mended}"


class HeldOut(NamedTuple):
    """Accuracy of a finished filter on paths that its design has not seen.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
        Times of the measurements; errors are those after the correction.
    rms, error : ndarray, shape (K+1, n')
        Root-mean-square errors and their standard errors; NaN where no path was left.
    paths : int
    diverged : int
        Paths on which the filter left the range of numbers; they are left out.
    mode_rate, mode_error : ndarray, shape (K+1,), or None
        As in `Prediction`.
    """

    times: np.ndarray
    rms: np.ndarray
    error: np.ndarray
    paths: int
    diverged: int
    mode_rate: MaybeArray = None
    mode_error: MaybeArray = None


def page(filter: Any, title: str, *lines: str) -> str:
    """Page of text: what a filter is, how it was designed, how accurate it says it is.

    Parameters
    ----------
    filter : filter
        With `design` and `predicted`, which may be None, `held_out`, `cycle` and the `clock` of
        its measurements.
    title : str
    *lines : str
        What this kind of filter has to say.
    """
    design, predicted, text = filter.design, filter.predicted, [title, *lines]
    if filter.measured is not None:
        read, whole = np.count_nonzero(filter.measured), filter.measured.size
        text.append(f"schedule     {read} of {whole} components are read")
    if filter.availability is not None:
        rates = ", ".join(f"{rate:g}" for rate in filter.availability)
        most = max((len(part.prob) for part in filter.fits), default=1)
        text.append(f"availability {rates}; up to {most} classes of histories")
    if filter.cycle == 1:
        text.append("later times  the last step serves all")
    elif filter.cycle:
        text.append(f"later times  the last {filter.cycle} steps serve all in turn")
    if design is not None:
        text.append(f"designed on  {design}")
    if predicted is not None:
        doubts = design is None or not design.exact
        notes = ["in-sample"] * predicted.in_sample + ["with standard errors"] * doubts
        modes = " and part of wrong modes" * (predicted.mode_rate is not None)
        notes = f" ({', '.join(notes)})" if notes else ""
        text += [f"predicted root-mean-square errors{modes}{notes}", *_accuracy(filter, doubts)]
    return "\n  ".join(text)


def span(filter: Any) -> str:
    """Line of a page: the measurements, and the nodes between them."""
    times, nodes = filter.times, sum(len(t) for t in filter.node_times)
    return f"measurements {len(times)}, from {when(times[0])} to {when(times[-1])}; {nodes} nodes"


def _accuracy(designed, doubts):
    """Lines of a page: predicted errors, and those on held-out paths beside or below them."""
    predicted, held, lines = designed.predicted, designed.held_out, []
    if held is not None:
        lost = f", {held.diverged} of them diverged" if held.diverged else ""
        lines.append(f"after the bar: on {held.paths} paths that the design has not seen{lost}")
    at = designed.clock.rows(predicted.times)
    for k in np.linspace(0, len(at) - 1, min(ROWS, len(at))).astype(int):
        j = at[k]
        row = f"  t = {when(predicted.times[j]):<8} {_errors(predicted, j, doubts)}"
        if held is None:
            lines.append(row)
            continue
        other = _errors(held, k, True)
        beside = len(row) + len(other) + 5 <= WIDTH
        lines += [f"{row} | {other}"] if beside else [row, f"{'|':>15} {other}"]
    return lines


def _errors(found, j, doubts):
    """Errors and part of wrong modes at one time of a `Prediction` or `HeldOut`."""

    def number(value, error):
        return f"{value:.4f} ± {error:.4f}" if doubts else f"{value:.4f}"

    row = [number(*pair) for pair in zip(found.rms[j], found.error[j], strict=True)]
    if found.mode_rate is not None:
        row.append("modes " + number(found.mode_rate[j], found.mode_error[j]))
    return "  ".join(row)
