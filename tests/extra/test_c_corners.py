"""Headers in corners: redundant and contradicting measurements, several filters in one file."""

import ctypes
import math
import warnings

import numpy as np
import pytest
import sympy
from scipy.special import erf

from seedslib import zoo
from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.extra import to_c
from seedslib.extra.c.source import constants
from seedslib.extra.c.tape import Tape
from seedslib.filters import assumed_density, extended_kalman
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

TIMES = 0.5 * np.arange(5)

x, v, w = sympy.symbols("x v w")


def seen_twice(cov0=1.0, noise=0.3):
    """A process whose sensor shows the same number twice, and half of it."""
    return JumpDiffusion(
        state=(x,), drift=[-x], diffusion=[[1]], sensor=[x + v, x + v, (x + v) / 2],
        noise=Noise((v,), cov=[[noise]]), mean0=[1], cov0=[[cov0]], step=0.05,
    )  # fmt: skip


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_redundant_components_get_no_gain(compiled):
    system = seen_twice()
    y = system.simulate(TIMES, 60, 1).measurements
    y[1, 0, :20] = np.nan  # the second one stands in for the first
    y[2, :2, 20:40] = np.nan
    for filter in (
        extended_kalman(system),
        synthesize(system, Memory(1), Taylor(), TIMES, paths=1000, seed=1, nodes=0),
    ):
        mean, _, loglik, _ = compiled(filter).run(TIMES, y)
        once = np.where(np.isnan(y[:, :1]), y[:, 1:2], y[:, :1])
        once = np.where(np.isnan(once), 2 * y[:, 2:], once)
        single = JumpDiffusion(
            state=(x,), drift=[-x], diffusion=[[1]], sensor=[x + v], noise=Noise((v,), cov=[[0.3]]),
            mean0=[1], cov0=[[1]], step=0.05,
        )  # fmt: skip
        if hasattr(filter, "integrator"):
            wanted = extended_kalman(single).run(TIMES, once)
            np.testing.assert_allclose(mean, wanted.mean, rtol=1e-10, atol=1e-12)
            density = wanted.loglik.copy()
            density[2, 20:40] += math.log(2)  # of half the number
            np.testing.assert_allclose(loglik, density, rtol=1e-10, atol=1e-12)
        # the library's pseudo-inverse agrees where the measurements do
        library = filter.run(TIMES, y)
        np.testing.assert_allclose(mean, library.mean, rtol=1e-7, atol=1e-9)


def test_contradicting_components_the_first_one_counts(compiled):
    filter = extended_kalman(seen_twice())
    made = compiled(filter)
    y = np.array([[[0.7], [0.7], [0.35]], [[0.2], [9.0], [-3.0]]])
    twin = np.array([[[0.7], [np.nan], [np.nan]], [[0.2], [np.nan], [np.nan]]])
    for a, b in zip(made.run(TIMES[:2], y)[:3], made.run(TIMES[:2], twin)[:3], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)


def test_nothing_random_means_no_gain(compiled):
    system = seen_twice(cov0=0.0, noise=0.0)
    y = np.full((1, 3, 1), 5.0)
    mean, cov, loglik, _ = compiled(extended_kalman(system)).run([0.0], y)
    wanted = extended_kalman(system).run([0.0], y)
    assert mean.item() == wanted.mean.item() == 1.0
    assert cov.item() == wanted.cov.item() == 0.0
    assert loglik.item() == 0.0
    assert wanted.loglik.item() == -np.inf  # Python tells that it cannot be


def test_an_indefinite_covariance_shows_itself(build, tmp_path):
    filter = extended_kalman(zoo.van_der_pol())
    to_c(filter, tmp_path / "f.h", name="f")
    source = (
        '#include "f.h"\nvoid broken(double *out)\n{\n    f_state s;\n'
        "    double y[2] = {1.0, 2.0};\n"
        "    f_init(&s);\n    f_predict(&s, 0.0);\n    s.cov[0][0] = -3.0;\n"
        "    f_correct(&s, y);\n    memcpy(out, s.mean, sizeof s.mean);\n}\n"
    )
    out = np.zeros(2)
    ctypes.CDLL(str(build(tmp_path, source))).broken(out.ctypes.data_as(ctypes.c_void_p))
    state = filter.predict(filter.initial(), 0.0)
    broken = state._replace(cov=np.diag([-3.0, 0.15]))
    wanted = filter.correct(broken, np.array([1.0, 2.0])).mean
    assert np.isnan(wanted[0])
    assert np.isnan(out[0])


