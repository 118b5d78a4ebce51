"""C of the forecasts of a finite-order filter: affine, polynomial, continuous."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.predictors import CLIP, FLOOR, PolynomialFit, monomial_recipe, range_roots
from seedslib.extra.c.source import constants, function
from seedslib.extra.c.tape import Tape, literal
from seedslib.extra.c.traced import moments_source

_AHEAD = "static inline void @name_ahead_(int k, const double *u, double *mean, double *cov)\n{\n"

_AFFINE = (
    _AHEAD
    + """\
    int i, j;
    for (i = 0; i < @NAME_STATE; i++) {
        double sum = 0.0;
        for (j = 0; j < @NAME_MEMORY; j++) sum += @name_gain[k][i][j] * u[j];
        mean[i] = sum + @name_offset[k][i];
    }
    memcpy(cov, @name_cov[k], sizeof @name_cov[k]);
}
"""
)

_POWERS = """\
    double point[@NAME_MEMORY], power[@NAME_POWERS + 1];
    int i, j;
    for (i = 0; i < @NAME_MEMORY; i++) {
        const double p = (u[i] - @name_centre[k][i]) * @name_scale[k][i];
        point[i] = p < -CLIP ? -CLIP : p > CLIP ? CLIP : p;
    }
    power[0] = 1.0;
    for (j = 0; j < @NAME_POWERS; j++) {
        power[j + 1] = point[@name_factor[j]] * power[@name_lower[j]];
    }
    for (i = 0; i < @NAME_STATE; i++) {
        double sum = 0.0;
        for (j = 0; j < @NAME_MEAN_POWERS; j++) sum += @name_gain[k][i][j] * power[j + 1];
        mean[i] = sum + @name_offset[k][i];
    }
""".replace("CLIP", literal(CLIP))
"""Polynomials in the memory `u` by the fit `k`, to `mean`; with the tables of `_polynomials`."""

_CONSTANT_COV = """\
    memcpy(cov, @name_cov[k], sizeof @name_cov[k]);
}
"""

_POLYNOMIAL_COV = """\
    for (i = 0; i < @NAME_STATE * (@NAME_STATE + 1) / 2; i++) {
        double sum = 0.0;
        for (j = 0; j < @NAME_COV_POWERS; j++) sum += @name_cov_gain[k][i][j] * power[j + 1];
        cov[i] = sum + @name_cov_offset[k][i];
    }
    @name_floor_(@name_root[k], @name_back[k], cov);
}
"""

_FLOOR = """\
/* Eigenvalues of a covariance, in units of the mean one, are not let below FLOOR: Jacobi
 * rotations of back' cov back, then root V max(., FLOOR) V' root'. */
