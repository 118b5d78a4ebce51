"""What a page shows of a cell: results, and the rest folded under them.

A Sphinx extension. `record` prints what it recorded for people in JupyterLab; on a page the prose
shows those numbers, so they are left out. Text that a cell with the tag ``fold-text`` printed is
folded with its code: it is there for who wants to check, and the prose says what follows from it.
Other printed text is shown, and what of it is a table is a table of the page.
"""

from __future__ import annotations

import json
from pathlib import Path

from docutils import nodes
from PIL import Image
from sphinx.transforms.post_transforms import SphinxPostTransform

from bookkit.recording import MIME
from bookkit.text_tables import pieces, to_html

FOLD = "fold-text"
"""Tag of a cell whose printed text is folded with its code."""


def without_records(notebook: dict) -> dict:
    """The notebook without what `record` printed; the glued numbers and the claims' boxes stay."""
    for cell in notebook["cells"]:
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if MIME in data and "text/html" not in data:
                output["data"] = {}
        if "outputs" in cell:
            cell["outputs"] = [out for out in cell["outputs"] if out.get("data", {"": ""})]
    return notebook


class FoldText(SphinxPostTransform):
    """Move printed text into the part of a cell that is folded."""

    default_priority = 198  # just before MyST-NB folds
    formats = ("html",)

    def run(self, **kwargs: object) -> None:
        """Called by Sphinx for each page."""
        for cell in list(self.document.findall(nodes.container)):
            if f"tag_{FOLD}" not in cell["classes"]:
                continue
            parts = {part.get("nb_element"): part for part in cell.children}
            code, output = parts.get("cell_code_source"), parts.get("cell_code_output")
            if code is None or output is None:
                continue
            for text in [part for part in output.children if "stream" in part["classes"]]:
                output.remove(text)
                code.append(text)
            if not output.children:
                cell.remove(output)


class TextTables(SphinxPostTransform):
    """Turn tables of printed text into tables of the page."""

    default_priority = 199  # after `FoldText`: what is folded stays text
    formats = ("html",)

    def run(self, **kwargs: object) -> None:
        """Called by Sphinx for each page."""
        for output in list(self.document.findall(nodes.container)):
            if output.get("nb_element") != "cell_code_output":
                continue
            for text in [part for part in output.children if "stream" in part["classes"]]:
                parts = pieces(text.astext())
                if any(part.rows for part in parts):
                    at = output.index(text)
                    output[at : at + 1] = [_shown(part, text) for part in parts]


class FigureWidths(SphinxPostTransform):
    """Show figures at the size they were drawn for: their pictures have two dots for one."""

    default_priority = 200
    formats = ("html",)

    def run(self, **kwargs: object) -> None:
        """Called by Sphinx for each page."""
        for output in list(self.document.findall(nodes.container)):
            if output.get("nb_element") != "cell_code_output":
                continue
            for image in output.findall(nodes.image):
                path = Path(self.app.srcdir) / image["uri"]
                if path.suffix == ".png" and "width" not in image:
                    with Image.open(path) as picture:
                        image["width"] = f"{picture.width // 2}px"


def _shown(part, text: nodes.Element) -> nodes.Element:
    if part.rows:
        table = nodes.raw("", to_html(part.rows, part.caption), format="html")
        return nodes.container("", table, classes=["output", "text_html"])
    rest = text.copy()
    rest += nodes.Text("\n".join(part.lines))
    rest.rawsource = rest.astext()
    return rest


def _on_read(app, docname: str, source: list[str]) -> None:
    if str(app.env.doc2path(docname)).endswith(".ipynb"):
        source[0] = json.dumps(without_records(json.loads(source[0])))


def setup(app) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("source-read", _on_read)
    app.add_post_transform(FoldText)
    app.add_post_transform(TextTables)
    app.add_post_transform(FigureWidths)
    return {"parallel_read_safe": True}
