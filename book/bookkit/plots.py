"""One look for every figure: lines differ by colour, dash and marker; axes carry units.

A filter has the same colour in the whole book, by the family it belongs to; filters of one family
differ by dash and marker.
"""

from __future__ import annotations

import io
from typing import Any

import matplotlib.pyplot as plt
from cycler import cycler
from IPython.core.getipython import get_ipython
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from seedslib.extra.plots import COLOURS

DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 2)))
MARKERS = ("o", "s", "^", "D", "v", "x", "P")
WIDTH = 6.8
"""Inches that a page shows of a figure at its own size; a wider one would be shrunk."""

BLUE, OCHRE, GREEN, PLUM, SKY, BROWN, BLACK = COLOURS
FAMILIES = {
    "Bayes filter": (BLACK, "-", ""),
    "particle filter": (SKY, "-", "P"),
    "Rao-Blackwellised particle filter": (SKY, "--", "x"),
    "extended Kalman filter": (OCHRE, "--", "s"),
    "IMM filter": (OCHRE, "-.", "D"),
    "Kalman filter": (OCHRE, "-", "s"),
    "assumed-density filter": (BROWN, "-.", "D"),
    "unscented Kalman filter": (BROWN, ":", "v"),
    "cubature Kalman filter": (BROWN, "--", "^"),
    "measurement filter": (GREEN, "-", "s"),
    "repaired filter": (OCHRE, "-", "s"),
    "paper's filter": (BLUE, "-", "o"),
    "minimax filter": (PLUM, "-.", "D"),
    "Gauss-Hermite filter": (GREEN, ":", "^"),
    "piecewise-linear filter": (BLUE, "-", "o"),
    "Gaussian sum": (OCHRE, "-.", "D"),
    "log-odds": (PLUM, "--", "D"),
    "indicator": (PLUM, ":", "v"),
    "order-1 filter": (BLUE, "-", "o"),
    "order-2 filter": (BLUE, "--", "^"),
    "order-3 filter": (BLUE, "-.", "v"),
    "order-4 filter": (BLUE, ":", "x"),
    "order-": (BLUE, "-", "o"),
}
"""Colour, dash and marker by what a filter's name says; the first that fits, longest first."""

FIRST = ("log-odds", "indicator")
"""What is remembered beside estimates: it is looked for before the number of estimates."""

DOTS = 110
"""A figure's dots to the inch on the page; its picture has twice as many."""

_STYLE = {
    "axes.prop_cycle": cycler(color=COLOURS) + cycler(linestyle=DASHES) + cycler(marker=MARKERS),
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.alpha": 0.3,
    "figure.dpi": DOTS,
    "savefig.dpi": DOTS,
    "figure.constrained_layout.use": True,
    "font.size": 9.5,  # of several panels, which a narrow page lets scroll
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
}

# One panel is narrow, so that a page of 360 dots shrinks it little: its letters stay near 9 points.
_ONE_PANEL = {"font.size": 11.5}

# A chapter's own figures: at 360 dots a page is three fourths of this width, and its text 9 points.
_CHAPTER = {
    "axes.prop_cycle": cycler(color=("#1f6fb0", "#b35900", "#00785a", "#8a3f9e", "#5f5f5f")),
    "axes.grid": False,
    "figure.figsize": (5.0, 3.0),
    "font.size": 12,
}


def chapter() -> None:
    """The look of a chapter's figures, whose code is plain matplotlib: set once, in its check.

    ``C0`` is the filter of the page, ``C1`` its rival (a Kalman filter), ``C2`` the truth.
    """
    plt.rcParams.update(_STYLE | _CHAPTER)
    plt.close(plt.figure())
    _small_pictures()


def axes(
    rows: int = 1, columns: int = 1, *, size: tuple[float, float] | None = None, **options: Any
) -> tuple[Figure, Any]:
    """Figure and axes in the book's style; `size` in inches, `options` as `plt.subplots`.

    Raises
    ------
    ValueError
        A figure wider than a page.
    """
    size = size or (5.2 if columns == 1 else WIDTH, 3.2 * rows)
    if size[0] > WIDTH:
        raise ValueError(f"size: got {size[0]} inches, and a page shows {WIDTH}")
    plt.rcParams.update(_STYLE | (_ONE_PANEL if columns == 1 else {}))
    made = plt.subplots(rows, columns, figsize=size, **options)
    _small_pictures()
    return made


def look(name: str, **changes: Any) -> dict[str, Any]:
    """How the filter of this name is drawn: colour, dash and marker, as options of `plot`.

    `changes` take the place of some, or are added.

    Raises
    ------
    ValueError
        A name without a family in `FAMILIES`.
    """
    for family in sorted(FAMILIES, key=lambda family: (family not in FIRST, -len(family))):
        if family.casefold() in name.casefold():
            known = dict(zip(("color", "linestyle", "marker"), FAMILIES[family], strict=True))
            return known | changes
    raise ValueError(f"name: got {name!r}, wanted one with any of {', '.join(FAMILIES)}")


def _small_pictures() -> None:
    """Figures shown from now on have few colours: after the first, which sets its formatter."""
    if (shell := get_ipython()) is not None:
        shell.display_formatter.formatters["image/png"].for_type(Figure, _picture)


def _picture(figure: Figure) -> bytes:
    """A figure as a transparent picture of 256 colours, a third of the bytes it has with all."""
    full, small = io.BytesIO(), io.BytesIO()
    figure.savefig(full, format="png", dpi=2 * DOTS, bbox_inches="tight", pad_inches=0.05)
    picture = Image.open(full).convert("RGBA")
    few = picture.quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few.save(small, "png", optimize=True)
    return small.getvalue()


def finish(ax: Axes, *, x: str, y: str, title: str = "", legend: bool = True) -> None:
    """Label the axes (quantity and unit), and show the legend where there is something to tell."""
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    if title:
        ax.set_title(title)
    if legend and ax.get_legend_handles_labels()[1]:
        ax.legend()
