"""Filters in C against the same filters in Python, number for number."""

import subprocess
import sys
from functools import lru_cache

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import Continuous, Polynomial, affine_synthesis, grid_synthesis, synthesize
from seedslib.designed import Memory, finite_memory, large_order
from seedslib.designed.predictors import PolynomialFit, monomials, standardised
from seedslib.extra import to_c
from seedslib.filters import CovarianceFilter, KalmanFilter, assumed_density, extended_kalman
from seedslib.linearization import Cubature, ExactGaussian, Linearization, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, LinearSystem, Noise, StochasticMap

TIMES = 0.5 * np.arange(7)
PATHS = 200

x1, x2, v1, v2, w1, w2, t = sympy.symbols("x1 x2 v1 v2 w1 w2 t")


def same(found, wanted, terms=0.0):
    """Equal to 1e-14 of the largest value of each component, NaN where NaN is wanted.

    Or of the largest `terms` of the sums that gave the value, where they cancel.
    """
    lost = ~np.isfinite(wanted)
    assert np.array_equal(lost, ~np.isfinite(found))
    size = np.where(lost, 0.0, np.abs(wanted)).max(axis=(0, -1), keepdims=True)
    size = np.maximum(size, terms)
    apart = np.abs(np.where(lost, 0.0, found) - np.where(lost, 0.0, wanted))
    assert (apart <= 1e-14 * size).all(), (apart / np.where(size > 0, size, 1.0)).max()


def with_gaps(y, seed=0, whole=False):
    """A record in which measurements are missing, and single components unless `whole`."""
    rng = np.random.default_rng(seed)
    y = y.copy()
    if not whole:
        y[rng.random(y.shape) < 0.2] = np.nan
    y[np.broadcast_to(rng.random((len(y), 1, y.shape[2])) < 0.1, y.shape)] = np.nan
    assert np.isnan(y).all(axis=1).any()
    return y


def radar():
    """Range and bearing of a random walk, with a sensor whose noise grows in time."""
    return JumpDiffusion(
        state=(x1, x2), drift=[0, -x2 / 2], diffusion=[[0.3, 0], [0, 0.2]],
        sensor=[sympy.sqrt(x1**2 + x2**2) + v1 * sympy.exp(t / 5), sympy.atan2(x2, x1) + v2 / 9],
        noise=Noise((v1, v2), cov=0.01 * np.eye(2)), mean0=[3, 1], cov0=0.1 * np.eye(2), step=0.05,
    )  # fmt: skip


def chain():
    """Four states in a row in discrete time, three measured: too many for the library's lines."""
    s, w, v = sympy.symbols("s:4"), sympy.symbols("w:4"), sympy.symbols("v:3")
    moves = [0.8 * s[k] + 0.3 * sympy.sin(s[(k + 1) % 4] + t) + w[k] for k in range(4)]
    shows = [s[0] * s[1] + v[0], s[2] + v[1], sympy.cos(s[3]) + v[2] + v[0]]
    return DiscreteSystem(
        StochasticMap(s, moves, Noise(w, cov=0.1 * np.eye(4)), time=t),
        StochasticMap(s, shows, Noise(v, cov=0.2 * np.eye(3)), time=t),
        [1.0, 0.5, 0.0, -0.5], 0.3 * np.eye(4),
    )  # fmt: skip


