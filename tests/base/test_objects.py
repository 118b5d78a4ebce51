"""Every object runs to equal bits after a trip to another process, or says why it cannot."""

import copy
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from html import unescape
from operator import methodcaller

import numpy as np
import pytest
import sympy as sp

from seedslib import zoo
from seedslib.base import Axis
from seedslib.delay import DelayKalmanFilter
from seedslib.delay import examples as delayed
from seedslib.design import Continuous, Polynomial, grid_synthesis, synthesize
from seedslib.designed import Memory, SwitchingFilter, large_order
from seedslib.evaluation import compare, diff, evaluate
from seedslib.filters import (
    GridBayesFilter,
    KnownModeFilter,
    ParticleFilter,
    RaoBlackwellFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    unscented_kalman,
)
from seedslib.linearization import Cubature, ExactGaussian, Taylor
from seedslib.models import (
    DiscreteSystem,
    FellerChain,
    JumpDiffusion,
    Noise,
    StochasticMap,
    SwitchingChain,
)
from seedslib.piecewise import PiecewiseLinearFilter
from seedslib.piecewise import examples as piecewise
from seedslib.two_step import LinearDiffusion

pytestmark = pytest.mark.filterwarnings("ignore:(paths|y): ")

TIMES = np.arange(3.0)
x, w, v = sp.symbols("x w v")


def discrete():
    move = StochasticMap([x], [x / 2 + w], Noise([w]))
    return DiscreteSystem(move, StochasticMap([x], [x**2 + v], Noise([v])), [0.5], [[1.0]])


def designed(memory=None, rule=None, system=None, **options):
    memory, rule = memory or Memory(1), rule or Taylor()
    return synthesize(system or discrete(), memory, rule, TIMES, paths=600, seed=1, **options)


def grids(system, times=TIMES):
    return grid_synthesis(
        system, large_order(1), times, x=(-8, 8, 41), z=(-6, 6, 21), y=(-16, 18, 35)
    )


def target():
    return zoo.manoeuvring_target("noisy")


SYSTEMS = {
    "discrete": discrete,
    "jump-diffusion": zoo.flip_process,
    "oscillator": zoo.van_der_pol,
    "switching": target,
    "dependent switching": zoo.dependent_switching,
    "linear": lambda: LinearDiffusion([[-1.0]], [[1.0]], [[1.0]], [[1.0]], [0.0], [[1.0]]),
    "delay": lambda: delayed.scalar(0.5, 0.3),
    "falling body": piecewise.falling_body,
}
FILTERS = {
    "extended": lambda: extended_kalman(discrete()),
    "extended, continuous": lambda: extended_kalman(zoo.flip_process(), step=0.1),
    "assumed density": lambda: assumed_density(zoo.van_der_pol(), integrator="euler", bound=50),
    "unscented": lambda: unscented_kalman(discrete()),
    "cubature": lambda: cubature_kalman(discrete()),
    "particles": lambda: ParticleFilter(discrete(), 10),
    "Rao-Blackwell": lambda: RaoBlackwellFilter(target(), 10),
    "grid": lambda: GridBayesFilter(zoo.scalar_switching(), (-8, 8, 31)),
    "bank": lambda: SwitchingFilter(target(), Taylor()),
    "finite order": designed,
    "finite order, exact": lambda: designed(Memory(1, 1), ExactGaussian()),
    "polynomial": lambda: designed(None, Cubature(), predictor=Polynomial(2, 1)),
    "continuous": lambda: designed(
        None, ExactGaussian(), zoo.flip_process(), predictor=Continuous(), horizon=2.5
    ).forecasting("constant"),
    "switching": lambda: designed(Memory(1), None, target()),
    "table": lambda: grids(zoo.flip_process()),
    "table of modes": lambda: grids(zoo.scalar_switching()),
    "piecewise": lambda: PiecewiseLinearFilter(piecewise.falling_body(), prune=1e-6),
}
TRIPS = {"pickle": lambda thing: pickle.loads(pickle.dumps(thing)), "deepcopy": copy.deepcopy}


def record(filter):
    """Arguments of `run`: the same measurements whatever they mean."""
    system = filter.system
    times = TIMES if not isinstance(filter, PiecewiseLinearFilter) else 1.0 + TIMES
    y = np.random.default_rng(0).normal(size=(len(times), system.measurement_size, 4))
    told = {}
    if system.indicators:
        told["indicators"] = np.zeros((len(times), 4), dtype=int)
    return times, y, told


