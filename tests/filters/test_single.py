"""One record on floats: the numbers of the filter's arrays, for each kind of filter."""

import pickle

import numpy as np
import pytest
import sympy

from export.exported_filters import FILTERS, case, near
from seedslib.base import Parameter
from seedslib.designed import SwitchingFilter
from seedslib.filters import KalmanFilter, extended_kalman, unscented_kalman
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap
from systems import TIMES, growth, pendulum, switching_system

STEPS = 200
GAPS = pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
a, b, v, w = sympy.symbols("a b v w", real=True)


def uses_floats(filter):
    return filter._single.of(filter)


def by_arrays(filter, state, t, y, *indicator, inputs=None):
    """A step by the two verbs, which have no program."""
    return filter.correct(filter.predict(state, t, inputs=inputs), y, *indicator, inputs=inputs)


def equal_states(found, wanted):
    """All that a state has, blocks of memory and distributions too."""
    assert type(found) is type(wanted)
    if wanted is None or isinstance(wanted, bool | int):
        assert found == wanted
    elif isinstance(wanted, tuple):
        assert len(found) == len(wanted)
        for part, other in zip(found, wanted, strict=True):
            if isinstance(other, np.ndarray) and other.ndim:
                near(part, other)
            elif isinstance(other, np.ndarray | float | np.generic):
                # a time, or a log-likelihood: a sum of numbers of order one, which may vanish
                near([part, 1.0], [other, 1.0])
            else:
                equal_states(part, other)


def long_record(one):
    """Times of a filter, 200 of them where it has no end, and a record with gaps, repeated."""
    filter, times = one.filter, one.times
    if getattr(filter, "memory", None) is None:
        times = times[0] + np.concatenate([[0], np.cumsum(np.resize(np.diff(times), STEPS - 1))])
    elif filter.cycle:
        times = times[0] + (times[1] - times[0]) * np.arange(STEPS)
    rows = np.resize(np.arange(len(one.times)), len(times))
    return times, one.y[rows, :, 0], rows


@GAPS
@pytest.mark.parametrize("name", FILTERS)
def test_a_step_is_that_of_the_arrays_from_the_same_state(name):
    one = case(name)
    filter, (times, y, rows) = one.filter, long_record(one)
    assert uses_floats(filter)
    state = filter.initial()
    for t, row, k in zip(times, y, rows, strict=True):
        more = () if one.indicators is None else (one.indicators[k, 0],)
        inputs = one.at(k) or None
        wanted = by_arrays(filter, state, t, row, *more, inputs=inputs)
        equal_states(filter.step(state, t, row, *more, inputs=inputs), wanted)
        state = wanted


@GAPS
@pytest.mark.parametrize("name", FILTERS)
def test_a_record_alone_has_the_estimates_that_it_has_in_a_batch(name):
    one = case(name)
    options = {"covariances": True} if "covariances" in one.filter.takes else {}
    for i in (0, 1):
        alone, batch = (
            one.filter.run(
                one.times,
                one.y[..., part],
                indicators=None if one.indicators is None else one.indicators[:, part],
                inputs={p: values[:, part] for p, values in one.inputs.items()} or None,
                **options,
            )
            for part in (i, slice(i, i + 1))
        )
        for found, wanted in zip(alone, batch, strict=True):
            assert (found is None) == (wanted is None)
            if wanted is not None:
                assert found.dtype == wanted.dtype
                near(found, wanted.reshape(found.shape))


# What floats do not have, and what is refused


def exact():
    """Two sensors without noise; what they say first is known."""
    shows = StochasticMap((a, b), [a, b + a / 5], Noise(()))
    move = StochasticMap((a, b), [a + b / 3 + v, 0.9 * b + w / 2], Noise((v, w)))
    return DiscreteSystem(move, shows, [0.3, -0.2], [[0.5, 0.1], [0.1, 0.8]])


def wide():
    F, H = np.eye(2) + np.eye(2, k=1), np.eye(2)[:1]
    return LinearSystem(F, 0.1 * np.eye(2), H, [[1e-4]], [0, 0], 1e8 * np.eye(2))


HARD = {
    "overflow": (extended_kalman, growth, [[1.0], [1e300], [2.0], [1e-300], [3.0]]),
    "exact": (extended_kalman, exact, [[0.7, 0.2], [0.9, 0.1], [np.nan, 0.4], [1.0, np.nan]]),
    "exact, points": (unscented_kalman, exact, [[0.7, 0.2], [0.9, 0.1], [np.nan, 0.4]]),
    "wide": (KalmanFilter, wide, [[1.0], [np.nan], [3.0], [2.0]]),
}


