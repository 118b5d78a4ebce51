"""Single verbs of the piecewise-linear filter: options, start, prediction, correction, shapes."""

import numpy as np
import pytest
from scipy.stats import norm

from oracles import piecewise_routes as routes
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem

INF = np.inf


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "fast"}, 'method: wanted "auto", "exact" or "matched", got \'fast\'$'),
        ({"prune": 1.0}, r"prune: wanted a share in \[0, 1\), got 1$"),
        ({"prune": -0.5}, r"prune: wanted a share in \[0, 1\), got -0.5$"),
        ({"prune": np.nan}, "prune: wanted finite numbers"),
        ({"prune": [0.1]}, "prune: wanted 0 axes"),
        ({"neglect": 1.0}, r"neglect: wanted a share in \[0, 1\), got 1$"),
        ({"neglect": -1e-30}, r"neglect: wanted a share in \[0, 1\), got -1e-30$"),
        ({"neglect": np.nan}, "neglect: wanted finite numbers"),
        ({"merge": -0.5}, "merge: wanted a nonnegative distance, got -0.5$"),
        ({"merge": INF}, "merge: wanted finite numbers"),
        ({"merge": [0.1]}, "merge: wanted 0 axes"),
        ({"keep": 0}, "keep: wanted at least 1, got 0$"),
        ({"max_branches": 1}, "max_branches: wanted at least one per cell, got 1$"),
        ({"max_branches": np.nan}, "max_branches: wanted at least one per cell, got nan$"),
    ],
)
def test_options_that_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        PiecewiseLinearFilter(routes.tent(), **options)


def test_kinds_that_are_refused():
    with pytest.raises(TypeError, match="system: wanted a PiecewiseLinearSystem"):
        PiecewiseLinearFilter(routes.tent().discrete())
    with pytest.raises(TypeError, match=r"keep: wanted a whole number, got 2\.5$"):
        PiecewiseLinearFilter(routes.tent(), keep=2.5)
    with pytest.raises(ValueError, match=r"merge: wanted 0 for a state of 2 components$"):
        PiecewiseLinearFilter(routes.noisy_block(), merge=1e-9)
    PiecewiseLinearFilter(routes.noisy_block(), merge=0.0)
    PiecewiseLinearFilter(routes.tent(), prune=0.0, neglect=0.0, max_branches=2)


def test_options_are_what_was_asked_for():
    plain = PiecewiseLinearFilter(routes.tent())
    assert (plain.method, plain.prune, plain.keep, plain.merge) == ("auto", 0.0, None, 0.0)
    assert (plain.neglect, plain.max_branches) == (1e-30, 20_000)
    other = PiecewiseLinearFilter(routes.tent(), method="exact", prune=0.25, keep=3, merge=1,
                                  neglect=0.5, max_branches=7)  # fmt: skip
    assert (other.method, other.prune, other.keep, other.merge) == ("exact", 0.25, 3, 1.0)
    assert (other.neglect, other.max_branches) == (0.5, 7)


@pytest.mark.parametrize("batch", [(), (3,), (2, 2)])
def test_the_first_state_is_the_prior(batch):
    system = routes.noisy_block()
    state = PiecewiseLinearFilter(system).initial(batch)
    assert state.time is None
    each = (1,) * len(batch)
    assert state.mean.shape == (2, *batch)
    np.testing.assert_allclose(
        state.mean, system.mean0.reshape(2, *each) * np.ones(batch), atol=1e-15
    )
    np.testing.assert_allclose(
        state.cov, system.cov0.reshape(2, 2, *each) * np.ones(batch), atol=1e-15
    )
    left = norm.cdf(-0.1 / 0.5)
    wanted = np.reshape([left, 1 - left], (2, *each)) * np.ones(batch)
    np.testing.assert_allclose(state.mode_prob, wanted, rtol=1e-13)
    np.testing.assert_allclose(state.weights, wanted, rtol=1e-13)
    for part in (state.loglik, state.lost, state.distance, state.diverged, state.error_bound):
        assert part.shape == batch
        assert not part.any()
    assert state.diverged.dtype == bool


