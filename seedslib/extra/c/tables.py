"""C of a filter whose functions are tables: multilinear interpolation, constant at the ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from seedslib.base.tables import Axis
from seedslib.designed.outputs.lookup import Table
from seedslib.designed.outputs.table import TableFilter
from seedslib.extra.c.records import STATE, between, frame, going_on, push
from seedslib.extra.c.source import constants
from seedslib.extra.c.tape import literal

_TYPES = """\
typedef struct {
    double low, high, scale; /* ends, nodes per unit */
    int count;               /* nodes */
} @name_axis;

typedef struct {
    const double *values;
    int axes, axis[@NAME_AXES]; /* their number, and which ones */
} @name_table;
"""

_LOOKUP = """\
/* Multilinear interpolation, the values at the ends beyond them. */
static inline void @name_lookup_(const @name_table *table, const double *point, double *out)
{
    double share[@NAME_AXES], value[1 << @NAME_AXES];
    int place[1 << @NAME_AXES] = { 0 }, corner, i, k, size = 1;
    for (k = 0; k < table->axes; k++) {
        const @name_axis *axis = &@name_axes[table->axis[k]];
        double p = point[k];
        int below;
        p = ((p < axis->low ? axis->low : p > axis->high ? axis->high : p) - axis->low)
            * axis->scale;
        below = p < axis->count - 2 ? (int)p : axis->count - 2;
        share[k] = p - below < 1.0 ? p - below : 1.0;
        size *= axis->count;
        for (corner = 0; corner < 1 << table->axes; corner++) {
            const int up = corner >> (table->axes - 1 - k) & 1;
            place[corner] = place[corner] * axis->count + below + up;
        }
    }
    for (i = 0; i < @NAME_ESTIMATE; i++) {
        for (corner = 0; corner < 1 << table->axes; corner++) {
            value[corner] = table->values[i * size + place[corner]];
        }
        for (k = table->axes - 1; k >= 0; k--) { /* neighbours on the last axis come first */
            for (corner = 0; corner < 1 << k; corner++) {
                const double low = value[2 * corner];
                value[corner] = low + share[k] * (value[2 * corner + 1] - low);
            }
        }
        out[i] = value[0];
    }
}

/* What is remembered after `k` measurements, without the places that are not yet taken. */
static inline void @name_held_(const @name_state *s, int k, double *out)
{
    const int estimates = k < @NAME_HELD_ESTIMATES ? k : @NAME_HELD_ESTIMATES;
    const int measurements = k < @NAME_HELD_MEASUREMENTS ? k : @NAME_HELD_MEASUREMENTS;
    memcpy(out, s->memory, (size_t)(estimates * @NAME_ESTIMATE) * sizeof *out);
    memcpy(out + estimates * @NAME_ESTIMATE,
           s->memory + @NAME_HELD_ESTIMATES * @NAME_ESTIMATE,
           (size_t)(measurements * @NAME_MEASUREMENT) * sizeof *out);
}
"""

_STEP = """\
/* One measurement; NaN in all components where it is missing. */
static inline int @name_step(@name_state *s, const double *y)
{
    double point[@NAME_AXES] = { 0.0 };
    const int gap = isnan(s->cov[0][0]); /* the design knows no gaps */
    int i, missing = 0;@ENDS
    for (i = 0; i < @NAME_MEASUREMENT; i++) {
        if (isinf(y[i])) return @NAME_INFINITE;
        if (isnan(y[i])) missing++;
    }
    if (missing && (missing < @NAME_MEASUREMENT || @NAME_HELD_MEASUREMENTS)) return @NAME_PARTLY;
    if (missing) {
        if (s->k == 0) {
            memcpy(s->mean, @name_first_mean, sizeof s->mean);
        } else {
            @name_held_(s, s->k, point);
            @name_lookup_(&@name_ahead[s->k - 1], point, s->mean);
        }
    } else {
        memcpy(point, y, sizeof s->shown);
        @name_held_(s, s->k, point + @NAME_MEASUREMENT);
        @name_lookup_(&@name_output[s->k], point, s->mean);
    }
    memcpy(s->shown, y, sizeof s->shown);
    for (i = 0; i < @NAME_ESTIMATE * @NAME_ESTIMATE; i++) {
        const int p = i / @NAME_ESTIMATE, q = i % @NAME_ESTIMATE;
        s->cov[p][q] = missing || gap ? (double)NAN : @name_cov[s->k][p][q];
    }
    s->loglik = (double)NAN;
    @name_push_(s);
    s->k++;@LAP
    return @NAME_OK;
}
"""

_NODES = """\
/* Forecasts at the nodes from the last measurement to the next, at
 * @name_node_times[@name_node_start[s->k - 1]]@LATER and on. Returns their number. */
