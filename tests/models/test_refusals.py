"""What models refuse, by type of error and by the name of the argument; files and wrong systems."""

import copy
import pickle

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base import ELAPSED, Input, Parameter
from seedslib.filters import extended_kalman
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    PlaneChain,
    StochasticMap,
    SwitchingSystem,
    grid_chain,
    level,
    regression,
    season,
    van_loan,
)
from seedslib.two_step import LinearDiffusion
from systems import continuous_system, linear_system, switching_system

x, y, v, w, s = sympy.symbols("x y v w s")
MOVE = StochasticMap((x,), [x / 2 + v], Noise((v,)))
SHOWN = StochasticMap((x,), [x + w], Noise((w,)))
BOUNDED = StochasticMap((x,), [x * w**2], Noise((w,)))
COV, AXIS = np.eye(2), (-3, 3, 9)
q = Parameter("q", 1.0)


def sampled(rng, count):
    return rng.uniform(-1, 1, (1, count))


def map_of(state=(x,), value=(x,), *noise, **options):
    return StochasticMap(state, value, *noise, **options)


def functions(**options):
    return StochasticMap.from_functions(1, 1, lambda t, x, v: x + v, Noise(1), **options)


def steps(dynamics=MOVE, sensor=SHOWN, mean0=0, cov0=1, **options):
    return DiscreteSystem(dynamics, sensor, mean0, cov0, **options)


def linear(**changes):
    given = {"F": COV, "Q": COV, "H": [[1.0, 0.5]], "R": 0.4, "mean0": [1.0, -1.0], "cov0": COV}
    return LinearSystem(**given | changes)


def continuous(drift=-1, step=1.0):
    return LinearSystem.from_continuous(drift, 1, 1, 1, 0, 1, step=step)


def flow(state=(x,), drift=None, diffusion=((1,),), sensor=None, **options):
    given = {"mean0": [0.0] * len(state), "cov0": np.eye(len(state))} | options
    drift = [-each for each in state] if drift is None else drift
    return JumpDiffusion(state, drift, diffusion, sensor or [state[0] + v], Noise((v,)), **given)


def modes(**changes):
    given = {
        "state": (x,),
        "dynamics": [[x / 2 + v], [x + v]],
        "noise": Noise((v,)),
        "switching": [[0.9, 0.1], [0.3, 0.7]],
        "sensor": [[x + w], [2 * x + w]],
        "sensor_noise": Noise((w,)),
        "initial": [(0.5, [0], [[1]]), (0.5, [1], [[2]])],
    }
    return SwitchingSystem(**given | changes)


def of_maps(moves=(MOVE,), switching=((1,),), sensors=(SHOWN,), **options):
    return SwitchingSystem.from_maps(moves, switching, sensors, [(1, [0], [[1]])], **options)


def starts(*probabilities, cov=1):
    return {"initial": [(p, [0], [[cov]]) for p in probabilities]}


def logistic():
    return [[1 / (1 + sympy.exp(-v)), 1 / (1 + sympy.exp(v))]] * 2


def simulated(system=None, times=(0.0, 1.0), paths=2, seed=0, **options):
    return (system or zoo.linear_gaussian()).simulate(times, paths, seed, **options)


def feller(**options):
    return grid_chain(flow(**options), AXIS).transition(0, 1)


