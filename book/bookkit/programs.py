"""The programs of pages and notebooks, looked over by a type checker as a reader's editor would."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

FENCE = re.compile(
    r"^( *)```(?:python|\{code-cell\} ipython3)\n((?:---\n.*?^---\n|(?: *:[^\n]*\n)*))(.*?)^\1```$",
    re.M | re.S,
)  # an indentation, the options of a cell, the program


def program(text: str) -> str:
    """The Python of a page, or the cells of a notebook, each line at its place, all else blank."""
    lines = [""] * (text.count("\n") + 1)
    for match in FENCE.finditer(text):
        first = text.count("\n", 0, match.start(3))
        for k, line in enumerate(match[3].splitlines()):
            lines[first + k] = line.removeprefix(match[1])
    return "\n".join(lines).rstrip("\n") + "\n"


def faults(root: Path, pages: list[Path]) -> list[str]:
    """What the type checker finds in the programs of some pages, a line each.

    Raises
    ------
    ValueError
        A page without a program.
    """
    with tempfile.TemporaryDirectory() as folder:
        files = {}
        for page in pages:
            text = program(page.read_text())
            if not text.strip():
                raise ValueError(f"{page.name}: wanted a program, found none")
            file = Path(folder).resolve() / f"{page.stem}.py"
            file.write_text(text)
            files[str(file)] = page
        # an editable install is not seen by a type checker: it is told where the packages are
        config = {"typeCheckingMode": "standard", "extraPaths": [str(root), str(root / "book")]}
        (Path(folder) / "pyrightconfig.json").write_text(json.dumps(config))
        done = subprocess.run(
            [sys.executable, "-m", "basedpyright", "--outputjson", "--pythonpath", sys.executable],
            cwd=folder,
            capture_output=True,
            text=True,
        )
    found = json.loads(done.stdout)
    assert found["summary"]["filesAnalyzed"] >= len(files), done.stdout
    return [
        f"{files[fault['file']].relative_to(root)}:{fault['range']['start']['line'] + 1}: "
        f"{fault['message']}"
        for fault in found["generalDiagnostics"]
        if fault["severity"] == "error"
    ]
