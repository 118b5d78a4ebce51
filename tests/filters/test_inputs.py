"""Inputs told with the data: against recursions written out, formulas of time, path by path."""

import numpy as np
import pytest
import sympy as sp

from seedslib.base import Input, Parameter, assigned
from seedslib.evaluation import compare, fit
from seedslib.filters import (
    KalmanFilter,
    KnownModeFilter,
    ParticleFilter,
    RaoBlackwellFilter,
    extended_kalman,
    smooth,
    unscented_kalman,
)
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
    inputs_of,
)

x, v, w, t = sp.symbols("x v w t")
u = Input("u")
TIMES = np.arange(6.0)
VALUES = np.array([0.5, -1.0, 2.0, 0.3, 1.0, -0.5])
OWN = VALUES[:, None] * np.linspace(0.5, 1.5, 5)
COURSE = sp.Piecewise(*((c, t < k + 0.5) for k, c in enumerate(VALUES)), (VALUES[-1], True))
"""The values as a function of time, each about the time at which it is told."""


def discrete(u):
    moves = StochasticMap([x], [0.8 * sp.sin(x) + u + 0.3 * v], Noise((v,)))
    return DiscreteSystem(moves, StochasticMap([x], [x + u * x / 5 + w / 2], Noise((w,))), [0], [1])


def switching(u):
    stay = 1 / (1 + sp.exp(-u))
    leave = [[stay, 1 - stay], [1 - stay, stay]]
    moves = [[0.9 * x + u + v], [x - u + 2 * v]]
    shows = [[x + u / 5 + w], [x + w / 2]]
    tells = [[sp.Rational(3, 4), sp.Rational(1, 4)], [stay / 2, 1 - stay / 2]]
    first = [(0.5, [0], [[1]]), (0.5, [1], [[1]])]
    return SwitchingSystem(
        [x], moves, Noise((v,)), leave, shows, Noise((w,)), first, indicator=tells
    )


TOLD, WRITTEN = discrete(u), discrete(COURSE)


@pytest.fixture(scope="module")
def record():
    return TOLD.simulate(TIMES, 5, 1, inputs={u: OWN})


def test_a_linear_system_against_the_filter_written_out():
    F, Q, H, R = np.array([[1, 0.4], [0, 0.9]]), np.diag([0.1, 0.3]), np.array([[1.0, 0.2]]), 0.2
    B, D = np.array([[0.3, 0.0], [1.0, -0.5]]), np.array([[0.5, 0.1]])
    second = Input("s")
    system = LinearSystem(F, Q, H, [[R]], [0, 1], np.eye(2), B=B, D=D, inputs=(u, second))
    told, y = np.stack([VALUES, np.sin(TIMES)]), np.cos(2 * TIMES)[:, None]
    found = KalmanFilter(system).run(TIMES, y, inputs={u: told[0], second: told[1]})
    m, P = np.array([0.0, 1.0]), np.eye(2)
    for k in range(len(TIMES)):
        if k:
            m, P = F @ m + B @ told[:, k - 1], F @ P @ F.T + Q
        S = (H @ P @ H.T)[0, 0] + R
        gain, innovation = P @ H[0] / S, y[k, 0] - H[0] @ m - D[0] @ told[:, k]
        m, P = m + gain * innovation, P - np.outer(gain, gain) * S
        loglik = -0.5 * (np.log(2 * np.pi * S) + innovation**2 / S)
        assert found.mean[k] == pytest.approx(m, rel=1e-12)
        assert found.cov[k] == pytest.approx(P, rel=1e-11)
        assert found.loglik[k] == pytest.approx(loglik, rel=1e-12)


@pytest.mark.parametrize(
    "entry", [1.5, sp.Integer(1) + sp.Symbol("t") / 2, lambda t: [[1 + t / 2]]]
)
def test_diffuse_components_beside_inputs_take_them_as_a_shift(entry):
    """What inputs add to the state is known, so that it may be taken off the measurements."""
    B = entry if callable(entry) else [[entry]]
    size = entry if isinstance(entry, float) else None
    parts = [[0.9]], [[0.2]], [[1.0]], [[0.3]], [0], [[0]]
    told = LinearSystem(*parts, diffuse=(0,), B=B, inputs=(u,))
    plain = LinearSystem(*parts, diffuse=(0,))
    shift, y = np.zeros(6), np.cos(TIMES)[:, None]
    for k in range(1, 6):
        push = 1 + (k - 1) / 2 if size is None else size
        shift[k] = 0.9 * shift[k - 1] + push * VALUES[k - 1]
    wanted = KalmanFilter(plain).run(TIMES, y - shift[:, None])
    found = KalmanFilter(told).run(TIMES, y, inputs={u: VALUES})
    assert found.mean[:, 0] == pytest.approx(wanted.mean[:, 0] + shift, rel=1e-11)
    assert np.isnan(found.loglik).sum() == 0
    assert found.loglik == pytest.approx(wanted.loglik, rel=1e-11)
    smoothed = smooth(KalmanFilter(told), TIMES, y, inputs={u: VALUES}).mean[:, 0]
    wanted = smooth(KalmanFilter(plain), TIMES, y - shift[:, None]).mean[:, 0]
    assert smoothed == pytest.approx(wanted + shift, rel=1e-11)


