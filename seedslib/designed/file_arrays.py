"""Arrays of a file of a designed filter, each held against the others as it is taken."""

from __future__ import annotations

import numpy as np

from seedslib.designed.finite_order_rules import Prediction
from seedslib.designed.prediction import HeldOut


def shaped(arrays, name, shape) -> np.ndarray:
    """Finite float64 array of the given name and shape (-1 is any length), or ValueError."""
    array = arrays[name]
    fits = array.ndim == len(shape) and all(
        want in (-1, got) for want, got in zip(shape, array.shape, strict=True)
    )
    if not fits or array.dtype != np.dtype("<f8") or not np.isfinite(array).all():
        raise ValueError(f"{name} of shape {array.shape}")
    return array


def measurement_times(arrays) -> np.ndarray:
    """Times of the measurements, shape (K+1,), in order, or ValueError."""
    times = shaped(arrays, "times", (-1,))
    if not (times.size and (np.diff(times) > 0).all()):
        raise ValueError("times that do not increase")
    return times


def node_times(arrays, times, intervals) -> tuple[np.ndarray, ...]:
    """Times of the nodes in each interval, in order and inside of it, or ValueError."""
    ends = np.append(times[1:], np.inf)
    found = []
    for k in range(intervals):
        found.append(shaped(arrays, f"nodes/{k}/times", (-1,)))
        if not (np.diff([times[k], *found[k], ends[k]]) > 0).all():
            raise ValueError(f"nodes/{k}/times outside of their interval or out of order")
    return tuple(found)


HELD_OUT = ("rms", "error", "deviation", "mode_rate", "mode_error")


def held_out_arrays(held: HeldOut | None) -> tuple[dict, dict]:
    """Numbers for the header and arrays by name of the errors on held-out paths, if any."""
    if held is None:
        return {}, {}
    parts = {name: getattr(held, name) for name in HELD_OUT}
    arrays = {f"held_out/{name}": part for name, part in parts.items() if part is not None}
    return {"paths": held.paths, "diverged": held.diverged}, arrays


def held_out(header, arrays, times) -> HeldOut | None:
    """Errors on held-out paths; NaN where no path was left, or ValueError."""
    counts = header["held_out"]
    if not counts:
        return None
    parts = {name: arrays.get(f"held_out/{name}") for name in HELD_OUT}
    shape = (len(times), *arrays["predicted/rms"].shape[1:])
    for name, part in parts.items():
        mode = name.startswith("mode_")
        if mode and part is None and "predicted/mode_rate" not in arrays:
            continue
        if part is None or part.dtype != np.dtype("<f8") or part.shape != shape[: 2 - mode]:
            raise ValueError(f"held_out/{name} missing, or of another shape than {shape}")
    return HeldOut(times=times, **parts, **{name: int(n) for name, n in counts.items()})


def prediction(header, arrays, times, components) -> Prediction:
    """What the design says about the filter's accuracy, at the measurements at least."""
    stamps = shaped(arrays, "predicted/times", (-1,))
    if not np.isin(times, stamps).all():
        raise ValueError("predicted/times without those of the measurements")
    shape = (len(stamps), components)
    return Prediction(
        stamps,
        shaped(arrays, "predicted/rms", shape),
        shaped(arrays, "predicted/error", shape),
        bool(header["in_sample"]),
    )
