"""``python -m seedslib design``, ``filter`` and ``fit`` against the same in Python."""

import json

import numpy as np
import pandas
import pytest

from seedslib import zoo
from seedslib.base import Input, Parameter
from seedslib.design import Polynomial, grid_synthesis, synthesize
from seedslib.designed import Memory, SwitchingFilter, load, save
from seedslib.evaluation import fit
from seedslib.filters import KalmanFilter, ParticleFilter, smooth
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import LinearSystem

LEVEL = """
from seedslib.base import Input, Parameter
from seedslib.filters import KalmanFilter
from seedslib.models import LinearSystem
q, r = Parameter("q", .5, positive=True), Parameter("r", 2., positive=True)
system = LinearSystem(1, q, 1, r, 1, 3)
"""
FILES = {
    "level.py": LEVEL,
    "own.py": f"{LEVEL}filter = KalmanFilter(system)\n",
    "heated.py": LEVEL.replace("1, 3)", "1, 3, b=2 * Input('u'), d=Input('u'))"),
    "pair.py": "from seedslib import zoo\nsystem, times = zoo.van_der_pol(), range(3)\n",
    "flip.py": "from seedslib import zoo\nsystem = zoo.flip_process()\n",
    "target.py": "from seedslib import zoo\nsystem = zoo.manoeuvring_target('noisy')\n",
    "none.py": "x = 1\n",
    "exits.py": "import sys\nsys.exit(3)\n",
    "wrong.py": "x = 1 / 0\n",
    "d.csv": "t,y1\n0,1.5\n1,\n2,-0.25\n3,2\n",
    "days.csv": "day,y1\n2020-01-01,1.5\n2020-01-02,\n2020-01-03,-.25\n2020-01-04,2\n",
    "text.csv": "t,y1\n0,a\n",
    "empty.csv": "",
}
TIMES, Y = np.arange(4.0), np.array([1.5, np.nan, -0.25, 2.0])[:, None]
Q, R = (Parameter(name, value, positive=True) for name, value in (("q", 0.5), ("r", 2.0)))
KALMAN = KalmanFilter(LinearSystem(1, Q, 1, R, 1, 3))
PLAIN = '"filter=KalmanFilter(system)"'


@pytest.fixture(autouse=True)
def files(folder):
    for name, text in FILES.items():
        (folder / name).write_text(text)


def same(path, wanted, times=TIMES):
    """The table of estimates is the data frame of those in Python, its times are as they came."""
    frame = pandas.read_csv(path, index_col=0)
    pandas.testing.assert_frame_equal(
        frame, wanted.to_dataframe(times), check_names=False, check_index_type=False, rtol=1e-14
    )
    return frame


@pytest.mark.filterwarnings("ignore:held out")
@pytest.mark.parametrize(
    ("words", "rule", "options"),
    [
        ("'memory=Memory(1)'", ExactGaussian(), {}),
        (
            "'memory=Memory(1)' linearization=Taylor() 'predictor=Polynomial(2, 1)' components=1",
            Taylor(),
            {"predictor": Polynomial(2, 1), "components": 1},
        ),
        (
            "'memory=Memory(1)' 'measured=np.eye(3, 2) > 0' 'availability=[.8 for _ in range(2)]'",
            ExactGaussian(),
            {"measured": np.eye(3, 2) > 0, "availability": [0.8, 0.8]},
        ),
    ],
)
def test_a_design_is_that_of_python(run, folder, words, rule, options):
    system = zoo.van_der_pol()
    code, out, err = run(f"design pair.py {words} paths=600 seed=1 --verbose --out f.npz")
    wanted = synthesize(system, Memory(1), rule, range(3), paths=600, seed=1, **options)
    assert (code, out) == (0, f"{wanted}\n")
    assert "2 steps" in err
    y = system.simulate(range(3), 2, 1, measured=options.get("measured")).measurements
    one, other = (each.run(range(3), y).mean for each in (load("f.npz", system), wanted))
    np.testing.assert_array_equal(one, other)


