"""Exact errors of estimators with past innovations, and what their best gains can reach."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from seedslib.delay import (
    DelayKalmanFilter,
    DelaySystem,
    PrintedDelayFilter,
    StructureGains,
    apply_gains,
    error_covariance,
    examples,
    greedy_gains,
    separate_gains,
)
from seedslib.delay.structure import regression

# plant, last instant, optimum, greedy gains in structure (6), greedy with L = 0
TABLE = {
    ".6/.3, N=1": (lambda: examples.scalar(0.6, 0.3, 1.0, 1), 60, 0.567136, 0.567139, 0.568338),
    ".6/.3, N=3": (lambda: examples.scalar(0.6, 0.3, 1.0, 3), 60, 0.556728, 0.556732, 0.558079),
    ".1/.85, N=3": (lambda: examples.scalar(0.1, 0.85, 4.0, 3), 60, 1.322188, 1.322194, 1.326489),
    ".5/-.6, N=3": (lambda: examples.scalar(0.5, -0.6, 4.0, 3), 60, 1.252144, 1.252323, 1.277804),
    "no delay": (lambda: examples.scalar(0.9, 0.0, 1.0, 4), 60, 0.597407, 0.597407, 0.597407),
    "pure delay": (lambda: examples.scalar(0.0, 0.9, 1.0, 4), 60, 0.597407, 0.597407, 0.597407),
    "rot .7, N=3": (lambda: examples.rotation(0.7, 3), 60, 1.917649, 1.922601, 2.005665),
    "rot .7, N=10": (lambda: examples.rotation(0.7, 10), 60, 1.858969, 1.863999, 1.938710),
    "E2": (examples.precise_sensor, 50, 1.584208, 4.625259, 4.378e7),
    "E1": (examples.two_noises, 100, 71.44573, 3917.2, 3.8e5),
    "unstable": (lambda: examples.scalar(1.2, -1.2, 10.0, 3), 60, 6.334987, 6.448263, 6.994620),
}
HALF_DIGIT = {"E2": (5e-7, 5e-7, 5e3), "E1": (5e-6, 0.05, 5e3)}


def traces(cov):
    return np.trace(cov, axis1=1, axis2=2)


@pytest.mark.parametrize("name", TABLE)
def test_table_of_plants(name):
    build, steps, *wanted = TABLE[name]
    system = build()
    covs = (
        DelayKalmanFilter(system).gains(steps).cov,
        greedy_gains(system, steps).cov,
        greedy_gains(system, steps, past=0).cov,
    )
    for cov, value, digit in zip(covs, wanted, HALF_DIGIT.get(name, (5e-7,) * 3), strict=True):
        assert traces(cov)[-1] == pytest.approx(value, abs=1.001 * digit, rel=0)


def test_time_history():
    system = examples.scalar(0.6, 0.3, 1.0, 1)
    rows = (
        (DelayKalmanFilter(system).gains(4).cov, [0.591837, 0.579479, 0.568930, 0.567671]),
        (greedy_gains(system, 4).cov, [0.591837, 0.579479, 0.568937, 0.567675]),
        (greedy_gains(system, 4, past=0).cov, [0.591837, 0.581804, 0.570306, 0.568964]),
    )
    for cov, wanted in rows:
        np.testing.assert_allclose(cov[1:, 0, 0], wanted, rtol=0, atol=5.01e-7)


def varying_plant(delays, steps, seed=8, n=2, m=2):
    rng = np.random.default_rng(seed)
    size = (max(delays) + 1) * n
    root = rng.standard_normal((size, size))
    return DelaySystem(
        {d: 0.4 * rng.standard_normal((steps, n, n)) for d in delays},
        sensor=rng.standard_normal((steps + 1, m, n)),
        noise_cov=[[1.0]],
        sensor_cov=[[0.5, 0.1], [0.1, 1.0]],
        cov0=root @ root.T / size,
        noise_input=rng.standard_normal((steps, n, 1)),
    )


def by_coefficients(system, gains):
    """Error covariance from the estimates' coefficients on start and noises (a linear filter)."""
    error, spread = coefficients(system, gains)
    return error @ spread @ error.swapaxes(1, 2)


