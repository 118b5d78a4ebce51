"""Designs that know what may be missing: classes of histories, written out record by record."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import sympy
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import RegularGridInterpolator

from oracles.linear import corrected
from oracles.switching import SwitchingOracle, merged
from seedslib import zoo
from seedslib.base import Axis
from seedslib.design import Polynomial, grid_synthesis, synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem

pytestmark = pytest.mark.filterwarnings("ignore:availability", "ignore:paths. .* too few paths")
x, y, v, w, p, q, r = sympy.symbols("x y v w p q r", real=True)
TIMES = np.arange(4.0)
RATES = np.array([0.6, 1.0, 0.3])
MOVE, SHIFT, SPREAD = np.array([[0.9, 0.3], [-0.2, 0.8]]), [0.1, 0.0], np.diag([0.05, 0.4])
LOOK, NOISE = np.array([[1.0, 0.0], [0.5, 1.0], [0.0, 2.0]]), np.diag([0.5, 0.2, 0.9])


def nearest(covs, before):
    """Classes whose covariances are the nearest by their generalised eigenvalues."""
    apart = [
        [np.abs(np.log(scipy.linalg.eigh(one, other, eigvals_only=True))).max() for other in before]
        for one in covs
    ]
    return np.argmin(apart, axis=1)


def pair():
    moved = [0.9 * x + 0.3 * y + 0.1 + v, -0.2 * x + 0.8 * y + w]
    shown = [x + p, y + 0.5 * x + q, 2 * y + r]
    return DiscreteSystem(
        StochasticMap([x, y], moved, Noise((v, w), cov=SPREAD)),
        StochasticMap([x, y], shown, Noise((p, q, r), cov=NOISE)), [0.2, -0.3],
        [[1.0, 0.2], [0.2, 0.7]],
    )  # fmt: skip


def record(paths, steps, size=3, rates=RATES, seed=2):
    rng = np.random.default_rng(seed)
    shown = rng.normal(size=(steps, size, paths))
    shown[rng.random(shown.shape) > np.array(rates)[:size, None]] = np.nan
    return shown


@pytest.fixture(scope="module")
def linear():
    return synthesize(
        pair(), Memory(1), Taylor(), TIMES, paths=400, seed=1, availability=RATES.tolist()
    )


@pytest.mark.parametrize("form", ["design", "for ever", "two in turn", "some steps"])
def test_run_of_a_linear_system_is_its_classes_written_out(linear, form):
    """The class of a record is a table of the one before it and the pattern of what arrived."""
    filter, served = linear, [0, 1, 2]
    if form == "for ever":
        filter, served = replace(linear, cycle=1), [0, 1, 2, 2, 2]
    elif form == "two in turn":
        filter, served = replace(linear, cycle=2), [0, 1, 2, 1, 2]
    elif form == "some steps":
        filter, served = linear.taking([0, 1, 3]), [0, 2]
    times, shown = np.arange(len(served) + 1.0), record(12, len(served) + 1)
    if form == "some steps":
        times = filter.times
    found = filter.run(times, shown, covariances=True)
    for path in range(12):
        group, before = 0, None
        state = filter.step(filter.initial(), 0.0, shown[0, :, path])
        for k, row in enumerate(served, start=1):
            fit, here = linear.fits[row], ~np.isnan(shown[k - 1, :, path])
            number = int(here[0]) + 2 * int(here[2])
            if row and before != row - 1:  # it did not follow in the design
                group = nearest(linear.fits[before].covs, fit.before)[group]
            group, before = fit.table[group, number], row
            mean = fit.fits.gain[group] @ found.mean[k - 1, :, path] + fit.fits.offset[group]
            mean, cov, loglik = corrected(
                mean, fit.fits.cov[group], shown[k, :, path], LOOK, np.zeros(3), NOISE
            )
            assert_allclose(found.mean[k, :, path], mean, rtol=1e-9, atol=1e-12)
            assert_allclose(found.cov[k, :, :, path], cov, rtol=1e-9, atol=1e-12)
            assert_allclose(found.loglik[k, path], loglik, rtol=1e-9, atol=1e-11)
            state = filter.step(state, times[k], shown[k, :, path])
            assert_allclose(state.mean, mean, rtol=1e-9, atol=1e-12)
            assert_allclose(state.cov, cov, rtol=1e-9, atol=1e-12)
    alone = filter.run(times, shown[..., 3], covariances=True)
    assert_allclose(alone.cov, found.cov[..., 3], rtol=1e-9, atol=1e-12)
    plane = filter.run(times, shown.reshape(-1, 3, 4, 3))
    assert_allclose(plane.mean.reshape(found.mean.shape), found.mean, rtol=1e-12)


def test_classes_of_polynomial_forecasts_and_their_mean_covariance():
    """Covariances depend on the memory and on the class."""
    filter = synthesize(
        pair(), Memory(1), ExactGaussian(), TIMES, predictor=Polynomial(2, 1), paths=600, seed=1,
        availability=RATES,
    )  # fmt: skip
    shown = record(6, 4)
    state, group = filter.initial((6,)), np.zeros(6, dtype=int)
    for k in range(3):
        state = filter.step(state, TIMES[k], shown[k])
        here = ~np.isnan(shown[k])
        fit, group = filter.fits[k], filter.fits[k].table[group, here[0] + 2 * here[2]]
        assert_array_equal(state.group, group)
        ahead = filter.predict(state, TIMES[k + 1])
        for path in range(6):
            one = fit.one(group[path])
            mean, cov = one.forecast(state.mean[:, path : path + 1])
            assert_allclose(ahead.mean[:, path], mean[:, 0], rtol=1e-12)
            assert_allclose(ahead.cov[..., path], cov[..., 0], rtol=1e-12)
        weighed = sum(share * fit.one(c).cov for c, share in enumerate(fit.prob))
        assert_allclose(fit.cov, weighed, rtol=1e-12)


def test_what_is_sure_and_missing_is_a_gap(linear):
    """What may be missing is none; from the gap on nothing is claimed, means go on."""
    shown = record(5, 4)
    shown[2, 1, 3] = np.nan
    with pytest.warns(UserWarning, match="1 of 5 records have gaps, from 2 on"):
        found = linear.run(TIMES, shown, covariances=True)
    assert np.isfinite(found.mean).all()
    lost = np.isnan(found.cov).any(axis=(1, 2))
    assert_array_equal(np.argwhere(lost), [[2, 3], [3, 3]])
    assert_array_equal(np.argwhere(np.isnan(found.loglik)), [[3, 3]])
    state = linear.initial((5,))
    for k, now in enumerate(TIMES):
        state = linear.step(state, now, shown[k])
        assert_allclose(state.loglik, found.loglik[k], rtol=1e-9, atol=1e-12)
        cov = np.broadcast_to(state.cov.reshape(2, 2, -1), (2, 2, 5))
        assert_allclose(cov, found.cov[k], rtol=1e-9)


# Modes

CHAIN, TELLS = np.array([[0.9, 0.1], [0.3, 0.7]]), np.array([[0.8, 0.2], [0.3, 0.7]])


def modes():
    moved = [[0.9 * x + 0.3 * y + v, -0.2 * x + 0.8 * y + w], [x / 2 + 2 * v, y / 3 + 1 + w]]
    return SwitchingSystem(
        (x, y), moved, Noise((v, w), cov=SPREAD), CHAIN.tolist(),
        [[x + p, x / 2 + y + q], [x + 2 * p, y + q]],
        Noise((p, q), cov=NOISE[:2, :2]), [(0.6, [0.2, -0.3], np.eye(2)),
                                           (0.4, [-1, 0.5], [[0.5, 0.1], [0.1, 2]])],
        indicator=TELLS.tolist(),
    )  # fmt: skip


def bank():
    spread = [SPREAD, np.diag([4, 1]) @ SPREAD]
    matrices = [MOVE, np.diag([0.5, 1 / 3])]
    looks, noises = [LOOK[:2], np.eye(2)], [NOISE[:2, :2], np.diag([4, 1]) @ NOISE[:2, :2]]
    initial = [(0.6, np.array([0.2, -0.3]), np.eye(2)),
               (0.4, np.array([-1, 0.5]), np.array([[0.5, 0.1], [0.1, 2]]))]  # fmt: skip
    return SwitchingOracle(
        initial, lambda k, i: (matrices[i], np.array([0, float(i)]), spread[i]), lambda k: CHAIN,
        lambda k, i: (looks[i], np.zeros(2), noises[i]), lambda k: TELLS,
    )  # fmt: skip


@pytest.fixture(scope="module")
def switching():
    return synthesize(
        modes(), Memory(1), Taylor(), TIMES, paths=4000, seed=1, availability=[0.6, 1.0, 0.7]
    )


@pytest.mark.parametrize("form", ["design", "for ever", "two in turn", "some steps"])
def test_run_of_a_jump_linear_system_is_its_classes_written_out(switching, form):
    """Cells of a class come after those of the one before; claims are scaled to its errors."""
    made = switching
    filter, served = {
        "design": (made, [0, 1, 2, 3]),
        "for ever": (replace(made, cycle=1), [0, 1, 2, 3, 3, 3]),
        "two in turn": (replace(made, cycle=2), [0, 1, 2, 3, 2, 3]),
        "some steps": (made.taking([0, 1, 3]), [0, 1, 3]),
    }[form]
    steps = len(served)
    times, shown = np.arange(float(steps)), record(8, steps, 2, [0.6, 1.0])
    rng = np.random.default_rng(5)
    told = np.where(rng.random((steps, 8)) < 0.7, rng.integers(0, 2, (steps, 8)), -1)
    joined = form != "design"
    found = filter.run(times, shown, indicators=told, covariances=not joined)
    state = filter.initial((8,))
    for k, now in enumerate(times):
        state = filter.step(state, now, shown[k], told[k])
        assert_allclose(state.mean, found.mean[k], rtol=1e-11)
        if not joined:
            assert_allclose(filter.report(state).cov, found.cov[k], rtol=1e-11)
    for path in range(8):
        group, groups = 0, []

        def recall(k, law, expected, path=path, groups=groups):
            nonlocal group
            row, follows = served[k], served[k + 1] if k + 1 < steps else None
            here = int(not np.isnan(shown[k, 0, path])) + 2 * int(told[k, path] >= 0)
            group = made.arrivals[row].table[group, here]
            groups.append((row, group))
            if follows is None:
                return None
            prob = np.array([part[0] for part in law])
            z = sum(part[0] * part[1] for part in law)
            if follows != row + 1:
                one, other = made.arrivals[row].after, made.arrivals[follows].before
                group = nearest(one, other)[group]
            cell = int(prob[1] > prob[0]) + 2 * group
            fit, score = made.fits[follows - 1].fit, []
            for i in range(2):
                apart = fit.white[:, :, i, cell] @ (z - fit.centre[:, i, cell])
                score.append(fit.log_weight[i, cell] - 0.5 * apart @ apart)
            weight = np.exp(np.array(score) - max(score))
            return [
                (weight[i] / weight.sum(), fit.gain[..., i, cell] @ z + fit.offset[:, i, cell],
                 fit.cov[..., i, cell])
                for i in range(2)
            ]  # fmt: skip

        laws, _, logliks = bank().run(shown[..., path], told[:, path], recall)
        recall(steps - 1, laws[-1], None)
        assert_allclose(found.loglik[:, path], logliks, rtol=1e-8, atol=1e-9)
        for k, (law, (row, last)) in enumerate(zip(laws, groups, strict=True)):
            mean, cov = merged(law)
            assert_allclose(found.mean[k, :, path], mean, rtol=1e-8, atol=1e-9)
            if joined:
                continue
            arrivals = made.arrivals[row]
            ratio = np.diagonal(arrivals.after[last]) / arrivals.claimed[last]
            scaled = np.sqrt(np.outer(ratio, ratio)) * cov
            assert_allclose(found.cov[k, ..., path], scaled, rtol=1e-8)


def test_missing_indicator_is_a_gap_for_a_memory_and_none_for_a_bank():
    shown = np.random.default_rng(3).normal(size=(4, 2, 5))
    told = np.random.default_rng(4).integers(0, 2, (4, 5))
    told[1, 2] = -1
    made = synthesize(modes(), Memory(1), Taylor(), TIMES, paths=4000, seed=1)
    with pytest.warns(UserWarning, match="1 of 5 records have gaps, from 1 on"):
        found = made.run(TIMES, shown, indicators=told, covariances=True)
    lost = np.isnan(found.cov).all(axis=(1, 2))
    assert_array_equal(np.argwhere(lost), [[1, 2], [2, 2], [3, 2]])
    assert_array_equal(np.argwhere(np.isnan(found.loglik)), [[2, 2], [3, 2]])
    assert np.isfinite(found.mean).all()
    state = made.initial((5,))
    for k, now in enumerate(TIMES):
        if k:
            claims = np.isnan(made.forecast(state, now).cov).any(axis=(0, 1))
            assert_array_equal(claims, lost[k - 1])
        state = made.step(state, now, shown[k], told[k])
        assert_allclose(state.loglik, found.loglik[k], rtol=1e-11)
        assert_allclose(made.report(state).cov, found.cov[k], rtol=1e-11)
    plain = SwitchingFilter(modes(), Taylor()).run(TIMES, shown, indicators=told, covariances=True)
    assert np.isfinite(plain.cov).all()
    assert np.isfinite(plain.loglik).all()


# Tables


def looked_up(table, points):
    """By SciPy, at one point; (y..., class, memory...)."""
    axes = [np.linspace(a.low, a.high, a.count) if isinstance(a, Axis) else np.arange(a.count)
            for a in table.axes]  # fmt: skip
    point = [np.clip(c, axis[0], axis[-1]) for c, axis in zip(points, axes, strict=True)]
    return RegularGridInterpolator(axes, table.estimate[0])(point)[0] if axes else table.estimate[0]


@pytest.mark.parametrize("form", ["chance", "for ever", "shuffled", "schedule"])
def test_run_of_tables_is_those_of_its_patterns_and_classes(form):
    """A scalar state by two sensors: a table for each pattern of what is there."""
    system = DiscreteSystem(
        StochasticMap((x,), [0.8 * x + sympy.sin(x) / 2 + v], Noise((v,))),
        StochasticMap((x,), [x + p, x / 2 + q], Noise((p, q), cov=[[1.0, 0], [0, 0.3]])),
        [0.3], [[1.0]],
    )  # fmt: skip
    mask = np.array([[1, 1], [1, 0], [0, 0], [0, 1]], dtype=bool)
    known = {"measured": mask} if form == "schedule" else {"availability": [0.6, 0.8]}
    made = grid_synthesis(
        system, Memory(1), TIMES, x=(-9, 9, 61), z=(-7, 7, 29), y=[(-12, 12, 37), (-7, 7, 29)],
        **known,
    )  # fmt: skip
    if form == "shuffled":  # the classes of a step in another order, and hardly other covariances
        part = made.arrivals[2]
        turned = [name[::-1].copy() for name in (part.table, part.covs, 1.001 * part.before)]
        part = part._replace(table=turned[0], covs=turned[1], before=turned[2])
        made = replace(made, arrivals=(*made.arrivals[:2], part, made.arrivals[3]))
    filter = replace(made, cycle=1) if form == "for ever" else made
    served = [0, 1, 2, 3, 3, 3] if form == "for ever" else [0, 1, 2, 3]
    shown = record(10, len(served), 2, [0.6, 0.8])
    if form == "schedule":
        shown = np.where(mask[..., None], np.random.default_rng(1).normal(size=(4, 2, 10)), np.nan)
    times = np.arange(float(len(served)))
    found = filter.run(times, shown, covariances=True)
    plane = filter.run(times, shown.reshape(-1, 2, 5, 2), covariances=True)
    assert_array_equal(plane.mean.reshape(found.mean.shape), found.mean)
    for path in range(10):
        group, z, before = 0, None, -1
        state = filter.initial()
        for k, row in enumerate(served):
            step, here = made.steps[row], ~np.isnan(shown[k, :, path])
            if form != "schedule" and (before != row - 1 or (form == "shuffled" and row == 2)):
                group = nearest(made.arrivals[before].after, made.arrivals[row].before)[group]
            past = ([] if form == "schedule" else [group]) + ([] if z is None else [z])
            number = int(here[0]) + 2 * int(here[1])
            table = step.shown.tables[number - 1] if number else step.blind
            z = looked_up(table, [*shown[k, here, path], *past])
            assert_allclose(found.mean[k, 0, path], z, atol=1e-9)
            wanted = made.covariances[row]
            if form != "schedule":
                wanted = made.arrivals[row].covs[group, number]
                group = made.arrivals[row].table[group, number]
            cov = found.cov[k].reshape(1, 1, -1)
            assert_allclose(np.broadcast_to(cov, (1, 1, 10))[..., path], wanted, rtol=1e-12)
            before = row
            state = filter.step(state, times[k], shown[k, :, path])
            assert_allclose(state.mean, z, atol=1e-9)
            assert_allclose(state.cov, wanted, rtol=1e-12)


def test_tables_with_classes_claim_nothing_between_measurements():
    filter = grid_synthesis(
        zoo.flip_process(), Memory(1), [0.0, 0.25, 0.5], x=(-3.5, 3.5, 41), z=(-3, 3, 31),
        y=(-8, 8, 41), nodes=1, availability=0.7,
    )  # fmt: skip
    times = np.array([0.0, 0.1, 0.25, 0.375, 0.5])
    shown = np.full((5, 1, 3), np.nan)
    shown[::2] = np.random.default_rng(8).normal(size=(3, 1, 3))
    shown[2, 0, 1] = np.nan
    found = filter.run(times, shown, covariances=True)
    assert np.isnan(found.cov[[1, 3]]).all()
    assert np.isfinite(found.cov[::2]).all()
    group = filter.arrivals[0].table[0, 1]
    group = filter.arrivals[1].table[group, 0]
    (fit,) = filter.node_fits[1]
    node = looked_up(fit, [group, found.mean[2, 0, 1]])
    assert_allclose(found.mean[3, 0, 1], node, atol=1e-9)
    alone = filter.run(times, shown[..., 1], covariances=True)
    assert_array_equal(alone.cov, found.cov[..., 1])
    some = filter.taking([0, 2])
    assert_array_equal(some.arrivals[1].covs, filter.arrivals[2].covs)
