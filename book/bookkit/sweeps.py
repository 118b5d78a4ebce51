"""Run a notebook over a grid of parameters, on this machine or on a cluster.

Text travels, not files: a worker receives the notebook and returns it executed, so no disk
is shared. Every finished point is one pair of files, written at once; a sweep that was killed
goes on where it stopped.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import nbformat

from bookkit import fingerprint
from bookkit.files import replace
from bookkit.grids import MOST_POINTS, check_points, read_grid
from bookkit.kept import entry_of, read_entry, write_table
from bookkit.limits import Limits
from bookkit.points import execute_point, library_of

TABLE = "results.csv"


class Report(NamedTuple):
    """How a sweep ended: numbers of points, and the table it wrote."""

    total: int
    already: int
    failed: int
    table: Path


def run_sweep(
    notebook: Path | str,
    grid: Path | str,
    out: Path | str,
    *,
    scheduler: str | None = None,
    workers: int = 2,
    retry: bool = False,
    quiet: bool = False,
    limits: Limits | None = None,
    most: int = MOST_POINTS,
) -> Report:
    """Run every point of a grid that is not yet done, and write the table of all of them.

    Parameters
    ----------
    notebook : path
        An executed notebook (``.ipynb``) with a parameters cell and a check cell after it.
    grid : path
        YAML file with the values of each parameter.
    out : path
        Folder of results: ``<key>.ipynb`` and ``<key>.json`` per point, ``results.csv``.
    scheduler : str, optional
        Address of a running Dask scheduler; by default a cluster is started here.
    workers : int
        Number of local worker processes.
    retry : bool
        Run points again that failed before.
    quiet : bool
        No progress bar.
    limits : Limits, optional
        What each point may take; one that takes more is a failed point.
    most : int
        Points that a grid may have.

    Returns
    -------
    Report

    Raises
    ------
    ValueError
        A missing or ill-formed file, an unknown or refused parameter, an unreachable
        scheduler, a kept point that is not of its place: before anything is run. Also a worker
        whose library differs from this one, and a scheduler that is lost on the way; what was
        finished is kept.
    """
    notebook, grid, out = Path(notebook), Path(grid), Path(out)
    if notebook.suffix != ".ipynb" or not notebook.is_file():
        raise ValueError(f"{notebook}: wanted an existing .ipynb notebook")
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise ValueError(f"workers: wanted a whole number of at least 1, got {workers!r}")
    (limits := limits or Limits()).check()
    text = notebook.read_text()
    try:
        content = nbformat.reads(text, as_version=4)
    except Exception:
        raise ValueError(f"{notebook}: not a notebook file") from None
    wanted = read_grid(grid)
    if wanted.notebook and Path(wanted.notebook).stem != notebook.stem:
        raise ValueError(f"{grid}: is for {wanted.notebook}, not for {notebook}")
    points = wanted.points(most)
    check_points(content, points)
    inputs = _inputs(notebook, content)
    _make_folder(out)
    files = {_key(notebook, content, point): point for point in points}
    finished = {key: read_entry(out, key, point) for key, point in files.items()}
    failed_before = [k for k, r in finished.items() if r is not None and r["problem"]]
    todo = [k for k, r in finished.items() if r is None or (retry and r["problem"])]
    already = len(files) - len(todo)
    print(
        f"{len(files)} points, {already} already done"
        + (f" ({len(failed_before)} of them failed)" if failed_before and not retry else "")
        + f", {len(todo)} to run",
        flush=True,
    )
    if todo:
        with _client(scheduler, min(workers, len(todo))) as client:
            left = {key: files[key] for key in todo}
            _run(client, text, inputs, left, out, quiet, limits)
    results = {key: read_entry(out, key, point) for key, point in files.items()}
    table = out / TABLE
    write_table(table, files, results)
    failed = sum(1 for r in results.values() if r is None or r["problem"])
    return Report(len(files), already, failed, table)


def _key(path: Path, notebook: nbformat.NotebookNode, point: Mapping[str, Any]) -> str:
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    names = [fingerprint.LOCK, *notebook.metadata.get("inputs", [])]
    files = fingerprint.file_digest(fingerprint.project_root(path.parent), names)
    return fingerprint.digest(code, library_of(notebook), files, sorted(point.items()))


def _inputs(path: Path, notebook: nbformat.NotebookNode) -> dict[str, str]:
    """Text of the data files that the notebook says it reads; they travel with it.

    Raises
    ------
    ValueError
        One of them is not there, or no text.
    """
    root = fingerprint.project_root(path.parent)
    found = {}
    for name in notebook.metadata.get("inputs", []):
        try:
            found[name] = (root / name).read_text()
        except (OSError, UnicodeDecodeError):
            raise ValueError(f"{path.name}: wanted its input {name}, a text file") from None
    return found


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise ValueError(f"{out}: wanted a folder for the results, but a file is there") from None
    if (out / TABLE).is_dir():
        raise ValueError(f"{out / TABLE}: wanted a file for the table, but a folder is there")
    if not os.access(out, os.W_OK | os.X_OK):
        raise ValueError(f"{out}: wanted a folder that can be written to")


def _run(
    client: Any,
    text: str,
    inputs: dict[str, str],
    todo: Mapping[str, dict],
    out: Path,
    quiet: bool,
    limits: Limits | None = None,
) -> None:
    from dask.distributed import as_completed
    from tqdm import tqdm

    def submitted(key: str, name: str) -> Any:
        work = text, todo[key], inputs, limits
        return client.submit(execute_point, *work, key=f"{name}-{key}", retries=2)

    ours, suspects = library_of(json.loads(text)), []
    running = {submitted(key, "point"): key for key in todo}
    for future in tqdm(as_completed(running), total=len(running), unit="point", disable=quiet):
        key = running[future]
        if not _kept(future, out, key, todo[key], ours, False):
            suspects.append(key)
    for key in suspects:  # it may only have waited beside one that kills its worker
        _kept(submitted(key, "alone"), out, key, todo[key], ours, True)


def _kept(future: Any, out: Path, key: str, point: Mapping, ours: str, alone: bool) -> bool:
    """Whether what became of a point is written; not where it has lost its workers, with others."""
    try:
        result = future.result()
    except Exception as error:
        kind = type(error).__name__
        if kind == "KilledWorker" and not alone:
            return False
        lost = "its worker was lost again and again"  # where it was is no matter
        problem = lost if kind == "KilledWorker" else f"{kind}: {error}"
        result = {"notebook": "", "problem": problem, "library": ours}
    if future.cancelled():
        raise ValueError("the scheduler was lost; what was finished is kept: start it again")
    if result["library"] != ours:
        raise ValueError("a worker runs another version of seedslib: install this one there")
    entry = entry_of(point, result)
    if result["notebook"]:
        replace(out / f"{key}.ipynb", result["notebook"])
    replace(out / f"{key}.json", json.dumps(entry, indent=1) + "\n")
    future.release()  # a worker that is lost later need not do it again
    return True


@contextmanager
def _client(scheduler: str | None, workers: int):
    from dask.distributed import Client, LocalCluster

    if scheduler is not None:
        from seedslib.extra.dask_crew import connect

        with connect(scheduler) as client:
            if not client.scheduler_info()["workers"]:
                print(f"{scheduler}: no workers there yet, waiting for one", flush=True)
            yield client
        return
    with (
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address=None,
            # this machine only, nobody asks who is there; two sweeps want two ports
            host="127.0.0.1",
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            silence_logs=50,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client