def test_two_filters_in_one_file_and_a_main_that_uses_none(build, tmp_path):
    system = zoo.van_der_pol()
    to_c(extended_kalman(system), tmp_path / "a.h", name="a")
    to_c(extended_kalman(system, integrator="euler"), tmp_path / "b.h", name="b")
    designed = synthesize(system, Memory(1), Taylor(), TIMES, paths=500, seed=1)
    to_c(designed, tmp_path / "c.h", name="c")
    source = '#include "a.h"\n#include "b.h"\n#include "c.h"\nint main(void) { return 0; }\n'
    more = ["-Wshadow", "-Wstrict-prototypes", "-Wmissing-prototypes", "-Wdouble-promotion", "-O3"]
    assert build(tmp_path, source, more=more).exists()
    fast = build(tmp_path, source, name="fast", more=["-ffast-math"], fails=True)
    assert "leave -ffast-math and -ffinite-math-only out" in fast


def test_constants_come_back_exactly(build, tmp_path):
    rng = np.random.default_rng(0)
    values = rng.normal(size=(40, 3, 2)) * 10.0 ** rng.integers(-300, 300, size=(40, 3, 2))
    values[0, 0] = 5e-324, -0.0
    text = "#include <string.h>\n" + constants("numbers", values)
    text += "void read(double *out);\n"
    text += "void read(double *out) { memcpy(out, numbers, sizeof numbers); }\n"
    found = np.empty_like(values)
    ctypes.CDLL(str(build(tmp_path, text))).read(found.ctypes.data_as(ctypes.c_void_p))
    assert found.tobytes() == values.tobytes()
    assert max(map(len, text.splitlines())) <= 110
    with pytest.raises(ValueError, match="finite"):
        constants("numbers", [1.0, np.nan])


def arithmetic(a, b):
    """Functions of two numbers, for the recorder and for NumPy."""
    return [
        a + b, a - b, a * b, a / b, -a, abs(a), a**3, a**-2, 2**b, b**a, b**0.5, np.sqrt(b),
        np.exp(a), np.log(b), np.sin(a), np.cos(a), np.tan(a), np.arctan2(a, b), np.tanh(a),
        np.hypot(a, b), np.square(a), np.maximum(a, b), np.minimum(a, b), np.sign(a),
        np.heaviside(a, 0.5), np.floor(a), np.cbrt(a), np.expm1(a), np.float64(2.0) * a,
        np.multiply(a, np.array(3.0)), 0.0 - a, 1.0 / b, a + 0.0, a * 1, np.power(b, 1.5),
        np.select([np.less(a, 0.0), np.greater_equal(b, 1.0)], [a * a, b], default=7.0),
        np.select([np.equal(a, 2.0), a >= 0.8], [b, a / 3], default=a), erf(a),
    ]  # fmt: skip


def test_recorded_arithmetic_is_that_of_numpy(build, tmp_path):
    tape = Tape()
    a, b = tape.inputs("y[{}]", 2)
    found = arithmetic(a, b)
    lines = tape.body({f"out[{k}]": part for k, part in enumerate(found)})
    text = "#include <math.h>\nvoid f(const double *y, double *out);\n"
    text += "void f(const double *y, double *out)\n{\n" + "\n".join(lines) + "\n}\n"
    made = ctypes.CDLL(str(build(tmp_path, text)))
    for point in ([0.3, 0.8], [-1.7, 2.5], [2.0, 1.0], [-0.0, 3.0]):
        y, out = np.array(point), np.empty(len(found))
        made.f(y.ctypes.data_as(ctypes.c_void_p), out.ctypes.data_as(ctypes.c_void_p))
        with np.errstate(divide="ignore", invalid="ignore"):
            wanted = np.array([float(part) for part in arithmetic(*y)])
        np.testing.assert_allclose(out, wanted, rtol=2e-15, atol=0, equal_nan=True)


def test_recorder_keeps_only_what_is_wanted_and_once():
    tape = Tape()
    a, b = tape.inputs("y[{}]", 2)
    product, again = a * b, a * b
    _ = a / b
    assert product.name == again.name
    assert 0 * a == 0.0
    assert (1 * a).name == (a + 0).name == a.name
    lines = tape.body({"out[0]": product, "out[1]": 2.5})
    assert [line.split(" = ")[1] for line in lines] == ["y[0];", "y[1];", "x0 * x1;", "x2;", "2.5;"]


