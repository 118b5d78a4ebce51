"""The piecewise-linear filter where it is exact, against sums over starting points."""

import numpy as np
import pytest
import sympy as sp

from oracles import literal_lemmas as literal
from oracles.linear import Linear, kalman
from oracles.piecewise import (
    TIMES,
    line_parts,
    lozi,
    posterior,
    product_parts,
    records,
    tent,
)
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem
from seedslib.zoo import falling_body

INF = np.inf
COLLAPSING = (0.05, 0.0, -1.7)
LINES = {
    "moving": line_parts(),
    "collapsing": line_parts(COLLAPSING),
    "one state": product_parts()[1],
}
CASES = {name: (PiecewiseLinearSystem(**parts), parts) for name, parts in LINES.items()}
FIELDS = "mean", "cov", "loglik", "mode_prob"


@pytest.mark.parametrize("name", CASES)
def test_estimates_equal_the_sum_over_starting_points(name):
    """Everything varies with time; records are complete, partly missing and with gaps."""
    system, parts = CASES[name]
    y = records(system, 4)
    found = PiecewiseLinearFilter(system).run(TIMES, y.reshape(5, -1, 2, 2))
    for n in range(4):
        for field, wanted in zip(FIELDS, posterior(parts, y[..., n]), strict=True):
            part = getattr(found, field)[(..., *divmod(n, 2))]
            np.testing.assert_allclose(part, wanted, rtol=1e-10, atol=1e-11, err_msg=field)
    assert not found.diverged.any()


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("verb", ["step", "predict and correct", "two predictions in a row"])
def test_verbs_equal_the_sum_over_starting_points(name, verb):
    """The record misses the first, the third and the fourth time."""
    system, parts = CASES[name]
    y = records(system)[..., 2]
    filter_, wanted = PiecewiseLinearFilter(system), posterior(parts, y)
    state = filter_.initial()
    assert state.time is None
    np.testing.assert_allclose(state.mean, system.mean0, atol=1e-12)
    np.testing.assert_allclose(state.cov, system.cov0, atol=1e-12)
    for k, t in enumerate(TIMES):
        if k and verb.startswith("two") and np.isnan(y[k]).all():
            ahead = filter_.forecast(state, t)
            state = filter_.predict(state, t)
            np.testing.assert_array_equal(ahead.mean, state.mean)
        elif verb == "step":
            state = filter_.step(state, t, y[k])
        else:
            state = filter_.correct(filter_.predict(state, t), y[k])
        assert state.time == t
        report = filter_.report(state)
        for field, part in zip(FIELDS, wanted, strict=True):
            np.testing.assert_allclose(getattr(report, field), part[k], rtol=1e-10, atol=1e-11)
        assert state.dropped == 0.0
        again = filter_.predict(state, t)
        np.testing.assert_array_equal(again.mean, state.mean)
        assert again.loglik == 0.0
    for state, mean in zip(filter_.states(TIMES[:3], y[:3]), wanted.mean[:3], strict=True):
        np.testing.assert_allclose(state.mean, mean, rtol=1e-10, atol=1e-11)


def test_one_cell_is_the_kalman_filter():
    """Noise in the free components, two unlike sensors, one of them missing at times."""
    rng = np.random.default_rng(8)
    F, b, G = rng.standard_normal((3, 3)) / 2, rng.standard_normal(3), rng.standard_normal((3, 2))
    F[0, 1:], G[0] = 0.0, 0.0
    H, d, R = (
        rng.standard_normal((2, 3)),
        rng.standard_normal(2),
        np.array([[0.4, 0.1], [0.0, 0.3]]),
    )
    mean0, cov0 = rng.standard_normal(3), np.eye(3) + 0.3
    system = PiecewiseLinearSystem([-INF, INF], (b, F), (d, H), R, mean0, cov0, noise=G)
    y = system.simulate(8, 1, 4).measurements[..., 0]
    y[3, 0] = np.nan
    model = Linear(
        [F] * 8,
        [b] * 8,
        [G @ G.T] * 8,
        np.array([H] * 9),
        np.array([d] * 9),
        np.array([R @ R.T] * 9),
        mean0,
        cov0,
    )
    found, wanted = PiecewiseLinearFilter(system).run(8, y), kalman(model, y)
    for field in FIELDS[:3]:
        np.testing.assert_allclose(getattr(found, field), getattr(wanted, field), atol=1e-12)


