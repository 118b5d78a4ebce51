"""Designs that condition on what has arrived: estimates and claims after gaps, likely or not."""

import warnings
from itertools import product

import numpy as np
import pytest
import sympy

from oracles.linear import Linear, kalman
from seedslib import zoo
from seedslib.design import (
    Polynomial,
    grid_synthesis,
    optimal_risk,
    simulated_synthesis,
    stationary,
    synthesize,
)
from seedslib.designed import Memory, load, save
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem

p, q, v, w = sympy.symbols("p q v w", real=True)
e, r = sympy.symbols("e1 e2", real=True), sympy.symbols("r1 r2", real=True)
TIMES = np.arange(3.0, 12.0)
GRIDS = {"x": (-12, 12, 65), "z": (-12, 12, 73), "y": (-15, 15, 57)}
MOVES, LOUD = np.array([[0.95, 0.3], [-0.3, 0.92]]), np.diag([0.5, 0.2])
PUSH = np.diag([0.05, 0.5])


def walk():
    """Errors after a silence are up to three times those without."""
    return DiscreteSystem(
        StochasticMap([p], [0.95 * p + q], Noise([q], cov=[[0.7]])),
        StochasticMap([p], [p + v], Noise([v])), [0.5], [[1.0]],
    )  # fmt: skip


def of_one_mode():
    return SwitchingSystem(
        [p], [[0.95 * p + sympy.sqrt(0.7) * q]], Noise([q]), [[1]], [[p + v]], Noise([v]),
        [(1.0, [0.5], [[1.0]])],
    )  # fmt: skip


def pair():
    """Two unlike components that turn into each other, each with a sensor."""
    moved = [MOVES[i] @ np.array([p, q]) + e[i] for i in (0, 1)]
    return DiscreteSystem(
        StochasticMap([p, q], moved, Noise(e, cov=PUSH)),
        StochasticMap([p, q], [p + r[0], q + r[1]], Noise(r, cov=LOUD)), [0.0, 0.0], np.eye(2),
    )  # fmt: skip


def constant(steps, move, push, look, loud, mean0, cov0):
    """A linear model whose parts are the same at all times."""
    parts = [np.broadcast_to(part, (steps, *np.shape(part))) for part in (move, push, look, loud)]
    zeros = np.zeros((steps, len(move))), np.zeros((steps, len(look)))
    F, Q, H, R = parts
    return Linear(F[1:], zeros[0][1:], Q[1:], H, zeros[1], R, np.array(mean0), np.array(cov0))


def kalmans(model, y):
    """Means (K+1, n, records) and deviations of the Kalman filter of each record."""
    rows = [kalman(model, record) for record in np.moveaxis(y, 2, 0)]
    means = np.stack([row.mean for row in rows], axis=-1)
    covs = np.stack([row.cov for row in rows], axis=-1)
    return means, np.sqrt(np.einsum("kiij->kij", covs))


def deviations(found, y):
    """Claimed deviations (K+1, n, records)."""
    n = found.mean.shape[1]
    cov = found.cov.reshape(len(found.cov), n, n, -1)
    return np.sqrt(np.einsum("kiij->kij", np.broadcast_to(cov, (*cov.shape[:3], y.shape[2]))))


OF_WALK = constant(9, [[0.95]], [[0.7]], [[1.0]], [[1.0]], [0.5], [[1.0]])
MAKERS = {  # design, largest and typical relative error of claims, of estimates in deviations
    "affine": (
        lambda **more: synthesize(walk(), Memory(1), Taylor(), TIMES, paths=8000, seed=1, **more),
        0.06, 0.02, 0.06,
    ),
    "polynomial": (
        lambda **more: synthesize(
            walk(), Memory(1), Taylor(), TIMES, paths=12_000, seed=1, predictor=Polynomial(2, 0),
            **more,
        ),
        0.08, 0.03, 0.15,
    ),
    "modes": (
        lambda **more: synthesize(
            of_one_mode(), Memory(1), ExactGaussian(), TIMES, paths=6000, seed=1, **more
        ),
        0.08, 0.025, 0.08,
    ),
    "grid": (lambda **more: grid_synthesis(walk(), Memory(1), TIMES, **GRIDS, **more),
             0.03, 0.01, 0.06),
    "tables": (
        lambda **more: simulated_synthesis(
            walk(), Memory(1), TIMES, paths=4000, seed=1, method="histogram",
            z=(-9, 9, 45), y=(-11, 11, 45), **more,
        ),
        0.1, 0.03, 0.4,
    ),
}  # fmt: skip


