"""What a result depends on, as one hash: notebook, lock file, library files, data files."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path

import seedslib

PACKAGES = {
    "seedslib": Path(seedslib.__file__).parent,
    "bookkit": Path(__file__).parent,
}
"""The library and this harness: what a notebook was made with."""

LOCK = "requirements.lock"


def project_root(start: Path) -> Path:
    """Nearest folder at or above `start` that holds the lock file.

    Raises
    ------
    ValueError
        There is none.
    """
    start = start.resolve()
    for folder in (start, *start.parents):
        if (folder / LOCK).is_file():
            return folder
    raise ValueError(f"no {LOCK} at or above {start}: run this inside the project")


def library_files() -> list[str]:
    """All Python files of the library and of the harness, as ``package/file``, in order."""
    return sorted(
        f"{name}/{path.relative_to(folder).as_posix()}"
        for name, folder in PACKAGES.items()
        for path in folder.rglob("*.py")
    )


def library_contents() -> dict[str, bytes | None]:
    """All Python files of the library with what is in them now."""
    return {name: _library_content(name) for name in library_files()}


def library_digest(
    files: Iterable[str] | None = None, contents: Mapping[str, bytes | None] | None = None
) -> str:
    """Hash of the given library files (all by default); a missing one changes the hash.

    With `contents` it is the hash of what stood in them when `library_contents` read them.
    """
    files = library_files() if files is None else sorted(files)
    if contents is not None:
        return digest(*((name, contents.get(name)) for name in files))
    return digest(*((name, _library_content(name)) for name in files))


def file_digest(root: Path, names: Iterable[str]) -> str:
    """Hash of files given relative to `root`; a missing one changes the hash."""
    return digest(*((name, _content(root / name)) for name in sorted(names)))


def digest(*parts: object) -> str:
    """Short hash of the parts' representation."""
    state = hashlib.sha256()
    for part in parts:
        state.update(repr(part).encode())
        state.update(b"\0")
    return state.hexdigest()[:24]


def _library_content(name: str) -> bytes | None:
    package, _, rest = name.partition("/")
    return _content(PACKAGES[package] / rest) if package in PACKAGES else None


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() else None
