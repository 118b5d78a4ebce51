"""Where a command writes: in a folder that exists, and over none of the files that it reads."""

from __future__ import annotations

from pathlib import Path


def as_output(path: str, **inputs: str | None) -> Path:
    """File to write, or a refusal before any work is done.

    Parameters
    ----------
    path : str
    **inputs : str or None
        Files that the command reads, by what they are.

    Raises
    ------
    ValueError
        No such folder, or a folder itself; the output is one of the inputs, by whatever name,
        link or spelling.
    """
    out = Path(path)
    if not out.parent.is_dir():
        raise ValueError(f"out: no such folder as {out.parent}")
    if out.is_dir():
        raise ValueError(f"out: wanted a file, got the folder {path}")
    for what, name in inputs.items():
        if name is not None and out.exists() and Path(name).exists() and out.samefile(name):
            raise ValueError(f"out: wanted another file than the {what} {name}, got {path}")
    return out
