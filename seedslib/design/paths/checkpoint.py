"""A design in progress in a file, so that a run that was stopped goes on where it was.

After each step between measurements the file is replaced as a whole: it holds what was found so
far and, for each bundle of paths, the states and what the filter remembers. Random streams follow
from the seed and are not stored. Nothing in a file is executed.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import warnings
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import seedslib
from seedslib.base.blocks import seed_record
from seedslib.base.checks import as_count
from seedslib.base.values import looked_at
from seedslib.design.paths.forward_pass import Found
from seedslib.designed.archive import read, write
from seedslib.designed.codec import KNOWN, packed, unpacked
from seedslib.designed.finite_order_rules import FiniteOrderState
from seedslib.designed.identity import model_text
from seedslib.designed.memory import Past
from seedslib.designed.shapes import check_array, check_start, check_verbs
from seedslib.models.kinds import mentioned
from seedslib.models.simulation import simulate

FORMAT = "seedslib design in progress"
TRIAL = 256
"""Paths of the small run by which a system is recognised."""


class Progress(NamedTuple):
    """What the file holds.

    Attributes
    ----------
    stop : int
        Number of the last time stopped at.
    found : Found
    alive : tuple of ndarray
        Marks of the paths that are not left out, for each bundle.
    states : tuple of ndarray
        States for each bundle; none after the last step.
    filters : tuple of FiniteOrderState
        What the next step takes of the filter's state, for each bundle.
    """

    stop: int
    found: Found
    alive: tuple[Any, ...]
    states: tuple[Any, ...]
    filters: tuple[Any, ...]


_KNOWN = KNOWN | {kind.__name__: kind for kind in (Progress, Found, FiniteOrderState, Past)}


class Checkpoint:
    """The file of a design in progress.

    Parameters
    ----------
    path : path-like
        In a folder that exists. The file is made when there is none.
    identity : dict
        What the design depends on, by name; see `identity`.

    Raises
    ------
    ValueError
        A folder that does not exist.
    """

    def __init__(self, path: str | PathLike[str], identity: Any) -> None:
        self.path: Path = Path(path)
        # as they come back from a file: lists for tuples
        self.identity: Any = json.loads(json.dumps(identity))
        if self.path.is_dir() or not self.path.parent.is_dir():
            raise ValueError(f"checkpoint: wanted a file in a folder that exists, got {path}")

    def write(self, forward: Any, last: Any) -> Any:
        """Replace the file by what a forward pass has now; after the last step without states."""
        walk, states, filters = forward.walk, (), ()
        if not last:
            states = tuple(walk.states)
            filters = tuple(
                state._replace(cov=None, loglik=0.0, before=None) for state in forward.states
            )
        now = Progress(walk.stop, forward.found, tuple(walk.alive), states, filters)
        tree, arrays = packed(now, known=_KNOWN)
        header = {"format": FORMAT, "identity": self.identity, "progress": tree}
        write(self.path, header, arrays)

    def restore(self, forward: Any) -> Any:
        """Put a forward pass where the file is; nothing happens where there is no file.

        Raises
        ------
        ValueError
            A file that is damaged or something else, or that belongs to another design; the
            message says what differs.
        """
        if not self.path.exists():
            return
        try:
            header, arrays = read(self.path, FORMAT)
            there, here = dict(header["identity"]), self.identity
            now = unpacked(header["progress"], arrays, known=_KNOWN)
            _require_progress(now)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(
                f"checkpoint: {self.path.name} is damaged or something else ({error}); remove it "
                "to begin again"
            ) from None
        names = [n for n in {**here, **there} if there.get(n) != here.get(n)]
        if "times" in names:  # the system was looked at there
            names = [name for name in names if name not in ("system", "linearization")]
        if names:
            raise ValueError(
                f"checkpoint: {self.path.name} belongs to another design, which differs in "
                + ", ".join(_apart(n, there.get(n), here.get(n)) for n in names)
                + "; remove it or give another file"
            )
        forward.walk.resume(now.stop, list(now.states), list(now.alive))
        forward.resume(now.found, list(now.filters))


def _require_progress(now):
    """Refuse what is no `Progress` throughout: the design would stop on it later."""
    found = now.found
    size, (n, _) = found.size, check_start("found.start", found.start)
    check_array("found.size", size, None)
    fits = [*found.fits, *(fit for row in found.node_fits for fit in row)]
    check_verbs([("found.fits", fit) for fit in fits], "forecast")
    if not found.scores:
        raise ValueError("found.scores: wanted some, got none")
    for time, rms, error in found.scores:
        if not isinstance(time, float | int):
            raise TypeError(f"found.scores: wanted times, got {time!r}")
        check_array("found.scores", rms, len(size), finite=False)
        check_array("found.scores", error, len(size), finite=False)
    for part in now.states:
        check_array("states", part, n, None, finite=False)
    for part in now.alive:
        if not isinstance(part, np.ndarray) or part.dtype != bool or part.ndim != 1:
            raise TypeError("alive: wanted marks")
    for part in now.filters:
        if not isinstance(part, FiniteOrderState):
            raise TypeError("filters: wanted states of a filter")
    as_count("stop", now.stop, 0)


def identity(
    system: Any, rules: Any, linearization: Any, predictor: Any, times: Any, grid: Any, paths: Any,
    root: Any, options: Any, bound: Any, held: Any, measured: Any,
) -> Any:  # fmt: skip
    """What a design depends on, by name and in a form that JSON takes.

    The system is recognised by its formulas and by a small run, bit by bit, and so are the
    moments of the sensor.
    """
    known = looked_at(mentioned(system))
    with warnings.catch_warnings(), np.errstate(all="ignore"), known:
        warnings.simplefilter("ignore")  # the design itself will warn
        trial = simulate(system, times[:3], TRIAL, 0)
        moments = rules.sensor(times[0], trial.states[0], system.cov0)
        rates = [
            system.intensity(times[0], x) for x in trial.states if hasattr(system, "intensity")
        ]
    text = np.frombuffer(json.dumps(model_text(system)).encode(), dtype=np.uint8)
    law = system.mean0, system.cov0
    entropy, spawn_key = seed_record(root)
    return {
        "system": _digest(text, trial.states, trial.measurements, *rates, *law),
        "linearization": [type(linearization).__name__, _digest(*moments)],
        "memory": dataclasses.asdict(rules.memory),
        "predictor": [type(predictor).__name__, dataclasses.asdict(predictor)],
        "times": times.tolist(),
        "nodes": [nodes.tolist() for nodes in grid],
        "components": rules.components,
        "measured_nodes": rules.measured_nodes,
        "paths": paths,
        "seed": entropy,
        "spawn_key": list(spawn_key),
        "options": options,
        "bound": bound,
        "measured": measured.tolist(),
        "version of seedslib": seedslib.__version__,
        "version of NumPy": np.__version__,
        **{f"input {u}": _digest(values) for u, values in held.values.items()},
    }


def _digest(*arrays) -> str:
    whole = hashlib.sha256()
    for array in arrays:
        whole.update(np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()


def _apart(name, there, here):
    """A name, with the values where they are short."""
    if max(len(str(there)), len(str(here))) > 30:
        return name
    return f"{name} ({there} there, {here} here)"