@pytest.mark.filterwarnings("ignore:.*records have gaps")
def test_a_design_in_a_file_filters_with_its_model(run, folder):
    system = zoo.flip_process()
    made = synthesize(system, Memory(1), ExactGaussian(), TIMES, paths=600, seed=1, nodes=0)
    axes = {"x": (-3.5, 3.5, 21), "z": (-3, 3, 7), "y": (-8, 8, 9)}
    table = grid_synthesis(system, Memory(1), TIMES, **axes)
    for filter in (made, table):
        save(filter, folder / "f.npz")
        assert run("filter f.npz d.csv --system flip.py --out x.csv")[0] == 0
        same("x.csv", filter.run(TIMES, Y, covariances=True))


@pytest.mark.parametrize(
    ("model", "words", "wanted"),
    [
        ("own", "", KALMAN.run(TIMES, Y)),
        ("level", f"{PLAIN} --smooth", smooth(KALMAN, TIMES, Y)),
        ("level", f"{PLAIN} lag=1 --smooth", smooth(KALMAN, TIMES, Y, lag=1)),
        (
            "level",
            "'filter=lambda numbers: ParticleFilter(system, 30)' seed=3",
            ParticleFilter(KALMAN.system, 30).run(TIMES, Y, seed=3),
        ),
    ],
)
def test_a_filter_of_a_model_is_that_of_python(run, model, words, wanted):
    assert run(f"filter {model}.py d.csv {words} --out x.csv") == (0, "", "")
    assert same("x.csv", wanted).index.name == "t"


def test_dates_other_separators_and_columns_by_name(run, folder):
    wanted = KALMAN.run(TIMES, Y)
    days = [f"2020-01-0{k}" for k in range(1, 5)]
    assert run(f"filter own.py days.csv {PLAIN} --unit D --out x.csv")[0] == 0
    assert same("x.csv", wanted, days).index.name == "day"
    (folder / "e.csv").write_text("hour;no;flow\n0;7;1.5\n24;7;\n48;7;-.25\n72;7;2\n")
    assert run("filter own.py e.csv --sep ';' --columns flow --out x.csv")[0] == 0
    same("x.csv", KALMAN.run(24 * TIMES, Y), 24 * TIMES)


def test_inputs_and_indicators_are_columns_of_their_names(run, folder):
    u, values = Input("u"), np.array([0.5, 1.0, -2.0, 0.25])
    (folder / "u.csv").write_text("t,u,y1\n0,.5,1.5\n1,1,\n2,-2,-.25\n3,.25,2\n")
    assert run(f"filter heated.py u.csv {PLAIN} --out x.csv")[0] == 0
    heated = KalmanFilter(LinearSystem(1, Q, 1, R, 1, 3, b=2 * u, d=u))
    same("x.csv", heated.run(TIMES, Y, inputs={u: values}))
    (folder / "j.csv").write_text("t,y1,indicator\n0,1.5,0\n1,,1\n2,-.25,\n3,2,1\n")
    words = "'filter=SwitchingFilter(system, Taylor())'"
    assert run(f"filter target.py j.csv {words} --out x.csv")[0] == 0
    bank = SwitchingFilter(zoo.manoeuvring_target("noisy"), Taylor())
    same("x.csv", bank.run(TIMES, Y, indicators=[0, 1, -1, 1], covariances=True))


