"""C, `compiled` and JavaScript of each kind of filter against the filter in Python."""

import json
import math
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from export.exported_filters import FILTERS, PATHS, case, near
from seedslib.export import compiled, to_c, to_js

COMPILER, NODE = shutil.which("cc"), shutil.which("node")
pytestmark = [
    pytest.mark.skipif(COMPILER is None, reason="no C compiler called cc"),
    pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning"),
]
STRICT = "-std=c99 -Wall -Wextra -Wconversion -Wshadow -Wstrict-prototypes -Wmissing-prototypes"
STRICT = f"{STRICT} -Wdouble-promotion -Werror -pedantic -ffp-contract=off".split()
SANITIZED = ["-g0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
NAMES = list(FILTERS)


def step(filter, one, state, k, i):
    """The state after measurement k of record i, or of all records with a slice for i."""
    t, y = one.times[k], one.y[k, :, i]
    if one.inputs and one.carried:  # they may change at each measurement
        state = filter.predict(state, t, inputs=one.at(max(k - 1, 0), i))
        return filter.correct(state, y, inputs=one.at(k, i))
    return filter.step(state, t, y, *(() if one.indicators is None else (one.indicators[k, i],)))


def numbers(found):
    """Estimates of one record as one list of numbers; the likelihood is NaN where there is none."""
    loglik = np.nan if found.loglik is None else found.loglik
    parts = [found.mean, np.ravel(found.cov), [loglik]]
    parts += [] if found.modes is None else [[found.modes]]
    return np.concatenate(parts + ([] if found.mode_prob is None else [found.mode_prob]))


def by_steps(filter, one, i=0):
    """What a filter finds in record i step by step, in one list."""
    state, found = filter.initial(), []
    for k in range(len(one.times)):
        state = step(filter, one, state, k, i)
        found.append(numbers(filter.report(state)))
    return np.concatenate(found)


# C: all filters in one program, which runs a record of one of them.

RECORD = """
#include "@name.h"
static void @name_record(int count)
{
    double y[@NAME_MEASUREMENT], bad[@NAME_MEASUREMENT], u[@INPUTS], held[@INPUTS];
    @name_state s, kept;
    int i, k, told;
    @name_init(&s);
    for (k = 0; k < count; k++) {
        const double t = get();
        for (i = 0; i < @NAME_MEASUREMENT; i++) bad[i] = y[i] = get();
        memcpy(held, u, sizeof u);
        for (i = 0; i < @INPUTS; i++) u[i] = get();
        told = (int)get();
        bad[@NAME_MEASUREMENT - 1] = -HUGE_VAL;
        memcpy(&kept, &s, sizeof s);
        want(@name_step(&s, @TIMEbad@TOLD@NOW), @NAME_INFINITE, 80);
        want(memcmp(&kept, &s, sizeof s), 0, 81);
        @STEP
        for (i = 0; i < @NAME_ESTIMATE; i++) put(s.mean[i]);
        for (i = 0; i < @NAME_ESTIMATE * @NAME_ESTIMATE; i++) put((&s.cov[0][0])[i]);
        put(s.loglik);
        @MODES
        (void)t; (void)told;
    }
    @LAST
}
"""
MAIN = """
#include <stdio.h>
#include <stdlib.h>
static double get(void)
{
    double x;
    if (fread(&x, sizeof x, 1, stdin) != 1) exit(99);
    return x;
}
static void put(double x) { if (fwrite(&x, sizeof x, 1, stdout) != 1) exit(98); }
static void want(int code, int wanted, int place) { if (code != wanted) exit(place + code); }
@RECORDS
int main(void)
{
    const int which = (int)get(), count = (int)get();
    switch (which) {
@CASES    default: return 97;
    }
    return 0;
}
"""


def record_in_c(name, text):
    """C that runs a record with a header, and tries what each step must refuse."""
    inputs = re.search(r"#define \w+_INPUTS (\d+)", text)
    timed = f" {name}_step({name}_state *s, double time" in text
    step, last = "want(@name_step(&s, @TIMEy@TOLD@NOW), @NAME_OK, 100);", ""
    if timed:
        last = "want(@name_step(&s, -1e6, y@TOLD@NOW), @NAME_TIME, 82);"
    elif f"{name.upper()}_CYCLE" not in text:
        last = "want(@name_step(&s, y@TOLD), @NAME_END, 83);"
    if "int indicator" in text:
        last = last.replace("@TOLD", ", -1")
        last += (
            "\n    for (i = 0; i < @NAME_MEASUREMENT; i++) y[i] = (double)NAN;\n    @name_init(&s);"
        )
        for told in ("@NAME_INDICATORS", "-2"):
            last += f" want(@name_step(&s, @LATERy, {told}), @NAME_RANGE, 84);"
    if f" {name}_predict(" in text:  # the halves at every other time
        halves = "want(@name_predict(&s, t@HELD), @NAME_OK, 110);"
        halves += " want(@name_correct(&s, y@U), @NAME_OK, 120);"
        step = f"if (k % 2) {{ {step} }} else {{ {halves} }}"
        last += " want(@name_predict(&s, (double)NAN@HELD), @NAME_TIME, 88);"
        last += " @name_init(&s); want(@name_correct(&s, y@U), @NAME_TIME, 89);"
    if inputs:
        last += " want(@name_step(&s, 9.0, y, u, NULL), @NAME_UNTOLD, 90);"
    modes = "put(s.mode);" if "int mode;" in text else ""
    if " prob[" in text:
        modes += " for (i = 0; i < @NAME_MODES; i++) put(s.prob[i]);"
    marks = {"@STEP": step, "@MODES": modes, "@LAST": last, "@INPUTS": inputs[1] if inputs else "1"}
    marks |= {"@TOLD": ", told" * ("int indicator" in text), "@NOW": ", held, u" * bool(inputs)}
    marks |= {"@HELD": ", held" * bool(inputs), "@U": ", u" * bool(inputs)}
    marks |= {"@TIME": "t, " * timed, "@LATER": "9.0, " * timed}
    source = RECORD
    for mark, part in {**marks, "@NAME": name.upper(), "@name": name}.items():
        source = source.replace(mark, part)
    return source


def build(folder, names):
    """A program of several filters."""
    records, cases = "", ""
    for name in names:
        k = NAMES.index(name)
        records += record_in_c(f"f{k}", to_c(case(name).filter, folder / f"f{k}.h", name=f"f{k}"))
        cases += f"    case {k}: f{k}_record(count); break;\n"
    (folder / "main.c").write_text(MAIN.replace("@RECORDS", records).replace("@CASES", cases))
    line = [COMPILER, *STRICT, *SANITIZED, "main.c", "-o", "main", "-lm"]
    done = subprocess.run(line, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[:3000]
    return folder / "main"


def by_program(program, name, one):
    """What a program finds in the first record of a case."""
    inputs = inputs_of(one)
    given = [NAMES.index(name), len(one.times)]
    for k, t in enumerate(one.times):
        told = -1 if one.indicators is None else one.indicators[k, 0]
        given += [t, *one.y[k, :, 0], *(inputs[k] if one.inputs and one.carried else [0.0]), told]
    data = np.array(given, dtype=float).tobytes()
    done = subprocess.run([program], input=data, capture_output=True)
    assert (done.returncode, done.stderr) == (0, b"")
    return np.frombuffer(done.stdout)


def inputs_of(one):
    """Inputs of the first record, (times, inputs) in the order of their names."""
    return np.array([one.inputs[p][:, 0] for p in sorted(one.inputs, key=str)]).T


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    return build(tmp_path_factory.mktemp("c"), NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_c_equals_the_filter_and_is_clean_under_sanitizers(name, program):
    one = case(name)
    near(by_program(program, name, one), by_steps(one.filter, one))


@pytest.mark.parametrize("value", [1e300, -1e3, 60.0])
@pytest.mark.parametrize("name", NAMES)
def test_c_equals_the_filter_after_absurd_measurements(name, value, program):
    """Numbers that overflow, and what no mode explains: nothing of it is undefined in C.

    Of numbers beyond 1e50 rounding may have left nothing.
    """
    one = case(name)
    y = one.y.copy()
    y[3:5, 0] = np.where(np.isnan(y[3:5, 0]), np.nan, value)
    absurd = replace(one, y=y)
    with np.errstate(all="ignore"):
        wanted = by_steps(one.filter, absurd)
    found = by_program(program, name, absurd)
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(wanted))
    found, wanted = (np.where(abs(x) > 1e50, np.sign(x), x) for x in (found, wanted))
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_compiled_equals_the_filter(name, quick):
    """Step by step, in batches, and in whole records of many."""
    one = case(name)
    filter, twin = one.filter, compiled(one.filter)
    near(by_steps(twin, one, 1), by_steps(filter, one, 1))
    options = {"inputs": one.inputs or None, "indicators": one.indicators}
    if "covariances" in filter.takes:
        options["covariances"] = True
    wanted, found = (each.run(one.times, one.y, **options) for each in (filter, twin))
    for part, other in zip(found, wanted, strict=True):
        assert (part is None) == (other is None)
        if part is not None:  # a covariance may be common to all records
            other = other[..., None] if other.ndim < part.ndim else other
            near(part, np.broadcast_to(other, part.shape))
    threads = twin.run(one.times, one.y, **options, workers=2)
    np.testing.assert_array_equal(threads.mean, found.mean)
    state = twin.initial((PATHS,))
    for k in range(len(one.times)):
        state = step(twin, one, state, k, slice(None))
        near(state.mean, found.mean[k])


# JavaScript

RUN = """
import * as filter from './made.mjs';
import { readFileSync } from 'fs';
const names = { nan: NaN, inf: Infinity, '-inf': -Infinity }, found = [];
const read = (x) => typeof x === 'string' ? names[x] : x;
const { times, y, told, inputs } = JSON.parse(readFileSync('data.json', 'utf8'));
const state = filter.init(), rows = y.map((row) => row.map(read));
const record = [...(STEP.includes('time') ? [times] : []), rows.flat(), ...(told ? [told] : []),
  ...(inputs ? [inputs.flat()] : [])];
const whole = filter.run(filter.init(), ...record);
for (let k = 0; k < y.length; k++) {
  const given = [rows[k]];
  if (STEP.includes('time')) given.unshift(times[k]);
  if (told) given.push(told[k]);
  if (inputs) given.push(inputs[Math.max(k - 1, 0)], inputs[k]);
  const code = filter.step(state, ...given);
  if (code !== filter.OK) throw new Error(`step ${k}: code ${code}`);
  found.push(...state.mean, ...state.cov, state.loglik);
  const n = state.mean.length;
  state.mean.forEach((x, i) => {
    if (!Object.is(x, whole.mean[k * n + i])) throw new Error(`run: ${x} at ${k}`);
  });
  if (state.mode !== undefined) found.push(state.mode);
  if (state.prob !== undefined) found.push(...state.prob);
}
console.log(JSON.stringify(found.map((x) => Number.isFinite(x) ? x : `${x}`)));
"""


def for_json(value):
    """Lists of numbers, those that are not finite as words."""
    if isinstance(value, list):
        return [for_json(part) for part in value]
    return value if math.isfinite(value) else str(value)


@pytest.mark.skipif(NODE is None, reason="no node")
@pytest.mark.parametrize("name", NAMES)
def test_javascript_equals_the_filter(name, tmp_path):
    """Step by step; whole records have the same means."""
    one = case(name)
    text = to_js(one.filter, tmp_path / "made.mjs")
    data = {
        "times": one.times.tolist(),
        "y": for_json(one.y[..., 0].tolist()),
        "told": None if one.indicators is None else one.indicators[:, 0].tolist(),
        "inputs": inputs_of(one).tolist() if one.inputs and one.carried else None,
    }
    (tmp_path / "data.json").write_text(json.dumps(data))
    step = re.search(r"export function step\((.*)\)", text)[1].split(", ")
    (tmp_path / "run.mjs").write_text(f"const STEP = {step};" + RUN)
    done = subprocess.run([NODE, "run.mjs"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    near([float(x) for x in json.loads(done.stdout)], by_steps(one.filter, one))