def running(filter):
    """Call of `run` that another process can make."""
    times, y, told = record(filter)
    return methodcaller("run", times, y, **told)


def same(one, two):
    """Whether two trees of tuples and arrays agree bit by bit."""
    if isinstance(one, tuple):
        return len(one) == len(two) and all(map(same, one, two))
    return one is two is None or np.array_equal(one, two, equal_nan=True)


@pytest.mark.parametrize("trip", TRIPS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_systems_travel(name, trip):
    system = SYSTEMS[name]()
    other = TRIPS[trip](system)
    if hasattr(system, "simulate"):
        times = 3 if name == "delay" else TIMES
        one, two = (each.simulate(times, 5, 3) for each in (system, other))
        assert same(tuple(one), tuple(two))
    assert type(other) is type(system)


@pytest.mark.parametrize("name", FILTERS)
def test_filters_travel(name):
    filter = FILTERS[name]()
    run = running(filter)
    wanted = run(filter)
    for trip in TRIPS.values():
        other = trip(filter)
        assert same(tuple(wanted), tuple(run(other)))
        assert repr(other) == repr(filter)
    times, y, told = record(filter)
    shown = [rows[0] for rows in told.values()]
    state = filter.step(filter.initial((4,)), times[0], y[0], *shown)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(state)).mean, state.mean)


def test_known_modes_travel():
    filter = KnownModeFilter(target())
    y, modes = np.ones((3, 1, 4)), np.zeros((3, 4), dtype=int)
    for trip in TRIPS.values():
        told = {"modes": modes, "indicators": modes}
        one, two = (each.run(TIMES, y, **told) for each in (filter, trip(filter)))
        assert same(tuple(one), tuple(two))


def test_a_delay_filter_travels():
    filter = DelayKalmanFilter(delayed.scalar(0.5, 0.3))
    assert isinstance(pickle.loads(pickle.dumps(filter)), DelayKalmanFilter)


def test_chains_and_results_travel():
    flip = zoo.flip_process()
    ekf = extended_kalman(flip, step=0.1)
    things = [
        FellerChain(flip, Axis(-3, 3, 31)), SwitchingChain(zoo.scalar_switching(), Axis(-8, 8, 31)),
        ekf.run(TIMES, np.ones((3, 1))), evaluate(ekf, flip, TIMES, 50, 1),
        compare({"a": ekf, "b": ParticleFilter(flip, 10)}, flip, TIMES, 50, 1),
        flip.simulate(TIMES, 5, 1), diff(designed(), designed()), sp.symbols("a b"), Noise((x,)),
    ]  # fmt: skip
    for thing in things:
        for trip in TRIPS.values():
            assert type(trip(thing)) is type(thing)


def test_a_pool_of_processes_runs_filters():
    chosen = [FILTERS[name]() for name in ("extended", "finite order", "switching")]
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=fresh) as pool:
        waiting = [pool.submit(running(filter), filter) for filter in chosen]
        for filter, result in zip(chosen, waiting, strict=True):
            assert same(tuple(running(filter)(filter)), tuple(result.result(timeout=120)))


def test_lambdas_do_not_travel():
    sensor = StochasticMap.from_functions(1, 1, lambda t, x, v: x + v, Noise(1))
    with pytest.raises((AttributeError, pickle.PicklingError), match=r"lambda|local object"):
        pickle.dumps(sensor)


@pytest.mark.parametrize("name", [*SYSTEMS, *FILTERS])
def test_objects_show_themselves(name):
    thing = (FILTERS | SYSTEMS)[name]()
    if hasattr(thing, "_repr_html_"):
        page = unescape(thing._repr_html_())
        assert page.startswith(("<table>", "<pre>"))
        assert " object at 0x" not in page
        if page.startswith("<pre>"):
            assert str(thing) in page
    if "<" in repr(thing)[:1]:
        assert "\n" not in repr(thing)
        assert " object at 0x" not in repr(thing)


def test_a_model_shows_its_formulas_and_a_comparison_its_page():
    page = JumpDiffusion((x,), [-x], [[1]], [x + v], Noise((v,)), [0], [[1]])._repr_html_()
    assert "<td>drift</td><td>[-x]</td>" in page
    flip = zoo.flip_process()
    found = compare({"a<b": extended_kalman(flip, step=0.1)}, flip, TIMES, 50, 1)
    assert repr(found).splitlines()[1].startswith("a<b ")
    assert "a&lt;b" in found._repr_html_()
