"""Maps that see the elapsed time: discrete models on times at any distance."""

import pickle

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import quad_vec
from scipy.linalg import expm

from seedslib.base import ELAPSED, Input, Parameter, assigned
from seedslib.designed import SwitchingFilter
from seedslib.evaluation import fit
from seedslib.filters import (
    KalmanFilter,
    ParticleFilter,
    RaoBlackwellFilter,
    extended_kalman,
    smooth,
    unscented_kalman,
)
from seedslib.linearization import Taylor
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
    inputs_of,
)

x, z, v, w, t = sp.symbols("x z v w t")
u, rate = Input("u"), Parameter("a", 0.7, positive=True)
TIMES = np.array([0.0, 0.3, 1.0, 1.1, 2.5, 2.7])
VALUES = np.array([0.5, -1.0, 2.0, 0.3, 1.0, -0.5])
Y = np.cos(3 * TIMES)[:, None]
SENSOR = StochasticMap([x], [x + w / 2], Noise((w,)))


def relaxing(dt):
    """dX = (u - a X) dt + dB over a step, written out."""
    fade, spread = sp.exp(-rate * dt), sp.sqrt((1 - sp.exp(-2 * rate * dt)) / (2 * rate))
    move = [fade * x + (1 - fade) / rate * u + spread * v]
    return DiscreteSystem(StochasticMap([x], move, Noise((v,))), SENSOR, [0], [[1]])


def moved(t, x, v, a, u, dt):
    fade = np.exp(-a * dt)
    return fade * x + (1 - fade) / a * u + np.sqrt((1 - fade**2) / (2 * a)) * v


def functions():
    move = StochasticMap.from_functions(1, 1, moved, Noise(1), parameters=(rate, u, ELAPSED))
    return DiscreteSystem(move, SENSOR, [0], [[1]])


SYSTEM = relaxing(ELAPSED)
MATRICES = LinearSystem.from_continuous(
    -0.7, 1.0, 1.0, 0.25, 0, 1, step=None, B=[[1.0]], inputs=(u,)
)
CONTINUOUS = JumpDiffusion([x], [u - rate * x], [[1]], [x + w / 2], Noise((w,)), [0], [[1]])


@pytest.mark.parametrize("verb", ["run", "smooth"])
def test_four_ways_to_write_one_system_on_irregular_times(verb):
    def estimates(filter):
        run = filter.run if verb == "run" else lambda *a, **b: smooth(filter, *a, **b)
        return run(TIMES, Y, inputs={u: VALUES})

    wanted = estimates(extended_kalman(CONTINUOUS, step=0.005))
    for filter in (
        KalmanFilter(MATRICES), unscented_kalman(MATRICES), extended_kalman(SYSTEM),
        unscented_kalman(functions()),
    ):  # fmt: skip
        found = estimates(filter)
        assert np.allclose(found.mean, wanted.mean, rtol=1e-9)
        assert np.allclose(found.cov.ravel(), wanted.cov.ravel(), rtol=1e-9)
        assert np.allclose(found.loglik, wanted.loglik, rtol=1e-9)


def test_each_step_is_discretised_exactly():
    drift, push = np.array([[0.0, 1.0], [-2.0, -0.3]]), np.array([[0.2, 0.0], [1.0, 0.5]])
    noise, inputs = np.diag([0.0, 1.5]), (u, Input("s"))
    parts = drift, noise, [[1, 0]], [[0.2]], [0, 0], np.eye(2)
    for step in (0.3, 1.7):
        even = LinearSystem.from_continuous(*parts, step=step, B=push, inputs=inputs)
        free = LinearSystem.from_continuous(*parts, step=None, B=push, inputs=inputs)
        wanted = quad_vec(lambda s: expm(drift * s) @ push, 0, step, epsabs=1e-13)[0]
        spread = quad_vec(lambda s: expm(drift * s) @ noise @ expm(drift * s).T, 0, step)[0]
        at = np.array([0.3, -0.4])
        for system in (even, free):
            with assigned({ELAPSED: step, u: 0.8, inputs[1]: -0.6}):
                mean, cov = system.dynamics.conditional_moments(0.0, at[:, None])
            moved = expm(drift * step) @ at + wanted @ [0.8, -0.6]
            assert mean[:, 0] == pytest.approx(moved, rel=1e-11)
            assert cov.reshape(2, 2, -1)[..., 0] == pytest.approx(spread, rel=1e-8)


def test_diffuse_components_move_by_the_elapsed_time():
    """A wide first law, with what the width costs taken off, is the limit."""
    drift, noise = np.array([[0.0, 1.0], [0.0, -0.2]]), np.diag([0.1, 1.0])
    parts = drift, noise, [[1, 0]], [[0.2]], [0, 0]
    exact = LinearSystem.from_continuous(*parts, np.zeros((2, 2)), step=None, diffuse=(0, 1))
    wide = LinearSystem.from_continuous(*parts, 1e8 * np.eye(2), step=None)
    found, near = (KalmanFilter(s).run(TIMES, Y) for s in (exact, wide))
    assert found.mean[2:] == pytest.approx(near.mean[2:], rel=1e-5)
    found, near = (smooth(KalmanFilter(s), TIMES, Y) for s in (exact, wide))
    assert found.mean == pytest.approx(near.mean, rel=1e-4)


