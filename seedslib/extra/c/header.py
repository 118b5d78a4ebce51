"""From a designed filter to one C99 header."""

# cppcheck 2.22 with its MISRA C:2012 add-on, on headers of all kinds in double, ones with gaps or
# inputs too, and on three in float, has no finding of its own but that loops
# with counters declared at the top could declare them later. Rules from which the C departs, why:
#
# required  2.2   sums with a zero and products with a one, which sizes of the model make of indices
#           9.3   { 0 } for a whole array
#           10.1, 10.3, 10.4, 10.8   truth as int in a choice; signed sizes times sizeof; 1 << axes
#           14.1, 14.2, 14.4   loops with two counters; isnan and isinf, which are int, as a test
#           15.6  bodies of one statement without braces
#           17.7  memcpy, memmove and memset, whose value is their first argument
# advisory  2.5, 8.9   codes and tables that only a caller, or one function, uses
#           12.1, 12.3   a ? b : c without brackets; several names in one declaration
#           13.3, 13.4, 17.8   *out++ = x, a = b = x for both halves of a matrix
#           15.5  early returns of what is refused
#           18.4  place + number, for parts of arrays

from __future__ import annotations

import os
from typing import Any

from seedslib.base.atomic import write_whole
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.memory import Memory
from seedslib.designed.output_filter import OutputFilter, TableFilter
from seedslib.designed.predictors import Continuous
from seedslib.designed.switching.filter import SwitchingFilter
from seedslib.extra.c.source import checked_name, comment, model_lines, named, single, tolerances
from seedslib.extra.c.traced import told_of
from seedslib.filters.covariance import CovarianceFilter
from seedslib.models.kinds import mentioned

_HEAD = """\
#ifndef @NAME_H
#define @NAME_H

#include <math.h>
#include <string.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "@name: wanted a compiler that keeps NaN; leave -ffast-math and -ffinite-math-only out"
#endif

#define @NAME_OK 0       /* what the functions return */
#define @NAME_END 1      /* no more measurement times in the design */
#define @NAME_INFINITE 2 /* a measurement that is infinite */
#define @NAME_PARTLY 3   /* a measurement of which only some components are there */
#define @NAME_TIME 4     /* a time that is not where it should be */
#define @NAME_RANGE 5    /* an indicator that is none */
#define @NAME_STRAY 6    /* a component that the schedule of the design leaves out */
#define @NAME_UNTOLD 7   /* inputs that are not told */

"""

_RULES = """\
Use: declare a @name_state, call @name_init, then @name_step for each measurement. It \
returns @NAME_OK, or why it refused; the state is then as before. \
A component of a measurement is NaN where it is missing. Compile with -ffp-contract=off to get \
the numbers of the Python library but for rounding; along a record the filter carries a difference \
on as it does any error of an estimate, and may make it larger. Never compile with -ffast-math or \
-ffinite-math-only."""

_REDUNDANT = """\
A component of the measurement is left out exactly where it is missing: zero innovation, unit \
pivot. One that the components before it determine (its pivot is at most 1e-13 of its variance, \
1e-6 in float) gets the gain zero and is not counted in loglik; the Python library uses the \
pseudo-inverse there, which is the same for measurements that do not contradict each other. A \
covariance of the measurement that is clearly indefinite gives NaN."""

_INPUTS = """ \
u holds the inputs: @WHICH. @name_step takes them for the forecast and for the correction; where \
they change at a measurement, call @name_predict with those that act until then, and @name_correct \
with those at that time."""

_MODES = """ \
A covariance that the correction leaves indefinite by rounding is not mended. An indicator is -1 \
where it is missing; what no mode can show says nothing, and loglik is minus infinity."""

_WHOLE = """\
A measurement is missing as a whole or not at all; where the tables end their last values are \
used. There is no likelihood; cov is the error covariance that the design found, NaN where the \
measurement is missing."""


