"""Consistency: normalised squares and coverage against a filter written by hand."""

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from oracles.linear import kalman
from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.evaluation import compare, evaluate
from seedslib.filters import Estimates, KalmanFilter, extended_kalman
from seedslib.linearization import ExactGaussian
from seedslib.models import DiscreteSystem, Noise, StochasticMap
from systems import INPUTS, TIMES, linear_numbers, linear_system, recorded

x, v, w = sympy.symbols("x v w", real=True)
MASK = np.array([[1, 0], [0, 1], [0, 0], [1, 1], [0, 1], [1, 0], [1, 1]], dtype=bool)


def walk(noise=1.0):
    return DiscreteSystem(
        StochasticMap([x], [0.9 * x + w], Noise([w], cov=[[noise]])),
        StochasticMap([x], [x + v], Noise([v])),
        [0.0],
        [[1.0]],
    )


def ratio(found, expected):
    """Sum by sum over paths, and its standard error as that of a ratio of means."""
    share, paths = found.sum() / expected.sum(), len(found)
    spread = ((found - share * expected) ** 2).sum()
    assert paths > 2
    return share, np.sqrt(spread) / expected.sum()


def test_all_measures_are_those_of_a_filter_written_by_hand():
    """Unlike components, inputs, sensors of schedules of their own that fail, a window."""
    system, paths, late = recorded(linear_system()), 400, slice(2, 6)
    options = {"measured": MASK, "availability": [0.9, 0.7], "window": (2, 5), "inputs": INPUTS}
    filter = KalmanFilter(system.system)
    found = evaluate(filter, system, TIMES, paths, 3, consistency=True, **options)
    model, y = linear_numbers(means=False), system.all("measurements")
    rows = [kalman(model, y[..., i]) for i in range(paths)]
    mean, cov, _, before, spread = (np.stack(part, axis=-1) for part in zip(*rows, strict=True))
    shown = ~np.isnan(y)
    error = mean - system.all("states")
    inverse = np.linalg.inv(np.moveaxis(cov, 3, 0))
    nees = np.einsum("jiN,Njik,jkN->jN", error, inverse, error)
    nis = np.full((7, paths), np.nan)
    for j, i in np.ndindex(7, paths):
        if (here := shown[j, :, i]).any():
            H, R = model.H[j][here], model.R[j][np.ix_(here, here)]
            apart = y[j, here, i] - H @ before[j, :, i] - model.d[j][here]
            nis[j, i] = apart @ np.linalg.solve(H @ spread[j, ..., i] @ H.T + R, apart)
    count, measured = np.full((7, paths), 3), shown.sum(axis=1)
    for field, wanted in (
        ("nees_ratio", ratio(nees[late].sum(axis=0), count[late].sum(axis=0))),
        ("nis_ratio", ratio(np.nansum(nis[late], axis=0), measured[late].sum(axis=0))),
    ):
        assert getattr(found, field) == pytest.approx(wanted[0], rel=1e-8)
        assert getattr(found, f"{field}_error") == pytest.approx(wanted[1], rel=1e-6)
    inside = np.abs(error) <= norm.ppf(0.975) * np.sqrt(np.einsum("jiiN->jiN", cov))
    share = inside[late].mean(axis=0)
    np.testing.assert_allclose(found.average_coverage, share.mean(axis=1))
    spread = share.std(axis=1) / np.sqrt(paths)
    np.testing.assert_allclose(found.average_coverage_error, spread, rtol=1e-6)


def test_a_consistent_filter_is_told_from_a_bold_one():
    filters = {"right": extended_kalman(walk()), "bold": extended_kalman(walk(0.2))}
    found = compare(filters, walk(), np.arange(8.0), 1500, 3, consistency=True, availability=0.7)
    right, bold = found["right"], found["bold"]
    for name, wanted in (("nees_ratio", 1), ("nis_ratio", 1), ("average_coverage", 0.95)):
        off, error = np.abs(getattr(right, name) - wanted), getattr(right, f"{name}_error")
        assert np.all(off < 4 * error), name
        off, error = np.abs(getattr(bold, name) - wanted), getattr(bold, f"{name}_error")
        assert np.all(off > 6 * error), name
    assert f"{right.nees_ratio:.4g} ± {right.nees_ratio_error:.2g}" in repr(found)


