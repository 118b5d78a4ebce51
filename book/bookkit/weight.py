"""What the built book weighs: files that no page loads are left out, and the rest is measured.

A Sphinx extension. The theme and MathJax bring builds for other uses, maps of sources, and a script
of 1.5 MB for icons that the theme's own style sheet draws with a font as well.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from urllib.parse import unquote, urlsplit

SITE, PAGE = 30_000_000, 3_000_000
"""Largest weight of the book, and of a page with all that it loads, in bytes."""

UNUSED = (
    "**/*.map",
    "_static/locales/**/*",
    "_static/scripts/fontawesome.js*",
    "_static/vendor/fontawesome/webfonts/*.ttf",
    "_static/mathjax/adaptors/*",
    "_static/mathjax/*.js",
    "_static/mathjax/input/mml/**/*",
    "_static/mathjax/input/*.js",
    "_static/mathjax/output/*.js",
    "_static/mathjax/output/svg/**/*",
    "_static/mathjax/sre/mathmaps/*",
)
USED = ("tex-chtml.js", "base.json", "en.json")
"""What of these stays: MathJax as it is loaded, and the words with which it speaks."""

_ICONS = re.compile(r'<script[^>]*src="[^"]*fontawesome\.js[^"]*"[^>]*>\s*</script>\s*')
_THEBE = re.compile(
    r"<script[^>]*>const THEBE_JS_URL[^<]*</script>\s*|"
    r'<script[^>]*src="[^"]*sphinx-thebe\.js[^"]*"[^>]*>\s*</script>\s*'
)
"""Cells that run on a server elsewhere: the theme declares it twice, which is an error."""
_INDEX = re.compile(r'<script[^>]*src="[^"]*searchindex\.js[^"]*"[^>]*>\s*</script>\s*')
"""What can be searched; the page that searches asks for it, every other one would for nothing."""
_LOADS = re.compile(r'<(?:script|img|link)\b[^>]*?\b(?:src|href)="([^"#]+)"[^>]*>')


def prune(html_root: Path) -> None:
    """Remove the files that no page loads, and the outputs from the notebooks to download.

    Parameters
    ----------
    html_root : Path
        Folder of the built HTML.
    """
    for pattern in UNUSED:
        for path in html_root.glob(pattern):
            if path.is_file() and path.name not in USED:
                path.unlink()
    for path in html_root.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        lighter = _THEBE.sub("", _ICONS.sub("", text))
        if path.name != "search.html":
            lighter = _INDEX.sub("", lighter)
        if lighter != text:
            path.write_text(lighter, encoding="utf-8")
    for path in html_root.glob("_sources/**/*.ipynb"):
        notebook = json.loads(path.read_text(encoding="utf-8"))
        for cell in notebook["cells"]:
            if cell["cell_type"] == "code":
                cell |= {"outputs": [], "execution_count": None}
        path.write_text(json.dumps(notebook, ensure_ascii=False, indent=1), encoding="utf-8")


def faults(html_root: Path, *, site: int = SITE, page: int = PAGE) -> list[str]:
    """What is too heavy; empty when nothing is.

    Parameters
    ----------
    html_root : Path
        Folder of the built HTML.
    site, page : int
        Bytes allowed to the whole, and to a page with its scripts, styles and pictures.
    """
    found = []
    total = sum(path.stat().st_size for path in html_root.rglob("*") if path.is_file())
    if total > site:
        found.append(f"the book weighs {total / 1e6:.1f} MB, wanted at most {site / 1e6:g}")
    for path in sorted(html_root.rglob("*.html")):
        if (weight := page_weight(path)) > page:
            name = path.relative_to(html_root).as_posix()
            found.append(f"{name}: weighs {weight / 1e6:.1f} MB, wanted at most {page / 1e6:g}")
    return found


def page_weight(page: Path) -> int:
    """Bytes of a page with the scripts, styles and pictures that it names."""
    text = page.read_text(encoding="utf-8")
    names = {
        unquote(urlsplit(match[1]).path)
        for match in _LOADS.finditer(text)
        if not match[0].startswith("<link") or 'rel="stylesheet"' in match[0]
    }
    files = {(page.parent / name).resolve() for name in names if name and not name.startswith("/")}
    return page.stat().st_size + sum(path.stat().st_size for path in files if path.is_file())


def setup(app) -> dict[str, bool]:
    """Called by Sphinx."""

    def finished(app, error: Exception | None) -> None:
        if error is None and app.builder.name == "html":
            prune(Path(app.outdir))

    app.connect("build-finished", finished)
    return {"parallel_read_safe": True}
