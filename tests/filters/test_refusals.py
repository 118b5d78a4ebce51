"""What filters refuse: the type of the error, and the argument that it names first."""

import numpy as np
import pytest
import sympy as sp

from seedslib import zoo
from seedslib.base import Input
from seedslib.filters import (
    CovarianceFilter,
    Estimates,
    GridBayesFilter,
    KalmanFilter,
    KnownModeFilter,
    ParticleFilter,
    RaoBlackwellFilter,
    extended_kalman,
    smooth,
)
from seedslib.linearization import Taylor
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
)
from systems import U, growth, linear_system

x, v, w = sp.symbols("x v w")
LINE = LinearSystem(0.5, 1, 1, 1, 0, 1)
DRIVEN = LinearSystem(0.5, 1, 1, 1, 0, 1, b=U)
SQUARED = JumpDiffusion((x,), [0], [[1]], [x * v**2], Noise((v,)), [0], [[1]])
BANK = zoo.manoeuvring_target("noisy")
KALMAN, PARTICLES, KNOWN = KalmanFilter(LINE), ParticleFilter(LINE, 5), KnownModeFilter(BANK)
TWO, Y = [0.0, 1.0], np.zeros((2, 1))
ESTIMATES = Estimates(np.zeros((2, 1)), np.ones((2, 1, 1)))
SHOWN = np.zeros(2, int)
STATE = KALMAN.step(KALMAN.initial(), 0.0, [0.0])

TWICE, HALF = np.eye(2), [[1 / (1 + sp.exp(x)), 1 - 1 / (1 + sp.exp(x))]] * 2
UNIFORM = Noise((v,), cov=[[1 / 3]], sample=lambda rng, n: rng.uniform(-1, 1, (1, n)))


def switching(moves=x + v, shows=x + w, leave=((0.9, 0.1), (0.2, 0.8)), noise=None, **options):
    """Two modes of one distribution."""
    noise, sensor_noise = noise or Noise((v,)), Noise((w,))
    initial = [(0.5, [0], [[1]])] * 2
    return SwitchingSystem(
        (x,), [[moves]] * 2, noise, leave, [[shows]] * 2, sensor_noise, initial, **options
    )


def on_nodes(system, mean0=0, cov0=1, initial=None):
    """A run of the grid filter, of a system or of a map of the next state."""
    if isinstance(system, sp.Expr):
        maps = StochasticMap([x], [system], Noise([v])), StochasticMap([x], [x + w], Noise([w]))
        system = DiscreteSystem(*maps, mean0, cov0, initial)
    axes = [(-5, 5, 11)] * system.state_size if system.state_size > 1 else (-5, 5, 11)
    return GridBayesFilter(system, axes).run(TWO, np.zeros((2, system.measurement_size)))


def known(**options):
    return KNOWN.run(TWO, Y, **{"indicators": SHOWN, "modes": SHOWN} | options)


