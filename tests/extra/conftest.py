"""Headers compiled with the compiler of the system, strictly, and called from Python."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from seedslib.extra import to_c

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic"]
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


SWITCHED = """
#include "NAME.h"
int record(int count, const double *t, const double *y, const int *told, double *mean, double *cov,
           double *loglik, double *prob, int *mode)
{
    NAME_state s;
    int k, code;
    (void)t; (void)told; (void)prob;
    NAME_init(&s);
    for (k = 0; k < count; k++) {
        code = NAME_step(&s, TIME y + k * BIG_MEASUREMENT TOLD);
        if (code != BIG_OK) return code;
        memcpy(mean + k * BIG_ESTIMATE, s.mean, sizeof s.mean);
        memcpy(cov + k * BIG_ESTIMATE * BIG_ESTIMATE, s.cov, sizeof s.cov);
        loglik[k] = s.loglik;
        mode[k] = s.mode;
        PROB
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


class Switched:
    """A filter with modes in C that runs the records of an array (K+1, m, N)."""

    def __init__(self, library, filter):
        self.library, self.filter = library, filter

    def run(self, times, y, told=None):
        """Means, covariances, likelihoods, probabilities and modes, the batch axis last."""
        count, _, paths = y.shape
        n, modes = getattr(self.filter, "components", 0), self.filter.system.modes
        n = n or self.filter.system.state_size
        mean, cov = np.empty((paths, count, n)), np.empty((paths, count, n, n))
        loglik, prob = np.empty((paths, count)), np.full((paths, count, modes), np.nan)
        mode, times = np.empty((paths, count), np.intc), np.ascontiguousarray(times, dtype=float)
        for i in range(paths):
            shown = np.ascontiguousarray(y[..., i])
            seen = np.zeros(count, np.intc) if told is None else told[:, i].astype(np.intc)
            whole = [part.ctypes.data_as(ctypes.POINTER(ctypes.c_int)) for part in (seen, mode[i])]
            parts = map(pointer, (mean[i], cov[i], loglik[i], prob[i]))
            code = self.library.record(
                count, pointer(times), pointer(shown), whole[0], *parts, whole[1]
            )
            if code:
                return code
        return tuple(np.moveaxis(part, 0, -1) for part in (mean, cov, loglik, prob, mode))


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
        switched = hasattr(filter.system, "modes")
        source = CARRIED if carried else SWITCHED if switched else DESIGNED
        source = source.replace("NAME", name)
        source = source.replace("TIME", "t[k]," * ("double t, const double *y" in text))
        source = source.replace("TOLD", ", told[k]" * ("int indicator" in text))
        given = "memcpy(prob + k * BIG_MODES, s.prob, sizeof s.prob);"
        source = source.replace("PROB", given * ("prob[" in text))
        if "_ESTIMATE " not in text:
            source = source.replace("ESTIMATE", "STATE")
        source = source.replace("BIG", name.upper())
        key = (text, source, *more)
        if key not in libraries:
            libraries[key] = ctypes.CDLL(str(compile_c(folder, source, more=more)))
        if switched:
            return Switched(libraries[key], filter)
        return Compiled(libraries[key], filter, carried)

    return make


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory):
    """A cache of the tests' own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield
