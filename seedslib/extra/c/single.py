"""Single precision: the same C with ``float``, its tolerances, and how far it is from ``double``.

Also how many bytes a header wants.
"""

from __future__ import annotations

import ctypes
import math
import re
from typing import Any

import numpy as np

from seedslib.base.clock import ROUNDING, SAME, slack
from seedslib.base.semidefinite import ABSOLUTE, INDEFINITE, RELATIVE
from seedslib.base.values import looked_at
from seedslib.designed.runs import DesignedFilter
from seedslib.designed.switching.lemmas import FAINT
from seedslib.extra.c.build import library
from seedslib.extra.c.tape import CALLS, literal
from seedslib.extra.c.traced import told_of
from seedslib.models.kinds import mentioned

TOLERANCES = {
    "RELATIVE": (RELATIVE, 1e-6), "ABSOLUTE": (ABSOLUTE, float(np.finfo(np.float32).tiny)),
    "INDEFINITE": (INDEFINITE, 1e-4), "FAINT": (FAINT, 1e-30), "TURNED": (1e-36, 1e-14),
    "SAME": (SAME, 1e-4), "ROUND": (ROUNDING, 2.0**-21),
}  # fmt: skip
"""What counts as zero, as faint, as one time: in double, and in float."""

LENGTH = 1000
"""Measurements of each record on which float is compared with double."""

RECORDS = 100
"""How many such records: the largest difference hangs on the rarest of them."""

RESERVE = 4.0
"""The bounds that a header states are so many times what was found."""

_RECORD = """
int record(int count, const double *t, const double *y, const int *told, double *out);
int record(int count, const double *t, const double *y, const int *told, double *out)
{
    @REAL shown[F_MEASUREMENT]@ROOM;
    f_state s;
    int i, k, code;
    (void)t; (void)told;
    f_init(&s);
    for (k = 0; k < count; k++) {
        for (i = 0; i < F_MEASUREMENT; i++) shown[i] = (@REAL)y[k * F_MEASUREMENT + i];
        code = f_step(&s, @TIMEshown@TOLD@WITH);
        if (code != F_OK) return code;
        for (i = 0; i < @OUT; i++) *out++ = s.mean[i];
        for (i = 0; i < @OUT; i++) *out++ = s.cov[i][i];
    }
    return F_OK;
}
"""


def tolerances(filter: Any, real: str) -> str:
    """Macros of what counts as nothing."""
    known = {name: pair[real == "float"] for name, pair in TOLERANCES.items()}
    if isinstance(filter, DesignedFilter) and filter.memory is not None:
        times, room = np.asarray(filter.times), filter.clock.tolerance
        if real == "float":
            span = float(np.diff(times).min()) if len(times) > 1 else 1.0
            room = max(room, slack(span, 0.0), min(known["ROUND"] * abs(times[-1]), 0.25 * span))
        known["SLACK"] = room
    return "".join(f"#define @NAME_{name} {literal(value)}\n" for name, value in known.items())


def single(text: str) -> str:
    """A header's C in single precision; comments are left as they are.

    Raises
    ------
    ValueError
        A number out of the range of float.
    """
    parts = re.split(r"(/\*.*?\*/)", text, flags=re.DOTALL)
    calls = "|".join(sorted({*CALLS.values(), "fmin", "fmax"}))
    for k in range(0, len(parts), 2):
        part = re.sub(r"\bdouble\b", "float", parts[k])
        part = re.sub(rf"\b({calls})\(", r"\1f(", part).replace("HUGE_VAL", "HUGE_VALF")
        number = r"(?<![\w.])(?:\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)"
        parts[k] = re.sub(number, _short, part)
    return "".join(parts)


def _short(found: re.Match) -> str:
    with np.errstate(over="ignore", under="ignore"):
        value = np.float32(found[0])
    if not np.isfinite(value):
        raise ValueError(f"constant: wanted a number in the range of float, got {found[0]}")
    if abs(value) < np.finfo(np.float32).tiny:
        return "0.0F"
    words = str(value)
    return words + ("F" if "." in words or "e" in words else ".0F")


def sizes(text: str) -> str:
    """Bytes of tables and state, in words; structures count as their numbers do."""
    macros = {name: int(v) for name, v in re.findall(r"^#define (\w+) (\d+)$", text, re.M)}
    wide = {"double": 8, "float": 4, "int": 4, "char": 1}
    array = r"((?:\[[^\]]*\])*)"

    def count(dims: str) -> int:
        lengths = re.findall(r"\[([^\]]*)\]", dims)
        found = [re.sub(r"[A-Za-z_]\w*", lambda m: str(macros[m[0]]), each) for each in lengths]
        return math.prod(_whole(each) for each in found)

    tables = sum(
        wide[kind] * count(dims)
        for kind, dims in re.findall(
            rf"^static const (?:signed )?(double|float|int|char) \w+{array} = ", text, re.M
        )
    )
    state = re.findall(r"typedef struct \{((?:(?!typedef).)*?)\} \w+_state;", text, re.DOTALL)[0]
    fields = re.findall(rf"(double|float|int) (\w+){array};", state)
    place = 0
    for kind, _, dims in fields:
        place += -place % wide[kind] + wide[kind] * count(dims)
    place += -place % max(wide[kind] for kind, _, _ in fields)
    return (
        f"Bytes: {tables} of tables of numbers, {place} of a state. There is no heap, and no "
        "recursion."
    )


