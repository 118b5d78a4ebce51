"""Every filter has the same verbs, and an evaluation takes them all."""

import inspect

import numpy as np
import pytest
import sympy as sp

from seedslib import delay, designed, filters, piecewise, zoo
from seedslib.design import grid_synthesis
from seedslib.evaluation import compare
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, System

VERBS = {
    "initial": ("batch", "seed"),
    "predict": ("state", "t"),
    "correct": ("state", "y"),
    "report": ("state",),
    "step": ("state", "t", "y"),
    "forecast": ("state", "t"),
    "run": ("times", "measurements"),
}
ALL = [
    filters.CovarianceFilter, filters.ParticleFilter, filters.RaoBlackwellFilter,
    filters.GridBayesFilter, filters.KnownModeFilter, designed.FiniteOrderFilter,
    designed.SwitchingFilter, designed.TableFilter, delay.DelayKalmanFilter,
    delay.PrintedDelayFilter, piecewise.PiecewiseLinearFilter,
]  # fmt: skip
PLANT = delay.examples.rotation(0.7, 3)
BODY = piecewise.examples.falling_body(5)
MAKE = {
    "covariance": lambda: filters.extended_kalman(zoo.van_der_pol()),
    "particle": lambda: filters.ParticleFilter(zoo.van_der_pol(), 10),
    "rao": lambda: filters.RaoBlackwellFilter(zoo.manoeuvring_target("noisy"), 10),
    "grid": lambda: filters.GridBayesFilter(zoo.scalar_switching("A1H")),
    "known": lambda: filters.KnownModeFilter(zoo.manoeuvring_target("noisy")),
    "bank": lambda: designed.SwitchingFilter(zoo.manoeuvring_target("noisy"), Taylor()),
    **{
        method: lambda method=method: delay.DelayKalmanFilter(PLANT, method)
        for method in ("structured", "array", "chandrasekhar", "augmented")
    },
    "printed": lambda: delay.PrintedDelayFilter(PLANT),
    "piecewise": lambda: piecewise.PiecewiseLinearFilter(BODY),
    "table": lambda: grid_synthesis(
        zoo.scalar_switching("A1H"),
        designed.large_order(1),
        np.arange(6.0),
        x=(-8, 8, 41),
        z=(-6, 6, 21),
        y=(-16, 18, 41),
    ),
}


@pytest.mark.parametrize("kind", ALL)
def test_every_filter_has_the_same_verbs(kind):
    assert issubclass(kind, filters.Filter)
    assert set(kind.takes) <= {"indicators", "modes", "seed", "covariances"}
    for verb, wanted in VERBS.items():
        known = tuple(inspect.signature(getattr(kind, verb)).parameters)[1:]
        assert known[: len(wanted)] == wanted, verb
    run = inspect.signature(kind.run).parameters
    assert set(kind.takes) <= set(run)


@pytest.mark.parametrize("kind", MAKE)
def test_a_run_is_the_steps_one_after_the_other(kind):
    """Also that a seed of None is taken everywhere, and what a forecast says."""
    made, times = MAKE[kind](), np.arange(6.0)
    data = made.system.simulate(times, 4, 3)
    given = {"indicators": data.indicators, "modes": data.modes, "seed": 0, "covariances": True}
    given = {name: part for name, part in given.items() if name in made.takes}
    whole = made.run(times, data.measurements, **given)
    shown = [()] * 6 if data.indicators is None else [(row,) for row in data.indicators]
    told = [{"mode": row} for row in data.modes] if "modes" in made.takes else [{}] * 6
    state = made.initial((4,), None, **told[0])
    for k, t in enumerate(times):
        ahead = made.forecast(state, t, **told[k])
        assert ahead.mean.shape == whole.mean.shape[1:]
        assert ahead.loglik is None
        state = made.step(state, t, data.measurements[k], *shown[k], **told[k])
        if "seed" in made.takes:  # streams of a run are those of its blocks
            continue
        said = made.report(state)
        np.testing.assert_allclose(said.mean, whole.mean[k], rtol=1e-10, atol=1e-12)
        assert (whole.modes is None) == (said.modes is None)
        if said.cov is not None:
            cov = whole.cov[k]
            cov = cov if said.cov.ndim <= cov.ndim else cov[..., None]
            np.testing.assert_allclose(said.cov, cov, rtol=1e-9, atol=1e-12)


def test_delay_filters_are_compared():
    """Their errors are those that the recursions claim, or not, by themselves."""
    steps, made = 12, {"kalman": MAKE["structured"](), "printed": MAKE["printed"]()}
    found = compare(made, PLANT, np.arange(steps + 1.0), 4000, 5, consistency=True)
    table = made["kalman"].gains(steps)
    exact = {
        "kalman": np.trace(table.cov, axis1=1, axis2=2),
        "printed": np.trace(
            delay.error_covariance(PLANT, made["printed"].gains(steps).gains), axis1=1, axis2=2
        ),
    }
    for name, result in found.items():
        assert (np.abs(result.total - np.sqrt(exact[name])) < 4.5 * result.total_error).all()
    low, high = (bound[0] for bound in found["kalman"].nees_bounds)
    assert low - 0.1 < found["kalman"].nees.mean() < high + 0.1
    few = compare(made | {"printed": made["kalman"]}, PLANT, np.arange(5.0), 50, 5, measured=[1])
    rows = np.isclose(few["kalman"].rms, few["printed"].rms)
    assert rows.all()


