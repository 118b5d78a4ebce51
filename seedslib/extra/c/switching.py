"""C of a switching filter: laws of all modes carried (IMM), or given by a memory."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.base.linalg import symmetric
from seedslib.designed.switching.filter import CellFit, SwitchingFilter
from seedslib.designed.switching.rules import SOFTEST
from seedslib.extra.c import cells, laws
from seedslib.extra.c.branches import check_branches, moves_source, readings_source, switches_source
from seedslib.extra.c.records import going_on, losing, schedule
from seedslib.extra.c.source import constants, function
from seedslib.extra.c.tape import Tape, literal
from seedslib.extra.c.traced import record_correction, telling, told_of
from seedslib.filters.weights import TIE

_WATCH = """\
    if (indicator < -1 || indicator >= @NAME_INDICATORS) return @NAME_RANGE;
"""

_WANTED = "    if (indicator < 0) return @NAME_PARTLY; /* it is to be remembered */\n"


def switching_source(filter: SwitchingFilter) -> tuple[dict[Any, Any], str]:
    """Macros and C of a `SwitchingFilter`.

    Raises
    ------
    TypeError, ValueError
        Moments without formulas, fits that are no laws in cells.
    """
    system, memory, rules = filter.system, filter.memory, filter.rules
    told = told_of(system)
    check_branches(rules, filter.linearization, system)
    n, m, modes = system.state_size, system.measurement_size, system.modes
    each = system.indicators if rules.split else 1
    macros = {
        "STATE": n,
        "MEASUREMENT": m,
        "MODES": modes,
        "INDICATORS": system.indicators,
        "JOINT": n + m,
        "LAW": n * (n + 3) // 2,
        "BOTH": (n + m) * (n + m + 3) // 2,
        "EACH": each,
        "PARTS": modes * each,
    }
    text = constants("@name_score0", _logs([part.probability for part in system.initial]))
    first = [[*part.mean, *part.cov[np.tril_indices(n)]] for part in system.initial]
    text += constants("@name_law0", first)
    moves = moves_source(system, filter.linearization, rules.split)
    shared = [
        moves,
        readings_source(system, filter.linearization),
        _correction(filter),
        *_forecasts(filter),
        laws.SENSE,
    ]
    expect = ""
    if memory is None:
        own, held, begin, header = laws.CARRIED_STEP, _CARRIED, "", _TIMED
        gaps = after = ""
    else:
        known = _designed(filter, macros)
        text, own = text + constants("@name_times", filter.times), cells.DESIGNED_STEP
        text += schedule(filter)
        shared += [known, cells.PUSH.replace("@SOFT", literal(SOFTEST))]
        held, begin, header = _held(memory), "", "    int k; /* @COUNTED */\n@LAPS"
        gaps, after = ", NaN from a gap on", ", NaN after a gap"
        expect = laws.EXPECT if memory.measurements else ""
    take = laws.TAKE.replace("@EXPECT", expect).replace("@TIE", literal(1.0 - TIE))
    watch = _WATCH if system.indicators else ""
    if system.indicators and memory is not None:
        watch += losing(filter)[1]
    if memory is not None and memory.indicators:
        watch += _WANTED
    marks = {
        "@HEADER": header,
        "@GAPS": gaps,
        "@AFTER": after,
        "@HELD": held,
        "@BEGIN": begin,
        "@TOLD": ", int indicator" if system.indicators else "",
        "@WATCH": watch,
        "@SEEN": "indicator" if system.indicators else "-1",
        "@MOST": str(modes),
        "@LOST": losing(filter)[0],
        "@LENGTH": _lasting(told, memory is None),
    }
    whole = "\n".join([text, laws.STATE, laws.MIX, *shared, take, own])
    for mark, part in marks.items():
        whole = whole.replace(mark, part)
    return macros, going_on(filter, telling(whole, told))


_TIMED = """\
    double t; /* time of the estimate */
    int started; /* whether it has one */
"""

_CARRIED = """\
    double score[@NAME_MODES]; /* logarithms of the probabilities */
    double law[@NAME_MODES][@NAME_LAW]; /* mean and covariance in each mode */
