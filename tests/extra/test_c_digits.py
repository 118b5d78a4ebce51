"""How far C and Python agree: within rounding in a step, at the same node of a time stamp."""

import ctypes

import numpy as np
import pytest
import sympy

from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.extra import to_c
from seedslib.filters import extended_kalman
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

FORECAST, CORRECTION = 1e-14, 1e-13
"""Bounds of the documentation of `to_c`: of the largest term, and of the largest value."""

HALVES = """
#include "one.h"
void forecast(int k, const double *memory, double *mean, double *cov)
{
    one_ahead_(k - 1, memory, mean, cov);
}
void correction(double t, const double *mean, const double *cov, const double *y, double *found)
{
    one_state s;
    one_init(&s);
    one_correct_(t, mean, cov, &s, y);
    memcpy(found, s.mean, sizeof s.mean);
}
"""
PATHS, STEPS = 20, 60


@pytest.fixture(scope="module")
def bearings():
    """Two bearings of a target that moves away: errors of the past are kept and grow."""
    state = x, vx, y, vy = sympy.symbols("x vx y vy", real=True)
    q, r = sympy.symbols("q1 q2", real=True), sympy.symbols("r1 r2", real=True)
    move = [x + vx + q[0] / 2, vx + q[0], y + vy + q[1] / 2, vy + q[1]]
    seen = [sympy.atan2(y, x) + r[0], sympy.atan2(y + 5, x - 20) + r[1]]
    system = DiscreteSystem(
        StochasticMap(state, move, Noise(q, cov=np.eye(2) * 0.01)),
        StochasticMap(state, seen, Noise(r, cov=np.eye(2) * 0.03**2)),
        mean0=[5, 0.5, 15.0, -0.2], cov0=np.diag([4.0, 0.1, 4.0, 0.1]),
    )  # fmt: skip
    times = np.arange(STEPS + 1.0)
    filter = synthesize(system, Memory(2), Taylor(), times, paths=2000, seed=1, nodes=0)
    return filter, times, system.simulate(times, PATHS, 3).measurements


def of_path(thing, i):
    """The part of one path in a state of many; what is common to all stays."""
    if isinstance(thing, np.ndarray):
        return thing[..., i].copy() if thing.shape[-1:] == (PATHS,) else thing
    if isinstance(thing, tuple):
        parts = [of_path(part, i) for part in thing]
        return type(thing)(*parts) if hasattr(thing, "_fields") else tuple(parts)
    return thing


def apart(one, other, *terms):
    return np.abs(one - other).max() / max(np.abs(part).max() for part in (other, *terms))


@pytest.mark.filterwarnings("ignore:correction:UserWarning")
def test_halves_of_a_step_alone_and_in_a_batch(bearings):
    filter, times, y = bearings
    after, forecasts, corrections = filter.initial((PATHS,)), [], []
    for k, (t, row) in enumerate(zip(times, y, strict=True)):
        before, ahead = after, filter.predict(after, t)
        after = filter.correct(ahead, row)
        for i in range(PATHS):
            state = of_path(before, i)
            terms = [filter.fits[k - 1].gain * state.past.vector] if k else []
            forecasts.append(apart(filter.predict(state, t).mean, ahead.mean[:, i], *terms))
            alone = filter.correct(of_path(ahead, i), row[:, i])
            corrections.append(apart(alone.mean, after.mean[:, i]))
    assert max(forecasts) < FORECAST
    assert max(corrections) < CORRECTION


def test_halves_of_a_step_in_c_and_in_python(bearings, build, tmp_path):
    filter, times, y = bearings
    to_c(filter, tmp_path / "one.h", name="one")
    library = ctypes.CDLL(str(build(tmp_path, HALVES)))
    lower, forecasts, corrections = np.tril_indices(4), [], []

    def given(*arrays):
        return [part.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for part in arrays]

    for i in range(5):
        after = filter.initial()
        for k, (t, row) in enumerate(zip(times, np.ascontiguousarray(y[..., i]), strict=True)):
            before, ahead = after, filter.predict(after, t)
            after = filter.correct(ahead, row)
            if k < 2:  # the memory is not full yet, and its places are not those of the sum
                continue
            u, mean, cov = np.array(before.past.vector), np.empty(4), np.empty(10)
            library.forecast(k, *given(u, mean, cov))
            forecasts.append(apart(mean, ahead.mean, filter.fits[k - 1].gain * u))
            mean, cov, found = np.array(ahead.mean), np.array(ahead.cov)[lower], np.empty(4)
            library.correction(ctypes.c_double(t), *given(mean, cov, row, found))
            corrections.append(apart(found, after.mean))
    assert max(forecasts) < FORECAST
    assert max(corrections) < CORRECTION


# Times of a forecast


@pytest.mark.parametrize(("unit", "start"), [(1.0, 0.0), (1.0, 1.7e9), (1e-9, 0.0)])
@pytest.mark.parametrize("kind", ["piecewise constant", "interpolated"])
def test_forecasts_at_a_node_but_for_rounding(compiled, unit, start, kind):
    x, v = sympy.symbols("x v")
    system = JumpDiffusion(
        (x,), [-x / unit], [[sympy.Float(unit**-0.5)]], [x + v], Noise((v,)), [3], [[1]],
        step=0.05 * unit,
    )  # fmt: skip
    times = start + unit * np.arange(3.0)
    made = synthesize(system, Memory(1), Taylor(), times, paths=500, seed=1, nodes=3)
    filter, y = made.forecasting(kind), np.array([[2.0]])
    library = compiled(filter, name="when")
    state = filter.step(filter.initial(), times[0], y[0])
    for node in [times[0], *filter.node_times[0], times[1]]:
        for t in (np.nextafter(node, -np.inf), node, np.nextafter(node, np.inf)):
            found = library.forecast(y, float(t))
            np.testing.assert_allclose(found, filter.forecast(state, t).mean, rtol=1e-12)
    for t in (times[0] - 0.01 * unit, times[1] + 0.01 * unit):
        assert library.forecast(y, float(t)) == 4
        with pytest.raises(ValueError, match="wanted a time from"):
            filter.forecast(state, t)


# Compilers that leave NaN out


@pytest.mark.parametrize("flag", ["-ffast-math", "-ffinite-math-only", "-Ofast"])
def test_a_compiler_that_knows_no_nan_is_refused(build, tmp_path, flag):
    x, v = sympy.symbols("x v")
    still = StochasticMap((x,), [x], Noise())
    system = DiscreteSystem(still, StochasticMap((x,), [x + v], Noise((v,))), [0], [[1]])
    to_c(extended_kalman(system), tmp_path / "ekf.h", name="ekf")
    source = '#include "ekf.h"\nint size(void) { return (int)sizeof(ekf_state); }\n'
    told = build(tmp_path, source, more=[flag], fails=True)
    assert "ekf: wanted a compiler that keeps NaN" in told
    build(tmp_path, source, more=["-fno-finite-math-only", "-O2"])