def test_an_input_is_the_function_of_time_that_it_is():
    made = TOLD.simulate(TIMES, 7, 3, inputs={u: VALUES})
    wanted = WRITTEN.simulate(TIMES, 7, 3)
    assert np.array_equal(made.states, wanted.states)
    assert np.array_equal(made.measurements, wanted.measurements)
    for filter in (extended_kalman, unscented_kalman, lambda s: ParticleFilter(s, 40)):
        found = filter(TOLD).run(TIMES, made.measurements, inputs={u: VALUES})
        plain = filter(WRITTEN).run(TIMES, made.measurements)
        assert np.allclose(found.mean, plain.mean, rtol=1e-12)
        assert np.allclose(found.loglik, plain.loglik, rtol=1e-12)
    told = smooth(extended_kalman(TOLD), TIMES, made.measurements, inputs={u: VALUES})
    plain = smooth(extended_kalman(WRITTEN), TIMES, made.measurements)
    assert np.allclose(told.mean, plain.mean, rtol=1e-12)


def test_switching_systems_are_told_them_too():
    told, written = switching(u), switching(COURSE)
    made = told.simulate(TIMES, 6, 3, inputs={u: VALUES})
    wanted = written.simulate(TIMES, 6, 3)
    assert np.array_equal(made.modes, wanted.modes)
    assert np.allclose(made.measurements, wanted.measurements, rtol=1e-12)
    assert np.array_equal(made.indicators, wanted.indicators)
    for filter in (
        lambda s: RaoBlackwellFilter(s, 15), lambda s: ParticleFilter(s, 15), KnownModeFilter
    ):  # fmt: skip
        more = {"indicators": made.indicators}
        if filter is KnownModeFilter:
            more["modes"] = made.modes
        plain = filter(written).run(TIMES, made.measurements, **more)
        for course in (VALUES, np.repeat(VALUES[:, None], 6, axis=1)):
            found = filter(told).run(TIMES, made.measurements, inputs={u: course}, **more)
            assert np.allclose(found.mean, plain.mean, rtol=1e-12)
            assert np.allclose(found.loglik, plain.loglik, rtol=1e-12)


def test_known_modes_with_inputs_of_their_own_are_run_path_by_path():
    system = switching(u)
    made = system.simulate(TIMES, 5, 3, inputs={u: OWN})
    filter = KnownModeFilter(system)
    found = filter.run(
        TIMES, made.measurements, indicators=made.indicators, modes=made.modes, inputs={u: OWN}
    )
    for k in range(5):
        one = filter.run(
            TIMES, made.measurements[..., [k]], indicators=made.indicators[:, [k]],
            modes=made.modes[:, [k]], inputs={u: OWN[:, k]},
        )  # fmt: skip
        assert np.allclose(found.mean[..., k], one.mean[..., 0], rtol=1e-12)


def test_paths_with_inputs_of_their_own(record):
    for k in range(5):
        alone = TOLD.simulate(TIMES, 5, 1, inputs={u: OWN[:, k]})
        assert np.array_equal(alone.states[..., k], record.states[..., k])
    for filter in (extended_kalman(TOLD), unscented_kalman(TOLD)):
        found = filter.run(TIMES, record.measurements, inputs={u: OWN})
        both = smooth(filter, TIMES, record.measurements, inputs={u: OWN})
        for k in range(5):
            here = TIMES, record.measurements[..., k]
            one = filter.run(*here, inputs={u: OWN[:, k]})
            assert np.allclose(found.mean[..., k], one.mean, rtol=1e-12)
            assert np.allclose(found.loglik[:, k], one.loglik, rtol=1e-12)
            one = smooth(filter, *here, inputs={u: OWN[:, k]})
            assert np.allclose(both.mean[..., k], one.mean, rtol=1e-11)


