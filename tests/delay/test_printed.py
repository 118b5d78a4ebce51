"""The filter as printed: kept literally, and shown for what it is."""

import mpmath
import numpy as np
import pytest

from seedslib.delay import (
    DelayKalmanFilter,
    DelaySystem,
    PrintedDelayFilter,
    apply_gains,
    error_covariance,
    examples,
    greedy_gains,
)

# plant, last instant, claimed, true
TABLE = {
    ".6/.3, N=1": (lambda: examples.scalar(0.6, 0.3, 1.0, 1), 60, 0.569971, 0.576203),
    ".6/.3, N=3": (lambda: examples.scalar(0.6, 0.3, 1.0, 3), 60, 0.558004, 0.562823),
    ".1/.85, N=3": (lambda: examples.scalar(0.1, 0.85, 4.0, 3), 60, 1.319102, 1.323668),
    ".5/-.6, N=3": (lambda: examples.scalar(0.5, -0.6, 4.0, 3), 60, 1.235283, 1.276974),
    "no delay": (lambda: examples.scalar(0.9, 0.0, 1.0, 4), 60, 0.600271, 0.611678),
    "pure delay": (lambda: examples.scalar(0.0, 0.9, 1.0, 4), 60, 0.597407, 0.597407),
    "rot .7, N=3": (lambda: examples.rotation(0.7, 3), 60, 1.819110, 2.086743),
    "rot .7, N=10": (lambda: examples.rotation(0.7, 10), 60, 1.797977, 2.012554),
    "E2": (examples.precise_sensor, 50, 2.960149, 2.728465),
    "E1": (examples.two_noises, 100, 223.567, 150.178),
    "unstable": (lambda: examples.scalar(1.2, -1.2, 10.0, 3), 60, 23.5717, 36.1875),
}
HALF_DIGIT = {"E1": 5e-4, "unstable": 5e-5}


def traces(cov):
    return np.trace(cov, axis1=1, axis2=2)


def literal(system, steps, unset=lambda n: np.zeros((n, n))):
    """(9)-(29) written with one loop per index: K, L and the claimed matrix.

    `unset` makes the lags that (23), (25), (28) do not give, those beyond N.
    """
    reach, n, m = system.max_delay, system.state_size, system.measurement_size
    identity = np.eye(n)
    known = {(j, i): unset(n) for j in range(2 * reach + 1) for i in range(2 * reach + 1)}
    blocks = system.start_blocks()
    for j in range(reach + 1):
        for i in range(reach + 1):
            known[j, i] = blocks[j] if i == j else np.zeros((n, n))

    def near(k):
        return system.step(k + 1).dynamics.get(0, 0 * identity)

    def far(k):
        both = system.step(k + 1).dynamics
        return both[reach]

    gains, pasts, claims = [], [], []
    for k in range(1, steps + 1):
        used = range(1, min(reach, k - 1) + 1)
        ahead = {}
        for j in (0, *used):
            for i in (0, *used):
                a, b, c, d = near(k - 1 - j), far(k - 1 - j), near(k - 1 - i), far(k - 1 - i)
                ahead[j, i] = a @ known[j, i] @ c.T + b @ known[reach + j, i] @ c.T
                ahead[j, i] += a @ known[j, reach + i] @ d.T
                ahead[j, i] += b @ known[reach + j, reach + i] @ d.T
                if i == j:
                    ahead[j, i] += system.step(k - j).state_noise
        sensor = {j: system.step(k - j).sensor for j in (0, *used)}
        noise = {j: system.step(k - j).sensor_cov for j in (0, *used)}
        inverse = {
            j: np.linalg.inv(sensor[j] @ ahead[j, j] @ sensor[j].T + noise[j]) for j in (0, *used)
        }
        past = {j: ahead[0, j] @ sensor[j].T @ inverse[j] for j in used}
        left = ahead[0, 0].copy()
        for j in used:
            left -= past[j] @ sensor[j] @ ahead[0, j].T
        gain = left @ sensor[0].T @ inverse[0]
        keep = identity - gain @ sensor[0]
        rest = ahead[0, 0].copy()
        for j in used:
            rest -= ahead[0, j] @ sensor[j].T @ past[j].T
        claimed = keep @ rest
        for i in used:
            for j in used:
                if i != j:
                    claimed += past[i] @ sensor[i] @ ahead[i, j] @ sensor[j].T @ past[j].T
        moved = {}
        for j in range(2 * reach + 1):
            for i in range(2 * reach + 1):
                if i and j:
                    moved[j, i] = known[j - 1, i - 1]
        for j in range(1, 2 * reach + 1):
            row = keep @ (near(k - 1) @ known[0, j - 1] + far(k - 1) @ known[reach, j - 1])
            for i in used:
                row -= (
                    past[i]
                    @ sensor[i]
                    @ (near(k - i - 1) @ known[i, j - 1] + far(k - i - 1) @ known[reach + i, j - 1])
                )
            moved[0, j], moved[j, 0] = row, row.T
        moved[0, 0] = claimed
        known = moved
        gains.append(gain)
        pasts.append([past.get(j, np.zeros((n, m))) for j in range(1, reach + 1)])
        claims.append(claimed)
    return np.array(gains), np.array(pasts), np.array(claims)


