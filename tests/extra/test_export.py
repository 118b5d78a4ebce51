"""C, `compiled` and JavaScript of each kind of filter against the filter in Python."""

import json
import math
import re
import shutil
import subprocess

import numpy as np
import pytest

from extra.exported_filters import FILTERS, PATHS, case, near
from seedslib.extra import compiled, to_c, to_js

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
        with one.at(max(k - 1, 0), i):
            state = filter.predict(state, t)
        with one.at(k, i):
            return filter.correct(state, y)
    return filter.step(state, t, y, *(() if one.indicators is None else (one.indicators[k, i],)))


def numbers(found):
    """Estimates of one record as one list of numbers; the likelihood is NaN where there is none."""
    loglik = np.nan if found.loglik is None else found.loglik
    parts = [found.mean, np.ravel(found.cov), [loglik]]
    parts += [] if found.modes is None else [[found.modes]]
    return np.concatenate(parts + ([] if found.mode_prob is None else [found.mode_prob]))


def by_steps(filter, one, i=0):
    """What a filter finds in record i step by step, and forecasts after each, in one list."""
    state, found = filter.initial(), []
    for k in range(len(one.times)):
        state = step(filter, one, state, k, i)
        found.append(numbers(filter.report(state)))
        with one.at(k, i):
            found += [filter.forecast(state, later).mean for later in one.later(k)]
    return np.concatenate(found)


# C: all filters in one program, which runs a record of one of them.

