"""What a reader can move: figures with sliders that work from a file, with no network."""

from __future__ import annotations

from pathlib import Path

PAGES = {
    "live": (
        "dropouts",
        "plugin_loss",
        "delay",
        "switching_noise",
        "interval",
        "regions",
        "growth",
    ),
    "live_noise": ("van_der_pol",),
    "live_flip": ("flip", "flip_function"),
    "live_modes": ("switching",),
}
"""Pages of the book, and the figures on each."""


def write(root: Path) -> None:
    """Write all fragments, ``book/live/*.html``; needs node, for the first pictures.

    Parameters
    ----------
    root : Path
        Folder of the project.
    """
    from bookkit.files import replace
    from bookkit.live import filters, fragment, tables

    (root / "book" / "live").mkdir(exist_ok=True)
    for figure in [*filters.figures(), *tables.figures()]:
        replace(root / "book" / "live" / f"{figure.name}.html", fragment.fragment(figure))
