"""``seedslib filter`` and ``fit`` with the filters of a model."""

import json
from pathlib import Path

import numpy as np
import pytest

from seedslib import designed, filters
from seedslib.base import assigned
from seedslib.base.tables import Axis
from seedslib.commands.cli import main
from seedslib.commands.kinds import KINDS
from seedslib.commands.models import load_model
from seedslib.evaluation import fit
from seedslib.filters import KalmanFilter
from seedslib.linearization import ExactGaussian, Taylor, Unscented

LEVEL = """
from seedslib.base import Parameter
from seedslib.models import LinearSystem

q, r = Parameter("q", .5, positive=True), Parameter("r", 2., positive=True)
system = LinearSystem(1, q, 1, r, 1, 3)
"""
COMMON = """
import sympy as sp
from seedslib import zoo
from seedslib.models import JumpDiffusion, Noise
x, v = sp.symbols("x v")
"""
WANDER = (
    COMMON
    + """
system = JumpDiffusion((x,), [-sp.sin(x)], [[1]], [x + v], Noise((v,)), [1], [[1]], step=.05)
"""
)
MODES = COMMON + "system = zoo.scalar_switching('A1H')\n"
JUMPS = """
import sympy as sp
from seedslib.models import Noise, SwitchingSystem
x, v, w = sp.symbols("x v w")
system = SwitchingSystem(
    (x,), [[.9 * x + v], [v - .5 * x]], Noise((v,)), [[.9, .1], [.2, .8]],
    [[x + w]] * 2, Noise((w,)), [(.5, [0], [[1]])] * 2,
)
"""
Y = [1.5, np.nan, -0.25, 0.75, 2.0]
IRREGULAR, EVEN = [0, 0.25, 0.6, 1.5, 2], [0, 1, 2, 3, 4]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in (("level", LEVEL), ("wander", WANDER), ("modes", MODES), ("jumps", JUMPS)):
        (tmp_path / f"{name}.py").write_text(text)
    for name, times in (("even", EVEN), ("irregular", IRREGULAR)):
        rows = [f"{t},{'NA' if np.isnan(y) else y}" for t, y in zip(times, Y, strict=True)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["t,y1", *rows]) + "\n")
    return tmp_path


def numbers(read, name, *columns):
    head, *rows = read(name)
    return np.array([[float(row[head.index(c)] or "nan") for row in rows] for c in columns])


@pytest.mark.parametrize(
    ("model", "kind", "options", "given"),
    [
        ("level", "KalmanFilter", [], []),
        ("wander", "extended_kalman", [], []),
        ("wander", "unscented_kalman", [], []),
        ("wander", "cubature_kalman", [], []),
        ("wander", "assumed_density", [], []),
        ("wander", "CovarianceFilter", ["--linearization", "unscented:.7,2,1"],
         [Unscented(0.7, 2, 1)]),
        ("wander", "ParticleFilter", ["--particles", "50", "--seed", "3"], [50]),
        ("modes", "SwitchingFilter", [], [ExactGaussian()]),
        ("modes", "SwitchingFilter", ["--linearization", "taylor"], [Taylor()]),
        ("modes", "GridBayesFilter", ["--grid", "x=-9:9:91"], [Axis(-9, 9, 91)]),
        ("jumps", "RaoBlackwellFilter", ["--particles", "3", "--seed", "3"], [3]),
    ],
)  # fmt: skip
def test_any_filter_by_its_name_in_python(read, model, kind, options, given):
    data, times = ("irregular", IRREGULAR) if model == "wander" else ("even", EVEN)
    arguments = ["filter", f"{model}.py", f"{data}.csv", "--kind", kind, *options]
    assert main([*arguments, "--out", "x.csv"]) == 0
    make = getattr(designed if kind == "SwitchingFilter" else filters, kind)
    filter = make(load_model(f"{model}.py").system, *given)
    told = {"seed": 3} if "--seed" in options else {}
    told |= {"covariances": True} if kind == "SwitchingFilter" else {}
    found = filter.run(times, np.array(Y)[:, None], **told)
    wanted = found.mean[:, 0], np.sqrt(found.cov[:, 0, 0])
    np.testing.assert_allclose(numbers(read, "x.csv", "x1", "sd1"), wanted, rtol=1e-14)
    if found.mode_prob is not None:
        assert numbers(read, "x.csv", "p1", "p2").T.tolist() == found.mode_prob.tolist()


