"""``seedslib filter`` and ``fit`` of models that are told inputs."""

import numpy as np
import pytest

from seedslib.commands.cli import main

MODEL = """
import sympy as sp
from seedslib.base import Input, Parameter
from seedslib.models import DiscreteSystem, Noise, StochasticMap
x, v, w = sp.symbols("x v w")
u, b, r = Input("u"), Parameter("b", 2.0), Parameter("r", 1.0, positive=True)
system = DiscreteSystem(
    StochasticMap((x,), [x + b * u + v], Noise((v,), cov=[[.5]])),
    StochasticMap((x,), [x + u + sp.sqrt(r) * w], Noise((w,))), [1], [[3]],
)
"""
Y, U = [1.5, np.nan, -0.25, 2.0], [0.5, 1.0, -2.0, 0.25]
EKF = ["--kind", "extended_kalman"]
NAMED = ["--inputs", "u=heat"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.py").write_text(MODEL)
    rows = [
        f"{k},{'' if np.isnan(y) else y},{u}" for k, (y, u) in enumerate(zip(Y, U, strict=True))
    ]
    (tmp_path / "d.csv").write_text("\n".join(["t,y1,heat", *rows]) + "\n")


@pytest.mark.parametrize("options", [[], ["--time", "t"], ["--columns", "y1"]])
def test_inputs_move_the_state_and_shift_the_measurement(read, options):
    arguments = ["filter", "m.py", "d.csv", *EKF, *NAMED, *options, "--level", ".95"]
    assert main([*arguments, "--out", "x.csv"]) == 0
    names, *rows = read("x.csv")
    table = np.array(rows, dtype=float)
    m, p, wanted = 1.0, 3.0, []
    for k, (y, u) in enumerate(zip(Y, U, strict=True)):
        if k:
            m, p = m + 2 * U[k - 1], p + 0.5
        expected = m + u
        if np.isfinite(y):
            m, p = m + p / (p + 1) * (y - expected), p / (p + 1)
        wanted.append([m, np.sqrt(p), expected])
    found = table[:, [names.index(c) for c in ("x1", "sd1", "y1")]]
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    assert main([*arguments[:-2], "--smooth", "--out", "s.csv"]) == 0
    assert read("s.csv")[-1][:3] == read("x.csv")[-1][:3]
    assert main(["fit", "m.py", "d.csv", *EKF, *NAMED, "--free", "b", "--set", "r=1"]) in (0, 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "inputs: wanted u=COLUMN, those of the model; got None"),
        (["--inputs", "u=heat,v=y1"], "inputs: wanted u=COLUMN"),
        (["--inputs", "u=cold"], "wanted one column called cold, got t,y1,heat"),
        ([*NAMED, "--forecast", "2"], "forecast: wanted rows without measurements in the table"),
    ],
)
def test_inputs_that_are_refused(capsys, refused, options, message):
    told = refused(capsys, main, "filter", "m.py", "d.csv", *EKF, *options, "--out", "x.csv")
    assert message in told