@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.filterwarnings("ignore:paths:UserWarning")
def test_claims_and_estimates_of_every_history_are_those_of_the_kalman_filter(maker, tmp_path):
    """Random gaps, silences that hardly ever come by chance, and steps, batches, and files."""
    make, most, typical, far = MAKERS[maker]
    made = make(availability=0.75)
    data = made.system.simulate(TIMES, 60, 4, availability=0.6)
    y = data.measurements.copy()
    for count in range(1, 8):
        y[1 : 1 + count, :, count] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = made.run(TIMES, y, covariances=True)
    means, wanted = kalmans(OF_WALK, y)
    error = np.log(deviations(found, y) / wanted)[1:]
    assert np.abs(error).max() < most
    assert np.sqrt((error**2).mean()) < typical
    assert np.sqrt((((found.mean - means) / wanted) ** 2).mean()) < far
    # what is predicted is the mean over all histories
    chances = {True: 0.75, False: 0.25}
    mean = np.zeros(4)
    for history in product((True, False), repeat=4):
        record = np.where(history, 0.0, np.nan)[:, None, None]
        short = constant(4, [[0.95]], [[0.7]], [[1.0]], [[1.0]], [0.5], [[1.0]])
        mean += (
            np.prod([chances[here] for here in history]) * kalmans(short, record)[1][:, 0, 0] ** 2
        )
    slack = 4 * made.predicted.error[:4, 0] + 0.03 * np.sqrt(mean)
    np.testing.assert_array_less(np.abs(made.predicted.rms[:4, 0] - np.sqrt(mean)), slack)
    if made.held_out is not None:
        np.testing.assert_allclose(made.held_out.rms, made.predicted.rms, rtol=0.15)
    parts = getattr(made, "arrivals", ()) or made.fits
    for part in parts:
        assert part.prob.sum() == pytest.approx(1.0)
    save(made, tmp_path / "f.npz")
    again = load(tmp_path / "f.npz", made.system).run(TIMES, y, covariances=True)
    np.testing.assert_array_equal(again.mean, found.mean)
    np.testing.assert_array_equal(again.cov, found.cov)
    state, single = made.initial((60,)), made.initial()
    for k, t in enumerate(TIMES):
        state, single = made.step(state, t, y[k]), made.step(single, t, y[k, :, 0])
        np.testing.assert_allclose(state.mean, found.mean[k], rtol=1e-10)
        np.testing.assert_allclose(single.mean, found.mean[k, :, 0], rtol=1e-9)


@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_what_always_arrives_is_the_plain_design_and_what_never_does_the_forecast(maker):
    make, *_ = MAKERS[maker]
    plain, sure = make(), make(availability=1.0)
    data = plain.system.simulate(TIMES, 5, 4)
    np.testing.assert_array_equal(
        sure.run(TIMES, data.measurements).mean, plain.run(TIMES, data.measurements).mean
    )
    np.testing.assert_array_equal(sure.predicted.rms, plain.predicted.rms)
    blind = make(availability=0.0)
    nothing = np.full((9, 1, 2), np.nan)
    found = blind.run(TIMES, nothing, covariances=True)
    means, wanted = kalmans(OF_WALK, nothing)
    np.testing.assert_allclose(found.mean, means, atol=0.12)
    np.testing.assert_allclose(deviations(found, nothing), wanted, rtol=0.05)


@pytest.mark.filterwarnings("ignore:availability:UserWarning")
def test_two_unlike_sensors_by_schedule_and_by_chance():
    """Of a state of two components by regression: claims of each history, and nodes alike."""
    system, mask = pair(), np.ones((9, 2), dtype=bool)
    mask[:, 1] = np.arange(9) % 3 == 0
    made = synthesize(system, Memory(1), Taylor(), TIMES, paths=6000, seed=1, measured=mask,
                      availability=[0.8, 0.9])  # fmt: skip
    y = system.simulate(TIMES, 100, 4, measured=mask, availability=[0.8, 0.9]).measurements
    model = constant(9, MOVES, PUSH, np.eye(2), LOUD, [0.0, 0.0], np.eye(2))
    means, wanted = kalmans(model, y)
    found = made.run(TIMES, y, covariances=True)
    error = np.log(deviations(found, y) / wanted)
    assert np.abs(error).max() < 0.15
    assert np.sqrt((error**2).mean()) < 0.02
    assert np.sqrt((((found.mean - means) / wanted) ** 2).mean()) < 0.06
    with pytest.raises(ValueError, match="measurements"):
        made.run(TIMES, system.simulate(TIMES, 3, 4).measurements)