def test_recorder_refuses_what_c_has_not():
    (a,) = Tape().inputs("y[{}]", 1)
    with pytest.raises(ValueError, match="wanted functions that C99 has, got deg2rad"):
        np.deg2rad(a)
    with pytest.raises(TypeError, match="choices by one comparison each"):
        bool(np.less(a, 1.0))
    with pytest.raises(ValueError, match="finite"):
        a * np.inf


def test_the_first_covariance_beside_a_wide_prior(compiled):
    noise = Noise((v,), cov=[[1e-8]])
    system = JumpDiffusion((x,), [0], [[0]], [x + v], noise, [0.0], [[1e12]], step=0.5)
    filter = synthesize(system, Memory(1), Taylor(), TIMES[:3], nodes=0, paths=2000, seed=1)
    found = compiled(filter).run(TIMES[:3], np.full((3, 1, 1), 5.0))[1].ravel()
    np.testing.assert_allclose(found, 1e-8 / np.arange(1.0, 4.0), rtol=0.1)


def test_a_carried_covariance_beside_a_wide_prior_is_warned_of():
    def kalman(prior):
        noise = Noise((v,), cov=[[1e-8]])
        return extended_kalman(
            JumpDiffusion((x,), [0], [[0]], [x + v], noise, [0.0], [[prior]], step=0.5)
        )

    with pytest.warns(UserWarning, match="in C the variance of x1 loses its digits"):
        to_c(kalman(1e12))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        to_c(kalman(1.0))


def test_bearings_across_the_cut(compiled):
    a, b, p, q, r = sympy.symbols("a b p q r", real=True)
    move = StochasticMap([a, b], [a + 0.01 * p, b - 0.2 + 0.01 * q], Noise((p, q)))
    see = StochasticMap(
        [a, b], [sympy.atan2(b, a) + 0.02 * r], Noise((r,)), period={0: 2 * math.pi}
    )
    system = DiscreteSystem(move, see, [-10.0, 1.0], 0.1 * np.eye(2))
    times = np.arange(12.0)
    y = system.simulate(times, 20, 2).measurements
    y[3, 0, :5] = np.nan
    carried = extended_kalman(system)
    for filter, record in (
        (carried, y),
        (synthesize(system, Memory(1), Taylor(), times, paths=1000, seed=1), y[..., 5:]),
    ):
        mean, _, loglik, _ = compiled(filter).run(times, record)
        library = filter.run(times, record)
        np.testing.assert_allclose(mean, library.mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(loglik, library.loglik, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("place", [0.0, 0.5])
def test_a_filter_that_starts_from_a_known_state_on_a_kink(compiled, place):
    """The code divides by the variance of what switches, which is zero to begin with."""
    x, v, w = sympy.symbols("x v w", real=True)
    system = DiscreteSystem(
        StochasticMap([x], [sympy.Abs(x) + sympy.sign(x) + v / 2], Noise([v])),
        StochasticMap([x], [sympy.Min(x, 0) + w], Noise([w])),
        mean0=place, cov0=0.0,
    )  # fmt: skip
    times, y = np.arange(5.0), np.array([np.nan, 0.3, -0.2, np.nan, -1.0])[:, None, None]
    filter = assumed_density(system)
    wanted = filter.run(times, y)
    assert np.isfinite(wanted.cov).all()
    mean, cov, loglik, _ = compiled(filter).run(times, y)
    for found, given in ((mean, wanted.mean), (cov, wanted.cov), (loglik, wanted.loglik)):
        np.testing.assert_allclose(found, given, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("power", [0, 1])
def test_a_one_sided_exponential_beside_a_wide_prior(compiled, power):
    """The exponential of the first variance is no number; its product with a probability is."""
    x, v, w = sympy.symbols("x v w", real=True)
    sensor = sympy.Piecewise(((x + 1) ** power * sympy.exp(x), x < 0), (1 + x, True))
    system = DiscreteSystem(
        StochasticMap([x], [0.9 * x + v], Noise([v])),
        StochasticMap([x], [sensor + w], Noise([w])),
        mean0=-30.0, cov0=1e4,
    )  # fmt: skip
    times = np.arange(6.0)
    y = system.simulate(times, 20, 1).measurements
    filter = assumed_density(system)
    wanted = filter.run(times, y)
    mean, cov, loglik, _ = compiled(filter).run(times, y)
    for found, given in ((mean, wanted.mean), (cov, wanted.cov), (loglik, wanted.loglik)):
        assert np.isfinite(given).all()
        np.testing.assert_allclose(found, given, rtol=1e-9, atol=1e-9)