static inline void @name_floor_(const double root[@NAME_STATE][@NAME_STATE],
                                const double back[@NAME_STATE][@NAME_STATE], double *cov)
{
    double a[@NAME_STATE][@NAME_STATE], v[@NAME_STATE][@NAME_STATE];
    int i, j, p, q, sweep;
    for (p = 0; p < @NAME_STATE; p++) {
        for (q = 0; q <= p; q++) {
            double sum = 0.0;
            for (i = 0; i < @NAME_STATE; i++) {
                double inner = 0.0;
                for (j = 0; j < @NAME_STATE; j++) {
                    inner += cov[i > j ? i * (i + 1) / 2 + j : j * (j + 1) / 2 + i] * back[j][q];
                }
                sum += back[i][p] * inner;
            }
            a[p][q] = a[q][p] = sum;
            v[p][q] = v[q][p] = p == q ? 1.0 : 0.0;
        }
    }
    for (sweep = 0; sweep < 60; sweep++) {
        double off = 0.0, all = 0.0;
        for (p = 0; p < @NAME_STATE; p++) {
            all += a[p][p] * a[p][p];
            for (q = 0; q < p; q++) off += a[p][q] * a[p][q];
        }
        if (!(off > @NAME_TURNED * all)) break;
        for (p = 0; p < @NAME_STATE; p++) {
            for (q = 0; q < p; q++) {
                double turn, c, s;
                if (a[p][q] == 0.0) continue;
                turn = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                turn = (turn >= 0.0 ? 1.0 : -1.0) / (fabs(turn) + hypot(turn, 1.0));
                c = 1.0 / sqrt(turn * turn + 1.0);
                s = turn * c;
                for (i = 0; i < @NAME_STATE; i++) {
                    const double x = a[i][p], y = a[i][q];
                    a[i][p] = c * x - s * y;
                    a[i][q] = s * x + c * y;
                }
                for (i = 0; i < @NAME_STATE; i++) {
                    const double x = a[p][i], y = a[q][i], w = v[i][p], z = v[i][q];
                    a[p][i] = c * x - s * y;
                    a[q][i] = s * x + c * y;
                    v[i][p] = c * w - s * z;
                    v[i][q] = s * w + c * z;
                }
            }
        }
    }
    for (p = 0; p < @NAME_STATE; p++) {
        const double length = sqrt(a[p][p] < FLOOR ? FLOOR : a[p][p]);
        for (i = 0; i < @NAME_STATE; i++) {
            double sum = 0.0;
            for (q = 0; q < @NAME_STATE; q++) sum += root[i][q] * v[q][p];
            a[i][p] = sum * length;
        }
    }
    for (i = 0; i < @NAME_STATE; i++) {
        for (j = 0; j <= i; j++) {
            double sum = 0.0;
            for (p = 0; p < @NAME_STATE; p++) sum += a[i][p] * a[j][p];
            cov[i * (i + 1) / 2 + j] = sum;
        }
    }
}
"""

_MOVE = """\
/* One Euler step of the continuous forecast, so much later than in the design. */
static inline void @name_move_(int i, double later, double *z)
{
    double mean[@NAME_STATE], rate[@NAME_ESTIMATE];
    int k, j;
    for (k = 0; k < @NAME_STATE; k++) {
        double sum = 0.0;
        for (j = 0; j < @NAME_ESTIMATE; j++) sum += @name_course_gain[i][k][j] * z[j];
        mean[k] = sum + @name_course_offset[i][k];
    }
    @name_velocity_(@name_course_time[i] + later, mean, @name_course_cov[i], rate);
    for (k = 0; k < @NAME_ESTIMATE; k++) z[k] += @name_course_step[i] * rate[k];
}
"""


def held(filter: Any, step: int) -> np.ndarray:
    """Places in the full memory of the components that are there after step `step`."""
    memory, n, m = filter.memory, filter.components, filter.system.measurement_size
    estimates = np.arange(n * min(step + 1, memory.estimates))
    measured = n * memory.estimates + np.arange(m * min(step + 1, memory.measurements))
    return np.concatenate([estimates, measured])


def _spread_out(values: np.ndarray, places: Sequence[int] | np.ndarray, size: int) -> np.ndarray:
    """Columns put at their places among `size`, zeros elsewhere."""
    found = np.zeros((*values.shape[:-1], size))
    found[..., places] = values
    return found


def _lower(cov: np.ndarray) -> np.ndarray:
    return cov[np.tril_indices(len(cov))]


def ahead(filter: FiniteOrderFilter) -> tuple[str, dict[Any, Any]]:
    """C of the forecast for the next measurement, and macros that it wants."""
    order, fits = filter.order, [*enumerate(filter.fits)]
    if isinstance(fits[0][1], PolynomialFit):
        return _polynomial(filter, fits)
    gains = [_spread_out(fit.gain, held(filter, k), order) for k, fit in fits]
    text = constants("@name_gain", gains)
    text += constants("@name_offset", [fit.offset for _, fit in fits])
    text += constants("@name_cov", [_lower(fit.cov) for _, fit in fits])
    return text + _AFFINE, {}


def _polynomials(
    filter: Any, fits: list[tuple[int, PolynomialFit]], degree: int
) -> tuple[str, dict[Any, Any]]:
    """Tables of polynomial means after steps, and macros that they want.

    Parameters
    ----------
    filter : FiniteOrderFilter
    fits : list of (int, PolynomialFit)
        With the number of the step after which each one forecasts.
    degree : int
        Of the monomials that are formed.
    """
    order, size = filter.order, fits[0][1].mean_degree
    recipe, number = monomial_recipe(order, degree), _numbers(order, degree)
    macros = {"POWERS": len(recipe), "MEAN_POWERS": len(monomial_recipe(order, size))}
    tables: dict[str, list] = {key: [] for key in ("centre", "scale", "gain", "offset")}
    for k, fit in fits:
        there = held(filter, k)
        places = _places(number, there, degree)[: fit.gain.shape[1]]
        # what is not yet remembered has the scale zero and the gains zero
        tables["centre"].append(_spread_out(fit.centre, there, order))
        tables["scale"].append(_spread_out(fit.scale, there, order))
        tables["gain"].append(_spread_out(fit.gain, places, macros["MEAN_POWERS"]))
        tables["offset"].append(fit.offset)
    text = "".join(constants(f"@name_{key}", values) for key, values in tables.items())
    text += constants("@name_factor", [factor for factor, _ in recipe], "int")
    lower = [0 if lower is None else lower + 1 for _, lower in recipe]
    return text + constants("@name_lower", lower, "int"), macros


def _polynomial(
    filter: FiniteOrderFilter, fits: list[tuple[int, PolynomialFit]]
) -> tuple[str, dict[Any, Any]]:
    first, order = fits[0][1], filter.order
    degree = max(first.mean_degree, first.cov_degree)
    text, macros = _polynomials(filter, fits, degree)
    body = _AHEAD + _POWERS
    if not first.cov_degree:
        text += constants("@name_cov", [_lower(fit.residual) for _, fit in fits])
        return text + body + _CONSTANT_COV, macros
    number = _numbers(order, degree)
    macros["COV_POWERS"] = len(monomial_recipe(order, first.cov_degree))
    tables: dict[str, list] = {key: [] for key in ("cov_gain", "cov_offset", "root", "back")}
    for k, fit in fits:
        places = _places(number, held(filter, k), degree)[: fit.cov_gain.shape[1]]
        tables["cov_gain"].append(_spread_out(fit.cov_gain, places, macros["COV_POWERS"]))
        tables["cov_offset"].append(fit.cov_offset)
        root, back = (_square(part) for part in range_roots(fit.residual))
        tables["root"].append(root)
        tables["back"].append(back)
    text += "".join(constants(f"@name_{key}", values) for key, values in tables.items())
    body = _FLOOR.replace("FLOOR", literal(FLOOR)) + body
    return text + body + _POLYNOMIAL_COV, macros


def _places(number: dict[tuple, int], there: np.ndarray, degree: int) -> list[int]:
    """Numbers, among all monomials, of those of the components that are there."""
    return [number[tuple(there[list(powers)])] for powers in _numbers(len(there), degree)]


def _numbers(size: int, degree: int) -> dict[tuple, int]:
    """Number of each monomial, known by the places of its factors."""
    found: list[tuple] = []
    for factor, lower in monomial_recipe(size, degree):
        found.append((() if lower is None else found[lower]) + (factor,))
    return {powers: number for number, powers in enumerate(found)}


def _square(part: np.ndarray) -> np.ndarray:
    """Columns of zeros added: they have the eigenvalue zero and no weight."""
    return np.pad(part, ((0, 0), (0, len(part) - part.shape[1])))


def course(filter: FiniteOrderFilter) -> str:
    """C of the Euler steps of `Continuous` through all intervals, and where each one starts."""
    system, n = filter.system, filter.components
    tape = Tape()
    size = system.state_size
    mean, lower = tape.inputs("mean[{}]", size), tape.inputs("lower[{}]", size * (size + 1) // 2)
    before, first, (velocity, *_) = moments_source(
        tape, filter.linearization, system.drift_map, "@name_drift", mean, lower, spread=False
    )
    lines = tape.body({f"rate[{k}]": velocity[k] for k in range(n)})
    head = "void @name_velocity_(double t, const double *mean, const double *lower, double *rate)"
    times, sizes, starts = [], [], [0]
    for k, row in enumerate(filter.node_fits):
        end = filter.times[k + 1] if k < len(filter.fits) else filter.node_times[k][-1]
        stops = np.array([filter.times[k], *filter.node_times[k], end])[: len(row) + 1]
        times += stops[:-1].tolist()
        sizes += np.diff(stops).tolist()
        starts.append(len(times))
    starts += [len(times)] * (len(filter.times) + 1 - len(starts))
    fits = [fit for row in filter.node_fits for fit in row]
    text = constants("@name_course_start", starts, "int")
    text += constants("@name_course_time", times) + constants("@name_course_step", sizes)
    text += constants("@name_course_gain", [fit.gain for fit in fits])
    text += constants("@name_course_offset", [fit.offset for fit in fits])
    text += constants("@name_course_cov", [_lower(fit.cov) for fit in fits])
    unused = [*first, "    (void)t; (void)mean; (void)lower;"]
    return text + before + function(head, unused + lines) + _MOVE