def coefficients(system, gains):
    """Errors as linear functions of start and noises, and the covariance of the latter."""
    steps, n, m, reach = (
        len(gains.gain) - 1,
        system.state_size,
        system.measurement_size,
        system.max_delay,
    )
    start = (reach + 1) * n
    q = system.step(1).noise_cov.shape[0]
    basis = start + steps * (q + m)
    chain, y = np.zeros((reach + 1 + steps, n, basis)), np.full((steps + 1, m, basis), np.nan)
    spreads = [system.start_cov()]
    for j in range(reach + 1):
        chain[reach - j, :, j * n : (j + 1) * n] = np.eye(n)
    for k in range(1, steps + 1):
        step, at = system.step(k), start + (k - 1) * (q + m)
        for d, a in step.dynamics.items():
            chain[reach + k] += a @ chain[reach + k - 1 - d]
        chain[reach + k, :, at : at + q] += step.noise_input
        y[k] = step.sensor @ chain[reach + k]
        y[k, :, at + q : at + q + m] += np.eye(m)
        spreads += [step.noise_cov, step.sensor_cov]
    return chain[reach:] - apply_gains(system, gains, y), block_diag(*spreads)


@pytest.mark.parametrize("corrected", [False, True])
@pytest.mark.parametrize("delays", [(0, 3), (0, 1, 4), (0,), (2,)])
def test_exact_recursion_equals_expansion_in_coefficients(delays, corrected):
    """DK-R6: for arbitrary gains, in both structures."""
    system = varying_plant(delays, 20)
    rng = np.random.default_rng(2)
    past = 0.2 * rng.standard_normal((21, system.max_delay, 2, 2))
    for k in range(21):
        past[k, max(k - 1, 0) :] = 0.0
    gains = StructureGains(0.3 * rng.standard_normal((21, 2, 2)), past, corrected)
    wanted = by_coefficients(system, gains)
    found = error_covariance(system, gains)
    assert np.abs(found - wanted).max() <= 1e-14 * np.abs(wanted).max()


def test_exact_recursion_against_monte_carlo():
    """DK-R6: plant E2 at k = 20 with greedy, memoryless and printed gains."""
    system, paths = examples.precise_sensor(), 20_000
    run = system.simulate(20, paths, 9)
    cases = (
        (greedy_gains(system, 20).gains, 3.949, 5e-4),
        (greedy_gains(system, 20, past=0).gains, 1606.9, 0.05),
        (PrintedDelayFilter(system).gains(20).gains, 2.7199, 5e-5),
    )
    for gains, wanted, digit in cases:
        exact = traces(error_covariance(system, gains))[-1]
        assert exact == pytest.approx(wanted, abs=1.001 * digit)
        error = run.states[20] - apply_gains(system, gains, run.measurements)[20]
        square = (error**2).sum(axis=0)
        assert abs(square.mean() - exact) <= 4.0 * square.std() / np.sqrt(paths)


def test_greedy_gains_report_their_own_error():
    system = varying_plant((0, 3), 20)
    for errors in (
        greedy_gains(system, 20),
        greedy_gains(system, 20, past=1),
        greedy_gains(system, 20, past=2, keep="oldest", corrected=True),
        separate_gains(system, 20),
        greedy_gains(system, 20, criterion="sum"),
    ):
        again = error_covariance(system, errors.gains)
        np.testing.assert_allclose(again, errors.cov, rtol=0, atol=1e-13)


def test_greedy_gains_minimise_the_next_error():
    """No other gains at the last instant do better, the earlier ones being the same."""
    system = examples.rotation(0.7, 3)
    best = greedy_gains(system, 12)
    rng = np.random.default_rng(4)
    for _ in range(20):
        gain, past = best.gains.gain.copy(), best.gains.past.copy()
        gain[12] += 0.01 * rng.standard_normal(gain[12].shape)
        past[12] += 0.01 * rng.standard_normal(past[12].shape)
        other = error_covariance(system, StructureGains(gain, past))
        assert traces(other)[12] > traces(best.cov)[12]


@pytest.mark.parametrize("delay", [1, 2, 4])
def test_greedy_structure_is_optimal_up_to_instant_n_plus_one(delay):
    """DK-R4."""
    system = examples.scalar(0.6, 0.3, 1.0, delay)
    best = DelayKalmanFilter(system).gains(delay + 2).cov[:, 0, 0]
    greedy = greedy_gains(system, delay + 2).cov[:, 0, 0]
    np.testing.assert_allclose(greedy[: delay + 2], best[: delay + 2], rtol=0, atol=1e-12)
    assert greedy[delay + 2] > best[delay + 2] + 1e-8
    if delay == 1:
        np.testing.assert_allclose(
            [greedy[3], best[3]], [0.56893672, 0.56892957], rtol=0, atol=5.01e-9
        )


def test_all_true_innovations_give_the_optimal_filter():
    """Theorem R by regression: the greedy gains of structure (R1) are those of (R2)."""
    system = varying_plant((0, 1, 4), 20)
    kalman = DelayKalmanFilter(system)
    greedy = greedy_gains(system, 20, corrected=True)
    np.testing.assert_allclose(greedy.cov, kalman.gains(20).cov, rtol=0, atol=1e-13)
    wanted = kalman.innovation_gains(20)
    np.testing.assert_allclose(greedy.gains.gain, wanted.gain, rtol=0, atol=1e-12)
    np.testing.assert_allclose(greedy.gains.past, wanted.past, rtol=0, atol=1e-12)


