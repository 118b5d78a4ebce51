"""Files of designs and of designs in progress: damaged, edited, resealed, hostile."""

from __future__ import annotations

import io
import json
import warnings
import zipfile
from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from attempts.judge import Attempt, equal, flagged, sane
from attempts.sealed import array, leaves, member, parts, pickled, replaced, sealed
from attempts.targets import TIMES, Y, discrete, switching
from seedslib import zoo
from seedslib.design import Polynomial, grid_synthesis, minimax_synthesis, synthesize
from seedslib.designed import Memory, load, save
from seedslib.linearization import GaussHermite, Taylor

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


class Kind:
    """A design, its file and what it is run on."""

    def __init__(self, filter, system, record):
        self.filter, self.system, self.record = filter, system, record
        save(filter, "made.npz")
        self.content = Path("made.npz").read_bytes()
        Path("made.npz").unlink()
        self.right = self.run(filter)

    def run(self, filter):
        return filter.run(self.filter.times, self.record)

    def read(self, content: bytes | Callable[[], bytes]):
        """Run a filter that was read from a file."""
        Path("f.npz").write_bytes(content() if callable(content) else content)
        try:
            found = self.run(load("f.npz", self.system))
        finally:
            if Path("pwned").exists():
                raise RuntimeError("a file was executed")
        return found


def _plain(**options):
    return Kind(
        synthesize(discrete(), Memory(1), Taylor(), TIMES, paths=300, seed=1, **options),
        discrete(),
        Y,
    )


def _waits():
    system, times = zoo.linear_gaussian(), TIMES[:3]
    made = synthesize(
        system,
        Memory(2),
        GaussHermite(3),
        times,
        paths=300,
        seed=1,
        nodes=1,
        predictor=Polynomial(2, 1),
    )
    return Kind(made, system, Y[:3])


def _modes():
    made = synthesize(switching(), Memory(1), Taylor(), TIMES, paths=400, seed=1)
    return Kind(made, switching(), Y)


def _table():
    axes = {"x": (-6, 6, 25), "z": (-6, 6, 9), "y": (-14, 14, 29)}
    made = grid_synthesis(zoo.scalar_switching(), Memory(1, log_odds=False), TIMES[:2], **axes)
    return Kind(made, None, Y[:2])


def _minimax():
    made = minimax_synthesis(discrete(), Memory(1), TIMES[:3], paths=300, seed=1)
    return Kind(made, discrete(), Y[:3])


KINDS = {
    "plain": _plain,
    "with nodes": _waits,
    "modes": _modes,
    "table": _table,
    "minimax": _minimax,
}


@cache
def kind(name: str) -> Kind:
    return KINDS[name]()


def attempts(names: tuple[str, ...] = tuple(KINDS)) -> list[Attempt]:
    """All of them, or those of some kinds of files; designs in progress always."""
    found = []
    for name in names:
        made = kind(name)
        unharmed = partial(lambda made, value: equal(value, made.right), made)
        for what, content in spoiled(made.content):
            found.append(Attempt(f"{name}: {what}", partial(made.read, content), unharmed))
        for what, content in altered(made.content):
            found.append(Attempt(f"{name}, sealed: {what}", partial(made.read, content), harmless))
        for what, content in hostile(made.content):
            found.append(Attempt(f"{name}, hostile: {what}", partial(made.read, content)))
    return found + progress()


def harmless(value: object) -> bool:
    """Another design, which somebody wrote: sane numbers, or a filter that says it diverges."""
    return sane(value) or flagged(value)


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
        yield f"without {name}", partial(sealed, header, {k: v for k, v in members.items() if k != name})
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


# Designs in progress


def _begun(content: bytes | Callable[[], bytes] | None = None) -> object:
    """The design with a file of itself in progress; with None that file."""
    path = Path("p.npz")
    path.unlink(missing_ok=True)
    if content is not None:
        path.write_bytes(content() if callable(content) else content)
    made = synthesize(
        discrete(), Memory(1), Taylor(), TIMES, paths=300, seed=1, nodes=0, checkpoint=path
    )
    if Path("pwned").exists():
        raise RuntimeError("a file was executed")
    return path.read_bytes() if content is None else (made.start, made.fits)


def progress() -> list[Attempt]:
    content = _begun()
    Path("p.npz").unlink()
    wanted = _begun(content)
    Path("p.npz").unlink()
    same: Callable[[object], bool] = partial(equal, wanted)
    found = [
        Attempt(f"progress: {what}", partial(_begun, spoilt), same)
        for what, spoilt in spoiled(content)
        if spoilt
    ]
    header, members = parts(content)
    for path in leaves(header["progress"], ("progress",)):
        for value in VALUES:
            spoilt = partial(sealed, replaced(header, path, value), members)
            found.append(
                Attempt(
                    f"progress, sealed: {'/'.join(map(str, path))} = {value!r}"[:90],
                    partial(_begun, spoilt),
                    is_design,
                )
            )
    for path in leaves(header["identity"], ("identity",)):
        for value in VALUES[:4]:
            spoilt = partial(sealed, replaced(header, path, value), members)
            found.append(
                Attempt(
                    f"progress of another: {'/'.join(map(str, path))} = {value!r}"[:90],
                    partial(_begun, spoilt),
                    same,
                )
            )
    for name, given in members.items():
        for what, other in arrays(array(given)):
            spoilt = partial(sealed, header, members | {name: other})
            found.append(
                Attempt(f"progress, sealed: {name} {what}", partial(_begun, spoilt), is_design)
            )
    return found


def is_design(value: object) -> bool:
    """What somebody who makes checksums wrote: a design of finite numbers."""
    return sane(value)
