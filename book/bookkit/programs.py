"""The programs of pages and notebooks as Python files, for a type checker."""

from __future__ import annotations

import re
from pathlib import Path

_PROGRAM = re.compile(
    r"^( *)```(?:python|\{code-cell\} ipython3)\n((?:---\n.*?^---\n|(?: *:[^\n]*\n)*))(.*?)^\1```$",
    re.M | re.S,
)  # an indentation, the options of a cell, the program


def program(text: str) -> str:
    """The Python of a page, or the cells of a notebook, each line at its place, all else blank."""
    lines = [""] * (text.count("\n") + 1)
    for match in _PROGRAM.finditer(text):
        first = text.count("\n", 0, match.start(3))
        for k, line in enumerate(match[3].splitlines()):
            lines[first + k] = line.removeprefix(match[1])
    return "\n".join(lines).rstrip("\n") + "\n"


def write(root: Path, folder: Path) -> None:
    """Write the programs of the README and of all notebooks into an empty folder."""
    folder.mkdir(parents=True)
    for page in [root / "README.md", *(root / "notebooks").glob("*.md")]:
        (folder / f"{page.stem}.py").write_text(program(page.read_text()))