class Claims:
    """Estimates zero and claims one covariance, or none."""

    def __init__(self, cov=None):
        self.cov = cov

    def run(self, times, measurements):
        count = measurements.shape[2]
        mean = np.zeros((len(times), 3, count))
        if self.cov is None:
            return Estimates(mean)
        return Estimates(mean, np.broadcast_to(self.cov[..., None], (len(times), 3, 3, count)))


def test_singular_covariances_are_met_on_their_range():
    """Errors u c with covariance u u' have the square c^2, in units that are far apart."""
    u = np.array([1.3, -1e3, 1e-3])
    state = sympy.symbols("a:3", real=True)
    still = StochasticMap(state, list(state))
    system = recorded(
        DiscreteSystem(
            still, StochasticMap(state, [state[0] + v], Noise([v])), np.zeros(3), np.outer(u, u)
        )
    )
    options = {"consistency": True, "window": [0]}
    found = evaluate(Claims(np.outer(u, u)), system, [0, 1], 300, 1, **options)
    squares = (system.all("states")[0, 0] / u[0]) ** 2
    assert found.nees_ratio == pytest.approx(squares.mean() / 3, rel=1e-6)
    assert found.nis_ratio is None
    certain = evaluate(Claims(np.diag([4.0, 0.0, 0.0])), system, [0, 1], 300, 1, **options)
    squares = system.all("states")[0, 0, 300:] ** 2 / 4.0
    assert certain.nees_ratio == pytest.approx(squares.mean() / 3)
    nothing = evaluate(Claims(), system, [0, 1], 300, 1, **options)
    assert nothing.nees_ratio is None
    assert nothing.average_coverage is None


@pytest.mark.filterwarnings("ignore:measurements. 500 of 1000 records have gaps")
def test_measures_leave_out_what_a_designed_filter_does_not_know():
    """Every second path loses a measurement: ratio and coverage are those of the others."""

    def fail(made):
        made.measurements[2, :, ::2] = np.nan

    system, times = recorded(walk(), fail), np.arange(6.0)
    designed = synthesize(walk(), Memory(1), ExactGaussian(), times, paths=4000, seed=1)
    row = evaluate(designed, system, times, 1000, 3, consistency=True)
    run = designed.run(times, system.all("measurements"), covariances=True)
    squares = (run.mean - system.all("states"))[:, 0] ** 2 / run.cov[:, 0, 0]
    known = ~np.isnan(squares)
    assert known[:2].all()
    np.testing.assert_array_equal(known[2:].sum(axis=1), 500)
    wanted = ratio(np.nansum(squares, axis=0), known.sum(axis=0))
    assert row.nees_ratio == pytest.approx(wanted[0], rel=1e-10)
    assert row.nees_ratio_error == pytest.approx(wanted[1], rel=1e-8)
    assert abs(row.nees_ratio - 1) < 5 * row.nees_ratio_error
    inside = np.abs(run.mean - system.all("states")) <= norm.ppf(0.975) * np.sqrt(run.cov[:, 0])
    assert row.average_coverage == pytest.approx((inside[:, 0] & known).sum() / known.sum())


def test_innovations_of_a_design_are_those_of_its_schedule():
    """It passes through its own times, also where the schedule has nothing to read."""
    times = np.arange(6.0)
    read = times % 2 == 0
    designed = synthesize(
        walk(), Memory(1), ExactGaussian(), times, paths=4000, seed=1, measured=read
    )
    row = evaluate(designed, walk(), times, 1000, 3, measured=read, consistency=True)
    assert abs(row.nis_ratio - 1) < 5 * row.nis_ratio_error
