"""A designed filter as a picture: what it predicts of its errors, and its output function."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from bookkit.plots import axes, band, curve, finish
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.switching import SwitchingFilter
from seedslib.designed.tables import OutputFilter, Table, switches

MEMORIES = 5
"""Values of the memory for which the output function is drawn."""


def plot_design(designed, *, measurement: int | None = None) -> Figure:
    """Picture of a designed filter in the style of the book.

    Left: predicted root-mean-square error of each estimated component against time, in a band of
    two standard errors on either side where it was estimated from paths, with the times of the
    measurements marked on the axis. Right, for tables with a scalar measurement and a memory of
    at most one number: the estimate f(y, u) against the measurement y for some memories u. For a
    switching system instead: the predicted part of wrong modes, in the same band.

    Parameters
    ----------
    designed : FiniteOrderFilter, SwitchingFilter, TableFilter or LearnedFilter
        Of any kind.
    measurement : int, optional
        Number k of the measurement whose function is drawn; by default the last that can be.

    Returns
    -------
    Figure

    Raises
    ------
    TypeError
        Something that is no designed filter.
    ValueError
        No such measurement, or one whose function has no such picture; a switching filter that
        does not say what it predicts.
    """
    if not isinstance(designed, FiniteOrderFilter | SwitchingFilter | OutputFilter):
        raise TypeError(f"designed: wanted a FiniteOrderFilter, got {type(designed).__name__}")
    if switches(designed.system):
        return _plot_switching(designed, measurement)
    drawn = _drawable(designed)
    if measurement is not None and measurement not in drawn:
        can = ", ".join(map(str, drawn)) or "none"
        raise ValueError(
            f"measurement: wanted one whose function can be drawn ({can}), got {measurement!r}"
        )
    if not drawn:
        figure, ax = axes()
        _errors(ax, designed)
        return figure
    figure, (left, right) = axes(1, 2)
    _errors(left, designed)
    _output(right, designed, drawn[-1] if measurement is None else measurement)
    return figure


def _plot_switching(designed, measurement):
    if measurement is not None:
        raise ValueError(f"measurement: wanted none for a switching system, got {measurement!r}")
    predicted = designed.predicted
    if predicted is None:
        raise ValueError("designed: wanted a filter with predicted errors, got one without")
    if designed.system.modes == 1:
        figure, left = axes()
    else:
        figure, (left, right) = axes(1, 2)
        band(right, predicted.times, predicted.mode_rate, predicted.mode_error)
        right.set_ylim(bottom=0.0)
        finish(right, x="time", y="part of wrong modes", title="Predicted mode errors")
    _errors(left, designed)
    return figure


def _errors(ax, designed):
    predicted = designed.predicted
    count = predicted.rms.shape[1]
    for i in range(count):
        label = "predicted error" if count == 1 else f"component {i + 1}"
        band(ax, predicted.times, predicted.rms[:, i], predicted.error[:, i], label=label)
    ax.set_ylim(bottom=0.0)
    ax.plot(
        designed.times,
        np.zeros(len(designed.times)),
        "|",
        color="black",
        markersize=14,
        linestyle="none",
        clip_on=False,
        label="measurements",
    )
    finish(ax, x="time", y="root-mean-square error", title="Predicted accuracy")


def _drawable(designed) -> list[int]:
    """Numbers of the measurements whose function is a table of one or two scalars."""
    if not isinstance(designed, OutputFilter) or designed.system.measurement_size != 1:
        return []
    return [
        k
        for k, (table, _) in enumerate(designed.steps)
        if isinstance(table, Table) and len(table.axes) <= 2 and len(table.estimate) == 1
    ]


def _output(ax, designed, k):
    table = designed.steps[k].update
    y = table.axes[0].nodes
    memories = [None]
    if len(table.axes) == 2:
        memories = np.linspace(table.axes[1].low, table.axes[1].high, MEMORIES)
    for u in memories:
        points = [y] if u is None else [y, np.array([u])]
        curve(ax, y, table(points).mean[0], label=None if u is None else f"memory u = {u:g}")
    finish(
        ax,
        x="measurement y",
        y="estimate f(y, u)" if len(table.axes) == 2 else "estimate f(y)",
        title=f"Output function at t = {designed.times[k]:g}",
    )