@pytest.mark.parametrize("name", ["tent", "moving", "adaptive"])
def test_a_record_of_a_batch_is_filtered_as_if_alone(name):
    system = {
        "tent": tent(),
        "moving": CASES["moving"][0],
        "adaptive": falling_body(6, support="estimate"),
    }[name]
    y = system.simulate(4, 4, 1).measurements
    y[2, 0, 1] = np.nan
    filter_ = PiecewiseLinearFilter(system)
    whole = filter_.run(4, y.reshape(5, -1, 2, 2), workers=2)
    for n in (0, 1, 3):
        alone = filter_.run(4, y[..., n])
        for field in (*FIELDS, "diverged"):
            part = getattr(whole, field)[(..., *divmod(n, 2))]
            np.testing.assert_allclose(getattr(alone, field), part, rtol=1e-9, atol=1e-12)


def test_a_step_that_follows_the_estimate_linearises_at_it():
    """In the cell that holds the range, and in no other."""
    follow, still = (falling_body(6, support=rule) for rule in ("estimate", "centroid"))
    filter_ = PiecewiseLinearFilter(follow)
    state = filter_.step(filter_.predict(filter_.initial(), 3.0), 4.0, [0.09])
    one, other = follow.dynamics_at(4.0, state.mean[:, None]), still.dynamics_at(4.0)
    cell = follow.regions.locate(state.mean[:1])
    parts = [
        np.where(np.arange(6) == cell, p[..., 0], q[..., 0])
        for p, q in zip(one, other, strict=False)
    ]
    same = PiecewiseLinearSystem(
        still.regions, tuple(parts[:2]), ([0.0], [[0.0, 1.0]]), [[1e-3]], still.mean0, still.cov0
    )
    alone, both = (
        PiecewiseLinearFilter(same).step(state, 5.0, [0.08]),
        filter_.step(state, 5.0, [0.08]),
    )
    np.testing.assert_allclose(alone.mean, both.mean, rtol=1e-14)
    np.testing.assert_allclose(alone.loglik, both.loglik, rtol=1e-14)


def test_two_measurements_at_one_time_are_one_of_both():
    system = tent(
        sensor=([[0.0, 0.0], [0.1, 0.2]], [[[-1.0, 1.0]], [[0.5, 1.0]]]),
        sensor_noise=[[0.2, 0.0], [0.0, 0.3]],
    )
    y, filter_ = system.simulate(2, 4, 6).measurements, PiecewiseLinearFilter(system)
    whole, state = filter_.run(2, y), filter_.initial((4,))
    for t in range(3):
        state, total = filter_.predict(state, float(t)), 0.0
        for part in (0, 1):
            alone = np.full((2, 4), np.nan)
            alone[part] = y[t, part]
            state = filter_.correct(state, alone)
            total = total + state.loglik
        np.testing.assert_allclose(state.mean, whole.mean[t], atol=1e-13)
        np.testing.assert_allclose(total, whole.loglik[t], atol=1e-12)


def test_branches_are_as_many_as_itineraries():
    """Of the tent map and of the Lozi map, counted by the notebooks as well."""
    for system, wanted in ((tent(), [4, 8, 16, 30, 56, 104]), (lozi(), [4, 8, 16, 30, 54])):
        y = system.simulate(len(wanted), 2, 5).measurements
        states = list(PiecewiseLinearFilter(system).states(len(wanted), y))
        assert [len(state.weights) for state in states[1:]] == wanted


@pytest.mark.parametrize(("edge", "offset"), [(0.0, 0.0), (2.0, 1.0), (-2.0, -1.0)])
def test_a_contraction_to_an_edge_keeps_the_weights_for_many_steps(edge, offset):
    """x halves its distance to the edge; the sensor tells the side alone: a closed form."""
    system = PiecewiseLinearSystem(
        [-INF, edge, INF],
        ([offset], [[0.5]]),
        ([[-1.0, 1.0]], [[[0.0, 0.0]]]),
        [[3.0]],
        [edge + 0.4],
        [[1.0]],
    )
    found = PiecewiseLinearFilter(system).run(80, np.r_[np.nan, np.ones(80)][:, None])
    above = float(0.5 * (1 + sp.erf(0.4 / sp.sqrt(2)).evalf()))
    odds = above / (1 - above) * np.exp(2 * np.arange(81) / 9.0)
    np.testing.assert_allclose(found.mode_prob[:, 1], odds / (1 + odds), rtol=1e-9)
    phi = np.exp(-0.08) / np.sqrt(2 * np.pi)
    right, left = 0.4 + phi / above, 0.4 - phi / (1 - above)
    mean = edge + (odds * right + left) / (1 + odds) * 0.5 ** np.arange(81)
    np.testing.assert_allclose(found.mean[:, 0], mean, rtol=1e-12)


