"""What `extra` refuses: the type of the error, and the argument that its message names."""

import sys
from importlib import reload

import numpy as np
import pytest
from sklearn.tree import DecisionTreeRegressor

from seedslib import zoo
from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.extra import cluster, learn, plot_estimates
from seedslib.filters import Estimates
from seedslib.linearization import Taylor
from systems import growth

CONSTANT = DecisionTreeRegressor(max_depth=2)


def learned(regressor=CONSTANT, times=range(2), memory=None, **options):
    options = {"paths": 60, "seed": 1, "regressor": regressor, **options}
    return learn(growth(), memory or Memory(1), times, **options)


def drawn(**options):
    found = Estimates(np.zeros((5, 2, 3)), np.zeros((5, 2, 2, 3)))
    return plot_estimates(**{"times": np.arange(5.0), "estimates": found, **options})


OTHERS = [
    (lambda: learned(3), TypeError, "regressor"),
    (lambda: learned(draws=0), ValueError, "draws"),
    (lambda: learned(sets=1), ValueError, "sets"),
    (lambda: learned(seed=1.5), TypeError, "seed"),
    (lambda: learned(memory=Memory(1, indicators=1)), ValueError, "memory"),
    (
        lambda: learn(zoo.scalar_switching(), Memory(1), range(2), paths=9, seed=1),
        TypeError,
        "system",
    ),
    (lambda: cluster(8786).__enter__(), TypeError, "scheduler"),
    (lambda: cluster("nothing://127.0.0.1:9").__enter__(), ValueError, "scheduler"),
    (
        lambda: synthesize(
            growth(), Memory(1), Taylor(), range(3), paths=200, seed=1, workers="tcp:"
        ),
        TypeError,
        "workers",
    ),
    (lambda: drawn(times=np.arange(4.0)), ValueError, "times"),
    (lambda: drawn(names=["a"]), ValueError, "names"),
    (lambda: drawn(record=4), ValueError, "record"),
    (lambda: drawn(measurements={2: np.zeros(5)}), ValueError, "measurements"),
    (lambda: drawn(axes=[None]), ValueError, "axes"),
]


@pytest.mark.filterwarnings("ignore:paths:UserWarning", "ignore:held out:UserWarning")
@pytest.mark.parametrize(("call", "error", "argument"), OTHERS)
def test_a_refusal_names_the_argument(call, error, argument):
    with pytest.raises(error, match=rf"^({argument})\b"):
        call()


@pytest.mark.parametrize(
    ("package", "extra", "use"),
    [
        ("distributed", "cluster", lambda: reload(sys.modules["seedslib.extra.dask_crew"])),
        ("matplotlib", "plots", lambda: plot_estimates([0.0], Estimates(np.zeros((1, 1)), None))),
        ("pandas", "tables", lambda: Estimates(np.zeros((1, 1)), None).to_dataframe([0.0])),
        (
            "sklearn.ensemble",
            "learn",
            lambda: learn(growth(), Memory(1), range(2), paths=9, seed=1),
        ),
    ],
)
def test_a_package_that_is_not_there_is_named_with_its_extra(monkeypatch, package, extra, use):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"^{package.partition('.')[0]}: .*seedslib\[{extra}\]"):
        use()