@pytest.mark.parametrize("kind", ["grid", "likelihood", "histogram"])
@pytest.mark.filterwarnings("ignore:y. the axes miss:UserWarning")
def test_tables_of_some_of_two_sensors(kind):
    """One state; the table of one component sums over the other, or is counted without it."""
    system, times = DiscreteSystem(
        StochasticMap([p], [0.8 * p + q], Noise([q])),
        StochasticMap([p], [p + v, p - w], Noise([v, w], cov=np.diag([1.0, 0.3]))), [0.0], [[2.0]],
    ), TIMES[:3]  # fmt: skip
    axes = {"y": [(-9, 9, 31), (-7, 7, 41)], "z": (-6, 6, 41)}
    mask = np.array([[True, True], [False, True], [True, False]])
    told = {"measured": mask, "availability": [0.7, 0.9]}
    if kind == "grid":
        made = grid_synthesis(system, Memory(1), times, x=(-8, 8, 49), **axes, **told)
        risk = optimal_risk(system, Memory(1), times, x=(-8, 8, 49), **axes, **told)
        np.testing.assert_allclose(risk.mse, made.predicted.rms[:, 0] ** 2, rtol=1e-12)
        np.testing.assert_allclose(made.covariances[:, 0, 0], risk.mse, rtol=1e-12)
    else:
        axes = {"y": [(-9, 9, 19), (-7, 7, 25)], "z": (-6, 6, 19)}
        made = simulated_synthesis(
            system, Memory(1), times, paths=2000, seed=1, method=kind, **axes, **told
        )
    y = system.simulate(times, 200, 4, **told).measurements
    model = constant(3, [[0.8]], [[1.0]], [[1.0], [1.0]], np.diag([1.0, 0.3]), [0.0], [[2.0]])
    means, wanted = kalmans(model, y)
    found = made.run(times, y, covariances=True)
    bound, far = {"grid": (0.06, 0.1), "likelihood": (0.15, 0.3), "histogram": (0.2, 0.35)}[kind]
    error = np.log(deviations(found, y) / wanted)
    assert np.abs(error[1:]).max() < bound
    assert np.sqrt((((found.mean - means) / wanted) ** 2).mean()) < far
    assert np.isfinite(found.mean).all()


def test_exact_and_counted_tables_of_a_jumping_signal_agree_at_nodes_too():
    flip, times = zoo.flip_process(), 0.25 * np.arange(5)
    axes = {"z": (-2.4, 2.4, 41), "y": (-8, 8, 57)}
    made = grid_synthesis(flip, Memory(1), times, x=(-3.5, 3.5, 57), nodes=1, availability=0.6,
                          **axes)  # fmt: skip
    grid = made.predicted.times
    data = flip.simulate(grid, 8000, 3, measured=np.arange(9) % 2 == 0, availability=0.6)
    square = (made.run(grid, data.measurements).mean - data.states)[:, 0] ** 2
    doubt = 4 * square.std(axis=1) / np.sqrt(8000)
    assert (np.abs(square.mean(axis=1) - made.predicted.rms[:, 0] ** 2) < doubt + 0.004).all()
    y = data.measurements[::2].copy()
    y[1:4] = np.nan
    found = made.run(times, y, covariances=True)
    square = (found.mean - data.states[::2])[:, 0] ** 2
    apart = (square - found.cov.reshape(5, -1)).mean(axis=1)
    assert (np.abs(apart) < 4 * square.std(axis=1) / np.sqrt(8000) + 0.004).all()
    counted = simulated_synthesis(flip, Memory(1), times[:3], paths=3000, seed=1, nodes=1,
                                  method="histogram", availability=0.6, **axes)  # fmt: skip
    np.testing.assert_allclose(counted.predicted.rms, made.predicted.rms[:5], rtol=0.06)
    np.testing.assert_array_equal(counted.predicted.times, grid[:5])


