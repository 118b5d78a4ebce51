"""What was chosen for a design, in words, and in what the choices of two designs differ."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.base.clock import Clock
from seedslib.designed.identity import difference, model_text, probe, probe_points
from seedslib.designed.prediction import ROWS
from seedslib.models.kinds import UnknownModel


class Change(NamedTuple):
    """A choice that differs: its name, and what it is in the first and in the second design."""

    name: str
    first: str
    second: str


CHOICES = {
    "memory": "memory", "forecast": "predictor", "functions": "made",
    "linearization": "linearization", "components": "components",
    "measured nodes": "measured_nodes", "between": "between", "later steps": "cycle",
    "normalisation": "normalisation",
}  # fmt: skip
"""What is chosen for a design, and where the filter has it."""


def choices(designed: Any) -> dict[str, str]:
    """What was chosen for a design, in words that are equal where the choices are."""
    found = {"kind": type(designed).__name__}
    for name, field in CHOICES.items():
        if hasattr(designed, field):
            found[name] = _named(getattr(designed, field))
    if getattr(designed, "split", False) and not designed.system.indicator_is_blind:
        found["normalisation"] += ", split forecast"
    found["measurement times"] = _grid(designed.times)
    if hasattr(designed, "node_times"):
        found["nodes"] = _grid(np.concatenate([*designed.node_times, np.empty(0)]))
    if designed.measured is not None:
        found["schedule"] = _mask(designed.measured)
    if designed.availability is not None:
        found["availability"] = ", ".join(f"{rate:g}" for rate in designed.availability)
    found["designed on"] = _source(designed.design)
    return found


def _source(made) -> str:
    """What a filter was designed on."""
    if made is None:
        return "unknown"
    if getattr(made, "exact", False):
        return "exact"
    stream = f", stream {made.spawn_key}" if made.spawn_key else ""
    return f"{made.paths} paths of seed {made.entropy}{stream}"


def _named(thing):
    """A choice in words; a linearization of one's own may have none but its name."""
    if isinstance(thing, bool):
        return "yes" if thing else "no"
    plain = type(thing).__repr__ is object.__repr__
    return type(thing).__name__ if plain else str(thing)


def _grid(times):
    """Times in words: spelled out where they are few or uneven."""
    if len(times) <= 1:
        return ", ".join(f"{t:.12g}" for t in times) or "none"
    steps = np.diff(times)
    even = np.ptp(steps) <= Clock(times).tolerance
    if even or len(times) > ROWS:
        by = f"by {steps[0]:.9g}" if even else f"unevenly, sum {times.sum():.12g}"
        return f"{len(times)} from {times[0]:.9g} to {times[-1]:.9g} {by}"
    return ", ".join(f"{t:.12g}" for t in times)


def _mask(read):
    """Components that are read, in words: row by row where the times are few."""
    if len(read) <= ROWS:
        return " ".join("".join(map(str, row)) for row in read.astype(int))
    places = np.flatnonzero(read)
    return f"{len(places)} of {read.size} components, sum of their places {places.sum()}"


def model_changes(first: Any, second: Any) -> list[Change]:
    """What differs between the models; nothing where they are one, however they are written."""
    one, two = first.system, second.system
    if one is two:
        return []
    if isinstance(one, UnknownModel) or isinstance(two, UnknownModel):
        words = ("unknown" if isinstance(s, UnknownModel) else "known" for s in (one, two))
        return [Change("model", *words)]
    if apart := UnknownModel.of(one).apart(UnknownModel.of(two)):
        word, a, b = apart
        return [Change(f"model ({word})", str(a), str(b))]
    points = probe_points(one, *first.reach)
    reason = difference(probe(one, points), probe(two, points), points)
    if not reason:  # the same model, however it is written
        return []
    a, b = model_text(one), model_text(two)
    texts = [
        Change(f"model ({name})", a.get(name, "none"), b.get(name, "none"))
        for name in {**a, **b}
        if a.get(name) != b.get(name)
    ]
    return [Change("model", "as designed", reason), *texts]
