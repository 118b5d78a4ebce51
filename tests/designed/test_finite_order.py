"""Filters of finite order: exact in the linear case, and their steps written out otherwise."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal

from oracles.finite_order import FiniteOrderOracle, transition
from seedslib import zoo
from seedslib.design import Continuous, Polynomial, synthesize
from seedslib.designed import Memory
from seedslib.linearization import Cubature, ExactGaussian, Taylor, Unscented
from seedslib.models import JumpDiffusion, Noise

x, y, z, v, w = sympy.symbols("x y z v w", real=True)
t = sympy.Symbol("t")
u = 1 - t / 3

# A linear system that has everything: time in all its functions, a drive, jumps, unlike
# components, correlated noises with means, a late irregular start, nodes, a schedule with gaps.

TIMES = np.array([1.5, 2.0, 3.1, 3.4, 4.2])
NODES = [start + (end - start) * np.array([1, 2]) / 3 for start, end in pairwise(TIMES)]
MEASURED = np.array([[1, 1], [1, 0], [1, 1], [0, 0], [1, 1]], dtype=bool)
MEAN0, COV0 = [0.4, -0.3], [[1.0, 0.3], [0.3, 0.8]]
NOISE_MEAN, NOISE_COV = np.array([0.2, -0.1]), np.array([[0.5, 0.1], [0.1, 0.3]])
LINEAR = JumpDiffusion(
    (x, y),
    [-x / 2 + (1 + t / 4) * y + u, -x / 2 - (0.3 + t / 5) * y + t / 3],
    [[0.4, 0], [0.1 + t / 10, 0.6]],
    [x + y / 3 + u / 2 + (1 + t / 5) * v, t * x / 4 - y + t + v / 2 + w],
    Noise((v, w), mean=NOISE_MEAN, cov=NOISE_COV),
    MEAN0,
    COV0,
    intensity=1.5,
    jump=[z / 2, 0.2 - z / 3],
    marks=Noise((z,), cov=[[1.2]]),
    time=t,
)


def drift(now):
    return np.array([[-0.5, 1 + now / 4], [-0.5, -0.3 - now / 5]])


def offset(now):
    return np.array([1 - now / 3, now / 3 + 1.5 * 0.2])


def diffusion(now):
    root = np.array([[0.4, 0], [0.1 + now / 10, 0.6]])
    mark = np.array([0.5, -1 / 3])
    jumps = 1.5 * (1.2 * np.outer(mark, mark) + np.diag([0.0, 0.2**2]))
    return np.linalg.cholesky(root @ root.T + jumps)


def sensor(now):
    matrix, mix = np.array([[1, 1 / 3], [now / 4, -1]]), np.array([[1 + now / 5, 0], [0.5, 1]])
    return matrix, np.array([(1 - now / 3) / 2, now]) + mix @ NOISE_MEAN, mix @ NOISE_COV @ mix.T


def oracle(estimates, measurements, components=2, measured=MEASURED):
    moves = []
    for k, nodes in enumerate(NODES):
        stops = [TIMES[k], *nodes, TIMES[k + 1]]
        moves.append([transition(drift, offset, diffusion, *ends) for ends in pairwise(stops)])
    sensors = [sensor(now) for now in TIMES]
    return FiniteOrderOracle(
        MEAN0, COV0, moves, sensors, estimates, measurements, components, measured
    )


def designed(memory, rule=None, measured=MEASURED, **options):
    return synthesize(
        LINEAR,
        memory,
        rule or Taylor(),
        TIMES,
        nodes=2,
        exact_moments=True,
        measured=measured,
        **options,
    )


FAMILY = {
    "small order": (Memory(1), {}),
    "large order": (Memory(2), {"rule": ExactGaussian()}),
    "finite memory": (Memory(measurements=2), {"rule": Unscented()}),
    "mixed memory": (Memory(1, 2), {"rule": Cubature()}),
    "one component": (Memory(2), {"components": 1}),
}
GRID = np.sort(np.concatenate([TIMES, *NODES, [1.75, 2.5]]))
PLACES = np.searchsorted(GRID, TIMES)


@pytest.fixture(scope="module", params=FAMILY)
def linear(request):
    memory, options = FAMILY[request.param]
    expected = oracle(memory.estimates, memory.measurements, options.get("components", 2))
    return designed(memory, **options), expected


def of_paths(part, count):
    """Matrices (a, b) of all paths, or (a, b, count) of each."""
    return np.broadcast_to(part.reshape(*part.shape[:2], -1), (*part.shape[:2], count))


def of_records(estimates, count):
    """Estimates whose covariances are those of each record."""
    cov = estimates.cov
    cov = cov if cov.ndim > 3 else np.repeat(cov[..., None], count, axis=3)
    return estimates._replace(cov=cov)


def on_grid(record):
    """The same at the times of a finer grid."""
    whole = np.full((len(GRID), *record.shape[1:]), np.nan)
    whole[PLACES] = record
    return whole


def test_design_of_a_linear_system_has_the_errors_of_regressions_on_its_memory(linear):
    filter, expected = linear
    rows = zip(filter.node_fits, expected.node_fits, strict=False)
    pairs = [*zip(filter.fits, expected.fits[1:], strict=True)]
    pairs += [pair for row in rows for pair in zip(*row, strict=True)]
    for fit, wanted in pairs:
        assert_allclose(fit.cov, wanted.cov, rtol=1e-6, atol=1e-8)
    assert filter.design.exact
    assert filter.design.pooled == filter.design.pairs == 0
    at = np.isin(filter.predicted.times, TIMES)
    errors = np.sqrt([np.diagonal(cov) for cov in expected.errors])
    assert_allclose(filter.predicted.rms[at], errors, rtol=1e-6)
    nodes = np.sqrt([np.diagonal(fit.cov) for row in expected.node_fits for fit in row])
    assert_allclose(filter.predicted.rms[~at], nodes, rtol=1e-6)


def test_run_of_a_linear_system_equals_the_recursion_of_its_regressions(linear):
    """Means, covariances, likelihoods and forecasts at nodes; alone, in a batch and in a grid."""
    filter, expected = linear
    record, _ = expected.draw(6, seed=3)
    shown = on_grid(record)
    found = of_records(filter.run(GRID, shown, covariances=True), 6)
    alone = filter.run(GRID, shown[..., 4], covariances=True)
    plane = filter.run(GRID, shown.reshape(*shown.shape[:2], 3, 2))
    assert_array_equal(plane.mean.reshape(found.mean.shape), found.mean)
    for part in ("mean", "cov", "loglik"):
        assert_allclose(getattr(alone, part), getattr(found, part)[..., 4], rtol=1e-9, atol=1e-11)
    for path in range(6):
        for k, (z, cov, loglik, nodes) in enumerate(expected.run(record[..., path])):
            row = PLACES[k]
            assert_allclose(found.mean[row, :, path], z, rtol=1e-6, atol=1e-6)
            assert_allclose(found.cov[row, ..., path], cov, rtol=1e-6, atol=1e-7)
            assert_allclose(found.loglik[row, path], loglik, rtol=1e-6, atol=1e-6)
            for node, value in zip(NODES[k] if k < 4 else [], nodes, strict=True):
                row = np.searchsorted(GRID, node)
                assert_allclose(found.mean[row, :, path], value, rtol=1e-6, atol=1e-6)
                assert np.isnan(found.cov[row, ..., path]).all()
                assert found.loglik[row, path] == 0.0
    half = np.searchsorted(GRID, 1.75)
    assert_allclose(found.mean[half], (found.mean[half - 1] + found.mean[half + 1]) / 2)


def test_steps_of_a_linear_system_equal_its_run(linear):
    """Predict, expect, correct and forecast."""
    filter, expected = linear
    record, _ = expected.draw(4, seed=5)
    shown = on_grid(record)
    found = of_records(filter.run(GRID, shown, covariances=True), 4)
    for batch in ((), (4,)):
        state = filter.initial(batch)
        for j, now in enumerate(GRID):
            value, part = shown[j] if batch else shown[j, :, 2], ... if batch else (..., 2)
            if now not in TIMES:
                mean = filter.forecast(state, now).mean
                assert_allclose(mean, found.mean[j][part], rtol=1e-9, atol=1e-11)
                continue
            k = PLACES.tolist().index(j)
            state = filter.predict(state, now)
            moments = filter.expect(state)
            state = filter.correct(state, value)
            matrix, _, noise = expected.sensors[k]
            fit = expected.fits[k]
            square = matrix @ fit.cov @ matrix.T + noise
            assert_allclose(of_paths(moments.cov, 4 if batch else 1)[..., 0], square, rtol=1e-6)
            cross = fit.cov @ matrix.T
            assert_allclose(
                of_paths(moments.cross, 4 if batch else 1)[..., 0], cross, rtol=1e-6, atol=1e-8
            )
            assert_allclose(state.mean, found.mean[j][part], rtol=1e-9, atol=1e-11)
            wanted = of_paths(found.cov[j][part], 4)
            assert_allclose(of_paths(state.cov, 4), wanted, rtol=1e-9, atol=1e-11)
            assert_allclose(state.loglik, found.loglik[j][part], rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize(
    "linear", ["small order", "large order", "finite memory", "one component"], indirect=True
)
def test_gaps_that_the_design_does_not_know_are_skipped_and_nothing_is_claimed_after(linear):
    """A missing component and a missing measurement: the mean goes on by the same recursion."""
    filter, expected = linear
    record, _ = expected.draw(3, seed=6)
    record[2, 1, 1] = record[0, 0, 2] = record[4, :, 2] = np.nan
    with pytest.warns(UserWarning, match=r"2 of 3 records have gaps, from 1\.5 on"):
        found = filter.run(TIMES, record, covariances=True)
    first = np.array([9, 2, 0])  # of the gap
    for path in range(3):
        wanted = expected.run(record[..., path])
        for k, (z, cov, loglik, _) in enumerate(wanted):
            assert_allclose(found.mean[k, :, path], z, rtol=1e-6, atol=1e-6)
            if k >= first[path]:
                cov = np.full_like(cov, np.nan)
            if k > first[path]:
                loglik = np.nan
            assert_allclose(found.cov[k, ..., path], cov, rtol=1e-6, atol=1e-7)
            assert_allclose(found.loglik[k, path], loglik, rtol=1e-6, atol=1e-6)
    state, single = filter.initial((3,)), filter.initial()
    for k, now in enumerate(TIMES):
        state, single = filter.predict(state, now), filter.predict(single, now)
        for part in filter.expect(state)[1:]:
            claims = ~np.isnan(of_paths(part, 3)).any(axis=(0, 1))
            assert_array_equal(claims, k <= first)
        state = filter.correct(state, record[k])
        single = filter.correct(single, record[k, :, 1])
        assert_allclose(state.mean, found.mean[k], rtol=1e-9, atol=1e-11)
        assert_allclose(of_paths(state.cov, 3), found.cov[k], rtol=1e-9)
        assert_allclose(state.loglik, found.loglik[k], rtol=1e-9, atol=1e-11)
        assert_allclose(single.mean, found.mean[k, :, 1], rtol=1e-9, atol=1e-11)
        assert_allclose(of_paths(single.cov, 1)[..., 0], found.cov[k, ..., 1], rtol=1e-9)
        assert_allclose(single.loglik, found.loglik[k, 1], rtol=1e-9, atol=1e-11)


# Forecasts between measurements, and filters whose steps are no regression of Gaussian
# distributions


def literal(values, kind, now):
    """(2.4) and (2.7) from times and estimates: before, at the nodes, at the end."""
    (last, last_node), inside, (end, ahead) = values
    times = np.array([s for s, _ in inside])
    i = max(np.flatnonzero(times <= now + 1e-12))
    start, z = inside[i]
    if kind == "constant":
        return inside[0][1]
    if kind == "interpolated":
        stop, other = inside[i + 1] if i + 1 < len(inside) else (end, ahead)
        return z + (now - start) / (stop - start) * (other - z)
    if kind == "piecewise constant":
        return z
    if kind == "linear":
        (start, z), before = inside[0], last
    elif i:
        before = inside[i - 1]
    else:
        before = last_node if kind == "piecewise linear" else None
    if before is None:
        return z
    return z + (now - start) / (start - before[0]) * (z - before[1])


KINDS = [
    "constant",
    "linear",
    "piecewise constant",
    "piecewise linear",
    "interpolated",
    "piecewise linear, first constant",
]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_forecasts_between_measurements_are_the_printed_formulas(kind, start):
    """At unequal times, also where a second is near the last digits of a time stamp."""
    times = start + np.array([0, 1, 2.5])
    made = synthesize(
        zoo.linear_gaussian(), Memory(2), Taylor(), times, nodes=2, exact_moments=True
    )
    nodes, filter = made.node_times, made.forecasting(kind)
    assert filter.between == kind
    record = np.random.default_rng(1).normal(size=(3, 1, 4))
    zero = made.step(made.initial((4,)), times[0], record[0])
    one = made.step(zero, times[1], record[1])

    def inside(state, row):
        u = state.past.vector
        return [(s, fit.mean(u)) for s, fit in zip(nodes[row], made.node_fits[row], strict=True)]

    first = [(times[0], zero.mean), *inside(zero, 0)]
    ahead = times[1], made.predict(zero, times[1]).mean
    second = [(times[1], one.mean), *inside(one, 1)]
    later = times[2], made.predict(one, times[2]).mean
    for state, values, moments in (
        (zero, ((None, None), first, ahead), [0, 0.1, 1 / 3, 0.4, 2 / 3, 0.9, 1]),
        (one, ((first[0], first[-1]), second, later), [1, 1.25, 1.5, 1.8, 2, 2.2, 2.5]),
    ):
        for now in start + np.array(moments):
            wanted = literal(values, kind, now)
            assert_allclose(filter.forecast(state, now).mean, wanted, rtol=1e-9, atol=1e-12)
            assert_allclose(made.forecast(state, now, kind).mean, wanted, rtol=1e-9, atol=1e-12)
            for near in (np.nextafter(now, 0), np.nextafter(now, 2e9)):  # rounded otherwise
                found = made.forecast(state, near, kind).mean
                assert_allclose(found, wanted, rtol=1e-5, atol=1e-6)
    grid = np.array([*times[:2], start + 1.25, *times[2:]])
    shown = np.insert(record, 2, np.nan, axis=0)
    assert_allclose(filter.run(grid, shown).mean[2], filter.forecast(one, start + 1.25).mean)


def test_continuous_forecast_moves_by_the_velocity_of_its_fits():
    """Euler's steps of E b(t, X), jumps included, X normal given the estimate: by hand."""
    z, times, step = sympy.Symbol("z", real=True), np.array([0.2, 0.7, 1.2]), 0.1
    system = JumpDiffusion(
        (x, y),
        [y + t, -x - t * y**2],
        [[0], [0.3]],
        [x + v, y + w],
        Noise((v, w)),
        [1.0, 0.0],
        [[0.4, 0.1], [0.1, 0.2]],
        intensity=(t + x**2) / 10,
        jump=[0, t * z],
        marks=Noise((z,), mean=2.0),
        time=t,
        step=step,
    )
    filter = synthesize(
        system,
        Memory(1),
        ExactGaussian(),
        times,
        predictor=Continuous(),
        paths=300,
        seed=1,
        step=step,
    )
    filter = replace(filter, cycle=1)  # the last interval serves the one after the design
    grid = np.linspace(0.2, 1.7, 16)
    record = np.full((16, 2, 3), np.nan)
    record[::5] = np.random.default_rng(2).normal(size=(4, 2, 3))
    found = filter.run(grid, record)
    state = filter.initial((3,))
    for j, now in enumerate(grid[:-1]):
        row = min(j // 5, 1)
        if j % 5 == 0:
            estimate, state = found.mean[j], filter.step(state, now, record[j])
        fit = filter.node_fits[row][j % 5]
        (first, second) = fit.gain @ estimate + fit.offset[:, None]
        square = [mean**2 + fit.cov[i, i] for i, mean in enumerate((first, second))]
        rates = second + now, -first - now * square[1] + 2 * now * (now + square[0]) / 10
        estimate = estimate + step * np.stack(rates)
        assert_allclose(filter.forecast(state, grid[j + 1]).mean, estimate, rtol=1e-9)
        if j % 5 < 4:
            assert_allclose(found.mean[j + 1], estimate, rtol=1e-9)
        else:
            wanted = filter.fits[row].gain @ estimate + filter.fits[row].offset[:, None]
            assert_allclose(filter.predict(state, grid[j + 1]).mean, wanted, rtol=1e-9)
    alone = filter.run(grid, record[..., 1])
    assert_allclose(alone.mean, found.mean[..., 1], rtol=1e-9)


@pytest.mark.parametrize("predictor", [Polynomial(3, 2), Polynomial(2, 0), Polynomial(1, 2)])
def test_polynomial_forecast_is_its_polynomial_written_out(predictor):
    """Of two clipped standardised numbers; eigenvalues of the covariance are cut from below."""
    system, times = zoo.van_der_pol(), np.array([0.0, 0.5, 1.0])
    filter = synthesize(
        system,
        Memory(1),
        ExactGaussian(),
        times,
        predictor=predictor,
        paths=1000,
        seed=1,
        step=0.05,
        nodes=1,
    )
    # covariances that bend more, so that the cut is met
    bent = tuple(fit._replace(cov_gain=4 * fit.cov_gain) for fit in filter.fits)
    filter = replace(filter, fits=bent)
    record = system.simulate(times, 300, 2, step=0.05).measurements
    record[0, :, 0] = 60.0, -90.0  # far beyond what is clipped
    state, raised = filter.step(filter.initial((300,)), 0.0, record[0]), 0
    for fit, now, shown in zip(filter.fits, times[1:], record[1:], strict=True):
        z = state.mean
        state = filter.predict(state, now)
        for path in range(0, 300, 10):
            a, b = np.clip((z[:, path] - fit.centre) * fit.scale, -3.5, 3.5)
            powers = np.array([a, b, a * a, a * b, b * b, a**3, a * a * b, a * b * b, b**3])
            count = fit.gain.shape[1]
            mean = fit.gain @ powers[:count] + fit.offset
            assert_allclose(state.mean[:, path], mean, rtol=1e-9, atol=1e-11)
            if not predictor.cov_degree:
                assert_array_equal(state.cov, fit.residual)
                continue
            p, q, r = fit.cov_gain @ powers[: fit.cov_gain.shape[1]] + fit.cov_offset
            root = np.linalg.cholesky(fit.residual)
            back = np.linalg.inv(root)
            values, axes = np.linalg.eigh(back @ np.array([[p, q], [q, r]]) @ back.T)
            raised += (values < 0.05).any()
            cov = root @ (axes * np.maximum(values, 0.05)) @ axes.T @ root.T
            assert_allclose(state.cov[..., path], cov, rtol=1e-8, atol=1e-10)
        state = filter.correct(state, shown)
    assert raised or not predictor.cov_degree
    found = filter.run(times, record, covariances=True)
    assert_array_equal(found.mean[-1], state.mean)
    single = filter.run(times, record[..., 0], covariances=True)
    assert_allclose(single.mean, found.mean[..., 0], rtol=1e-8)
    assert_allclose(single.cov, found.cov[..., 0], rtol=1e-8)
    assert_allclose(single.loglik, found.loglik[..., 0], rtol=1e-8)


def test_cycle_of_a_filter():
    """The last two steps of a cycle serve in turn."""
    times, record = np.array([0.0, 1.0, 1.5, 3.0]), np.random.default_rng(3).normal(size=(8, 1, 2))
    made = synthesize(
        zoo.linear_gaussian(), Memory(1), Taylor(), times, nodes=1, exact_moments=True
    )
    assert made.horizon == 3.0
    assert made.order == 2
    turning = replace(made, cycle=2)
    assert turning.horizon == np.inf
    grid = np.array([*times, 3.5, 4.25, 5.0, 5.5, 7.0])
    shown = np.insert(record, 5, np.nan, axis=0)
    found = turning.run(grid, shown, covariances=True)
    state = turning.initial((2,))
    rows = [0, 1, 2, 1, 2, 1, 2]
    for k, (now, row) in enumerate(zip(np.delete(grid, 5)[1:], rows, strict=True), start=1):
        state = turning.step(state, np.delete(grid, 5)[k - 1], record[k - 1])
        fit = made.fits[row]
        wanted = fit.gain @ state.mean + fit.offset[:, None]
        assert_allclose(turning.predict(state, now).mean, wanted, rtol=1e-12)
        if now == 5.0:  # the node in the middle of the longer interval
            node = made.node_fits[2][0].mean(state.mean)
            assert_allclose(turning.forecast(state, 4.25).mean, node, rtol=1e-12)
            assert_allclose(found.mean[5], node, rtol=1e-12)


def test_filter_taking_some_steps_of_a_design():
    """Each comes as long after the one before it as it did; the others are gone."""
    filter = designed(Memory(1))
    some = filter.taking([0, 2, 4])
    assert_allclose(some.times, [1.5, 2.6, 3.4], rtol=1e-12)
    assert_array_equal(some.measured, MEASURED[[0, 2, 4]])
    assert_array_equal(some.fits[1].gain, filter.fits[3].gain)
    assert_allclose(
        np.concatenate(some.node_times), 1.5 + np.array([1.1, 2.2, 4.1, 4.9]) / 3, rtol=1e-12
    )