DESIGNS = {
    "exact means": (zoo.van_der_pol, Memory(1), ExactGaussian(), {}),
    "Taylor, two estimates": (zoo.van_der_pol, Memory(2), Taylor(), {}),
    "cubic sensor": (lambda: zoo.van_der_pol("D"), Memory(1), ExactGaussian(), {}),
    "mixed memory, part of the state": (
        zoo.van_der_pol, Memory(2, 1), ExactGaussian(), {"components": 1},
    ),
    "measurements only": (zoo.van_der_pol, finite_memory(2), Taylor(), {}),
    "nodes that see the measurement": (
        zoo.van_der_pol, Memory(1), ExactGaussian(), {"measured_nodes": True},
    ),
    "horizon, jumps": (zoo.kicked_duffing, Memory(2), ExactGaussian(), {"horizon": 3.4}),
    "no nodes": (zoo.linear_gaussian, Memory(9), Taylor(), {"nodes": 0}),
    "polynomial": (zoo.van_der_pol, Memory(1), ExactGaussian(), {"predictor": Polynomial(3, 2)}),
    "polynomial, two estimates": (
        zoo.kicked_duffing, Memory(2), ExactGaussian(), {"predictor": Polynomial(2, 2)},
    ),
    "polynomial, one state": (
        zoo.flip_process, Memory(2), ExactGaussian(), {"predictor": Polynomial(3, 4)},
    ),
    "polynomial, constant covariance": (
        zoo.kicked_duffing, Memory(1), Taylor(), {"predictor": Polynomial(3, 0)},
    ),
    "continuous": (
        zoo.van_der_pol, Memory(1), ExactGaussian(), {"predictor": Continuous(), "step": 0.05},
    ),
    "continuous, horizon": (
        zoo.kicked_duffing, Memory(1), Taylor(),
        {"predictor": Continuous(), "step": 0.05, "horizon": 3.2},
    ),
    "range and bearing": (radar, Memory(2), Taylor(), {}),
    "discrete time, four states": (chain, Memory(1), ExactGaussian(), {}),
}  # fmt: skip


@lru_cache
def design(name):
    model, memory, rule, options = DESIGNS[name]
    return synthesize(model(), memory, rule, TIMES, paths=1000, seed=1, **options)


def cancelling(filter, mean):
    """Largest sum of absolute terms of the polynomial forecasts; extrapolated, they cancel."""
    found = 0.0
    for k, fit in enumerate(filter.fits):
        if isinstance(fit, PolynomialFit):
            u = np.concatenate(mean[max(0, k + 1 - filter.memory.estimates) : k + 1][::-1])
            powers = monomials(standardised(u, fit.centre, fit.scale), fit.mean_degree)
            found = max(found, (np.abs(fit.gain) @ np.abs(powers)).max())
    return found


def both_ways(filter, compiled, y, times=TIMES, **options):
    """Python and C on the same record: (mean, cov, loglik, node forecasts) of each."""
    nodes = np.concatenate([*filter.node_times, []])
    grid = np.union1d(times, nodes)
    full = np.full((len(grid), *y.shape[1:]), np.nan)
    tacts = np.searchsorted(grid, times)
    full[tacts] = y
    wanted = filter.run(grid, full, covariances=True)
    between = wanted.mean[np.searchsorted(grid, nodes)]
    loglik = None if wanted.loglik is None else wanted.loglik[tacts]
    return (wanted.mean[tacts], wanted.cov[tacts], loglik, between), compiled(
        filter, **options
    ).run(times, y)


@pytest.mark.parametrize("name", DESIGNS)
@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_designed_filters(name, compiled):
    filter = design(name)
    y = with_gaps(filter.system.simulate(TIMES, PATHS, 2).measurements)
    wanted, found = both_ways(filter, compiled, y)
    terms = cancelling(filter, wanted[0])
    same(found[0], wanted[0], terms)
    same(found[1].reshape(len(y), -1, PATHS), wanted[1].reshape(len(y), -1, PATHS), terms)
    same(found[2][:, None], wanted[2][:, None], terms)
    if len(wanted[3]):
        same(found[3], wanted[3], terms)


def test_one_path_step_by_step(compiled):
    filter = design("exact means")
    y = with_gaps(filter.system.simulate(TIMES, 40, 3).measurements)
    mean, cov, loglik, _ = compiled(filter).run(TIMES, y)
    for i in range(40):
        state = filter.initial()
        for k, moment in enumerate(TIMES):
            state = filter.step(state, moment, y[k, :, i])
            np.testing.assert_allclose(mean[k, :, i], state.mean, rtol=1e-14, atol=1e-14)
            np.testing.assert_allclose(cov[k, ..., i], state.cov, rtol=1e-14, atol=1e-14)
            np.testing.assert_allclose(loglik[k, i], state.loglik, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("horizon, jumps", "interpolated"), ("horizon, jumps", "piecewise constant"),
        ("horizon, jumps", "constant"), ("continuous, horizon", "interpolated"),
    ],
)  # fmt: skip
def test_forecasts_between_measurements(name, kind, compiled):
    filter = design(name).forecasting(kind)
    made = compiled(filter)
    y = filter.system.simulate(TIMES, 1, 4).measurements[..., 0]
    for steps in (1, 4, 7):
        state = filter.initial()
        for k in range(steps):
            state = filter.step(state, TIMES[k], y[k])
        end = TIMES[steps] if steps < 7 else filter.horizon
        for moment in np.linspace(TIMES[steps - 1], end, 9):
            wanted = filter.forecast(state, moment).mean
            np.testing.assert_allclose(made.forecast(y[:steps], moment), wanted, rtol=1e-13)
        assert made.forecast(y[:steps], end + 0.01) == 4
        assert made.forecast(y[:steps], TIMES[steps - 1] - 0.01) == 4


