"""What is typed on the command line, turned into the library's descriptions."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from seedslib.base.checks import as_times
from seedslib.base.clock import slack
from seedslib.base.tables import Axis
from seedslib.designed.memory import Memory, finite_memory, large_order, small_order

LINEARIZATIONS = {
    "taylor": "Taylor",
    "gaussian": "ExactGaussian",
    "unscented": "Unscented",
    "cubature": "Cubature",
    "gauss-hermite": "GaussHermite",
}
PREDICTORS = {"affine": "Affine", "polynomial": "Polynomial", "continuous": "Continuous"}
MEMORIES = {"small_order": small_order, "large_order": large_order, "finite_memory": finite_memory}


def as_memory(text: str) -> Memory:
    """Memory from ``estimates=2,measurements=1``, ``large_order:2``, ``finite_memory:4``.

    Of switching systems also ``indicators=1`` and ``log_odds``.

    Raises
    ------
    ValueError
        Other words, or a memory of nothing.
    """
    wanted = (
        "memory: wanted such as estimates=2, measurements=4, estimates=2,measurements=2, "
        f"small_order, large_order:2, finite_memory:4, or for modes estimates=1,indicators=1 or "
        f"estimates=1,log_odds; got {text!r}"
    )
    name, _, number = text.partition(":")
    if name in MEMORIES:
        return _called(MEMORIES[name], number, wanted)
    found: dict[str, int | bool] = {}
    parts = text.split(",")
    for part in parts:
        if counted := re.fullmatch(r"(estimates|measurements|indicators)=(\d+)", part):
            found[counted[1]] = int(counted[2])
        elif part == "log_odds":
            found[part] = True
    if len(found) < len(parts):
        raise ValueError(wanted)
    return Memory(**found)


def as_choice(name: str, text: str, choices: Mapping[str, str], room: object) -> object:
    """A linearization or a predictor from its name, options after a colon.

    Parameters
    ----------
    name : str
        Of the option, for messages.
    text : str
        Such as ``gauss-hermite`` or ``polynomial:3,2``.
    choices : mapping of str to str
        Names on the command line, and in the room.
    room : module

    Raises
    ------
    ValueError
        An unknown name, or options that it does not take.
    """
    wanted = f"{name}: wanted one of {', '.join(choices)}, options after a colon; got {text!r}"
    word, _, numbers = text.partition(":")
    if word not in choices:
        raise ValueError(wanted)
    return _called(getattr(room, choices[word]), numbers, wanted)


def as_time_grid(text: str) -> np.ndarray:
    """Times from ``start:stop:step``, the stop included where a step meets it, or ``0,0.5,2``.

    Raises
    ------
    ValueError
        Something else, or times that do not increase.
    """
    try:
        if ":" not in text:
            return as_times("times", [float(part) for part in text.split(",")])
        start, stop, step = (float(part) for part in text.split(":"))
        times = in_steps_of(start, stop, step)
    except (ValueError, ZeroDivisionError) as error:
        reason = str(error) if str(error).startswith("times:") else ""
        raise ValueError(
            reason or f"times: wanted start:stop:step or a list such as 0,0.5,2; got {text!r}"
        ) from None
    return as_times("times", times)


def linearization_of(text: str) -> Any:
    """A linearization of the library; see `as_choice`."""
    from seedslib import linearization

    return as_choice("linearization", text, LINEARIZATIONS, linearization)


def in_steps_of(start: float, stop: float, step: float) -> np.ndarray:
    """Times from the first up to the last, which is one of them where a step meets it.

    Raises
    ------
    ValueError, ZeroDivisionError
        A step that is not positive, a stop before the start, more than a million of them.
    """
    steps = (stop - start) / step
    if not (0 <= steps < 1e6 and step > 0):
        raise ValueError(f"wanted up to a million positive steps, got {start:g}:{stop:g}:{step:g}")
    steps += slack(step, max(abs(start), abs(stop))) / step  # the stop may be rounded
    return start + step * np.arange(math.floor(steps) + 1)


def axes_of(option: str, texts: list[str], first: str, *others: str) -> dict[str, list[Axis]]:
    """Axes from ``y=-8:8:121`` and ``z=-3:3:121``; several, for several components.

    Parameters
    ----------
    option : str
        For messages.
    texts : list of str
    first, *others : str
        Names of axes; the first is wanted.

    Raises
    ------
    ValueError
        Something else, or one of them twice.
    """
    wanted = " ".join(f"{name}=low:high:count" for name in (first, *others))
    found: dict[str, list[Axis]] = {}
    for text in texts:
        name, _, axes = text.partition("=")
        try:
            if name not in (first, *others) or name in found:
                raise ValueError
            found[name] = [_axis(axis) for axis in axes.split(",")]
        except (TypeError, ValueError):
            raise ValueError(
                f"{option}: wanted {wanted}, a comma between components; got {text!r}"
            ) from None
    if first not in found:
        raise ValueError(f"{option}: wanted {first}=low:high:count too, got {' '.join(texts)!r}")
    return found


def as_values(text: str) -> dict[str, float]:
    """Values of parameters from ``q=1.3,r=2``, or from a file that the command fit has written.

    Raises
    ------
    ValueError
        Something else, or not such a file.
    """
    wanted = f"set: wanted such as q=1.3,r=2, or FILE.json of the command fit; got {text!r}"
    try:
        if text.endswith(".json"):
            pairs = json.loads(Path(text).read_text(encoding="utf-8"))["values"].items()
        else:
            pairs = [part.split("=") for part in text.split(",")]
        found = {name.strip(): float(value) for name, value in pairs}
    except (AttributeError, KeyError, TypeError, ValueError):
        raise ValueError(wanted) from None
    if not all(map(math.isfinite, found.values())):
        raise ValueError(wanted)
    return found


def _axis(text):
    low, high, count = text.split(":")
    return Axis(float(low), float(high), int(count))


def _called(make: Callable, numbers: str, wanted: str) -> object:
    """Result of a call with the numbers of a list."""
    try:
        given = [_number(part) for part in numbers.split(",")] if numbers else []
        return make(*given)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{wanted} ({error})") from None


def _number(text):
    return int(text) if re.fullmatch(r"[+-]?\d+", text.strip()) else float(text)
