"""C of rules with points: factor of the covariance, a map at the points, weighted sums."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from seedslib.extra.c.source import constants, function
from seedslib.extra.c.tape import Tape, literal
from seedslib.extra.c.traced import told_on
from seedslib.extra.c.unrolled import point_space
from seedslib.linearization.points import PointRule
from seedslib.models.maps import StochasticMap

FACTOR = """\
/* Lower triangular L with L L' = P; a pivot that counts as zero gives a zero column, one that is
 * clearly negative, of the scale, NaN. */
static inline void @name_factor_(const double *lower, const double *scale,
                                 double root[@NAME_STATE][@NAME_STATE])
{
    int i, j, k;
    for (i = 0; i < @NAME_STATE; i++) {
        for (j = 0; j < @NAME_STATE; j++) {
            root[i][j] = j > i ? 0.0 : lower[i * (i + 1) / 2 + j];
        }
    }
    for (j = 0; j < @NAME_STATE; j++) {
        const double variance = fabs(lower[j * (j + 3) / 2]), pivot = root[j][j];
        double inverse = 0.0;
        if (pivot > @NAME_RELATIVE * variance + @NAME_ABSOLUTE) {
            root[j][j] = sqrt(pivot);
            inverse = 1.0 / root[j][j];
        } else if (pivot >= -@NAME_INDEFINITE * scale[j]) {
            root[j][j] = 0.0;
        } else {
            root[j][j] = inverse = (double)NAN;
        }
        for (i = j + 1; i < @NAME_STATE; i++) {
            root[i][j] = root[i][j] * inverse;
            for (k = j + 1; k <= i; k++) root[i][k] -= root[i][j] * root[k][j];
        }
    }
}
"""

SETTLE = """\
/* Without what rounding has left of directions that are known exactly. */
static inline void @name_settle_(const double *scale, @name_state *s)
{
    double lower[@NAME_STATE * (@NAME_STATE + 1) / 2], root[@NAME_STATE][@NAME_STATE];
    int i, j, k, zero = 0;
    for (i = 0; i < @NAME_STATE; i++) {
        for (j = 0; j <= i; j++) lower[i * (i + 1) / 2 + j] = s->cov[i][j];
    }
    @name_factor_(lower, scale, root);
    for (i = 0; i < @NAME_STATE; i++) if (root[i][i] == 0.0) zero = 1;
    for (i = 0; zero && i < @NAME_STATE; i++) {
        for (j = 0; j <= i; j++) {
            double sum = 0.0;
            for (k = 0; k <= j; k++) sum += root[i][k] * root[j][k];
            s->cov[i][j] = s->cov[j][i] = sum;
        }
    }
}
"""

_AT = """\
/* Points of the law N(mean, P), and the map at them. */
static inline void @LABEL_at_(double t, const double *mean, const double *lower,
                              double root[@NAME_STATE][@NAME_STATE], double y[@SPOTS][@WIDTH]@ALSO)
{
    double scale[@NAME_STATE], x[@NAME_STATE];
    int i, j, p;
    for (i = 0; i < @NAME_STATE; i++) scale[i] = fabs(lower[i * (i + 3) / 2]);
    @name_factor_(lower, scale, root);
    for (p = 0; p < @SPOTS; p++) {
        for (i = 0; i < @NAME_STATE; i++) x[i] = 0.0;
        for (j = 0; j < @NAME_STATE; j++) {
            const double w = @LABEL_unit[p][j];
            for (i = j; w != 0.0 && i < @NAME_STATE; i++) x[i] += root[i][j] * w;
        }
        for (i = 0; i < @NAME_STATE; i++) x[i] += mean[i];
        @LABEL_value_(t, x, @NOISE, y[p]@WITH);
    }
}
"""

_SLOPE = """\
    for (j = 0; j < @NAME_STATE; j++) {
        for (i = 0; i < @SIZE; i++) slope[j][i] = 0.0;
        for (p = 0; p < @SPOTS; p++) {
            const double w = @LABEL_unit[p][j] * @LABEL_square[p];
            for (i = 0; w != 0.0 && i < @SIZE; i++) slope[j][i] += w * y[p][i];
        }
    }
    for (k = 0; k < @NAME_STATE; k++) {
        for (i = 0; i < @SIZE; i++) {
            double sum = 0.0;
            for (j = 0; j <= k; j++) sum += root[k][j] * slope[j][i];
            cross[k * @SIZE + i] = sum;
        }
    }
