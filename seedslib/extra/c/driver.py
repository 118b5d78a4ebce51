"""C around an exported filter: what another program calls, one step or whole records."""

from __future__ import annotations

import re

import numpy as np

_ONE = """
#include <stddef.h>

/* Size of the state, and where its parts are; -1 where it has no such part. */
int api_layout(int i);
int api_layout(int i)
{
    static const int layout[] = { @LAYOUT };
    return layout[i];
}

void api_init(int count, f_state *s);
void api_init(int count, f_state *s)
{
    int i;
    for (i = 0; i < count; i++) f_init(&s[i]);
}

/* One measurement of each of some records, y component by component. */
int api_step(int count, const f_state *s, f_state *out, double t, const double *y,
             const long long *told@ALSO);
int api_step(int count, const f_state *s, f_state *out, double t, const double *y,
             const long long *told@ALSO)
{
    int i, j, code;
    double shown[F_MEASUREMENT]@ROOM;
    (void)t; (void)told;
    for (i = 0; i < count; i++) {
        out[i] = s[i];@CHECK
        for (j = 0; j < F_MEASUREMENT; j++) shown[j] = y[j * count + i];
@GIVEN        code = f_step(&out[i], @TIMEshown@TOLD1@WITH);
        if (code != F_OK) return code;
    }
    return F_OK;
}

/* Whole records: `wide` of them lie side by side in the arrays, `count` are run here. */
int api_fill(int count, long long wide, int times, const double *t, const long long *index,
             const double *y, const long long *told, double *mean, double *cov, double *loglik,
             double *prob, long long *mode, const double *u);
int api_fill(int count, long long wide, int times, const double *t, const long long *index,
             const double *y, const long long *told, double *mean, double *cov, double *loglik,
             double *prob, long long *mode, const double *u)
{
    f_state tile[@TILE]; /* some at a time, that lie side by side */
    double shown[F_MEASUREMENT]@ROOM;
    int first, i, j, k, code;
    (void)t; (void)told; (void)prob; (void)mode; (void)index; (void)u;
    for (first = 0; first < count; first += @TILE) {
        const int last = first + @TILE < count ? first + @TILE : count;
        for (i = first; i < last; i++) f_init(&tile[i - first]);
        for (k = 0; k < times; k++) for (i = first; i < last; i++) {
            f_state *s = &tile[i - first];
            const long long at = k * wide + i;
@BETWEEN            for (j = 0; j < F_MEASUREMENT; j++) {
                shown[j] = y[(k * (long long)F_MEASUREMENT + j) * wide + i];
            }
@STEP            if (code != F_OK) return code;
            for (j = 0; j < F_OUT; j++) mean[(k * (long long)F_OUT + j) * wide + i] = s->mean[j];
            for (j = 0; cov && j < F_OUT * F_OUT; j++) {
                cov[(k * (long long)(F_OUT * F_OUT) + j) * wide + i] = s->cov[j / F_OUT][j % F_OUT];
            }
            if (loglik) loglik[at] = s->loglik;
@MODES            (void)at;
        }
    }
    return F_OK;
}
"""

_ALONE = """
/* One record and nothing told: the time, then the measurement; three arguments are soon passed. */
int api_alone(const f_state *s, f_state *out, const double *given);
int api_alone(const f_state *s, f_state *out, const double *given)
{
    return api_step(1, s, out, given[0], given + 1, NULL);
}
"""

_BETWEEN = """\
            if (index[k] < 0) {
                double ahead[F_OUT];
                code = f_forecast(s, t[k], ahead);
                if (code != F_OK) return code;
                for (j = 0; j < F_OUT; j++) mean[(k * (long long)F_OUT + j) * wide + i] = ahead[j];
                for (j = 0; cov && j < F_OUT * F_OUT; j++) {
                    cov[(k * (long long)(F_OUT * F_OUT) + j) * wide + i] = (double)NAN;
                }
                if (loglik) loglik[at] = 0.0;
                continue;
            }
"""

_PROB = """\
            for (j = 0; prob && j < F_MODES; j++) {
                prob[(k * (long long)F_MODES + j) * wide + i] = s->prob[j];
            }
"""

_MODE = "            if (mode) mode[at] = s->mode;\n"

_HALVES = """
int api_predict(int count, const f_state *s, f_state *out, double t@ALSO);
int api_predict(int count, const f_state *s, f_state *out, double t@ALSO)
{@ALONE
    int i, code;
    for (i = 0; i < count; i++) {
        out[i] = s[i];
@GIVEN        code = f_predict(&out[i], t@WITH);
        if (code != F_OK) return code;
    }
    return F_OK;
}

int api_correct(int count, const f_state *s, f_state *out, const double *y@ALSO);
int api_correct(int count, const f_state *s, f_state *out, const double *y@ALSO)
{
    int i, j, code;
    double shown[F_MEASUREMENT]@ROOM;
    for (i = 0; i < count; i++) {
        out[i] = s[i];
        for (j = 0; j < F_MEASUREMENT; j++) shown[j] = y[j * count + i];
@GIVEN        code = f_correct(&out[i], shown@WITH);
        if (code != F_OK) return code;
    }
    return F_OK;
}
"""

