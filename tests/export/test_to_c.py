"""Headers themselves: equal text, what they include, compilers that they refuse, redundant data."""

import math
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
import sympy

from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.export import compiled, to_c
from seedslib.filters import extended_kalman, unscented_kalman
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap
from systems import growth, oscillator, pendulum

a, b, t = sympy.symbols("a b t", real=True)
v, w = sympy.symbols("v w", real=True)


def test_equal_filters_give_equal_text_in_any_process(tmp_path):
    text = to_c(extended_kalman(pendulum()), tmp_path / "a.h")
    assert (tmp_path / "a.h").read_text() == text
    code = (
        "import sympy; [sympy.Dummy() for _ in range(2345)]\n"
        "from seedslib.export import to_c; from seedslib.filters import extended_kalman\n"
        "from systems import pendulum; print(to_c(extended_kalman(pendulum())), end='')"
    )
    line = [sys.executable, "-c", f"import sys; sys.path = {sys.path}\n{code}"]
    assert subprocess.run(line, capture_output=True, text=True, check=True).stdout == text


def test_a_header_is_ascii_includes_two_headers_and_says_what_the_filter_is():
    filter = synthesize(growth(), Memory(2), Taylor(), np.arange(7.0), paths=300, seed=1, nodes=0)
    comment, code = to_c(filter, name="Own_1").split("*/", 1)
    assert comment.isascii()
    assert code.isascii()
    assert re.findall("#include (.*)", code) == ["<math.h>", "<string.h>"]
    assert f"{filter.predicted.rms[0, 0]:.4f} +- " in comment
    assert "#define OWN_1_MEMORY 2" in code


@pytest.mark.parametrize("flag", ["-ffast-math", "-ffinite-math-only"])
def test_a_compiler_that_leaves_nan_out_is_refused(tmp_path, flag):
    to_c(extended_kalman(growth()), tmp_path / "f.h", name="f")
    (tmp_path / "f.c").write_text('#include "f.h"\nint main(void) { return 0; }\n')
    for flags, fails in (([flag], True), ([], False)):
        line = [shutil.which("cc"), "-fsyntax-only", *flags, "f.c"]
        done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True)
        assert ("wanted a compiler that keeps NaN" in done.stderr) == fails == bool(done.returncode)


def redundant(components=3):
    """A sensor whose second component says what the first one does; the third shows a constant."""
    shows = [b + w, (b + w) / 2, a][:components]
    return DiscreteSystem(
        StochasticMap((a, b), [a, 0.5 * b + v], Noise((v,))),
        StochasticMap((a, b), shows, Noise((w,))),
        [1.0, 0.5],
        [[1.0, 0.2], [0.2, 0.7]],
    )


@pytest.mark.filterwarnings("ignore:cov0:UserWarning")
@pytest.mark.parametrize("make", [extended_kalman, unscented_kalman])
def test_a_redundant_component_gets_no_gain_and_is_not_counted(make, quick):
    """By the filter of the first two components' only number; a constant is known after a look."""
    times = np.arange(7.0)
    y = redundant(2).simulate(times, 5, 3).measurements
    y[1, 0] = y[3, 1] = y[5] = np.nan
    once = np.where(np.isnan(y[:, :1]), 2 * y[:, 1:], y[:, :1])
    wanted = make(redundant(1)).run(times, once)
    found = compiled(make(redundant(2))).run(times, y)
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-12, atol=1e-12)
    density = wanted.loglik.copy()
    density[1] += math.log(2)  # of half the number
    np.testing.assert_allclose(found.loglik, density, rtol=1e-12, atol=1e-12)
    y[0, 1], y[2, 1] = 9.0, -3.0  # the first one counts where they contradict each other
    found = compiled(make(redundant(2))).run(times, y)
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-12, atol=1e-12)
    constant = np.full((7, 1, 5), 1.7)
    if make is unscented_kalman:
        known = compiled(make(redundant(3))).run(times, np.concatenate([y, constant], axis=1))
        np.testing.assert_allclose(known.mean[:, 0], 1.7, rtol=1e-12)
        assert np.abs(known.cov[:, 0]).max() < 1e-15


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_a_known_position_that_is_driven_through_its_velocity_is_followed_in_c(order, quick):
    """In the first stages of a step it covaries with what it has no variance beside."""
    pick, c = np.array(order), sympy.Symbol("c", real=True)
    state, drift = np.array([a, b, c])[pick], np.array([b, -b / 2 + c / 5, -c + a])[pick]
    spread, cov0 = np.array([[0, 0], [1, 0], [0.2, 0.5]])[pick], np.diag([0.0, 0.3, 0.0])
    shown, mean0 = [a + w, b + c + v], np.zeros(3)
    cov0, noise = cov0[np.ix_(pick, pick)], Noise([w, v])
    system = JumpDiffusion(state, drift, spread, shown, noise, mean0, cov0, step=0.1)
    filter, times = unscented_kalman(system), np.arange(5.0) / 2
    y = np.random.default_rng(1).normal(size=(5, 2, 1))
    wanted, found = filter.run(times, y), compiled(filter).run(times, y)
    for part in ("mean", "cov", "loglik"):
        expected = getattr(wanted, part)
        expected = expected[..., None] if expected.ndim < getattr(found, part).ndim else expected
        np.testing.assert_allclose(getattr(found, part), expected, rtol=1e-11, atol=1e-12)


