"""The programs of pages and notebooks as Python files, for a type checker."""

from __future__ import annotations

import re
from pathlib import Path

_PROGRAM = re.compile(
    r"^( *)```(?:python|\{code-cell\} ipython3)\n((?:---\n.*?^---\n|(?: *:[^\n]*\n)*))(.*?)^\1```$",
    re.M | re.S,
)  # an indentation, the options of a cell, the program

_HEAD = """# pyright: reportArgumentType=false
# pyright: reportPossiblyUnboundVariable=false, reportRedeclaration=false
"""
"""What checkers say of options in dictionaries and of names set in loops is no fault of a cell."""


def program(text: str) -> str:
    """The Python of a page, or the cells of a notebook, each line at its place, all else blank."""
    lines = [""] * (text.count("\n") + 1)
    for match in _PROGRAM.finditer(text):
        first = text.count("\n", 0, match.start(3))
        for k, line in enumerate(match[3].splitlines()):
            lines[first + k] = line.removeprefix(match[1])
    return "\n".join(lines).rstrip("\n") + "\n"


def write(root: Path, folder: Path) -> None:
    """Write the programs of the README and the cells of all notebooks into an empty folder."""
    folder.mkdir(parents=True)
    (folder / "README.py").write_text(program((root / "README.md").read_text()))
    for page in (root / "notebooks").glob("*.md"):
        cells = page.read_text().replace("```python\n", "```text\n")  # stubs and their solutions
        (folder / f"{page.stem}.py").write_text(_HEAD + program(cells).removeprefix("\n\n"))
