"""Files of designs and of designs in progress: damaged, edited, resealed, hostile."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

from attempts.judge import Attempt, equal, flagged, sane
from attempts.sealed import (
    VALUES,
    altered,
    array,
    arrays,
    hostile,
    leaves,
    parts,
    replaced,
    sealed,
    spoiled,
)
from attempts.targets import TIMES, Y, discrete, switching
from seedslib import zoo
from seedslib.design import Polynomial, grid_synthesis, minimax_synthesis, synthesize
from seedslib.designed import Memory, load, save
from seedslib.linearization import GaussHermite, Taylor


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