def test_every_kind_has_a_row_above():
    rows = test_any_filter_by_its_name_in_python.pytestmark[0].args[1]
    assert {row[1] for row in rows} == set(KINDS)


def test_a_filter_of_the_file_itself(folder, read, write):
    write("own.py", LEVEL + "from seedslib.filters import unscented_kalman\n"
          "def filter():\n    return unscented_kalman(system, alpha=.5)\n")  # fmt: skip
    write("object.py", "from own import filter as make\nfilter = make()\n")
    for name in ("own", "object"):
        assert main(["filter", f"{name}.py", "even.csv", "--out", f"{name}.csv"]) == 0
    assert read("own.csv") == read("object.csv")
    # the same by two routes: everything is linear
    assert main(["filter", "own.py", "even.csv", "--kind", "KalmanFilter", "--out", "k.csv"]) == 0
    np.testing.assert_allclose(
        numbers(read, "own.csv", "x1", "sd1"), numbers(read, "k.csv", "x1", "sd1"), rtol=1e-12
    )


def test_a_designed_filter_of_the_file_is_held_against_its_times(capsys, write, read, refused):
    write("made.py", WANDER + """
from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.linearization import Taylor
filter = synthesize(system, Memory(1), Taylor(), [0, .5], paths=500, seed=1)
""")  # fmt: skip
    write("d.csv", "t,y1\n0,1\n0.5,2\n")
    assert main(["filter", "made.py", "d.csv", "--out", "x.csv"]) == 0
    assert numbers(read, "x.csv", "sd1").min() > 0
    told = refused(capsys, main, "filter", "made.py", "irregular.csv", "--out", "x.csv")
    assert "row 4: t = 0.6 comes after the measurement time 0.5 of the design" in told


