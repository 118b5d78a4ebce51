"""A new chapter of the book: a notebook to write in, in the contents and in the README's table."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

from bookkit.files import replace

_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
_CAPTION = re.compile(r"^  - caption: (.*)\n", re.M)

_TEMPLATE = Path(__file__).with_name("chapter.template")


def write(root: Path, name: str, title: str, part: str | None = None) -> str:
    """Write a new notebook source and enter it in ``_toc.yml`` and the README's table.

    Parameters
    ----------
    root : Path
        The project's folder.
    name : str
        The source will be ``notebooks/<name>.md``.
    title : str
    part : str, optional
        Caption of the part of the book whose last page it becomes. By default the part with a
        notebook whose name begins with the same word, or else the last part with notebooks.

    Returns
    -------
    str
        Caption of the part.

    Raises
    ------
    ValueError
        A name or a title that cannot be one, a name or part that is taken or unknown, contents or
        a table that have no place for it. Nothing is written then.
    """
    if not _NAME.fullmatch(name):
        raise ValueError(f"name: wanted words of a-z and 0-9 joined by '_', got {name!r}")
    if not title.strip() or re.search(r"[\n|\[\]]", title):
        raise ValueError(f"title: wanted one line without '|', '[' and ']', got {title!r}")
    page, title = f"notebooks/{name}", title.strip()
    source = root / f"{page}.md"
    contents, table = (_text(root / file) for file in ("_toc.yml", "README.md"))
    parts = _parts(contents)
    for path in (source, source.with_suffix(".ipynb")):
        if path.exists():
            raise ValueError(f"name: notebooks/{path.name} is there already, wanted a new name")
    if re.search(rf"file: {page}$", contents, re.M):
        raise ValueError(f"name: {page} is in _toc.yml already, wanted a new name")
    chosen = _part(parts, name) if part is None else part
    if chosen not in parts:
        raise ValueError(f"part: wanted one of {', '.join(parts)}, got {chosen!r}")
    contents = _entered(contents, chosen, page)
    table = _listed(table, parts[chosen], f"[{title}]({page}.ipynb)")
    label = name.replace("_", "-")
    text = _TEMPLATE.read_text().replace("@TITLE@", title).replace("@LABEL@", label)
    replace(source, text)
    replace(root / "_toc.yml", contents)
    replace(root / "README.md", table)
    return chosen


def _text(path: Path) -> str:
    if not path.is_file():
        raise ValueError(f"{path.name}: no such file, wanted a project with a book")
    return path.read_text()


def _parts(contents: str) -> dict[str, list[str]]:
    """The pages of each part of the book, in order."""
    try:
        parts = yaml.safe_load(contents)["parts"]
        return {part["caption"]: [page["file"] for page in part["chapters"]] for part in parts}
    except (yaml.YAMLError, KeyError, TypeError):
        raise ValueError("_toc.yml: wanted parts with captions and chapters") from None


def _part(parts: dict[str, list[str]], name: str) -> str:
    """The part with the nearest kin of a new page."""
    kin = f"notebooks/{name.partition('_')[0]}_"
    near = [part for part, pages in parts.items() if any(page.startswith(kin) for page in pages)]
    some = [part for part, pages in parts.items() if any("notebooks/" in page for page in pages)]
    if not some:
        raise ValueError("_toc.yml: wanted a part with a notebook")
    return near[0] if near else some[-1]


def _entered(contents: str, part: str, page: str) -> str:
    """The contents with a page at the end of a part; everything else as it stands."""
    starts = list(_CAPTION.finditer(contents))
    ends = [start.start() for start in starts[1:]] + [len(contents)]
    for start, end in zip(starts, ends, strict=False):
        if yaml.safe_load(start[1]) == part:
            chapters = contents[:end].rstrip("\n")
            return f"{chapters}\n      - file: {page}\n{contents[end:]}"
    raise ValueError(f"_toc.yml: wanted a line '  - caption: {part}'")


def _listed(table: str, pages: list[str], link: str) -> str:
    """The README with a link after that of the last listed page of a part."""
    for page in reversed(pages):
        found = list(re.finditer(rf"\[[^\[\]]*\]\({re.escape(page)}\.\w+\)(?=, \[| \|)", table))
        if found:
            end = found[-1].end()
            return f"{table[:end]}, {link}{table[end:]}"
    raise ValueError("README.md: wanted a row of the table with a page of that part")
