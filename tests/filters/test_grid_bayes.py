"""The Bayes filter on nodes against exact filters, sums over histories and literal sums."""

import warnings

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from oracles.linear import Linear, Regression, Switching, histories
from seedslib.base import ELAPSED, Input, Nodes
from seedslib.filters import GridBayesFilter, KalmanFilter, ParticleFilter, smooth
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap, SwitchingSystem
from seedslib.zoo import dependent_switching
from systems import growth

x, v, w = sympy.symbols("x v w", real=True)
t, u = sympy.Symbol("t"), Input("u")
TIMES = np.array([1.5, 1.9, 2.7, 3.0, 3.3])
PUSH = np.array([0.5, -1.0, 0.8, 0.3, -0.2])
SHOWN = np.array([0, -1, 1, 1, 0])
Y = np.array([[0.4, np.nan], [1.6, -0.3], [np.nan, np.nan], [np.nan, 0.7], [-0.5, 1.1]])
START = [(0.6, 0.5, 0.8), (0.4, -0.4, 1.2)]
NODES = (-8.0, 9.0, 171)


def coefficients(t, h, u, mode, m=np):
    """x' = f x + b + s v, y = h x + d + w: slopes, offsets, deviation of the noise."""
    f, b = 0.9 - 0.5 * mode + 0.2 * m.sin(t), h * u + mode - 0.3
    return f, b, 0.5 + 0.3 * h, [1, 0.3 * t - mode], [0.2 * u, mode]


def chances(t, m=np):
    s = m.sin(t) ** 2
    return [[0.8 - 0.3 * s, 0.2 + 0.3 * s], [0.3, 0.7]], [
        [0.9, 0.1],
        [0.2 + 0.3 * s, 0.8 - 0.3 * s],
    ]


def numbers(mode):
    steps = np.diff(TIMES)
    made = [coefficients(*now, mode) for now in zip(TIMES, np.append(steps, 0), PUSH, strict=True)]
    f, b, s, H, d = (np.array(part, dtype=float) for part in zip(*made, strict=True))
    Q = (s[:-1] ** 2)[:, None, None]
    R = np.tile(np.diag([0.6, 0.9]), (5, 1, 1))
    _, mean, cov = START[mode]
    F = f[:-1, None, None]
    return Linear(F, b[:-1, None], Q, H[..., None], d, R, np.array([mean]), np.array([[cov]]))


def formulas(mode):
    f, b, s, H, d = coefficients(t, ELAPSED, u, mode, sympy)
    noise = sympy.symbols("w1 w2")
    return [f * x + b + s * v], [a * x + c + q for a, c, q in zip(H, d, noise, strict=True)], noise


def systems():
    """The switching system and its oracle; the first mode alone and its oracle."""
    (move, show, noise), (other, shown, _) = formulas(0), formulas(1)
    sensor_noise = Noise(noise, cov=np.diag([0.6, 0.9]))
    leave, tell = chances(t, sympy)
    initial = [(p, [m], [[c]]) for p, m, c in START]
    switching = SwitchingSystem(
        (x,),
        [move, other],
        Noise((v,)),
        leave,
        [show, shown],
        sensor_noise,
        initial,
        indicator=tell,
    )
    maps = StochasticMap((x,), move, Noise((v,))), StochasticMap((x,), show, sensor_noise)
    leave, tell = zip(*map(chances, TIMES), strict=True)
    modes = [numbers(0), numbers(1)]
    exact = Switching(modes, np.array([0.6, 0.4]), np.array(leave[:-1]), np.array(tell))
    return switching, exact, DiscreteSystem(*maps, 0.5, 0.8), modes[0]


SWITCHING, MODES, ALONE, LINEAR = systems()


