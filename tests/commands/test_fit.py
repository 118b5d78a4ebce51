"""``python -m seedslib fit``, and ``filter`` with what it has found."""

import json

import numpy as np
import pytest

from seedslib.base import Parameter
from seedslib.evaluation import fit
from seedslib.filters import KalmanFilter
from seedslib.models import LinearSystem

LEVEL = """
from seedslib.base import Parameter
from seedslib.models import LinearSystem
q, r = Parameter("q", .5, positive=True), Parameter("r", 2., positive=True)
system = LinearSystem(1, q, 1, r, 1, 3)
"""
TIMES = np.arange(60.0)


@pytest.fixture(autouse=True)
def record(folder):
    rng = np.random.default_rng(4)
    y = np.cumsum(rng.normal(size=60)) + rng.normal(size=60)
    rows = [f"{k},{float(value)!r}" for k, value in enumerate(y)]
    (folder / "walk.csv").write_text("\n".join(["t,y1", *rows]) + "\n")
    (folder / "level.py").write_text(LEVEL)
    return y[:, None]


def test_a_fit_equals_that_of_python_and_filters_with_its_values(run, folder, table, record):
    line = "level.py walk.csv --kind KalmanFilter"
    code, out, _ = run(f"fit {line} --out fit.json")
    q, r = (Parameter(name, value, positive=True) for name, value in (("q", 0.5), ("r", 2.0)))
    filter = KalmanFilter(LinearSystem(1, q, 1, r, 1, 3))
    wanted = fit(filter, TIMES, record, [q, r])
    assert code == 0
    assert out == f"{wanted}\nwritten to fit.json\n"
    found = json.loads((folder / "fit.json").read_text())
    assert found["values"] == dict(zip("qr", wanted.values.tolist(), strict=True))
    assert found["errors"] == dict(zip("qr", wanted.errors.tolist(), strict=True))
    assert (found["loglik"], found["converged"]) == (wanted.loglik, True)
    assert run(f"filter {line} --set fit.json --out x.csv")[0] == 0
    with wanted.assigned():
        mean = filter.run(TIMES, record).mean
    np.testing.assert_allclose(table("x.csv").numbers("x1"), mean, rtol=1e-14)
    alone = run(f"fit {line} --set q=.01")[1]
    assert " q " not in alone
    assert run(f"fit {line} --set q=.01 --free r")[1] == alone


def test_a_fit_without_information_does_not_converge(run, folder):
    (folder / "two.py").write_text(LEVEL.replace("(1, q, 1, r", "(1, q * r, 1, 1"))
    code, _, err = run("fit two.py walk.csv --kind KalmanFilter --out f.json")
    assert code == 1
    assert err.count("\n") == 1
    assert json.loads((folder / "f.json").read_text())["errors"] == {"q": None, "r": None}


@pytest.mark.filterwarnings("ignore:x. more than")
def test_a_grid_is_made_anew_for_each_value(run, folder):
    (folder / "few.csv").write_text("".join((folder / "walk.csv").open().readlines()[:16]))
    for kind in ("GridBayesFilter --grid x=-12:12:61", "KalmanFilter"):
        assert run(f"fit level.py few.csv --set q=1. --out {kind[0]}.json --kind {kind}")[0] == 0
    grid, exact = (json.loads((folder / f"{name}.json").read_text()) for name in "GK")
    assert grid["loglik"] == pytest.approx(exact["loglik"], abs=1e-3)
    assert grid["values"]["r"] == pytest.approx(exact["values"]["r"], rel=1e-2)