def test_blocks_and_workers_have_the_inputs_of_their_paths(record):
    filter = extended_kalman(TOLD)
    whole = filter.run(TIMES, record.measurements, inputs={u: OWN})
    filter.block = lambda *_: 2
    for workers in (1, 3):
        told = {"inputs": {u: OWN}, "workers": workers}
        assert np.array_equal(filter.run(TIMES, record.measurements, **told).mean, whole.mean)
    square = record.measurements[..., :4].reshape(6, 1, 2, 2)
    found = filter.run(TIMES, square, inputs={u: OWN[:, :4].reshape(6, 2, 2)}).mean
    assert np.array_equal(found.reshape(6, 1, 4), whole.mean[..., :4])


def test_parameters_that_are_assigned_reach_all_blocks_and_threads(record):
    """Threads have contexts of their own, and blocks a part of the paths."""
    filter = extended_kalman(discrete(u + Parameter("shift", 0.0)))
    (shift,) = (p for p in filter.system.mentions if p.role == "parameter")
    with assigned({shift: np.arange(5.0)}):
        whole = filter.run(TIMES, record.measurements, inputs={u: OWN}).mean
        filter.block = lambda *_: 2
        again = filter.run(TIMES, record.measurements, inputs={u: OWN}, workers=2).mean
    assert np.array_equal(whole, again)
    wanted = extended_kalman(TOLD).run(TIMES, record.measurements, inputs={u: OWN + np.arange(5)})
    assert np.allclose(whole, wanted.mean, rtol=1e-12)


def kicked(u):
    return JumpDiffusion(
        [x], [u - x], [[1 + u**2 / 9]], [x + u / 3 + w], Noise((w,)), [0], [[1]],
        intensity=1 + u**2 / 4, jump=[u + v / 2], marks=Noise((v,)), step=0.02,
    )  # fmt: skip


def test_jumps_of_paths_with_inputs_of_their_own():
    system, times = kicked(u), TIMES / 4
    made = system.simulate(times, 5, 0, inputs={u: OWN})
    for k in range(5):
        alone = system.simulate(times, 5, 0, inputs={u: OWN[:, k]})
        assert np.array_equal(alone.states[..., k], made.states[..., k])
    filter = ParticleFilter(system, 20)
    for values in (VALUES, np.repeat(VALUES[:, None], 5, axis=1)):
        found = filter.run(times, made.measurements, inputs={u: values})
        assert np.array_equal(
            found.mean, filter.run(times, made.measurements, inputs={u: VALUES}).mean
        )
    filter = extended_kalman(system)
    found = filter.run(times, made.measurements, inputs={u: OWN})
    one = filter.run(times, made.measurements[..., 3], inputs={u: OWN[:, 3]})
    assert np.allclose(found.mean[..., 3], one.mean, rtol=1e-12)


def test_simulation_and_filter_mean_the_same_times():
    """The Kalman filter of a linear system is consistent; inputs told late are not."""
    system = LinearSystem(
        [[0.8]], [[0.1]], [[1.0]], [[0.2]], [0], [[1]], B=[[1]], D=[[0.5]], inputs=(u,)
    )
    filter, paths = KalmanFilter(system), 4000
    found = compare({"k": filter}, system, TIMES, paths, 2, inputs={u: VALUES}, consistency=True)
    assert np.abs(found["k"].nees - 1).max() < 5 * np.sqrt(2 / paths)
    assert np.abs(found["k"].nis - 1).max() < 5 * np.sqrt(2 / paths)
    data = system.simulate(TIMES, 500, 1, inputs={u: VALUES})
    late = filter.run(TIMES, data.measurements, inputs={u: np.roll(VALUES, 1)})
    square = (late.mean - data.states)[:, 0] ** 2 / late.cov[:, 0, 0, None]
    assert square.mean(axis=1).max() > 2


def test_comparisons_slice_the_inputs_of_paths():
    values = np.repeat(VALUES[:, None], 3000, axis=1)
    kinds = {"told": extended_kalman(TOLD), "written": extended_kalman(WRITTEN)}
    found = compare(kinds, TOLD, TIMES, 3000, 2, inputs={u: values})
    assert np.allclose(found["told"].rms, found["written"].rms, rtol=1e-12)
    wanted = compare(kinds, TOLD, TIMES, 3000, 2, inputs={u: VALUES}, workers=2)
    assert np.array_equal(found["told"].rms, wanted["told"].rms)


