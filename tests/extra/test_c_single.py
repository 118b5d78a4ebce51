"""Headers in single precision, what they say of themselves, and sanitizers."""

import ctypes
import re
import subprocess

import numpy as np
import pytest
import sympy
from sklearn.ensemble import RandomForestRegressor
from sklearn.neural_network import MLPRegressor

from seedslib import zoo
from seedslib.design import Polynomial, grid_synthesis, synthesize
from seedslib.designed import Memory, SwitchingFilter, large_order
from seedslib.extra import learn, to_c
from seedslib.extra.c import build
from seedslib.extra.c.single import RESERVE, sensing, single
from seedslib.filters import CovarianceFilter, extended_kalman, unscented_kalman
from seedslib.linearization import ExactGaussian, GaussHermite, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem

if build.compiler() is None:
    pytest.skip("no C compiler", allow_module_level=True)

TIMES = 0.5 * np.arange(7.0)
MORE = ["-Wconversion", "-Wdouble-promotion", "-Wfloat-conversion", "-Wshadow"]

a, b, v, w = sympy.symbols("a b v w", real=True)


def walk():
    return DiscreteSystem(
        StochasticMap((a, b), [0.9 * a + b, 0.7 * b + v], Noise((v,), cov=[[0.1]])),
        StochasticMap((a, b), [sympy.sin(a) + a + w], Noise((w,), cov=[[0.2]])),
        [0.0, 0.1], 0.5 * np.eye(2),
    )  # fmt: skip


def driven():
    moved = [[0.9 * a + v], [0.5 * a + 2 + v]]
    return SwitchingSystem(
        (a,), moved, Noise((v,)), [[0.9, 0.1], [0.3, 0.7]], [[a + w], [a + 2 * w]], Noise((w,)),
        [(0.5, [0.0], [[1.0]])] * 2, drives="new",
    )  # fmt: skip


def designed(**options):
    return synthesize(
        zoo.van_der_pol(), Memory(1), ExactGaussian(), TIMES, paths=500, seed=1, **options
    )


def learned(regressor):
    return learn(zoo.van_der_pol(), Memory(1), TIMES, paths=200, seed=1, regressor=regressor)


FILTERS = {
    "designed": designed,
    "polynomial": lambda: designed(predictor=Polynomial(3, 2)),
    "designed, with gaps": lambda: synthesize(
        walk(), Memory(1), Taylor(), TIMES, paths=500, seed=1, availability=0.6
    ),
    "table": lambda: grid_synthesis(
        zoo.flip_process(), large_order(1), TIMES[:4], x=(-3.5, 3.5, 41), z=(-2.5, 2.5, 7),
        y=(-8, 8, 17), nodes=1,
    ),
    "learned, network": lambda: learned(
        MLPRegressor(hidden_layer_sizes=(7,), max_iter=4, tol=0.0, activation="tanh")
    ),
    "learned, trees": lambda: learned(RandomForestRegressor(3, max_depth=4)),
    "extended": lambda: extended_kalman(walk()),
    "extended, in continuous time": lambda: extended_kalman(zoo.van_der_pol(), step=0.05),
    "unscented": lambda: unscented_kalman(walk()),
    "Gauss-Hermite": lambda: CovarianceFilter(walk(), GaussHermite(11)),
    "IMM": lambda: SwitchingFilter(zoo.manoeuvring_target(), Taylor()),
    "IMM, the new mode drives": lambda: SwitchingFilter(driven(), Taylor()),
    "switching, designed": lambda: synthesize(
        zoo.scalar_switching(), large_order(1), Taylor(), np.arange(6.0), paths=500, seed=1
    ),
}  # fmt: skip

PROGRAM = """
#include "made.h"
#include <stdio.h>
int main(void)
{
    static const REAL y[][MADE_MEASUREMENT] = { ROWS };
    made_state s;
    int k;
    made_init(&s);
    for (k = 0; k < COUNT; k++) {
        const int code = made_step(&s, TIME y[k] TOLD);
        if (code != MADE_OK) printf("refused %d: %d\\n", k, code);
        BETWEEN
        printf("%.17g %.17g\\n", (double)s.mean[0], (double)s.cov[0][0]);
    }
    return 0;
}
"""