_FORECAST = """
int api_forecast(int count, const f_state *s, double t, double *out);
int api_forecast(int count, const f_state *s, double t, double *out)
{
    double ahead[F_OUT];
    int i, j, code;
    for (i = 0; i < count; i++) {
        code = f_forecast(&s[i], t, ahead);
        if (code != F_OK) return code;
        for (j = 0; j < F_OUT; j++) out[j * count + i] = ahead[j];
    }
    return F_OK;
}
"""

_STEP = "            code = f_step(s, @RECORDshown@TOLD2);\n"

_TOLD_STEP = """\
            for (j = 0; j < F_INPUTS; j++) { /* what acts from the time before on */
                given[j] = u[((k > 0 ? k - 1 : 0) * (long long)F_INPUTS + j) * wide + i];
            }
            code = f_predict(s, t[k], given);
            for (j = 0; j < F_INPUTS; j++) given[j] = u[(k * (long long)F_INPUTS + j) * wide + i];
            if (code == F_OK) code = f_correct(s, shown, given);
"""

_GIVEN = "        for (j = 0; j < F_INPUTS; j++) given[j] = u[j * count + i];\n"

FIELDS = ("mean", "cov", "loglik", "prob", "mode", "t", "k", "started")
"""Parts of a state whose places a driver tells, behind the size of the whole."""


REFUSED = {
    1: "t: wanted at most the last measurement time",
    2: "y: wanted finite numbers or NaN, got an infinite one",
    3: "y: wanted all components of a measurement and what the memory keeps, got some missing",
    4: "t: wanted the next measurement time, or one after that of the state within 1e7 steps",
    5: "indicator: wanted one of the system, or -1 for a missing one",
    6: "y: wanted what the schedule of the design has, got a component of a measurement without it",
    7: "inputs: wanted values of the inputs of the model, got none",
}
"""What the codes of a step say, in words."""

TILE = 64
"""Records that are run together, so that what lies side by side is read together."""


def driver(text: str, later: str, slack: str) -> str:
    """The header with the functions that `seedslib.extra.compilation` calls; its prefix is ``f``.

    Parameters
    ----------
    text : str
        From `to_c`, with the name ``f``.
    later, slack : str
        C of what is to be added to the time of a step of the design, and how far another time
        may be from it; empty for filters without a design.
    """
    state = text[: text.index("} f_state;")].rpartition("typedef struct {")[2]
    known = {field: bool(re.search(rf"\b{field}(\[|;)", state)) for field in FIELDS}
    layout = [f"(int)offsetof(f_state, {field})" if known[field] else "-1" for field in FIELDS]
    timed = "double t, const double *y" in text
    told = "int indicator" in text
    between = " f_forecast(" in text
    inputs = "#define F_INPUTS " in text
    check = (
        ""
        if timed or not slack
        else (
            "\n        if (s[i].k < F_TIMES && !(fabs(t - (f_times[s[i].k]@LATER)) <= @SLACK)) {\n"
            "            return F_TIME;\n        }"
        )
    )
    more = _ONE + _ALONE * (not told and not inputs)
    more += _HALVES * (" f_predict(" in text) + _FORECAST * between
    for mark, part in (
        ("@STEP", _TOLD_STEP if inputs else _STEP),
        ("@ALSO", ", const double *u" * inputs),
        ("@ROOM", ", given[F_INPUTS]" * inputs),
        ("@GIVEN", _GIVEN * inputs),
        ("@WITH", ", given" * inputs),
        ("@ALONE", "\n    int j;\n    double given[F_INPUTS];" * inputs),
        ("@LAYOUT", ", ".join(["(int)sizeof(f_state)", *layout])),
        ("@CHECK", check),
        ("@TIME", "t, " * timed),
        ("@RECORD", "t[k], " * timed),
        ("@TOLD1", ", told ? (int)told[i] : -1" * told),
        ("@TOLD2", ", told ? (int)told[k * wide + i] : -1" * told),
        ("@BETWEEN", _BETWEEN * between),
        ("@MODES", _PROB * known["prob"] + _MODE * known["mode"]),
        ("@LATER", later),
        ("@SLACK", slack),
        ("@TILE", str(TILE)),
    ):
        more = more.replace(mark, part)
    size = "F_ESTIMATE" if "#define F_ESTIMATE " in text else "F_STATE"
    return f"{text}\n#define F_OUT {size}\n{more}"


def side_by_side(part: np.ndarray, wide: int, alone: bool) -> np.ndarray:
    """The same numbers, of which `wide` records lie side by side in memory."""
    if alone:
        return np.ascontiguousarray(part)
    steps = 8 * wide * np.cumprod((1, *part.shape[-2:0:-1]))[::-1]
    if part.strides == (*steps, 8):
        return part
    held = np.empty((*part.shape[:-1], wide), part.dtype)[..., : part.shape[-1]]
    held[...] = part
    return held