ROWS = [
    (lambda: Noise((v,), cov=[[-1.0]]), ValueError, "cov"),
    (lambda: Noise((v,), mean=[0.0, 1.0]), ValueError, "mean"),
    (lambda: Noise((v, v)), ValueError, "symbols"),
    (lambda: Noise((v,), sample=3), TypeError, "sample"),
    (lambda: Noise((v,), log_density=abs), TypeError, "log_density"),
    (lambda: map_of(value=[x + y]), ValueError, "expressions"),
    (lambda: map_of(value=[[x]]), ValueError, "value"),
    (lambda: map_of((x,), [x], Noise(1)), ValueError, "noise"),
    (lambda: map_of((x, v), [x], Noise((v,))), ValueError, "state, noise"),
    (lambda: map_of(period={1: 2.0}), ValueError, "period"),
    (lambda: functions(mean=lambda t, x: x), ValueError, "mean, cov"),
    (lambda: functions(parameters=(x,)), TypeError, "parameters"),
    (lambda: functions().value(0, np.ones((2, 3)), 0), ValueError, "value"),
    (lambda: BOUNDED.log_density(0, np.zeros((1, 1)), np.zeros((1, 1))), ValueError, "log_density"),
    (lambda: extended_kalman(steps(map_of(value=[sympy.sign(x)]))), ValueError, "expressions"),
    (lambda: steps(sensor=map_of((x, y))), ValueError, "dynamics, sensor"),
    (lambda: steps(map_of((w,), [w])), ValueError, "state, noise"),
    (lambda: steps(cov0=-1), ValueError, "cov0"),
    (lambda: linear(F=[[1.0]]), ValueError, "F"),
    (lambda: linear(Q=[[1.0, 2.0], [2.0, 1.0]]), ValueError, "Q"),
    (lambda: linear(F=[[s, 0], [0, 1]]), ValueError, "F"),
    (lambda: linear(diffuse=(2,)), ValueError, "diffuse"),
    (lambda: linear(diffuse=(0,)), ValueError, "cov0"),
    (lambda: simulated(linear(cov0=0 * COV, diffuse=(0, 1))), ValueError, "diffuse"),
    (lambda: extended_kalman(linear(cov0=0 * COV, diffuse=(0,))), ValueError, "system"),
    (lambda: linear(b=[1.0]), ValueError, "b"),
    (lambda: linear(mean0=[s, 0]), ValueError, "mean0"),
    (lambda: linear(cov0=[[q, 0], [0, Input("u")]]), ValueError, "mean0, cov0"),
    (lambda: linear(cov0=[[-q, 0], [0, 1]]), ValueError, "cov0"),
    (lambda: steps(cov0=q, initial=sampled), ValueError, "initial"),
    (lambda: steps(cov0=q).bind(q=[1, 2]).initial_sample(0, 2), ValueError, "mean0, cov0"),
    (lambda: continuous(q * sympy.Symbol("t")), ValueError, "drift"),
    (lambda: continuous(q * ELAPSED), ValueError, "drift"),
    (lambda: continuous(lambda t: -1), ValueError, "drift"),
    (lambda: linear(R=None), TypeError, "R"),
    (lambda: steps([x + v]), TypeError, "dynamics"),
    (lambda: steps(sensor=None), TypeError, "sensor"),
    (lambda: linear(d=x), ValueError, "d"),
    (lambda: level(1) + linear(), TypeError, r"\+"),
    (lambda: season(1, 0.1), ValueError, "period"),
    (lambda: regression(), ValueError, "inputs"),
    (lambda: level(s), ValueError, "Q"),
    (lambda: continuous(step=0.0), ValueError, "step"),
    (lambda: continuous([[1, 0]]), ValueError, "drift"),
    (lambda: van_loan([[-1.0]], [[-1.0]], 0.5), ValueError, "diffusion"),
    (lambda: van_loan([[-1.0]], [[1.0]], -0.5), ValueError, "step"),
    (lambda: van_loan([[800.0]], [[1.0]], 5.0), ValueError, "times"),
    (lambda: flow(drift=[s * x]), ValueError, "drift"),
    (lambda: flow((x, y), drift=[x]), ValueError, "drift"),
    (lambda: flow(diffusion=[1]), ValueError, "diffusion"),
    (lambda: flow(intensity=1), ValueError, "jump, intensity"),
    (lambda: flow(intensity=1, jump=[x, x]), ValueError, "jump"),
    (lambda: flow(mean0=[0, 0]), ValueError, "mean0"),
    (lambda: flow(step=0), ValueError, "step"),
    (lambda: flow(parameters={x: 5}), ValueError, "state, parameters"),
    (lambda: flow(time=x), ValueError, "state, time"),
    (lambda: flow().advance(np.ones((1, 2)), 1, 1, np.random.default_rng(0)), ValueError, "stop"),
    (lambda: modes(switching=[[0.9, 0.2], [0.3, 0.7]]), ValueError, "switching of mode 0"),
    (lambda: modes(switching=[[1 - x**2, x**2], [0, 1]]), ValueError, "switching of mode 0"),
    (lambda: modes(switching=logistic(), drives="new"), ValueError, "switching of mode 0"),
    (lambda: modes(indicator=[[0.5, 0.4], [0.5, 0.5]]), ValueError, "indicator of mode 0"),
    (lambda: modes(indicator=object()), TypeError, "indicator"),
    (lambda: modes(**starts(0.5, 0.6)), ValueError, "initial"),
    (lambda: modes(**starts(0.5, 0.5, cov=-1)), ValueError, r"initial\[0\] cov"),
    (lambda: modes(sensor=[[x + w]]), ValueError, "sensor"),
    (lambda: modes(drives="both"), ValueError, "drives"),
    (lambda: of_maps([None]), TypeError, "dynamics"),
    (lambda: of_maps([functions()] * 2), TypeError, "dynamics"),
    (lambda: of_maps([MOVE, SHOWN.with_weight(1), map_of((x, y))]), ValueError, "dynamics"),
    (lambda: of_maps([MOVE] * 2), ValueError, "sensors"),
    (lambda: of_maps(switching=[[0.5, 0.5]]), ValueError, "switching"),
    (lambda: of_maps(indicator=[[0.5, 0.4]]), ValueError, "indicator of mode 0"),
    (lambda: simulated(times=[0.0, 0.0]), ValueError, "times"),
    (lambda: simulated(paths=0), ValueError, "paths"),
    (lambda: simulated(seed=None), TypeError, "seed"),
    (lambda: simulated(workers=0), ValueError, "workers"),
    (lambda: simulated(step=-1.0), ValueError, "step"),
    (lambda: simulated(scheme="milstein"), ValueError, "scheme"),
    (lambda: simulated(measured=[2]), ValueError, "measured"),
    (lambda: simulated(measured=np.ones((2, 1), int)), ValueError, "measured"),
    (lambda: simulated(availability=1.5), ValueError, "availability"),
    (lambda: simulated(linear_system("functions")), ValueError, "inputs"),
    (lambda: simulated(inputs={x: [0.0, 1.0]}), TypeError, "inputs"),
    (lambda: simulated(modes(), modes=[0, 2]), ValueError, "modes"),
    (lambda: simulated(zoo.dependent_switching(), modes=[0, 0]), ValueError, "modes"),
    (lambda: grid_chain(zoo.van_der_pol(), AXIS), ValueError, "axes"),
    (lambda: grid_chain(switching_system(), AXIS), ValueError, "system"),
    (lambda: feller(sensor=[x * v**2]), ValueError, "sensor"),
    (lambda: feller(intensity=x, jump=[1]), ValueError, "intensity"),
    (lambda: feller(intensity=1, jump=[w], marks=Noise((w,), sample=sampled)), ValueError, "jump"),
    (lambda: grid_chain(flow(initial=sampled), AXIS).initial, ValueError, "system"),
    (lambda: grid_chain(flow(), AXIS).transition(1, 1), ValueError, "stop"),
    (lambda: grid_chain(steps(sensor=BOUNDED), AXIS), ValueError, "sensor"),
    (lambda: grid_chain(steps(map_of()), AXIS).transition(0, 1), ValueError, "dynamics"),
    (lambda: grid_chain(steps(initial=sampled), AXIS), ValueError, "system"),
    (lambda: grid_chain(zoo.manoeuvring_target(), AXIS), ValueError, "axes"),
    (lambda: grid_chain(modes(sensor=[[x * w**2]] * 2), AXIS), ValueError, "sensor"),
    (
        lambda: grid_chain(zoo.dependent_switching(), (-9, 9, 5)).transition(0, 1),
        ValueError,
        "x",
    ),
    (lambda: PlaneChain(zoo.kicked_duffing(), [AXIS] * 2), ValueError, "system"),
    (lambda: PlaneChain(flow((x, y), diffusion=[[1], [1]]), [AXIS] * 2), ValueError, "system"),
    (lambda: extended_kalman(LinearDiffusion(-1, 0.5, 1, 0.1, 0, 4)), TypeError, "system"),
    (lambda: extended_kalman(modes()), TypeError, "system"),
]


