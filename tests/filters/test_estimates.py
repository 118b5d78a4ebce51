"""Intervals and tables of estimates."""

import numpy as np
import pytest
from scipy.stats import norm

from seedslib.filters import Estimates, RaoBlackwellFilter, extended_kalman
from systems import (
    INPUTS,
    TIMES,
    discrete_system,
    linear_numbers,
    record,
    switching_system,
)

NAMES = ["place", "speed", "bias"]


@pytest.fixture(scope="module")
def estimates():
    """Of two records whose covariances differ from a gap on."""
    y = record(linear_numbers())[1]
    y = np.stack([y, np.nan_to_num(y)], axis=-1)
    return extended_kalman(discrete_system()).run(TIMES, y, inputs=INPUTS)


def common(estimates):
    """The same with the covariances of the first record for all."""
    return estimates._replace(cov=estimates.cov[..., 0])


def test_intervals_are_gaussian_ones(estimates):
    """Of records with covariances of their own or in common, and of a single time."""
    low, high = estimates.interval(0.9)
    for k, i, which in ((2, 1, 0), (4, 2, 1)):
        deviation = np.sqrt(estimates.cov[k, i, i, which])
        wanted = norm.interval(0.9, estimates.mean[k, i, which], deviation)
        np.testing.assert_allclose([low[k, i, which], high[k, i, which]], wanted, rtol=1e-12)
    low, high = common(estimates).interval()
    wanted = norm.interval(0.95, estimates.mean[4, 2, 1], np.sqrt(estimates.cov[4, 2, 2, 0]))
    np.testing.assert_allclose([low[4, 2, 1], high[4, 2, 1]], wanted, rtol=1e-12)
    one = Estimates(estimates.mean[3, :, 0], estimates.cov[3, :, :, 0])
    np.testing.assert_allclose(one.interval(0.9), estimates.interval(0.9)[:, 3, :, 0])


def test_table_of_one_record_is_indexed_by_time(estimates):
    table = Estimates(estimates.mean[..., 0]).to_dataframe(TIMES)
    assert table.index.name == "t"
    assert list(table.columns) == ["x1", "x2", "x3"]
    assert table.loc[TIMES[3], "x2"] == estimates.mean[3, 1, 0]
    parts = (None if part is None else part[..., 1] for part in estimates)
    table = Estimates(*parts).to_dataframe(TIMES)
    assert list(table.columns) == ["x1", "x2", "x3", "x1_sd", "x2_sd", "x3_sd", "loglik"]
    assert table.loc[TIMES[4], "x3_sd"] == pytest.approx(np.sqrt(estimates.cov[4, 2, 2, 1]))
    assert table["loglik"].sum() == pytest.approx(estimates.loglik[:, 1].sum())


def test_tables_show_modes():
    y = record(linear_numbers())[1]
    filter, shown = RaoBlackwellFilter(switching_system(), 20), np.zeros(7, int)
    estimates = filter.run(TIMES, y, indicators=shown, inputs=INPUTS)
    table = estimates.to_dataframe(TIMES)
    assert table.loc[TIMES[4], "mode"] == estimates.modes[4]
    assert table.loc[TIMES[4], "mode2"] == estimates.mode_prob[4, 2]
