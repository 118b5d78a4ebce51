"""What two designed filters of switching systems hold, side by side, for `diff`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.base.tables import Labels
from seedslib.designed.file_switching import UnknownModes, probe_switching, switching_text
from seedslib.designed.identity import difference, probe_points
from seedslib.designed.switching import SwitchingFilter
from seedslib.designed.switching_fits import CellFit
from seedslib.designed.switching_table import SwitchingTableFilter

FILTERS = (SwitchingFilter, SwitchingTableFilter)


class Predicted(NamedTuple):
    """Predicted errors as those of other designs: times, their size and standard errors."""

    times: np.ndarray
    rms: np.ndarray
    error: np.ndarray


def require_design(name, designed) -> None:
    """Refuse a switching filter that was not designed.

    Raises
    ------
    TypeError
        A filter without a memory.
    """
    if designed.memory is None:
        raise TypeError(f"{name}: wanted a designed filter, got one without a memory")


def choices(designed, grid) -> dict[str, str]:
    """What was chosen for a design, in words; `grid` says times."""
    made = designed.design
    if made is None:
        paths = "unknown"
    elif getattr(made, "exact", False):
        paths = "exact"
    else:
        paths = f"{made.paths} paths of seed {made.entropy}"
        if made.spawn_key:
            paths += f", stream {made.spawn_key}"
    found = {
        "kind": type(designed).__name__,
        "memory": str(designed.memory),
        "measurement times": grid(designed.times),
        "later steps": "as the last" if designed.lasting else "none",
        "designed on": paths,
    }
    if isinstance(designed, SwitchingTableFilter):
        return {**found, "method": designed.method, "components": str(designed.components)}
    plain = type(designed.linearization).__repr__ is object.__repr__
    words = type(designed.linearization).__name__ if plain else str(designed.linearization)
    normalisation = designed.normalisation
    if not designed.system.indicator_is_blind:
        normalisation += ", split forecast" if designed.split else ""
    return {**found, "linearization": words, "normalisation": normalisation}


def model_changes(first, second) -> list[tuple[str, str, str]]:
    """What differs between the models: name, and words of the first and of the second."""
    one, two = first.system, second.system
    if one is two:
        return []
    unknown = [isinstance(system, UnknownModes) for system in (one, two)]
    if any(unknown):
        return [("model", *("unknown" if u else "known" for u in unknown))]
    for name in ("modes", "state_size", "measurement_size", "indicators", "has_indicator"):
        a, b = getattr(one, name), getattr(two, name)
        if a != b:
            return [(f"model ({name.replace('_', ' ')})", str(a), str(b))]
    points = probe_points(one, float(first.times[0]), float(first.times[-1]))
    with np.errstate(all="ignore"):
        reason = difference(probe_switching(one, points), probe_switching(two, points), points)
    if not reason:
        return []
    a, b = switching_text(one), switching_text(two)
    texts = [
        (f"model ({name})", a.get(name, "none"), b.get(name, "none"))
        for name in {**a, **b}
        if a.get(name) != b.get(name)
    ]
    return [("model", "as designed", reason), *texts]


def predicted_errors(designed) -> tuple[Predicted, Predicted]:
    """Of the first components of the state, and of the decided mode."""
    predicted = designed.predicted
    if predicted is None:
        size = designed.system.state_size
        none = Predicted(np.empty(0), np.empty((0, size)), np.empty((0, size)))
        return none, Predicted(np.empty(0), np.empty((0, 1)), np.empty((0, 1)))
    return (
        Predicted(predicted.times, predicted.rms, predicted.error),
        Predicted(predicted.times, predicted.mode_rate[:, None], predicted.mode_error[:, None]),
    )


def relative_differences(first, k: int, second, q: int) -> dict[str, float]:
    """Relative differences between measurement k of one design and measurement q of another.

    Of fits the forecast that starts after the measurement; of tables the function at it, of the
    decided modes the part of nodes at which they differ.

    Returns
    -------
    dict of str to float
        |A - B| / max(|A|, |B|) in the Frobenius norm, or NaN where the two are not alike.
    """
    if isinstance(first, SwitchingTableFilter) != isinstance(second, SwitchingTableFilter):
        return {"output": np.nan}
    if isinstance(first, SwitchingTableFilter):
        found = {}
        for place in ("shown", "blind"):
            one, two = (getattr(d.tables[j], place) for d, j in ((first, k), (second, q)))
            prefix = "" if place == "shown" else "blind "
            found.update({f"{prefix}{name}": v for name, v in _tables(one, two).items()})
        return found
    if k >= len(first.fits) and q >= len(second.fits):
        return {}
    if k >= len(first.fits) or q >= len(second.fits):
        return {"gain": np.nan}
    one, two = first.fits[k], second.fits[q]
    if not (isinstance(one, CellFit) and isinstance(two, CellFit)):
        return {"fit": 0.0 if one is two else np.nan}
    here, there = _parts(one), _parts(two)
    same = _held(first.memory, k) == _held(second.memory, q)
    return {
        name: _apart(here[name], there[name])
        if same and here[name].shape == there[name].shape
        else np.nan
        for name in here
    }


def _held(memory, k):
    """What the memory holds after measurement k; numbers of one shape may be of other things."""
    blocks = (memory.estimates, memory.measurements, memory.indicators)
    return [min(k + 1, count) for count in blocks], memory.log_odds


def _parts(fit):
    """What a fit weighs, in forms that do not depend on how its density is factored."""
    return {
        "probability": np.exp(fit.log_weight - fit.log_weight.max()),
        "centre": fit.centre,
        "precision": np.einsum("kalc,kblc->ablc", fit.white, fit.white),
        "gain": fit.gain,
        "offset": fit.offset,
        "cov": fit.cov,
    }


def _tables(one, two):
    """Differences of two tables at the nodes of the first."""
    nan = {"estimate": np.nan, "mode": np.nan}
    if len(one.axes) != len(two.axes) or len(one.estimate) != len(two.estimate):
        return nan
    for a, b in zip(one.axes, two.axes, strict=True):
        labels = isinstance(a, Labels)
        if labels != isinstance(b, Labels) or (labels and a != b):
            return nan
    mean, mode = two.estimate, two.mode
    if one.axes != two.axes:
        points = np.meshgrid(*(axis.nodes for axis in one.axes), indexing="ij")
        mean, mode, _ = two.look_up(points, one.mode.shape)
    return {"estimate": _apart(one.estimate, mean), "mode": float((one.mode != mode).mean())}


def _apart(a, b):
    apart = np.sqrt(np.sum((a - b) ** 2))
    return float(apart / np.sqrt(max(np.sum(a**2), np.sum(b**2)))) if apart > 0 else 0.0
