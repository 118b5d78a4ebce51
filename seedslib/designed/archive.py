"""The container of a designed filter: an ``.npz`` archive of plain arrays with a JSON header.

Nothing in it is executed or taken for a formula. Equal contents give equal bytes.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from pathlib import Path

import numpy as np

from seedslib.base.atomic import write_whole

FORMAT = "seedslib designed filter"
VERSION = 2


def write(path, header: dict, arrays: dict) -> None:
    """Write a header and arrays of numbers, in the place of an old file when all is there."""
    whole = io.BytesIO()
    header = {"format": FORMAT, "version": VERSION, **header}
    with zipfile.ZipFile(whole, "w") as archive:
        text = json.dumps(header, sort_keys=True, indent=1).encode()
        _write(archive, "header", np.frombuffer(text, dtype=np.uint8))
        for name, array in arrays.items():
            _write(archive, name, np.asarray(array, dtype="<f8", order="C"))
    write_whole(path, whole.getvalue())


def _write(archive, name, array):
    """One array, neither compressed nor dated: both would make the bytes depend on the machine."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, version=(1, 0), allow_pickle=False)
    entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
    entry.external_attr, entry.create_system = 0, 3
    archive.writestr(entry, buffer.getvalue())


def read(path: Path, kinds) -> tuple[dict, dict]:
    """Arrays and header of a file.

    Parameters
    ----------
    path : Path
    kinds : collection of str
        Kinds of filters that are known.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        A file that is damaged or cut short, that holds something else, or that was written by
        another version; the message says which.
    """
    content = path.read_bytes()
    if content[:2] != b"PK":
        raise ValueError(f"{path.name}: not a designed filter (not an npz file)")
    try:
        arrays = {}
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            # members are not compressed: together they are smaller than the file
            size = sum(entry.file_size for entry in archive.infolist())
            if size > len(content):
                raise ValueError(f"{size} bytes in a file of {len(content)}")
            for entry in archive.infolist():
                name = entry.filename.removesuffix(".npy")
                if name in arrays:
                    raise ValueError(f"two members called {name}")
                buffer = io.BytesIO(archive.read(entry))
                arrays[name] = np.lib.format.read_array(buffer, allow_pickle=False)
    except (
        zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError,
        NotImplementedError, KeyError, MemoryError, UnicodeDecodeError, OverflowError,
    ) as error:  # fmt: skip
        raise ValueError(f"{path.name}: damaged or cut short ({error})") from None
    header = arrays.pop("header", None)
    try:
        header = json.loads(header.tobytes().decode())
        stated = header["format"]
    except (AttributeError, ValueError, TypeError, KeyError, RecursionError):
        raise ValueError(f"{path.name}: not a designed filter (no header of one)") from None
    if stated != FORMAT or header.get("kind") not in kinds:
        raise ValueError(
            f"{path.name}: not a finite-order filter (it says {stated!r}, {header.get('kind')!r})"
        )
    version = header.get("version")
    if version != VERSION:
        newer = isinstance(version, int) and version > VERSION
        raise ValueError(
            f"{path.name}: wanted version {VERSION} of the format, got {version!r}"
            + (" of a newer seedslib" if newer else "")
        )
    return arrays, header