@pytest.mark.parametrize("name", HARD)
def test_what_floats_cannot_do_arrays_do(name):
    make, system, y = HARD[name]
    filter, y, times = make(system()), np.array(y), np.arange(float(len(y)))
    with np.errstate(all="ignore"):
        alone, batch = filter.run(times, y), filter.run(times, y[..., None])
        state = filter.initial()
        for t, row in zip(times, y, strict=True):
            wanted = by_arrays(filter, state, t, row)
            equal_states(filter.step(state, t, row), wanted)
            state = wanted
    assert uses_floats(filter)
    for found, wanted in zip(alone, batch, strict=True):
        if wanted is not None:
            np.testing.assert_allclose(found, wanted.reshape(found.shape), rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize(
    "given",
    [
        (1.0, [np.inf]),
        (1.0, [1.0, 2.0]),
        (-1.0, [1.0]),
        (2.5, [1.0]),
        (np.nan, [1.0]),
        (1.0, ["x"]),
        (1.0, [1.0], 0),
    ],
)
def test_a_refusal_is_that_of_the_arrays(given):
    filter = extended_kalman(pendulum())
    state = filter.step(filter.step(filter.initial(), 0.0, [0.5]), 1.0, [0.3])
    with pytest.raises((TypeError, ValueError)) as wanted:
        by_arrays(filter, state, *given)
    with pytest.raises(wanted.type) as found:
        filter.step(state, *given)
    assert str(found.value) == str(wanted.value)


def test_an_indicator_is_wanted_and_in_range():
    filter = SwitchingFilter(switching_system(inputs=False), Taylor())
    state, y = filter.initial(), np.zeros(filter.system.measurement_size)
    for indicator in ((), (99,), (0.5,)):
        with pytest.raises((TypeError, ValueError), match=r"^indicator"):
            filter.step(state, TIMES[0], y, *indicator)


# Where a program is kept


def counted(monkeypatch, filter):
    """The list that programs of the filter's kind are put on as they are recorded."""
    kind, recorded = type(filter), []
    program = kind.program

    def record(self, **options):
        recorded.append(self)
        return program(self, **options)

    monkeypatch.setattr(kind, "program", record)
    return recorded


def test_numbers_of_parameters_share_one_program_which_is_not_pickled(monkeypatch):
    q = Parameter("q", 1.0, positive=True)
    filter = KalmanFilter(LinearSystem(1, q, 1, 1, 0, 1))
    recorded, times, y = counted(monkeypatch, filter), np.arange(5.0), np.ones((5, 1))
    for value in (0.3, 2.0):
        bound = filter.bind(q=value)
        near(bound.run(times, y).cov, bound.run(times, y[..., None]).cov.reshape(5, 1, 1))
    filter.run(times, y)
    assert len(recorded) == 1
    twin = pickle.loads(pickle.dumps(filter.bind(q=2.0)))
    near(twin.run(times, y).cov, filter.bind(q=2.0).run(times, y).cov)
    assert len(recorded) == 2
    many = filter.bind(q=np.array([0.3, 2.0])).run(times, np.ones((5, 1, 2)))
    near(many.cov[..., 1], twin.run(times, y).cov)


def test_steps_of_many_records_record_nothing(monkeypatch):
    filter = extended_kalman(pendulum())
    monkeypatch.setattr(
        type(filter), "program", lambda *args, **options: pytest.fail("a batch recorded a program")
    )
    state = filter.step(filter.initial((3,)), 0.0, np.zeros((filter.system.sensor.size, 3)))
    assert np.isfinite(state.mean).all()


class Doubting(KalmanFilter):
    """It takes half of what the filter takes from a measurement."""

    def update(self, state, y, p, indicator=None):
        later = super().update(state, y, p)
        return later._replace(mean=(state.mean + later.mean) / 2)


def test_a_filter_with_steps_of_its_own_takes_them():
    filter, y = Doubting(LinearSystem(1, 1, 1, 1, 0, 1)), np.ones((2, 1))
    assert filter.run([0.0, 1.0], y).mean[0, 0] == pytest.approx(0.25)
    assert filter.step(filter.initial(), 0.0, [1.0]).mean[0] == pytest.approx(0.25)


def test_large_filters_stay_on_arrays_and_what_is_unknown_until_it_is_determined():
    n = 30
    rng, y = np.random.default_rng(0), np.ones((3, 2))
    H = rng.normal(size=(2, n))
    large = KalmanFilter(
        LinearSystem(0.1 * rng.normal(size=(n, n)), np.eye(n), H, np.eye(2), np.zeros(n), np.eye(n))
    )
    unknown = KalmanFilter(
        LinearSystem(
            np.eye(2), np.eye(2), np.eye(2), np.eye(2), [0, 0], np.zeros((2, 2)), diffuse=(0, 1)
        )
    )
    for filter in (large, unknown):
        assert uses_floats(filter) == (filter is unknown)
        near(
            filter.run(np.arange(3.0), y).mean,
            filter.run(np.arange(3.0), y[..., None]).mean[..., 0],
        )