def test_a_forecast_over_instants_without_measurements():
    """Of the delay filter: the same as measurements that are all missing."""
    for method in ("structured", "array", "augmented"):
        kalman = MAKE[method]()
        y = PLANT.simulate(6, 3, 1).measurements
        y[4:6] = np.nan
        state = kalman.initial((3,))
        for k in (1, 2, 3):
            state = kalman.step(state, k, y[k])
        found, wanted = kalman.forecast(state, 5), kalman.run(6, y)
        np.testing.assert_allclose(found.mean, wanted.mean[5], rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.cov, wanted.cov[5], rtol=0, atol=1e-12)
        late = kalman.step(state, 6, y[6])
        np.testing.assert_allclose(late.mean[0], wanted.mean[6], rtol=0, atol=1e-12)
        with pytest.raises(ValueError, match="t: wanted an instant, a whole number"):
            kalman.predict(state, 3.5)
        with pytest.raises(ValueError, match="t: wanted a time from 3 on"):
            kalman.predict(state, 2)
        with pytest.raises(ValueError, match="state: wanted a forecast"):
            kalman.correct(state, y[4])


def test_the_printed_filter_wants_every_measurement():
    printed = MAKE["printed"]()
    state = printed.initial()
    assert printed.step(state, 0, [np.nan]) is state
    with pytest.raises(ValueError, match="state: wanted a forecast"):
        printed.correct(state, [1.0])
    with pytest.raises(ValueError, match="t: wanted the instant after a measured one"):
        printed.predict(state, 2)
    ahead = printed.predict(state, 1)
    with pytest.raises(ValueError, match="y: wanted finite numbers"):
        printed.correct(ahead, [np.nan])


def test_a_piecewise_filter_is_compared():
    made = {"piecewise": MAKE["piecewise"](), "many": piecewise.PiecewiseLinearFilter(BODY)}
    found = compare(made, BODY, np.arange(4.0), 60, 2, measured=[1, 3])
    assert found["piecewise"].rms.shape == (4, 2)
    np.testing.assert_array_equal(found["piecewise"].rms, found["many"].rms)


def test_what_a_filter_does_not_take_is_refused():
    times, y = np.arange(3.0), np.zeros((3, 2))
    kalman = MAKE["covariance"]()
    with pytest.raises(ValueError, match="modes: wanted none, the filter finds them by itself"):
        kalman.run(times, y, modes=np.zeros(3, int))
    with pytest.raises(ValueError, match="indicators: wanted none, the system has no modes"):
        kalman.run(times, y, indicators=np.zeros(3, int))
    with pytest.raises(ValueError, match=r"modes: wanted whole numbers of shape \(3,\), got None"):
        MAKE["known"]().run(times, y[:, :1], indicators=np.zeros(3, int))


def test_one_time_has_an_interval_and_a_measurement():
    """What a step and a forecast say, and a whole record in place of a measurement."""
    kalman = MAKE["covariance"]()
    state = kalman.step(kalman.initial(), 0.0, [1.0, 0.5])
    for told in (kalman.report(state), kalman.forecast(state, 1.0)):
        width = np.diff(told.interval(0.95), axis=0)[0]
        np.testing.assert_allclose(width, 2 * 1.959963984540054 * np.sqrt(np.diag(told.cov)))
    with pytest.raises(ValueError, match=r"y: wanted shape \(2, \*batch\), got \(9, 2\)"):
        kalman.step(state, 1.0, np.zeros((9, 2)))
    dates = np.array(["2026-01-01", "2026-01-02"], dtype="datetime64[h]")
    with pytest.raises(TypeError, match=r"datetime64\[h\]; take time since the first in a unit"):
        kalman.run(dates, np.zeros((2, 2)))


def test_systems_say_their_sizes_alike():
    x, w, v = sp.symbols("x w v")
    maps = StochasticMap([x], [x / 2 + w], Noise([w])), StochasticMap([x], [x + v], Noise([v]))
    numbers = DiscreteSystem(*maps, 0.0, 1.0)
    np.testing.assert_array_equal(numbers.cov0, [[1.0]])
    switching = zoo.manoeuvring_target("noisy")
    for system, sizes in (
        (numbers, (1, 1, 0)),
        (zoo.van_der_pol(), (2, 2, 0)),
        (switching, (2, 1, 2)),
        (switching.hybrid, (3, 2, 2)),
        (PLANT, (2, 1, 0)),
        (BODY, (2, 1, 0)),
    ):
        assert (system.state_size, system.measurement_size, system.indicators) == sizes
    for system in (numbers, zoo.van_der_pol(), switching.hybrid):
        assert isinstance(system, System)
