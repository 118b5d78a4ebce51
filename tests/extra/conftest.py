"""Headers compiled with the compiler of the system, strictly, and called from Python."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from seedslib.extra import to_c

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
FLAGS = [*STRICT, "-O1", "-ffp-contract=off", "-shared", "-fPIC"]

DESIGNED = """
#include "NAME.h"
int record(int count, const double *y, double *mean, double *cov, double *loglik, double *nodes)
{
    NAME_state s;
    int k, code, many;
    NAME_init(&s);
    for (k = 0; k < count; k++) {
        code = NAME_step(&s, y + k * BIG_MEASUREMENT);
        if (code != BIG_OK) return code;
        memcpy(mean + k * BIG_ESTIMATE, s.mean, sizeof s.mean);
        memcpy(cov + k * BIG_ESTIMATE * BIG_ESTIMATE, s.cov, sizeof s.cov);
        loglik[k] = s.loglik;
        many = NAME_nodes(&s, nodes);
        nodes += many * BIG_ESTIMATE;
    }
    return BIG_OK;
}
int forecast(int count, const double *y, double t, double *out)
{
    NAME_state s;
    int k;
    NAME_init(&s);
    for (k = 0; k < count; k++) NAME_step(&s, y + k * BIG_MEASUREMENT);
    return NAME_forecast(&s, t, out);
}
"""

CARRIED = """
#include "NAME.h"
int record(int count, const double *t, const double *y, double *mean, double *cov, double *loglik)
{
    NAME_state s;
    int k, code;
    NAME_init(&s);
    for (k = 0; k < count; k++) {
        code = NAME_step(&s, t[k], y + k * BIG_MEASUREMENT);
        if (code != BIG_OK) return code;
        memcpy(mean + k * BIG_STATE, s.mean, sizeof s.mean);
        memcpy(cov + k * BIG_STATE * BIG_STATE, s.cov, sizeof s.cov);
        loglik[k] = s.loglik;
    }
    return BIG_OK;
}
"""


def pointer(array):
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


class Compiled:
    """A filter in C that runs the records of an array (K+1, m, N)."""

    def __init__(self, library, filter, carried):
        self.library, self.filter, self.carried = library, filter, carried

    def run(self, times, y):
        """Means, covariances, likelihoods, node forecasts, each with the batch axis last."""
        rows = self.filter.n if self.carried else self.filter.components
        nodes, most = 0, 0
        if not self.carried:
            nodes = sum(map(len, self.filter.node_times))
            most = max(map(len, self.filter.node_times), default=0)
        count, paths = len(y), y.shape[2]
        mean, cov = np.empty((paths, count, rows)), np.empty((paths, count, rows, rows))
        loglik, ahead = (
            np.empty((paths, count)),
            np.full((paths, nodes + most * count + 1, rows), np.nan),
        )
        times = np.ascontiguousarray(times, dtype=float)
        for i in range(paths):
            shown = np.ascontiguousarray(y[..., i])
            given = [pointer(shown), pointer(mean[i]), pointer(cov[i]), pointer(loglik[i])]
            if self.carried:
                code = self.library.record(count, pointer(times), *given)
            else:
                code = self.library.record(count, *given, pointer(ahead[i]))
            assert code == 0
        back = (np.moveaxis(part, 0, -1) for part in (mean, cov, loglik, ahead[:, :nodes]))
        return tuple(back)

    def refused(self, y, times=None):
        """What the first refused step of one record (K+1, m) returns; zero where none was."""
        size = 64 * len(y)
        spare = [np.empty(size) for _ in range(4)]
        shown = np.ascontiguousarray(y, dtype=float)
        if self.carried:
            times = np.ascontiguousarray(times, dtype=float)
            given = [pointer(times), pointer(shown), *map(pointer, spare[:3])]
        else:
            given = [pointer(shown), *map(pointer, spare)]
        return self.library.record(len(y), *given)

    def forecast(self, y, t):
        """Forecast at a time after the measurements (k+1, m) of one record, or the code."""
        shown, out = np.ascontiguousarray(y), np.empty(self.filter.components)
        self.library.forecast.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_double,
                                          ctypes.c_void_p]  # fmt: skip
        code = self.library.forecast(len(y), shown.ctypes.data, t, out.ctypes.data)
        return out if code == 0 else code


def compile_c(folder, source, name="library", more=(), fails=False):
    """Path of the library made of a C text; what the compiler says where it is to fail."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler: wanted one called cc")
    (folder / f"{name}.c").write_text(source)
    command = [compiler, *FLAGS, *more, f"{name}.c", "-o", f"{name}.so", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert (done.returncode != 0) == fails, done.stderr
    return done.stderr if fails else folder / f"{name}.so"


@pytest.fixture
def build():
    return compile_c


@pytest.fixture(scope="session")
def compiled(tmp_path_factory):
    """A factory: filter to its C, compiled without a single warning."""

    libraries = {}

    def make(filter, name="made", more=()):
        folder = tmp_path_factory.mktemp("c")
        text = to_c(filter, folder / f"{name}.h", name=name)
        carried = hasattr(filter, "integrator")
        source = (CARRIED if carried else DESIGNED).replace("NAME", name)
        source = source.replace("BIG", name.upper())
        key = (text, source, *more)
        if key not in libraries:
            libraries[key] = ctypes.CDLL(str(compile_c(folder, source, more=more)))
        return Compiled(libraries[key], filter, carried)

    return make
