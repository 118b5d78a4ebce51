"""Wrong systems, uneven steps, missing measurements and blind sensors get a sentence."""

import warnings

import numpy as np
import pytest
import sympy

from seedslib import delay, piecewise, zoo
from seedslib.base.checks import as_covariance
from seedslib.design import grid_synthesis, simulated_synthesis, synthesize, tabulated
from seedslib.designed import Memory, SwitchingFilter
from seedslib.evaluation import compare, evaluate
from seedslib.extra import learn
from seedslib.filters import (
    CovarianceFilter,
    GridBayesFilter,
    KnownModeFilter,
    ParticleFilter,
    RaoBlackwellFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    unscented_kalman,
)
from seedslib.gaussian import norm_mean
from seedslib.linearization import GaussHermite, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap
from seedslib.two_step import LinearDiffusion

x, v, w = sympy.symbols("x v w", real=True)
TIMES, FEW = np.arange(3.0), {"paths": 500, "seed": 1}


def walk(sensor=x + w, count=1, **options):
    shows = [sensor] if count == 1 else sensor
    return DiscreteSystem(
        StochasticMap((x,), [x / 2 + v], Noise((v,))), StochasticMap((x,), shows, Noise((w,))),
        [0.0], [[1.0]], **options,
    )  # fmt: skip


LINEAR = LinearDiffusion(-1, 0.5, 1, 0.1, 0, 4)


class Zero:
    """A regressor."""

    def fit(self, given, wanted):
        return self

    def predict(self, given):
        return np.zeros(len(given))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: extended_kalman(LINEAR), "system: .* got a LinearDiffusion; see two_step"),
        (lambda s: extended_kalman(s), "system: .* got a SwitchingSystem; see SwitchingFilter"),
        (lambda s: extended_kalman(DiscreteSystem), "system: .* got the class DiscreteSystem"),
        (lambda s: ParticleFilter(LINEAR), "system: wanted .* got a LinearDiffusion; see two_step"),
        (
            lambda s: ParticleFilter(piecewise.examples.falling_body(5)),
            "system: wanted .* got a PiecewiseLinearSystem; see piecewise",
        ),
        (
            lambda s: synthesize(
                delay.examples.precise_sensor(), Memory(1), Taylor(), TIMES, **FEW
            ),
            "system: wanted .* got a DelaySystem; see delay",
        ),
        (
            lambda s: synthesize(Memory(1), walk(), Taylor(), TIMES, **FEW),
            "system: wanted .* got a Memory; the system comes before",
        ),
        (
            lambda s: tabulated(SwitchingFilter(s, Taylor()), y=(-8, 8, 9), z=(-3, 3, 9)),
            "filter: wanted a FiniteOrderFilter, got a SwitchingFilter; .* grid_synthesis",
        ),
        (
            lambda s: learn(s, Memory(1), TIMES, regressor=Zero(), **FEW),
            "system: wanted a JumpDiffusion or DiscreteSystem, got a SwitchingSystem",
        ),
        (
            lambda s: grid_synthesis(LINEAR, Memory(1), TIMES, x=(-8, 8, 9)),
            "wanted a JumpDiffusion or DiscreteSystem or SwitchingSystem, got a LinearDiffusion",
        ),
        (lambda s: simulated_synthesis(LINEAR, Memory(1), TIMES, **FEW), "got a LinearDiffusion"),
        (lambda s: SwitchingFilter(walk(), Taylor()), "wanted a SwitchingSystem, got a Discrete"),
        (lambda s: RaoBlackwellFilter(walk()), "wanted a SwitchingSystem, got a DiscreteSystem"),
        (lambda s: KnownModeFilter(walk()), "wanted a SwitchingSystem, got a DiscreteSystem"),
        (lambda s: GridBayesFilter(LINEAR), "DiscreteSystem or SwitchingSystem, got a LinearD"),
        (lambda s: evaluate(walk(), extended_kalman(walk()), TIMES, 5, 1), "filter: wanted a fil"),
        (lambda s: compare({"a": 5}, walk(), TIMES, 5, 1), "a: wanted a filter .* got a int"),
        (lambda s: evaluate(extended_kalman(walk()), LINEAR, TIMES, 5, 1), "got a LinearDiffusion"),
    ],
)  # fmt: skip
def test_a_wrong_system_gets_a_sentence(call, message):
    with pytest.raises(TypeError, match=message):
        call(zoo.scalar_switching("A1H"))


@pytest.mark.parametrize(
    "call",
    [
        lambda t: extended_kalman(walk()).run(t, np.zeros((4, 1))),
        lambda t: ParticleFilter(walk(), 5).run(t, np.zeros((4, 1))),
        lambda t: walk().simulate(t, 5, 1),
        lambda t: synthesize(walk(), Memory(1), Taylor(), t, **FEW),
        lambda t: simulated_synthesis(walk(), Memory(1), t, **FEW),
        lambda t: learn(walk(), Memory(1), t, regressor=Zero(), **FEW),
        lambda t: zoo.scalar_switching().simulate(t, 5, 1),
        lambda t: SwitchingFilter(zoo.scalar_switching(), Taylor()).run(t, np.zeros((4, 1))),
        lambda t: GridBayesFilter(zoo.scalar_switching()).run(t, np.zeros((4, 1))),
        lambda t: KnownModeFilter(zoo.scalar_switching()).run(
            t, np.zeros((4, 1)), modes=np.zeros(4, int)
        ),
        lambda t: synthesize(zoo.scalar_switching(), Memory(1), Taylor(), t, **FEW),
        lambda t: grid_synthesis(zoo.scalar_switching(), Memory(1), t, x=(-8, 8, 9)),
    ],
)
def test_uneven_steps_of_a_system_in_discrete_time_are_refused(call):
    with pytest.raises(ValueError, match=r"times: wanted equal steps, .* write the missing times"):
        call([0.0, 1.0, 2.0, 5.0])


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: extended_kalman(walk()), {}),
        (lambda: ParticleFilter(walk(), 10), {}),
        (lambda: SwitchingFilter(zoo.scalar_switching(), Taylor()), {}),
        (lambda: GridBayesFilter(zoo.scalar_switching()), {}),
        (lambda: KnownModeFilter(zoo.scalar_switching()), {"mode": 0}),
        (lambda: RaoBlackwellFilter(zoo.manoeuvring_target("noisy")), {}),
    ],
)
def test_single_steps_refuse_the_gaps_that_a_run_refuses(make, told):
    made = make()
    y = np.zeros(made.system.measurement_size)
    shown = (0,) if made.system.indicators else ()
    state = made.initial()
    for t in (1.6e9, 1.6e9 + 0.1, 1.6e9 + 0.2):
        state = made.step(state, t, y, *shown, **told)
    with pytest.raises(ValueError, match=r"t: wanted equal steps, .* from 1600000000.2 on, 0.3"):
        made.predict(state, 1.6e9 + 0.5, *told.values())