def test_separate_gains_are_not_the_minimum():
    """DK-T3: exact covariances in (20), (21) still miss the joint minimum."""
    system = examples.rotation(0.7, 3)
    separate, joint = separate_gains(system, 60).cov, greedy_gains(system, 60).cov
    assert traces(separate)[-1] == pytest.approx(1.948819, abs=5.01e-7)
    assert traces(joint)[-1] == pytest.approx(1.922601, abs=5.01e-7)
    # the first instant at which both could differ with the same past
    first = separate_gains(system, 3), greedy_gains(system, 3)
    np.testing.assert_allclose(first[0].cov[:2], first[1].cov[:2], rtol=0, atol=1e-14)
    # a step along the downhill direction at (20), (21) gains something, at the joint gains nothing
    assert steepest(system, separate_gains(system, 12).gains) > 0.01
    assert steepest(system, greedy_gains(system, 12).gains) < 1e-9


def steepest(system, gains, step=1e-3):
    """Largest derivative of the last trace by the gains of the last instant."""
    found = []
    for name in ("gain", "past"):
        table = getattr(gains, name)
        for at in np.ndindex(table[-1].shape):
            ends = []
            for sign in (1.0, -1.0):
                moved = table.copy()
                moved[-1][at] += sign * step
                cov = error_covariance(system, gains._replace(**{name: moved}))
                ends.append(traces(cov)[-1])
            found.append(abs(ends[0] - ends[1]) / (2.0 * step))
    return max(found)


def test_past_innovations_help_when_their_gains_are_right():
    """DK-T6: gains (R2) and joint gains never harm and mostly help; misplaced ones often harm."""
    share = {"repaired": [], "joint": [], "misplaced": [], "printed": []}
    for system in examples.random_plants(20):
        right = DelayKalmanFilter(system).innovation_gains(30)
        without = traces(greedy_gains(system, 30, past=0).cov)[-1]
        for name, gains in (
            ("repaired", right),
            ("joint", greedy_gains(system, 30).gains),
            ("misplaced", right._replace(corrected=False)),
            ("printed", PrintedDelayFilter(system).gains(30).gains),
        ):
            share[name].append(traces(error_covariance(system, gains))[-1] / without)
    worse = {name: np.count_nonzero(np.array(s) > 1.0 + 1e-9) for name, s in share.items()}
    better = {name: np.count_nonzero(np.array(s) < 1.0 - 1e-9) for name, s in share.items()}
    assert worse["repaired"] == worse["joint"] == 0
    assert min(better["repaired"], better["joint"]) > 10
    assert worse["misplaced"] > 2
    assert worse["printed"] > 4
    system = examples.precise_sensor()
    without = greedy_gains(system, 50, past=0).cov
    assert traces(without)[-1] / traces(DelayKalmanFilter(system).gains(50).cov)[-1] > 1e7


def test_greedy_memory_is_unstable_on_stable_plants():
    grows = traces(greedy_gains(examples.precise_sensor(), 60, past=0).cov)
    assert grows[60] > 10.0 * grows[50] > 100.0 * grows[40]
    grows = traces(greedy_gains(examples.two_noises(), 200).cov)
    assert grows[200] > 10.0 * grows[100] > 100.0 * grows[20]


def test_truncation_curve():
    system = examples.rotation(0.7, 10)
    oldest = [
        traces(greedy_gains(system, 120, past=kept, keep="oldest", corrected=True).cov)[-1]
        for kept in range(11)
    ]
    wanted = [
        1.938729, 1.879386, 1.869233, 1.866560, 1.865813, 1.865606, 1.865440, 1.864595, 1.862608,
        1.860317, 1.858970,
    ]  # fmt: skip
    np.testing.assert_allclose(oldest, wanted, rtol=0, atol=5.01e-7)
    newest = [traces(greedy_gains(system, 120, past=kept).cov)[-1] for kept in range(4)]
    np.testing.assert_allclose(
        newest, [1.938729, 1.925177, 1.923318, 1.923080], rtol=0, atol=5.01e-7
    )
    gain = oldest[0] - oldest[-1]
    assert (newest[0] - newest[3]) / gain == pytest.approx(0.196, abs=5e-4)
    assert (oldest[0] - oldest[3]) / gain == pytest.approx(0.90, abs=0.01)