def still():
    """A number that does not move."""
    return JumpDiffusion(
        state=(x1,), drift=[0], diffusion=[[0]], sensor=[x1 + v1], noise=Noise((v1,)), mean0=[1],
        cov0=[[1]],
    )  # fmt: skip


def matrices(**options):
    """Two numbers of which one is seen, by matrices; one of them depends on time."""
    move = [[1.0, 0.5], [0.0, 0.9]]
    options = {"mean0": [1.0, 0.5], "cov0": np.eye(2), **options}
    return LinearSystem(
        move, [[0.0, 0.0], [0.0, 0.2]], [[1 + sympy.sin(sympy.Symbol("t")) / 2, 0.0]], [[0.3]],
        **options,
    )  # fmt: skip


CARRIED = {
    "EKF, Runge-Kutta": (zoo.van_der_pol, extended_kalman, {}),
    "EKF, Euler": (zoo.van_der_pol, extended_kalman, {"integrator": "euler", "step": 0.02}),
    "assumed density": (zoo.van_der_pol, assumed_density, {"step": 0.03}),
    "assumed density, jumps": (zoo.kicked_duffing, assumed_density, {"step": 0.02}),
    "linear": (zoo.linear_gaussian, extended_kalman, {}),
    "nothing moves": (still, extended_kalman, {"integrator": "euler"}),
    "range and bearing": (radar, extended_kalman, {}),
    "discrete time, four states": (chain, extended_kalman, {}),
}


@pytest.mark.parametrize("name", CARRIED)
def test_filters_that_carry_a_covariance(name, compiled):
    model, kind, options = CARRIED[name]
    filter = kind(model(), **options)
    y = with_gaps(filter.system.simulate(TIMES, PATHS, 2).measurements)
    wanted = filter.run(TIMES, y)
    mean, cov, loglik, _ = compiled(filter).run(TIMES, y)
    spread = wanted.cov if wanted.cov.ndim == 4 else wanted.cov[..., None] * np.ones(PATHS)
    same(mean, wanted.mean)
    same(cov.reshape(len(y), -1, PATHS), spread.reshape(len(y), -1, PATHS))
    same(loglik[:, None], wanted.loglik[:, None])


@pytest.mark.parametrize("memory", [large_order(1), large_order(2), finite_memory(1)])
@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_tables(memory, compiled):
    times = 0.25 * np.arange(4)
    filter = grid_synthesis(
        zoo.flip_process(), memory, times, x=(-3.5, 3.5, 101), z=(-2.5, 2.5, 13), y=(-8, 8, 49),
        nodes=2,
    )  # fmt: skip
    y = filter.system.simulate(times, PATHS, 2).measurements
    if memory.estimates:
        y = with_gaps(y, whole=True)
    y[1, 0, :2] = -9.0, 9.0  # beyond the ends
    wanted, found = both_ways(filter, compiled, y, times, more=["-O3"])
    same(found[0], wanted[0])
    cov = wanted[1].reshape(4, 1, 1, -1)  # without gaps it is common to all paths
    same(found[1][..., 0, :], np.broadcast_to(cov, (4, 1, 1, PATHS))[..., 0, :])
    assert np.isnan(found[2]).all()
    same(found[3], wanted[3])


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_affine_filter_by_grid(compiled):
    system = zoo.flip_process()
    filter, _ = affine_synthesis(
        system, large_order(1), Taylor(), TIMES[:3], x=(-3.5, 3.5, 81), z=(-3, 3, 41), y=(-8, 8, 61)
    )
    y = with_gaps(system.simulate(TIMES[:3], 50, 2).measurements)
    wanted, found = both_ways(filter, compiled, y, TIMES[:3])
    same(found[0], wanted[0])


