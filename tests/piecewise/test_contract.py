import numpy as np
import pytest
import sympy as sp

from oracles import piecewise_routes as routes
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem, examples

INF = np.inf


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_one_region_is_the_kalman_filter(noise):
    rng = np.random.default_rng(8)
    system = PiecewiseLinearSystem(
        regions=[-INF, INF],
        dynamics=(rng.standard_normal(3), 0.5 * rng.standard_normal((3, 3))),
        noise=noise * rng.standard_normal((3, 2)),
        sensor=(rng.standard_normal(2), rng.standard_normal((2, 3))),
        sensor_noise=0.4 * np.eye(2),
        mean0=rng.standard_normal(3),
        cov0=np.eye(3) + 0.3,
    )
    y = system.simulate(12, 1, 4).measurements[..., 0]
    found = PiecewiseLinearFilter(system).run(12, y)
    mean, cov, loglik = routes.kalman(system, y[1:])
    assert found.mean[1:] == pytest.approx(mean, abs=1e-13)
    assert found.cov[1:] == pytest.approx(cov, abs=1e-13)
    assert found.loglik[1:] == pytest.approx(loglik, abs=1e-12)
    assert found.mode_prob == pytest.approx(np.ones((13, 1)), abs=1e-14)


@pytest.mark.parametrize(
    "system",
    [
        examples.falling_body(30),
        routes.tent(),
        routes.saturation(),
        routes.noisy_block(),
        routes.wave(9),
    ],
)
def test_one_data_set_is_the_same_in_a_batch(system):
    y = system.simulate(6, 12, 1).measurements
    y[3, 0, ::4] = np.nan
    filter_ = PiecewiseLinearFilter(system)
    batch = filter_.run(6, y)
    grid = filter_.run(np.arange(7.0), y.reshape(7, 1, 3, 4))
    assert grid.mean.shape == (7, system.state_size, 3, 4)
    assert grid.diverged.shape == (3, 4)
    assert np.array_equal(grid.cov.reshape(batch.cov.shape), batch.cov)
    for dataset in (0, 5, 11):
        alone = filter_.run(6, y[:, :, dataset])
        for name in ("mean", "cov", "mode_prob", "loglik", "diverged"):
            part, whole = getattr(alone, name), getattr(batch, name)
            assert part == pytest.approx(whole[..., dataset], rel=1e-11, abs=1e-13)


def test_pruned_data_set_is_the_same_in_a_batch():
    y = routes.tent().simulate(8, 12, 1).measurements
    filter_ = PiecewiseLinearFilter(routes.tent(), prune=1e-3)
    batch = filter_.run(8, y)
    for dataset in (0, 7):
        alone = filter_.run(8, y[:, :, dataset])
        assert alone.mean == pytest.approx(batch.mean[..., dataset], abs=1e-13)


def test_missing_measurement_is_no_measurement():
    """A step without data forecasts; a missing component is as if the sensor lacked it."""
    both = routes.noisy_block()
    double = PiecewiseLinearSystem(
        regions=both.regions, dynamics=both.dynamics, noise=both.noise,
        sensor=([[0.0, 0.1], [0.3, 0.2]], [[[0.3, 0.3], [1.0, 0.5]], [[1.0, 2.0], [0.0, 0.0]]]),
        sensor_noise=[[0.5, 0.0], [0.0, 0.7]], mean0=both.mean0, cov0=both.cov0,
    )  # fmt: skip
    y = double.simulate(4, 5, 2).measurements
    y[:, 1] = np.nan
    y[2] = np.nan
    pair, single = (PiecewiseLinearFilter(s).run(4, z) for s, z in ((double, y), (both, y[:, :1])))
    for one, other in zip(pair, single, strict=True):
        assert one == pytest.approx(other, abs=1e-13)
    assert pair.loglik[2] == pytest.approx(np.zeros(5), abs=1e-13)
    filter_ = PiecewiseLinearFilter(both)
    states = list(filter_.states(4, y[:, :1]))
    forecast = filter_.forecast(states[1], 2.0)
    assert forecast.mode_prob == pytest.approx(states[2].mode_prob, abs=1e-13)
    assert forecast.mean == pytest.approx(states[2].mean, abs=1e-13)
    again = filter_.correct(filter_.predict(states[2], 3.0), y[3, :1])
    assert again.cov == pytest.approx(states[3].cov, abs=1e-13)