def test_entries_of_matrices_may_mention_it():
    system = LinearSystem(
        [[sp.exp(-rate * ELAPSED)]], [[(1 - sp.exp(-2 * rate * ELAPSED)) / (2 * rate)]], [[1]],
        [[0.25]], [0], [[1]], B=[[(1 - sp.exp(-rate * ELAPSED)) / rate]], inputs=(u,),
    )  # fmt: skip
    assert system.mentions == {rate, ELAPSED, u}
    found = KalmanFilter(system).run(TIMES, Y, inputs={u: VALUES})
    wanted = extended_kalman(SYSTEM).run(TIMES, Y, inputs={u: VALUES})
    assert np.allclose(found.loglik, wanted.loglik, rtol=1e-12)


def test_simulated_steps_have_the_moments_of_their_lengths():
    paths = 20_000
    found = SYSTEM.simulate(TIMES, paths, 0, inputs={u: VALUES}).states[:, 0]
    mean, square = 0.0, 1.0
    for k, dt in enumerate(np.diff(TIMES)):
        fade = np.exp(-0.7 * dt)
        mean = fade * mean + (1 - fade) / 0.7 * VALUES[k]
        square = fade**2 * square + (1 - fade**2) / 1.4
        assert abs(found[k + 1].mean() - mean) < 4.5 * np.sqrt(square / paths)
        assert abs(found[k + 1].var() / square - 1) < 4.5 * np.sqrt(2 / paths)
    filter = ParticleFilter(SYSTEM, 4000).run(TIMES, Y, inputs={u: VALUES})
    exact = KalmanFilter(MATRICES).run(TIMES, Y, inputs={u: VALUES})
    assert np.abs(filter.mean - exact.mean).max() < 5 * np.sqrt(exact.cov.max() / 4000)


def switching(dt):
    """A chain that leaves its modes at the rates 1 and 1/2, and a state that knows the mode."""
    gone = 1 - sp.exp(-3 * dt / 2)
    leave = [[1 - 2 * gone / 3, 2 * gone / 3], [gone / 3, 1 - gone / 3]]
    moves = [[x * (1 - dt / 3) + sp.sqrt(dt) * v], [x + dt + 2 * sp.sqrt(dt) * v]]
    first = [(1.0, [0], [[1]]), (0.0, [1], [[1]])]
    return SwitchingSystem(
        [x], moves, Noise((v,)), leave, [[x + w], [x + w / 2]], Noise((w,)), first, time=t
    )


def test_probabilities_of_switching_over_gaps():
    system, paths = switching(ELAPSED), 20_000
    modes = system.simulate(TIMES, paths, 0).modes
    generator = np.array([[-1, 0.5], [1, -0.5]])
    for k, time in enumerate(TIMES):
        share = expm(generator * time)[1, 0]
        assert abs(modes[k].mean() - share) <= 4.5 * np.sqrt(share * (1 - share) / paths)
    steps = sp.Piecewise(*((dt, t < b) for dt, b in zip(np.diff(TIMES), TIMES[1:], strict=True)))
    # the lengths written as a function of the time that is left; dt is mentioned and unused
    written = switching(sp.Max(sp.Piecewise((steps, t < TIMES[-1]), (1, True)), ELAPSED - 9))
    made = system.simulate(TIMES, 5, 0).measurements
    for filter in (lambda s: SwitchingFilter(s, Taylor()), lambda s: RaoBlackwellFilter(s, 20)):
        found, wanted = (filter(s).run(TIMES, made) for s in (system, written))
        assert np.allclose(found.mean, wanted.mean, rtol=1e-11)
        assert np.allclose(found.loglik, wanted.loglik, rtol=1e-11)


def test_array_functions_are_given_values_after_their_own_arguments():
    system = functions()
    assert inputs_of(system) == {u}
    assert system.mentions == {rate, u, ELAPSED}
    again = pickle.loads(pickle.dumps(system.dynamics))
    with assigned({u: np.array([1.0, 2.0]), ELAPSED: 0.5, rate: 2.0}):
        point = 0.0, np.array([[1.0, 3.0]]), np.array([[0.1, -0.2]])
        wanted = moved(*point, 2.0, np.array([1.0, 2.0]), 0.5)
        assert np.array_equal(again.value(*point), wanted)
    sensed = StochasticMap.from_functions(
        1, 1, lambda t, x, v, a: x + a * v, Noise(1), parameters=(rate,),
        mean=lambda t, x, a: x, cov=lambda t, x, a: a**2 * np.ones((1, *x.shape)),
        log_density=lambda t, y, x, a: -0.5 * ((y - x)[0] / a) ** 2 - np.log(a),
        weight=lambda t, x, v, a: np.exp(-a * x[0] ** 2),
    )  # fmt: skip
    assert sensed.whole().mentions == {rate}
    at = np.array([[0.5]])
    with assigned({rate: 2.0}):
        assert sensed.conditional_moments(0.0, at)[1].item() == 4.0
        found = sensed.log_density(0.0, np.array([[1.5]]), at)
        assert found == pytest.approx(-0.125 - np.log(2))
        assert sensed.weight(0.0, at, at) == pytest.approx(np.exp(-0.5))
    with pytest.raises(TypeError, match="parameters: wanted a sequence of Parameter"):
        StochasticMap.from_functions(1, 1, moved, Noise(1), parameters=(x,))