def test_equal_steps_of_any_length_and_from_anywhere():
    y = np.zeros((4, 1))
    for start, step in ((0, 1), (0, 0.1), (7.3, 1e-3), (1.6e9, 0.01), (0, 1e6)):
        extended_kalman(walk()).run(start + step * np.arange(4), y)
    extended_kalman(zoo.van_der_pol()).run(
        [0, 0.1, 0.5, 0.6], np.zeros((4, 2))
    )  # a flow bridges any gap


def own(log_density):
    return StochasticMap.from_functions(
        1, 2, lambda t, x, v: np.concatenate([x, x]) + v, Noise(2), log_density=log_density
    )


def gauss(t, y, x):
    return (-0.5 * (y - x) ** 2 - 0.5 * np.log(2 * np.pi)).sum(axis=0)


def gauss_of_parts(t, y, x):
    return np.nansum(-0.5 * (y - x) ** 2 - 0.5 * np.log(2 * np.pi) * ~np.isnan(y), axis=0)


def test_a_given_log_density_where_measurements_are_missing():
    move = StochasticMap.from_functions(1, 1, lambda t, x, v: x / 2 + v, Noise(1))
    closed = StochasticMap((x,), [x + v, x + w], Noise((v, w)))
    y = np.array([[1.0, 0.5], [np.nan, np.nan], [2.0, 1.0]])
    part = np.where(np.arange(3)[:, None] + np.arange(2) == 1, np.nan, 1.0)

    def run(sensor, y):
        system = DiscreteSystem(move, sensor, [0.0], [[1.0]])
        return ParticleFilter(system, 500).run(TIMES, y, seed=1)

    wanted, found = run(closed, y), run(own(gauss), y)
    assert found.loglik[1] == 0.0
    assert not found.diverged
    np.testing.assert_allclose(found.loglik, wanted.loglik, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-12)
    with pytest.raises(ValueError, match="log_density: wanted numbers where a part"):
        run(own(gauss), part)
    np.testing.assert_allclose(
        run(own(gauss_of_parts), part).loglik, run(closed, part).loglik, rtol=1e-12
    )


COVARIANCE = [
    extended_kalman, unscented_kalman, cubature_kalman, assumed_density,
    lambda system: CovarianceFilter(system, GaussHermite(5)),
]  # fmt: skip


@pytest.mark.parametrize("make", COVARIANCE)
def test_a_sensor_that_no_estimate_hears_is_warned_of(make):
    with pytest.warns(UserWarning, match=r"sensor: y1 is uncorrelated .* log y\*\*2"):
        make(walk(sympy.exp(x / 2) * w))
    with pytest.warns(UserWarning, match="sensor: y2 is uncorrelated"):
        make(walk([x + w, w], 2))


@pytest.mark.parametrize("make", COVARIANCE)
@pytest.mark.parametrize(
    "sensor",
    [x**2 + w, sympy.cos(x) + w, x * (1 + w), 1e-9 * x + 1e3 * w, x**4 + w, (x - 1) ** 2 * x + w],
)
def test_sensors_that_are_flat_somewhere_are_not(make, sensor):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make(walk(sensor))


@pytest.mark.parametrize("cov", [np.diag([1e12, -1.0]), np.diag([1.0, -1e-300])])
def test_a_negative_variance_is_never_rounding(cov):
    two = {"mean0": [0, 0], "cov0": cov}
    a, b = sympy.symbols("a b")
    still = StochasticMap((a, b), [a, b])
    for call in (
        lambda: as_covariance("cov", cov),
        lambda: LinearDiffusion(-np.eye(2), np.zeros((2, 2)), np.eye(2), np.eye(2), **two),
        lambda: DiscreteSystem(still, still, **two),
        lambda: Noise((a, b), cov=cov),
        lambda: norm_mean(np.zeros((2, 3)), np.stack([cov] * 3, axis=-1)),
    ):
        with pytest.raises(ValueError, match=r"positive semidefinite matri.*, got variance"):
            call()


def test_correlations_are_looked_at_in_their_own_units():
    units = np.array([1e8, 1e-8])
    good, bad = (np.array([[1, r], [r, 1]]) * np.outer(units, units) for r in (0.999, 1.001))
    np.testing.assert_array_equal(as_covariance("cov", good, definite=True), good)
    with pytest.raises(ValueError, match=r"got eigenvalue -0\.001 when scaled to unit diagonal"):
        as_covariance("cov", bad)
    as_covariance("cov", np.ones((3, 3)) * np.outer([1e5, 1, 1e-5], [1e5, 1, 1e-5]))