def test_the_last_measurement_as_an_input():
    """A leverage effect: the return correlates with the volatility that comes next."""
    last, rho = Input("last"), -0.7
    push = last * sp.exp(-x / 2)  # the last return in units of its volatility
    moves = StochasticMap(
        [x], [0.9 * x + 0.3 * (rho * push + sp.sqrt(1 - rho**2) * v)], Noise((v,))
    )
    system = DiscreteSystem(
        moves, StochasticMap([x], [sp.exp(x / 2) * w], Noise((w,))), [0], [[0.4]]
    )
    rng, count = np.random.default_rng(0), 300
    state, y = 0.0, np.empty((count, 1))
    for k in range(count):
        shock = rng.standard_normal()
        y[k] = np.exp(state / 2) * shock
        state = 0.9 * state + 0.3 * (rho * shock + np.sqrt(1 - rho**2) * rng.standard_normal())
    times = np.arange(float(count))
    filter = ParticleFilter(system, 200)
    told = filter.run(times, y, inputs={last: y[:, 0]}).loglik.sum()
    # the same noises without what correlates them
    blind = filter.run(times, y, inputs={last: np.zeros(count)}).loglik.sum()
    assert told > blind + 5
    with pytest.warns(UserWarning, match="uncorrelated"):
        filter = extended_kalman(system)
    assert np.isfinite(filter.run(times, y, inputs={last: y[:, 0]}).mean).all()


def test_step_by_step_with_assigned_values():
    filter, y = extended_kalman(TOLD), np.cos(TIMES)[:, None]
    wanted, state = filter.run(TIMES, y, inputs={u: VALUES}), filter.initial()
    for k, time in enumerate(TIMES):
        with assigned({u: VALUES[max(k - 1, 0)]}):
            state = filter.predict(state, time)
            ahead = filter.forecast(state, time)
        with assigned({u: VALUES[k]}):
            state = filter.correct(state, y[k])
        assert np.allclose(state.mean, wanted.mean[k], rtol=1e-13)
        assert ahead.mean.shape == (1,)
    with assigned({u: 0.5}):  # an input that does not change need not be told with each record
        found = filter.run(TIMES, y)
    assert np.array_equal(found.mean, filter.run(TIMES, y, inputs={u: np.full(6, 0.5)}).mean)


def test_a_gain_of_the_input_is_fitted():
    gain = Parameter("b", 0.2)
    system = LinearSystem([[0.7]], [[0.1]], [[1]], [[0.1]], [0], [[1]], B=[[gain]], inputs=(u,))
    times, rng = np.arange(40.0), np.random.default_rng(3)
    values = rng.standard_normal((40, 2))
    with assigned({gain: 1.3}):
        y = system.simulate(times, 2, 0, inputs={u: values}).measurements
    found = fit(KalmanFilter(system), times, y, [gain], inputs={u: values})
    assert abs(found.values[0] - 1.3) < 4 * found.errors[0] < 0.5
    one = fit(lambda: KalmanFilter(system), times, y, [gain], inputs={u: values})
    assert one.values == pytest.approx(found.values, rel=1e-5)


@pytest.mark.parametrize(
    ("inputs", "error", "words"),
    [
        (None, ValueError, "wanted values of u, got none"),
        ({u: VALUES, Input("q"): VALUES}, ValueError, "wanted those of the model, u, got q"),
        ({u: VALUES[:3]}, ValueError, r"inputs\[u\]: wanted shape \(6,\) or \(6, 5\)"),
        ({u: np.full(6, np.nan)}, ValueError, r"inputs\[u\]: wanted finite"),
        ({Parameter("u", 1.0): VALUES}, TypeError, "wanted a mapping of Input"),
        ([VALUES], TypeError, "wanted a mapping of Input"),
    ],
)
def test_what_does_not_fit_is_refused(record, inputs, error, words):
    with pytest.raises(error, match=words):
        extended_kalman(TOLD).run(TIMES, record.measurements, inputs=inputs)
    with pytest.raises(error, match=words):
        TOLD.simulate(TIMES, 5, 0, inputs=inputs)


def test_untold_inputs_and_places_without_them_say_so():
    assert inputs_of(TOLD) == {u}
    assert inputs_of(WRITTEN) == frozenset()
    filter = extended_kalman(TOLD)
    with pytest.raises(ValueError, match="u: wanted a value of this input"):
        filter.correct(filter.predict(filter.initial(), 0.0), [0.0])
    parts = [[0.9]], [[0.2]], [[1.0]], [[0.3]], [0], [[0]]
    with pytest.raises(ValueError, match="B, D, inputs"):
        LinearSystem(*parts, inputs=(u,))
    with pytest.raises(ValueError, match="B: wanted shape"):
        LinearSystem(*parts, B=[[1, 2]], inputs=(u,))
