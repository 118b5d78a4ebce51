"""Designs that know of missing measurements, in C: schedules, and classes of what arrived."""

import warnings
from functools import lru_cache

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import Polynomial, grid_synthesis, stationary, synthesize
from seedslib.designed import Memory
from seedslib.extra import compiled as behind_its_verbs
from seedslib.extra import to_c
from seedslib.extra.c import build
from seedslib.filters import extended_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

p, q, v = sympy.symbols("p q v", real=True)
e, r = sympy.symbols("e1 e2", real=True), sympy.symbols("r1 r2", real=True)
TIMES, SHORT = np.arange(7.0), 0.5 * np.arange(4.0)

pytestmark = pytest.mark.filterwarnings("ignore:availability", "ignore:paths:UserWarning")


@lru_cache
def pair():
    """Two components that turn into each other, each with a sensor."""
    moved = [0.95 * p + 0.3 * q + e[0], -0.3 * p + 0.92 * q + e[1]]
    return DiscreteSystem(
        StochasticMap([p, q], moved, Noise(e, cov=np.diag([0.05, 0.5]))),
        StochasticMap([p, q], [p + r[0], q + r[1]], Noise(r, cov=np.diag([0.5, 0.2]))),
        [0.0, 0.0], np.eye(2),
    )  # fmt: skip


@lru_cache
def walk():
    """Its variance grows for as long as nothing arrives."""
    return DiscreteSystem(
        StochasticMap([p], [p + q], Noise([q])), StochasticMap([p], [p + v], Noise([v])),
        [0.0], [[1.0]],
    )  # fmt: skip


@lru_cache
def bent():
    """One component and a sensor with a cube in it."""
    return DiscreteSystem(
        StochasticMap([p], [0.9 * p + q], Noise([q])),
        StochasticMap([p], [p + p**3 / 30 + v], Noise([v], cov=[[0.2]])), [0.0], [[1.0]],
    )  # fmt: skip


def mask():
    """The second sensor is read at every third time, and the first not at the beginning."""
    found = np.ones((len(TIMES), 2), dtype=bool)
    found[:, 1] = np.arange(len(TIMES)) % 3 == 0
    found[0, 0] = False
    return found


def turns():
    """One sensor each time."""
    return np.array([[True, False], [False, True]] * 4)[: len(TIMES)]


def planned(system, memory=None, rule=None, times=TIMES, **options):
    memory, rule = memory or Memory(1), rule or Taylor()
    return synthesize(system, memory, rule, times, **{"paths": 500, "seed": 1, **options})


def oscillator(**options):
    return planned(zoo.van_der_pol(), rule=ExactGaussian(), times=SHORT, nodes=1, **options)


MADE = {
    "walk": lambda: planned(walk(), paths=3000, availability=0.6),
    "nodes that see the measurement": lambda: oscillator(
        measured_nodes=True, availability=[1.0, 0.6]
    ),
    "two estimates": lambda: planned(pair(), Memory(2), availability=[0.7, 1.0]),
    "polynomials": lambda: planned(bent(), predictor=Polynomial(2, 2), availability=0.7),
    "schedule": lambda: planned(pair(), measured=mask()),
    "schedule and classes": lambda: planned(
        pair(), Memory(1, 1), measured=mask(), availability=[0.7, 0.8]
    ),
    "for ever, in turn": lambda: stationary(
        planned(pair(), measured=turns(), availability=[0.7, 0.8]), tolerance=9.0, paths=50,
        cycle=2,
    ),
}  # fmt: skip


