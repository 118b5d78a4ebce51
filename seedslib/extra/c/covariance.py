"""C of the filters that carry a covariance: extended Kalman and assumed-density filters."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from seedslib.base.checks import outside
from seedslib.base.clock import MOST_STEPS
from seedslib.base.conditioning import update
from seedslib.base.values import looked_at
from seedslib.extra.c.points import FACTOR, SETTLE, point_rates
from seedslib.extra.c.source import constants, function
from seedslib.extra.c.tape import Tape, literal
from seedslib.extra.c.traced import (
    check_formulas,
    corrected_outputs,
    mean_rates,
    moments_source,
    record_correction,
    telling,
    told_of,
    told_on,
    written,
)
from seedslib.filters.covariance import STEPS, CovarianceFilter
from seedslib.linearization.moments import Linearization, Matrices
from seedslib.linearization.points import PointRule
from seedslib.linearization.taylor_and_exact import Taylor
from seedslib.models.kinds import mentioned

ROUGH = 1e-3
"""Part of a variance that rounding must not take."""

_STATE = """\
typedef struct {
    double t; /* time of the estimate */
    int started; /* whether it has one */
    double mean[@NAME_STATE]; /* estimate */
    double cov[@NAME_STATE][@NAME_STATE]; /* its covariance */
    double loglik; /* log-density of the last measurement */
} @name_state;

static inline void @name_init(@name_state *s)
{
    memset(s, 0, sizeof *s);
    memcpy(s->mean, @name_mean0, sizeof s->mean);
    memcpy(s->cov, @name_cov0, sizeof s->cov);
}
"""

_PREDICT = """\
/* Forecast to a time; the first call only says when the initial law holds.@LIMIT */
static inline int @name_predict(@name_state *s, double t@ALSO)
{
    double z[@NAME_MOMENTS];
    int i, j, place = @NAME_STATE;
@NONE    if (!isfinite(t) || (s->started && t < s->t)) return @NAME_TIME;
    if (s->started && t > s->t) {@LENGTH
        memcpy(z, s->mean, sizeof s->mean);
        for (i = 0; i < @NAME_STATE; i++) for (j = 0; j <= i; j++) z[place++] = s->cov[i][j];
        @ADVANCE
        memcpy(s->mean, z, sizeof s->mean);
        place = @NAME_STATE;
        for (i = 0; i < @NAME_STATE; i++) {
            for (j = 0; j <= i; j++) s->cov[i][j] = s->cov[j][i] = z[place++];
        }
    }
    s->t = t;
    s->started = 1;
    return @NAME_OK;
}
"""

_LIMIT = f"\n   One more than {MOST_STEPS} integration steps ahead is refused, the state as it was."

_INTEGRATE = """\
{
            const double steps = fmax(1.0, ceil((t - s->t) / @STEP - @NAME_SAME));
            const double h = (t - s->t) / steps;
            double k;
            if (!(steps <= @MOST)) return @NAME_TIME;
            for (k = 0.0; k < steps; k += 1.0) @name_advance_(s->t + k * h, h, z@WITH);
        }"""

_NONE = "    if (u == NULL) return @NAME_UNTOLD;\n"

_STEP = """\
static inline int @name_correct(@name_state *s, const double *y@ALSO)
{
    int i;
@NONE    if (!s->started) return @NAME_TIME;
    for (i = 0; i < @NAME_MEASUREMENT; i++) if (isinf(y[i])) return @NAME_INFINITE;
    @name_correct_(s->t, s, y@WITH);
    return @NAME_OK;
}

