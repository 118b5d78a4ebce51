"""Designs for a sensor whose components are read at known times."""

import warnings

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import Polynomial, stationary, synthesize
from seedslib.designed import Memory, finite_memory, load, save
from seedslib.evaluation import compare
from seedslib.linearization import Cubature, ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

p, q = sympy.symbols("p q", real=True)
r = sympy.symbols("r1 r2", real=True)
e = sympy.symbols("e1 e2", real=True)
MOVE, READ = np.array([[0.9, 0.3], [-0.2, 0.8]]), np.diag([0.5, 0.2])
TIMES = np.arange(25.0)
RATES = np.zeros((25, 2), dtype=bool)
RATES[::2, 0] = RATES[::5, 1] = True
"""One component every second time, the other every fifth: both, one, or none."""


@pytest.fixture(scope="module")
def system():
    state = [p, q]
    moved = [0.9 * p + 0.3 * q + e[0], -0.2 * p + 0.8 * q + e[1]]
    return DiscreteSystem(
        StochasticMap(state, moved, Noise(e, cov=np.eye(2))),
        StochasticMap(state, [p + r[0], q + r[1]], Noise(r, cov=READ)), [0.0, 1.0], np.eye(2),
    )  # fmt: skip


@pytest.fixture(scope="module")
def filter(system):
    return synthesize(system, Memory(1), Taylor(), TIMES, paths=40_000, seed=1, measured=RATES)


def riccati(count, mask):
    """Covariances of the optimal filter, from the rows that are read, by the textbook."""
    cov, found = np.eye(2), []
    for k in range(count):
        if k:
            cov = MOVE @ cov @ MOVE.T + np.eye(2)
        there = mask[k % len(mask)]
        h = np.eye(2)[there]
        gain = np.linalg.solve(h @ cov @ h.T + h @ READ @ h.T, h @ cov).T
        cov = cov - gain @ h @ cov
        found.append(cov)
    return np.array(found)


def test_it_is_the_kalman_filter_of_the_schedule(system, filter):
    data = system.simulate(TIMES, 3000, 5, measured=RATES)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing is unexpected
        found = filter.run(TIMES, data.measurements, covariances=True)
    wanted = riccati(25, RATES)
    cov = np.broadcast_to(found.cov.reshape(25, 2, 2, -1), (25, 2, 2, 3000))
    np.testing.assert_allclose(cov, wanted[..., None] * np.ones(3000), rtol=0.05, atol=0.02)
    error = found.mean - data.states
    root = np.sqrt(np.diagonal(wanted, axis1=1, axis2=2))
    assert np.abs(np.sqrt((error**2).mean(axis=2)) / root - 1).max() < 4 / np.sqrt(2 * 3000)
    np.testing.assert_allclose(filter.predicted.rms, root, rtol=4 / np.sqrt(80_000) + 0.005)
    assert np.isfinite(found.loglik).all()


def test_its_exact_design_is_the_riccati_recursion():
    """Without simulation: a drifting pair with a sensor of two rates, and a memory of what came."""
    fluid = JumpDiffusion(
        [p, q], [q, -p - q], [[0], [1]], [p + r[0], q + r[1]], Noise(r, cov=READ), [0, 0],
        np.eye(2), step=0.1,
    )  # fmt: skip
    made = synthesize(fluid, Memory(1), Taylor(), TIMES / 5, exact_moments=True, measured=RATES)
    other = synthesize(fluid, Memory(1), Taylor(), TIMES / 5, paths=20_000, seed=2, nodes=0,
                       step=0.02, measured=RATES)  # fmt: skip
    rows = made.clock.rows(made.predicted.times)
    rms = made.predicted.rms[rows]
    np.testing.assert_allclose(rms, other.predicted.rms, rtol=0.03)
    found = made.run(TIMES / 5, fluid.simulate(TIMES / 5, 1, 1, measured=RATES).measurements,
                     covariances=True)  # fmt: skip
    claims = np.sqrt(np.diagonal(found.cov[..., 0], axis1=1, axis2=2))
    np.testing.assert_allclose(claims, rms, rtol=1e-9)
    # what is missing is remembered as it was expected, which adds nothing to the estimates
    both = synthesize(fluid, Memory(1, 1), Taylor(), TIMES / 5, exact_moments=True, measured=RATES)
    np.testing.assert_allclose(both.predicted.rms[rows], rms, rtol=1e-6)


def test_a_further_gap_is_unknown_and_a_further_measurement_refused(system, filter):
    y = system.simulate(TIMES, 3, 5, measured=RATES).measurements.copy()
    y[4, 0, 1] = np.nan
    with pytest.warns(UserWarning, match="1 of 3 records have gaps, from 4 on"):
        found = filter.run(TIMES, y, covariances=True)
    lost = np.isnan(np.broadcast_to(found.cov.reshape(25, 2, 2, -1), (25, 2, 2, 3))[:, 0, 0])
    assert lost[4:, 1].all()
    assert not lost[:4].any()
    assert not lost[:, [0, 2]].any()
    state, known = filter.initial((3,)), filter.initial((3,))
    for k, t in enumerate(TIMES[:8]):
        state = filter.step(state, t, y[k])
        assert np.isnan(state.cov).any() == (k >= 4)
        np.testing.assert_allclose(state.mean, found.mean[k], rtol=1e-12)
    y[3, 1, 2] = 0.5
    with pytest.raises(ValueError, match=r"measurements: .*got component 1 .* in row 3"):
        filter.run(TIMES, y)
    for k in range(3):
        known = filter.step(known, TIMES[k], y[k])
    with pytest.raises(ValueError, match=r"y: .*got component 1"):
        filter.step(known, TIMES[3], y[3])


