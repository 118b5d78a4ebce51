"""Turn text notebooks into executed ones, and only those whose inputs changed.

The text file ``notebooks/x.md`` is the source; ``notebooks/x.ipynb`` is made from it and
carries the hash of everything it was made from, so that staleness is a fact of the files.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import NamedTuple

import jupytext
import nbformat
from nbclient.exceptions import CellExecutionError, CellTimeoutError

from bookkit import fingerprint
from bookkit.claims import LEDGER, Claim, own_claims
from bookkit.files import replace
from bookkit.limits import Held, Limits, end_with_parent
from bookkit.recording import read_records
from bookkit.streams import merged

KERNEL = "python3"
TIMEOUT = 600
"""Seconds for a cell."""

LIMITS = Limits(memory=8.0)
"""Of a chapter."""

STAMP = "seedslib"

_LOADED = (
    "import json, pathlib, sys\n"
    "_homes = {name: pathlib.Path(sys.modules[name].__file__).parents[1]\n"
    "    for name in ('seedslib', 'bookkit') if name in sys.modules}\n"
    "_paths = [(_homes.get(name.split('.')[0]), m.__file__)\n"
    "    for name, m in list(sys.modules.items()) if getattr(m, '__file__', None)]\n"
    "print(json.dumps(sorted(pathlib.Path(path).relative_to(home).as_posix()\n"
    "    for home, path in _paths if home)))"
)


class Outcome(NamedTuple):
    """What became of one notebook; `problem` is empty when it was executed."""

    source: Path
    problem: str


def sources(root: Path, chosen: Sequence[str] = ()) -> list[Path]:
    """The text notebooks of the project, or the chosen ones (``.md`` or ``.ipynb`` names).

    Raises
    ------
    ValueError
        A chosen notebook has no text source.
    """
    if not chosen:
        return sorted((root / "notebooks").glob("*.md"))
    found = [Path(name).resolve().with_suffix(".md") for name in chosen]
    for name, path in zip(chosen, found, strict=True):
        if not path.is_file():
            raise ValueError(f"{name}: no such text notebook, wanted a file {path.name}")
    return found


def is_stale(source: Path) -> bool:
    """Whether the executed notebook is missing or was made from other inputs."""
    target = source.with_suffix(".ipynb")
    if not target.is_file():
        return True
    try:
        stamp = json.loads(target.read_text())["metadata"][STAMP]
        return stamp["inputs"] != _inputs(source)(stamp["library"])
    except (ValueError, KeyError, TypeError):
        return True


def execute(root: Path, chosen: Sequence[str] = (), *, force: bool = False) -> list[Outcome]:
    """Execute the stale notebooks, two at a time; a failure leaves the old result in place.

    Parameters
    ----------
    root : Path
        The project's folder.
    chosen : sequence of str
        Which notebooks; all by default.
    force : bool
        Execute those that are up to date as well.
    """
    todo = [path for path in sources(root, chosen) if force or is_stale(path)]
    return list(_outcomes(todo))


def _outcomes(todo: Iterable[Path]) -> Iterable[Outcome]:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    spawn = get_context("spawn")
    with ProcessPoolExecutor(max_workers=2, mp_context=spawn, initializer=end_with_parent) as pool:
        running = {pool.submit(_execute_one, path): path for path in todo}
        try:
            for future in as_completed(running):
                try:
                    problem = future.result()
                except BrokenProcessPool:
                    problem = "failed: the process that executed it, or its neighbour, was killed"
                print(f"{running[future].name}: {problem or 'executed'}", flush=True)
                yield Outcome(running[future], problem)
        except KeyboardInterrupt:
            for process in active_children():  # the pool would wait for them
                process.kill()
            raise


def _execute_one(source: Path) -> str:
    """Execute one notebook; whatever is wrong with it is its outcome, not the others' end."""
    try:
        return _execute_source(source)
    except Exception as error:
        return f"failed: {type(error).__name__}: {_one_line(error)}"


