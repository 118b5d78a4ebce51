import numpy as np
import pytest

from oracles import piecewise_routes as routes
from seedslib.piecewise import PiecewiseLinearFilter, examples


def test_fixed_regions_against_quadrature_in_every_cell():
    system = examples.falling_body(12)
    runs = np.random.default_rng(4).standard_normal((3, 10))
    y = np.concatenate([routes.falling(5.0, runs[:2]), routes.falling(50.0, runs[2:])], axis=2)
    found = PiecewiseLinearFilter(system).run(10, y)

    inner = system.regions.edges[1:-1]
    edges = np.concatenate([np.arange(-74.0, 5.0, 0.3), inner, np.arange(50.0, 129.0, 0.3)])
    x, weight = routes.panels(np.unique(edges), 6, 20)
    angle, share = np.polynomial.hermite_e.hermegauss(12)
    cell = system.regions.locate(x[None])
    log_prior = -0.5 * ((x - 27.5) / 11.25) ** 2
    for dataset in range(3):
        state = np.repeat(0.1 + 1e-6 * angle[:, None], x.size, axis=1)
        log_density = log_prior + np.log(share / share.sum())[:, None]
        before = np.log((np.exp(log_density) * weight).sum())
        for t in range(1, 11):
            c = system.dynamics_at(t - 1)
            state = state + c.offset[1, cell, 0] + c.matrix[1, 0, cell, 0] * x
            error = (y[t, 0, dataset] - state) / 1e-3
            log_density = log_density - 0.5 * error**2 - np.log(1e-3 * np.sqrt(2 * np.pi))
            top = log_density.max()
            joint = np.exp(log_density - top) * weight
            total = joint.sum()
            mean = np.array([(joint * x).sum(), (joint * state).sum()]) / total
            offset = x - mean[0], state - mean[1]
            cov = np.array([[(joint * a * b).sum() for a in offset] for b in offset]) / total
            deviation = np.sqrt(np.diag(cov))
            error = (found.mean[t, :, dataset] - mean) / deviation
            assert np.abs(error).max() <= 5e-13
            gap = (found.cov[t, :, :, dataset] - cov) / np.outer(deviation, deviation)
            assert np.abs(gap).max() <= 5e-13
            after = top + np.log(total)
            assert found.loglik[t, dataset] == pytest.approx(after - before, abs=5e-13)
            per_cell = np.bincount(cell, joint.sum(axis=0), minlength=12) / total
            assert found.mode_prob[t, :, dataset] == pytest.approx(per_cell, abs=5e-13)
            before = after


def figure(start, seed, runs, **options):
    noise = np.random.default_rng(seed).standard_normal((runs, 10))
    system = examples.falling_body(**options)
    found = PiecewiseLinearFilter(system).run(10, routes.falling(start, noise))
    error = found.mean[:, 0] - start
    return np.sqrt((error**2).mean(axis=1)) / start, error**2 / found.cov[:, 0, 0]


R5 = [4.22, 1.65, 0.141, 0.0604, 0.0334, 0.0212, 0.0149, 0.0108, 0.0081, 0.0062]
TAU5 = [3.52, 0.92, 0.90, 0.97, 0.95, 0.94, 0.98, 0.98, 0.96, 0.94]
R50 = [0.446, 0.409, 0.348, 0.276, 0.209, 0.160, 0.123, 0.096, 0.073, 0.057]
TAU50 = [4.18, 4.41, 4.28, 3.71, 2.99, 2.51, 2.17, 1.91, 1.67, 1.63]


@pytest.mark.parametrize(("start", "r", "tau"), [(5.0, R5, TAU5), (50.0, R50, TAU50)])
def test_falling_body_against_another_program_s_4000_runs(start, r, tau):
    """Relative errors and consistency of the figure, within the errors of 800 other runs."""
    relative, ratio = figure(start, 2, 800)
    assert relative[0] == pytest.approx(22.5 / start)
    assert ratio[0] == pytest.approx(4.0)
    error = ratio[1:].std(axis=1) * np.sqrt(1 / 800 + 1 / 4000)
    assert (np.abs(ratio[1:].mean(axis=1) - tau) < 4 * error + 0.005).all()
    # a mean square scatters like the ratio, its root half as much
    share = error / ratio[1:].mean(axis=1) / 2
    assert (np.abs(relative[1:] / r - 1) < 4 * share + 0.01).all()


def close(ratio):
    """Within two standard deviations of an average over 20 records."""
    return (np.abs(ratio[1:] - 1) < 2 * np.sqrt(2 / 20)).all()