def test_predicting_to_the_time_of_a_state_only_forgets_the_measurement():
    filter_ = PiecewiseLinearFilter(routes.tent())
    start = filter_.initial((2,))
    timed = filter_.predict(start, 3)
    assert isinstance(timed.time, float)
    assert timed.time == 3.0
    assert timed.branches is start.branches
    seen = filter_.correct(timed, [[0.3, 0.4]])
    assert (seen.loglik != 0.0).all()
    again = filter_.predict(seen, 3.0)
    assert again.loglik.tolist() == [0.0, 0.0]
    assert again.mean is seen.mean
    later = filter_.predict(seen, 4.0)
    assert later.loglik.tolist() == [0.0, 0.0]
    assert later.time == 4.0


OPTIONS = [{}, {"prune": 1e-2}, {"merge": 0.3}, {"keep": 3, "merge": 0.1}, {"method": "matched"}]


@pytest.mark.parametrize("options", OPTIONS)
def test_a_step_is_a_prediction_and_a_correction(options):
    filter_ = PiecewiseLinearFilter(routes.tent(), **options)
    y = routes.tent().simulate(4, 3, 2).measurements
    one = other = filter_.initial((3,))
    for t in range(5):
        one = filter_.step(one, t, y[t])
        other = filter_.correct(filter_.predict(other, t), y[t])
        assert one.time == other.time == t
        for name in ("mean", "cov", "mode_prob", "loglik", "lost", "distance", "diverged"):
            pair = getattr(one, name), getattr(other, name)
            np.testing.assert_allclose(*pair, rtol=1e-12, atol=1e-15, err_msg=name)


def test_a_step_that_follows_the_estimate_linearises_at_the_prediction():
    system = routes.wave(6, support="estimate")
    filter_ = PiecewiseLinearFilter(system)
    state = filter_.step(filter_.initial(), 0.0, [np.nan])
    ahead = filter_.predict(state, 1.0)
    after, both = filter_.correct(ahead, [0.7]), filter_.step(state, 1.0, [0.7])
    assert after.mean == both.mean
    seen = system.sensor_at(1.0, ahead.mean[:, None])
    same = PiecewiseLinearSystem(
        regions=system.regions, dynamics=lambda t: None, mean0=[1.0], cov0=[[0.5]],
        sensor=(seen.offset[..., 0], seen.matrix[..., 0]), sensor_noise=seen.noise[..., 0],
    )  # fmt: skip
    alone = PiecewiseLinearFilter(same).correct(ahead, [0.7])
    np.testing.assert_allclose(alone.mean, both.mean, rtol=1e-14)
    np.testing.assert_allclose(alone.loglik, both.loglik, rtol=1e-14)


@pytest.mark.parametrize("options", [{"prune": 0.05}, {"keep": 3}, {"prune": 0.02, "keep": 5}])
def test_pruned_states_are_the_mixtures_of_what_is_kept(options):
    """Weights before, by the filter that keeps everything; what is kept is scaled up."""
    system = routes.tent()
    y = system.simulate(3, 5, 4).measurements
    cut, whole = PiecewiseLinearFilter(system, **options), PiecewiseLinearFilter(system)
    state = whole.step(whole.step(whole.initial((5,)), 0, y[0]), 1, y[1])
    full, less = whole.step(state, 2, y[2]), cut.step(state, 2, y[2])
    w = full.weights.copy()
    for n in range(5):
        order = np.argsort(w[:, n])
        small = np.cumsum(w[order, n]) <= options.get("prune", 0.0)
        small[: max(0, len(w) - options.get("keep", len(w)))] = True
        w[order[small], n] = 0.0
    share = 1.0 - w.sum(axis=0)
    assert (share > 0.0).any()
    kept = (w > 0.0).any(axis=1)
    np.testing.assert_allclose(less.weights, (w / w.sum(axis=0))[kept], rtol=1e-12)
    assert len(less.branches.cell) == kept.sum()
    law = full.law.weighed
    for n in range(5):
        here = law.dataset == n
        part = w[law.branch[here], n] / w[:, n].sum()
        mean = part @ law.mean[0, here]
        spread = part @ (law.cov[0, 0, here] + (law.mean[0, here] - mean) ** 2)
        np.testing.assert_allclose(less.mean[0, n], mean, rtol=1e-12)
        np.testing.assert_allclose(less.cov[0, 0, n], spread, rtol=1e-11)
    np.testing.assert_allclose(less.loglik, full.loglik, rtol=1e-14)
    np.testing.assert_allclose(less.lost, share / (1 - share), rtol=1e-9, atol=1e-15)
    forward = cut.predict(less, 3)
    np.testing.assert_allclose(forward.weights.sum(axis=0), 1.0, rtol=1e-13)
    assert (forward.lost == less.lost).all()


