"""Run a notebook over a grid of parameters, on this machine or on a cluster.

Text travels, not files: a worker receives the notebook and returns it executed, so no disk
is shared. Every finished point is one executed notebook, written at once; a sweep that was killed
goes on where it stopped.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from contextlib import redirect_stdout, suppress
from io import StringIO
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import nbformat
import pandas
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bookkit.claims import LEDGER
from bookkit.execution import (
    STAMP,
    data_files,
    digest,
    library_contents,
    library_digest,
    project_root,
)
from bookkit.parameters import explain
from bookkit.recording import columns, read_records
from seedslib.base.atomic import write_whole

TABLE = "results.csv"
SECONDS = 3600
"""For a cell of a point."""

Scalar = bool | int | float | str


class Grid(BaseModel):
    """A grid file: the notebook it is for, and the values of each parameter."""

    model_config = ConfigDict(extra="forbid")
    notebook: str | None = None
    grid: dict[str, Annotated[list[Scalar | list[Scalar]], Field(min_length=1)]]


def run_sweep(
    notebook: Path | str,
    grid: Path | str,
    out: Path | str,
    *,
    scheduler: str | None = None,
    workers: int = 2,
) -> Any:
    """Run every point of a grid that is not yet done, and write the table of all of them.

    Parameters
    ----------
    notebook : path
        An executed notebook (``.ipynb``) with a parameters cell and a check cell after it.
    grid : path
        YAML file with the values of each parameter.
    out : path
        Folder of results: ``<key>.ipynb`` for each point, ``results.csv`` for all.
    scheduler : str, optional
        Address of a running Dask scheduler; by default a cluster is started here.
    workers : int
        Number of local worker processes.

    Returns
    -------
    DataFrame
        The table: parameters, recorded numbers, and under ``problem`` why a point has none.

    Raises
    ------
    ValueError
        Not a grid, or a parameter that the notebook does not have or refuses: before anything is
        run. Also a worker whose library differs from this one.
    """
    notebook, grid, out = Path(notebook), Path(grid), Path(out)
    content = nbformat.read(notebook, as_version=4)
    points = _points(grid, notebook)
    _check_points(content, points)
    root = project_root(notebook.parent)
    files = {name: (root / name).read_text() for name in data_files(content)}
    by_key = {_key(content, files, point): point for point in points}
    files[LEDGER] = (root / LEDGER).read_text()  # another sentence in it makes no other numbers
    out.mkdir(parents=True, exist_ok=True)
    rows = {key: _read_point(out / f"{key}.ipynb", point) for key, point in by_key.items()}
    todo = {key: by_key[key] for key, row in rows.items() if row["problem"]}
    done = len(rows) - len(todo)
    print(f"{len(rows)} points, {done} already done, {len(todo)} to run", flush=True)
    if todo:
        with _client(scheduler, min(workers, len(todo))) as client:
            for key, problem in _run(client, content, files, todo, out):
                rows[key] = _read_point(out / f"{key}.ipynb", by_key[key], problem)
                print(f"{by_key[key]}: {rows[key]['problem'] or 'done'}", flush=True)
    table = pandas.DataFrame(list(rows.values()), dtype=object)  # a whole number stays one
    table["problem"] = table.pop("problem")  # the last column
    table.to_csv(out / TABLE, index=False)
    return table


def _points(path: Path, notebook: Path) -> list[dict[str, Any]]:
    """All combinations of a grid's values, the first parameter slowest."""
    try:
        grid = Grid.model_validate(yaml.safe_load(path.read_text()))
    except ValidationError as error:
        raise ValueError(f"{path}: {explain(error)}") from None
    except yaml.YAMLError as error:
        raise ValueError(f"{path}: not YAML: {error}") from None
    if grid.notebook and Path(grid.notebook).stem != notebook.stem:
        raise ValueError(f"{path}: is for {grid.notebook}, not for {notebook}")
    return [dict(zip(grid.grid, values, strict=True)) for values in product(*grid.grid.values())]