def sum_of_errors(system, gains):
    """E|x̃_k + ... + x̃_{k-N}|² of the last instant, from coefficients on start and noises."""
    errors, spread = coefficients(system, gains)
    total = errors[-1 - system.max_delay :].sum(axis=0)
    return np.trace(total @ spread @ total.T)


def test_sum_criterion_is_not_what_the_paper_derives():
    """DK-C4, DK-R7: the minimiser of (4) against that of (7), each checked in its criterion."""
    system = examples.rotation(0.7, 3)
    summed, newest = greedy_gains(system, 60, criterion="sum"), greedy_gains(system, 60)
    for errors, wanted in ((summed, 6.678), (newest, 1.923)):
        assert traces(errors.cov)[-1] == pytest.approx(wanted, abs=5e-4)
        assert traces(by_coefficients(system, errors.gains))[-1] == pytest.approx(wanted, abs=5e-4)
    rng = np.random.default_rng(1)
    gains, least = greedy_gains(system, 9, criterion="sum").gains, []
    for scale in (0.0, *[0.01] * 10):
        moved = gains.past.copy()
        moved[-1] += scale * rng.standard_normal(moved[-1].shape)
        least.append(sum_of_errors(system, gains._replace(past=moved)))
    assert min(least[1:]) > least[0]
    # another last step from the same past: the minimiser of (7) does worse in (4)
    other = greedy_gains(system, 9).gains
    mixed = gains._replace(
        gain=np.concatenate([gains.gain[:-1], other.gain[-1:]]),
        past=np.concatenate([gains.past[:-1], other.past[-1:]]),
    )
    assert sum_of_errors(system, mixed) > least[0] + 1e-3


def test_when_all_past_gains_vanish():
    plants = (
        examples.scalar(0.9, 0.0, 1.0, 3),
        examples.scalar(0.0, 0.9, 1.0, 3),
        examples.scalar(0.6, 0.3, 1.0, 0),
    )
    for system in plants:
        past = DelayKalmanFilter(system).innovation_gains(20).past
        assert np.abs(past).max(initial=0.0) <= 1e-15
    assert np.abs(DelayKalmanFilter(examples.scalar(0.6, 0.3)).innovation_gains(20).past).max() > 0


@pytest.mark.parametrize(
    ("call", "error", "name"),
    [
        (lambda s, g: greedy_gains(s, 0), ValueError, "steps"),
        (lambda s, g: greedy_gains(s, 5, past=4), ValueError, "past"),
        (lambda s, g: greedy_gains(s, 5, past=1.0), TypeError, "past"),
        (lambda s, g: greedy_gains(s, 5, keep="some"), ValueError, "keep"),
        (lambda s, g: greedy_gains(s, 5, criterion="sum", corrected=True), ValueError, "criterion"),
        (lambda s, g: greedy_gains(s, 5, criterion="max"), ValueError, "criterion"),
        (lambda s, g: error_covariance(s, g._replace(gain=g.gain[:, :1])), ValueError, "gain"),
        (lambda s, g: error_covariance(s, g._replace(past=g.past[:, :1])), ValueError, "past"),
        (lambda s, g: apply_gains(s, g, np.zeros((6, 1))), ValueError, "measurements"),
        (lambda s, g: apply_gains(s, g, np.full((6, 1), np.nan)), ValueError, "measurements"),
        (lambda s, g: apply_gains(s, g, np.zeros((4, 1))), ValueError, "measurements"),
    ],
)
def test_bad_input_is_named(call, error, name):
    system = examples.rotation(0.7, 3)
    with pytest.raises(error, match=name):
        call(system, greedy_gains(system, 5).gains)


def test_strangers_no_paths_and_overflow_are_refused():
    system = examples.rotation(0.7, 3)
    gains = greedy_gains(system, 5).gains
    for call in (
        lambda: greedy_gains("plant", 5),
        lambda: separate_gains("plant", 5),
        lambda: error_covariance("plant", gains),
    ):
        with pytest.raises(TypeError, match="system"):
            call()
    with pytest.raises(TypeError, match="gains"):
        error_covariance(system, None)
    with pytest.raises(ValueError, match=r"measurements.*path"):
        apply_gains(system, gains, np.zeros((6, 1, 0)))
    wild = examples.scalar(3.0, 1.0, 1.0, 2)
    idle = greedy_gains(wild, 2).gains
    idle = idle._replace(gain=np.zeros((800, 1, 1)), past=np.zeros((800, 2, 1, 1)))
    with pytest.raises(ValueError, match=r"system.*overflow"):
        error_covariance(wild, idle)


def test_covariance_that_rounding_made_indefinite_is_named():
    cov = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-12]])
    with pytest.raises(ValueError, match="system: wanted innovations"):
        regression(np.eye(2), cov)
