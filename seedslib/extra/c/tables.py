"""C of a filter whose functions are tables: multilinear interpolation, constant at the ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from seedslib.base.tables import Axis, Labels
from seedslib.designed.output_filter import TableFilter
from seedslib.designed.tables import Table
from seedslib.extra.c.records import STATE, between, frame, going_on, push
from seedslib.extra.c.source import constants, function
from seedslib.extra.c.tape import literal
from seedslib.models.kinds import switches

_TYPES = """\
typedef struct {
    double low, high, scale; /* ends, nodes per unit; zero where nothing lies between nodes */
    int count;               /* nodes */
} @name_axis;

typedef struct {
    const double *values;
    @MODE_TYPEint axes, axis[@NAME_AXES + 1]; /* their number, and which ones */
} @name_table;
"""

_LOOKUP = """\
/* Multilinear interpolation, the values at the ends beyond them; returns the nearest node. */
static inline int @name_lookup_(const @name_table *table, const double *point, double *out)
{
    double share[@NAME_AXES + 1], value[1 << @NAME_AXES];
    int place[1 << @NAME_AXES] = { 0 }, corner, i, k, size = 1, split = 0, nearest = 0;
    for (k = 0; k < table->axes; k++) {
        const @name_axis *axis = &@name_axes[table->axis[k]];
        double p = point[k];
        int below;
        size *= axis->count;
        if (axis->scale == 0.0) {
            nearest = nearest * axis->count + (int)p;
            for (corner = 0; corner < 1 << split; corner++) {
                place[corner] = place[corner] * axis->count + (int)p;
            }
            continue;
        }
        p = ((p < axis->low ? axis->low : p > axis->high ? axis->high : p) - axis->low)
            * axis->scale;
        below = p < axis->count - 2 ? (int)p : axis->count - 2;
        p -= (double)below;
        share[split] = p < 1.0 ? p : 1.0;
        nearest = nearest * axis->count + below + (share[split] > 0.5);
        for (corner = (1 << split) - 1; corner >= 0; corner--) {
            place[2 * corner + 1] = place[corner] * axis->count + below + 1;
            place[2 * corner] = place[corner] * axis->count + below;
        }
        split++;
    }
    for (i = 0; i < @NAME_ROWS; i++) {
        for (corner = 0; corner < 1 << split; corner++) {
            value[corner] = table->values[i * size + place[corner]];
        }
        for (k = split - 1; k >= 0; k--) { /* neighbours on the last axis come first */
            for (corner = 0; corner < 1 << k; corner++) {
                const double low = value[2 * corner];
                value[corner] = low + share[k] * (value[2 * corner + 1] - low);
            }
        }
        out[i] = value[0];
    }
    return nearest;
}

/* What is remembered after `k` measurements, without the places that are not yet taken. */
static inline void @name_held_(const @name_state *s, int k, double *out)
{
    const int estimates = k < @NAME_HELD_ESTIMATES ? k : @NAME_HELD_ESTIMATES;
    const int measurements = k < @NAME_HELD_MEASUREMENTS ? k : @NAME_HELD_MEASUREMENTS;
    memcpy(out, s->memory, (size_t)(estimates * @NAME_BLOCK) * sizeof *out);
    memcpy(out + estimates * @NAME_BLOCK, s->memory + @NAME_HELD_ESTIMATES * @NAME_BLOCK,
           (size_t)(measurements * @NAME_SHOWN) * sizeof *out);
}
"""

_STEP = """\
/* One measurement; NaN in all components where it is missing. */
static inline int @name_step(@name_state *s, const double *y@TOLD)
{
    double point[@NAME_AXES + 1] = { 0.0 }, found[@NAME_ROWS];
    const @name_table *table;
    const int gap = isnan(s->cov[0][0]); /* the design knows no gaps */
    int i, missing = 0, @NEARESTlost = gap;@ENDS
    for (i = 0; i < @NAME_MEASUREMENT; i++) {
        if (isinf(y[i])) return @NAME_INFINITE;
        if (isnan(y[i])) missing++;
    }
    if (missing && (missing < @NAME_MEASUREMENT || @NAME_HELD_MEASUREMENTS)) return @NAME_PARTLY;
@WATCH    if (missing) {
        lost = 1;
        table = &@name_ahead[s->k];
        @name_held_(s, s->k, point + @FIRST);
    } else {
        memcpy(point + @FIRST, y, sizeof s->shown);
        table = &@name_output[s->k];
        @name_held_(s, s->k, point + @FIRST + @NAME_MEASUREMENT);
    }
    @KEEPNEAREST@name_lookup_(table, point, found);
    memcpy(s->mean, found, sizeof s->mean);
    memcpy(s->shown, y, sizeof s->shown);
    for (i = 0; i < @NAME_ESTIMATE * @NAME_ESTIMATE; i++) {
        const int p = (int)(i / @NAME_ESTIMATE), q = i % @NAME_ESTIMATE;
        s->cov[p][q] = lost ? (double)NAN : @name_cov[s->k][p][q];
    }
    s->loglik = (double)NAN;
@DECIDE    @name_push_(s@LETTERS);
    s->k++;@LAP
    return @NAME_OK;
}
"""

_NODES = """\
/* Forecasts at the nodes from the last measurement to the next, at
 * @name_node_times[@name_node_start[s->k - 1]]@LATER and on. Returns their number. */