def to_c(
    filter: FiniteOrderFilter | OutputFilter | SwitchingFilter | CovarianceFilter,
    path: str | os.PathLike[str] | None = None,
    name: str = "filter",
    real: str = "double",
) -> str:
    """Write a filter as a C99 header that needs <math.h> and <string.h> only.

    The tables of the design are constants, the formulas of the sensor and of the forecast are
    the library's own lines, recorded. All functions are ``static inline``. The header holds
    ``<name>_state``, ``<name>_init(state *)`` and

    - for a filter of finite order or a table
      ``<name>_step(state *, const double *y)``, one measurement, ``<name>_nodes(state *,
      double *out)``, the forecasts at the nodes up to the next measurement, and
      ``<name>_forecast(state *, double t, double *out)``, the forecast at any time up to then;
    - for a filter that carries a covariance ``<name>_step(state *, double t, const double *y)``,
      and its halves ``<name>_predict(state *, double t)`` and ``<name>_correct(state *,
      const double *y)``; of a model with inputs each has them, in the order of their names, as a
      last argument ``const double *u``. How long a step is the C finds by itself.

    All but the first return ``<NAME>_OK`` (zero) or why they refused, ``<name>_nodes`` a number.

    Parameters
    ----------
    filter : FiniteOrderFilter, TableFilter, SwitchingFilter or CovarianceFilter
        Affine, polynomial or continuous forecasts; `Taylor`, `ExactGaussian`, or with one mode a
        rule with points; the integrators with fixed steps. A design may go on for ever, or have
        sensors with schedules. A learned filter is read off as tables first, by its `tabulated`.
    path : path_like, optional
        Where to write the header as well.
    name : str
        Prefix of all names.
    real : {"double", "float"}
        What numbers are.

    Returns
    -------
    str
        The header. Equal filters give equal text.

    Raises
    ------
    TypeError, ValueError
        A filter or a part of it that has no C; the message says what is wanted.
    NoClosedForm
        A mean of the model has no closed form.

    Warns
    -----
    UserWarning
        A prior so wide that a variance loses its digits in C, which knows no noise apart.

    Notes
    -----
    Without contraction of products and sums (-ffp-contract=off) C and Python run the same lines
    and differ by the rounding of what Python leaves to BLAS and LAPACK. From the same state a
    forecast is the same within 1e-14 of the largest term of its sum, and the correction of the
    same forecast within 1e-13 of the largest value, where the covariance of the measurement is
    far from singular. Along a record a difference is carried on as any error of an estimate is: a
    filter that forgets its past keeps it small, one whose sensor leaves a direction almost unseen
    can make it a million times larger in a hundred steps. The same holds in Python of records
    filtered alone and in a batch.

    Where a component of a measurement is a function of those before it the gain is zero, while
    the library takes the pseudo-inverse: the same, unless the measurements contradict each other.

    Examples
    --------
    >>> from seedslib.extra import to_c
    >>> from seedslib.filters import extended_kalman
    >>> from seedslib import zoo
    >>> text = to_c(extended_kalman(zoo.van_der_pol()), name="oscillator")
    >>> "oscillator_step" in text
    True
    """
    name = checked_name(name)
    check_told(filter)
    if real not in ("double", "float"):
        raise ValueError(f"real: wanted double or float, got {real!r}")
    check_sensed(filter)
    macros, text, rule = _parts(filter)
    rules = [named(part, name) for part in (_RULES, rule)]
    dimensions = "".join(f"#define @NAME_{key} {value}\n" for key, value in macros.items())
    code = _HEAD + dimensions + tolerances(filter, real) + "\n" + text + "\n#endif\n"
    code = single(named(code, name)) if real == "float" else named(code, name)
    whole = comment([_described(filter), model_lines(filter.system), *rules]) + code
    if path is not None:
        write_whole(path, whole.encode("ascii"))
    return whole


def check_sensed(filter: Any) -> None:
    """Refuse a design that knows more of missing measurements than its C does.

    Raises
    ------
    ValueError
        A design with an availability, output functions with a schedule.
    """
    for name in ["availability"] + ["measured"] * isinstance(filter, OutputFilter):
        if getattr(filter, name, None) is not None:
            raise ValueError(f"filter: wanted a {type(filter).__name__} without `{name}` for C")


def check_told(filter: Any) -> None:
    """Refuse a model that is told what this kind of filter in C is not.

    Raises
    ------
    TypeError
        A memory of one's own, whose rule C does not know.
    ValueError
        Inputs of a filter with a design that evaluates them, inputs of one with modes.
    """
    memory = getattr(filter, "memory", None)
    if memory is not None and type(memory) is not Memory:
        raise TypeError(
            f"memory: wanted a Memory, got {type(memory).__name__}, whose rule C does not know"
        )
    system = getattr(filter, "system", None)
    roles = {p.role for p in mentioned(system)} - {"parameter"}
    if isinstance(filter, SwitchingFilter) and "input" in roles:
        raise ValueError("filter: wanted a model without inputs, C has none with modes")
    if isinstance(filter, FiniteOrderFilter) and "input" in roles:
        maps = [system.sensor]
        maps += [system.drift_map] if isinstance(filter.predictor, Continuous) else []
        if any(p.role == "input" for map in maps for p in map.mentions):
            raise ValueError(
                "filter: wanted a design whose inputs are in its forecasts alone, got some in "
                "what is evaluated: C has none there"
            )


def _parts(filter: Any) -> tuple[dict, str, str]:
    """Macros, C, and what people should know about this kind of filter."""
    if isinstance(filter, TableFilter):
        from seedslib.extra.c.tables import table_source

        return *table_source(filter), _WHOLE
    if isinstance(filter, CovarianceFilter):
        from seedslib.extra.c.covariance import covariance_source

        return *covariance_source(filter), _REDUNDANT + _told(filter)
    if isinstance(filter, SwitchingFilter):
        from seedslib.extra.c.switching import switching_source

        return *switching_source(filter), _REDUNDANT + _MODES
    if isinstance(filter, FiniteOrderFilter):
        from seedslib.extra.c.finite_order import finite_order_source

        return *finite_order_source(filter), _REDUNDANT
    hint = "; read it off as tables first: filter.tabulated(y=..., z=...)"
    raise TypeError(
        "filter: wanted a FiniteOrderFilter, a TableFilter, a SwitchingFilter or a "
        "CovarianceFilter, got "
        f"{type(filter).__name__}{hint if hasattr(filter, 'tabulated') else ''}"
    )


def _told(filter: Any) -> str:
    """What the inputs of a model are."""
    names = [str(p) for p in told_of(filter.system) if p.role == "input"]
    return _INPUTS.replace("@WHICH", ", ".join(names)) if names else ""


def _described(filter: Any) -> str:
    """The filter in words, its predicted errors included where it has some."""
    if not isinstance(filter, CovarianceFilter):
        return str(filter)
    lines = [f"Filter that carries mean and covariance: {filter.linearization}"]
    if filter.continuous:
        lines.append(f"  integrated   {filter.integrator}, steps of {filter.integration_step:g}")
    return "\n".join(lines)
