"""A time so far ahead that its steps have no end is refused in C and ECMAScript too."""

import ctypes
import json
import shutil
import subprocess

import numpy as np
import pytest

from seedslib import zoo
from seedslib.base.clock import MOST_STEPS
from seedslib.extra import to_c, to_js
from seedslib.filters import extended_kalman

NODE = shutil.which("node")
FAR = [1e12, 1e300, MOST_STEPS * 0.01 + 0.011]
TIME = 4  # the code of a time that is not where it should be


@pytest.fixture(scope="module")
def filter():
    return extended_kalman(zoo.van_der_pol())


def test_in_c(filter, build, tmp_path):
    text = to_c(filter, tmp_path / "f.h", name="f")
    assert "One more than 10000000 integration steps ahead is refused, the state as it was" in text
    source = (
        '#include "f.h"\nint far(double t, double *mean)\n{\n    f_state s, before;\n'
        "    int code;\n    double y[2] = {1.0, 2.0};\n    f_init(&s);\n    f_step(&s, 0.0, y);\n"
        "    before = s;\n"
        "    code = f_step(&s, t, y);\n    if (memcmp(&before, &s, sizeof s)) return -1;\n"
        "    f_predict(&s, 0.5);\n    memcpy(mean, s.mean, sizeof s.mean);\n    return code;\n}\n"
    )
    far, mean = ctypes.CDLL(str(build(tmp_path, source))).far, np.zeros(2)
    wanted = filter.step(filter.initial(), 0.0, np.array([1.0, 2.0]))
    wanted = filter.predict(wanted, 0.5).mean
    for t in FAR:
        code = far(ctypes.c_double(t), mean.ctypes.data_as(ctypes.c_void_p))
        assert code == TIME
        np.testing.assert_allclose(mean, wanted, rtol=1e-12)


@pytest.mark.skipif(NODE is None, reason="no node")
def test_in_ecmascript(filter, tmp_path):
    to_js(filter, tmp_path / "made.mjs")
    (tmp_path / "run.mjs").write_text(
        "import * as filter from './made.mjs';\n"
        "const state = filter.init();\nfilter.step(state, 0, [1, 2]);\n"
        "const before = JSON.stringify(state), codes = [];\n"
        f"for (const t of {json.dumps(FAR)}) codes.push(filter.step(state, t, [1, 2]));\n"
        "console.log(JSON.stringify([codes, before === JSON.stringify(state)]));\n"
    )
    done = subprocess.run(
        [NODE, "run.mjs"], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=60
    )
    assert json.loads(done.stdout) == [[TIME] * len(FAR), True]
