"""The Bayes filter on a grid against sums written out, limits, and other filters."""

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from seedslib import zoo
from seedslib.filters import GridBayesFilter, ParticleFilter, extended_kalman
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem

x, v, w = sympy.symbols("x v w", real=True)


def two_speeds(indicator=None):
    """Two modes with constant switching, for literal loops."""
    return SwitchingSystem(
        (x,), [[0.9 * x + 0.6 * v], [0.5 * x + 1 + 0.8 * v]], Noise((v,)),
        [[0.7, 0.3], [0.2, 0.8]], [[x + w], [2 * x + w]], Noise((w,)),
        [(0.6, [0], [[1]]), (0.4, [1], [[0.5]])], indicator=indicator,
    )  # fmt: skip


@pytest.mark.parametrize("indicator", [None, [[0.9, 0.1], [0.3, 0.7]]])
def test_against_sums_over_all_paths_of_modes_and_nodes(indicator):
    """P(i, x | data) by adding up every path i_0, x_0, ..., i_2, x_2 on 25 nodes: literal (1.3)."""
    nodes = np.linspace(-5, 5, 25)
    system = two_speeds(indicator)
    y = np.array([[0.3], [1.1], [-0.4]])
    shown = None if indicator is None else np.array([0, 1, -1])
    found = GridBayesFilter(system, (-5, 5, 25)).run([0, 1, 2], y, indicators=shown)
    start = ((0.6, 0, 1.0), (0.4, 1, 0.5))
    move = ((0.9, 0, 0.6), (0.5, 1, 0.8))
    switch, gain = ((0.7, 0.3), (0.2, 0.8)), (1, 2)
    joint = {}
    for i, (p, m, d) in enumerate(start):
        mass = norm.pdf(nodes, m, np.sqrt(d))
        for s in range(25):
            joint[i, s] = p * mass[s] / mass.sum()
    for k in range(3):
        if k:
            later = dict.fromkeys(joint, 0.0)
            for (i, s), p in joint.items():
                a, c, r = move[i]
                density = norm.pdf(nodes, a * nodes[s] + c, r)
                for l in range(2):
                    for q in range(25):
                        share = density[q] / density.sum()
                        later[l, q] += p * switch[i][l] * share
            joint = later
        for i, s in joint:
            joint[i, s] *= norm.pdf(y[k, 0], gain[i] * nodes[s], 1.0)
            if shown is not None and shown[k] >= 0:
                joint[i, s] *= indicator[i][shown[k]]
        total = sum(joint.values())
        joint = {key: p / total for key, p in joint.items()}
        prob = [sum(joint[i, s] for s in range(25)) for i in range(2)]
        mean = sum(joint[i, s] * nodes[s] for i, s in joint)
        square = sum(joint[i, s] * nodes[s] ** 2 for i, s in joint)
        np.testing.assert_allclose(found.mode_prob[k], prob, rtol=1e-10)
        np.testing.assert_allclose(found.mean[k, 0], mean, atol=1e-10)
        np.testing.assert_allclose(found.cov[k, 0, 0], square - mean**2, rtol=1e-9)
        np.testing.assert_allclose(found.loglik[k], np.log(total), rtol=1e-9)
        assert found.modes[k] == np.argmax(prob)


def test_one_linear_mode_is_the_kalman_filter():
    system = SwitchingSystem(
        (x,), [[0.9 * x + 0.5 * v]], Noise((v,)), [[1]], [[x + w]], Noise((w,)), [(1, [0.5], [[1]])]
    )
    alone = DiscreteSystem(
        StochasticMap((x,), [0.9 * x + 0.5 * v], Noise((v,))),
        StochasticMap((x,), [x + w], Noise((w,))), [0.5], [[1]],
    )  # fmt: skip
    times = np.arange(9.0)
    record = alone.simulate(times, 30, 1).measurements
    record[3, 0, :10] = np.nan
    exact = extended_kalman(alone).run(times, record)
    found = GridBayesFilter(system, (-9, 9, 361)).run(times, record)
    np.testing.assert_allclose(found.mean, exact.mean, atol=3e-4)
    np.testing.assert_allclose(found.loglik, exact.loglik, atol=1e-3)
    cov = exact.cov if exact.cov.ndim == 4 else exact.cov[..., None]
    np.testing.assert_allclose(found.cov, np.broadcast_to(cov, found.cov.shape), atol=5e-4)
    np.testing.assert_allclose(found.mode_prob, 1.0, rtol=1e-12)


def test_finer_nodes_change_little():
    """161 nodes on [-8, 8] are enough for the second scalar example."""
    system = zoo.scalar_switching("A2")
    data = system.simulate(np.arange(16.0), 60, 1)
    coarse, fine = (
        GridBayesFilter(system, (-8, 8, n)).run(data.times, data.measurements) for n in (161, 401)
    )
    assert np.abs(coarse.mean - fine.mean).max() < 0.02
    assert np.abs(coarse.mode_prob - fine.mode_prob).max() < 0.02


