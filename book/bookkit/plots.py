"""One look for every figure: lines differ by colour, dash and marker; axes carry units."""

from __future__ import annotations

from typing import Any, overload

import matplotlib.pyplot as plt
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

COLOURS = ("#0b5394", "#c44e00", "#1a7f4b", "#8e3b9e", "#7a6400", "#444444")
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)))
MARKERS = ("o", "s", "^", "D", "v", "x")

_STYLE = {
    "axes.prop_cycle": cycler(color=COLOURS) + cycler(linestyle=DASHES) + cycler(marker=MARKERS),
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.alpha": 0.3,
    "figure.dpi": 110,
    "savefig.dpi": 110,
    "figure.constrained_layout.use": True,
    "font.size": 10,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
}


@overload
def axes(*, size: tuple[float, float] | None = None, **options: Any) -> tuple[Figure, Axes]: ...
@overload
def axes(
    rows: int, columns: int = 1, *, size: tuple[float, float] | None = None, **options: Any
) -> tuple[Figure, Any]: ...
def axes(
    rows: int = 1, columns: int = 1, *, size: tuple[float, float] | None = None, **options: Any
) -> tuple[Figure, Any]:
    """Figure and axes in the book's style; `size` in inches, `options` as `plt.subplots`."""
    plt.rcParams.update(_STYLE)
    size = size or (6.4 if columns == 1 else 4.6 * columns, 3.8 * rows)
    return plt.subplots(rows, columns, figsize=size, **options)


def curve(ax: Axes, x: Any, y: Any, *, label: str | None = None, **options: Any) -> None:
    """Line with about ten markers, however many points it has."""
    every = max(1, len(x) // 10)
    ax.plot(x, y, label=label, markevery=every, **options)


def band(ax: Axes, x: Any, y: Any, error: Any, *, label: str | None = None) -> None:
    """Monte Carlo curve with a band of two standard errors on either side."""
    every = max(1, len(x) // 10)
    (line,) = ax.plot(x, y, label=label, markevery=every)
    ax.fill_between(x, y - 2 * error, y + 2 * error, color=line.get_color(), alpha=0.2, linewidth=0)


def finish(ax: Axes, *, x: str, y: str, title: str = "", legend: bool = True) -> None:
    """Label the axes (quantity and unit), and show the legend where there is something to tell."""
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    if title:
        ax.set_title(title)
    if legend and ax.get_legend_handles_labels()[1]:
        ax.legend()
