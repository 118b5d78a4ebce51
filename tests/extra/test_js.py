"""Filters as ECMAScript modules, run by node, against the same filters in Python."""

import json
import math
import shutil
import subprocess

import numpy as np
import pytest
import sympy
from scipy import special

from seedslib import zoo
from seedslib.design import Continuous, Polynomial, grid_synthesis, stationary, synthesize
from seedslib.designed import Memory, SwitchingFilter, large_order
from seedslib.extra import to_js
from seedslib.extra.c.source import function
from seedslib.extra.c.tape import Tape
from seedslib.extra.js.module import _HELPERS
from seedslib.extra.js.translation import Translation
from seedslib.filters import CovarianceFilter, assumed_density, extended_kalman, unscented_kalman
from seedslib.linearization import ExactGaussian, GaussHermite, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

NODE = shutil.which("node")
pytestmark = [
    pytest.mark.skipif(NODE is None, reason="no node"),
    pytest.mark.filterwarnings("ignore:paths:UserWarning"),
    pytest.mark.filterwarnings("ignore:y. the axes:UserWarning"),
    pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning"),
]

a, b, u, v, w = sympy.symbols("a b u v w", real=True)
LENGTH = 300

RUN = """
import * as filter from './made.mjs';
import { readFileSync } from 'fs';
const { times, y, told } = JSON.parse(readFileSync('data.json', 'utf8'));
const numbers = { nan: NaN, inf: Infinity, '-inf': -Infinity };
const read = (x) => typeof x === 'string' ? numbers[x] : x;
const words = (x) => Number.isFinite(x) ? x : Number.isNaN(x) ? 'nan' : x > 0 ? 'inf' : '-inf';
const state = filter.init(), found = [];
for (let k = 0; k < y.length; k++) {
  const given = [y[k].map(read)];
  if (process.argv[2] === 'timed') given.unshift(times[k]);
  if (told) given.push(told[k]);
  const code = filter.step(state, ...given);
  const said = [code, ...state.mean, ...state.cov, state.loglik, state.mode ?? 0];
  found.push(said.map(words));
}
const ahead = filter.forecast ? Array.from(filter.forecast(state, times[y.length]) ?? []) : [];
console.log(JSON.stringify([found, ahead.map(words)]));
"""


def plain(value):
    """Numbers for JSON, those that are not finite as words."""
    if isinstance(value, float | int):
        return value if math.isfinite(value) else str(value)
    return [plain(part) for part in value]