"""


def _lasting(told: list[Any], carried: bool) -> str:
    """C of how long a step is, where the model is told that."""
    if not told:
        return ""
    ends = "t", "s->t"
    if not carried:
        ends = "(@name_times[s->k]@LATER)", "(@name_times[s->k - 1]@LATER)"
    return f"const double dt = {ends[0]} - {ends[1]};\n        "


def _forecasts(filter: SwitchingFilter) -> list[str]:
    """C of the forecast of all modes."""
    if filter.system.drives == "old":
        return [laws.PROPAGATE]
    moved = laws.PROPAGATE.replace("@name_propagate_", "@name_moved_")
    switches = switches_source(filter.system, filter.linearization)
    return [switches, laws.SWITCHED, moved, laws.BOTH]


def _held(memory: Any) -> str:
    """What the state has of the memory."""
    text = "    double memory[@NAME_MEMORY]; /* newest first: estimates, then measurements */\n"
    text += "    int modes[@NAME_HELD_ESTIMATES + 1]; /* decided with the estimates */\n"
    text += "    int told[@NAME_HELD_INDICATORS + 1]; /* indicators */\n"
    return text + "    double shown[@NAME_MEASUREMENT]; /* last measurement, gaps filled */\n"


def _logs(values: Any) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.log(np.asarray(values, dtype=float))


def _correction(filter: SwitchingFilter) -> str:
    """C of the correction in one mode, from the joint law of state and measurement."""
    system, tape = filter.system, Tape()
    n, m = system.state_size, system.measurement_size
    size = n + m
    joint = tape.inputs("joint[{}]", size * (size + 3) // 2)
    cov = symmetric(joint[size:], size)
    y = tape.inputs("y[{}]", m)
    moments = joint[n:size], cov[:n, n:], cov[n:, n:]
    lower = cov[:n, :n][np.tril_indices(n)]
    mean, found, loglik, _ = record_correction(
        tape, joint[:n], lower, y, moments, n, filter.rules.periods
    )
    outputs = {f"law[{k}]": part for k, part in enumerate(mean)}
    outputs |= {f"law[{n + k}]": part for k, part in enumerate(p for row in found for p in row)}
    lines = tape.body({**outputs, "density": loglik})
    head = "double @name_correct_(const double *joint, const double *y, double *law)"
    return function(head, ["    double density;", *lines, "    return density;"])


def _designed(filter: SwitchingFilter, macros: dict[Any, Any]) -> str:
    """C of the law given the memory, and the macros that it wants."""
    system, memory, fits = filter.system, filter.memory, filter.fits
    if not fits or not all(isinstance(fit, CellFit) for fit in fits):
        raise TypeError("fits: wanted laws in cells, for at least two measurements, to write in C")
    odds = system.modes - 1 if memory.log_odds else 0
    n = system.state_size
    macros |= {
        "MEMORY": memory.order(n, system.measurement_size, system.modes),
        "BLOCK": n + odds,
        "HELD_ESTIMATES": memory.estimates,
        "HELD_INDICATORS": memory.indicators,
        "TIMES": len(filter.times),
    }
    if filter.cycle:
        macros["CYCLE"] = filter.cycle
    text, rows = cells.KNOWN, []
    for k, fit in enumerate(fits):
        cov = fit.cov[np.tril_indices(n)]
        parts = [fit.log_weight, fit.centre, fit.white, fit.gain, fit.offset, cov]
        names = [f"@name_{name}_{k}_" for name in ("weight", *CellFit._fields[1:])]
        for name, part in zip(names, parts, strict=True):
            ordered = np.moveaxis(part, (-1, -2), (0, 1))
            text += constants(name, ordered.reshape(-1) if ordered.size else [0.0])
        rows.append(f"    {{ {len(fit.centre)}, {', '.join(names)} }}")
    text += f"static const @name_fit @name_fits[{len(rows)}] = {{\n" + ",\n".join(rows) + "\n};\n"
    return text + cells.FORECAST
