"""ECMAScript modules: states side by side, whole records, what is refused, error functions."""

import json
import shutil
import subprocess

import numpy as np
import pytest
import sympy
from scipy import special

from seedslib import zoo
from seedslib.designed import SwitchingFilter
from seedslib.extra import to_js
from seedslib.filters import extended_kalman
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap
from systems import growth, pendulum

pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="no node")


@pytest.fixture
def node(tmp_path):
    """Run a program beside a module made of a filter; what it prints, from JSON."""

    def run(filter, program):
        to_js(filter, tmp_path / "made.mjs")
        (tmp_path / "run.mjs").write_text("import * as f from './made.mjs';\n" + program)
        done = subprocess.run(["node", "run.mjs"], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


def test_states_in_turn_and_copies_equal_states_alone(node):
    one, kept, first, other, second = node(
        extended_kalman(pendulum()),
        """
const one = f.init(), other = f.init(), y = [[0.7], [NaN], [-0.3]];
let kept;
for (let k = 0; k < 3; k++) {
  f.step(one, k, y[k]);
  if (k === 1) kept = one.copy();
  f.step(other, k, y[2 - k]);
}
f.step(kept, 2, y[2]);
const alone = [f.init(), f.init()];
for (let k = 0; k < 3; k++) f.step(alone[0], k, y[k]);
for (let k = 0; k < 3; k++) f.step(alone[1], k, y[2 - k]);
const found = [one, kept, alone[0], other, alone[1]];
console.log(JSON.stringify(found.map((s) => [...s.mean, ...s.cov, s.loglik])));
""",
    )
    assert one == kept == first != other == second


def test_whole_records_equal_steps(node):
    same, refusal, alone, room, own = node(
        extended_kalman(pendulum()),
        """
const y = [0.7, NaN, -0.3], alone = { mean: [], cov: [], loglik: [] }, one = f.init();
for (let k = 0; k < 3; k++) {
  f.step(one, k, y.slice(k, k + 1));
  for (const name in alone) alone[name].push(one[name]);
}
const room = f.rows(3), given = f.run(f.init(), [0, 1, 2], y, room);
const own = f.run(f.init(), [0, 1, 2], y);
let refusal = '';
try { f.run(f.init(), [1, 0], [1, 1]); } catch (error) { refusal = error.message; }
const flat = (found) => [...found.mean].flat().concat([...found.cov].flat(), [...found.loglik]);
console.log(JSON.stringify([given === room, refusal, flat(alone), flat(room), flat(own)]));
""",
    )
    assert same
    assert "code 4" in refusal
    assert alone == room == own
    assert len(alone) == 3 * 7


def test_refused_measurements_leave_the_state(node):
    codes, before, after, length = node(
        extended_kalman(pendulum()),
        """
const s = f.init(), seen = () => JSON.stringify([...s.mean, ...s.cov, s.loglik]);
f.step(s, 1, [0.7]);
const before = seen();
const codes = [f.step(s, 2, [Infinity]), f.step(s, 0.5, [1]), f.step(s, NaN, [1])];
const after = seen();
let length = '';
try { f.step(s, 2, [1, 1]); } catch (error) { length = error.message; }
console.log(JSON.stringify([codes, before, after, length]));
""",
    )
    assert codes == [2, 4, 4]
    assert before == after
    assert "y" in length
    modes = SwitchingFilter(zoo.manoeuvring_target(), Taylor())
    codes = "[0, 5, -2].map((j, k) => f.step(s, k, [1], j))"
    program = f"const s = f.init();\nconsole.log(JSON.stringify({codes}));\n"
    assert node(modes, program) == [0, 5, 5]


def test_a_time_beyond_ten_million_integration_steps_is_refused(node):
    """In ECMAScript as in C, with the state as it was."""
    system = zoo.van_der_pol()
    far = [1e12, 1e300, 1e7 * extended_kalman(system).integration_step + 0.02]
    codes, same = node(
        extended_kalman(system),
        f"""
const s = f.init();
f.step(s, 0, [1, 2]);
const seen = () => JSON.stringify([...s.mean, ...s.cov, s.loglik]), before = seen();
const codes = {json.dumps(far)}.map((t) => f.step(s, t, [1, 2]));
console.log(JSON.stringify([codes, before === seen()]));
""",
    )
    assert codes == [4, 4, 4]
    assert same


def test_error_functions_equal_those_of_scipy(node):
    """Means of a state that is known exactly are the functions themselves, here of the time."""
    a, b, w, t = sympy.symbols("a b w t", real=True)
    system = DiscreteSystem(
        StochasticMap((a, b), [sympy.erf(t), sympy.erfc(t)], Noise(()), time=t),
        StochasticMap((a, b), [a + w], Noise((w,))),
        [0, 0],
        np.zeros((2, 2)),
    )
    times = np.linspace(-6.0, 6.0, 97)
    found = node(
        extended_kalman(system),
        f"""
const s = f.init(), found = [];
for (const t of {times.tolist()}) {{ f.step(s, t, [NaN]); found.push([...s.mean]); }}
console.log(JSON.stringify(found));
""",
    )
    found, at = np.array(found)[1:], times[:-1]
    np.testing.assert_allclose(found[:, 0], special.erf(at), rtol=4e-15, atol=1e-300)
    np.testing.assert_allclose(found[:, 1], special.erfc(at), rtol=1e-13)


def test_equal_filters_give_equal_text_without_imports(tmp_path):
    text = to_js(extended_kalman(growth()), tmp_path / "a.mjs")
    assert (tmp_path / "a.mjs").read_text() == text == to_js(extended_kalman(growth()))
    assert "import " not in text
    assert text.isascii()
