"""C of a finite-order filter: first estimate, forecasts, correction, the step that joins them."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.predictors import AffineFit, Continuous, PolynomialFit
from seedslib.extra.c.forecasts import ahead, course, held
from seedslib.extra.c.points import FACTOR
from seedslib.extra.c.records import STATE, between, frame, going_on, losing, push, schedule
from seedslib.extra.c.source import constants, function
from seedslib.extra.c.tape import Tape
from seedslib.extra.c.traced import (
    check_formulas,
    corrected_outputs,
    moments_source,
    record_correction,
    telling,
)
from seedslib.linearization.points import PointRule

STEP = """\
/* One measurement: forecast from the memory, correction, memory. NaN: component missing. */
static inline int @name_step(@name_state *s, const double *y)
{
    double u[@NAME_MEMORY], mean[@NAME_STATE], cov[@NAME_STATE * (@NAME_STATE + 1) / 2];
    const int gap = isnan(s->cov[0][0]); /* the design knows no gaps */
    int i, lost = gap;@ENDS
    for (i = 0; i < @NAME_MEASUREMENT; i++) {
        if (isinf(y[i])) return @NAME_INFINITE;
@LOST
    }
    if (s->k == 0) {
        @name_first_(s, y);
    } else {
        memcpy(u, s->memory, sizeof u);
        @ARRIVE@name_ahead_(s->k - 1, u, mean, cov);
        @name_correct_(@name_times[s->k]@LATER, mean, cov, s, y);
    }
    if (gap) s->loglik = (double)NAN;
    for (i = 0; lost && i < @NAME_ESTIMATE * @NAME_ESTIMATE; i++) {
        s->cov[(int)(i / @NAME_ESTIMATE)][i % @NAME_ESTIMATE] = (double)NAN;
    }
    @name_push_(s);
    s->k++;@LAP
    return @NAME_OK;
}
"""

NODES = """\
/* Forecasts of the estimated components at the nodes from the last measurement to the next,
 * at @name_node_times[@name_node_start[s->k - 1]]@LATER and on. Returns their number. */
static inline int @name_nodes(const @name_state *s, double *out)
{
    int i, j, n;
    if (s->k == 0) return 0;
    for (n = @name_node_start[s->k - 1]; n < @name_node_start[s->k]; n++) {
        for (i = 0; i < @NAME_ESTIMATE; i++) {
            double sum = 0.0;
            for (j = 0; j < @NAME_MEMORY; j++) sum += @name_node_gain[n][i][j] * s->memory[j];
            *out++ = sum + @name_node_offset[n][i];
        }
    }
    return @name_node_start[s->k] - @name_node_start[s->k - 1];
}
"""

COURSE_NODES = """\
/* Forecasts of the estimated components at the nodes from the last measurement to the next,
 * at @name_node_times[@name_node_start[s->k - 1]]@LATER and on. Returns their number. */
