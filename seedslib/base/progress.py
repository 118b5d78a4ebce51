"""How far a long piece of work has come: lines of a log, at most about one a second.

They go to the logger ``seedslib`` at level INFO where somebody listens, as
``logging.basicConfig(level=logging.INFO)`` does. Where nobody does, and tqdm is installed, work of
more than a second has a bar in a terminal, and nothing elsewhere.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

LOG = logging.getLogger("seedslib")
LOG.addHandler(logging.NullHandler())

EVERY = 1.0
"""Seconds between two lines."""

Step = TypeVar("Step")


def followed(steps: Any, what: str, count: int | None = None, lines: bool = True) -> Any:
    """The same steps, in a loop whose progress is logged, or a bar in a terminal.

    Parameters
    ----------
    steps : iterable
    what : str
        Of what they are steps.
    count : int, optional
        How many; as many as `steps` has by default.
    lines : bool
        Whether they are logged; a loop that logs lines of its own wants the bar only.
    """
    count = len(steps) if count is None else count
    if LOG.isEnabledFor(logging.INFO):
        return _followed(steps, what, count) if lines else steps
    if not sys.stderr.isatty():
        return steps
    try:
        from tqdm import tqdm
    except ImportError:
        return steps
    return tqdm(steps, what, count, leave=False, delay=EVERY)


def _followed(steps: Iterable[Step], what: str, count: int) -> Iterator[Step]:
    begin = logged = time.monotonic()
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