def by_node(folder, filter, times, y, told=None, ahead=0.0):
    """Codes, means, covariances, likelihoods, modes and a forecast, by node."""
    to_js(filter, folder / "made.mjs")
    data = {"times": [*map(float, times), float(ahead)], "y": plain(y.tolist())}
    data["told"] = None if told is None else told.tolist()
    (folder / "data.json").write_text(json.dumps(data))
    (folder / "run.mjs").write_text(RUN)
    timed = [] if getattr(filter, "memory", None) is not None else ["timed"]
    done = subprocess.run(
        [NODE, "run.mjs", *timed], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    rows, forecast = json.loads(done.stdout)
    found = np.array([[float(x) for x in row] for row in rows])
    n = round(math.sqrt(found.shape[1] - 3 + 0.25) - 0.5)
    cov = found[:, 1 + n : -2].reshape(-1, n, n)
    return found[:, 0], found[:, 1 : 1 + n], cov, found[:, -2], found[:, -1], np.array(forecast)


def walk():
    return DiscreteSystem(
        StochasticMap((a, b), [0.9 * a + b, 0.7 * b + v], Noise((v,), cov=[[0.1]])),
        StochasticMap(
            (a, b), [sympy.sin(a) + a + w, sympy.atan2(b, 3 + a**2) + u], Noise((w, u))
        ),
        [0.0, 0.1], 0.5 * np.eye(2),
    )  # fmt: skip


def lasting(**options):
    system = options.pop("system", zoo.van_der_pol)()
    memory, rule = options.pop("memory", Memory(1)), options.pop("rule", ExactGaussian())
    times = np.arange(12.0) * options.pop("interval", 0.5)
    made = synthesize(system, memory, rule, times, paths=800, seed=1, **options)
    return stationary(made, tolerance=5.0, paths=100, cycle=2)


def tables():
    made = grid_synthesis(
        zoo.flip_process(), large_order(2), 0.25 * np.arange(12.0), x=(-3.5, 3.5, 61),
        z=(-2.5, 2.5, 13), y=(-8, 8, 25), nodes=2,
    )  # fmt: skip
    return stationary(made, tolerance=1.0, paths=200)


FILTERS = {
    "designed": lasting,
    "designed, polynomial": lambda: lasting(predictor=Polynomial(3, 2)),
    "designed, continuous": lambda: lasting(
        system=zoo.linear_gaussian, rule=Taylor(), predictor=Continuous(), step=0.1
    ),
    "table": tables,
    "extended": lambda: extended_kalman(walk()),
    "assumed density": lambda: assumed_density(zoo.van_der_pol(), step=0.05),
    "unscented": lambda: unscented_kalman(walk()),
    "Gauss-Hermite": lambda: CovarianceFilter(walk(), GaussHermite(9)),
    "IMM": lambda: SwitchingFilter(zoo.manoeuvring_target(), Taylor()),
    "switching, designed": lambda: lasting(
        system=zoo.scalar_switching, memory=large_order(2), interval=1.0
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FILTERS)
def test_many_steps(name, tmp_path):
    filter = FILTERS[name]()
    carried = getattr(filter, "memory", None) is None
    times = 0.5 * np.arange(LENGTH + 1.0)
    if not carried:
        times = np.array([filter.clock.moment(k, filter.cycle) for k in range(LENGTH + 1)])
    data = filter.system.simulate(times[:LENGTH], 1, 2)
    y, told = data.measurements[..., 0].copy(), data.indicators
    y[[3, 200]] = np.nan
    y[9] = 60.0  # absurd, where the filter has been told so far what it knows
    options = {} if told is None else {"indicators": told[:, 0]}
    more = {"covariances": True} if "covariances" in filter.takes else {}
    wanted = filter.run(times[:LENGTH], y, **options, **more)
    told = None if told is None else told[:, 0]
    codes, mean, cov, loglik, modes, ahead = by_node(
        tmp_path, filter, times[:LENGTH], y, told, times[LENGTH]
    )
    assert not codes.any()
    near(mean, wanted.mean)
    near(cov, wanted.cov)
    if wanted.loglik is not None:
        near(loglik, wanted.loglik)
    if wanted.modes is not None:
        assert np.array_equal(modes, wanted.modes)
    if not carried and hasattr(filter, "between") and wanted.modes is None:
        longer = np.concatenate([y, np.full_like(y[:1], np.nan)])
        if name == "table":
            near(ahead, filter.run(times, longer).mean[-1])
        else:
            assert np.isfinite(ahead).all()


def near(found, wanted, part=1e-8):
    lost = ~np.isfinite(wanted)
    assert np.array_equal(np.isnan(wanted), np.isnan(found))
    size = np.abs(np.where(lost, 0.0, wanted)).max()
    np.testing.assert_allclose(found[~lost], wanted[~lost], rtol=part, atol=part * size)


def test_what_is_refused_leaves_the_state(tmp_path):
    filter = extended_kalman(walk())
    y = np.array([[1.0, 0.1], [np.inf, 0.1], [0.5, 0.2]])
    codes, mean, *_ = by_node(tmp_path, filter, [0.0, 1.0, 1.0], y)
    assert codes.tolist() == [0, 2, 0]
    assert np.array_equal(mean[0], mean[1])
    alone = filter.run([0.0, 1.0], y[[0, 2]]).mean
    np.testing.assert_allclose(mean[[0, 2]], alone, rtol=1e-12)
    codes, *_ = by_node(tmp_path, filter, [0.0, 1.0, 0.5], np.ones((3, 2)))
    assert codes.tolist() == [0, 0, 4]
    imm = SwitchingFilter(zoo.manoeuvring_target(), Taylor())
    codes, *_ = by_node(tmp_path, imm, [0.0, 1.0], np.ones((2, 1)), np.array([0, 5]))
    assert codes.tolist() == [0, 5]


def test_several_states_at_once(tmp_path):
    """Steps of two states in turn, and a copy, are those of each alone."""
    to_js(extended_kalman(walk()), tmp_path / "made.mjs")
    (tmp_path / "run.mjs").write_text("""
import { init, step } from './made.mjs';
const one = init(), other = init(), y = [[1, 0.1], [0.5, 0.4], [0.2, -0.3]];
let kept;
for (let k = 0; k < 3; k++) {
  step(one, k, y[k]);
  if (k === 1) kept = one.copy();
  step(other, k, y[2 - k]);
}
step(kept, 2, y[2]);
const alone = [init(), init()];
for (let k = 0; k < 3; k++) step(alone[0], k, y[k]);
for (let k = 0; k < 3; k++) step(alone[1], k, y[2 - k]);
const told = [one, kept, alone[0], other, alone[1]].map((s) => [...s.mean, ...s.cov, s.loglik]);
console.log(JSON.stringify(told));
""")
    done = subprocess.run([NODE, "run.mjs"], cwd=tmp_path, capture_output=True, text=True)
    one, kept, first, other, second = json.loads(done.stdout)
    assert one == kept == first != other == second


def test_whole_records(tmp_path):
    """`run` finds what steps find, into room of its own or given, and says what was refused."""
    to_js(extended_kalman(walk()), tmp_path / "made.mjs")
    (tmp_path / "run.mjs").write_text("""
import { init, step, run, rows } from './made.mjs';
const y = [1, 0.1, 0.5, NaN, 0.2, -0.3], alone = { mean: [], cov: [], loglik: [] }, one = init();
for (let k = 0; k < 3; k++) {
  step(one, k, y.slice(2 * k, 2 * k + 2));
  for (const name in alone) alone[name].push(one[name]);
}
const room = rows(3), given = run(init(), [0, 1, 2], y, room), own = run(init(), [0, 1, 2], y);
let said = '';
try { run(init(), [1, 0], [1, 1, 2, 2]); } catch (error) { said = error.message; }
const flat = (found) => [...found.mean].flat().concat([...found.cov].flat(), [...found.loglik]);
console.log(JSON.stringify([given === room, said, flat(alone), flat(room), flat(own)]));
""")
    done = subprocess.run([NODE, "run.mjs"], cwd=tmp_path, capture_output=True, text=True)
    same, said, alone, room, own = json.loads(done.stdout)
    assert same
    assert said == "measurement 1: refused with code 4"
    assert alone == room == own
    assert len(alone) == 3 * 7


LOOPS = """
static int triangle(const double *x, double *out)
{
    int i, j, k, found = 0;
    for (i = 0, k = 0; i < 3; i++) for (j = 0; j <= i; j++, k++) out[k] += x[i] * x[j];
    for (i = 0, k = 0; i < 3; i++) if (x[i] > 1.5) for (j = 0; j < 2; j++, k++) found += k;
    for (i = 2; i >= 0; i--) { if (x[i] < 2.5) continue; found += 100 * i; }
    for (i = 0; i < 3; i++) if (x[i] > 1.5) break;
    found += 1000 * i;
    for (i = 0; i < 3; i++) { const double y = 2.0 * x[i]; out[6 + i] = y; }
    found += 10000 * i + 100000 * (1 + 2 * 3 / 2);
    for (i = 0; i < 20; i++) found += 1000000;
    for (j = 0; j < 2; j++) { found += 100000000 * k; k = 5; }
    return found;
}
static double share(int count, double *out) { out[count - 1] = 7.0; return 1.0 / count; }
static double both(double *out) { return share(4, out) + share(2, out + 4); }
"""


def test_loops_that_are_written_out(tmp_path):
    """Loops of few passes are as in C: their counters, those of others, and what ends them."""
    made = Translation(LOOPS)
    x, out = made.size, made.size + 3
    code = "\n".join(
        [f"const H = new Float64Array({out + 9});", f"H.set([1, 2, 3], {x});", *made.lines]
    )
    code += f"\nconst said = triangle({x}, {out}), found = Array.from(H.slice({out}));\n"
    code += (
        f"console.log(JSON.stringify([said, ...found, both({out}), H[{out + 3}], H[{out + 5}]]))"
    )
    (tmp_path / "loops.mjs").write_text(code)
    done = subprocess.run([NODE, "loops.mjs"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    # k is 4 behind its loop, 5 behind the first pass of the last one
    assert found[0] == (0 + 1 + 2 + 3) + 200 + 1000 + 30000 + 400000 + 20000000 + 100000000 * 9
    assert found[1:10] == [1, 2, 4, 3, 6, 9, 2, 4, 6]
    assert found[10:] == [0.75, 7, 7]
    triangle, shares = "\n".join(made.lines).split("function share$4")
    assert triangle.count("for (") == 5
    assert "share$2" in shares


def test_error_functions(tmp_path):
    x = np.linspace(-6.0, 6.0, 241)
    code = "\n".join(_HELPERS[name] for name in ("erf", "erfc", "tail"))
    code += f"\nconsole.log(JSON.stringify({x.tolist()}.map((x) => [erf(x), erfc(x)])));\n"
    (tmp_path / "e.mjs").write_text(code)
    done = subprocess.run([NODE, "e.mjs"], cwd=tmp_path, capture_output=True, text=True, check=True)
    found = np.array(json.loads(done.stdout))
    np.testing.assert_allclose(found[:, 0], special.erf(x), rtol=4e-15, atol=1e-300)
    np.testing.assert_allclose(found[:, 1], special.erfc(x), rtol=1e-13)


def test_what_ecmascript_has_not_is_refused():
    tape = Tape()
    (x,) = tape.inputs("x[{}]", 1)
    from scipy.special import gammaln

    lines = tape.body({"x[0]": gammaln(x)})
    with pytest.raises(ValueError, match="functions that ECMAScript has, got lgamma"):
        Translation(function("void f(double *x)", lines))
    with pytest.raises(ValueError, match="wanted exported C, got '@"):
        Translation("static int f(void) { @ }")


def test_equal_filters_give_equal_text(tmp_path):
    filter = extended_kalman(walk())
    text = to_js(filter, tmp_path / "a.mjs")
    assert (tmp_path / "a.mjs").read_text() == text == to_js(extended_kalman(walk()))
    assert "import " not in text