def test_the_schedule_goes_through_files_and_checkpoints(system, filter, tmp_path):
    save(filter, tmp_path / "f.npz")
    again = load(tmp_path / "f.npz", system)
    assert np.array_equal(again.measured, RATES)
    assert "schedule     18 of 50 components are read" in str(again)
    y = system.simulate(TIMES, 4, 5, measured=RATES).measurements
    assert np.array_equal(again.run(TIMES, y).mean, filter.run(TIMES, y).mean)
    file = tmp_path / "c.npz"
    synthesize(system, Memory(1), Taylor(), TIMES[:5], paths=600, seed=1, measured=RATES[:5],
               checkpoint=file)  # fmt: skip
    with pytest.raises(ValueError, match="differs in measured"):
        synthesize(system, Memory(1), Taylor(), TIMES[:5], paths=600, seed=1, checkpoint=file)


def test_a_periodic_schedule_lasts(system):
    mask = np.zeros((25, 2), dtype=bool)
    mask[:, 0], mask[2::3, 1] = True, True
    made = synthesize(system, Memory(1), Taylor(), TIMES, paths=40_000, seed=1, measured=mask)
    lasting = stationary(made, cycle=3)
    long, whole = np.arange(300.0), np.tile(mask[:3], (100, 1))
    y = system.simulate(long, 1, 3, measured=whole).measurements[..., 0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = lasting.run(long, y, covariances=True)
    np.testing.assert_allclose(found.cov, riccati(300, mask[:3]), rtol=0.04, atol=0.02)
    with pytest.raises(ValueError, match="cycle: wanted the period of the schedule"):
        stationary(made, cycle=2)
    with pytest.raises(ValueError, match="transient: wanted 1 and a multiple of the cycle of 3"):
        stationary(made, cycle=3, transient=5)
    short = stationary(made, cycle=3, transient=4)
    assert np.array_equal(short.measured, mask[[0, 1, 2, 3, 22, 23, 24]])
    assert np.isfinite(short.held_out.rms).all()


def test_two_rates_are_as_consistent_as_one():
    """Claims of a nonlinear design: normalised errors of one, in `compare` too."""
    u = sympy.symbols("u1 u2", real=True)
    s, d = sympy.symbols("s d", real=True)
    cart = JumpDiffusion(
        [p, s, d], [s, -p - 0.3 * s + d, -0.2 * d], [[0], [0.1], [0.1]],
        [p + u[0], sympy.tanh(s) + u[1]], Noise(u, cov=np.diag([0.05**2, 0.1**2])), [0, 0, 0],
        np.eye(3) * 0.2, step=0.02,
    )  # fmt: skip
    times = np.round(0.1 * np.arange(41), 6)
    mask = np.ones((41, 2), dtype=bool)
    mask[np.arange(41) % 5 != 0, 1] = mask[np.arange(41) % 5 == 3, 0] = False
    made = synthesize(cart, Memory(1), Cubature(), times, paths=8000, seed=1, nodes=0,
                      measured=mask)  # fmt: skip
    found = compare({"designed": made}, cart, times, 1000, 5, measured=mask, consistency=True)
    assert abs(found["designed"].nees_ratio - 1) < 0.05


def test_polynomials_and_finite_memories_take_schedules():
    system, times = zoo.van_der_pol(), 0.25 * np.arange(9)
    mask = np.ones(9, dtype=bool)
    mask[[3, 4]] = False
    for memory, kind in ((Memory(1), Polynomial(2, 1)), (finite_memory(2), None)):
        told = {} if kind is None else {"predictor": kind}
        made = synthesize(system, memory, ExactGaussian(), times, paths=4000, seed=1, nodes=1,
                          measured=mask, **told)  # fmt: skip
        y = system.simulate(times, 5, 1, measured=mask).measurements
        found = made.run(times, y, covariances=True)
        assert np.isfinite(found.cov).all()
        assert np.isfinite(found.mean).all()


def test_a_switching_design_takes_a_schedule():
    """A target with a noisy indicator whose position is read every other time."""
    system, times = zoo.manoeuvring_target("noisy"), np.arange(13.0)
    mask = np.ones((13, 2), dtype=bool)
    mask[1::2, 0] = mask[6, 1] = False
    made = synthesize(system, Memory(1), ExactGaussian(), times, paths=8000, seed=1, measured=mask)
    assert np.array_equal(made.measured, mask)
    data = system.simulate(times, 2000, 3, measured=mask)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = made.run(times, data.measurements, indicators=data.indicators, covariances=True)
    error = np.moveaxis(found.mean - data.states, 1, -1)[..., None]
    cov = np.moveaxis(found.cov, (1, 2), (-2, -1))
    nees = (error * np.linalg.solve(cov, error)).sum(axis=(-2, -1)) / 2
    assert abs(nees[4:].mean() - 1) < 0.05
    # a design that takes the position for read claims far too little where it is not
    blind = synthesize(system, Memory(1), ExactGaussian(), times, paths=8000, seed=1)
    assert (made.predicted.rms[5:12:2, 0] > 1.2 * blind.predicted.rms[5:12:2, 0]).all()
    with pytest.raises(ValueError, match="measured: wanted every indicator"):
        synthesize(system, Memory(1, indicators=1), ExactGaussian(), times, paths=8000, seed=1,
                   measured=mask)  # fmt: skip


def test_what_does_not_fit_is_refused(system, filter):
    with pytest.raises(ValueError, match=r"measured: wanted a mask of shape \(25,\) or \(25, 2\)"):
        synthesize(system, Memory(1), Taylor(), TIMES, paths=600, seed=1, measured=RATES[:, :1])
