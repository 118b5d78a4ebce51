"""The program of a filter: filters that carry mean and covariance, and the table of all kinds."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from seedslib.base.checks import outside
from seedslib.base.clock import MOST_STEPS, SAME
from seedslib.base.conditioning import update
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.switching import SwitchingFilter
from seedslib.designed.tables import TableFilter
from seedslib.export.designs import finite_order, table
from seedslib.export.kernels import (
    correct,
    lower_of,
    map_moments,
    moment_rates,
    settled,
    unpacked,
)
from seedslib.export.modes import switching
from seedslib.export.step import Step
from seedslib.filters.covariance import STEPS, CovarianceFilter
from seedslib.linearization.moments import Matrices
from seedslib.linearization.points import PointRule

LOST_PART = 1e-3
"""Part of a variance that rounding must not take."""


def covariance(step: Step) -> None:
    """A filter that carries mean and covariance: forecast to the time, then correction.

    Raises
    ------
    TypeError, ValueError
        A diffuse first state, maps or a linearization without formulas.

    Warns
    -----
    UserWarning
        A prior so wide that its variances lose their digits by the first measurement.
    """
    filter, n, system = step.filter, step.n, step.filter.system
    rule, t = filter.linearization, step.timed()
    moving = step.array("moving", (n * (n + 3) // 2,))
    moving.store([*step.mean.all, *lower_of(step.cov.all)])
    last_time = step.last_time.all
    later = (step.started.all > 0.0) & (t > last_time)
    span = t - last_time
    if filter.continuous:
        count = np.maximum(1.0, np.ceil(span / filter.integration_step - SAME))
        step.refuse(later & ~(count <= float(MOST_STEPS)), "TIME")
    with step.when(later):
        if filter.continuous:
            h, rates = span / count, moment_rates(step, rule, system, step.since())
            with step.loop(count) as i:
                moved = STEPS[filter.integrator](rates, last_time + i * h, list(moving.all), h)
                moving.store(moved)
        else:
            mean, _, cov = map_moments(
                step, rule, system.dynamics, last_time, *unpacked(moving.all, n), step.since(span)
            )
            moving.store([*mean, *lower_of(cov)])
    mean, cov = unpacked(moving.all, n)
    moments = map_moments(step, rule, system.sensor, t, mean, cov, step.at_time())
    periods = system.sensor.period
    mean, after, loglik, _ = correct(mean, cov, step.y, moments, n, periods, exact=True)
    step.cov.store(settled(after, cov) if isinstance(rule, PointRule) else after)
    step.mean.store(mean)
    step.loglik.store(loglik)
    step.last_time.store(t)
    step.started.store(1.0)


def _check_formulas(filter: CovarianceFilter) -> None:
    """Refuse a first state without a distribution, and maps and rules without formulas."""
    system, rule = filter.system, filter.linearization
    if getattr(system, "diffuse", ()):
        raise ValueError("system: wanted a first state with a law to write in C, got a diffuse one")
    if not (hasattr(rule, "formulas") or isinstance(rule, PointRule | Matrices)):
        raise TypeError(
            f"linearization: wanted formulas or a rule with points to write in C, got {rule!r}"
        )
    maps = [system.sensor, system.drift_map if filter.continuous else system.dynamics]
    if not all(map.symbolic or getattr(map, "formulas", None) is not None for map in maps):
        raise ValueError("system: wanted symbolic expressions to write in C, got array functions")


def _warn_of_wide_prior(filter: CovarianceFilter) -> None:
    """Warn of a prior so wide that C loses digits that Python keeps, which has the noise apart."""
    state, p = filter.predict(filter.initial(), 0.0), filter.system.nominal_values()
    expected = filter.expected(state, p)
    plain = np.diagonal(update(state.mean, state.cov, expected.mean, expected)[1])
    right = np.diagonal(filter.update(state, expected.mean, p).cov)
    wrong = np.abs(plain - right) > LOST_PART * right
    if wrong.any():
        warnings.warn(
            f"cov0: in C the variance of x{int(np.argmax(wrong)) + 1} loses its digits by the "
            "first measurement; wanted a narrower prior",
            stacklevel=outside(),
        )


KINDS = (
    (TableFilter, table),
    (CovarianceFilter, covariance),
    (SwitchingFilter, switching),
    (FiniteOrderFilter, finite_order),
)
"""Which function records a filter; the first kind that it is an instance of."""


def recorded(filter: Any, parameters: bool = False) -> Step:
    """The program of one measurement of a filter.

    Parameters
    ----------
    filter : Filter
    parameters : bool
        Whether parameters of the model are arguments of the program, or constants.

    Raises
    ------
    TypeError
        A filter of another kind.
    """
    for kind, record in KINDS:
        if isinstance(filter, kind):
            step = Step(filter, parameters)
            if isinstance(filter, CovarianceFilter):
                _check_formulas(filter)
                _warn_of_wide_prior(filter)
            record(step)
            return step
    tables = "; read it off as tables first: filter.tabulated(y=..., z=...)"
    raise TypeError(
        "filter: wanted a FiniteOrderFilter, a TableFilter, a SwitchingFilter or a "
        f"CovarianceFilter, got {type(filter).__name__}" + tables * hasattr(filter, "tabulated")
    )