@lru_cache
def made(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return MADE[name]()


def record(filter, paths=30, count=40):
    """Times and measurements with what the design knows to be missing, and some that it does not.

    The last ten paths lose a component for good that the design has for certain, where it has one.
    """
    many = count if filter.cycle else len(filter.times)
    times = np.array([filter.clock.moment(k, filter.cycle) for k in range(many)])
    there = filter.schedule.mask[[filter.served(k) for k in range(many)]]
    rates = filter.availability
    y = filter.system.simulate(
        times, paths, 2, measured=there, availability=None if rates is None else 0.6 * rates
    ).measurements.copy()
    if rates is not None:
        sure = rates == 1.0
        y[:, sure] = filter.system.simulate(times, paths, 2, measured=there).measurements[:, sure]
    if rates is None or sure.any():
        y[3, -1 if rates is None else int(np.argmax(sure)), -10:] = np.nan
    return times, y


def near(found, wanted, part=1e-13):
    assert np.array_equal(np.isnan(found), np.isnan(wanted))
    size = np.nanmax(np.abs(wanted))
    np.testing.assert_allclose(found, wanted, rtol=part, atol=part * size)


@pytest.mark.parametrize("name", MADE)
@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_they_are_the_filters_of_python(name, compiled):
    filter = made(name)
    times, y = record(filter)
    grid = np.union1d(times, np.concatenate([*filter.node_times, []]))
    if filter.cycle:
        grid = times
    whole = np.full((len(grid), *y.shape[1:]), np.nan)
    at = np.searchsorted(grid, times)
    whole[at] = y
    wanted = filter.run(grid, whole, covariances=True)
    mean, cov, loglik, nodes = compiled(filter).run(times, y)
    part = 1e-11 if "polynomial" in name else 1e-12 if filter.cycle else 1e-13
    near(mean, wanted.mean[at], part)
    near(cov, wanted.cov[at], part)
    near(loglik, wanted.loglik[at], 10 * part)
    between = np.setdiff1d(np.arange(len(grid)), at)
    if len(between):
        near(nodes[: len(between)], wanted.mean[between], part)
    assert np.isnan(cov).any() == np.isnan(wanted.cov[at]).any()


def test_it_matters_what_arrived(compiled):
    """The claims are those of the Kalman filter, which one covariance for all would not be."""
    filter = made("walk")
    times, y = record(filter)
    cov = compiled(filter).run(times, y)[1]
    right = extended_kalman(walk()).run(times, y).cov
    assert np.sqrt((np.log(cov / right) ** 2).mean()) < 0.05
    assert np.sqrt((np.log(cov.mean(axis=-1, keepdims=True) / right) ** 2).mean()) > 0.2


@pytest.mark.parametrize("name", ["schedule and classes", "for ever, in turn"])
@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_behind_the_verbs(name):
    if build.compiler() is None:
        pytest.skip("no C compiler")
    filter = made(name)
    twin = behind_its_verbs(filter)
    times, y = record(filter)
    wanted = filter.run(times, y, covariances=True)
    found = twin.run(times, y, covariances=True)
    near(found.mean, wanted.mean, 1e-12)
    near(found.cov, wanted.cov, 1e-12)
    near(found.loglik, wanted.loglik, 1e-11)
    state, single, many = filter.initial(), twin.initial(), twin.initial((30,))
    for k, t in enumerate(times):
        state, single = filter.step(state, t, y[k, :, 3]), twin.step(single, t, y[k, :, 3])
        many = twin.step(many, t, y[k])
        near(single.mean, state.mean, 1e-12)
        near(single.cov, state.cov, 1e-12)
        near(many.mean, wanted.mean[k], 1e-12)
    if not filter.cycle:
        stray = np.where(np.isnan(y[0, :, 0]), 1.0, y[0, :, 0])
        for each in (filter, twin):
            with pytest.raises(ValueError, match="wanted what the schedule of the design has, got"):
                each.step(each.initial(), 0.0, stray)
            with pytest.raises(ValueError, match="wanted what the schedule of the design has, got"):
                each.run(times, np.ones_like(y))


@pytest.mark.filterwarnings("ignore:[xyz]. the:UserWarning")
def test_refused(compiled):
    filter = made("schedule")
    y = record(filter, 1)[1][..., 0]
    c = compiled(filter)
    assert c.refused(y) == 0
    y[1, 1] = 0.0
    assert c.refused(y) == 6
    table = grid_synthesis(
        zoo.flip_process(), Memory(1), [0.0, 0.25], x=(-3.5, 3.5, 41), z=(-2.5, 2.5, 7),
        y=(-8, 8, 17), nodes=0,
    )  # fmt: skip
    object.__setattr__(table, "measured", np.ones((2, 1), dtype=bool))
    with pytest.raises(ValueError, match="filter: wanted a TableFilter without `measured` for C"):
        to_c(table)


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_modes_with_a_schedule(compiled):
    """The indicator is a component as any: here it is there at every second time only."""
    system, times = zoo.manoeuvring_target(), np.arange(6.0)
    read = np.ones((6, system.measurement_size + 1), dtype=bool)
    read[1::2, -1] = read[2, 0] = False
    filter = synthesize(system, Memory(1), Taylor(), times, paths=600, seed=1, measured=read)
    data = system.simulate(times, 20, 2, measured=read)
    y, told = data.measurements.copy(), data.indicators.copy()
    y[3, 0, :5], told[4, 5:9] = np.nan, -1
    wanted = filter.run(times, y, indicators=told, covariances=True)
    c = compiled(filter)
    mean, cov, loglik, prob, modes = c.run(times, y, told)
    for one, other in (
        (mean, wanted.mean), (cov, wanted.cov), (loglik, wanted.loglik), (prob, wanted.mode_prob)
    ):  # fmt: skip
        near(one, other, 1e-10)
    assert np.array_equal(modes, wanted.modes)
    assert np.isnan(cov[-1, 0, 0]).sum() == 9
    told[1] = 0
    assert c.run(times, y, told) == 6


def test_one_class_is_a_design_without(compiled):
    """Rates of one leave nothing to be known: the numbers are those of the plain design."""
    y = zoo.van_der_pol().simulate(SHORT, 20, 3).measurements
    plain, sure = oscillator(), oscillator(availability=[1.0, 1.0])
    assert plain.ways is None
    for one, two in zip(compiled(plain).run(SHORT, y), compiled(sure).run(SHORT, y), strict=True):
        near(one, two, 1e-12)