def test_what_is_neglected_counts_as_lost():
    system = routes.tent(sensor_noise=[[0.6]])
    y = system.simulate(2, 3, 4).measurements
    filter_ = PiecewiseLinearFilter(system, keep=1000, neglect=1e-3)
    states = list(filter_.states(2, y))
    assert [s.time for s in states] == [0.0, 1.0, 2.0]
    lost = np.full(3, 1e-3 / (1 - 1e-3))
    np.testing.assert_allclose(states[0].lost, lost, rtol=1e-13)
    for state in states[1:]:
        ratio = norm(0, 0.6).pdf(0) / np.exp(state.loglik)
        lost = (lost * ratio + 1e-3) / (1 - 1e-3)
        np.testing.assert_allclose(state.lost, lost, rtol=1e-12)
    plain = PiecewiseLinearFilter(system, neglect=1e-3)
    assert not list(plain.states(2, y))[-1].lost.any()


def test_matching_moments_makes_the_bound_unknown_unless_there_is_one_cell():
    y = routes.tent().simulate(2, 2, 4).measurements
    matched = list(PiecewiseLinearFilter(routes.tent(), method="matched").states(2, y))
    assert matched[0].lost.tolist() == [0.0, 0.0]
    assert np.isnan(matched[1].lost).all()
    linear = {"regions": [-INF, INF], "dynamics": ([1.0], [[0.5]]), "sensor": ([0.0], [[1.0]])}
    one = PiecewiseLinearFilter(routes.tent(**linear, noise=[[0.3]]))
    assert list(one.states(2, y))[-1].lost.tolist() == [0.0, 0.0]


def test_exact_transitions_are_refused_by_their_time_and_reason():
    noisy = PiecewiseLinearFilter(routes.tent(noise=[[0.1]]), method="exact")
    state = noisy.predict(noisy.initial(), 2.5)
    told = 'method: "exact" is impossible at t = 3, noise enters the restricted components$'
    with pytest.raises(ValueError, match=told):
        noisy.predict(state, 3.0)
    follow = PiecewiseLinearFilter(routes.wave(6, support="estimate"), method="exact")
    with pytest.raises(ValueError, match='method: "exact" is impossible at t = 1, noise enters'):
        follow.run(1, np.full((2, 1), np.nan))


def test_the_number_of_branches_may_be_reached_and_not_exceeded():
    y = routes.measurements(np.zeros(2))
    assert len(PiecewiseLinearFilter(routes.tent(), max_branches=8).run(2, y).mean) == 3
    told = "max_branches: got 8 branches at t = 2, more than 7; prune, merge or match moments$"
    with pytest.raises(ValueError, match=told):
        PiecewiseLinearFilter(routes.tent(), max_branches=7).run(2, y)