static inline int @name_nodes(const @name_state *s, double *out)
{
    double z[@NAME_MEMORY];
    int count, i;
    if (s->k == 0) return 0;
    count = @name_node_start[s->k] - @name_node_start[s->k - 1];
    memcpy(z, s->memory, sizeof z);
    for (i = 0; i < count; i++) {
        @name_move_(@name_course_start[s->k - 1] + i, 0.0@LATER, z);
        memcpy(out + i * @NAME_ESTIMATE, z, sizeof z);
    }
    return count;
}
"""

END = """\
static inline void @name_end_(const @name_state *s, double *out)
{
    double u[@NAME_MEMORY], mean[@NAME_STATE], cov[@NAME_STATE * (@NAME_STATE + 1) / 2];
    memcpy(u, s->memory, sizeof u);
    @name_ahead_(s->k - 1, u, mean, cov);
    memcpy(out, mean, @NAME_ESTIMATE * sizeof *out);
}
"""

COURSE_END = """\
static inline void @name_end_(const @name_state *s, double *out)
{
    int i;
    memcpy(out, s->memory, sizeof s->memory);
    for (i = @name_course_start[s->k - 1]; i < @name_course_start[s->k]; i++) {
        @name_move_(i, 0.0@LATER, out);
    }
}
"""

_COURSE_ARRIVE = """\
for (i = @name_course_start[s->k - 1]; i < @name_course_start[s->k]; i++) {
            @name_move_(i, 0.0@LATER, u);
        }
        """


def finite_order_source(filter: FiniteOrderFilter) -> tuple[dict[Any, Any], str]:
    """Macros and C of a `FiniteOrderFilter`.

    Raises
    ------
    TypeError, ValueError
        Forecasts or moments that have no C, see `seedslib.extra.to_c`.
    """
    check_formulas(filter.linearization, filter.system)
    kinds = {type(fit) for fit in filter.fits}
    if not kinds or not kinds <= {AffineFit, PolynomialFit}:
        raise TypeError(
            "predictor: wanted affine or polynomial forecasts for at least two measurements, got "
            f"{filter.predictor}, {len(filter.fits)} forecasts"
        )
    continuous = isinstance(filter.predictor, Continuous)
    text, macros = ahead(filter)
    if isinstance(filter.linearization, PointRule):
        text += FACTOR
    if continuous:
        text += course(filter)
    arrive = _COURSE_ARRIVE if continuous else ""
    common, timing = frame(filter)
    text = "\n".join(
        [
            timing,
            schedule(filter),
            text,
            STATE,
            _first(filter),
            _correction(filter),
            push(filter),
            STEP.replace("@ARRIVE", arrive).replace("@LOST", losing(filter)[0]),
            COURSE_NODES if continuous else _nodes(filter),
            COURSE_END if continuous else END,
            between(filter),
        ]
    )
    return {**common, **macros}, going_on(filter, telling(text, ()))


def _first(filter: FiniteOrderFilter) -> str:
    """C of the estimate from the first measurement, whose moments are fixed."""
    start, tape = filter.start, Tape()
    n, m, rows = len(start.mean), len(start.moments.mean), filter.components
    y = tape.inputs("y[{}]", m)
    moments = (
        tape.inputs("@name_first_sensor[{}]", m),
        tape.inputs("@name_first_cross[{}][{}]", n, m),
        tape.inputs("@name_first_spread[{}][{}]", m, m),
    )
    mean = tape.inputs("@name_first_mean[{}]", n)
    text = constants("@name_first_mean", start.mean)
    # it depends on no number of a measurement, only on which the design knows to be missing
    first = filter.predict(filter.initial(), filter.times[0])
    shown = np.zeros(m) if filter.measured is None else np.where(filter.measured[0], 0.0, np.nan)
    text += constants("@name_first_cov", filter.correct(first, shown).cov)
    text += constants("@name_first_sensor", start.moments.mean)
    text += constants("@name_first_cross", start.moments.cross)
    text += constants("@name_first_spread", start.moments.cov)
    found = record_correction(tape, mean, None, y, moments, rows, filter.rules.periods)
    head = "void @name_first_(@name_state *s, const double *y)"
    known = "    memcpy(s->cov, @name_first_cov, sizeof s->cov);"
    return text + function(head, [known, *tape.body(_stored(found))])


def _correction(filter: FiniteOrderFilter) -> str:
    """C of the moments of the sensor and the correction, in one straight line."""
    tape, n, m = Tape(), len(filter.start.mean), filter.system.sensor.size
    y = tape.inputs("y[{}]", m)
    mean, lower = tape.inputs("mean[{}]", n), tape.inputs("lower[{}]", n * (n + 1) // 2)
    text, lines, moments = moments_source(
        tape, filter.linearization, filter.system.sensor, "@name_sensor", mean, lower
    )
    kept, periods = filter.components, filter.rules.periods
    found = record_correction(tape, mean, lower, y, moments, kept, periods)
    head = (
        "void @name_correct_(double t, const double *mean, const double *lower, @name_state *s,\n"
        "                                 const double *y)"
    )
    return text + function(head, [*lines, "    (void)t;", *tape.body(_stored(found))])


def _stored(found: tuple) -> dict:
    shown = {f"s->shown[{j}]": part for j, part in enumerate(found[3])}
    return {**corrected_outputs(found), **shown}


def _nodes(filter: FiniteOrderFilter) -> str:
    """C of the affine forecasts at the nodes."""
    order, rows = filter.order, [(k, fit) for k, row in enumerate(filter.node_fits) for fit in row]
    gain = np.zeros((max(1, len(rows)), filter.components, order))
    offset = np.zeros(gain.shape[:2])
    for i, (k, fit) in enumerate(rows):
        gain[i][:, held(filter, k)], offset[i] = fit.gain, fit.offset
    text = constants("@name_node_gain", gain) + constants("@name_node_offset", offset)
    return text + NODES
