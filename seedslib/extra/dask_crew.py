"""The bundles of a design on the workers of a Dask cluster; its lists are futures and stay there.

The cluster itself does again what a lost worker had, with the same numbers. Warnings of the
simulation come out on the workers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from itertools import repeat
from operator import itemgetter
from typing import Any

from seedslib.base.checks import optional
from seedslib.design.paths import Executor

with optional("cluster"):
    import distributed
    from distributed.client import ClosedClientError
    from distributed.comm import CommClosedError

PATIENCE = 30
"""Seconds for a scheduler to answer, and for a first worker to come."""

FAILURES = (CancelledError, ClosedClientError, CommClosedError, distributed.KilledWorker)
"""Errors of the cluster, not of the work."""


@contextmanager
def cluster(scheduler: str | distributed.Client) -> Iterator[Cluster]:
    """Executor for a design, the workers of a Dask cluster: ``synthesize(..., workers=executor)``.

    It is a context: ``with cluster("tcp://host:8786") as executor:``. Workers need the same
    versions of this library, NumPy and Python.

    Parameters
    ----------
    scheduler : str or distributed.Client
        Address of a scheduler, or a client, which is left open.

    Raises
    ------
    TypeError, ValueError
        Something else; no scheduler or no worker there.
    RuntimeError
        The cluster was lost on the way.
    """
    if isinstance(scheduler, distributed.Client):
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
        return distributed.Client(scheduler, timeout=PATIENCE, **options)
    except (OSError, TimeoutError, ValueError):
        raise ValueError(f"scheduler: nothing answers at {scheduler}") from None


class Remote:
    """A list whose entries are on the workers; iteration fetches them."""

    def __init__(self, client: distributed.Client, futures: list[Any]) -> None:
        self.client: Any = client
        self.futures: list[Any] = futures

    def __iter__(self) -> Iterator[Any]:
        try:
            return iter(self.client.gather(self.futures))
        except FAILURES as error:
            raise RuntimeError(f"scheduler: the cluster was lost ({error})") from error


class Cluster(Executor):
    """Map over bundles on the workers of a cluster.

    Parameters
    ----------
    client : distributed.Client
    """

    def __init__(self, client: distributed.Client) -> None:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            raise ValueError(f"scheduler: no worker came within {PATIENCE} s") from None
        self.client = client

    def __call__(self, work: Callable[..., Any], *lists: Any) -> Any:
        """Entries ``work(*entries)`` over the entries of the lists; they stay on the workers."""
        lists = tuple(part.futures if isinstance(part, Remote) else part for part in lists)
        count = next(len(part) for part in lists if not isinstance(part, repeat))
        lists = tuple(
            [next(part)] * count if isinstance(part, repeat) else list(part) for part in lists
        )
        return Remote(self.client, self.client.map(work, *lists, pure=False))

    def share(self, thing: object) -> repeat[Any]:
        """Stand-in for a list that has the same thing for every bundle, sent once."""
        # a task, since what is scattered is lost for good with the worker that has it
        return repeat(self.client.submit(_itself, thing, pure=False))

    def unzip(self, pairs: Iterable[Any]) -> list[Any]:
        """Lists of the first and of the second parts of the entries of a list."""
        return [self(itemgetter(k), pairs) for k in range(2)]


def _itself(thing: object) -> object:
    return thing
