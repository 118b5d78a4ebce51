"""Archives of designs: damaged bytes, and parts that were changed under a checksum that fits."""

from __future__ import annotations

import hashlib
import io
import json
import warnings
import zipfile
from collections.abc import Iterator
from functools import partial
from itertools import pairwise

import numpy as np

SEED = 20260723
BYTES = 240
"""Flips, regions and cuts of each file."""
VALUES = (
    None,
    True,
    -1,
    0,
    2,
    7,
    10**9,
    10**30,
    0.5,
    float("inf"),
    float("-inf"),
    float("nan"),
    "",
    "x",
    "1",
    "__import__('os').system('touch pwned')",
    "os.system",
    [],
    {},
    [1.0],
    {"class": "x"},
    {"class": "array"},
    {"class": "list", "parts": []},
    {"class": "Memory", "estimates": 1},
    {"class": "type"},
    {"class": None},
    {"class": "Taylor"},
    {"class": "Moments"},
)
"""What is put in each place of a header."""


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


def spoiled(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Bytes that were changed: nothing else than the design itself may come out."""
    rng = np.random.default_rng(SEED)
    size = len(content)
    for k in range(BYTES):
        where, bit = int(rng.integers(size)), 1 << int(rng.integers(8))
        yield f"bit {k}", content[:where] + bytes([content[where] ^ bit]) + content[where + 1 :]
    for k in range(BYTES // 3):
        where, long = int(rng.integers(size)), int(rng.integers(1, 200))
        noise = rng.bytes(long)
        yield f"region {k}", content[:where] + noise + content[where + long :]
        yield f"zeros {k}", content[:where] + bytes(long) + content[where + long :]
        yield f"cut {k}", content[:where]
        yield f"left out {k}", content[:where] + content[where + long :]
        yield f"put in {k}", content[:where] + noise + content[where:]
    for k in range(40):
        yield f"header of the file {k}", content[:k] + bytes([content[k] ^ 255]) + content[k + 1 :]
        yield (
            f"end of the file {k}",
            content[: size - k - 1] + bytes([content[-k - 1] ^ 255]) + content[size - k :],
        )
    yield from {
        "nothing": b"",
        "PK": b"PK",
        "twice": content + content,
        "text": b"t,y1\n0,1\n",
        "after words": b"PK words" + content,
        "reversed": content[::-1],
    }.items()


def altered(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Headers and arrays that were changed by somebody who makes a new checksum."""
    header, members = parts(content)
    for path in leaves(header):
        for value in VALUES:
            yield (
                f"{'/'.join(map(str, path))} = {value!r}"[:90],
                partial(sealed, replaced(header, path, value), members),
            )
    for name, given in members.items():
        for what, other in arrays(array(given)):
            yield f"{name} {what}", partial(sealed, header, members | {name: other})
        yield (
            f"without {name}",
            partial(sealed, header, {k: v for k, v in members.items() if k != name}),
        )
    names = list(members)
    for one, other in pairwise(names):
        yield (
            f"{one} and {other} swapped",
            partial(sealed, header, members | {one: members[other], other: members[one]}),
        )


def arrays(given: np.ndarray) -> Iterator[tuple[str, bytes]]:
    values = given.astype(float) if given.dtype.kind in "iub" else given
    with np.errstate(all="ignore"):
        changed = {
            "negated": -values,
            "zeros": 0 * values,
            "1e300": values * 0 + 1e300,
            "NaN": values * np.nan,
            "inf": values + np.inf,
            "huge": values * 1e60,
            "tiny": values * 1e-60,
            "single": values.astype("f4"),
            "integers": values.astype(int),
            "bools": values.astype(bool),
            "flat": values.ravel(),
            "one axis more": values[None],
            "turned": values.T,
            "doubled": np.concatenate([values.ravel()] * 2),
            "none": values.ravel()[:0],
            "complex": values + 0j,
            "text": values.astype(str),
            "one number": np.float64(1.0),
            "half": values.ravel()[: values.size // 2],
            "columns first": np.asfortranarray(values),
            "dates": values.astype(int).astype("M8[s]"),
        }
    for what, other in changed.items():
        yield what, member(other)
    yield "objects", pickled()


def hostile(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Small files that ask for much, say a thing twice, or carry what is not theirs."""
    header, members = parts(content)
    deep = b"[" * 100_000
    yield "header nested 100000 deep", sealed(deep, members)
    yield "header of nested lists", sealed(deep + b"]" * 100_000, members)
    yield "header of no text", sealed(b"\xff\xfe", members)
    yield (
        "long number",
        sealed(json.dumps(header).encode()[:-1] + b', "x": ' + b"9" * 100_000 + b"}", members),
    )
    yield "pickle", sealed(header, members | {"extra.npy": pickled()})
    yield "pickle alone", b"PK" + pickled()
    for count, size in ((400, 10**7), (20, 10**8), (2000, 10**6)):
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
            shown = bytes(size)
            for k in range(min(count, 3 * 10**7 // size)):
                archive.writestr(f"{k}.npy", shown)
        yield f"bomb of {count} members", buffer.getvalue()
    for method, name in (
        (zipfile.ZIP_DEFLATED, "deflated"),
        (zipfile.ZIP_BZIP2, "bzip2"),
        (zipfile.ZIP_LZMA, "lzma"),
    ):
        big = dict(members) | {"big.npy": member(np.zeros(10**6))}
        yield f"{name}, with zeros", sealed(header, big, method)
    for shape in (
        "(100000000000000000000,)",
        "(-1,)",
        "(1e9,)",
        "(10**9,)",
        "__import__('os')",
        "(9999999999, 9999999999)",
    ):
        text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode()
        text += b" " * (117 - len(text)) + b"\n"
        first = next(iter(members))
        odd = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text
        yield f"shape {shape}", sealed(header, members | {first: odd})
    for where in (
        "../../evil.npy",
        "/tmp/evil.npy",
        "C:\\evil.npy",
        "a/../../evil.npy",
        "a\x00b.npy",
        "header",
    ):
        yield f"member {where!r}", _more(content, where)
    for name in (*members, "header.npy", "checksum.npy"):
        yield f"two called {name}", _more(content, name)


def _more(content: bytes, name: str) -> bytes:
    """One more member, which the checksum does not know."""
    buffer = io.BytesIO(content)
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "a") as archive:
        warnings.simplefilter("ignore")
        archive.writestr(name, member([1.0]))
    return buffer.getvalue()
