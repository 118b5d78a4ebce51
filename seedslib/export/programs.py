"""The program of a filter as other languages have it: without arrays that do what it cannot."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from seedslib.base.checks import outside
from seedslib.base.conditioning import update
from seedslib.filters.base import Filter
from seedslib.filters.covariance import CovarianceFilter
from seedslib.filters.program import Program

LOST_PART = 1e-3
"""Part of a variance that rounding must not take."""


def recorded(filter: Any, parameters: bool = False) -> Program:
    """The program of one measurement of a filter.

    Parameters
    ----------
    filter : Filter
    parameters : bool
        Whether parameters of the model are arguments of the program, or constants.

    Raises
    ------
    TypeError, ValueError
        A filter that has no program, or a part of it that has none.

    Warns
    -----
    UserWarning
        A prior so wide that its variances lose their digits by the first measurement.
    """
    if not isinstance(filter, Filter):
        raise TypeError(f"filter: wanted a Filter, got {type(filter).__name__}")
    step = filter.program(parameters=parameters)
    if isinstance(filter, CovarianceFilter):
        _warn_of_wide_prior(filter)
    return step


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