def test_refused_steps(compiled):
    y = np.zeros((9, 2))
    filter = design("exact means")
    made = compiled(filter, "oscillator")
    assert (made.refused(y[:7]), made.refused(y[:8])) == (0, 1)
    y[3, 1] = np.inf
    assert made.refused(y[:7]) == 2
    carried = compiled(extended_kalman(zoo.van_der_pol()))
    assert carried.refused(y[:7], TIMES) == 2
    assert carried.refused(y[:3], [0.0, 0.5, 0.4]) == 4
    assert carried.refused(y[:3], [0.0, np.inf, 0.4]) == 4
    assert carried.refused(y[:3], [0.0, 0.5, 0.5]) == 0


def test_equal_filters_give_equal_text_in_any_process(tmp_path):
    text = to_c(assumed_density(zoo.kicked_duffing()), tmp_path / "a.h")
    assert (tmp_path / "a.h").read_text() == text
    code = (
        "import sympy; from seedslib.extra import to_c; from seedslib import zoo\n"
        "from seedslib.filters import assumed_density; [sympy.Dummy() for _ in range(2345)]\n"
        "print(to_c(assumed_density(zoo.kicked_duffing())), end='')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == text


def test_the_comment_says_what_the_filter_is():
    filter = design("exact means")
    text = to_c(filter, name="vdp")
    comment, code = text.split("*/", 1)
    assert text.isascii()
    assert f"{filter.predicted.rms[0, 0]:.4f} +- " in comment
    assert "ExactGaussian()" in comment
    assert "v1 + x1**2" in comment
    assert "-ffp-contract=off" in comment
    assert {line for line in code.splitlines() if line.startswith("#include")} == {
        "#include <math.h>", "#include <string.h>",
    }  # fmt: skip
    assert "#define VDP_MEMORY 2" in code


class Own(Linearization):
    """A rule of one's own, of which nothing is known but its numbers."""

    def moments(self, map, spread=True):
        return Cubature().moments(map, spread)


class Late(Memory):
    """A memory of one's own, which C would renew in its own way."""

    def push(self, past, *, estimate=None, **more):
        return super().push(past, estimate=None if estimate is None else estimate / 2, **more)


def test_what_has_no_c_is_refused_in_words():
    system = zoo.van_der_pol()
    with pytest.raises(TypeError, match="linearization: wanted formulas or a rule with points"):
        to_c(CovarianceFilter(system, Own()))
    with pytest.raises(ValueError, match="system: wanted a first state with a law"):
        to_c(KalmanFilter(matrices(diffuse=(0, 1), cov0=np.zeros((2, 2)))))
    moving = LinearSystem(lambda t: np.eye(2), np.eye(2), [[1, 0]], [[1]], [0, 0], np.eye(2))
    with pytest.raises(ValueError, match="system: wanted symbolic expressions"):
        to_c(KalmanFilter(moving))
    with pytest.raises(ValueError, match="integrator: wanted rk4 or euler"):
        to_c(extended_kalman(system, integrator="adaptive"))
    with pytest.raises(ValueError, match=r"between: .* got 'linear'"):
        to_c(design("exact means").forecasting("linear"))
    with pytest.raises(TypeError, match="filter: wanted a FiniteOrderFilter"):
        to_c(system)
    for name in ("2nd", "a-b", "", "a b"):
        with pytest.raises(ValueError, match="name"):
            to_c(extended_kalman(system), name=name)
    with pytest.raises(TypeError, match="name"):
        to_c(extended_kalman(system), name=3)
    one = synthesize(system, Memory(1), Taylor(), [0.0], paths=500, seed=1)
    with pytest.raises(TypeError, match="at least two measurements"):
        to_c(one)
    own = synthesize(system, Late(1), Taylor(), [0.0, 0.5], paths=500, seed=1)
    with pytest.raises(TypeError, match="memory: wanted a Memory, got Late"):
        to_c(own)
