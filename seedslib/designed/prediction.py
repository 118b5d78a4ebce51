"""What a design says of its filter, in numbers and words: errors that it predicts and finds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.clock import when

if TYPE_CHECKING:
    from seedslib.designed.finite_order import FiniteOrderFilter
    from seedslib.designed.switching.filter import SwitchingFilter

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

    def source(self, exact: str = "exact moments") -> str:
        """What the numbers were taken from, in words; `exact` are those for no paths."""
        return exact if self.exact else f"{self.paths} paths, seed {self.entropy}"

    @property
    def left_out(self) -> str:
        """The paths that were left out, to go on a sentence with; empty where none was."""
        return f", {self.diverged} diverged paths left out" if self.diverged else ""


class HeldOut(NamedTuple):
    """Accuracy of a finished filter on paths that its design has not seen.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
        Times of the measurements; errors are those after the correction.
    rms, error : ndarray, shape (K+1, n')
        Root-mean-square errors and their standard errors; NaN where no path was left.
    deviation : ndarray, shape (K+1, n')
        Standard deviation of the state there: the error of the best constant.
    paths : int
    diverged : int
        Paths on which the filter left the range of numbers, which are left out from there on, or
        made an error that hardly one design would meet on as many paths as it was made on.
    mode_rate, mode_error : ndarray, shape (K+1,), or None
        As in `Prediction`.
    """

    times: np.ndarray
    rms: np.ndarray
    error: np.ndarray
    deviation: np.ndarray
    paths: int
    diverged: int
    mode_rate: MaybeArray = None
    mode_error: MaybeArray = None


def headline(designed: FiniteOrderFilter) -> str:
    """One line: order, memory, forecast, linearization."""
    return (
        f"order {designed.order}: {designed.memory}; {designed.predictor}; {designed.linearization}"
    )


def finite_order_page(designed: FiniteOrderFilter) -> str:
    """Page of text: what the filter is, how it was designed, how accurate it says it is."""
    design, times = designed.design, designed.times
    nodes, doubts = sum(len(t) for t in designed.node_times), designed.predicted.in_sample
    first, last = when(times[0]), when(times[-1])
    return "\n".join([
        f"Finite-order filter of {headline(designed)}",
        f"  estimates    {designed.components} of {len(designed.start.mean)} state components",
        f"  measurements {len(times)}, from {first} to {last}; {nodes} nodes between",
        f"  forecasts    {designed.between}",
        *sensor_lines(designed),
        *([later_times(designed)] if designed.cycle else []),
        f"  designed on  {design.source()}{design.left_out}",
        "  predicted root-mean-square errors"
        + (" (in-sample, with standard errors)" if doubts else ""),
        *accuracy(designed, doubts),
    ])  # fmt: skip


def switching_page(filter: SwitchingFilter) -> str:
    """As `finite_order_page`, of a `SwitchingFilter`."""
    held = "carries the laws of all modes" if filter.memory is None else f"of {filter.memory}"
    lines = [
        f"Filter of {filter.system.modes} modes, {held}; {filter.linearization}",
        f"  order        {filter.order}",
    ]
    if (design := filter.design) is not None:
        lines.append(f"  designed on  {design.source()}")
        lines.append(
            f"  mended       {design.thin} of {design.pairs} thin pairs of cell and mode, "
            f"{design.mended} covariances{design.left_out}"
        )
    lines += sensor_lines(filter)
    if filter.cycle:
        lines.append(later_times(filter))
    if filter.predicted is not None:
        lines.append("  predicted errors of state and part of wrong modes (in-sample)")
        lines += accuracy(filter, modes="modes ")
    return "\n".join(lines)


def accuracy(designed: Any, doubts: bool = True, modes: str = "") -> list[str]:
    """Lines of a page: predicted errors, and those on held-out paths beside or below them.

    Parameters
    ----------
    designed : filter
        With `predicted`, `held_out` and the `clock` of its measurements.
    doubts : bool
        Whether the predicted errors have standard errors.
    modes : str
        What stands before the predicted part of wrong modes.
    """
    predicted, held, lines = designed.predicted, designed.held_out, []
    if held is not None:
        lost = f", {held.diverged} of them diverged" if held.diverged else ""
        lines.append(f"  after the bar: on {held.paths} paths that the design has not seen{lost}")
    at = designed.clock.rows(predicted.times)
    for k in shown_rows(len(at)):
        j = at[k]
        row = f"    t = {when(predicted.times[j]):<8} {_errors(predicted, j, doubts, modes)}"
        if held is None:
            lines.append(row)
            continue
        other = _errors(held, k, True, "modes ")
        beside = len(row) + len(other) + 3 <= WIDTH
        lines += [f"{row} | {other}"] if beside else [row, f"{'|':>17} {other}"]
    return lines


def sensor_lines(filter: Any) -> list[str]:
    """Lines of a page: what the design knows of missing measurements."""
    lines = []
    if filter.measured is not None:
        read, whole = np.count_nonzero(filter.measured), filter.measured.size
        lines.append(f"  schedule     {read} of {whole} components are read")
    if filter.availability is not None:
        parts = getattr(filter, "arrivals", None) or filter.fits
        most = max((len(part.prob) for part in parts), default=1)
        rates = ", ".join(f"{rate:g}" for rate in filter.availability)
        lines.append(f"  availability {rates}; up to {most} classes of histories")
    return lines


def later_times(filter: Any) -> str:
    """Line of a page: what comes after the last time of the design."""
    in_turn = f"the last {filter.cycle} steps serve all in turn"
    steps = {0: "none after the last time", 1: "the last step serves all"}
    return "  later times  " + steps.get(filter.cycle, in_turn)


def shown_rows(count: int) -> np.ndarray:
    """Numbers of at most `ROWS` rows, evenly chosen."""
    return np.linspace(0, count - 1, min(ROWS, count)).astype(int)


def _errors(found, j, doubts, modes):
    """Errors and part of wrong modes at one time of a `Prediction` or `HeldOut`."""

    def told(value, doubt):
        return f"{value:.4f} ± {doubt:.4f}" if doubts else f"{value:.4f}"

    row = [told(*pair) for pair in zip(found.rms[j], found.error[j], strict=True)]
    if found.mode_rate is not None:
        row.append(modes + told(found.mode_rate[j], found.mode_error[j]))
    return "  ".join(row)