@pytest.mark.parametrize(("call", "error", "name"), ROWS)
def test_wrong_arguments_are_refused_by_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()


@pytest.mark.parametrize(
    "make",
    [
        lambda: steps(mean0=0.5),
        continuous_system,
        switching_system,
        linear_system,
        lambda: grid_chain(zoo.flip_process(), AXIS),
        lambda: grid_chain(zoo.scalar_switching(), (-8, 8, 31)),
        lambda: grid_chain(steps(), AXIS),
    ],
)
def test_models_travel_and_show_themselves(make):
    """A copy and a pickle are the same model: equal bits of its paths or of its transition."""
    model = make()
    for other in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model)):
        assert type(other) is type(model)
        assert repr(other) == repr(model)
        if hasattr(model, "simulate"):
            times = [1.5, 2.5]
            inputs = {u: [0.3, 0.1] for u in model.parameters if u.role == "input"}
            one, two = (each.simulate(times, 5, 3, inputs=inputs).states for each in (model, other))
        else:
            one, two = (each.transition(0.0, 1.0) for each in (model, other))
        np.testing.assert_array_equal(one, two)
    assert "object at 0x" not in repr(model)


def test_a_lambda_does_not_travel():
    with pytest.raises((AttributeError, pickle.PicklingError)):
        pickle.dumps(functions())