def test_a_fit_is_that_of_python_and_filters_with_its_values(run, folder):
    y = (
        np.cumsum(np.random.default_rng(4).normal(size=(40, 1)), axis=0)
        + np.sin(9 * np.arange(40))[:, None]
    )
    pandas.DataFrame(y, columns=["y1"]).to_csv("walk.csv")
    for words, free in (("", [Q, R]), ("free=[r]", [R])):
        code, out, _ = run(f"fit level.py walk.csv {PLAIN} {words} --out fit.json")
        wanted = fit(KALMAN, np.arange(40.0), y, free)
        assert (code, out) == (0, f"{wanted}\n")
        values = dict(zip(map(str, free), wanted.values.tolist(), strict=True))
        assert json.loads((folder / "fit.json").read_text()) == values
        assert run(f"filter level.py walk.csv {PLAIN} --values fit.json --out x.csv")[0] == 0
        same("x.csv", KALMAN.bind(wanted.numbers).run(np.arange(40.0), y), np.arange(40))
    (folder / "two.py").write_text(LEVEL.replace("(1, q, 1, r", "(1, q * r, 1, 1"))
    assert run(f"fit two.py walk.csv {PLAIN} --out fit.json")[0] == 1  # only their product matters


def test_a_filter_that_diverges_says_so(run, folder):
    (folder / "growth.py").write_text("from systems import growth\nsystem = growth()\n")
    (folder / "far.csv").write_text("t,y1\n0,.9\n1,1e300\n2,.2\n3,.3\n")
    code, _, err = run("filter growth.py far.csv 'filter=extended_kalman(system)' --out x.csv")
    lost = pandas.read_csv("x.csv", index_col=0)["x1"].isna().sum()
    assert code == 1
    assert err.splitlines()[-1].endswith(f"{lost} of 4 rows are no numbers")


REFUSED = """
design missing.py --out f.npz | missing.py
design none.py --out f.npz | none.py, system
design exits.py --out f.npz | exits.py
design wrong.py --out f.npz | wrong.py, division by zero
design pair.py memory=Memory(1 --out f.npz | memory
design pair.py memory=magic --out f.npz | memory, magic
design pair.py 'memory=Memory(1)' paths=2 seed=1 --out f.npz | paths
design pair.py 'memory=Memory(1)' colour=1 paths=200 seed=1 --out f.npz | colour
design flip.py 'memory=Memory(1)' paths=200 seed=1 --out f.npz | times
filter level.py d.csv --out x.csv | filter
filter level.py d.csv filter=KalmanFilter(system --out x.csv | filter
filter d.csv d.csv --out x.csv | d.csv
filter own.py none.csv --out x.csv | none.csv
filter own.py empty.csv --out x.csv | columns
filter own.py text.csv --out x.csv | text.csv, a
filter own.py days.csv --out x.csv | days.csv, unit
filter own.py d.csv --columns z --out x.csv | d.csv, z
filter heated.py d.csv 'filter=KalmanFilter(system)' --out x.csv | d.csv, u
filter plain.npz d.csv --out x.csv | plain.npz, --system
filter own.py d.csv --values none.json --out x.csv | none.json
fit flip.py d.csv 'filter=extended_kalman(system)' | free
fit level.py d.csv | filter
"""


@pytest.mark.parametrize("row", REFUSED.strip().splitlines())
def test_a_line_is_refused_by_name_and_nothing_is_written(run, folder, row):
    if "plain.npz" in row:
        options = {"paths": 300, "seed": 1, "nodes": 0}
        made = synthesize(zoo.flip_process(), Memory(1), Taylor(), range(3), **options)
        save(made, folder / "plain.npz")
    line, words = row.split(" | ")
    code, out, err = run(line)
    assert (code, out, err.count("\n")) == (2, "", 1)
    for word in words.split(", "):
        assert word in err
    assert not (folder / "x.csv").exists()
    assert not (folder / "f.npz").exists()


ENDS = {"MemoryError()": 2, "ModuleNotFoundError(name='dask')": 2, "KeyboardInterrupt()": 130}


@pytest.mark.parametrize("error", ENDS)
def test_what_ends_a_filter_is_said_in_one_line(run, folder, error):
    own = f"class Own:\n    system = system\n    def run(self, *_, **__):\n        raise {error}\n"
    (folder / "ends.py").write_text(f"{LEVEL}{own}filter = Own()\n")
    code, out, err = run("filter ends.py d.csv --out x.csv")
    assert (code, out, err.count("\n")) == (ENDS[error], "", 1)