@pytest.mark.parametrize("kept", [0, 1])
@pytest.mark.parametrize("kind", ["grid", "histogram", "likelihood"])
def test_tables_with_modes_and_an_indicator_that_may_be_missing(kind, kept):
    """Predicted errors and wrong modes are those found; remembered indicators are all there."""
    system, times = zoo.dependent_switching(), np.arange(4.0)
    rates = [0.6, 1.0 if kept else 0.7]
    axes = {"z": (-4, 8, 37), "y": (-9, 22, 55)}
    options = {"availability": rates, "probabilities": not kept, **axes}
    if kind == "grid":
        made = grid_synthesis(system, Memory(1, 0, kept), times, x=(-7, 11, 46), **options)
    else:
        made = simulated_synthesis(system, Memory(1, 0, kept), times, paths=3000, seed=2,
                                   method=kind, **options)  # fmt: skip
    data = system.simulate(times, 6000, 3, availability=rates)
    found = made.run(times, data.measurements, covariances=True, indicators=data.indicators)
    square = (found.mean - data.states)[:, 0] ** 2
    doubt = 4 * square.std(axis=1) / np.sqrt(6000) + 8 * (
        made.predicted.rms * made.predicted.error
    )[:, 0]  # fmt: skip
    assert (np.abs(square.mean(axis=1) - made.predicted.rms[:, 0] ** 2) < doubt + 0.01).all()
    wrong = (found.modes != data.modes).mean(axis=1)
    doubt = 4 * np.hypot(np.sqrt(0.25 / 6000), made.predicted.mode_error)
    assert (np.abs(wrong - made.predicted.mode_rate) < doubt).all()
    # given what arrived at the last time
    apart = (square - found.cov.reshape(4, -1))[-1]
    for here in np.isnan(data.measurements[-1, 0]), ~np.isnan(data.measurements[-1, 0]):
        slack = 0.01 if kind == "grid" else 0.15 * square[-1, here].mean()
        part = apart[here]
        assert abs(part.mean()) < 4 * part.std() / np.sqrt(len(part)) + slack
    if not kept:
        np.testing.assert_allclose(found.mode_prob.sum(axis=1), 1.0, atol=1e-12)


@pytest.mark.filterwarnings("ignore:paths:UserWarning")  # some cells are thin
def test_switching_design_of_two_modes_claims_the_errors_it_has():
    system, times = SwitchingSystem(
        (p,), [[0.9 * p + 0.4 + 0.3 * q], [0.5 * p - 0.7 + 0.8 * q]], Noise((q,)),
        [[0.85, 0.15], [0.3, 0.7]], [[p + 0.5 * v], [1.3 * p + 0.7 * v]], Noise((v,)),
        [(0.6, [0.3], [[1.2]]), (0.4, [-0.5], [[0.7]])], indicator=[[0.8, 0.2], [0.3, 0.7]],
    ), np.arange(4.0)  # fmt: skip
    told = {"availability": [0.6, 0.8]}
    made = synthesize(system, Memory(1), ExactGaussian(), times, paths=3000, seed=1, **told)
    data = system.simulate(times, 6000, 3, **told)
    found = made.run(times, data.measurements, indicators=data.indicators, covariances=True)
    square = (found.mean - data.states)[:, 0] ** 2
    rms, doubt = np.sqrt(square.mean(axis=1)), made.predicted.error[:, 0]
    assert (np.abs(rms - made.predicted.rms[:, 0]) < 6 * doubt + 0.005).all()
    wrong = (found.modes != data.modes).mean(axis=1)
    assert (np.abs(wrong - made.predicted.mode_rate) < 6 * made.predicted.mode_error).all()
    assert (np.abs(made.held_out.mode_rate - made.predicted.mode_rate) < 0.08).all()
    lost = np.isnan(data.measurements[-2:, 0]).all(axis=0)
    ratio = square[-1, lost].mean() / found.cov[-1, 0, 0, lost].mean()
    assert abs(ratio - 1) < 4 * np.sqrt(2 / lost.sum()) + 0.05


