"""One point of a sweep, run where it is called: a notebook with other parameters."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bookkit import fingerprint
from bookkit.claims import LEDGER
from bookkit.execution import STAMP


def execute_point(
    text: str, parameters: Mapping[str, Any], files: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Run one point where this is called: on a worker. Failures are returned, not raised.

    Parameters
    ----------
    text : str
        The executed notebook.
    parameters : mapping
    files : mapping of str to str, optional
        Text of the data files that the notebook reads, by their names in the project.

    Returns
    -------
    dict
        ``notebook`` (text of the executed notebook), ``problem`` (empty when all went well) and
        ``library`` (hash of the library files that the notebook uses, as they are here).
    """
    import papermill

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    problem = ""
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
                progress_bar=False,
                cwd=str(home),
                extra_arguments=["--log-level=CRITICAL"],
            )
        except papermill.PapermillExecutionError as error:
            problem = f"{error.ename}: {error.evalue}"
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
        done = target.read_text() if target.is_file() else ""
    return {"notebook": done, "problem": problem, "library": library_of(json.loads(text))}


def _ledger(text: str) -> str:
    """The claims that the notebook decides and has brought with it."""
    stamp = json.loads(text).get("metadata", {}).get(STAMP, {})
    return json.dumps(stamp.get("claims", []))


def library_of(notebook: Mapping[str, Any]) -> str:
    """Hash of the library files that the notebook imported when it was executed."""
    return fingerprint.library_digest(
        notebook.get("metadata", {}).get("seedslib", {}).get("library")
    )