"""

_MOMENTS = (
    """\
/* Mean of the map, its covariance with the state, its own on and below the diagonal. */
static inline void @LABEL_(double t, const double *mean, const double *lower, double *found@ALSO)
{
    double root[@NAME_STATE][@NAME_STATE], y[@SPOTS][@WIDTH], slope[@NAME_STATE][@SIZE];
    double *cross = found + @SIZE, *cov = cross + @NAME_STATE * @SIZE;
    int i, j, k, p;
    @LABEL_at_(t, mean, lower, root, y@WITH);
    @LABEL_fixed_(t, cov@WITH);
    for (i = 0; i < @SIZE; i++) {
        const double start = y[0][i];
        double sum = 0.0;
@CIRCLE        for (p = 0; p < @SPOTS; p++) sum += (y[p][i] - start) * @LABEL_weight[p];
        found[i] = start + sum;
        for (p = 0; p < @SPOTS; p++) y[p][i] -= found[i];
    }
"""
    + _SLOPE
    + """\
    for (p = 0; p < @SPOTS; p++) {
        for (i = 0, k = 0; i < @SIZE; i++) {
            const double w = y[p][i] * @LABEL_square[p];
            for (j = 0; j <= i; j++) cov[k++] += w * y[p][j];
        }
    }
@VARIED    (void)cross;
}
"""
)

_VARIED = """\
    for (k = @SIZE; k < @WIDTH; k++) {
        double sum = 0.0;
        for (p = 0; p < @SPOTS; p++) sum += y[p][k] * @LABEL_weight[p];
        cov[@LABEL_varied[k - @SIZE]] += sum;
    }
"""

_RATE = (
    """\
/* Rates of mean and covariance, z = (mean, covariance on and below the diagonal). */
static inline void @name_rate_(double t, const double *z, double *dz@ALSO)
{
    double root[@NAME_STATE][@NAME_STATE], y[@SPOTS][@WIDTH], cross[@NAME_STATE * @NAME_STATE];
    double slope[@NAME_STATE][@NAME_STATE];
    int i, j, k, p, place = @NAME_STATE;
    @LABEL_at_(t, z, z + @NAME_STATE, root, y@WITH);
    for (i = 0; i < @WIDTH; i++) {
        double sum = 0.0;
        for (p = 0; p < @SPOTS; p++) sum += y[p][i] * @LABEL_weight[p];
        dz[i] = sum;
        for (p = 0; i < @NAME_STATE && p < @SPOTS; p++) y[p][i] -= sum;
    }
"""
    + _SLOPE
    + """\
    for (i = 0; i < @NAME_STATE; i++) {
        for (j = 0; j <= i; j++) {
            dz[place++] += cross[i * @NAME_STATE + j] + cross[j * @NAME_STATE + i];
        }
    }
}
"""
)

_ADVANCE = {
    "euler": """\
static inline void @name_advance_(double t, double h, double *z@ALSO)
{
    double rate[@NAME_MOMENTS];
    int i;
    @name_rate_(t, z, rate@WITH);
    for (i = 0; i < @NAME_MOMENTS; i++) z[i] += h * rate[i];
}
""",
    "rk4": """\