def _whole(text: str) -> int:
    """Value of a product, a sum or a quotient of whole numbers, as lengths of arrays are."""
    import sympy

    return int(sympy.sympify(text))


def compared(filter: Any, double: str, short: str) -> str:
    """How far the filter in float is from the one in double on simulated records, in words.

    Both texts have the prefix ``f``.
    """
    times, words = _times(filter)
    with looked_at(mentioned(filter.system)):
        data = filter.system.simulate(times, RECORDS, 0, **sensing(filter, len(times)))
    y = np.ascontiguousarray(np.moveaxis(data.measurements, -1, 0))
    told = None if data.indicators is None else data.indicators.T.astype(np.intc, order="C")
    # an input is what it is where a model is only looked at
    values = [f"(@REAL){p.value!r}" for p in told_of(filter.system) if p.role == "input"]
    found = []
    for real, text in (("double", double), ("float", short)):
        out = "F_ESTIMATE" if "#define F_ESTIMATE " in text else "F_STATE"
        timed = f"({real})t[k], " if re.search(r"_step\(f_state \*s, \w+ t,", text) else ""
        source = text + _RECORD.replace("@OUT", out).replace("@TIME", timed)
        for mark, part in (
            ("@WITH", ", told_"), ("@ROOM", f", told_[{len(values)}] = {{ {', '.join(values)} }}")
        ):  # fmt: skip
            source = source.replace(mark, part * ("#define F_INPUTS " in text))
        source = source.replace("@TOLD", ", told[k]" if "int indicator" in text else "")
        path = library(source.replace("@REAL", real))
        if path is None:
            return "The difference of float from double was not measured: there was no C compiler."
        n = getattr(filter, "components", None) or filter.system.state_size
        numbers = np.empty((RECORDS, len(times), 2, n))
        run = ctypes.CDLL(str(path)).record
        for k in range(RECORDS):
            parts = (times, y[k], None if told is None else told[k], numbers[k])
            if run(len(times), *(part if part is None else _at(part) for part in parts)):
                return f"In {real} the filter refuses one of {words}."
        found.append(numbers)
    sound, brief = (np.isfinite(part).all(axis=(1, 2, 3)) for part in found)
    lost, both = sound & ~brief, sound & brief
    if not both.any():
        return f"In float numbers are lost on {words}: do not use it."
    one, other = (part[both] for part in found)
    deviation = np.sqrt(np.abs(one[:, :, 1]))
    with np.errstate(invalid="ignore", divide="ignore"):
        apart = np.abs(other[:, :, 0] - one[:, :, 0]) / np.where(deviation > 0, deviation, np.nan)
        wide = np.abs(np.sqrt(np.abs(other[:, :, 1])) / deviation - 1.0)
    missing = f" In float numbers are lost on {lost.sum()} of them." if lost.any() else ""
    return (
        f"Means differ from those in double by at most {RESERVE * np.nanmax(apart):.1e} of the "
        f"deviation that the filter claims, and deviations by {RESERVE * np.nanmax(wide):.1e} of "
        f"themselves: {RESERVE:g} times the worst on {words}.{missing}"
    )


def sensing(filter: Any, count: int) -> dict[str, Any]:
    """What a design knows of missing measurements, as a simulation takes it."""
    if getattr(filter, "measured", None) is getattr(filter, "availability", None) is None:
        return {}
    mask = filter.schedule.mask[[filter.served(k) for k in range(count)]]
    return {"measured": mask, "availability": filter.availability}


def _at(part: np.ndarray) -> ctypes.c_void_p:
    return part.ctypes.data_as(ctypes.c_void_p)


def _times(filter: Any) -> tuple[np.ndarray, str]:
    if isinstance(filter, DesignedFilter) and filter.memory is not None:
        count = LENGTH if filter.cycle else len(filter.times)
        times = np.array([filter.clock.moment(k, filter.cycle) for k in range(count)])
        return times, f"{RECORDS} records of {count} measurements simulated with the seed 0"
    step = 10.0 * filter.integration_step if getattr(filter, "continuous", False) else 1.0
    words = f"{RECORDS} records of {LENGTH} measurements, {step:g} apart, simulated with the seed 0"
    return step * np.arange(float(LENGTH)), words