def close(estimates, dist, k=...):
    np.testing.assert_allclose(estimates.mean[k], dist.mean, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(estimates.cov[k], dist.cov, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(estimates.mode_prob[k], dist.mode_prob, rtol=1e-7)


def test_modes_on_nodes_equal_the_sum_over_histories():
    """Run, smoothing, steps and two forecasts in a row, with an input and missing parts."""
    filter = GridBayesFilter(SWITCHING, NODES)
    given = {"indicators": SHOWN, "inputs": {u: PUSH}}
    estimates = filter.run(TIMES, Y, **given)
    for lag in (None, 2):
        smoothed = smooth(filter, TIMES, Y, lag=lag, **given)
        for k in range(5):
            last = 4 if lag is None else min(k + lag, 4)
            close(smoothed, histories(MODES, Y, SHOWN, k, last), k)
    total = [histories(MODES, Y, SHOWN, k, k).loglik for k in range(5)]
    np.testing.assert_allclose(estimates.loglik, np.diff(total, prepend=0), rtol=1e-7, atol=1e-9)
    state = filter.initial()
    for k in range(5):
        close(estimates, histories(MODES, Y, SHOWN, k, k), k)
        state = filter.predict(state, TIMES[k], inputs={u: PUSH[max(k - 1, 0)]})
        close(state, histories(MODES, Y, SHOWN, k, k - 1))
        if k == 3:
            close(
                filter.forecast(state, TIMES[4], inputs={u: PUSH[3]}),
                histories(MODES, Y, SHOWN, 4, 2),
            )
        state = filter.correct(state, Y[k], SHOWN[k], inputs={u: PUSH[k]})
    np.testing.assert_array_equal(estimates.modes, estimates.mode_prob.argmax(axis=1))
    assert not estimates.diverged


@pytest.mark.parametrize("nodes", [NODES, "uneven"])
def test_one_dist_on_nodes_equals_regression(nodes):
    if nodes == "uneven":
        s = np.linspace(-1.2, 1.2, 161)
        nodes = Nodes(6 * np.sinh(s), 6 * np.cosh(s) * (s[1] - s[0]))
    exact = Regression(LINEAR)
    y = np.stack([Y, np.nan_to_num(Y)], axis=-1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        filter = GridBayesFilter(ALONE, nodes)
        estimates = filter.run(TIMES, y, inputs={u: PUSH})
    smoothed = smooth(filter, TIMES, y, inputs={u: PUSH})
    for i in range(2):
        for part, dist in (
            (estimates, exact.filtered(y[..., i])),
            (smoothed, exact.smoothed(y[..., i])),
        ):
            np.testing.assert_allclose(part.mean[..., i], dist[0], atol=1e-7)
            np.testing.assert_allclose(part.cov[..., i], dist[1], atol=1e-7)
        np.testing.assert_allclose(estimates.loglik[:, i], exact.logliks(y[..., i]), atol=1e-7)
    assert estimates.mode_prob is None
    assert estimates.modes is None
    assert not estimates.diverged.any()


def test_two_components_equal_the_kalman_filter():
    """Matrices without symmetry, a correlated start, and a correlated noise."""
    system = LinearSystem(
        [[0.5, 0.2], [-0.1, 0.4]],
        [[0.5, 0.1], [0.1, 0.4]],
        [[1.0, 0.5]],
        [[0.3]],
        [0.2, 0.0],
        [[0.6, 0.1], [0.1, 0.5]],
    )
    times, y = 3.0 + np.arange(6.0), np.random.default_rng(1).standard_normal((6, 1, 3))
    y[4, 0, 1] = np.nan
    filter = GridBayesFilter(system, [(-5.2, 5.2, 27), (-4.6, 4.6, 26)])
    estimates, wanted = filter.run(times, y), KalmanFilter(system).run(times, y)
    np.testing.assert_allclose(estimates.mean, wanted.mean, atol=1e-6)
    np.testing.assert_allclose(estimates.cov, wanted.cov, atol=1e-6)
    np.testing.assert_allclose(estimates.loglik, wanted.loglik, atol=1e-6)


def test_growth_model_equals_literal_sums_over_nodes():
    system, times = growth(), 2 + np.arange(4.0)
    y = system.simulate(times, 1, 4).measurements[..., 0]
    nodes = np.linspace(-36, 36, 289)
    dist, total = norm.pdf(nodes, 0.5, np.sqrt(2.0)), 0.0
    estimates = GridBayesFilter(system, (-36, 36, 289)).run(times, y)
    for k in range(4):
        if k:
            moved = nodes / 2 + 25 * nodes / (1 + nodes**2) + 8 * np.cos(1.2 * times[k - 1])
            dist = 0.25 * norm.pdf(nodes[:, None], moved, np.sqrt(10)) @ dist
        dist = dist * norm.pdf(y[k, 0], nodes**2 / 20, 1.0) * (1 if k else 0.25)
        total, dist = np.log(dist.sum()), dist / dist.sum()
        mean = dist @ nodes
        assert estimates.mean[k, 0] == pytest.approx(mean, rel=1e-9, abs=1e-9)
        assert estimates.cov[k, 0, 0] == pytest.approx(dist @ (nodes - mean) ** 2, rel=1e-9)
        assert estimates.loglik[k] == pytest.approx(total, rel=1e-9)


def test_particles_come_close_where_noises_and_indicator_depend_on_the_state():
    system = dependent_switching()
    data = system.simulate(np.arange(6.0), 30, 2)
    given = {"indicators": data.indicators}
    exact = GridBayesFilter(system, (-9, 9, 181)).run(data.times, data.measurements, **given)
    for count in (250, 4000):
        estimates = ParticleFilter(system, count).run(
            data.times, data.measurements, seed=3, **given
        )
        scale = np.sqrt(exact.cov[:, 0].mean() / count)
        assert 0.3 * scale < np.sqrt(((estimates.mean - exact.mean) ** 2).mean()) < 4 * scale
        apart = np.sqrt(((estimates.mode_prob - exact.mode_prob) ** 2).mean())
        assert apart < 1.2 / np.sqrt(count)


def test_blocks_threads_and_batches_do_not_matter():
    filter = GridBayesFilter(SWITCHING, (-8, 9, 61))
    y = np.random.default_rng(0).standard_normal((5, 2, 600))
    shown = np.random.default_rng(0).integers(-1, 2, (5, 600))
    whole = filter.run(TIMES, y, indicators=shown, inputs={u: PUSH})
    folded = filter.run(
        TIMES,
        y.reshape(5, 2, 6, 100),
        indicators=shown.reshape(5, 6, 100),
        inputs={u: PUSH},
        workers=2,
    )
    np.testing.assert_array_equal(folded.mean.reshape(5, 1, 600), whole.mean)
    np.testing.assert_array_equal(folded.mode_prob.reshape(5, 2, 600), whole.mode_prob)
    single = filter.run(TIMES, y[..., 7], indicators=shown[:, 7], inputs={u: PUSH})
    np.testing.assert_allclose(single.mean, whole.mean[..., 7], rtol=1e-10)
    assert single.modes.shape == (5,)
    with pytest.raises(ValueError, match="u"):  # one transition for all records
        filter.run(TIMES, y, indicators=shown, inputs={u: PUSH[:, None] * np.ones(600)})


@pytest.mark.parametrize("modes", [False, True])
def test_measurement_that_leaves_the_nodes_is_marked_for_good(modes):
    """In a run and step by step; the estimate stays a number and comes back."""
    system = SWITCHING if modes else ALONE
    filter, y = GridBayesFilter(system, (-8, 9, 101)), np.zeros((5, 2, 4))
    y[1, 0, 1], y[1, 0, 2], y[1, :, 3] = 1e160, 1e3, np.nan
    options = {"indicators": np.zeros((5, 4), int)} if modes else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        estimates = filter.run(TIMES, y, inputs={u: PUSH}, **options)
        assert estimates.diverged.tolist() == [False, True, True, False]
        assert np.isneginf(estimates.loglik[1, 1])
        assert np.isfinite(estimates.mean).all()
        assert abs(estimates.mean[-1, 0, 2]) < 1
        state = filter.initial((4,))
        for k in range(5):
            shown = (options["indicators"][k],) if modes else ()
            state = filter.step(state, TIMES[k], y[k], *shown, inputs={u: 0.5})
            assert filter.report(state).diverged.tolist() == [False, k > 0, k > 0, False]
        smoothed = smooth(filter, TIMES, y, inputs={u: PUSH}, **options)
        assert smoothed.diverged.tolist() == [False, True, True, False]


def test_probability_that_leaves_the_nodes_is_dropped_and_warned_about():
    """Of a normal distribution cut off at two deviations; a switching system keeps it on the
    nodes."""
    still = StochasticMap([x], [x + v], Noise([v], cov=[[0.25]]))
    sensor = StochasticMap([x], [x + w], Noise([w]))
    missing = [[np.nan], [np.nan]]
    filter = GridBayesFilter(DiscreteSystem(still, sensor, 0.0, 0.0), (-1.0, 1.0, 2001))
    with pytest.warns(UserWarning, match=r"^x: "):
        estimates = filter.run([0, 1], missing)
    inside = norm.cdf(2.0) - norm.cdf(-2.0)
    assert estimates.loglik.sum() == pytest.approx(np.log(inside), abs=4e-7)
    assert estimates.mean[1, 0] == pytest.approx(0.0, abs=1e-12)
    variance = 0.25 * (1 - 4 * norm.pdf(2.0) / inside)
    assert estimates.cov[1, 0, 0] == pytest.approx(variance, rel=1e-6)
    one = SwitchingSystem.from_maps([still], [[1]], [sensor], [(1, [0], [[0]])])
    filter = GridBayesFilter(one, (-1.0, 1.0, 401))
    with pytest.warns(UserWarning, match=r"^x: "):
        estimates = filter.run([0, 1], missing)
    assert estimates.loglik.sum() == pytest.approx(0.0, abs=1e-12)
    lost = filter.chain.loss(0.0, 1.0)
    assert lost[200] == pytest.approx(1 - inside, abs=1e-4)
    assert lost[-1] == pytest.approx(norm.cdf(0.0) + norm.cdf(-4.0), abs=1e-4)


@pytest.mark.parametrize("drives", ["old", "new"])
def test_nodes_of_modes_that_are_short_or_coarse_for_the_noise_are_warned_about(drives):
    """Each step adds h**2 / 12 to the variance where cells are wide; fine nodes say nothing."""
    system = SwitchingSystem(
        (x,),
        [[0.9 * x + v / 4]] * 2,
        Noise((v,)),
        [[0.9, 0.1], [0.2, 0.8]],
        [[x + w]] * 2,
        Noise((w,)),
        [(0.5, [0], [[0.3]])] * 2,
        drives=drives,
    )
    y = np.zeros((5, 1))
    for axis, warned in (((-6, 6, 97), False), ((-6, 6, 25), True), ((-0.7, 0.7, 29), True)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            GridBayesFilter(system, axis).run(range(5), y)
        assert {str(one.message)[:2] for one in caught} == ({"x:"} if warned else set())


def test_mode_returns_from_any_log_odds():
    """50 measurements for mode 0 and 100 for mode 1, each worth 18 / 1.000001 in log-odds."""
    system = SwitchingSystem(
        (x,),
        [[v]] * 2,
        Noise((v,), cov=[[1e-6]]),
        [[1, 0], [0, 1]],
        [[x + w], [6 + x + w]],
        Noise((w,)),
        [(0.5, [0], [[1e-6]])] * 2,
    )
    filter, state = GridBayesFilter(system, (-0.01, 0.01, 161)), None
    y = np.where(np.arange(150) < 50, 0.0, 6.0)
    for batch in ((), (2,)):
        state = filter.initial(batch)
        for k in range(150):
            state = filter.step(state, float(k), np.full((1, *batch), y[k]))
            if k in (49, 149):
                wanted = {49: -900, 149: 900}[k] / 1.000001
                odds = state.log_prob[1] - state.log_prob[0]
                np.testing.assert_allclose(odds, wanted, rtol=1e-9)
                assert (filter.report(state).modes == (k > 49)).all()
    assert not state.diverged.any()


@pytest.mark.parametrize("push", [-1e-15, 0.0, 1e-15])
def test_equal_modes_are_decided_for_the_first(push):
    """Two modes in which everything is the same but a last bit of the initial distribution."""
    system = SwitchingSystem(
        (x,),
        [[x / 2 + v]] * 2,
        Noise((v,)),
        [[0.9, 0.1], [0.1, 0.9]],
        [[x + w]] * 2,
        Noise((w,)),
        [(0.5 + push, [0], [[1]]), (0.5 - push, [0], [[1]])],
    )
    y = np.random.default_rng(0).standard_normal((5, 1, 20))
    filter = GridBayesFilter(system, (-6, 6, 61))
    assert (filter.run(np.arange(5.0), y).modes == 0).all()
    assert (smooth(filter, np.arange(5.0), y).modes == 0).all()