FLOAT = """
#include <stdio.h>
#include "f.h"
int main(void)
{
    f_state s;
    f_real y[1] = { 0.3F };
    double t = 1e8;
    f_init(&s);
    for (int k = 0; k < 20; k++, t += 0.01) if (f_step(&s, t, y)) return 1;
    printf("%.17g %.9g\\n", s.t, (double)s.mean[0]);
    return 0;
}
"""


def test_times_stay_exact_where_numbers_are_float(tmp_path):
    """Steps of 0.01 at a time of which a float holds eights only."""
    filter, times = extended_kalman(pendulum()), 1e8 + 0.01 * np.arange(20)
    text = to_c(filter, name="f").replace("typedef double f_real", "typedef float f_real")
    (tmp_path / "f.h").write_text(text)
    (tmp_path / "f.c").write_text(FLOAT)
    line = [shutil.which("cc"), "-std=c99", "-Wall", "f.c", "-o", "f", "-lm"]
    subprocess.run(line, cwd=tmp_path, check=True)
    printed = subprocess.run([tmp_path / "f"], capture_output=True, text=True, check=True).stdout
    t, mean = map(float, printed.split())
    wanted = filter.run(times, np.full((20, 1), 0.3)).mean[-1, 0]
    assert t == pytest.approx(times[-1], abs=1e-6)
    assert mean == pytest.approx(wanted, rel=1e-4)


AFTER = """
#include <stdio.h>
#include "f.h"
int main(void)
{
    f_state s;
    const double y[1] = { 0.3 };
    f_init(&s);
    for (int k = 0; k < 20; k++) if (f_after(&s, 0.01 * k, y)) return 1;
    printf("%.17g %.17g\\n", s.t, s.mean[0]);
    return f_after(&s, -0.01, y) != F_TIME;
}
"""


def test_steps_by_the_time_since_the_last_one_and_the_stack_they_take(tmp_path):
    filter, times = extended_kalman(oscillator()), np.cumsum(0.01 * np.arange(20))
    text = to_c(filter, tmp_path / "f.h", name="f")
    (tmp_path / "f.c").write_text(AFTER)
    line = [shutil.which("cc"), "-std=c99", "-Wall", "f.c", "-o", "f", "-lm", "-fstack-usage"]
    taken = {}
    for level in ("-O0", "-Os"):
        subprocess.run([*line, level], cwd=tmp_path, check=True)
        rows = [row.split("\t") for row in next(tmp_path.glob("*.su")).read_text().splitlines()]
        taken[level] = max(int(size) for _, size, _ in rows)
    printed = subprocess.run([tmp_path / "f"], capture_output=True, text=True, check=True).stdout
    t, mean = map(float, printed.split())
    assert t == pytest.approx(times[-1])
    assert mean == pytest.approx(filter.run(times, np.full((20, 1), 0.3)).mean[-1, 0], rel=1e-12)
    said = int(re.search(r"about ([\d,]+) bytes\W+of\W+stack", text)[1].replace(",", ""))
    assert 0.8 * said < taken["-O0"] < 1.3 * said
    assert taken["-Os"] < said


def test_a_long_record_is_the_same_in_c_and_python(quick):
    filter, times = extended_kalman(growth()), np.arange(3000.0)
    y = filter.system.simulate(times, 1, 3).measurements[..., 0]
    wanted, found = filter.run(times, y), compiled(filter).run(times, y)
    for part in ("mean", "cov", "loglik"):
        expected = getattr(wanted, part)
        np.testing.assert_allclose(
            getattr(found, part), expected, rtol=1e-13, atol=1e-13 * np.abs(expected).max()
        )