def test_measurement_at_the_first_time_is_used():
    y = routes.measurements(np.array([0.3, 0.4]))
    y[0] = 0.7
    found = PiecewiseLinearFilter(routes.tent()).run(2, y)
    points, weights = routes.tent_nodes(3)
    prior = -0.5 * (points - 0.1) ** 2 / 0.25 - 0.5 * ((0.7 - np.abs(points)) / 0.2) ** 2
    mean, _, loglik = routes.posterior(
        points, prior, weights, lambda x: 1 - 1.8 * np.abs(x), np.abs, 0.2, [0.3, 0.4]
    )
    assert found.mean[1:, 0] == pytest.approx(mean, abs=1e-12)
    assert found.loglik[1:] == pytest.approx(loglik, abs=1e-12)


def test_impossible_measurement_spoils_its_own_data_set_only():
    y = routes.tent().simulate(5, 4, 3).measurements
    spoiled = y.copy()
    spoiled[2, 0, 1] = 1e200
    filter_ = PiecewiseLinearFilter(routes.tent())
    clean, found = filter_.run(5, y), filter_.run(5, spoiled)
    assert found.diverged.tolist() == [False, True, False, False]
    others = [0, 2, 3]
    assert np.array_equal(found.mean[..., others], clean.mean[..., others])
    assert np.isnan(found.mean[2:, 0, 1]).all()
    assert np.isfinite(found.mean[:2, 0, 1]).all()
    assert found.loglik[2, 1] == -INF
    for options in ({"prune": 1e-4}, {"merge": 0.1, "prune": 1e-3}, {"method": "matched"}):
        cut = PiecewiseLinearFilter(routes.tent(), **options)
        assert cut.run(5, spoiled).diverged.tolist() == [False, True, False, False]
        assert cut.run(5, spoiled[..., 1:2]).diverged.tolist() == [True]
    assert filter_.run(5, spoiled[..., 1:2]).diverged.tolist() == [True]
    with pytest.raises(ValueError, match="incompatible with every branch at t = 2"):
        filter_.run(5, spoiled[..., 1])


def test_far_measurement_is_no_failure():
    """Seventy standard deviations off: the weights live on the logarithmic scale."""
    found = PiecewiseLinearFilter(routes.tent()).run(2, routes.measurements([-14.0, 0.2]))
    assert np.isfinite(found.mean).all()
    assert found.loglik[1] < -1000


def test_neglected_integrals_do_not_show():
    noise = np.random.default_rng(3).standard_normal((30, 10))
    y = routes.falling(5.0, noise)
    system = examples.falling_body(200)
    full = PiecewiseLinearFilter(system, neglect=0.0).run(10, y)
    default = PiecewiseLinearFilter(system).run(10, y)
    assert default.mean == pytest.approx(full.mean, rel=1e-14)
    assert default.cov == pytest.approx(full.cov, rel=1e-12)
    coarse = PiecewiseLinearFilter(system, neglect=1e-3).run(10, y)
    deviation = np.sqrt(full.cov[:, 0, 0])
    assert 0.0 < np.abs((coarse.mean - full.mean)[:, 0] / deviation).max() < 5e-3


def test_precise_sensor_keeps_a_semidefinite_covariance():
    noise = np.random.default_rng(3).standard_normal((5, 10))
    system = examples.falling_body(100, sensor_noise=1e-7)
    t = np.arange(1, 11)[:, None]
    y = routes.measurements(0.1 - 0.005 * t**2 / 20.0 + 1e-7 * noise.T)
    found = PiecewiseLinearFilter(system).run(10, y)
    values = np.linalg.eigvalsh(np.moveaxis(found.cov, 3, 1))
    assert (values[..., 0] >= -1e-12 * values[..., 1]).all()


