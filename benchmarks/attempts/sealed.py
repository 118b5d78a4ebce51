"""Archives of designs taken apart and put together again, with a checksum that fits."""

from __future__ import annotations

import hashlib
import io
import json
import warnings
import zipfile
from collections.abc import Iterator

import numpy as np


def parts(content: bytes) -> tuple[dict, dict[str, bytes]]:
    """Header and members of an archive."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {entry.filename: archive.read(entry) for entry in archive.infolist()}
    members.pop("checksum.npy")
    return json.loads(array(members.pop("header.npy")).tobytes()), members


def array(content: bytes) -> np.ndarray:
    return np.load(io.BytesIO(content), allow_pickle=False)


def member(values: object, *, pickled: bool = False) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.asarray(values), (1, 0), allow_pickle=pickled)
    return buffer.getvalue()


def sealed(header: object, members: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    """Archive of these members; the checksum is theirs."""
    text = header if isinstance(header, bytes) else json.dumps(header, sort_keys=True).encode()
    whole, buffer = hashlib.sha256(), io.BytesIO()
    every = {"header.npy": member(np.frombuffer(text, np.uint8)), **members}
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "w", method) as archive:
        warnings.simplefilter("ignore")
        for name, content in every.items():
            whole.update(f"{name.removesuffix('.npy')} {len(content)} ".encode())
            whole.update(content)
            archive.writestr(name, content)
        archive.writestr("checksum.npy", member(np.frombuffer(whole.digest(), np.uint8)))
    return buffer.getvalue()


def leaves(tree: object, path: tuple = ()) -> Iterator[tuple]:
    """Paths of all places in a header, branches too."""
    yield path
    if isinstance(tree, dict | list):
        for key in tree if isinstance(tree, dict) else range(len(tree)):
            yield from leaves(tree[key], (*path, key))


def replaced(tree: object, path: tuple, value: object) -> object:
    """The tree with another value at a place."""
    if not path:
        return value
    if isinstance(tree, dict):
        return {k: replaced(v, path[1:], value) if k == path[0] else v for k, v in tree.items()}
    return [replaced(v, path[1:], value) if k == path[0] else v for k, v in enumerate(tree)]


def pickled() -> bytes:
    """An array of objects whose pickle would write a file called pwned."""

    class Trap:
        def __reduce__(self):
            return (open, ("pwned", "w"))

    return member(np.array([Trap()], dtype=object), pickled=True)