def varying_plant(steps=15):
    rng = np.random.default_rng(1)
    return DelaySystem(
        {0: 0.4 * rng.standard_normal((steps, 2, 2)), 3: 0.4 * rng.standard_normal((steps, 2, 2))},
        sensor=rng.standard_normal((steps + 1, 2, 2)),
        noise_cov=[[1.0]],
        sensor_cov=[[1.0, 0.3], [0.3, 0.8]],
        cov0=np.eye(2),
        history_cov=np.array([1.0, 0.5, 0.2])[:, None, None] * np.eye(2),
        noise_input=rng.standard_normal((steps, 2, 1)),
    )


@pytest.mark.parametrize(
    "build", [varying_plant, examples.precise_sensor, lambda: examples.scalar(0.5, -0.6, 4.0, 3)]
)
def test_recursion_is_the_printed_one(build):
    system = build()
    found = PrintedDelayFilter(system).gains(15)
    gain, past, claimed = literal(system, 15)
    np.testing.assert_allclose(found.gains.gain[1:], gain, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.gains.past[1:], past, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.claimed[1:], claimed, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", TABLE)
def test_table_of_plants(name):
    """DK-T2: what the filter claims and what it does."""
    build, steps, claimed, true = TABLE[name]
    system, digit = build(), 1.001 * HALF_DIGIT.get(name, 5e-7)
    printed = PrintedDelayFilter(system).gains(steps)
    assert traces(printed.claimed)[-1] == pytest.approx(claimed, abs=digit, rel=0)
    assert traces(error_covariance(system, printed.gains))[-1] == pytest.approx(
        true, abs=digit, rel=0
    )


def test_time_history():
    system = examples.scalar(0.6, 0.3, 1.0, 1)
    printed = PrintedDelayFilter(system).gains(4)
    true = error_covariance(system, printed.gains)
    for cov, wanted in (
        (printed.claimed, [0.591837, 0.586934, 0.572019, 0.570675]),
        (true, [0.591837, 0.598227, 0.579917, 0.577272]),
    ):
        np.testing.assert_allclose(cov[1:, 0, 0], wanted, rtol=0, atol=5.01e-7)


def test_claimed_matrix_is_not_the_covariance_by_monte_carlo():
    """DK-T2: 40 000 paths agree with the exact analysis and not with the claim."""
    system, paths = examples.rotation(0.7, 3), 40_000
    run = system.simulate(60, paths, 7)
    printed = PrintedDelayFilter(system)
    estimates = printed.run(run.times, run.measurements)
    square = ((run.states[60] - estimates.mean[60]) ** 2).sum(axis=0)
    error = square.std() / np.sqrt(paths)
    true = traces(error_covariance(system, printed.gains(60).gains))[-1]
    assert abs(square.mean() - true) <= 4.0 * error
    assert abs(square.mean() - traces(estimates.cov)[-1]) > 15.0 * error


def test_expansion_of_the_error_gives_both_forms():
    """DK-T1: (8) for matrices, noises and errors uncorrelated, is (12); with (20), (21) it is (22).

    The expansion is one product over the stacked errors and noises, without any of the formulas.
    """
    rng = np.random.default_rng(3)
    n, m, reach = 3, 2, 3
    root = rng.standard_normal(((reach + 1) * n, (reach + 1) * n))
    joint = (root @ root.T).reshape(reach + 1, n, reach + 1, n).swapaxes(1, 2)
    sensor = rng.standard_normal((reach + 1, m, n))
    noise = [a @ a.T + np.eye(m) for a in rng.standard_normal((reach + 1, m, m))]
    inner = [s @ joint[j, j] @ s.T + r for j, (s, r) in enumerate(zip(sensor, noise, strict=True))]

    def both(mixed, subtracted):
        """The expansion, (12), (22): `mixed[j]` stands for P'_{k,j} in (12) and (22)."""
        past = [joint[0, j] @ sensor[j].T @ np.linalg.inv(inner[j]) for j in range(1, reach + 1)]
        left = joint[0, 0] - subtracted * sum(
            past[j - 1] @ sensor[j] @ joint[0, j].T for j in range(1, reach + 1)
        )
        gain = left @ sensor[0].T @ np.linalg.inv(inner[0])
        keep = np.eye(n) - gain @ sensor[0]
        rows = [keep, *(-l @ s for l, s in zip(past, sensor[1:], strict=True))]
        expanded = sum(rows[j] @ joint[j, i] @ rows[i].T for j in range(4) for i in range(4))
        expanded = expanded + sum(g @ r @ g.T for g, r in zip([gain, *past], noise, strict=True))
        told = sum(mixed[j] @ sensor[j].T @ past[j - 1].T for j in range(1, reach + 1))
        apart = sum(
            past[i - 1] @ sensor[i] @ joint[i, j] @ sensor[j].T @ past[j - 1].T
            for i in range(1, reach + 1) for j in range(1, reach + 1) if i != j
        )  # fmt: skip
        long = keep @ joint[0, 0] @ keep.T + gain @ noise[0] @ gain.T - keep @ told
        long = long - (keep @ told).T + apart
        long = long + sum(past[j - 1] @ inner[j] @ past[j - 1].T for j in range(1, reach + 1))
        return expanded, long, keep @ (joint[0, 0] - told) + apart

    expanded, long, short = both(joint[0], True)
    np.testing.assert_allclose(long, expanded, rtol=0, atol=1e-11)
    np.testing.assert_allclose(short, expanded, rtol=0, atol=1e-11)
    expanded, long, short = both(joint[:, 0], True)  # P'_{k,j} transposed
    assert np.abs(long - expanded).max() > 0.1
    expanded, long, short = both(joint[0], False)  # (20) without its sum
    np.testing.assert_allclose(long, expanded, rtol=0, atol=1e-11)
    assert np.abs(short - long).max() > 0.01


@pytest.mark.parametrize("name", TABLE)
def test_expanded_form_equals_the_claimed_one(name):
    """DK-T1: (12) and (22) of the filter itself, for the gains (20), (21)."""
    build, steps, *_ = TABLE[name]
    printed = PrintedDelayFilter(build()).gains(steps)
    assert np.abs(printed.expanded - printed.claimed).max() <= 1e-12


def test_optimal_only_at_the_first_instant_and_in_degenerate_plants():
    """DK-T4."""
    for build, *_ in TABLE.values():
        system = build()
        true = traces(error_covariance(system, PrintedDelayFilter(system).gains(10).gains))
        best = traces(DelayKalmanFilter(system).gains(10).cov)
        assert true[1] == pytest.approx(best[1], rel=1e-13)
        assert (true >= best * (1.0 - 1e-13)).all()
    system = examples.scalar(0.6, 0.3, 1.0, 1)
    true = error_covariance(system, PrintedDelayFilter(system).gains(2).gains)
    assert true[2, 0, 0] > DelayKalmanFilter(system).gains(2).cov[2, 0, 0] + 0.018
    for system in (examples.scalar(0.0, 0.9, 1.0, 4), examples.scalar(0.6, 0.3, 1.0, 0)):
        printed = PrintedDelayFilter(system).gains(30)
        best = DelayKalmanFilter(system).gains(30).cov
        np.testing.assert_allclose(printed.claimed, best, rtol=0, atol=1e-14)
        np.testing.assert_allclose(
            error_covariance(system, printed.gains), best, rtol=0, atol=1e-14
        )


def test_without_delay_it_is_not_the_kalman_filter():
    """DK-T5: by hand for n = 1, A = 0.9, no delay, everything else 1, N = 1."""
    printed = PrintedDelayFilter(examples.scalar(0.9, 0.0, 1.0, 1)).gains(2)
    first = 1.81 / 2.81
    assert first == pytest.approx(0.6441281139, abs=5e-11)
    by_hand = 0.9 * (1.0 - first) * 0.9 * 0.9 * 1.0  # A (I-KC) A P_0 A, dropped terms absent
    inner = 1.81 + 1.0
    assert printed.gains.gain[1, 0, 0] == pytest.approx(first, abs=1e-15)
    assert printed.gains.past[2, 0, 0, 0] == pytest.approx(by_hand / inner, abs=1e-15)
    assert printed.gains.past[2, 0, 0, 0] == pytest.approx(0.0923240587, abs=5.01e-11)
    assert printed.gains.gain[2, 0, 0] == pytest.approx(0.5939509407, abs=5.01e-11)
    system = examples.scalar(0.9, 0.0, 1.0, 1)
    assert np.abs(DelayKalmanFilter(system).innovation_gains(20).past).max() == 0.0


def test_claims_below_the_optimum_are_impossible():
    for name in (".1/.85, N=3", ".5/-.6, N=3", "rot .7, N=3", "rot .7, N=10"):
        build, steps, *_ = TABLE[name]
        system = build()
        best = traces(DelayKalmanFilter(system).gains(steps).cov)[-1]
        assert traces(PrintedDelayFilter(system).gains(steps).claimed)[-1] < best


def test_limit_cycle():
    system = examples.scalar(1.2, -1.2, 10.0, 3)
    printed = PrintedDelayFilter(system).gains(600)
    true = error_covariance(system, printed.gains)[:, 0, 0]
    claimed, gain = printed.claimed[:, 0, 0], printed.gains.gain[:, 0, 0]
    np.testing.assert_allclose(claimed[-2:], [8.689465, 20.267732], rtol=0, atol=5.01e-7)
    np.testing.assert_allclose(true[-2:], [7.449172, 35.044497], rtol=0, atol=5.01e-7)
    np.testing.assert_allclose(gain[-2:], [0.7091, 0.2982], rtol=0, atol=5.01e-5)
    np.testing.assert_allclose(claimed[-40:-2], claimed[-38:], rtol=1e-9)
    best = DelayKalmanFilter(system).gains(600).cov[:, 0, 0]
    assert best[-1] == pytest.approx(6.334987, abs=5.01e-7)
    assert best[-2] == pytest.approx(best[-1], rel=1e-12)


def test_start_is_the_covariance():
    """DK-S1: (23) with the covariance, (25) from j = 1; lags beyond N never enter."""
    rng, mean = np.random.default_rng(6), 3.0
    x0, older, w, v = rng.standard_normal((4, 200_000))
    state = 0.6 * (x0 + mean) + 0.3 * older + w
    both = np.cov(state, state + v)

    def first_gain(start):
        system = DelaySystem({0: 0.6, 1: 0.3}, 1.0, 1.0, 1.0, start, mean0=[mean, 0.0],
                             history_cov=1.0)  # fmt: skip
        return PrintedDelayFilter(system).gains(1).gains.gain[1, 0, 0]

    assert first_gain(1.0) == pytest.approx(1.45 / 2.45, abs=1e-15)
    assert first_gain(1.0) == pytest.approx(both[0, 1] / both[1, 1], abs=0.01)
    assert abs(first_gain(1.0 + mean**2) - first_gain(1.0)) > 0.2
    assert abs(first_gain(0.0) - first_gain(1.0)) > 0.05
    plain, filled = (
        literal(varying_plant(), 15, unset)
        for unset in (lambda n: np.zeros((n, n)), lambda n: rng.standard_normal((n, n)))
    )
    for one, other in zip(plain, filled, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


def scalar_claims(near, far, reach, steps):
    """(9)-(29) for one component and unit variances, in the digits of mpmath's context."""
    size = range(2 * reach + 1)
    known = {(j, i): mpmath.mpf(i == j and i <= reach) for j in size for i in size}
    claims = []
    for k in range(1, steps + 1):
        used = range(1, min(reach, k - 1) + 1)
        half = {
            (j, i): near * known[j, i] + far * known[reach + j, i] for j in (0, *used) for i in size
        }
        ahead = {
            (j, i): near * half[j, i] + far * half[j, reach + i] + (i == j)
            for j in (0, *used) for i in (0, *used)
        }  # fmt: skip
        past = {j: ahead[0, j] / (ahead[j, j] + 1) for j in used}
        told = sum(past[j] * ahead[0, j] for j in used)
        keep = 1 - (ahead[0, 0] - told) / (ahead[0, 0] + 1)
        claims.append(
            keep * (ahead[0, 0] - told)
            + sum(past[i] * ahead[i, j] * past[j] for i in used for j in used if i != j)
        )
        moved = {(j, i): known[j - 1, i - 1] for j in size for i in size if i and j}
        for j in size[1:]:
            moved[0, j] = moved[j, 0] = keep * half[0, j - 1] - sum(
                past[i] * half[i, j - 1] for i in used
            )
        moved[0, 0] = claims[-1]
        known = moved
    return claims


def test_printed_recursion_can_grow_without_bound():
    """DK-R8: claim and truth grow, in double precision and with forty digits; the optimum rests."""
    system = examples.scalar(1.5, -1.5, 1.0, 3)
    printed = PrintedDelayFilter(system).gains(100)
    claimed = printed.claimed[:, 0, 0]
    with mpmath.workdps(40):
        exact = np.array(
            [float(c) for c in scalar_claims(mpmath.mpf(1.5), mpmath.mpf(-1.5), 3, 100)]
        )
    np.testing.assert_allclose(claimed[1:], exact, rtol=1e-6)
    true = error_covariance(system, printed.gains)[:, 0, 0]
    for curve in (claimed, true):
        assert (curve[-1] / curve[-51]) ** (1 / 50) == pytest.approx(1.618, abs=0.003)
        assert curve[-1] > 1e12
    best = DelayKalmanFilter(system).gains(100).cov[:, 0, 0]
    np.testing.assert_allclose(best[-20:], 0.802191, rtol=0, atol=5.01e-7)
    run = system.simulate(30, 4000, 5)
    mean = PrintedDelayFilter(system).run(run.times, run.measurements).mean
    square = ((run.states - mean)[30, 0]) ** 2
    assert abs(square.mean() - true[30]) <= 4.0 * square.std() / np.sqrt(4000)
    # the same recursion stays bounded on the plant of the limit cycle
    assert (
        traces(PrintedDelayFilter(examples.scalar(1.2, -1.2, 10.0, 3)).gains(100).claimed).max()
        < 40
    )


def test_random_study():
    """Quantiles 50, 90, 100 % of the ratio to the optimum over 50 stable plants."""
    ratios, steps = {name: [] for name in ("true", "claimed", "greedy", "without")}, 60
    for system in examples.random_plants(50):
        best = traces(DelayKalmanFilter(system).gains(steps).cov)[-1]
        printed = PrintedDelayFilter(system).gains(steps)
        for name, cov in (
            ("true", error_covariance(system, printed.gains)),
            ("claimed", printed.claimed),
            ("greedy", greedy_gains(system, steps).cov),
            ("without", greedy_gains(system, steps, past=0).cov),
        ):
            ratios[name].append(traces(cov)[-1] / best)
    ratios = {name: np.array(values) for name, values in ratios.items()}
    wanted = {
        "true": (1.00041, 1.0487, 1.1242),
        "claimed": (1.0000, 1.0094, 1.1155),
        "greedy": (1.0000, 1.00013, 1.00205),
        "without": (1.0002, 1.0229, 1.1115),
    }
    for name, quantiles in wanted.items():
        np.testing.assert_allclose(
            np.quantile(ratios[name], [0.5, 0.9, 1.0]), quantiles, rtol=0.002, err_msg=name
        )
    assert ratios["claimed"].min() == pytest.approx(0.9390, abs=5e-4)
    assert np.count_nonzero(ratios["claimed"] < 1.0 - 1e-9) == 29
    assert np.count_nonzero(ratios["true"] > ratios["without"] * (1.0 + 1e-9)) == 20
    assert np.count_nonzero(ratios["greedy"] > 1.0 + 1e-9) == 29


def test_estimates_are_those_of_the_gains():
    system = varying_plant()
    y = system.simulate(15, 4, 3).measurements
    printed = PrintedDelayFilter(system)
    np.testing.assert_array_equal(
        printed.run(len(y) - 1, y).mean, apply_gains(system, printed.gains(15).gains, y)
    )


@pytest.mark.parametrize(
    ("build", "error"),
    [
        (lambda: "plant", TypeError),
        (lambda: DelaySystem({0: 0.5, 1: 0.1, 2: 0.1}, 1.0, 1.0, 1.0, 1.0), ValueError),
        (lambda: DelaySystem({1: 0.5}, 1.0, 1.0, 1.0, np.eye(2) + 0.5), ValueError),
        (lambda: DelaySystem({1: 0.5}, 1.0, 1.0, 1.0, 1.0, mean0=[0.0, 1.0]), ValueError),
    ],
)
def test_other_systems_are_refused(build, error):
    with pytest.raises(error, match="system"):
        PrintedDelayFilter(build())


def test_records_and_ranges_are_checked():
    printed = PrintedDelayFilter(examples.rotation(0.7, 3))
    for records, error in (("abc", TypeError), ([[1], [1, 2]], TypeError), (3.0, ValueError)):
        with pytest.raises(error, match="measurements"):
            printed.run(2, records)
    with pytest.raises(ValueError, match=r"printed|system"):
        PrintedDelayFilter(examples.scalar(1e160, 0.3, 1.0, 2)).gains(4)