def test_sharp_sensor_keeps_the_digits_of_what_is_left():
    """One component is seen with an error of 1e-9; the other with NaN in half of the records."""
    system = PiecewiseLinearSystem(
        regions=[-INF, INF],
        dynamics=([0.0, 0.0], np.eye(2)),
        sensor=([0.0, 0.0], np.eye(2)),
        sensor_noise=np.diag([1e-9, 0.5]),
        mean0=[0.0, 0.0],
        cov0=[[1.0, 0.3], [0.3, 2.0]],
    )
    y = np.full((2, 2, 4), np.nan)
    y[1, 0], y[1, 1, :2] = 0.7, 0.2
    for batch in (y, y[..., 2:]):
        cov = PiecewiseLinearFilter(system).run(1, batch).cov[1]
        rest = 2 - sp.Rational(9, 100) / (1 + sp.Rational(1, 10**18))
        first = sp.Rational(1, 10**18) / (1 + sp.Rational(1, 10**18))
        assert cov[0, 0] == pytest.approx(float(first), rel=1e-12)
        assert cov[1, 1, -1] == pytest.approx(float(rest), rel=1e-14)
        assert cov[0, 1, -1] == pytest.approx(float(sp.Rational(3, 10) * first), rel=1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_random_systems_with_sharp_sensors_do_not_break(seed):
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((3, 3, 2))
    matrix[0, 1:], matrix[0, 0] = 0.0, rng.choice([-1, 1], 2) * rng.uniform(0.5, 1.5, 2)
    system = PiecewiseLinearSystem(
        regions=[-INF, 0.3, INF],
        dynamics=(rng.standard_normal((3, 2)), matrix),
        noise=np.array([[0.0], [1.0], [0.3]]) * 10.0 ** rng.uniform(-6, 0),
        sensor=(rng.standard_normal((2, 2)), rng.standard_normal((2, 3, 2))),
        sensor_noise=10.0 ** rng.uniform(-9, -6) * np.eye(2),
        mean0=np.zeros(3),
        cov0=np.eye(3),
    )
    runs = system.simulate(5, 3, seed)
    found = PiecewiseLinearFilter(system).run(5, runs.measurements)
    assert not found.diverged.any()
    variance = np.einsum("tiin->tin", found.cov)
    assert (variance >= 0.0).all()
    assert np.isfinite(found.mean).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "fast"}, "method: wanted"),
        ({"prune": 1.0}, "prune: wanted a share"),
        ({"prune": -0.1}, "prune: wanted a share"),
        ({"neglect": 2.0}, "neglect: wanted a share"),
        ({"merge": -1.0}, "merge: wanted a nonnegative"),
        ({"keep": 0}, "keep: wanted at least 1"),
        ({"max_branches": 1}, "max_branches: wanted"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        PiecewiseLinearFilter(routes.tent(), **options)


def test_bad_arguments_are_refused():
    filter_ = PiecewiseLinearFilter(routes.tent())
    with pytest.raises(TypeError, match="system: wanted"):
        PiecewiseLinearFilter("tent")
    with pytest.raises(ValueError, match="merge: wanted 0"):
        PiecewiseLinearFilter(routes.noisy_block(), merge=0.1)
    with pytest.raises(ValueError, match=r"measurements: wanted shape \(4, 1, \*batch\)"):
        filter_.run(3, np.zeros((3, 1)))
    with pytest.raises(ValueError, match="y: wanted shape"):
        filter_.step(filter_.initial(), 0.0, [1.0, 2.0])
    with pytest.raises(ValueError, match="state: wanted a state with a time"):
        filter_.correct(filter_.initial(), [1.0])
    started = filter_.step(filter_.initial(), 0.0, [np.nan])
    with pytest.raises(ValueError, match="t: wanted a time from 2 on, got 1"):
        filter_.predict(filter_.predict(started, 2.0), 1.0)
    with pytest.raises(ValueError, match="t: wanted a time from 0 on, got nan"):
        filter_.predict(started, np.nan)
    with pytest.raises(ValueError, match="finite"):
        filter_.run(1, routes.measurements([INF]))
    with pytest.raises(ValueError, match="times"):
        filter_.run([0.0, 2.0, 1.0], np.zeros((3, 1)))


def test_two_measurements_at_one_time_are_one_of_both():
    """Correcting twice at one time is the same as a sensor with two independent rows."""
    double = routes.tent(
        sensor=([[0.0, 0.0], [0.1, 0.2]], [[[-1.0, 1.0]], [[0.5, 1.0]]]),
        sensor_noise=[[0.2, 0.0], [0.0, 0.3]],
    )
    together = PiecewiseLinearFilter(double)
    y = double.simulate(3, 4, 6).measurements
    whole = together.run(3, y)
    state = together.initial((4,))
    for t in range(4):
        state = together.predict(state, float(t))
        total = np.zeros(4)
        for part in ([0], [1]):
            alone = np.full((2, 4), np.nan)
            alone[part] = y[t, part]
            state = together.correct(state, alone)
            total += state.loglik
        assert state.mean == pytest.approx(whole.mean[t], abs=1e-13)
        assert total == pytest.approx(whole.loglik[t], abs=1e-12)


def test_known_starting_point():
    """Prior without spread: the posterior is one deterministic path."""
    found = PiecewiseLinearFilter(routes.tent(cov0=[[0.0]])).run(
        3, routes.measurements([0.7, 0.1, 0.3])
    )
    x, path = 0.1, [0.1]
    for _ in range(3):
        x = 1 - 1.8 * abs(x)
        path.append(x)
    assert found.mean[:, 0] == pytest.approx(path, abs=1e-15)
    assert np.abs(found.cov).max() == 0.0
    expected = -0.5 * ((np.array([0.7, 0.1, 0.3]) - np.abs(path[1:])) / 0.2) ** 2
    expected -= np.log(0.2 * np.sqrt(2 * np.pi))
    assert found.loglik[1:] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("spread", [(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)])
def test_plane_prior_without_spread_in_some_direction(spread):
    """A start known in one component or both, against a sum over the other one."""
    base = routes.lozi()
    system = PiecewiseLinearSystem(
        regions=base.regions,
        dynamics=base.dynamics,
        sensor=base.sensor,
        sensor_noise=base.sensor_noise,
        mean0=base.mean0,
        cov0=np.diag(spread),
    )
    y = [0.6, -0.2, 0.4]
    found = PiecewiseLinearFilter(system).run(3, routes.measurements(y))
    step = np.linspace(-8.0, 8.0, 400_001) if any(spread) else np.zeros(1)
    x, z = (0.1 + np.sqrt(part) * step for part in spread)
    weight = np.exp(-0.5 * step**2)
    weight /= weight.sum()
    for t, value in enumerate(y, start=1):
        x, z = 1 - 1.7 * np.abs(x) + z, 0.5 * x
        density = np.exp(-0.5 * ((value - x) / 0.3) ** 2) / 0.3 / np.sqrt(2 * np.pi)
        total = (weight * density).sum()
        weight = weight * density / total
        assert found.mean[t] == pytest.approx([(weight * x).sum(), (weight * z).sum()], abs=1e-8)
        assert found.loglik[t] == pytest.approx(np.log(total), abs=1e-8)


def test_noise_free_sensor_of_a_known_state_is_refused():
    blind = routes.tent(sensor_noise=[[0.0]], cov0=[[0.0]])
    with pytest.raises(ValueError, match="sensor_noise: a predicted measurement has no spread"):
        PiecewiseLinearFilter(blind).run(1, routes.measurements([0.2]))
    sharp = routes.tent(sensor_noise=[[0.0]])
    with pytest.raises(ValueError, match="prune: the bound needs sensor noise"):
        PiecewiseLinearFilter(sharp, prune=1e-3).run(1, routes.measurements([0.2]))
    found = PiecewiseLinearFilter(sharp).run(1, routes.measurements([0.2]))
    # x0 = +-(1 -+ 0.2) / 1.8 explain the measurement: two points left of the kink, two right of it
    assert found.mode_prob[1].sum() == pytest.approx(1.0)
    roots = np.array([0.8, -0.8, 1.2, -1.2]) / 1.8
    weight = np.exp(-0.5 * (roots - 0.1) ** 2 / 0.25)
    assert found.mean[1, 0] == pytest.approx(
        0.2 * (weight[:2].sum() - weight[2:].sum()) / weight.sum()
    )
