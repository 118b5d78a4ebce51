"""ECMAScript modules: states side by side, whole records, what is refused, error functions."""

import json
import shutil
import subprocess

import numpy as np
import pytest
import sympy
from scipy import special

from seedslib import zoo
from seedslib.export import compiled, to_js
from seedslib.filters import extended_kalman
from seedslib.models import DiscreteSystem, Noise, StochasticMap
from systems import growth, pendulum

pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="no node")
SEEN = "const seen = (s) => [...s.mean, ...s.cov, s.loglik];\n"


@pytest.fixture
def node(tmp_path):
    """What a program beside the module of a filter prints, from JSON."""

    def run(filter, program, found):
        text = to_js(filter, tmp_path / "made.mjs")
        assert (tmp_path / "made.mjs").read_text() == text == to_js(filter)
        lines = [f"import * as f from './made.mjs';\n{SEEN}", program]
        (tmp_path / "run.mjs").write_text("".join(lines) + f"console.log(JSON.stringify({found}));")
        done = subprocess.run(["node", "run.mjs"], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


def test_states_in_turn_and_copies_equal_states_alone(node):
    program = """
const one = f.init(), other = f.init(), y = [[0.7], [NaN], [-0.3]], alone = [f.init(), f.init()];
let kept;
for (let k = 0; k < 3; k++) {
  f.step(one, k, y[k]);
  if (k === 1) kept = one.copy();
  f.step(other, k, y[2 - k]);
}
f.step(kept, 2, y[2]);
for (let k = 0; k < 3; k++) f.step(alone[0], k, y[k]);
for (let k = 0; k < 3; k++) f.step(alone[1], k, y[2 - k]);
"""
    found = node(extended_kalman(pendulum()), program, "[one, kept, ...alone, other].map(seen)")
    assert found[0] == found[1] == found[2] != found[3] == found[4]


def test_whole_records_equal_steps(node):
    program = """
const y = [0.7, NaN, -0.3], alone = [], one = f.init(), room = f.rows(3);
for (let k = 0; k < 3; k++) { f.step(one, k, y.slice(k, k + 1)); alone.push(...seen(one)); }
const given = f.run(f.init(), [0, 1, 2], y, room), own = f.run(f.init(), [0, 1, 2], y);
let refusal = '';
try { f.run(f.init(), [1, 0], [1, 1]); } catch (error) { refusal = error.message; }
const rows = (r) => [0, 1, 2].flatMap((k) => [...r.mean.slice(2 * k, 2 * k + 2),
  ...r.cov.slice(4 * k, 4 * k + 4), r.loglik[k]]);
"""
    found = "[given === room, refusal, alone, rows(room), rows(own)]"
    same, refusal, alone, room, own = node(extended_kalman(pendulum()), program, found)
    assert same
    assert "1" in refusal
    assert alone == room == own
    assert len(alone) == 3 * 7


def test_refused_measurements_leave_the_state(node):
    """Infinite ones, times that go back, and times beyond ten million integration steps."""
    filter = extended_kalman(zoo.van_der_pol())
    far = 1e7 * filter.integration_step + 2.0
    program = f"""
const s = f.init();
f.step(s, 1, [1, 2]);
const before = seen(s), codes = [f.step(s, 2, [1, -Infinity]), f.step(s, 0.5, [1, 1]),
  f.step(s, NaN, [1, 1]), f.step(s, 1e300, [1, 1]), f.step(s, {far!r}, [1, 1])], after = seen(s);
let length = '';
try {{ f.step(s, 2, [1, 1, 1]); }} catch (error) {{ length = error.message; }}
"""
    codes, before, after, length = node(filter, program, "[codes, before, after, length]")
    assert codes == [2, 4, 4, 4, 4]
    assert before == after
    assert length.startswith("y")


def test_error_functions_equal_those_of_scipy(node):
    """Means of a state that is known exactly are the functions themselves, here of the time."""
    a, b, w, t = sympy.symbols("a b w t", real=True)
    move = StochasticMap((a, b), [sympy.erf(t), sympy.erfc(t)], Noise(()), time=t)
    sensor = StochasticMap((a, b), [a + w], Noise((w,)))
    filter = extended_kalman(DiscreteSystem(move, sensor, [0, 0], np.zeros((2, 2))))
    times = np.linspace(-6.0, 6.0, 97)
    program = f"""
const s = f.init(), found = [];
for (const t of {times.tolist()}) {{ f.step(s, t, [NaN]); found.push(s.mean); }}
"""
    found = np.array(node(filter, program, "found"))[1:]
    np.testing.assert_allclose(found[:, 0], special.erf(times[:-1]), rtol=4e-15, atol=1e-300)
    np.testing.assert_allclose(found[:, 1], special.erfc(times[:-1]), rtol=1e-13)


def test_100_000_steps_end_as_those_of_compiled_c(node):
    filter, times = extended_kalman(growth()), np.arange(100_000.0)
    noise, y, x = np.random.default_rng(3).normal(size=(2, times.size)), [], 0.5
    for t, v, w in zip(times, *noise, strict=True):
        y.append(x**2 / 20 + w)
        x = x / 2 + 25 * x / (1 + x**2) + 8 * np.cos(1.2 * t) + np.sqrt(10) * v
    program = f"""
const y = {np.round(y, 6).tolist()}, found = f.run(f.init(), y.map((_, k) => k), y);
"""
    last = node(filter, program, "[found.mean.at(-1), found.cov.at(-1), found.loglik.at(-1)]")
    wanted = compiled(filter).run(times, np.round(y, 6)[:, None])
    parts = wanted.mean[-1, 0], wanted.cov[-1, 0, 0], wanted.loglik[-1]
    np.testing.assert_allclose(last, parts, rtol=1e-13)