def test_particles_come_close_where_noises_and_indicator_depend_on_the_state():
    """Distance to 4000 particles falls to that of their sampling error."""
    system = zoo.dependent_switching()
    data = system.simulate(np.arange(9.0), 30, 2)
    given = {"indicators": data.indicators}
    exact = GridBayesFilter(system, (-9, 9, 241)).run(data.times, data.measurements, **given)
    distance = []
    for count in (250, 4000):
        found = ParticleFilter(system, count).run(data.times, data.measurements, seed=3, **given)
        distance.append(np.sqrt(((found.mode_prob - exact.mode_prob) ** 2).mean()))
        scale = np.sqrt(exact.cov[:, 0].mean() / count)
        assert np.sqrt(((found.mean - exact.mean) ** 2).mean()) < 4 * scale
    assert 2.2 < distance[0] / distance[1] < 7.5
    assert distance[1] < 0.02


SECTION_9 = {"A1H": (0.2944, 1.1375), "A1L": (0.1086, 0.6011), "A2": (0.3566, 1.2415)}


@pytest.mark.parametrize("sensor", SECTION_9)
def test_optimal_errors_of_the_scalar_examples(sensor):
    """Section 9: error of mode and state over k = 10..30 of 4000 paths, ours on 1000."""
    from seedslib.evaluation import evaluate

    system, times = zoo.scalar_switching(sensor), np.arange(31.0)
    found = evaluate(GridBayesFilter(system), system, times, 1000, 7, window=(10, 30))
    wrong, rms = SECTION_9[sensor]
    scale = 4 * np.sqrt(1 + 1000 / 4000)
    assert abs(found.average_mode_error - wrong) < scale * found.average_mode_error_error
    assert abs(found.average[0] - rms) < scale * found.average_error[0]
    # the exact posterior knows its own errors
    first = {"A1H": 0.9128, "A1L": 0.7294, "A2": 0.8912}[sensor]
    assert abs(found.rms[0, 0] - first) < 4 * found.rms_error[0, 0]


def test_verbs_make_up_a_run_and_blocks_do_not_matter():
    system = two_speeds([[0.9, 0.1], [0.3, 0.7]])
    data = system.simulate(np.arange(4.0), 700, 1)
    filter = GridBayesFilter(system, (-6, 8, 71))
    whole = filter.run(data.times, data.measurements, indicators=data.indicators)
    state = filter.initial((700,))
    assert state.mode_prob[:, 0] == pytest.approx([0.6, 0.4])
    for k, t in enumerate(data.times):
        ahead = filter.forecast(state, t) if k else None
        state = filter.step(state, t, data.measurements[k], data.indicators[k])
        if k:
            assert np.abs(ahead.mode_prob.sum(axis=0) - 1).max() < 1e-12
    np.testing.assert_allclose(state.mean, whole.mean[-1], rtol=1e-12)
    folded = filter.run(
        data.times, data.measurements.reshape(4, 1, 7, 100),
        indicators=data.indicators.reshape(4, 7, 100), workers=2,
    )  # fmt: skip
    np.testing.assert_array_equal(folded.mean.reshape(4, 1, 700), whole.mean)
    single = filter.run(data.times, data.measurements[..., 0], indicators=data.indicators[..., 0])
    np.testing.assert_allclose(single.mode_prob, whole.mode_prob[..., 0], rtol=1e-12)
    assert single.modes.shape == (4,)


def test_unexplained_measurements_are_marked():
    y = np.zeros((2, 1, 2))
    y[1, 0, 1] = 1e160
    found = GridBayesFilter(two_speeds(), (-6, 8, 71)).run([0, 1], y)
    assert found.diverged.tolist() == [False, True]
    assert np.isneginf(found.loglik[1, 1])
    assert np.isfinite(found.mean).all()


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: GridBayesFilter(zoo.manoeuvring_target()), ValueError, "state"),
        (lambda: GridBayesFilter(zoo.flip_process()), TypeError, "or SwitchingSystem, got a Jump"),
        (lambda: GridBayesFilter(two_speeds(), (0, 1)), TypeError, "x: wanted an Axis"),
    ],
)
def test_bad_systems(make, error, message):
    with pytest.raises(error, match=message):
        make()


def test_bad_records():
    filter = GridBayesFilter(two_speeds([[1, 0], [0, 1]]), (-6, 8, 71))
    y = np.zeros((2, 1, 3))
    with pytest.raises(ValueError, match="indicators: wanted, the system has an indicator"):
        filter.run([0, 1], y)
    with pytest.raises(ValueError, match=r"indicators: wanted shape \(2, 3\)"):
        filter.run([0, 1], y, indicators=np.zeros((2, 2), int))
    with pytest.raises(ValueError, match=r"measurements: wanted shape \(2, 1, \*batch\)"):
        filter.run([0, 1], np.zeros((2, 2, 3)), indicators=np.zeros((2, 3), int))
    with pytest.raises(ValueError, match="state: wanted a state with a time"):
        filter.correct(filter.initial(), [0.0], 0)