def test_records_and_measurements_of_other_shapes_are_refused():
    filter_ = PiecewiseLinearFilter(routes.tent())
    for y in (np.zeros((4, 2)), np.zeros((3, 1)), np.zeros(4), np.zeros((4, 2, 5))):
        shape = str(y.shape).replace("(", r"\(").replace(")", r"\)")
        told = rf"measurements: wanted shape \(4, 1, \*batch\), got {shape}$"
        with pytest.raises(ValueError, match=told):
            filter_.record(3, y)
    times, y = filter_.record([0.0, 2.0, 5.0], np.full((3, 1, 2), np.nan))
    assert times.tolist() == [0.0, 2.0, 5.0]
    assert y.shape == (3, 1, 2)
    assert filter_.record(2, np.zeros((3, 1)))[0].tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(ValueError, match="measurements: wanted finite numbers, got inf"):
        filter_.record(1, [[0.0], [INF]])
    state = filter_.predict(filter_.initial((2,)), 1.0)
    for y, told in (
        ([0.0], r"y: wanted shape \('any', 2\), got \(1,\)$"),
        ([[0.0]], r"y: wanted shape \('any', 2\), got \(1, 1\)$"),
        ([[[0.0, 0.0]]], r"y: wanted shape \('any', 2\), got \(1, 1, 2\)$"),
        ([[0.0, 0.0]] * 2, r"y: wanted shape \(1, 2\), got \(2, 2\)$"),
        ([[0.0, INF]], "y: wanted finite numbers, got inf"),
    ):
        with pytest.raises(ValueError, match=told):
            filter_.correct(state, y)
    with pytest.raises(ValueError, match="state: wanted a state with a time, got None"):
        filter_.correct(filter_.initial(), [0.0])


def test_a_sensor_need_not_exist_where_nothing_is_measured():
    def sensor_noise(t):
        return {2.0: [[0.2]], 3.0: [[0.3]]}[t]

    filter_ = PiecewiseLinearFilter(routes.tent(sensor_noise=sensor_noise))
    found = filter_.run(3, np.array([[np.nan], [np.nan], [0.3], [0.1]]))
    assert found.loglik[1] == pytest.approx(0.0, abs=1e-14)
    assert np.isfinite(found.loglik).all()


def test_a_data_set_that_nothing_explains_has_no_estimates_from_there_on():
    y = routes.tent().simulate(3, 3, 3).measurements
    y[1, 0, 1] = 1e200
    found = PiecewiseLinearFilter(routes.tent()).run(3, y)
    assert found.diverged.tolist() == [False, True, False]
    assert found.loglik[1:, 1].tolist()[0] == -INF
    assert np.isnan(found.loglik[2:, 1]).all()
    for part in (found.mean, found.cov, found.mode_prob):
        assert np.isfinite(part[0]).all()
        assert np.isnan(part[1:, ..., 1]).all()
        assert np.isfinite(part[..., [0, 2]]).all()
    filter_ = PiecewiseLinearFilter(routes.tent())
    state = filter_.predict(filter_.initial(), 0.0)
    with pytest.raises(
        ValueError, match=r"y: measurement incompatible with every branch at t = 1$"
    ):
        filter_.step(state, 1.0, [1e200])


def test_matching_works_on_fewer_records_together_the_more_pairs_of_cells_there_are():
    times = np.arange(4.0)
    exact = PiecewiseLinearFilter(routes.tent())
    assert [exact.block(times, paths, 1) for paths in (0, 1, 10**7)] == [1, 1, 10**7]
    for filter_ in (
        PiecewiseLinearFilter(routes.tent(), method="matched"),
        PiecewiseLinearFilter(routes.tent(noise=[[0.1]])),
    ):
        assert [filter_.block(times, p, 1) for p in (0, 7, 10**7)] == [1, 7, 500_000]
    many = PiecewiseLinearFilter(routes.wave(2000))
    assert many.block(times, 50, 1) == 1
    begun = PiecewiseLinearFilter(routes.tent(noise=lambda t: {5.0: [[0.1]]}[t]))  # at 5 only
    assert begun.block(times + 5.0, 10**7, 1) == 500_000


def test_the_report_is_that_of_the_state():
    filter_ = PiecewiseLinearFilter(routes.tent())
    state = filter_.step(filter_.predict(filter_.initial((2,)), 0.0), 1.0, [[0.3, 0.4]])
    found = filter_.report(state)
    for name in ("mean", "cov", "mode_prob", "loglik", "diverged"):
        assert getattr(found, name) is getattr(state, name)
    assert found.modes is None
    ahead = filter_.forecast(state, 2.0)
    assert (ahead.mean == filter_.predict(state, 2.0).mean).all()
