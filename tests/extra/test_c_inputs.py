"""Filters of models that are told inputs, or how long a step is, in C."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest
import sympy

from seedslib.base.parameters import ELAPSED, Input
from seedslib.base.values import assigned
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.extra import compiled as compiled_twin
from seedslib.extra import to_c, to_js
from seedslib.extra.c.build import compiler
from seedslib.filters import (
    CovarianceFilter,
    KalmanFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    unscented_kalman,
)
from seedslib.linearization import GaussHermite, Taylor
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
)

a, b, v, w = sympy.symbols("a b v w", real=True)
FORCE, BIAS = Input("force"), Input("bias")
TIMES = np.array([0.0, 0.5, 0.7, 1.5, 2.5, 2.75])

RUN = """
#include "made.h"
int record(int whole, int count, const double *t, const double *y, const double *u, double *mean,
           double *cov, double *loglik)
{
    made_state s;
    int k, code;
    made_init(&s);
    for (k = 0; k < count; k++) {
        const double *now = u + k * MADE_INPUTS, *before = k > 0 ? now - MADE_INPUTS : now;
        if (whole) {
            code = made_step(&s, t[k], y + k * MADE_MEASUREMENT, now);
        } else {
            code = made_predict(&s, t[k], before);
            if (code == MADE_OK) code = made_correct(&s, y + k * MADE_MEASUREMENT, now);
        }
        if (code != MADE_OK) return code;
        memcpy(mean + k * MADE_STATE, s.mean, sizeof s.mean);
        memcpy(cov + k * MADE_STATE * MADE_STATE, s.cov, sizeof s.cov);
        loglik[k] = s.loglik;
    }
    return MADE_OK;
}
int untold(void);
int untold(void)
{
    const double y[MADE_MEASUREMENT] = { 0.0 };
    made_state s;
    made_init(&s);
    return made_step(&s, 0.0, y, NULL);
}
"""


def steered(bent=False):
    """A cart that is pushed by a known force, with a sensor whose bias is told."""
    noise = FORCE * v + v**2 / 9 if bent else (1 + FORCE**2) * v / 5
    moves = StochasticMap(
        (a, b), [a + ELAPSED * b, 0.9 * b + ELAPSED * FORCE + noise], Noise((v,), cov=[[0.1]])
    )
    shows = StochasticMap(
        (a, b), [a + a**2 / 9 + BIAS + w, sympy.sin(b) + w * BIAS / 2], Noise((w,))
    )
    return DiscreteSystem(moves, shows, [0.5, 1.0], 0.3 * np.eye(2))


def pushed():
    return JumpDiffusion(
        (a, b), [b, FORCE - sympy.sin(a)], [[0], [0.3 + FORCE / 9]], [a + BIAS + w], Noise((w,)),
        [0.5, 0.0], 0.2 * np.eye(2), step=0.1,
    )  # fmt: skip


def matrices():
    """By matrices: the inputs push the state and the measurement."""
    return LinearSystem(
        [[1.0, 0.3], [0.0, 0.9]], 0.1 * np.eye(2), [[1.0, 0.2]], [[0.3]], [0.0, 1.0],
        np.eye(2), B=[[0.0, 0.0], [0.0, 1.0]], D=[[1.0, 0.0]], inputs=(BIAS, FORCE),
    )  # fmt: skip


def entries():
    """By matrices with expressions for entries: the elapsed time, the time, an input."""
    return LinearSystem(
        [[1.0, ELAPSED], [0.0, sympy.exp(-ELAPSED)]],
        [[ELAPSED**3 / 3, ELAPSED**2 / 2], [ELAPSED**2 / 2, ELAPSED]],
        [[1.0, sympy.sin(sympy.Symbol("t")) + BIAS]], [[0.3 + BIAS**2]], [0.0, 1.0], np.eye(2),
        B=[[0.0], [ELAPSED]], inputs=(FORCE,),
    )  # fmt: skip


FILTERS = {
    "Kalman, entries by formulas": lambda: KalmanFilter(entries()),
    "Kalman": lambda: KalmanFilter(matrices()),
    "extended": lambda: extended_kalman(steered()),
    "unscented": lambda: unscented_kalman(steered()),
    "points that cover the noise": lambda: cubature_kalman(steered(bent=True)),
    "in loops": lambda: CovarianceFilter(steered(), GaussHermite(7)),
    "assumed density, in continuous time": lambda: assumed_density(pushed()),
    "unscented, in continuous time": lambda: unscented_kalman(pushed(), integrator="euler"),
}  # fmt: skip


def made(build, folder, filter):
    to_c(filter, folder / "made.h", name="made")
    head, _, rest = RUN.partition("int record")
    declared = "int record(int whole, int count, const double *t, const double *y, "
    declared += "const double *u, double *mean,\n double *cov, double *loglik);\nint record"
    return ctypes.CDLL(str(build(folder, head + declared + rest, more=["-Wshadow"])))


def run(library, filter, times, y, u, whole=False):
    """Code, means, covariances and likelihoods of one record."""
    n = filter.n
    given = [np.ascontiguousarray(part, dtype=float) for part in (times, y, u)]
    found = [np.empty((len(y), *size)) for size in ((n,), (n, n), ())]
    places = [part.ctypes.data_as(ctypes.c_void_p) for part in (*given, *found)]
    return library.record(int(whole), len(y), *places), *found


def times_of(filter):
    """Evenly spaced ones for what moves by steps of one length."""
    even = not filter.continuous and ELAPSED not in filter.system.mentions
    return np.arange(float(len(TIMES))) if even else TIMES


@pytest.mark.parametrize("name", FILTERS)
def test_they_are_the_filters_of_python(name, build, tmp_path):
    filter = FILTERS[name]()
    rng = np.random.default_rng(0)
    u = rng.normal(size=(len(TIMES), 2))  # bias and force, in the order of their names
    told = {BIAS: u[:, 0], FORCE: u[:, 1]}
    y = rng.normal(size=(len(TIMES), filter.system.measurement_size))
    y[2] = np.nan
    y[4, 0] = np.nan
    times = times_of(filter)
    wanted = filter.run(times, y, inputs=told)
    library = made(build, tmp_path, filter)
    code, *found = run(library, filter, times, y, u)
    assert code == 0
    for one, other in zip(found, (wanted.mean, wanted.cov, wanted.loglik), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-12)
    # one block around the whole step
    state = filter.initial()
    _, mean, *_ = run(library, filter, times, y, u, whole=True)
    for k, t in enumerate(times):
        with assigned({p: x[k] for p, x in told.items()}):
            state = filter.step(state, t, y[k])
        np.testing.assert_allclose(mean[k], state.mean, rtol=1e-11, atol=1e-12)
    assert np.abs(mean - found[0])[1:].min() > 1e-6
    assert library.untold() == 7


def test_under_sanitizers(tmp_path):
    """Points in loops, whose functions hand the inputs on."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler: wanted one called cc")
    to_c(FILTERS["in loops"](), tmp_path / "made.h", name="made")
    more = """
#include <stdio.h>
int main(void)
{
    const double t[3] = { 0.0, 0.4, 1.0 }, y[6] = { 0.1, 0.2, NAN, 0.3, 0.2, NAN };
    const double u[6] = { 0.1, -0.2, 0.3, 0.0, 0.2, 0.1 };
    double mean[6], cov[12], loglik[3];
    const int code = record(0, 3, t, y, u, mean, cov, loglik);
    printf("%d %d %d", code, untold(), isfinite(mean[4] + cov[8] + loglik[2]));
    return 0;
}
"""
    (tmp_path / "main.c").write_text(RUN + more)
    flags = ["-std=c99", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    line = ["cc", *flags, "main.c", "-o", "main", "-lm"]
    subprocess.run(line, cwd=tmp_path, check=True, capture_output=True)
    done = subprocess.run(["./main"], cwd=tmp_path, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("0 7 1", "")


def test_the_elapsed_time_alone(compiled):
    """Steps of any length, without an argument for it; by the Kalman filter written out by hand."""
    system = DiscreteSystem(
        StochasticMap((a,), [sympy.exp(-ELAPSED) * a + sympy.sqrt(ELAPSED) * v], Noise((v,))),
        StochasticMap((a,), [a + w], Noise((w,))), [1.0], [[2.0]],
    )  # fmt: skip
    times, y = TIMES, np.random.default_rng(1).normal(size=(6, 1, 1))
    mean, cov, _, _ = compiled(extended_kalman(system)).run(times, y)
    m, p = 1.0, 2.0
    for k, t in enumerate(times):
        if k:
            fade = np.exp(times[k - 1] - t)
            m, p = fade * m, fade**2 * p + t - times[k - 1]
        m, p = m + p / (p + 1) * (y[k, 0, 0] - m), p / (p + 1)
        np.testing.assert_allclose((mean[k, 0, 0], cov[k, 0, 0, 0]), (m, p), rtol=1e-12)


def test_a_design_with_its_inputs_in_its_forecasts(compiled):
    """Inputs of the design are in its numbers: nothing is told to the C."""
    moves = StochasticMap((a,), [0.9 * a + FORCE + v], Noise((v,)))
    times = np.arange(5.0)
    forces = {FORCE: np.sin(times)}

    def design(shown):
        system = DiscreteSystem(moves, StochasticMap((a,), shown, Noise((w,))), [0.0], [[1.0]])
        return synthesize(
            system, Memory(1), Taylor(), times, paths=300, seed=1,
            inputs=dict.fromkeys(system.mentions, forces[FORCE]),
        )  # fmt: skip

    filter = design([a + w])
    y = np.random.default_rng(1).normal(size=(5, 1, 3))
    wanted = filter.run(times, y, inputs=forces, covariances=True)
    mean, *_ = compiled(filter).run(times, y)
    np.testing.assert_allclose(mean, wanted.mean, rtol=1e-12, atol=1e-13)
    with pytest.raises(ValueError, match="wanted a design whose inputs are in its forecasts alone"):
        to_c(design([a + w + BIAS]))


def test_float_and_what_is_refused():
    text = to_c(unscented_kalman(pushed()), real="float").replace("\n * ", " ")
    assert "u holds the inputs: bias, force." in text
    assert "differ from those in double by at most" in text
    with pytest.raises(ValueError, match="wanted a model without inputs"):
        to_js(extended_kalman(steered()))
    modes = SwitchingSystem(
        (a,), [[a + FORCE + v], [a + v]], Noise((v,)), [[0.9, 0.1], [0.1, 0.9]],
        [[a + w], [a + 2 * w]], Noise((w,)), [(0.5, [0.0], [[1.0]])] * 2,
    )  # fmt: skip
    with pytest.raises(
        ValueError, match="filter: wanted a model without inputs, C has none with modes"
    ):
        to_c(SwitchingFilter(modes, Taylor()))


@pytest.mark.parametrize("name", ["extended", "unscented, in continuous time"])
def test_behind_the_verbs(name):
    if compiler() is None:
        pytest.skip("no C compiler")
    filter = FILTERS[name]()
    twin = compiled_twin(filter)
    rng = np.random.default_rng(3)
    y = rng.normal(size=(len(TIMES), filter.system.measurement_size, 4))
    u = {BIAS: rng.normal(size=(len(TIMES), 4)), FORCE: rng.normal(size=len(TIMES))}
    wanted, found = filter.run(TIMES, y, inputs=u), twin.run(TIMES, y, inputs=u)
    for one, other in zip(found[:2], wanted[:2], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(found.loglik, wanted.loglik, rtol=1e-10)
    alone = {BIAS: u[BIAS][:, 2], FORCE: u[FORCE]}
    np.testing.assert_allclose(twin.run(TIMES, y[..., 2], inputs=alone).mean, found.mean[..., 2])
    with assigned({FORCE: 0.3}):
        some = {BIAS: u[BIAS]}
        held = twin.run(TIMES, y, inputs=some).mean
        right = filter.run(TIMES, y, inputs=some).mean
    np.testing.assert_allclose(held, right, rtol=1e-11, atol=1e-12)
    state, other, many = filter.initial(), twin.initial(), twin.initial((4,))
    for k, t in enumerate(TIMES[:3]):
        with assigned({BIAS: u[BIAS][max(k - 1, 0), 2], FORCE: u[FORCE][max(k - 1, 0)]}):
            state, other = filter.predict(state, t), twin.predict(other, t)
        with assigned({BIAS: u[BIAS][max(k - 1, 0)], FORCE: u[FORCE][max(k - 1, 0)]}):
            many = twin.predict(many, t)
        with assigned({BIAS: u[BIAS][k, 2], FORCE: u[FORCE][k]}):
            state, other = filter.correct(state, y[k, :, 2]), twin.correct(other, y[k, :, 2])
        with assigned({BIAS: u[BIAS][k], FORCE: u[FORCE][k]}):
            many = twin.correct(many, y[k])
        np.testing.assert_allclose(other.mean, state.mean, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(many.mean, found.mean[k], rtol=1e-11, atol=1e-12)
    with assigned({BIAS: 0.1, FORCE: -0.4}):
        state, other = (
            filter.step(state, TIMES[3], y[3, :, 2]),
            twin.step(other, TIMES[3], y[3, :, 2]),
        )
        ahead = [each.forecast(s, TIMES[4]).mean for each, s in ((filter, state), (twin, other))]
    np.testing.assert_allclose(other.cov, state.cov, rtol=1e-10)
    np.testing.assert_allclose(*ahead, rtol=1e-10)
    untold = pytest.raises(ValueError, match="force: wanted a value of this input, got none")
    with untold, assigned({BIAS: 0.1}):
        twin.step(other, TIMES[4], y[4, :, 2])
    with pytest.raises(ValueError, match="inputs: wanted values of bias, force, got none"):
        twin.run(TIMES, y)