@pytest.mark.filterwarnings("ignore:availability:UserWarning")
@pytest.mark.parametrize(
    ("memory", "options"),
    [(Memory(2), {"nodes": 1}), (Memory(1), {"nodes": 0, "predictor": Polynomial(2, 1)})],
)
def test_a_curved_sensor_has_the_predicted_errors_of_all_histories(memory, options):
    """Nodes and long memories; claims in a gap are those of a design for the schedule."""
    system, times = zoo.van_der_pol(), 0.25 * np.arange(6)
    options = {"paths": 2500, "seed": 1, "step": 0.05, **options}
    made = synthesize(system, memory, ExactGaussian(), times, availability=0.8, **options)
    stops = made.predicted.times
    at = np.searchsorted(stops, times - 1e-9)
    shown = np.isin(np.arange(len(stops)), at)
    data = system.simulate(stops, 4000, 7, measured=shown, availability=0.8, step=0.05)
    error = made.run(stops, data.measurements).mean - data.states
    rms = np.sqrt((error**2).mean(axis=2))
    np.testing.assert_allclose(made.predicted.rms, rms, rtol=0.12)
    mask = np.array([1, 1, 0, 0, 0, 1], dtype=bool)
    other = synthesize(system, memory, ExactGaussian(), times, measured=mask, **options)
    y = system.simulate(times, 1000, 7, measured=mask, step=0.05).measurements
    one, two = (deviations(f.run(times, y, covariances=True), y).mean(axis=2)
                for f in (made, other))  # fmt: skip
    np.testing.assert_allclose(one[2:5], two[2:5], rtol=0.08)


@pytest.mark.parametrize("maker", ["affine", "grid", "modes"])
def test_frozen_designs_claim_what_kalman_does_on_long_records(maker):
    """With a silence that comes long after the end of the design, and a short transient."""
    make, *_ = MAKERS[maker]
    made = make(availability=0.9)
    lasting = stationary(made, 0.2, paths=300)
    long = np.arange(3.0, 43.0)
    y = made.system.simulate(long, 10, 9, availability=0.9).measurements
    y[25:31] = np.nan
    model = constant(40, [[0.95]], [[0.7]], [[1.0]], [[1.0]], [0.5], [[1.0]])
    wanted = kalmans(model, y)[1]
    error = np.log(deviations(lasting.run(long, y, covariances=True), y) / wanted)
    assert np.abs(error[9:]).max() < 0.15
    short = stationary(made, 0.3, transient=3, paths=300)
    error = np.log(deviations(short.run(long, y, covariances=True), y) / wanted)
    assert np.abs(error[20:]).max() < 0.25


def test_classes_that_are_too_few_are_warned_of_and_still_predict_their_errors():
    """Three sensors of six numbers: more histories than classes, the likely ones known best."""
    names = sympy.symbols("s1:4", real=True)
    system = DiscreteSystem(
        StochasticMap([p, q], [1.1 * p + q, 0.95 * q + v], Noise([v])),
        StochasticMap([p, q], [p + 3 * names[0], q + names[1], p - q + 5 * names[2]],
                      Noise(names)), [0.0, 0.0], np.eye(2),
    )  # fmt: skip
    with pytest.warns(UserWarning, match="availability"):
        made = synthesize(system, Memory(1), Taylor(), TIMES[:6], paths=1500, seed=1,
                          availability=0.5)  # fmt: skip
    assert 40 < max(len(fit.prob) for fit in made.fits) <= 64
    data = system.simulate(TIMES[:6], 6000, 6, availability=0.5)
    error = made.run(TIMES[:6], data.measurements).mean - data.states
    np.testing.assert_allclose(made.predicted.rms, np.sqrt((error**2).mean(axis=2)), rtol=0.1)


def test_gaps_that_a_design_does_not_expect_leave_its_claims_unknown():
    """In a schedule, and of a component that was to arrive always."""
    system, mask = pair(), np.ones((5, 2), dtype=bool)
    mask[1::2, 1] = False
    for told in ({"measured": mask}, {"availability": [1.0, 0.9]}):
        made = synthesize(system, Memory(1), Taylor(), TIMES[:5], paths=1500, seed=1, **told)
        y = system.simulate(TIMES[:5], 3, 4, measured=mask).measurements.copy()
        y[2, 0, 1] = np.nan
        with pytest.warns(UserWarning, match="records have gaps"):
            found = made.run(TIMES[:5], y, covariances=True)
        lost = np.isnan(np.broadcast_to(found.cov.reshape(5, 2, 2, -1), (5, 2, 2, 3))[:, 0, 0])
        assert lost.sum(axis=0).tolist() == [0, 3, 0]
        assert np.isfinite(found.mean).all()