static inline int @name_nodes(const @name_state *s, double *out)
{
    double point[@NAME_AXES + 1] = { 0.0 };
    int n;
    if (s->k == 0) return 0;
    @name_held_(s, s->k, point);
    for (n = @name_node_start[s->k - 1]; n < @name_node_start[s->k]; n++) {
        @LOOKUP
        out += @NAME_ESTIMATE;
    }
    return @name_node_start[s->k] - @name_node_start[s->k - 1];
}

static inline void @name_end_(const @name_state *s, double *out)
{
    double point[@NAME_AXES + 1] = { 0.0 };
    @name_held_(s, s->k, point);
    @name_lookup_(&@name_ahead[s->k], point, out);
}
"""

_DECIDE = """\
    s->mode = table->modes[nearest];
"""

_WATCH = """\
    if (indicator < -1 || indicator >= @NAME_INDICATORS) return @NAME_RANGE;
    if (indicator < 0) lost = 1;
    point[0] = (double)(indicator < 0 ? @NAME_INDICATORS : indicator);
"""

_WANTED = "    if (indicator < 0) return @NAME_PARTLY; /* it is to be remembered */\n"


def table_source(filter: TableFilter) -> tuple[dict[Any, Any], str]:
    """Macros and C of a `TableFilter`.

    Raises
    ------
    TypeError, ValueError
        Functions that are no tables, or only one measurement.
    """
    nodes = [fit for row in filter.node_fits for fit in row]
    outputs, ahead = zip(*filter.steps, strict=True)
    tables = [*outputs, *ahead, *nodes]
    others = {type(fit).__name__ for fit in tables if not isinstance(fit, Table)}
    if others or len(ahead) < 2:
        raise TypeError(
            "filter: wanted tables over evenly spaced axes, for at least two measurements, got "
            f"{', '.join(sorted(others)) or len(outputs)}"
        )
    system, memory = filter.system, filter.memory
    modes, told = switches(system), getattr(system, "indicators", 0)
    kept, decided = bool(memory.indicators), modes and bool(memory.estimates)
    prob = outputs[0].prob is not None
    macros, timing = frame(filter)
    axes = list(dict.fromkeys(axis for fit in tables for axis in fit.axes))
    block, shown = filter.components + decided + kept, macros["MEASUREMENT"] + kept
    macros["MEMORY"] = block * memory.estimates + shown * memory.measurements
    macros["AXES"] = macros["MEASUREMENT"] + bool(told) + macros["MEMORY"]
    macros |= {"BLOCK": block, "SHOWN": shown, "HELD_ESTIMATES": memory.estimates}
    macros["HELD_MEASUREMENTS"] = memory.measurements
    macros["ROWS"] = filter.components + prob * getattr(system, "modes", 0)
    if modes:
        macros |= {"MODES": system.modes, "INDICATORS": told}
    rows = [
        f"    {{ {literal(a.low)}, {literal(a.high)}, {literal(1.0 / a.step)}, {a.count} }}"
        if isinstance(a, Axis)
        else f"    {{ 0.0, 0.0, 0.0, {a.count} }}"
        for a in axes
    ]
    text = f"static const @name_axis @name_axes[{len(axes)}] = {{\n" + ",\n".join(rows) + "\n};\n"
    for name, fits in (("output", outputs), ("ahead", ahead), ("node", nodes)):
        text += _tables(name, fits, axes, macros["AXES"], modes)
    text += constants("@name_cov", filter.covariances)
    after = (
        []
        if modes
        else [
            _NODES.replace(
                "@LOOKUP", "@name_lookup_(&@name_node[n], point, out);" if nodes else ""
            ),
            between(filter),
        ]
    )
    marks = {
        "@STATE_MORE": _deciding(prob) if modes else "",
        "@TOLD": ", int indicator" * bool(told),
        "@WATCH": (_WATCH + _WANTED * kept) if told else "",
        "@FIRST": str(int(bool(told))),
        "@NEAREST": "nearest, " * modes,
        "@KEEPNEAREST": "nearest = " * modes,
        "@MODE_TYPE": "const signed char *modes;\n    " if modes else "",
        "@DECIDE": (_DECIDE + _PROB * prob) if modes else "",
    }
    state = STATE.replace("} @name_state;", "@STATE_MORE} @name_state;") if modes else STATE
    letters = [name for name, there in (("s->mode", decided), ("indicator", kept)) if there]
    pushed, call = push(filter), ""
    if letters:
        pushed, call = _lettered(macros, letters), ", indicator" * kept
    text = "\n".join([timing, _TYPES, text, state, _LOOKUP, pushed, _STEP, *after])
    for mark, part in sorted(marks.items(), key=lambda item: -len(item[0])):
        text = text.replace(mark, part)
    return macros, going_on(filter, text.replace("@LETTERS", call))


_PROB = "    memcpy(s->prob, found + @NAME_ESTIMATE, sizeof s->prob);\n"


def _deciding(prob: bool) -> str:
    text = "    int mode; /* decided mode */\n"
    return text + "    double prob[@NAME_MODES]; /* probabilities of the modes */\n" * prob


def _lettered(macros: dict[Any, Any], letters: list[str]) -> str:
    """C that puts a measurement or an estimate on the memory, behind its mode and indicator."""
    source = "mean" if macros["HELD_ESTIMATES"] else "shown"
    size = macros["BLOCK"] if source == "mean" else macros["SHOWN"]
    lines = [
        "    int i;",
        f"    for (i = @NAME_MEMORY - 1; i >= {size}; i--) s->memory[i] = s->memory[i - {size}];",
        *(f"    s->memory[{k}] = (double){letter};" for k, letter in enumerate(letters)),
        f"    memcpy(s->memory + {len(letters)}, s->{source}, sizeof s->{source});",
    ]
    told = ", int indicator" if "indicator" in letters else ""
    return function(f"void @name_push_(@name_state *s{told})", lines)


def _tables(
    name: str, fits: Sequence[Table], axes: list[Axis | Labels], most: int, modes: bool
) -> str:
    """The values of some tables, and the list of the tables."""
    if not fits:
        return ""
    text, rows = "", []
    for k, fit in enumerate(fits):
        values = fit.estimate if fit.prob is None else np.concatenate([fit.estimate, fit.prob])
        text += constants(f"@name_{name}_{k}_", values.ravel())
        own = f"@name_{name}_{k}_"
        if modes:
            text += constants(f"{own}m_", np.ravel(fit.mode), "signed char")
            own += f", {own}m_"
        used = [axes.index(axis) for axis in fit.axes] + [0] * (most + 1 - len(fit.axes))
        used = ", ".join(map(str, used))
        rows.append(f"    {{ {own}, {len(fit.axes)}, {{ {used} }} }}")
    return (
        text
        + f"static const @name_table @name_{name}[{len(fits)}] = {{\n"
        + (",\n".join(rows) + "\n};\n")
    )