def test_ratio_at_50_units_is_not_close_to_one_and_the_condition_can_hold():
    """Under the deviation 11.25; bodies inside the windows, and the deviation 22.5, fulfil it."""
    near = figure(5.0, 2, 400)[1].mean(axis=1)
    assert not close(near)
    assert close(near[1:])
    assert not close(figure(50.0, 2, 400)[1].mean(axis=1))
    assert close(figure(50.0, 2, 400, deviation=22.5)[1].mean(axis=1))
    rng = np.random.default_rng(5)
    start = 27.5 + 11.25 * rng.standard_normal(500)
    start = start[(start > 5.0) & (start < 50.0)]
    y = routes.falling(start, rng.standard_normal((start.size, 10)))
    found = PiecewiseLinearFilter(examples.falling_body()).run(10, y)
    assert close(((found.mean[:, 0] - start) ** 2 / found.cov[:, 0, 0]).mean(axis=1))


def extended_kalman(y):
    """EKF of the falling body: mean and variance of the range, (K+1, N)."""
    x, z = np.full(y.shape[2], 27.5), np.full(y.shape[2], 0.1)
    p, q, s = np.full_like(x, 11.25**2), np.zeros_like(x), np.full_like(x, 1e-12)
    kept = [(x, p)]
    for t in range(1, len(y)):
        k = 0.01 * (t - 0.5)
        slope = k / x**2
        z, s, q = z - k / x, s + 2 * slope * q + slope**2 * p, q + slope * p
        w, error = s + 1e-6, y[t, 0] - z
        x, z = x + q / w * error, z + s / w * error
        p, q, s = p - q * q / w, q * 1e-6 / w, s * 1e-6 / w
        kept.append((x, p))
    return np.array(kept).swapaxes(0, 1)


def test_extended_kalman_filter_diverges_on_the_falling_body():
    noise = np.random.default_rng(1).standard_normal((4000, 10))
    mean, var = extended_kalman(routes.falling(50.0, noise))
    ratio = ((mean - 50.0) ** 2 / var).mean(axis=1)
    expected = [4.0, 4.1, 4.4, 5.4, 7.0, 9.2, 11.7, 14.4, 17.1, 20.1]
    assert ratio[1:] == pytest.approx(expected, abs=0.06)
    mean, var = extended_kalman(routes.falling(5.0, noise))
    median = np.median((mean - 5.0) ** 2 / var, axis=1)[1:]
    expected = [3.8, 1.2, 10, 280, 996, 2.4e3, 5.0e3, 9.2e3, 1.6e4, 2.5e4]
    assert median == pytest.approx(expected, rel=0.05)
    relative = np.sqrt(((mean - 5.0) ** 2).mean(axis=1)) / 5.0
    assert relative[1] == pytest.approx(4.4, abs=0.06)
    assert 30.0 < relative[10] < 50.0


def noticeable(states, threshold, relative):
    return [state.noticeable(threshold, relative=relative).mean() for state in states]


def test_number_of_noticeable_branches():
    """Far bodies never make the count rise; near ones do, from about 19 to about 52."""
    noise = np.random.default_rng(1).standard_normal((600, 10))
    filter_ = PiecewiseLinearFilter(examples.falling_body())
    states = list(filter_.states(10, routes.falling(50.0, noise)))[1:]
    expected = [23.6, 18.5, 9.5, 5.1, 3.0, 2.1, 1.5, 1.1, 1.0, 1.0]
    assert noticeable(states, 0.01, True) == pytest.approx(expected, abs=0.3)
    expected = [16.7, 14.1, 8.7, 5.0, 3.1, 2.2, 1.6, 1.2, 1.0, 1.0]
    assert noticeable(states, 0.005, False) == pytest.approx(expected, abs=0.3)
    near = list(filter_.states(10, routes.falling(5.0, noise)))[1:]
    counts = np.array([(s.weights >= 0.02 * s.weights.max(axis=0)).sum(axis=0) for s in near])
    assert counts.mean(axis=1) == pytest.approx(noticeable(near, 0.02, True))
    error = 5 * counts.std(axis=1) / np.sqrt(600)
    expected = [19.2, 51.4, 29.9, 18.6, 12.6, 8.8, 6.7, 5.0, 4.0, 3.3]  # another 400 records
    assert (np.abs(counts.mean(axis=1) - expected) < 1.6 * error + 0.05).all()
    assert counts[1].mean() > 2 * counts[0].mean()


