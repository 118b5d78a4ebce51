"""The container of a design: an ``.npz`` archive of plain arrays with a JSON header and a checksum.

Nothing in it is executed or taken for a formula. Equal contents give equal bytes.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
import zlib
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

import seedslib
from seedslib.base.atomic import replacing

FORMAT = "seedslib designed filter"
VERSION = 3
DAMAGE = (
    zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError,
    NotImplementedError, KeyError, MemoryError, OverflowError,
)  # fmt: skip
"""What reading an archive raises that is damaged."""


def write(path: str | PathLike[str], header: dict[Any, Any], arrays: dict[str, np.ndarray]) -> None:
    """Write a header and arrays of numbers, in the place of an old file when all is there."""
    versions = {"seedslib": seedslib.__version__, "numpy": np.__version__}
    header = {"format": FORMAT, "version": VERSION, "versions": versions, **header}
    text = json.dumps(header, sort_keys=True).encode()
    whole = hashlib.sha256()
    with replacing(path) as file, zipfile.ZipFile(file, "w") as archive:
        for name, array in {"header": np.frombuffer(text, dtype=np.uint8), **arrays}.items():
            _write(archive, name, np.asarray(array), whole)
        _write(archive, "checksum", np.frombuffer(whole.digest(), dtype=np.uint8), whole)


def _write(archive, name, array, whole):
    """One array, neither compressed nor dated: both would make the bytes depend on the machine."""
    array = array.astype(array.dtype.newbyteorder("<"), copy=False)
    head = _head(array.dtype.str, array.shape, np.isfortran(array))
    content = head + array.tobytes(order="A")
    entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
    entry.external_attr, entry.create_system = 0, 3
    archive.writestr(entry, content)
    _count_in(whole, name, content)


@lru_cache(maxsize=1024)
def _head(kind: str, shape: tuple, turned: bool) -> bytes:
    """What an ``.npy`` file of version 1.0 begins with."""
    buffer = io.BytesIO()
    form = {"descr": kind, "fortran_order": turned, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, form)
    return buffer.getvalue()


def _count_in(whole, name, content):
    whole.update(f"{name} {len(content)} ".encode())
    whole.update(content)


def read(path: Path, wanted: str = FORMAT) -> tuple[dict[Any, Any], dict[str, np.ndarray]]:
    """Header and arrays of a file.

    Parameters
    ----------
    path : Path
    wanted : str
        What the header says that it is.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        A file that is damaged or cut short, that holds something else, or that was written by
        another version; the message says which.
    """
    arrays, whole, size = {}, hashlib.sha256(), path.stat().st_size
    with path.open("rb") as file:
        if file.read(2) != b"PK":
            raise ValueError(f"{path.name}: not a designed filter (not an npz file)")
        try:
            with zipfile.ZipFile(file) as archive:
                # members are not compressed: together they are smaller than the file
                if (total := sum(entry.file_size for entry in archive.infolist())) > size:
                    raise ValueError(f"{total} bytes in a file of {size}")
                for entry in archive.infolist():
                    name, content = entry.filename.removesuffix(".npy"), archive.read(entry)
                    if name in arrays:
                        raise ValueError(f"two members called {name}")
                    arrays[name] = _array(content)
                    if name != "checksum":
                        _count_in(whole, name, content)
        except DAMAGE as error:
            raise ValueError(f"{path.name}: damaged or cut short ({error})") from None
    header, checksum = arrays.pop("header", None), arrays.pop("checksum", None)
    try:
        header = json.loads(header.tobytes().decode())
        stated = header["format"]
    except (AttributeError, ValueError, TypeError, KeyError, RecursionError):
        raise ValueError(f"{path.name}: not a designed filter (no header of one)") from None
    if stated != wanted:
        raise ValueError(f"{path.name}: not a {wanted} (it says {stated!r})")
    version = header.get("version")
    if version != VERSION:
        newer = isinstance(version, int) and version > VERSION
        raise ValueError(
            f"{path.name}: wanted version {VERSION} of the format, got {version!r}"
            + (" of a newer seedslib" if newer else "")
        )
    if checksum is None or checksum.tobytes() != whole.digest():
        raise ValueError(f"{path.name}: damaged or altered (its checksum is not that of its parts)")
    return header, arrays


def _array(content: bytes) -> np.ndarray:
    """Array of numbers in the content of an ``.npy`` file of version 1.0."""
    start = 10 + int.from_bytes(content[8:10], "little")
    if content[:8] != b"\x93NUMPY\x01\x00" or len(content) < start:
        raise ValueError("no array of version 1.0")
    shape, turned, dtype = _form(content[8:start])
    if dtype.kind not in "biuf" or math.prod(shape) * dtype.itemsize != len(content) - start:
        raise ValueError(f"{len(content) - start} bytes for shape {shape} of {dtype}")
    found = np.frombuffer(content, dtype, offset=start)
    return found.reshape(shape, order="F" if turned else "C").copy(order="K")


@lru_cache(maxsize=1024)
def _form(text: bytes) -> tuple:
    """Shape, order and kind of an array; members of one shape say it with the same words."""
    return np.lib.format.read_array_header_1_0(io.BytesIO(text))
