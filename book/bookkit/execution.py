"""Turn text notebooks into executed ones, and only those whose inputs changed.

The text file ``notebooks/x.md`` is the source; ``notebooks/x.ipynb`` is made from it and
carries the hash of everything it was made from, so that staleness is a fact of the files.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import cache
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from yaml import YAMLError

import seedslib
from bookkit.claims import LEDGER, read_ledger
from bookkit.recording import read_records
from seedslib.base.atomic import write_whole

KERNEL = "python3"
TIMEOUT = 600
"""Seconds for a cell."""

STAMP = "seedslib"
"""Entry of a notebook's metadata: hash of its inputs, and the library files it imported."""

LOCK = "requirements.lock"
PACKAGES = {"seedslib": Path(seedslib.__file__).parent, "bookkit": Path(__file__).parent}

_IMPORTED = """import sys
print(*sorted(m for m in sys.modules if m.partition(".")[0] in ("seedslib", "bookkit")))"""


def project_root(start: Path) -> Path:
    """Nearest folder at or above `start` that holds the lock file.

    Raises
    ------
    ValueError
        There is none.
    """
    for folder in (start.resolve(), *start.resolve().parents):
        if (folder / LOCK).is_file():
            return folder
    raise ValueError(f"no {LOCK} at or above {start}: run this inside the project")


def sources(root: Path, chosen: Sequence[str] = ()) -> list[Path]:
    """The text notebooks of the project, or the chosen ones (``.md`` or ``.ipynb`` names).

    Raises
    ------
    ValueError
        A chosen notebook has no text source.
    """
    paths = [Path(name).resolve().with_suffix(".md") for name in chosen]
    for path in paths:
        if not path.is_file():
            raise ValueError(f"{path}: no such text notebook")
    return paths or sorted((root / "notebooks").glob("*.md"))


def is_stale(source: Path) -> bool:
    """Whether the executed notebook is missing or was made from other inputs."""
    try:
        stamp = json.loads(source.with_suffix(".ipynb").read_text())["metadata"][STAMP]
        return stamp["inputs"] != _fingerprint(source, stamp["library"], library_contents())
    except (OSError, ValueError, KeyError, TypeError, YAMLError):
        return True


def execute(root: Path, chosen: Sequence[str] = (), *, force: bool = False) -> dict[str, str]:
    """Execute the stale notebooks, two at a time; a failure leaves the old result in place.

    Parameters
    ----------
    root : Path
        The project's folder.
    chosen : sequence of str
        Which notebooks; all by default.
    force : bool
        Execute those that are up to date as well.

    Returns
    -------
    dict of str to str
        For each source by its name what went wrong, empty where it was executed.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    todo = [path for path in sources(root, chosen) if force or is_stale(path)]
    problems = {}
    with ThreadPoolExecutor(max_workers=2) as pool:  # the work is done by the kernels
        running = {pool.submit(_execute_one, path): path for path in todo}
        for future in as_completed(running):
            name = running[future].name
            problems[name] = future.result()
            print(f"{name}: {problems[name] or 'executed'}", flush=True)
    return problems


def _execute_one(source: Path) -> str:
    """Execute one notebook; whatever is wrong with it is its outcome, not the others' end."""
    try:
        # What it depends on is read before it runs: a change made meanwhile leaves it stale.
        text, contents = source.read_text(), library_contents()
        notebook = jupytext.reads(text, fmt="md")
        notebook.cells.append(nbformat.v4.new_code_cell(_IMPORTED))
        NotebookClient(
            notebook,
            timeout=TIMEOUT,
            kernel_name=KERNEL,
            record_timing=False,
            coalesce_streams=True,
            extra_arguments=["--log-level=CRITICAL"],
            resources={"metadata": {"path": str(source.parent)}},
        ).execute()
        library = notebook.cells.pop().outputs[0].text.split()
        _normalise(notebook)
        read_records(notebook)
        inputs = _fingerprint(source, library, contents, text)
    except CellExecutionError as error:
        return f"failed: {error.ename}: {error.evalue}\n{error.traceback}"
    except Exception as error:
        return f"failed: {type(error).__name__}: {error}"
    notebook.metadata[STAMP] = {"inputs": inputs, "library": library}
    write_whole(source.with_suffix(".ipynb"), (nbformat.writes(notebook) + "\n").encode())
    return ""


def _normalise(notebook: nbformat.NotebookNode) -> None:
    """Drop all that differs between two runs of the same notebook; refuse warnings in it."""
    notebook.metadata.get("language_info", {}).pop("version", None)
    notebook.metadata.pop("widgets", None)
    for index, cell in enumerate(notebook.cells):
        cell["id"] = digest(index, cell.source)[:12]
        cell.metadata.pop("execution", None)
        for output in cell.get("outputs", []):
            if output.get("name") == "stderr":
                raise ValueError(f"cell {index} wrote to stderr: {output.text[:200]}")


def _fingerprint(
    source: Path, library: Iterable[str], contents: Mapping[str, bytes], text: str | None = None
) -> str:
    """Hash of what a notebook depends on: text, library, data files, lock, its claims."""
    text = source.read_text() if text is None else text
    root = project_root(source.parent)
    notebook = jupytext.reads(text, fmt="md")
    claims = []
    if (root / LEDGER).is_file():
        own = [c for c in read_ledger(root / LEDGER) if c.notebook == f"notebooks/{source.name}"]
        claims = [claim.model_dump_json(exclude={"verdict"}) for claim in own]
    data = {name: (root / name).read_bytes() for name in data_files(notebook)}
    return digest(text, library_digest(library, contents), data, claims)


def data_files(notebook: Mapping) -> list[str]:
    """The files that a notebook depends on beside the library, relative to the project."""
    return [LOCK, *notebook["metadata"].get("inputs", [])]


def library_contents() -> dict[str, bytes]:
    """All modules of the library and of the harness, by name, with what is in their files.

    Comments and docstrings are left out: they change no number. Other files of a package, such as
    those that programs in C are written with, belong to it.
    """
    contents: dict[str, bytes] = {}
    for package, folder in PACKAGES.items():
        for path in sorted(folder.rglob("*")):
            if path.is_file() and path.suffix not in {".pyc", ".md"}:
                own = path.relative_to(folder).with_suffix("").parts
                parts = own if path.suffix == ".py" else (*own[:-1], "__init__")
                name = ".".join((package, *parts))
                text = path.read_bytes()
                part = _program(text) if path.suffix == ".py" else text
                contents[name] = contents.get(name, b"") + part
    return contents


@cache
def _program(text: bytes) -> bytes:
    """Hash of a module without its comments and docstrings."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            node.body = [part for part in node.body if not _is_text(part)]
    return hashlib.sha256(ast.dump(tree).encode()).digest()


def _is_text(statement: ast.stmt) -> bool:
    value = statement.value if isinstance(statement, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


def library_digest(modules: Iterable[str], contents: Mapping[str, bytes]) -> str:
    """Hash of some modules; one that is not there any more changes it."""
    files = (contents.get(m) or contents.get(f"{m}.__init__") for m in sorted(modules))
    return digest(*files)


def digest(*parts: object) -> str:
    """Short hash of the parts' representation."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:24]