static inline int @name_nodes(const @name_state *s, double *out)
{
    double point[@NAME_AXES] = { 0.0 };
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
    double point[@NAME_AXES] = { 0.0 };
    @name_held_(s, s->k, point);
    @name_lookup_(&@name_ahead[s->k - 1], point, out);
}
"""


def table_source(filter: TableFilter) -> tuple[dict[Any, Any], str]:
    """Macros and C of a `TableFilter`.

    Raises
    ------
    TypeError, ValueError
        Functions that are no tables, or only one measurement.
    """
    nodes = [fit for row in filter.node_fits for fit in row]
    outputs, ahead = zip(*filter.steps, strict=True)
    first, *ahead = ahead
    tables = [*outputs, *ahead, *nodes]
    others = {type(fit).__name__ for fit in tables if not isinstance(fit, Table)}
    if others or not ahead:
        raise TypeError(
            "filter: wanted tables over evenly spaced axes, for at least two measurements, got "
            f"{', '.join(sorted(others)) or len(outputs)}"
        )
    macros, timing = frame(filter)
    axes = list(dict.fromkeys(axis for fit in tables for axis in fit.axes))
    m = filter.system.measurement_size
    macros["AXES"] = m + filter.order
    macros["HELD_ESTIMATES"] = filter.memory.estimates
    macros["HELD_MEASUREMENTS"] = filter.memory.measurements
    rows = [
        f"    {{ {literal(a.low)}, {literal(a.high)}, {literal(1.0 / a.step)}, {a.count} }}"
        for a in axes
    ]
    text = f"static const @name_axis @name_axes[{len(axes)}] = {{\n" + ",\n".join(rows) + "\n};\n"
    for name, fits in (("output", outputs), ("ahead", ahead), ("node", nodes)):
        text += _tables(name, fits, axes, macros["AXES"])
    text += constants("@name_first_mean", first.estimate)
    text += constants("@name_cov", filter.covariances)
    lookup = "@name_lookup_(&@name_node[n], point, out);" if nodes else ""
    text = "\n".join([
        timing, _TYPES, text, STATE, _LOOKUP, push(filter), _STEP,
        _NODES.replace("@LOOKUP", lookup), between(filter),
    ])  # fmt: skip
    return macros, going_on(filter, text)


def _tables(name: str, fits: Sequence[Table], axes: list[Axis], most: int) -> str:
    """The values of some tables, and the list of the tables."""
    if not fits:
        return ""
    text, rows = "", []
    for k, fit in enumerate(fits):
        text += constants(f"@name_{name}_{k}_", fit.estimate.ravel())
        used = [axes.index(axis) for axis in fit.axes] + [0] * (most - len(fit.axes))
        used = ", ".join(map(str, used))
        rows.append(f"    {{ @name_{name}_{k}_, {len(fit.axes)}, {{ {used} }} }}")
    return (
        text
        + f"static const @name_table @name_{name}[{len(fits)}] = {{\n"
        + (",\n".join(rows) + "\n};\n")
    )