@pytest.mark.parametrize(
    ("model", "options", "message"),
    [
        ("level", [], "kind: wanted one of KalmanFilter, extended_kalman,"),
        ("level", ["--kind", "ekf"], "GridBayesFilter; got ekf"),
        ("level", ["--kind", "SwitchingFilter"], "SwitchingFilter of level.py: system: wanted a "
         "SwitchingSystem, got a DiscreteSystem; see"),
        ("wander", ["--kind", "KalmanFilter"], "wanted a LinearSystem, got a JumpDiffusion"),
        ("modes", ["--kind", "extended_kalman"], "got a SwitchingSystem; see SwitchingFilter"),
        ("modes", ["--kind", "RaoBlackwellFilter"], "RaoBlackwellFilter of modes.py"),
        ("level", ["--kind", "KalmanFilter", "--particles", "5"],
         "particles: wanted none for KalmanFilter"),
        ("level", ["--grid", "x=0:1:3"], "grid: wanted none for level.py"),
        ("modes", ["--kind", "GridBayesFilter", "--grid", "0:1"], "grid: wanted x=low:high:count"),
        ("level", ["--kind", "KalmanFilter", "--seed", "1"], "seed: wanted none, KalmanFilter"),
        ("wander", ["--kind", "ParticleFilter", "--seed", "-1"], "seed: wanted a whole number"),
        ("wander", ["--kind", "ParticleFilter", "--particles", "0"], "wanted at least 1, got 0"),
        ("level", ["--kind", "KalmanFilter", "--set", "s=1"],
         "set: wanted a `Parameter` of the model (q, r), got s"),
        ("level", ["--kind", "KalmanFilter", "--set", "q"], "set: wanted such as q=1.3,r=2"),
        ("level", ["--kind", "KalmanFilter", "--lag", "1"], "lag: wanted --smooth with it, got 1"),
        ("level", ["--kind", "KalmanFilter", "--model", "level.py"], "model: wanted none beside"),
        ("wander", ["--kind", "extended_kalman", "--set", "q=1"], "the model's file names none"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_said_in_one_sentence(capsys, refused, model, options, message):
    told = refused(
        capsys, main, "filter", f"{model}.py", "even.csv", *options, "--out", "x.csv"
    )  # fmt: skip
    assert message in told


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("filter = 3\n", "wanted `filter` with the verbs of seedslib.filters.Filter, got int"),
        ("def filter():\n    return 1 / 0\n", "ZeroDivisionError: division by zero (line 2)"),
    ],
)  # fmt: skip
def test_bad_filters_of_a_file(capsys, refused, write, text, message):
    write("own.py", text)
    told = refused(capsys, main, "filter", "own.py", "even.csv", "--out", "x.csv")
    assert f"own.py: {message}" in told
    told = refused(
        capsys, main, "filter", "own.py", "even.csv", "--kind", "KalmanFilter", "--out", "x.csv"
    )
    assert "own.py: wanted `system`, got only `filter`" in told


def test_discrete_systems_want_equal_steps(capsys, refused):
    told = refused(
        capsys, main, "filter", "level.py", "irregular.csv", "--kind", "KalmanFilter", "--out",
        "x.csv",
    )  # fmt: skip
    assert "irregular.csv: times: wanted equal steps, for a system in discrete time" in told


# Smoothing


@pytest.mark.parametrize("options", [[], ["--lag", "1"]])
def test_smoothing_is_the_smoother_of_the_library(read, options):
    arguments = ["filter", "level.py", "even.csv", "--kind", "KalmanFilter", "--set", "q=1.5"]
    assert main([*arguments, "--smooth", *options, "--forecast", "2", "--out", "s.csv"]) == 0
    # the law of all levels and measurements, by one matrix
    levels = 3 + 1.5 * np.minimum.outer(np.arange(7), np.arange(7))
    mean, sd = np.empty(7), np.empty(7)
    for k in range(7):
        seen = [j for j in (0, 2, 3, 4) if not options or j <= k + 1]
        gain = np.linalg.solve(levels[np.ix_(seen, seen)] + 2 * np.eye(len(seen)), levels[seen, k])
        mean[k] = 1 + gain @ (np.array(Y)[seen] - 1)
        sd[k] = np.sqrt(levels[k, k] - gain @ levels[seen, k])
    np.testing.assert_allclose(numbers(read, "s.csv", "x1", "sd1"), [mean, sd], rtol=1e-12)
    assert read("s.csv")[0] == ["t", "x1", "sd1", "x1_low", "x1_high"]


def test_a_filter_without_a_smoother_is_refused(capsys, refused, write):
    write("own.py", LEVEL + "from seedslib.filters import Filter, KalmanFilter\n"
          "class Mine(Filter):\n    def __init__(self):\n        self.system = system\n"
          "filter = Mine()\n")  # fmt: skip
    told = refused(capsys, main, "filter", "own.py", "even.csv", "--smooth", "--out", "s.csv")
    assert "even.csv: smooth: filter: wanted" in told
    assert "got Mine" in told


# Fitting


def test_a_fit_and_what_is_filtered_with_it(capsys, write, read, refused):
    rng = np.random.default_rng(4)
    y = np.cumsum(rng.normal(size=60)) + rng.normal(size=60)
    write("walk.csv", "\n".join(["t,y1", *(f"{k},{float(v)!r}" for k, v in enumerate(y))]))
    arguments = ["level.py", "walk.csv", "--kind", "KalmanFilter"]
    assert main(["fit", *arguments, "--out", "fit.json"]) == 0
    model = load_model("level.py")
    filter = KalmanFilter(model.system)
    q, r = model.parameters["q"], model.parameters["r"]
    found = fit(filter, np.arange(60.0), y[:, None], [q, r])
    assert capsys.readouterr().out == f"{found}\nwritten to fit.json\n"
    told = json.loads(Path("fit.json").read_text())
    assert told["values"] == dict(zip("qr", found.values.tolist(), strict=True))
    assert told["errors"] == dict(zip("qr", found.errors.tolist(), strict=True))
    assert (told["loglik"], told["converged"]) == (found.loglik, True)
    assert main(["filter", *arguments, "--set", "fit.json", "--out", "x.csv"]) == 0
    told = refused(capsys, main, "filter", *arguments, "--set", "fit.json", "--out", "fit.json")
    assert "out: wanted another file than the values fit.json" in told
    with found.assigned():
        wanted = filter.run(np.arange(60.0), y[:, None]).mean[:, 0]
    np.testing.assert_allclose(numbers(read, "x.csv", "x1")[0], wanted, rtol=1e-14)
    with assigned({q: 0.5, r: 2.0}):
        assert np.abs(filter.run(np.arange(60.0), y[:, None]).mean[:, 0] - wanted).max() > 1e-3


def test_one_parameter_and_the_others_as_they_are_set(capsys):
    arguments = ["fit", "level.py", "even.csv", "--kind", "KalmanFilter", "--set", "q=.01"]
    assert main(arguments) in (0, 1)
    alone = capsys.readouterr().out
    assert " q " not in alone
    assert main([*arguments, "--free", "r"]) in (0, 1)
    assert capsys.readouterr().out == alone


def test_what_a_fit_refuses(capsys, refused):
    data = ["even.csv", "--kind"]
    told = refused(capsys, main, "fit", "wander.py", *data, "extended_kalman")
    assert "free: wanted a `Parameter` that wander.py names, got none" in told
    told = refused(capsys, main, "fit", "level.py", *data, "KalmanFilter", "--free", "z")
    assert "free: wanted a `Parameter` of the model (q, r), got z" in told
    told = refused(capsys, main, "fit", "level.py", *data, "KalmanFilter", "--out", "level.py")
    assert "out: wanted another file than the model level.py" in told
    told = refused(capsys, main, "fit", "f.npz", *data, "KalmanFilter")
    assert "wanted MODEL.py, got f.npz" in told


def test_a_fit_without_information_does_not_converge(capsys, write):
    write("two.py", LEVEL.replace("LinearSystem(1, q, 1, r", "LinearSystem(1, q * r, 1, 1"))
    assert main(["fit", "two.py", "even.csv", "--kind", "KalmanFilter", "--out", "f.json"]) == 1
    told = capsys.readouterr()
    assert told.err == "seedslib: even.csv: the fit did not converge\n"
    assert "too many parameters" in told.out
    assert json.loads(Path("f.json").read_text())["errors"] == {"q": None, "r": None}


def test_a_grid_takes_in_the_values_when_it_is_made(read, write):
    named = "from seedslib.base import Parameter\na = Parameter('a', .9)\n"
    write("grid.py", named + JUMPS.replace(".9 * x", "a * x"))
    arguments = ["grid.py", "even.csv", "--kind", "GridBayesFilter", "--grid", "x=-9:9:61"]
    for value in (".9", ".1"):
        assert main(["filter", *arguments, "--set", f"a={value}", "--out", f"{value}.csv"]) == 0
    model = load_model("grid.py")
    with assigned({model.parameters["a"]: 0.1}):
        filter = filters.GridBayesFilter(model.system, Axis(-9, 9, 61))
        wanted = filter.run(EVEN, np.array(Y)[:, None])
    assert numbers(read, ".1.csv", "x1")[0].tolist() == wanted.mean[:, 0].tolist()
    assert abs(numbers(read, ".9.csv", "x1") - wanted.mean[:, 0]).max() > 0.01
    assert main(["fit", *arguments, "--out", "fit.json"]) in (0, 1)
    assert json.loads(Path("fit.json").read_text())["loglik"] > wanted.loglik.sum()
