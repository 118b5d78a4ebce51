"""C that all filters with a design share: state, times, memory, the forecast at any time."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.designed.base import DesignedFilter
from seedslib.designed.between import BetweenFilter
from seedslib.extra.c.source import constants, function
from seedslib.extra.c.tape import literal

FORECASTS = ("interpolated", "piecewise constant", "constant")
"""Forecasts between measurements that need nothing from before the last one."""

STATE = """\
typedef struct {
    int k; /* @COUNTED */
@LAPS    double mean[@NAME_ESTIMATE]; /* estimate at the last one */
    double cov[@NAME_ESTIMATE][@NAME_ESTIMATE]; /* its covariance, NaN from a gap on */
    double loglik; /* log-density of the last measurement, NaN after a gap */
    double memory[@NAME_MEMORY]; /* newest first: estimates, then measurements */
    double shown[@NAME_MEASUREMENT]; /* last measurement, gaps filled */
} @name_state;

static inline void @name_init(@name_state *s)
{
    memset(s, 0, sizeof *s);
}
"""

BETWEEN = """\
/* Forecast of the estimated components at a time from the last measurement to the next. */
static inline int @name_forecast(const @name_state *s, double t, double *out)
{
    double value[(@NAME_NODES + 2) * @NAME_ESTIMATE], when[@NAME_NODES + 2], slack, span, share;
    int i = 0, j, count, nodes;
    if (s->k == 0) return @NAME_TIME;
    memcpy(value, s->mean, sizeof s->mean);
    nodes = @name_nodes(s, value + @NAME_ESTIMATE);
    when[0] = @name_times[s->k - 1]@LATER;
    for (j = 0; j < nodes; j++) {
        when[j + 1] = @name_node_times[@name_node_start[s->k - 1] + j]@LATER;
    }
    count = nodes + 1;
    if (s->k < @NAME_TIMES) {
        @name_end_(s, value + count * @NAME_ESTIMATE);
        when[count++] = @name_times[s->k]@LATER;
    }
    if (!(t >= when[0] - @NAME_SLACK && t <= when[count - 1] + @NAME_SLACK)) return @NAME_TIME;
    span = when[count - 1] - when[0];
    slack = fmin(fmax(@NAME_SAME * span, @NAME_ROUND * fabs(when[count - 1])), 0.25 * span);
    while (i < nodes && when[i + 1] <= t + slack) i++;
    @SHARE
    for (j = 0; j < @NAME_ESTIMATE; j++) {
        const double now = value[i * @NAME_ESTIMATE + j];
        out[j] = share == 0.0 ? now : now + share * (value[(i + 1) * @NAME_ESTIMATE + j] - now);
    }
    return @NAME_OK;
}
"""

_SHARES = {
    "interpolated": "share = i + 1 < count ? (t - when[i]) / (when[i + 1] - when[i]) : 0.0;",
    "piecewise constant": "share = 0.0;",
    "constant": "i = 0;\n    share = 0.0;",
}


_ONCE = {
    "@COUNTED": "measurements taken in",
    "@LAPS": "",
    "@LATER": "",
    "@ENDS": "\n    if (s->k >= @NAME_TIMES) return @NAME_END;",
    "@LAP": "",
}

_FOR_EVER = {
    "@COUNTED": "step of the design that serves the next measurement",
    "@LAPS": "    double laps; /* how often its last steps have begun again */\n",
    "@LATER": " + s->laps * @SPAN",
    "@ENDS": "",
    "@LAP": """
    if (s->k == @NAME_TIMES) { /* the last steps serve all later measurements in turn */
        s->k -= @NAME_CYCLE;
        s->laps += 1.0;
    }""",
}


def going_on(filter: DesignedFilter, text: str) -> str:
    """C with what depends on whether the design has an end."""
    cycle, times = filter.cycle, filter.times
    for mark, part in (_FOR_EVER if cycle else _ONCE).items():
        text = text.replace(mark, part)
    return text.replace("@SPAN", literal(times[-1] - times[-1 - cycle])) if cycle else text


def frame(filter: BetweenFilter) -> tuple[dict[Any, Any], str]:
    """Macros with the dimensions, and C of the times of measurements and nodes."""
    times = filter.times
    counts = [len(nodes) for nodes in filter.node_times]
    counts += [0] * (len(times) - len(counts))
    nodes = np.concatenate([*filter.node_times, []])
    macros = {
        "STATE": filter.system.state_size,
        "ESTIMATE": filter.components,
        "MEASUREMENT": filter.system.measurement_size,
        "MEMORY": filter.order,
        "TIMES": len(times),
        "NODES": max(counts),
    }
    if filter.cycle:
        macros["CYCLE"] = filter.cycle
    text = constants("@name_times", times)
    text += constants("@name_node_start", np.cumsum([0, *counts]), "int")
    return macros, text + constants("@name_node_times", nodes if len(nodes) else [0.0])


def between(filter: BetweenFilter) -> str:
    """C of the forecast at any time.

    Raises
    ------
    ValueError
        A kind of forecast that looks further back than the last measurement.
    """
    if filter.between not in FORECASTS:
        raise ValueError(
            f"between: wanted one of {', '.join(FORECASTS)} for C, got {filter.between!r}; "
            'use filter.forecasting("interpolated")'
        )
    return BETWEEN.replace("@SHARE", _SHARES[filter.between])


_LOST = "        if (isnan(y[i])) lost = 1;"

_SCHEDULED = """\
        if (!isnan(y[i]) && @name_read[s->k][i] == 0) return @NAME_STRAY;
        if (isnan(y[i]) && @name_read[s->k][i] == 1) lost = 1;"""

_SCHEDULED_INDICATOR = """\
    if (indicator >= 0 && @name_read[s->k][@NAME_MEASUREMENT] == 0) return @NAME_STRAY;
    if (indicator < 0 && @name_read[s->k][@NAME_MEASUREMENT] == 1) lost = 1;
"""


def schedule(filter: DesignedFilter) -> str:
    """C of which components the design has at each time; nothing where it has all of them."""
    return "" if filter.measured is None else constants("@name_read", filter.measured, "int")


def losing(filter: DesignedFilter) -> tuple[str, str]:
    """C that sees a gap the design does not know of: in a component, and in the indicator."""
    if filter.measured is None:
        return _LOST, "    if (indicator < 0) lost = 1;\n"
    return _SCHEDULED, _SCHEDULED_INDICATOR


def push(filter: DesignedFilter) -> str:
    """C that puts the newest estimate and measurement on the memory."""
    lines, place = [], 0
    for count, size, source in (
        (filter.memory.estimates, filter.components, "mean"),
        (filter.memory.measurements, filter.system.measurement_size, "shown"),
    ):
        start = f"s->memory + {place}" if place else "s->memory"
        if count > 1:
            moved = (count - 1) * size
            lines.append(
                f"    memmove(s->memory + {place + size}, {start}, {moved} * sizeof *s->memory);"
            )
        if count:
            lines.append(f"    memcpy({start}, s->{source}, sizeof s->{source});")
        place += count * size
    return function("void @name_push_(@name_state *s)", lines)