def _execute_source(source: Path) -> str:
    # What it depends on is read before it runs: a change made meanwhile leaves it stale.
    inputs, claims = _inputs(source), _claims(source)
    notebook = _read(source)
    missing = [n for n in _declared(notebook) if not (_root(source) / n).is_file()]
    if missing:
        return f"failed: no such input: {', '.join(missing)}"
    probe = nbformat.v4.new_code_cell(_LOADED)
    notebook.cells.append(probe)
    started: list[int] = [0]
    client = Held(
        notebook,
        limits=LIMITS,
        timeout=TIMEOUT,
        iopub_timeout=60,
        raise_on_iopub_timeout=True,
        kernel_name=KERNEL,
        record_timing=False,
        extra_arguments=["--log-level=CRITICAL"],
        resources={"metadata": {"path": str(source.parent)}},
        on_cell_start=lambda cell, cell_index: started.append(cell_index),
    )
    try:
        client.execute()
    except CellTimeoutError:
        return f"failed: cell {started[-1]}: took longer than {TIMEOUT} s"
    except CellExecutionError as error:
        return f"failed: cell {started[-1]}: {error.ename}: {error.evalue}"
    except RuntimeError as error:
        return f"failed: cell {started[-1]}: {_one_line(error)}"
    for cell in notebook.cells:
        if "outputs" in cell:
            cell.outputs = merged(cell.outputs)
    library = json.loads(notebook.cells.pop().outputs[0]["text"])
    for index, cell in enumerate(notebook.cells):
        if noise := _on_stderr(cell):
            return f"failed: cell {index} wrote to stderr: {noise[:200]}"
    try:
        read_records(notebook)
    except ValueError as error:
        return f"failed: {error}"
    _normalise(notebook)
    told = [claim.model_dump(mode="json", exclude_none=True) for claim in claims]
    notebook.metadata[STAMP] = {"inputs": inputs(library), "library": library, "claims": told}
    if not source.is_file():
        return "failed: its source was removed while it ran"
    replace(source.with_suffix(".ipynb"), nbformat.writes(notebook) + "\n")
    return ""


def _inputs(source: Path) -> Callable[[Iterable[str]], str]:
    """Hash of what the notebook depends on as it stands now, given the library files it uses."""
    text = source.read_text()
    contents = fingerprint.library_contents()
    names = [fingerprint.LOCK, *_declared(_read(source))]
    files = fingerprint.file_digest(_root(source), names)
    claims = [c.model_dump_json(exclude={"verdict", "kind"}) for c in _claims(source)]

    def hashed(library: Iterable[str]) -> str:
        used = fingerprint.library_digest(library, contents)
        return fingerprint.digest(text, used, files, claims)

    return hashed


def _claims(source: Path) -> list[Claim]:
    """What the ledger asks of the notebook."""
    return own_claims(_root(source) / LEDGER, f"notebooks/{source.name}")


def _root(source: Path) -> Path:
    return fingerprint.project_root(source)


def _read(source: Path) -> nbformat.NotebookNode:
    """The text notebook, or a ValueError that names what cannot be read in it."""
    try:
        return jupytext.read(source)
    except Exception as error:
        raise ValueError(f"{source.name} is no text notebook: {_one_line(error)}") from None


def _declared(notebook: nbformat.NotebookNode) -> list[str]:
    """The data files that the front matter names, relative to the project."""
    names = notebook.metadata.get("inputs", [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"inputs: wanted a list of file names, got {names!r}")
    return names


def _normalise(notebook: nbformat.NotebookNode) -> None:
    """Drop all that differs between two runs of the same thing."""
    notebook.metadata.get("language_info", {}).pop("version", None)
    notebook.metadata.pop("widgets", None)
    for index, cell in enumerate(notebook.cells):
        cell["id"] = fingerprint.digest(index, cell.source)[:12]
        cell.metadata.pop("execution", None)


def _on_stderr(cell: nbformat.NotebookNode) -> str:
    outputs = cell.get("outputs", [])
    return "".join(o["text"] for o in outputs if o.get("name") == "stderr")


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