def test_functions_of_a_jump_diffusion_are_given_them_too():
    system = JumpDiffusion.from_functions(
        lambda t, x, a, u: u - a * x, lambda t, x, a, u: np.ones((1, *x.shape)), SENSOR, [0],
        [[1]], parameters=(rate, u), step=0.05,
    )  # fmt: skip
    found = unscented_kalman(system).run(TIMES, Y, inputs={u: VALUES})
    wanted = extended_kalman(CONTINUOUS, step=0.05).run(TIMES, Y, inputs={u: VALUES})
    assert np.allclose(found.mean, wanted.mean, rtol=1e-11)


def test_a_rate_is_fitted_on_irregular_times():
    times = np.cumsum(np.random.default_rng(0).exponential(size=60))
    values = np.sin(times)
    with assigned({rate: 1.2}):
        y = SYSTEM.simulate(times, 1, 0, inputs={u: values}).measurements[..., 0]
    found = [
        fit(filter, times, y, [rate], inputs={u: values})
        for filter in (extended_kalman(SYSTEM), unscented_kalman(functions()))
    ]
    assert found[0].values == pytest.approx(found[1].values, rel=1e-6)
    assert abs(found[0].values[0] - 1.2) < 3 * found[0].errors[0]


def test_unequal_steps_are_refused_of_maps_that_do_not_see_them():
    system = relaxing(sp.Integer(1))
    for refused in (
        lambda: extended_kalman(system).run(TIMES, Y, inputs={u: VALUES}),
        lambda: system.simulate(TIMES, 3, 0, inputs={u: VALUES}),
    ):
        with pytest.raises(ValueError, match=r"wanted equal steps.*ELAPSED"):
            refused()
    filter, state = extended_kalman(SYSTEM), None
    state = filter.initial()
    with assigned({u: 0.0}):
        for time in TIMES:
            state = filter.predict(state, time)
    assert state.time == TIMES[-1]


def test_where_no_step_is_made_there_is_no_elapsed_time():
    sensed = StochasticMap([x], [x + ELAPSED * w], Noise((w,)))
    system = DiscreteSystem(SYSTEM.dynamics, sensed, [0], [[1]])
    moving = JumpDiffusion([x], [-x * ELAPSED], [[1]], [x + w], Noise((w,)), [0], [[1]])
    for filter, inputs in ((extended_kalman(system), {u: VALUES}), (extended_kalman(moving), {})):
        with pytest.raises(ValueError, match="dt: the elapsed time is known only while"):
            filter.run(TIMES, Y, inputs=inputs)


def test_inputs_and_the_elapsed_time_travel():
    assert pickle.loads(pickle.dumps(ELAPSED)) == ELAPSED
    assert pickle.loads(pickle.dumps(Input("q", positive=True))) == Input("q", positive=True)
    assert Input("dt", positive=True) != ELAPSED
    assert Input("a", positive=True) != Parameter("a", 0.5, positive=True)
    again = pickle.loads(pickle.dumps(MATRICES.dynamics))
    with assigned({ELAPSED: 0.4}):
        assert again.slope_at(0.0)[0, 0] == pytest.approx(np.exp(-0.28), rel=1e-14)


def test_sensors_of_symbolic_systems_have_components_on_a_circle():
    turn = 2 * np.pi
    system = JumpDiffusion([x], [0], [[1]], [x + w], Noise((w,)), [3], [[0.1]], period={0: turn})
    assert dict(system.sensor.period) == {0: turn}
    filter, beyond = extended_kalman(system), np.array([[3.1], [-3.1]])
    found = filter.run([0.0, 1.0], beyond).mean
    assert found == pytest.approx(filter.run([0.0, 1.0], beyond + np.array([[0], [turn]])).mean)
    modes = SwitchingSystem(
        [x], [[x + v]], Noise((v,)), [[1]], [[x + w]], Noise((w,)), [(1, [3], [[0.1]])],
        period={0: turn},
    )  # fmt: skip
    assert dict(modes.sensors[0].period) == {0: turn}
    shown = RaoBlackwellFilter(modes, 4).run([0.0, 1.0], beyond).mean
    assert shown == pytest.approx(found, rel=1e-9)