static inline void @name_advance_(double t, double h, double *z@ALSO)
{
    double a[@NAME_MOMENTS], b[@NAME_MOMENTS], c[@NAME_MOMENTS], d[@NAME_MOMENTS];
    double moved[@NAME_MOMENTS];
    int i;
    @name_rate_(t, z, a@WITH);
    for (i = 0; i < @NAME_MOMENTS; i++) moved[i] = z[i] + 0.5 * h * a[i];
    @name_rate_(t + 0.5 * h, moved, b@WITH);
    for (i = 0; i < @NAME_MOMENTS; i++) moved[i] = z[i] + 0.5 * h * b[i];
    @name_rate_(t + 0.5 * h, moved, c@WITH);
    for (i = 0; i < @NAME_MOMENTS; i++) moved[i] = z[i] + h * c[i];
    @name_rate_(t + h, moved, d@WITH);
    for (i = 0; i < @NAME_MOMENTS; i++) {
        z[i] = z[i] + h / 6.0 * (a[i] + 2.0 * (b[i] + c[i]) + d[i]);
    }
}
""",
}


def point_moments(
    rule: PointRule, map: StochasticMap, label: str, spread: bool = True, told: Sequence[Any] = ()
) -> str:
    """C of ``<label>_(t, mean, lower, found)``: E y, cov(x, y) and cov y of a symbolic map.

    Without `spread` nothing random is added to y, and its covariance has no meaning.
    """
    n, m = map.state_size, map.size
    mean, cov, noise = point_space(map)
    unit, weight, square = rule.rule(n + (0 if noise is None else noise.size))
    state, lower = set(map.state), [cov[i, j] for i in range(m) for j in range(i + 1)]
    varied = [k for k, e in enumerate(lower) if getattr(e, "free_symbols", set()) & state]
    fixed = [0 if k in varied else e for k, e in enumerate(lower)] if spread else [0] * len(lower)
    varied = varied if spread else []
    text = _tables(label, unit[:n], weight, square)
    text += _map_source(label, map, [*mean, *(lower[k] for k in varied)], noise, told)
    if noise is not None:
        text += constants(f"{label}_noise", (noise.mean[:, None] + noise.root @ unit[n:]).T)
    tape = Tape()
    with told_on(tape, told):
        found = _evaluated((map.time,), fixed, tape.inputs("t")[()])
    lines = ["    (void)t;@UNUSED", *tape.body({f"cov[{k}]": e for k, e in enumerate(found)})]
    text += function(f"void {label}_fixed_(double t, double *cov@ALSO)", lines)
    if varied:
        text += constants(f"{label}_varied", varied, "int")
    text += _AT + _MOMENTS.replace("@VARIED", _VARIED if varied else "").replace(
        "@CIRCLE", "".join(map_ for map_ in _circles(map))
    )
    held = f"{label}_noise[p]" if noise is not None else "x"
    return _filled(text, label, unit.shape[1], m, m + len(varied), held)


def point_rates(rule: PointRule, system: Any, integrator: str, told: Sequence[Any]) -> str:
    """C of one integration step of mean and covariance of a jump-diffusion."""
    label, n = "@name_flow", system.state_size
    drift, spread = system.drift_map, system.spread_map
    unit, weight, square = rule.rule(n)
    text = _tables(label, unit, weight, square)
    text += _map_source(label, drift, [*drift.expressions, *spread.expressions], None, told)
    text += _AT + _RATE + _ADVANCE[integrator]
    return _filled(text, label, unit.shape[1], n, n + len(spread.expressions), "x")


def _tables(label: str, unit: np.ndarray, weight: np.ndarray, square: np.ndarray) -> str:
    text = constants(f"{label}_unit", unit.T) + constants(f"{label}_weight", weight)
    return text + constants(f"{label}_square", square)


def _filled(text: str, label: str, spots: int, size: int, width: int, noise: str) -> str:
    for mark, value in (
        ("@SPOTS", spots),
        ("@SIZE", size),
        ("@WIDTH", width),
        ("@NOISE", noise),
        ("@LABEL", label),
    ):
        text = text.replace(mark, str(value))
    return text


def _circles(map: StochasticMap) -> list[str]:
    """C that brings the values of circular components near the first one."""
    line = (
        "        for (p = 0; i == {0} && p < @SPOTS; p++) {{\n"
        "            y[p][i] -= {1} * floor((y[p][i] - start) / {1} + 0.5);\n        }}\n"
    )
    return [line.format(k, literal(period)) for k, period in map.period]


def _map_source(
    label: str, map: StochasticMap, expressions: list[Any], noise: Any, told: Sequence[Any]
) -> str:
    """C of a map at one point."""
    tape = Tape()
    t, x = tape.inputs("t")[()], tape.inputs("x[{}]", map.state_size)
    given, values = (map.time, tuple(map.state)), [t, list(x)]
    if noise is not None:
        given += (tuple(noise.symbols),)
        values.append(list(tape.inputs("v[{}]", noise.size)))
    with told_on(tape, told):
        found = _evaluated(given, expressions, *values)
    head = f"void {label}_value_(double t, const double *x, const double *v, double *y@ALSO)"
    lines = tape.body({f"y[{k}]": part for k, part in enumerate(found)})
    return function(head, ["    (void)t; (void)x; (void)v;@UNUSED", *lines])


def _evaluated(given: tuple[Any, ...], expressions: list[Any], *values: Any) -> list[Any]:
    from seedslib.models.codegen import compile_components

    return compile_components(given, expressions)(*values)