def exact_body(y, points):
    """Posterior mean and deviation of the range for the nonlinear model, (K, N)."""
    x = np.geomspace(1.0, 27.5 + 9 * 11.25, points)[:, None]
    log_weight = np.log(x) - 0.5 * ((x - 27.5) / 11.25) ** 2 + np.zeros((1, y.shape[2]))
    angle, var, out = np.full(log_weight.shape, 0.1), 1e-12, []
    for t in range(1, len(y)):
        angle = angle - 0.01 * (t - 0.5) / x
        error, spread = y[t] - angle, var + 1e-6
        log_weight = log_weight - 0.5 * error**2 / spread
        angle, var = angle + var / spread * error, var - var**2 / spread
        weight = np.exp(log_weight - log_weight.max(axis=0))
        weight /= weight.sum(axis=0)
        mean = (weight * x).sum(axis=0)
        out.append((mean, np.sqrt((weight * (x - mean) ** 2).sum(axis=0))))
    return np.array(out).swapaxes(0, 1)


def test_the_paper_s_partition_does_not_converge_and_an_even_one_does():
    noise = np.random.default_rng(0).standard_normal((20, 10))
    y = routes.falling(50.0, noise)
    mean, deviation = exact_body(y, 6001)

    def error(system):
        found = PiecewiseLinearFilter(system).run(10, y).mean[1:, 0]
        return np.sqrt((((found - mean) / deviation) ** 2).mean(axis=1))[-1]

    assert error(examples.falling_body(100)) == pytest.approx(0.40, abs=0.006)
    assert error(examples.falling_body(800)) == pytest.approx(0.11, abs=0.006)
    wide = {"partition": "curvature", "span": (2.5, 100.0)}
    errors = [error(examples.falling_body(n, **wide)) for n in (50, 100, 200)]
    assert errors == pytest.approx([0.0298, 0.0071, 0.0018], abs=2e-4)


def test_bodies_drawn_from_the_prior_are_judged_consistently():
    """At 50 km the exact posterior has a ratio above 3 as well; over the prior it is 1."""
    noise = np.random.default_rng(1).standard_normal((200, 10))
    mean, deviation = exact_body(routes.falling(50.0, noise), 5001)
    assert (((mean - 50.0) / deviation)[:4] ** 2).mean(axis=1).min() > 3.0
    ours = PiecewiseLinearFilter(examples.falling_body(100)).run(10, routes.falling(50.0, noise))
    ratio = ((ours.mean[:, 0] - 50.0) ** 2 / ours.cov[:, 0, 0]).mean(axis=1)
    assert ratio[10] > 1.5

    rng = np.random.default_rng(2)
    start = 27.5 + 11.25 * rng.standard_normal(1500)
    start = start[start > 2.5]
    y = routes.falling(start, rng.standard_normal((start.size, 10)))
    even = examples.falling_body(100, partition="curvature", span=(2.5, 100.0))
    found = PiecewiseLinearFilter(even).run(10, y)
    square = (found.mean[1:, 0] - start) ** 2 / found.cov[1:, 0, 0]
    error = square.std(axis=1) / np.sqrt(start.size)
    assert (np.abs(square.mean(axis=1) - 1) < 4 * error).all()


@pytest.mark.parametrize("start", [5.0, 50.0])
def test_cutting_branches_of_the_falling_body_does_no_harm(start):
    """At 1e-8 of the weight a step; 1e-4 is harmless for the far body only."""
    y = routes.falling(start, np.random.default_rng(1).standard_normal((300, 10)))
    system = examples.falling_body(100)
    full = PiecewiseLinearFilter(system).run(10, y)
    for share in (1e-8, 1e-4):
        states = list(PiecewiseLinearFilter(system, prune=share).states(10, y))
        shift = np.stack([s.mean[0] for s in states]) - full.mean[:, 0]
        worst = np.abs(shift / np.sqrt(full.cov[:, 0, 0])).max()
        kept = [(s.branches.log_unit > -np.inf).sum(axis=0).mean() for s in states[1:]]
        assert np.mean(kept) < 50
        assert kept[-1] < 10
        assert (worst < 0.02) == (share == 1e-8 or start == 50.0)
        assert 0.0 < np.median(states[-1].error_bound) < 0.2


def test_support_points_that_follow_the_estimate_are_no_better():
    still, follow = (figure(5.0, 0, 100, support=s)[1] for s in ("centroid", "estimate"))
    gain = follow[10] - still[10]
    assert not np.array_equal(still, follow)
    assert gain.mean() > -2 * gain.std() / np.sqrt(gain.size)