/* One measurement: forecast to its time and correction. NaN: component missing. */
static inline int @name_step(@name_state *s, double t, const double *y@ALSO)
{
    int i, code;
    for (i = 0; i < @NAME_MEASUREMENT; i++) if (isinf(y[i])) return @NAME_INFINITE;
    code = @name_predict(s, t@WITH);
    if (code == @NAME_OK) @name_correct_(t, s, y@WITH);
    return code;
}
"""


def covariance_source(filter: CovarianceFilter) -> tuple[dict[Any, Any], str]:
    """Macros and C of a `CovarianceFilter`.

    Raises
    ------
    TypeError, ValueError
        Moments without formulas.

    Warns
    -----
    UserWarning
        A prior so wide that its variances lose their digits by the first measurement.
    """
    system = filter.system
    if getattr(system, "diffuse", ()):
        raise ValueError("system: wanted a first state with a law to write in C, got a diffuse one")
    check_formulas(_rule(filter), system)
    if not filter.continuous and not written(system.dynamics):
        raise ValueError("system: wanted symbolic expressions to write in C, got array functions")
    n, m = filter.n, system.sensor.size
    _look_at_prior(filter)
    macros = {"STATE": n, "MEASUREMENT": m, "MOMENTS": n * (n + 3) // 2}
    text = constants("@name_mean0", np.asarray(system.mean0, dtype=float))
    text += constants("@name_cov0", np.asarray(system.cov0, dtype=float))
    advance = "@name_advance_(s->t, z@WITH);  /* dynamics are those of the time they leave */"
    limit = ""
    if filter.continuous:
        advance = _INTEGRATE.replace("@STEP", literal(filter.integration_step))
        advance, limit = advance.replace("@MOST", literal(float(MOST_STEPS))), _LIMIT
    told = told_of(system)
    sensed = [p for p in told if p.role == "input"]
    if sensed:
        macros["INPUTS"] = len(sensed)
    predict = _PREDICT.replace("@ADVANCE", advance).replace("@LIMIT", limit)
    # what is told from outside, and the length of a step, which is found inside
    first, _, rest = predict.partition("@LENGTH")
    length = "\n        const double dt = t - s->t;" if len(told) > len(sensed) else ""
    predict = telling(first, sensed) + length + telling(rest, told)
    by_points = isinstance(_rule(filter), PointRule)
    parts = [
        text,
        _STATE,
        FACTOR * by_points,
        SETTLE * by_points,
        telling(_motion(filter, told), told),
        predict,
        telling(_correction(filter, sensed), sensed),
        telling(_STEP, sensed),
    ]
    return macros, "\n".join(parts).replace("@NONE", _NONE if sensed else "")


def _rule(filter: CovarianceFilter) -> Linearization:
    """The linearization; of the matrices of a linear system the one that is exact for them."""
    linear = isinstance(filter.linearization, Matrices)
    return Taylor() if linear else filter.linearization


def _look_at_prior(filter: CovarianceFilter) -> None:
    """Warn of a prior so wide that C, which has no noise apart, loses what is left of it."""
    state = filter.predict(filter.initial(), 0.0)
    with looked_at(mentioned(filter.system)):
        expected = filter.expect(state)
        plain = update(state.mean, state.cov, expected.mean, expected)[1]
        right = np.diagonal(filter.correct(state, expected.mean).cov)
    lost = np.abs(np.diagonal(plain) - right) > ROUGH * right
    if lost.any():
        warnings.warn(
            f"cov0: in C the variance of x{int(np.argmax(lost)) + 1} loses its digits by the first "
            "measurement; wanted a narrower prior",
            stacklevel=outside(),
        )


def _motion(filter: CovarianceFilter, told: list[Any]) -> str:
    """C of one integration step, or of the step of a system in discrete time."""
    system, n, tape, rule = filter.system, filter.n, Tape(), _rule(filter)
    if not filter.continuous:
        mean = tape.inputs("z[{}]", n)
        lower = tape.inputs(f"z[{n} + {{}}]", n * (n + 1) // 2)
        text, lines, (mean, _, cov) = moments_source(
            tape, rule, system.dynamics, "@name_dynamics", mean, lower, told=told
        )
        found = [*mean, *cov[np.tril_indices(n)]]
        stores = tape.body({f"z[{k}]": part for k, part in enumerate(found)})
        if lines:
            lines.insert(1, f"    const double *mean = z, *lower = z + {n};")
        head = "void @name_advance_(double t, double *z@ALSO)"
        return text + function(head, [*lines, "    (void)t;@UNUSED", *stores])
    if not system.drift_map.symbolic:
        raise ValueError("system: wanted closed forms of its mean rates, got array functions")
    if isinstance(rule, PointRule):
        return point_rates(rule, system, filter.integrator, told)
    z, t = tape.inputs("z[{}]", n * (n + 3) // 2), tape.inputs("t")[()]
    with told_on(tape, told):
        found = STEPS[filter.integrator](mean_rates(rule, system), t, z, tape.inputs("h")[()])
    stores = tape.body({f"z[{k}]": part for k, part in enumerate(found)})
    head = "void @name_advance_(double t, double h, double *z@ALSO)"
    return function(head, ["    (void)t; (void)h;@UNUSED", *stores])


_BEFORE = """\
    double scale[@NAME_STATE];
    int i;
    for (i = 0; i < @NAME_STATE; i++) scale[i] = s->cov[i][i];"""

_PACK = """\
    double lower[@NAME_STATE * (@NAME_STATE + 1) / 2];
    const double *mean = s->mean;
    int j;"""

_PACKED = """\
    for (i = 0; i < @NAME_STATE; i++) {
        for (j = 0; j <= i; j++) lower[i * (i + 1) / 2 + j] = s->cov[i][j];
    }"""


def _correction(filter: CovarianceFilter, told: list[Any]) -> str:
    tape, n, sensor = Tape(), filter.n, filter.system.sensor
    y = tape.inputs("y[{}]", sensor.size)
    mean, cov = tape.inputs("s->mean[{}]", n), tape.inputs("s->cov[{}][{}]", n, n)
    text, lines, moments = moments_source(
        tape, _rule(filter), sensor, "@name_sensor", mean, cov[np.tril_indices(n)], told=told
    )
    found = record_correction(tape, mean, cov[np.tril_indices(n)], y, moments, n, sensor.period)
    stores, last = tape.body(corrected_outputs(found)), []
    if isinstance(_rule(filter), PointRule):
        lines = [*lines[:1], _PACK, _BEFORE, _PACKED, *lines[1:]] if lines else [_BEFORE]
        last = ["    @name_settle_(scale, s);"]
    head = "void @name_correct_(double t, @name_state *s, const double *y@ALSO)"
    return text + function(head, [*lines, "    (void)t;@UNUSED", *stores, *last])
