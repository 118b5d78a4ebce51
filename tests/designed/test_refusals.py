"""What filters refuse: arguments by their names, and parts that do not fit together."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import (
    BoundedPolynomial,
    Polynomial,
    grid_synthesis,
    minimax_synthesis,
    synthesize,
)
from seedslib.designed import (
    Memory,
    Past,
    SwitchingFilter,
    SwitchingRules,
    finite_memory,
    large_order,
    load,
    save,
)
from seedslib.filters import smooth
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

pytestmark = pytest.mark.filterwarnings(
    "ignore:paths. .* too few paths", "ignore:availability", "ignore:y. the axes miss"
)
x, y, v, w, p, q = sympy.symbols("x y v w p q", real=True)
TIMES, ONES = np.arange(3.0), np.ones((3, 1))


def pair():
    moved = [0.9 * x + 0.3 * y + v, -0.2 * x + 0.8 * y + w]
    return DiscreteSystem(
        StochasticMap([x, y], moved, Noise((v, w))),
        StochasticMap([x, y], [x + p, y + q], Noise((p, q))),
        [0.2, -0.3],
        np.eye(2),
    )


def affine(**options):
    return synthesize(
        zoo.linear_gaussian(),
        Memory(1),
        Taylor(),
        TIMES,
        nodes=1,
        paths=300,
        seed=1,
        step=0.25,
        **options,
    )


def modes(memory=None, **options):
    return synthesize(
        zoo.manoeuvring_target("noisy"),
        memory or Memory(2, 1, 1, True),
        Taylor(),
        TIMES,
        paths=3000,
        seed=1,
        **options,
    )


def tables(system, memory=None, **options):
    axes = {"x": (-8, 8, 41), "z": (-6, 6, 9), "y": (-16, 18, 31)}
    return grid_synthesis(system, memory or Memory(1), [0.0, 0.25, 0.5], **axes | options)


@pytest.fixture(scope="module")
def made():
    """A filter of each kind."""
    return SimpleNamespace(
        affine=affine(),
        modes=modes(),
        table=tables(zoo.flip_process()),
        mode_table=tables(zoo.dependent_switching(), Memory(1, 0, 1)),
        minimax=minimax(correction=BoundedPolynomial(2)),
    )


def minimax(**options):
    return minimax_synthesis(pair(), Memory(1), TIMES, paths=100, seed=1, **options)


def stepped(filter, count):
    state = filter.initial()
    for now in filter.times[:count]:
        state = filter.step(state, now, np.full(filter.system.measurement_size, 0.3))
    return state


def forecast(m):
    return m.affine.predict(m.affine.initial((3,)), 0.0)


def scheduled():
    return affine(measured=[[True], [False], [True]])


def bank(system=None, *memory, **options):
    return SwitchingFilter(system or TARGET, Taylor(), *memory, **options)


def corrected(indicator):
    """A correction of a bank by an indicator."""
    return bank().correct(bank().predict(bank().initial((2,)), 0.0), np.zeros((1, 2)), indicator)


def run(filter, **change):
    given = {"times": TIMES, "measurements": np.zeros((3, 1, 4)), "indicators": SHOWN}
    return filter.run(**given | change)


TARGET = zoo.manoeuvring_target("noisy")
SCALAR, STEADY, LOG_ODDS = zoo.scalar_switching(), zoo.steady_target(), Memory(1, log_odds=True)
SHOWN = np.zeros((3, 4), dtype=int)
REFUSED = [
    # memories
    *[
        (lambda _, call=call, l=l: call(l), error, "l")
        for call in (large_order, finite_memory)
        for l, error in ((0, ValueError), (-1, ValueError), (1.5, TypeError), (True, TypeError))
    ],
    (lambda _: Memory(), ValueError, "memory"),
    (lambda _: Memory(indicators=2), ValueError, "memory"),
    (lambda _: Memory(-1), ValueError, "estimates"),
    (lambda _: Memory(1, measurements=2.0), TypeError, "measurements"),
    (lambda _: Memory(1, indicators=-1), ValueError, "indicators"),
    (lambda _: Memory(1, log_odds=1), TypeError, "log_odds"),
    (lambda _: Memory(0, 1, log_odds=True), ValueError, "log_odds"),
    (lambda _: Memory(1).push(Past(), measurement=ONES), ValueError, "estimate"),
    (lambda _: Memory(1, 1).push(Past(), estimate=ONES), ValueError, "measurement"),
    (lambda _: Memory(1, 0, 1).push(Past(), estimate=ONES), ValueError, "indicator"),
    (lambda _: Memory(1, log_odds=True).push(Past(), estimate=ONES), ValueError, "log_odds"),
    (lambda _: Polynomial(0), ValueError, "mean_degree"),
    (lambda _: Polynomial(2, 0.5), TypeError, "cov_degree"),
    (lambda _: BoundedPolynomial(0), ValueError, "degree"),
    # filters of finite order: fields
    *[
        (lambda m, change=change: replace(m.affine, **change), error, next(iter(change)))
        for change, error in (
            ({"components": 0}, ValueError),
            ({"components": 3}, ValueError),
            ({"cycle": 3}, ValueError),
            ({"cycle": -1}, ValueError),
            ({"cycle": True}, ValueError),
            ({"between": "cubic"}, ValueError),
            ({"times": TIMES[::-1].copy()}, ValueError),
            ({"times": np.empty(0)}, ValueError),
            ({"fits": ()}, ValueError),
            ({"node_times": ()}, ValueError),
            ({"measured": ONES[:2] > 0}, ValueError),
            ({"measured": "all"}, ValueError),
            ({"availability": [1.5]}, ValueError),
        )
    ],
    (lambda m: m.affine.forecasting("cubic"), ValueError, "between"),
    # steps
    (lambda m: m.affine.correct(m.affine.initial(), [0.0]), ValueError, "state"),
    (lambda m: m.affine.expect(m.affine.initial()), ValueError, "state"),
    (lambda m: m.affine.predict(forecast(m), 1.0), ValueError, "state"),
    (lambda m: m.affine.forecast(forecast(m), 0.5), ValueError, "state"),
    (lambda m: m.affine.predict(m.affine.initial(), 0.5), ValueError, "t"),
    (lambda m: m.affine.predict(stepped(m.affine, 3), 3.0), ValueError, "t"),
    (lambda m: m.affine.forecast(stepped(m.affine, 2), 2.5), ValueError, "t"),
    (lambda m: m.affine.forecast(stepped(m.affine, 2), 0.5), ValueError, "t"),
    (lambda m: m.affine.forecast(stepped(m.affine, 2), 1.5, "x"), ValueError, "kind"),
    (lambda m: m.affine.correct(forecast(m), np.zeros((2, 3))), ValueError, "y"),
    (lambda m: m.affine.correct(forecast(m), [[0, np.inf, 0]]), ValueError, "y"),
    (lambda m: m.affine.correct(forecast(m), [["a", "b", "c"]]), TypeError, "y"),
    (lambda _: (f := scheduled()).correct(f.predict(stepped(f, 1), 1.0), [0.5]), ValueError, "y"),
    # records
    *[
        (
            lambda m, times=times: m.affine.run(times, np.full((len(times), 1), np.nan)),
            ValueError,
            "times",
        )
        for times in (TIMES[1:], TIMES + 0.25, [0, 2.0], [0, 1, 2, 3.5], [0, 0, 1])
    ],
    (lambda m: m.affine.run([0, 0.25, 1], np.zeros((3, 1))), ValueError, "measurements"),
    (lambda m: m.affine.run([0, 1], np.zeros((2, 3))), ValueError, "measurements"),
    (lambda m: m.affine.run([0, 1], [[np.inf], [0]]), ValueError, "measurements"),
    (lambda m: m.affine.run(TIMES, ONES, indicators=[0, 0, 0]), ValueError, "indicators"),
    (lambda _: scheduled().run(TIMES, ONES), ValueError, "measurements"),
    # filters of modes
    (lambda _: bank(zoo.flip_process()), TypeError, "system"),
    (lambda _: SwitchingFilter(TARGET, "taylor"), TypeError, "linearization"),
    (lambda _: bank(normalisation="other"), ValueError, "normalisation"),
    (lambda _: SwitchingRules(TARGET, Taylor(), "other"), ValueError, "normalisation"),
    (lambda _: bank(TARGET, "one"), TypeError, "memory"),
    (lambda _: bank(TARGET, Memory(1)), ValueError, "times"),
    (lambda _: bank(TARGET, Memory(1), times=TIMES), ValueError, "fits"),
    (lambda _: bank(SCALAR, Memory(1, 0, 1), times=TIMES, fits=[1, 2]), ValueError, "memory"),
    (lambda _: bank(STEADY, LOG_ODDS, times=TIMES, fits=[1, 2]), ValueError, "memory"),
    (lambda m: replace(m.modes, memory=Memory(1)), ValueError, "fits"),
    (lambda _: bank().predict(bank().step(bank().initial(), 1.0, [0.0], 1), 1.0), ValueError, "t"),
    (lambda _: bank().correct(bank().initial(), [0.0], 1), ValueError, "state"),
    (lambda _: bank().predict(bank().predict(bank().initial(), 0.0), 1.0), ValueError, "state"),
    (lambda _: corrected(None), ValueError, "indicator"),
    (lambda _: corrected(np.array([2, 0])), ValueError, "indicator"),
    (lambda _: corrected(np.array([0.5, 0.0])), TypeError, "indicator"),
    (lambda m: run(m.modes, indicators=None), ValueError, "indicators"),
    (lambda m: run(m.modes, indicators=SHOWN + 2), ValueError, "indicators"),
    (lambda m: run(m.modes, indicators=SHOWN + 0.5), TypeError, "indicators"),
    (lambda m: run(m.modes, indicators=SHOWN[:, :3]), ValueError, "indicators"),
    (lambda m: run(m.modes, indicators=SHOWN - 1), ValueError, "indicator"),
    (lambda m: run(m.modes, measurements=np.full((3, 1, 4), np.inf)), ValueError, "measurements"),
    (lambda m: run(m.modes, measurements=np.zeros((3, 2, 4))), ValueError, "measurements"),
    (lambda m: run(m.modes, times=[0.0, 2.0, 1.0]), ValueError, "times"),
    (lambda m: run(m.modes, times=[0.0, 1.0, 3.0]), ValueError, "times"),
    (lambda m: smooth(m.modes, TIMES, np.zeros((3, 1, 4)), indicators=SHOWN), TypeError, "filter"),
    # tables and other output functions
    (lambda m: m.table.correct(m.table.initial(), [0.0]), ValueError, "state"),
    (lambda m: m.table.predict(m.table.predict(m.table.initial(), 0.0), 0.25), ValueError, "state"),
    (lambda m: m.table.predict(m.table.initial(), 0.25), ValueError, "t"),
    (lambda m: m.table.predict(stepped(m.table, 3), 0.75), ValueError, "t"),
    (lambda m: m.table.forecast(stepped(m.table, 1), 0.3), ValueError, "t"),
    (lambda m: m.table.run([0, 0.5], np.zeros((2, 1))), ValueError, "times"),
    (
        lambda m: m.table.run([0, 0.25], np.zeros((2, 1)), indicators=[0, 0]),
        ValueError,
        "indicators",
    ),
    (
        lambda m: m.mode_table.run([0, 0.1, 0.25], np.full((3, 1), np.nan), indicators=[0, 0, 0]),
        ValueError,
        "times",
    ),
    (
        lambda m: m.mode_table.run([0, 0.25], np.zeros((2, 1)), indicators=[0, -1]),
        ValueError,
        "indicator",
    ),
    (lambda m: m.minimax.run([0.0], [[1.0, np.nan]]), ValueError, "y"),
    (
        lambda _: tables(zoo.flip_process(), Memory(0, 1)).run([0.0], [[np.nan]]),
        ValueError,
        "y",
    ),
    (lambda m: replace(m.table, steps=m.table.steps[:2]), ValueError, "steps"),
    (lambda m: replace(m.table, memory=Memory(2)), ValueError, "steps"),
    (lambda m: replace(m.mode_table, memory=Memory(1)), ValueError, "steps"),
    (lambda m: minimax(correction=3), TypeError, "correction"),
    (lambda m: minimax(prediction=3), TypeError, "prediction"),
    (lambda m: minimax(correction=lambda t, m, y: np.zeros(3)), ValueError, "correction"),
    (lambda m: minimax(prediction=lambda t, u: np.zeros((1, 3))), ValueError, "prediction"),
    # files
    (lambda _: save({}, "x.npz"), TypeError, "filter"),
    (lambda _: save(bank(), "x.npz"), TypeError, "filter"),
    (lambda _: load("x", None), TypeError, "system"),
    (lambda _: load("no such file.npz", zoo.flip_process()), FileNotFoundError, ""),
]


@pytest.mark.parametrize("number", range(len(REFUSED)))
def test_refusal_names_its_argument(made, number):
    call, error, argument = REFUSED[number]
    with pytest.raises(error) as caught:
        call(made)
    message = str(caught.value)
    assert message.startswith(argument), message
    if argument:
        assert message[len(argument)] in ":[.,", message