def test_an_impossible_measurement_spoils_its_own_record_only():
    y = tent().simulate(4, 4, 3).measurements
    spoiled = y.copy()
    spoiled[2, 0, 1] = 1e200
    for options in ({}, {"prune": 1e-4}):
        filter_ = PiecewiseLinearFilter(tent(), **options)
        clean, found = filter_.run(4, y), filter_.run(4, spoiled)
        assert found.diverged.tolist() == [False, True, False, False]
        others = [0, 2, 3]
        np.testing.assert_allclose(found.mean[..., others], clean.mean[..., others], rtol=1e-12)
        for part in (found.mean, found.cov, found.mode_prob):
            assert np.isnan(part[2:, ..., 1]).all()
            assert np.isfinite(part[:2, ..., 1]).all()
        assert (found.loglik[2, 1], np.isnan(found.loglik[3:, 1]).all()) == (-INF, True)
        assert filter_.run(4, spoiled[..., 1:2]).diverged.tolist() == [True]
    with pytest.raises(ValueError, match=r"^y: .* t = 2$"):
        PiecewiseLinearFilter(tent()).run(4, spoiled[..., 1])
    far = PiecewiseLinearFilter(tent()).run(2, [[np.nan], [-14.0], [0.2]])
    assert np.isfinite(far.mean).all()
    assert far.loglik[1] < -1000


def test_a_sensor_without_noise_leaves_single_points():
    """x0 = +-(1 -+ 0.2) / 1.8 explain the measurement: two on either side of the kink."""
    found = PiecewiseLinearFilter(tent(sensor_noise=[[0.0]])).run(1, [[np.nan], [0.2]])
    roots = np.array([0.8, -0.8, 1.2, -1.2]) / 1.8
    weight = np.exp(-0.5 * (roots - 0.1) ** 2 / 0.25)
    wanted = 0.2 * (weight[:2].sum() - weight[2:].sum()) / weight.sum()
    assert found.mean[1, 0] == pytest.approx(wanted)


def test_a_very_sharp_sensor_keeps_the_digits_of_what_is_left():
    """One component is seen with an error of 1e-9; the other is missing in half of the records."""
    system = PiecewiseLinearSystem(
        [-INF, INF],
        ([0.0, 0.0], np.eye(2)),
        ([0.0, 0.0], np.eye(2)[::-1]),
        np.diag([0.5, 1e-9]),
        [0.0, 0.0],
        [[1.0, 0.3], [0.3, 2.0]],
    )
    y = np.full((2, 2, 4), np.nan)
    y[1, 1], y[1, 0, :2] = 0.7, 0.2
    small, rest = 1e-18 / (1 + 1e-18), 2 - 0.09 / (1 + 1e-18)
    for batch in (y, y[..., 2:]):
        cov = PiecewiseLinearFilter(system).run(1, batch).cov[1]
        np.testing.assert_allclose(cov[0, 0], small, rtol=1e-6)
        np.testing.assert_allclose(cov[1, 1, -1], rest, rtol=1e-14)
        np.testing.assert_allclose(cov[0, 1, -1], 0.3 * small, rtol=1e-6)


@pytest.mark.parametrize("start", [5.0, 50.0])
def test_the_falling_body_by_the_formulas_of_the_paper(start):
    """(26) to (30) typed out."""
    t = np.arange(1, 11)
    y = 0.1 - 0.005 * t**2 / start + 1e-3 * np.random.default_rng(7).standard_normal(10)
    system, record = falling_body(100), np.r_[np.nan, y][:, None]
    found = PiecewiseLinearFilter(system).run(10, record)
    for k, (mean, cov) in enumerate(literal.falling_body(y, 100, 1e-3), start=1):
        scale = np.sqrt(np.diag(cov))
        np.testing.assert_allclose(found.mean[k] / scale, mean / scale, atol=1e-8)
        outer = np.outer(scale, scale)
        np.testing.assert_allclose(found.cov[k] / outer, cov / outer, atol=1e-8)
