"""The program of a filter: filters that carry mean and covariance, and the table of all kinds."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.base.clock import MOST_STEPS, SAME
from seedslib.base.values import assigned
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.output_filter import TableFilter
from seedslib.designed.switching.filter import SwitchingFilter
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
from seedslib.linearization.moments import Linearization, Matrices
from seedslib.linearization.points import PointRule
from seedslib.linearization.taylor_and_exact import Taylor


def covariance(step: Step) -> None:
    """A filter that carries mean and covariance: forecast to the time, then correction."""
    filter, n, system = step.filter, step.n, step.filter.system
    rule, t = _rule(filter), step.timed()
    moving = step.array("moving", (n * (n + 3) // 2,))
    moving.store([*step.mean.all, *lower_of(step.cov.all)])
    last_time = step.last_time.all
    later = (step.started.all > 0.0) & (t > last_time)
    span = t - last_time
    if filter.continuous:
        count = np.maximum(1.0, np.ceil(span / filter.integration_step - SAME))
        step.refuse(later & ~(count <= float(MOST_STEPS)), "TIME")
    with step.when(later), step.since(span):
        if filter.continuous:
            h, rates = span / count, moment_rates(step, rule, system)
            with step.loop(count) as i:
                moved = STEPS[filter.integrator](rates, last_time + i * h, list(moving.all), h)
                moving.store(moved)
        else:
            mean, _, cov = map_moments(
                step, rule, system.dynamics, last_time, *unpacked(moving.all, n)
            )
            moving.store([*mean, *lower_of(cov)])
    mean, cov = unpacked(moving.all, n)
    moments = map_moments(step, rule, system.sensor, t, mean, cov)
    periods = system.sensor.period
    mean, after, loglik, _ = correct(mean, cov, step.y, moments, n, periods, exact=True)
    step.cov.store(settled(after, cov) if isinstance(rule, PointRule) else after)
    step.mean.store(mean)
    step.loglik.store(loglik)
    step.last_time.store(t)
    step.started.store(1.0)


def _rule(filter: CovarianceFilter) -> Linearization:
    """The linearization; of the matrices of a linear system the one that is exact for them."""
    linear = isinstance(filter.linearization, Matrices)
    return Taylor() if linear else filter.linearization


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
            with assigned(step.values):
                record(step)
            return step
    raise TypeError(f"filter: wanted a filter that has C, got {type(filter).__name__}")