def run(folder, filter, real, flags):
    """Lines that a program with the filter prints of a record."""
    text = to_c(filter, folder / "made.h", name="made", real=real)
    times = filter.times if getattr(filter, "memory", None) else 0.5 * np.arange(40.0)
    y = filter.system.simulate(times, 1, 3, **sensing(filter, len(times))).measurements[..., 0]
    mark = "F" if real == "float" else ""

    def number(x):
        return f"({real})NAN" if np.isnan(x) else f"{x:.9e}{mark}"

    rows = ", ".join("{ " + ", ".join(map(number, row)) + " }" for row in y)
    source = PROGRAM.replace("REAL", real).replace("ROWS", rows).replace("COUNT", str(len(y)))
    timed = re.search(r"made_step\(made_state \*s, \w+ t,", text)
    source = source.replace("TIME", f"({real})(0.5 * k)," if timed else "")
    source = source.replace("TOLD", ", k % 2" if "int indicator" in text else "")
    between = (
        f"if (k) {{ {real} out[MADE_STATE]; (void)made_forecast(&s, s.k < MADE_TIMES ? "
        f"made_times[s.k] : made_times[s.k - 1], out); }}"
    )
    source = source.replace("BETWEEN", between if " made_forecast(" in text else "")
    (folder / "main.c").write_text(source)
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off"]
    line = ["cc", *strict, *flags, "main.c", "-o", "main", "-lm"]
    done = subprocess.run(line, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    done = subprocess.run(["./main"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return text, done.stdout


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.filterwarnings("ignore:paths:UserWarning")
@pytest.mark.filterwarnings("ignore:Stochastic Optimizer:UserWarning", "ignore:held out")
@pytest.mark.filterwarnings("ignore:y. the axes:UserWarning")
@pytest.mark.filterwarnings("ignore:[xz]. the:UserWarning")
def test_float_beside_double(name, tmp_path):
    filter = FILTERS[name]()
    sanitize = ["-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    text, double = run(tmp_path, filter, "double", sanitize)
    short, single_ = run(tmp_path, filter, "float", ["-O2", *MORE])
    assert "refused" not in double + single_
    code = short[short.index("#ifndef") :]
    assert "double" not in re.sub(r"/\*.*?\*/", "", code, flags=re.DOTALL)
    one, other = (np.array([[*map(float, row.split())] for row in each.splitlines()])
                  for each in (double, single_))  # fmt: skip
    np.testing.assert_allclose(other, one, rtol=2e-3, atol=2e-3)
    assert not np.array_equal(one, other)
    said = short.replace("\n * ", " ")
    told = re.search(r"differ from those in double by at most ([\d.e+-]+)", said)
    apart = np.abs(other - one)[:, 0] / np.sqrt(np.maximum(one[:, 1], 1e-12))
    assert np.nanmax(apart) <= float(told[1]) < RESERVE * 0.05  # of the worst of 1e5 steps
    assert "Bytes: " in text
    state = int(re.search(r"of tables of numbers, (\d+)", said)[1])
    assert state == size_of(tmp_path)


def size_of(folder):
    source = (
        '#include "made.h"\nint size(void);\nint size(void) { return (int)sizeof(made_state); }'
    )
    (folder / "size.c").write_text(source + "\n")
    line = ["cc", "-shared", "-fPIC", "size.c", "-o", "size.so", "-lm"]
    subprocess.run(line, cwd=folder, check=True, capture_output=True)
    return ctypes.CDLL(str(folder / "size.so")).size()


def test_bytes_of_tables(tmp_path):
    filter = designed(nodes=0)
    told = re.search(r"Bytes: (\d+)", to_c(filter))
    fit = filter.fits[0]
    steps = len(TIMES) - 1
    numbers = steps * (fit.gain.size + fit.offset.size + 3)  # forecasts
    numbers += 2 + 4 + 2 + 4 + 4  # the first estimate
    numbers += len(TIMES) + 1 + 4 + 2  # times, a node that is not there and its forecast
    assert int(told[1]) == 8 * numbers + 4 * (len(TIMES) + 1)


def test_numbers_out_of_the_range_of_float():
    assert single("double x = 1e-60 + exp(0.1); /* double 1.0 */") == (
        "float x = 0.0F + expf(0.1F); /* double 1.0 */"
    )
    with pytest.raises(ValueError, match="range of float, got 1e60"):
        single("double x = 1e60;")
    with pytest.raises(ValueError, match="real: wanted double or float"):
        to_c(extended_kalman(walk()), real="half")


def test_without_a_compiler_the_header_says_so(monkeypatch):
    monkeypatch.setattr(build, "compiler", lambda: None)
    assert "not measured" in to_c(extended_kalman(walk()), real="float").replace("\n * ", " ")
