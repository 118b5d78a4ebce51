"""C of the filters that carry a covariance: extended Kalman and assumed-density filters."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from seedslib.base.checks import outside
from seedslib.base.correction import correct
from seedslib.extra.c.source import constants, function
from seedslib.extra.c.tape import Tape, literal
from seedslib.extra.c.traced import (
    check_formulas,
    corrected_outputs,
    map_moments,
    mean_rates,
    record_correction,
)
from seedslib.filters.covariance import CovarianceFilter
from seedslib.filters.integration import euler_step, rk4_step

_STEPS = {"rk4": rk4_step, "euler": euler_step}

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
/* Forecast to a time; the first call only says when the initial law holds. */
static inline int @name_predict(@name_state *s, double t)
{
    double z[@NAME_MOMENTS];
    int i, j, place = @NAME_STATE;
    if (!isfinite(t) || (s->started && t < s->t)) return @NAME_TIME;
    if (s->started && t > s->t) {
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

_INTEGRATE = """\
{
            const double steps = fmax(1.0, ceil((t - s->t) / @STEP - 1e-9));
            const double h = (t - s->t) / steps;
            double k;
            for (k = 0.0; k < steps; k += 1.0) @name_advance_(s->t + k * h, h, z);
        }"""

_STEP = """\
static inline int @name_correct(@name_state *s, const double *y)
{
    int i;
    if (!s->started) return @NAME_TIME;
    for (i = 0; i < @NAME_MEASUREMENT; i++) if (isinf(y[i])) return @NAME_INFINITE;
    @name_correct_(s->t, s, y);
    return @NAME_OK;
}

/* One measurement: forecast to its time and correction. NaN: component missing. */
static inline int @name_step(@name_state *s, double t, const double *y)
{
    int i, code;
    for (i = 0; i < @NAME_MEASUREMENT; i++) if (isinf(y[i])) return @NAME_INFINITE;
    code = @name_predict(s, t);
    if (code == @NAME_OK) @name_correct_(t, s, y);
    return code;
}
"""


def covariance_source(filter: CovarianceFilter) -> tuple[dict[Any, Any], str]:
    """Macros and C of a `CovarianceFilter`.

    Raises
    ------
    TypeError, ValueError
        Moments without formulas, adaptive steps.

    Warns
    -----
    UserWarning
        A prior so wide that its variances lose their digits by the first measurement.
    """
    system = filter.system
    check_formulas(filter.linearization, system)
    n, m = filter.n, system.sensor.size
    _look_at_prior(filter)
    macros = {"STATE": n, "MEASUREMENT": m, "MOMENTS": n * (n + 3) // 2}
    text = constants("@name_mean0", np.asarray(system.mean0, dtype=float))
    text += constants("@name_cov0", np.asarray(system.cov0, dtype=float))
    advance = "@name_advance_(s->t, z);  /* dynamics are those of the time they leave */"
    if filter.continuous:
        advance = _INTEGRATE.replace("@STEP", literal(filter.integration_step))
    parts = [
        text, _STATE, _motion(filter), _PREDICT.replace("@ADVANCE", advance), _correction(filter),
        _STEP,
    ]  # fmt: skip
    return macros, "\n".join(parts)


def _look_at_prior(filter: CovarianceFilter) -> None:
    """Warn of a prior so wide that C, which has no noise apart, loses what is left of it."""
    state = filter.predict(filter.initial(), 0.0)
    expected = filter.expect(state)
    plain = correct(state.mean, state.cov, expected.mean, expected)[1]
    right = np.diagonal(filter.correct(state, expected.mean).cov)
    lost = np.abs(np.diagonal(plain) - right) > ROUGH * right
    if lost.any():
        warnings.warn(
            f"cov0: in C the variance of x{int(np.argmax(lost)) + 1} loses its digits by the first "
            "measurement; wanted a narrower prior",
            stacklevel=outside(),
        )


def _motion(filter: CovarianceFilter) -> str:
    """C of one integration step, or of the step of a system in discrete time."""
    system, n, tape = filter.system, filter.n, Tape()
    z, t = tape.inputs("z[{}]", n * (n + 3) // 2), tape.inputs("t")[()]
    if filter.continuous:
        if filter.integrator not in _STEPS:
            raise ValueError(
                f"integrator: wanted rk4 or euler for C, whose steps are fixed, got "
                f"{filter.integrator!r}"
            )
        if not system.drift_map.symbolic:
            raise ValueError("system: wanted closed forms of its mean rates, got array functions")
        rate = mean_rates(filter.linearization, system)
        found = _STEPS[filter.integrator](rate, t, z, tape.inputs("h")[()])
        head = "void @name_advance_(double t, double h, double *z)"
    else:
        moments = map_moments(filter.linearization, system.dynamics)
        mean, _, cov = moments(t, z[:n], z[n:])
        found = [*mean, *cov[np.tril_indices(n)]]
        head = "void @name_advance_(double t, double *z)"
    outputs = {f"z[{k}]": part for k, part in enumerate(found)}
    unused = "    (void)t; (void)h;" if filter.continuous else "    (void)t;"
    return function(head, [unused, *tape.body(outputs)])


def _correction(filter: CovarianceFilter) -> str:
    tape, n = Tape(), filter.n
    y = tape.inputs("y[{}]", filter.system.sensor.size)
    mean, cov = tape.inputs("s->mean[{}]", n), tape.inputs("s->cov[{}][{}]", n, n)
    lower = cov[np.tril_indices(n)]
    moments = map_moments(filter.linearization, filter.system.sensor)
    moments = moments(tape.inputs("t")[()], mean, lower)
    found = record_correction(tape, mean, lower, y, moments, n, filter.system.sensor.period)
    head = "void @name_correct_(double t, @name_state *s, const double *y)"
    return function(head, ["    (void)t;", *tape.body(corrected_outputs(found))])