ROWS = [
    (lambda: CovarianceFilter(BANK, Taylor()), TypeError, "system"),
    (lambda: CovarianceFilter(LINE, "ekf"), TypeError, "linearization"),
    (lambda: extended_kalman(growth(), integrator="heun"), ValueError, "integrator"),
    (lambda: extended_kalman(growth(), step=0.0), ValueError, "step"),
    (lambda: extended_kalman(growth(), bound=-1), ValueError, "bound"),
    (lambda: KalmanFilter(growth()), TypeError, "system"),
    (lambda: ParticleFilter(object()), TypeError, "system"),
    (lambda: ParticleFilter(SQUARED), ValueError, "system"),
    (lambda: ParticleFilter(LINE, 0), ValueError, "particles"),
    (lambda: RaoBlackwellFilter(growth()), TypeError, "system"),
    (lambda: RaoBlackwellFilter(BANK, 0), ValueError, "particles"),
    (lambda: RaoBlackwellFilter(switching(sp.sin(x) + v)), ValueError, "dynamics"),
    (lambda: RaoBlackwellFilter(switching(x * v)), ValueError, "dynamics"),
    (lambda: RaoBlackwellFilter(switching(noise=UNIFORM)), ValueError, "dynamics"),
    (lambda: RaoBlackwellFilter(switching(shows=x**2 + w)), ValueError, "sensor"),
    (lambda: RaoBlackwellFilter(switching(shows=x * w)), ValueError, "sensor"),
    (lambda: RaoBlackwellFilter(switching(leave=HALF)), ValueError, "switching"),
    (lambda: RaoBlackwellFilter(switching(indicator=HALF)), ValueError, "indicator"),
    (lambda: extended_kalman(linear_system(diffuse=(0,))), ValueError, "system"),
    (lambda: KnownModeFilter(LINE), TypeError, "system"),
    (lambda: KnownModeFilter(BANK, 5), TypeError, "linearization"),
    (lambda: GridBayesFilter(zoo.flip_process()), TypeError, "system"),
    (lambda: GridBayesFilter(LINE, (0, 1)), TypeError, "x"),
    (lambda: GridBayesFilter(BANK), ValueError, "system"),
    (lambda: on_nodes(LinearSystem(1, 0, 1, 1, 0, 1)), ValueError, "dynamics"),
    (lambda: on_nodes(x + v**2), ValueError, "dynamics"),
    (lambda: on_nodes(x + v, initial=lambda rng, n: rng.random((1, n))), ValueError, "system"),
    (lambda: on_nodes(LinearSystem(1, 1, 1, 1, 0, 0, diffuse=(0,))), ValueError, "system"),
    (lambda: on_nodes(LinearSystem(*[np.eye(3)] * 4, [0] * 3, np.eye(3))), ValueError, "system"),
    (
        lambda: on_nodes(LinearSystem(TWICE, TWICE, TWICE, TWICE, [0, 0], np.diag([1, 0]))),
        ValueError,
        "cov0",
    ),
    # records
    (lambda: KALMAN.run([0.0, 0.0], Y), ValueError, "times"),
    (lambda: KALMAN.run(np.array(["2026-01-01"], "datetime64[h]"), Y[:1]), TypeError, "times"),
    (lambda: KALMAN.run(TWO, np.zeros((3, 1))), ValueError, "measurements"),
    (lambda: KALMAN.run(TWO, np.zeros((2, 2))), ValueError, "measurements"),
    (lambda: KALMAN.run(TWO, np.zeros(2)), ValueError, "measurements"),
    (lambda: KALMAN.run(TWO, [[0.0], [np.inf]]), ValueError, "measurements"),
    (lambda: KALMAN.run(TWO, [[np.inf], [-np.inf]]), ValueError, "measurements"),
    (lambda: KALMAN.run(TWO, [["a"], ["b"]]), TypeError, "measurements"),
    (lambda: KALMAN.run(TWO, np.ma.masked_equal([[0.0], [9.0]], 9)), TypeError, "measurements"),
    (lambda: KALMAN.run(TWO, [[0.0], [0.0, 1.0]]), (TypeError, ValueError), "measurements"),
    (lambda: KALMAN.run(TWO, Y, modes=SHOWN), ValueError, "modes"),
    (lambda: KALMAN.run(TWO, Y, indicators=SHOWN), ValueError, "indicators"),
    (lambda: KALMAN.run(TWO, Y, workers=0), ValueError, "workers"),
    (lambda: KALMAN.block(np.arange(3.0), 10, 1.5), TypeError, "workers"),
    (lambda: known(indicators=None), ValueError, "indicators"),
    (lambda: known(indicators=[0, 2]), ValueError, "indicators"),
    (lambda: known(indicators=[-2, 0]), ValueError, "indicators"),
    (lambda: known(indicators=np.zeros((2, 2), int)), ValueError, "indicators"),
    (lambda: known(indicators=[0.5, 0.0]), TypeError, "indicators"),
    (lambda: known(modes=None), ValueError, "modes"),
    (lambda: known(modes=[0, 2]), ValueError, "modes"),
    (lambda: known(modes=[0, -1]), ValueError, "modes"),
    (lambda: known(modes=[0.0, 1.5]), TypeError, "modes"),
    (lambda: known(modes=np.zeros((2, 2), int)), ValueError, "modes"),
    # inputs
    (lambda: KalmanFilter(DRIVEN).run(TWO, Y), ValueError, "inputs"),
    (lambda: KalmanFilter(DRIVEN).run(TWO, Y, inputs={Input("q"): TWO}), ValueError, "inputs"),
    (lambda: KalmanFilter(DRIVEN).run(TWO, Y, inputs={U: [1.0]}), ValueError, "inputs"),
    (lambda: KalmanFilter(DRIVEN).run(TWO, Y, inputs={U: [np.nan, 0]}), ValueError, "inputs"),
    (lambda: KalmanFilter(DRIVEN).run(TWO, Y, inputs=[TWO]), TypeError, "inputs"),
    (lambda: KalmanFilter(DRIVEN).step(STATE, 1.0, [0.0]), ValueError, "u"),
    # steps
    (lambda: KALMAN.correct(KALMAN.initial(), [0.0]), ValueError, "state"),
    (lambda: PARTICLES.correct(PARTICLES.initial(), [0.0]), ValueError, "state"),
    (lambda: KNOWN.correct(KNOWN.initial(), [0.0], 0), ValueError, "state"),
    (lambda: KALMAN.predict(STATE, -0.5), ValueError, "t"),
    (lambda: KALMAN.step(STATE, 1.0, np.zeros((9, 2))), ValueError, "y"),
    (lambda: KNOWN.predict(KNOWN.predict(KNOWN.initial(), 0.0), 1.0), ValueError, "mode"),
    (lambda: KNOWN.initial((2,), mode=[0, 2]), ValueError, "mode"),
    (lambda: KNOWN.correct(KNOWN.predict(KNOWN.initial(), 0.0), [0.0]), ValueError, "indicator"),
    # smoothing
    (lambda: smooth("kalman", TWO, Y), TypeError, "filter"),
    (lambda: smooth(RaoBlackwellFilter(BANK), TWO, Y), TypeError, "filter"),
    (lambda: smooth(KALMAN, TWO, Y, lag=0), ValueError, "lag"),
    (lambda: smooth(PARTICLES, TWO, Y), TypeError, "filter"),
    (lambda: smooth(KNOWN, TWO, Y), TypeError, "filter"),
    (lambda: smooth(KALMAN, TWO, np.zeros((3, 1))), ValueError, "measurements"),
    # estimates
    (lambda: ESTIMATES.interval(95), ValueError, "level"),
    (lambda: ESTIMATES.interval(0.0), ValueError, "level"),
    (lambda: ESTIMATES.interval("95%"), ValueError, "level"),
    (lambda: KALMAN.correct(STATE, "a"), TypeError, "y"),
    (lambda: KALMAN.smooth(TWO, Y), AttributeError, "smooth"),
    (lambda: Estimates(np.zeros((3, 1))).interval(), ValueError, "interval"),
    (lambda: ESTIMATES.to_dataframe([0, 1, 2]), ValueError, "times"),
    (lambda: ESTIMATES.to_dataframe([0, 1], ["a", "b"]), ValueError, "names"),
]


@pytest.mark.filterwarnings("ignore:x. more than")
@pytest.mark.parametrize(("call", "error", "name"), ROWS)
def test_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=rf"^{name}\b"):
        call()
