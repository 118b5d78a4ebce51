"""The bundles of a design on the workers of a Dask cluster.

Neighbouring bundles make a share, one for each thread of the cluster. What belongs to a share
stays on the worker that made it; only partial moments come back. Work is collected until a
result is looked at and then goes out as one task for each share, a function of its arguments:
the cluster itself does again what a lost worker had, with the same numbers.

Warnings of the simulation come out on the workers.
"""

from __future__ import annotations

import ctypes
import platform
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import cache
from itertools import chain, count, pairwise, repeat
from operator import itemgetter
from typing import Any

import cloudpickle
import distributed
import numpy as np
from distributed.client import ClosedClientError
from distributed.comm import CommClosedError

import seedslib
from seedslib.base.values import carried
from seedslib.design.paths.walk import Crew

PATIENCE = 30
"""Seconds without any worker before a design gives up."""

CONNECT = 30
"""Seconds for a scheduler to answer: on a busy machine it takes its time."""

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Names of settings in the header malloc.h of glibc."""

LOST = (CancelledError, ClosedClientError, CommClosedError, distributed.KilledWorker)


@contextmanager
def cluster(scheduler: str | distributed.Client) -> Iterator[Cluster]:
    """Crew for a design, the workers of a Dask cluster: ``synthesize(..., workers=crew)``.

    It is a context: ``with cluster("tcp://host:8786") as crew:``. Workers need the same versions
    of this library, NumPy and Python.

    Parameters
    ----------
    scheduler : str or distributed.Client
        Address of a scheduler, or a client, which is left open.

    Raises
    ------
    TypeError, ValueError
        Something else; no scheduler or no worker there.
    RuntimeError
        The cluster was lost on the way, or a worker has other versions of the libraries.
    """
    if isinstance(scheduler, distributed.Client):
        if scheduler.asynchronous:
            raise TypeError("scheduler: wanted a client that is not asynchronous")
        yield Cluster(scheduler)
        return
    if not isinstance(scheduler, str):
        raise TypeError(f"scheduler: wanted an address or a distributed.Client, got {scheduler!r}")
    with connect(scheduler, set_as_default=False) as client:
        yield Cluster(client)


def connect(scheduler: str, **options: Any) -> distributed.Client:
    """A client of the scheduler at an address.

    Raises
    ------
    ValueError
        Nothing answers there.
    """
    try:
        return distributed.Client(scheduler, timeout=CONNECT, **options)
    except (OSError, TimeoutError, ValueError):
        raise ValueError(f"scheduler: nothing answers at {scheduler}") from None


class Cluster(Crew):
    """Map over bundles on the workers of a cluster; its lists stay there.

    Parameters
    ----------
    client : distributed.Client
    """

    def __init__(self, client: distributed.Client) -> None:
        self.client = client
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            raise ValueError(f"scheduler: no worker came within {PATIENCE} s") from None
        self._shares = sum(client.nthreads().values())
        self._names, self._known = count(), weakref.WeakSet()
        self._forget()

    def _forget(self) -> None:
        """Begin anew: what a design that failed has left behind must not fail the next one."""
        self._memories = [{}] * self._shares
        self._steps, self._sent = [], []

    def __call__(self, work: Callable[..., Any], *lists: Iterable[Any]) -> Remote:
        """Entries ``work(*entries)`` over the entries of the lists; they stay on the workers."""
        return self._noted(carried(work), lists)

    def share(self, thing: object) -> Remote:
        """Stand-in for a list that has the same thing for every bundle, sent once."""
        return self._noted(None, [_Same(thing)])

    def unzip(self, pairs: Remote) -> list[Any]:
        """Lists of the first and of the second parts of the entries of a list."""
        return [self(itemgetter(k), pairs) for k in range(2)]

    def fetch(self, name: int) -> list[Any]:
        """Entries of a list by its name, in the order of the bundles."""
        try:
            if self._steps:
                self._send()
            tasks = self._each_share(_entries, repeat(name))
            return list(chain.from_iterable(map(self._awaited, tasks)))
        except Exception as error:
            self._forget()
            if not isinstance(error, LOST):
                raise
            raise RuntimeError(
                f"scheduler: the cluster was lost ({error}); with a checkpoint the same call "
                "goes on from the last finished step"
            ) from error

    def _noted(self, work: Callable | None, lists: Sequence) -> Remote:
        """Note a step; the list it makes is kept for as long as somebody has it here."""
        names = []
        for part in lists:
            names.append(part.name if isinstance(part, Remote) else next(self._names))
            if not isinstance(part, Remote):
                self._sent.append((names[-1], self._cut(part)))
        remote = Remote(self, next(self._names))
        self._steps.append((remote.name, work, names))
        self._known.add(remote)
        return remote

    def _cut(self, entries: Sequence) -> list:
        """Pieces of a list for the shares."""
        shares = len(self._memories)
        if isinstance(entries, _Same):
            return [entries] * shares
        ends = np.linspace(0, len(entries), shares + 1).astype(int)
        return [entries[a:b] for a, b in pairwise(ends)]

    def _send(self) -> None:
        """One task for each share that does all steps since the last one."""
        kept = {remote.name for remote in self._known}
        program = cloudpickle.dumps((_versions(), self._steps, kept))
        lists = [
            _Sealed({name: pieces[i] for name, pieces in self._sent})
            for i in range(len(self._memories))
        ]
        self._memories = self._each_share(_run, repeat(program), lists)
        self._steps, self._sent = [], []

    def _each_share(self, function: Callable, *arguments: Iterable) -> list[distributed.Future]:
        with warnings.catch_warnings():
            # a design that goes on from a file sends its states once: they are no accident
            warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
            return [
                self.client.submit(function, *given, pure=False)
                for given in zip(*arguments, self._memories, strict=False)
            ]

    def _awaited(self, task: distributed.Future) -> object:
        """Result of a task, or an error where nobody is left to do it."""
        while True:
            try:
                return task.result(timeout=PATIENCE)
            except TimeoutError:
                if task.done():
                    raise
                if not self.client.scheduler_info()["workers"]:
                    raise CommClosedError("no workers are left") from None


class Remote:
    """A list with an entry for each bundle that stays on the workers; iteration fetches it."""

    def __init__(self, cluster: Cluster, name: int) -> None:
        self.cluster: Any = cluster
        self.name: int = name

    def __iter__(self) -> Iterator[Any]:
        return iter(self.cluster.fetch(self.name))


class _Same:
    """The same thing for every bundle."""

    def __init__(self, thing: object) -> None:
        self.thing = thing

    def __iter__(self) -> Iterator[Any]:
        return repeat(self.thing)


class _Sealed:
    """Lists that the cluster does not look into."""

    def __init__(self, lists: dict) -> None:
        self.lists = lists


def _versions() -> tuple[str, str, str]:
    return seedslib.__version__, np.__version__, platform.python_version()


@cache
def _keep_freed_memory() -> None:
    """Let the arrays of a bundle come from memory that this process has already.

    Dask starts workers so that they give every larger array back to the system; the page faults
    of taking it again would be most of the time. The figures are those that glibc itself goes up
    to where nobody has set them.
    """
    if platform.libc_ver()[0] == "glibc":
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_MMAP_THRESHOLD, 2**25)
        mallopt(M_TRIM_THRESHOLD, 2**26)


def _run(program: bytes, sealed: _Sealed, memory: dict) -> dict:
    """The lists of a share by their names after the steps of a program, on a worker."""
    _keep_freed_memory()
    versions, steps, kept = cloudpickle.loads(program)
    if versions != _versions():
        raise RuntimeError(
            f"scheduler: a worker has seedslib, NumPy and Python {', '.join(_versions())}, "
            f"wanted {', '.join(versions)}"
        )
    memory = memory | sealed.lists
    for name, work, given in steps:
        lists = [memory[part] for part in given]
        memory[name] = lists[0] if work is None else list(map(work, *lists))
    return {name: part for name, part in memory.items() if name in kept}


def _entries(name: int, memory: dict) -> list:
    return memory[name]
