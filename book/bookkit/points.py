"""One point of a sweep, run where it is called: a notebook with other parameters."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from bookkit import fingerprint
from bookkit.claims import LEDGER
from bookkit.execution import STAMP
from bookkit.limits import Held, Limits, Over


def execute_point(
    text: str,
    parameters: Mapping[str, Any],
    files: Mapping[str, str] | None = None,
    limits: Limits | None = None,
) -> dict[str, Any]:
    """Run one point where this is called: on a worker. Failures are returned, not raised.

    Parameters
    ----------
    text : str
        The executed notebook.
    parameters : mapping
    files : mapping of str to str, optional
        Text of the data files that the notebook reads, by their names in the project.
    limits : Limits, optional
        What the point may take.

    Returns
    -------
    dict
        ``notebook`` (text of the executed notebook), ``problem`` (empty when all went well) and
        ``library`` (hash of the library files that the notebook uses, as they are here).
    """
    import papermill

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Dask tells its workers to give memory back at once: every array would be faulted in again.
    os.environ.pop("MALLOC_TRIM_THRESHOLD_", None)
    limits, problem = limits or Limits(), ""
    papermill.engines.papermill_engines.register("held", _engine())
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder, "notebooks")
        home.mkdir()
        source, target = home / "in.ipynb", home / "out.ipynb"
        source.write_text(text)
        for name, content in {**(files or {}), LEDGER: _ledger(text)}.items():
            path = Path(folder, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content)
        try:
            papermill.execute_notebook(
                str(source),
                str(target),
                parameters=dict(parameters),
                kernel_name="python3",
                engine_name="held",
                limits=limits,
                progress_bar=False,
                cwd=str(home),
                extra_arguments=["--log-level=CRITICAL"],
            )
        except papermill.PapermillExecutionError as error:
            problem = f"{error.ename}: {error.evalue}"
            if error.ename == "MemoryError":
                problem += f" (a point may take {limits.memory:g} GB)"
        except Over as error:
            problem = f"{error}, which is the limit of a point"
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
        done = target.read_text() if target.is_file() else ""
    return {"notebook": done, "problem": problem, "library": library_of(json.loads(text))}


@cache
def _engine() -> type:
    """What papermill is to run notebooks with: its own engine, kept to limits."""
    from papermill.clientwrap import PapermillNotebookClient
    from papermill.engines import NBClientEngine

    class Client(Held, PapermillNotebookClient):
        pass

    class Engine(NBClientEngine):
        @classmethod
        def execute_managed_notebook(cls, nb_man: Any, kernel_name: str, **options: Any) -> Any:
            chosen = {name: options[name] for name in ("limits", "extra_arguments")}
            timeout = options["start_timeout"]
            client = Client(nb_man, kernel_name=kernel_name, startup_timeout=timeout, **chosen)
            return client.execute()

    return Engine


def _ledger(text: str) -> str:
    """The claims that the notebook decides and has brought with it."""
    stamp = json.loads(text).get("metadata", {}).get(STAMP, {})
    return json.dumps(stamp.get("claims", []))


def library_of(notebook: Mapping[str, Any]) -> str:
    """Hash of the library files that the notebook imported when it was executed."""
    return fingerprint.library_digest(
        notebook.get("metadata", {}).get("seedslib", {}).get("library")
    )
