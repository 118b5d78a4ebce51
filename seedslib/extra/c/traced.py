"""The lines of the library, recorded: moments of maps, the correction, integration steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from seedslib.base.circle import Periods
from seedslib.base.conditioning import LOG_2PI
from seedslib.base.linalg import ABSOLUTE, eliminate, symmetric
from seedslib.base.values import assigned
from seedslib.designed.finite_order import law_symbols
from seedslib.extra.c.tape import Number, Scalar, Tape
from seedslib.linearization.moments import Linearization
from seedslib.linearization.points import PointRule
from seedslib.models.kinds import mentioned
from seedslib.models.maps import StochasticMap


def check_formulas(linearization: Linearization, system: object) -> None:
    """Raise TypeError or ValueError where moments are no formulas, of a law or of a point."""
    if not (hasattr(linearization, "formulas") or isinstance(linearization, PointRule)):
        raise TypeError(
            f"linearization: wanted formulas or a rule with points to write in C, got "
            f"{linearization!r}"
        )
    if not written(system.sensor):
        raise ValueError("system: wanted symbolic expressions to write in C, got array functions")


def written(map: Any) -> bool:
    """Whether a map is given by expressions, or by matrices of them."""
    return map.symbolic or getattr(map, "formulas", None) is not None


def moments_source(
    tape: Tape,
    linearization: Linearization,
    map: StochasticMap,
    label: str,
    mean: Sequence[Any],
    lower: Sequence[Any],
    spread: bool = True,
    told: Sequence[Any] = (),
) -> tuple[str, list[str], tuple[Any, ...]]:
    """Moments of a map on a tape that has the time ``t``, by formulas or by points.

    Of a map that mentions inputs the tape has ``u`` and ``dt``, see `told_on`.

    Returns
    -------
    text : str
        C that must stand before the function that is recorded.
    lines : list of str
        C that this function begins with; it wants the law as arrays ``mean`` and ``lower``.
    moments : tuple
        E y, cov(x, y), cov y; the last None without `spread`.
    """
    if not map.symbolic:
        with told_on(tape, told):
            return "", [], _linear_moments(tape, map, mean, lower)
    if not isinstance(linearization, PointRule):
        evaluate = map_moments(linearization, map, spread)
        with told_on(tape, told):
            return "", [], evaluate(tape.inputs("t")[()], mean, lower)
    from seedslib.extra.c.points import point_moments
    from seedslib.extra.c.unrolled import few_points, unrolled_moments

    n, m = map.state_size, map.size
    if few_points(linearization, map):
        with told_on(tape, told):
            return "", [], unrolled_moments(tape, linearization, map, mean, lower, spread)
    size = m * (1 + n) + m * (m + 1) // 2
    found = tape.inputs("found[{}]", size)
    h, cross, cov = np.split(found, [m, m + n * m])
    moments = h, cross.reshape(n, m), symmetric(cov, m) if spread else None
    lines = [f"    double found[{size}];", f"    {label}_(t, mean, lower, found@WITH);"]
    return point_moments(linearization, map, label, spread, told), lines, moments


def _linear_moments(tape: Tape, map: Any, mean: Sequence[Any], lower: Sequence[Any]) -> Any:
    """Moments of a map by its matrices, A m + B u, P A' and A P A' + S."""
    import sympy

    from seedslib.models.codegen import compile_components

    slope, noise, push, inputs = map.formulas
    push = np.zeros((map.size, 0)) if push is None else push
    parts = [np.asarray(part, dtype=object) for part in (slope, noise, push)]
    entries = [*(e for part in parts for e in part.flat), *inputs[: push.shape[1]]]
    found = compile_components([sympy.Symbol("t")], entries)(tape.inputs("t")[()])
    A, S, B, u = np.split(np.array(found, dtype=object), np.cumsum([p.size for p in parts]))
    A, S, B = (part.reshape(p.shape) for part, p in zip((A, S, B), parts, strict=True))
    cross = symmetric(np.array(lower, dtype=object), map.state_size) @ A.T
    return A @ np.array(mean, dtype=object) + B @ u, cross, A @ cross + S


def told_of(system: Any) -> list[Any]:
    """What a model is told: inputs in the order of their names, then the elapsed time."""
    told = (p for p in mentioned(system) if p.role != "parameter")
    return sorted(told, key=lambda p: (p.role == "elapsed", str(p)))


def told_on(tape: Tape, told: Sequence[Any]) -> AbstractContextManager[None]:
    """Let inputs be what the C variable ``u`` holds, in their order, and the elapsed time ``dt``.

    C that is written within this has the marks ``@ALSO`` and ``@WITH`` for parameters and
    arguments behind the others, and ``@UNUSED``, which `telling` fills.
    """
    place = {p: "dt" if p.role == "elapsed" else f"u[{k}]" for k, p in enumerate(told)}
    return assigned({p: tape.inputs(name)[()] for p, name in place.items()})


def telling(text: str, told: Sequence[Any]) -> str:
    """C with the parameters for what a model is told; inputs come before the elapsed time."""
    roles = {p.role for p in told}
    known = [
        pair
        for role, pair in (("input", ("const double *", "u")), ("elapsed", ("double ", "dt")))
        if role in roles
    ]
    for mark, parts in (
        ("@ALSO", [f", {kind}{name}" for kind, name in known]),
        ("@WITH", [f", {name}" for _, name in known]),
        ("@UNUSED", [f" (void){name};" for _, name in known]),
    ):
        text = text.replace(mark, "".join(parts))
    return text


def map_moments(
    linearization: Linearization, map: StochasticMap, spread: bool = True
) -> Callable[..., tuple[Any, ...]]:
    """Moments of a map as ``f(t, mean, lower) -> (E y, cov(x, y), cov y)``, arrays of objects.

    `mean` and `lower` are components and entries of the covariance on and below the diagonal;
    cov y is None without `spread`.
    """
    from seedslib.models.codegen import compile_components

    n, m = map.state_size, map.size
    mean, lower, cov = law_symbols(n)
    parts = linearization.formulas(map, list(mean), cov, spread)
    flat = [entry for part in parts[: 2 + spread] for entry in part]
    evaluate = compile_components((map.time, mean, lower), flat)

    def moments(t: Scalar, mean: Sequence, lower: Sequence) -> tuple:
        found = np.array(evaluate(t, list(mean), list(lower)), dtype=object)
        h, cross, cov = np.split(found, [m, m + n * m])
        return h, cross.reshape(n, m), cov.reshape(m, m) if spread else None

    return moments


def mean_rates(linearization: Linearization, system: object) -> Callable[..., list[Any]]:
    """Rates of mean and covariance as ``f(t, components) -> list``, for the integrators."""
    from seedslib.models.codegen import compile_components

    n = system.state_size
    mean, lower, cov = law_symbols(n)
    velocity, change = linearization.rate_formulas(system, list(mean), cov)
    entries = [change[i, j] for i in range(n) for j in range(i + 1)]
    return compile_components((system.drift_map.time, (*mean, *lower)), [*velocity, *entries])


def record_correction(
    tape: Tape,
    mean: Sequence[Any],
    lower: Sequence[Any] | None,
    y: Sequence[Scalar],
    moments: tuple[Any, ...],
    rows: int,
    periods: Periods = (),
) -> tuple[Any, ...]:
    """Record the correction of the leading rows by a measurement of which parts may be missing.

    A missing component has a zero innovation and a unit pivot, which leaves it out exactly. A
    component that those before it determine has the gain zero; one whose variance given them is
    clearly negative gives NaN.

    Parameters
    ----------
    tape : Tape
    mean : sequence, length n
    lower : sequence
        Entries of the covariance on and below the diagonal, row by row; None where the corrected
        one is known.
    y : sequence of Scalar, length m
    moments : tuple
        E y (m,), cov(x, y) (n, m), cov y (m, m).
    rows : int
    periods : tuple
        Components of y on a circle, see `as_periods`.

    Returns
    -------
    mean : list, length `rows`
    cov : list of lists, or None
        On and below the diagonal.
    loglik : Scalar
        Of the components that were seen and are not redundant.
    shown : list
        The measurement, missing components filled with what was expected.
    """
    h, cross, spread = moments
    m, y = len(y), list(y)
    for k, period in periods:
        y[k] = y[k] - period * np.floor((y[k] - h[k]) / period + 0.5)
    seen = [tape.node("!isnan({0})", part, kind="int") for part in y]
    error = [tape.choose(seen[j], y[j] - h[j], 0.0) for j in range(m)]
    cross = [[tape.choose(seen[j], cross[k, j], 0.0) for j in range(m)] for k in range(rows)]
    both = [[_both(tape, seen[i], seen[j]) for j in range(i + 1)] for i in range(m)]
    spread = [
        [tape.choose(both[i][j], spread[i, j], 1.0 if i == j else 0.0) for j in range(i + 1)]
        for i in range(m)
    ]
    regular = []
    relative, absolute, indefinite = map(tape.macro, ("RELATIVE", "ABSOLUTE", "INDEFINITE"))

    def reciprocal(pivot: Number, variance: Number) -> tuple[Number, Number]:
        if not isinstance(pivot, Scalar):
            regular.append(pivot > ABSOLUTE)
            return (1.0 / pivot, pivot) if regular[-1] else (0.0, 1.0)
        least = absolute if pivot is variance else relative * variance + absolute
        regular.append(tape.infix(pivot, ">", least))
        redundant = tape.node(
            "{0} >= {1} ? 0.0 : (double)NAN", pivot, -(indefinite * variance + absolute)
        )
        inverse = tape.choose(regular[-1], 1.0 / pivot, redundant)
        return inverse, tape.choose(regular[-1], pivot, 1.0)

    mean = list(mean[:rows])
    cov = None
    if lower is not None:
        entries = iter(lower)
        cov = [[next(entries) for _ in range(k + 1)] for k in range(rows)]
    terms, pivots = eliminate(mean, cov, error, cross, spread, reciprocal)
    for a, b in zip(pivots[::2], pivots[1::2], strict=False):
        # one logarithm for two pivots where their product is a number
        pair = a * b
        terms.append(
            tape.node(
                "{0} > {1} && {0} < HUGE_VAL ? log({0}) : log({2}) + log({3})", pair, absolute, a, b
            )
            if isinstance(pair, Scalar)
            else np.log(a) + np.log(b)
        )
    terms += [np.log(p) for p in pivots[len(pivots) & ~1 :]]
    counted = [
        tape.node("{0} && {1} ? 1.0 : 0.0", a, b)
        if isinstance(b, Scalar)
        else tape.choose(a, 1.0 if b else 0.0, 0.0)
        for a, b in zip(seen, regular, strict=True)
    ]
    terms.append(reduce(add, counted) * LOG_2PI)
    shown = [tape.choose(seen[j], y[j], h[j]) for j in range(m)]
    return mean, cov, -0.5 * reduce(add, terms), shown


def _both(tape: Tape, first: Scalar, second: Scalar) -> Scalar:
    if first.name == second.name:
        return first
    return tape.node("{0} && {1}", first, second, kind="int")


def corrected_outputs(found: tuple[Any, ...], place: str = "s->") -> dict[Any, Any]:
    """Where a recorded correction is stored: mean, both halves of the covariance, likelihood."""
    mean, cov, loglik, _ = found
    outputs = {f"{place}mean[{k}]": part for k, part in enumerate(mean)}
    for k, row in enumerate(cov or ()):
        for q, part in enumerate(row):
            outputs[f"{place}cov[{k}][{q}]"] = part
            outputs[f"{place}cov[{q}][{k}]"] = part
    return {**outputs, f"{place}loglik": loglik}
