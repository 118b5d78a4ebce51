"""How far a long piece of work has come: lines of a log, at most about one a second.

They go to the logger ``seedslib`` at level INFO, which is heard after
``logging.basicConfig(level=logging.INFO)``.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import TypeVar

LOG = logging.getLogger("seedslib")
LOG.addHandler(logging.NullHandler())

EVERY = 1.0
"""Seconds between two lines."""

Step = TypeVar("Step")


def followed(steps: Collection[Step], what: str) -> Iterator[Step]:
    """The same steps, in a loop whose progress is logged.

    Parameters
    ----------
    steps : sized iterable
    what : str
        Of what they are steps.
    """
    count, begin = len(steps), time.monotonic()
    logged = begin
    for done, step in enumerate(steps, 1):
        yield step
        now = time.monotonic()
        if done == count:
            LOG.info("%s: all %d steps in %.1f s", what, count, now - begin)
        elif now - logged >= EVERY:
            logged, left = now, (now - begin) * (count - done) / done
            LOG.info("%s: step %d of %d, about %.0f s left", what, done, count, left)


@contextmanager
def listening(wanted: bool = True) -> Iterator[None]:
    """What is logged goes to standard error inside, if that is wanted."""
    if not wanted:
        yield
        return
    handler, level = logging.StreamHandler(), LOG.level
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)