RECORD = """
#include "@name.h"
static void @name_record(int count)
{
    @REAL y[@NAME_MEASUREMENT], bad[@NAME_MEASUREMENT], now[@INPUTS], before[@INPUTS], out[64];
    @REAL none[@NAME_MEASUREMENT];
    @name_state s, ahead;
    int i, k, code, told, queries;
    memset(before, 0, sizeof before);
    memset(out, 0, sizeof out);
    for (i = 0; i < @NAME_MEASUREMENT; i++) none[i] = (@REAL)NAN;
    @name_init(&s);
    for (k = 0; k < count; k++) {
        const @REAL t = (@REAL)get();
        for (i = 0; i < @NAME_MEASUREMENT; i++) bad[i] = y[i] = (@REAL)get();
        for (i = 0; i < @INPUTS; i++) now[i] = (@REAL)get();
        told = (int)get();
        bad[@NAME_MEASUREMENT - 1] = (@REAL)-HUGE_VAL;
        memcpy(&ahead, &s, sizeof s);
        want(@name_step(&s, @TIMEbad@NOW@TOLD), @NAME_INFINITE, 80);
        want(memcmp(&ahead, &s, sizeof s), 0, 81);
        @STEP
        want(code, @NAME_OK, 100 + code);
        for (i = 0; i < @ROWS; i++) put((double)s.mean[i]);
        for (i = 0; i < @ROWS * @ROWS; i++) put((double)s.cov[i / @ROWS][i % @ROWS]);
        put((double)s.loglik);
        @MODES
        for (queries = (int)get(); queries > 0; queries--) {
            const @REAL when = (@REAL)get();
            @FORECAST
            want(code, @NAME_OK, 120 + code);
            for (i = 0; i < @ROWS; i++) put((double)out[i]);
        }
        memcpy(before, now, sizeof now);
        (void)t; (void)told; (void)none;
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
static void want(int code, int wanted, int place) { if (code != wanted) exit(place); }
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


def record_in_c(name, text, real):
    """C that runs a record with a header, and tries what each step must refuse."""
    inputs = re.search(r"#define \w+_INPUTS (\d+)", text)
    before, now = (", before", ", now") if inputs else ("", "")
    timed = f"{real} t, const {real} *y" in text
    whole = "code = @name_step(&s, @TIMEy@NOW@TOLD);"
    forecast, last = "code = @NAME_OK; (void)when;", ""
    if timed:
        last = "want(@name_step(&s, -1e6@F, y@NOW@TOLD), @NAME_TIME, 82);"
    elif f"{name.upper()}_CYCLE" not in text:
        last = "want(@name_step(&s, y@TOLD), @NAME_END, 83);"
    if "int indicator" in text:
        last = last.replace("@TOLD", ", -1")
        last += " told = @NAME_INDICATORS; memcpy(y, none, sizeof y); @name_init(&s);"
        last += " want(@name_step(&s, @LATERy@TOLD), @NAME_RANGE, 84);"
        last += " told = -2; want(@name_step(&s, @LATERy@TOLD), @NAME_RANGE, 85);"
    if f" {name}_forecast(" in text:
        forecast = "code = @name_forecast(&s, when, out);"
        last += " want(@name_forecast(&s, -1e6@F, out), @NAME_TIME, 86);"
        last += " want(@name_forecast(&s, 1e6@F, out), @NAME_TIME, 87);"
    if f" {name}_predict(" in text:
        halves = f"code = @name_predict(&s, t{before}); if (!code) code = @name_correct(&s, y@NOW);"
        whole = halves if inputs else f"if (k % 2) {{ {whole} }} else {{ {halves} }}"
        forecast = "ahead = s; code = @name_predict(&ahead, when@NOW);"
        forecast += " memcpy(out, ahead.mean, sizeof ahead.mean);"
        last += " want(@name_predict(&s, (@REAL)NAN@NOW), @NAME_TIME, 88);"
    if inputs:
        last += " want(@name_step(&s, 9.0, y, NULL), @NAME_UNTOLD, 89);"
    modes = "put((double)s.mode);" if "int mode;" in text else ""
    if " prob[" in text:
        modes += " for (i = 0; i < @NAME_MODES; i++) put((double)s.prob[i]);"
    rows = "@NAME_ESTIMATE" if "_ESTIMATE " in text else "@NAME_STATE"
    told = ", told" * ("int indicator" in text)
    marks = {"@STEP": whole, "@FORECAST": forecast, "@MODES": modes, "@LAST": last, "@TOLD": told}
    marks |= {"@TIME": "t, " * timed, "@LATER": "9.0@F, " * timed, "@NOW": now, "@REAL": real}
    marks |= {"@F": "F" * (real == "float"), "@INPUTS": inputs[1] if inputs else "1"}
    source = RECORD
    for mark, part in {**marks, "@ROWS": rows, "@NAME": name.upper(), "@name": name}.items():
        source = source.replace(mark, part)
    return source


def build(folder, names, real="double"):
    """A program of several filters, and the headers."""
    records, cases, headers = "", "", {}
    for name in names:
        k = NAMES.index(name)
        text = headers[name] = to_c(case(name).filter, folder / f"f{k}.h", name=f"f{k}", real=real)
        records += record_in_c(f"f{k}", text, real)
        cases += f"    case {k}: f{k}_record(count); break;\n"
    (folder / "main.c").write_text(MAIN.replace("@RECORDS", records).replace("@CASES", cases))
    line = [COMPILER, *STRICT, *SANITIZED, "main.c", "-o", "main", "-lm"]
    done = subprocess.run(line, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[:3000]
    return folder / "main", headers


def by_program(program, name):
    """What a program finds in the first record of a filter."""
    one = case(name)
    inputs = np.array([x[:, 0] for _, x in sorted(one.inputs.items(), key=lambda u: str(u[0]))])
    given = [NAMES.index(name), len(one.times)]
    for k, t in enumerate(one.times):
        told = -1 if one.indicators is None else one.indicators[k, 0]
        now = inputs[:, k] if one.inputs and one.carried else [0.0]
        later = one.later(k)
        given += [t, *one.y[k, :, 0], *now, told, len(later), *later]
    data = np.array(given, dtype=float).tobytes()
    done = subprocess.run([program], input=data, capture_output=True)
    assert (done.returncode, done.stderr) == (0, b"")
    return np.frombuffer(done.stdout)


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    return build(tmp_path_factory.mktemp("c"), NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_c_equals_the_filter_and_is_clean_under_sanitizers(name, program):
    found = by_program(program[0], name)
    near(found, by_steps(case(name).filter, case(name)))


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


FLOAT = ["extended", "unscented, all functions", "polynomial", "table", "modes and log-odds"]


@pytest.mark.filterwarnings("ignore:.*loses its digits")
def test_c_in_single_precision_is_near_the_filter_and_has_no_double(tmp_path):
    main, headers = build(tmp_path, FLOAT, real="float")
    for name, text in headers.items():
        one = case(name)
        found = by_program(main, name)
        wanted = by_steps(one.filter, one)
        assert np.array_equal(np.isnan(found), np.isnan(wanted))
        np.testing.assert_allclose(found, wanted, rtol=2e-3, atol=2e-3)
        assert np.nanmax(np.abs(found - wanted)) > 1e-9
        code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
        assert "double" not in code
        assert not re.search(r"\b(pow|sqrt|fabs|fmin|fmax|log|exp)\(", code)


# JavaScript

RUN = """
import * as filter from './made.mjs';
import { readFileSync } from 'fs';
const names = { nan: NaN, inf: Infinity, '-inf': -Infinity }, found = [];
const read = (x) => typeof x === 'string' ? names[x] : x;
const { times, y, told, later, timed, coded } = JSON.parse(readFileSync('data.json', 'utf8'));
const state = filter.init();
for (let k = 0; k < y.length; k++) {
  const given = [y[k].map(read)];
  if (timed) given.unshift(times[k]);
  if (coded) given.push(told[k]);
  const code = filter.step(state, ...given);
  if (code !== filter.OK) throw new Error(`step ${k}: code ${code}`);
  found.push(...state.mean, ...state.cov, state.loglik);
  if (state.mode !== undefined) found.push(state.mode);
  if (state.prob !== undefined) found.push(...state.prob);
  for (const t of later[k]) {
    if (timed) {
      const ahead = state.copy();
      filter.predict(ahead, t);
      found.push(...ahead.mean);
    } else found.push(...filter.forecast(state, t));
  }
}
console.log(JSON.stringify(found.map((x) => Number.isFinite(x) ? x : `${x}`)));
"""


def for_json(value):
    """Lists of numbers, those that are not finite as words."""
    if isinstance(value, list):
        return [for_json(part) for part in value]
    return value if math.isfinite(value) else str(value)


@pytest.mark.skipif(NODE is None, reason="no node")
@pytest.mark.parametrize("name", [name for name in NAMES if not name.endswith("inputs")])
def test_javascript_equals_the_filter(name, tmp_path):
    one = case(name)
    text = to_js(one.filter, tmp_path / "made.mjs")
    data = {
        "times": one.times.tolist(),
        "y": for_json(one.y[..., 0].tolist()),
        "told": None if one.indicators is None else one.indicators[:, 0].tolist(),
        "later": [one.later(k).tolist() for k in range(len(one.times))],
        "timed": "step(state, t, y" in text,
        "coded": "y, indicator)" in text,
    }
    (tmp_path / "data.json").write_text(json.dumps(data))
    (tmp_path / "run.mjs").write_text(RUN)
    done = subprocess.run([NODE, "run.mjs"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    near([float(x) for x in json.loads(done.stdout)], by_steps(one.filter, one))
