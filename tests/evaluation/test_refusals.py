"""What the evaluation of filters refuses, by type of error and by the name of the argument."""

import numpy as np
import pytest
import sympy

from seedslib.base import Parameter
from seedslib.evaluation import compare, evaluate, fit
from seedslib.filters import Estimates, KalmanFilter
from seedslib.models import LinearSystem
from seedslib.two_step import LinearDiffusion

Q, R = Parameter("q", 1.0, positive=True), Parameter("r", 0.5, positive=True)
ZERO = Parameter("z", 0.0, positive=True)
STILL = LinearSystem(1, ZERO, 1, R, 0, 1)
SYSTEM = LinearSystem(1, Q, 1, R, 0, 1)
KALMAN = KalmanFilter(SYSTEM)
TIMES, Y = np.arange(3.0), np.ones((3, 1))


class Zero:
    def run(self, times, measurements, **options):
        return Estimates(np.zeros((len(times), 1, measurements.shape[2])))


class Silent(KalmanFilter):
    def run(self, *arguments, **options):
        return super().run(*arguments, **options)._replace(loglik=None)


def compared(filters=None, system=SYSTEM, times=(0, 1), paths=10, seed=1, **options):
    filters = {"one": Zero()} if filters is None else filters
    return compare(filters, system, times, paths, seed, **options)


def fitted(free, filter=KALMAN, y=Y, **options):
    return fit(filter, TIMES, y, free, **options)


ROWS = [
    (lambda: compared({}), TypeError, "filters"),
    (lambda: compared([Zero()]), TypeError, "filters"),
    (lambda: compared({"a": 5}), TypeError, "a"),
    (lambda: evaluate(SYSTEM, KALMAN, TIMES, 5, 1), TypeError, "filter"),
    (lambda: compared(system=LinearDiffusion(-1, 0.5, 1, 0.1, 0, 4)), TypeError, "system"),
    (lambda: compared(paths=0), ValueError, "paths"),
    (lambda: compared(seed=None), TypeError, "seed"),
    (lambda: compared(times=[1, 0]), ValueError, "times"),
    (lambda: compared(components=2), ValueError, "components"),
    (lambda: compared(components=0), ValueError, "components"),
    (lambda: compared(measured=[5]), ValueError, "measured"),
    (lambda: compared(window=(6, 9)), ValueError, "window"),
    (lambda: compared(window=np.ones(5, bool)), ValueError, "window"),
    (lambda: compared(window=[7]), ValueError, "window"),
    (lambda: compared(inputs={Q: [0, 1]}), TypeError, "inputs"),
    (lambda: compared().to_dataframe(["a", "b"]), ValueError, "names"),
    (lambda: fitted([sympy.Symbol("q")]), TypeError, "free"),
    (lambda: fitted([]), TypeError, "free"),
    (lambda: fitted([Parameter("k", 1.0)]), ValueError, "free"),
    (lambda: fitted([Q], y=np.full((3, 1), 1e200)), ValueError, "free"),
    (
        lambda: fitted([ZERO], filter=KalmanFilter(LinearSystem(1, ZERO, 1, R, 0, 1))),
        ValueError,
        "z",
    ),
    (lambda: fitted([Q], filter=Silent(SYSTEM)), ValueError, "filter"),
    (lambda: fitted([Q], filter=lambda numbers: Silent(SYSTEM)), ValueError, "filter"),
]


@pytest.mark.parametrize(("call", "error", "name"), ROWS)
def test_wrong_arguments_are_refused_by_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()