def _check_points(notebook: nbformat.NotebookNode, points: list[dict[str, Any]]) -> None:
    """Run the notebook's own check cell for every point, before any point is run."""
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    tagged = [i for i, cell in enumerate(code) if "parameters" in cell.metadata.get("tags", [])]
    if not tagged:
        raise ValueError("the notebook has no cell tagged 'parameters'")
    parameters, check = code[tagged[0]].source, code[tagged[0] + 1].source
    defaults: dict[str, Any] = {}
    exec(parameters, defaults)
    known = [name for name in defaults if not name.startswith("__")]
    if unknown := [name for name in points[0] if name not in known]:
        have = ", ".join(known)
        raise ValueError(f"{', '.join(unknown)}: unknown parameter, the notebook has {have}")
    errors: dict[str, None] = {}
    for point in points:
        try:
            with redirect_stdout(StringIO()):
                exec(check, defaults | point)
        except ValueError as error:
            errors[str(error)] = None
    if errors:
        raise ValueError("; ".join(errors))


def _key(notebook: nbformat.NotebookNode, files: Mapping[str, str], point: Mapping) -> str:
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    return digest(code, _library(notebook), dict(files), sorted(point.items()))


def _library(notebook: Mapping[str, Any]) -> str:
    """Hash of the modules that the notebook imported when it was executed, as they are here."""
    modules = notebook["metadata"].get(STAMP, {}).get("library", [])
    return library_digest(modules, library_contents())


def run_point(text: str, point: Mapping[str, Any], files: Mapping[str, str]) -> tuple[str, str]:
    """Run one point where this is called: on a worker.

    Parameters
    ----------
    text : str
        The executed notebook.
    point : mapping
        Values of parameters.
    files : mapping of str to str
        Text of the files that the notebook reads, by their names in the project.

    Returns
    -------
    text : str
        The notebook executed with these parameters, with the error that stopped it if one did.
    library : str
        Hash of the library files that it uses, as they are here.
    """
    import papermill

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Dask tells its workers to give memory back at once, which slows every array down.
    os.environ.pop("MALLOC_TRIM_THRESHOLD_", None)
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder, "notebooks")
        for name, content in {**files, "notebooks/in.ipynb": text}.items():
            path = Path(folder, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content)
        with suppress(papermill.PapermillExecutionError):  # the notebook says so itself
            papermill.execute_notebook(
                str(home / "in.ipynb"),
                str(home / "out.ipynb"),
                parameters=dict(point),
                kernel_name="python3",
                execution_timeout=SECONDS,
                progress_bar=False,
                cwd=str(home),
                extra_arguments=["--log-level=CRITICAL"],
            )
        return (home / "out.ipynb").read_text(), _library(json.loads(text))


def _run(client: Any, notebook: Any, files: Mapping, todo: Mapping, out: Path) -> Any:
    """Run points and write their notebooks; yields each with what stopped its worker, if any."""
    from dask.distributed import as_completed

    text, library = nbformat.writes(notebook), _library(notebook)
    running = {
        client.submit(run_point, text, point, files, key=f"point-{key}"): key
        for key, point in todo.items()
    }
    for future in as_completed(running):
        key, problem = running[future], ""
        try:
            done, theirs = future.result()
        except Exception as error:  # a dead kernel, a worker that was lost again and again
            problem = f"{type(error).__name__}: {error}"
        else:
            if theirs != library:
                raise ValueError("a worker has another version of seedslib: install this one there")
            write_whole(out / f"{key}.ipynb", done.encode())
        future.release()  # a worker that is lost later need not do it again
        yield key, problem


def _read_point(path: Path, point: Mapping[str, Any], problem: str = "") -> dict[str, Any]:
    """A row of the table: parameters, recorded values, and why there are none."""
    row = columns(point)
    if path.is_file() and not problem:
        notebook = json.loads(path.read_text())
        outputs = [out for cell in notebook["cells"] for out in cell.get("outputs", [])]
        errors = [f"{o['ename']}: {o['evalue']}" for o in outputs if o["output_type"] == "error"]
        if not errors:
            return row | columns(read_records(notebook).values) | row | {"problem": ""}
        problem = errors[0]
    return row | {"problem": problem or "not run"}


def _client(scheduler: str | None, workers: int) -> Any:
    from dask.distributed import Client

    if scheduler is not None:
        return Client(scheduler)
    return Client(n_workers=workers, threads_per_worker=1, dashboard_address=None, silence_logs=50)
