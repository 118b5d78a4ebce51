"""``python -m seedslib filter``: tables, dates, forecasts, any filter by its name."""

import numpy as np
import pytest
from scipy.stats import norm

from seedslib import designed, filters, zoo
from seedslib.base import Axis
from seedslib.design import synthesize
from seedslib.designed import Memory, save
from seedslib.linearization import Taylor, Unscented

LINEAR = "from seedslib.base import Input\nfrom seedslib.models import LinearSystem\n"
MODELS = {
    "level": f"{LINEAR}system = LinearSystem(1, .5, 1, 2, 1, 3)\n",
    "heated": f"{LINEAR}system = LinearSystem(1, .5, 1, 2, 1, 3, B=2, D=1, inputs=(Input('u'),))\n",
    "wander": "from systems import oscillator\nsystem = oscillator(.25)\n",
    "growth": "from systems import growth as system\nfrom seedslib.filters import extended_kalman\n"
    "def filter():\n    return extended_kalman(system())\n",
    "pair": "from seedslib import zoo\nsystem = zoo.van_der_pol()\n",
    "scalar": "from seedslib import zoo\nsystem = zoo.scalar_switching('A1H')\n",
    "target": "from seedslib import zoo\nsystem = zoo.manoeuvring_target('noisy')\n",
}
Y = np.array([1.5, np.nan, -0.25, 2.0])
PLAIN = "t,y1\n0,1.5\n1,\n2,-0.25\n3,2\n"
HALVES = "2020-02-29 12:00:00, 2020-03-01"
REACH = norm.ppf(0.975)


@pytest.fixture(autouse=True)
def models(folder):
    for name, text in MODELS.items():
        (folder / f"{name}.py").write_text(text)


@pytest.fixture
def filtered(run, folder, table):
    """The table that the filter of a model makes of another."""

    def filtered(model, text, options="", code=0):
        if "--kind" not in options and model in ("level", "heated"):
            options += " --kind KalmanFilter"
        (folder / "d.csv").write_text(text)
        path = model if "." in model else f"{model}.py"
        done = run(f"filter {path} d.csv --out x.csv {options}")
        assert done[0] == code, done
        return table("x.csv")

    return filtered


KINDS = [
    ("level", "KalmanFilter", "", []),
    ("wander", "extended_kalman", "", []),
    ("wander", "unscented_kalman", "", []),
    ("wander", "CovarianceFilter", "--linearization unscented:.7,2,1", [Unscented(0.7, 2, 1)]),
    ("wander", "ParticleFilter", "--particles 50 --seed 3", [50]),
    ("scalar", "SwitchingFilter", "--linearization taylor", [Taylor()]),
    ("scalar", "GridBayesFilter", "--grid x=-9:9:91", [Axis(-9, 9, 91)]),
]


@pytest.mark.parametrize(("model", "kind", "options", "given"), KINDS)
def test_any_filter_by_its_name_equals_that_of_python(filtered, model, kind, options, given):
    times = [0.0, 0.25, 1.5, 2.0] if model == "wander" else np.arange(4.0)
    rows = "".join(f"{t},{y}\n" for t, y in zip(times, Y, strict=True))
    found = filtered(model, "t,y1\n" + rows, f"--kind {kind} {options}")
    make = getattr(designed if kind == "SwitchingFilter" else filters, kind)
    told = {"seed": 3} if "seed" in options else {}
    told |= {"covariances": True} if kind == "SwitchingFilter" else {}
    space = {}
    exec(MODELS[model], space)
    wanted = make(space["system"], *given).run(times, Y[:, None], **told)
    expected = np.stack([wanted.mean[:, 0], np.sqrt(wanted.cov[:, 0, 0])], axis=1)
    np.testing.assert_allclose(found.numbers("x1", "sd1"), expected, rtol=1e-14)
    if wanted.mode_prob is not None:
        np.testing.assert_array_equal(found.numbers("p1", "p2"), wanted.mode_prob)
        assert found.text("mode") == [str(mode) for mode in wanted.modes]


def level(y, u=(0,) * 9):
    """By hand: mean, deviation, and what is expected of y with its deviation, at each time."""
    m, p, rows = 1.0, 3.0, []
    for k, value in enumerate(y):
        if k:
            m, p = m + 2 * u[k - 1], p + 0.5
        expected, s = m + u[k], p + 2
        if np.isfinite(value):
            m, p = m + p / s * (value - expected), p * 2 / s
        rows.append((m, np.sqrt(p), expected, np.sqrt(s)))
    return np.array(rows)


@pytest.mark.parametrize(
    ("rows", "options"),
    [
        ("t,y1 0,1.5 1,NA 2,-.25 3,2", ""),
        ("t;y1 0;1.5 1;NaN 2;-.25 3;2", ""),
        ("t\ty1 0\t1.5 1\t  2\t_-.25 3\t2", ""),
        ("year,flow 0,1.5 1, 2,-.25 3,2", "--time year"),
        ("who,flow,t a,1.5,0 b,,1 c,-.25,2 d,2,3", "--columns flow"),
        ("t,y1 2020-01-30,1.5 2020-01-31, 2020-02-01,-.25 2020-02-02,2", "--unit days"),
        (
            "t,y1 2020-01-01_23:00,1.5 2020-01-02T00:00, 2020-01-02_01:00,-.25 2020-01-02T02:00,2",
            "--unit hours",
        ),
        (
            "t,y1 2020-03-29T00:00Z,1.5 2020-03-29T02:00+01:00, 2020-03-29T02:00Z,-.25 "
            "2020-03-29T05:00+02:00,2",
            "--unit hours",
        ),
        ("t,y1 Mon,1.5 Tue, Fri,-.25 x,2", "--unit rows"),
    ],
)
def test_one_record_in_many_tables(filtered, rows, options):
    lines = [line.replace("_", " ") for line in rows.split(" ")]
    found = filtered("level", "\n".join(lines), options)
    np.testing.assert_allclose(found.numbers("x1", "sd1"), level(Y)[:, :2], rtol=1e-12)
    cells = [line.replace("\t", ",").replace(";", ",").split(",") for line in lines if line]
    at = cells[0].index("year" if "--time" in options else "t")
    assert [found.names[0], *found.text(found.names[0])] == [row[at] for row in cells]


def test_columns_by_name_and_in_order(filtered):
    wanted = filtered("pair", "t,y1,y2\n0,1,5\n1,2,\n2,3,7\n", "--kind extended_kalman").rows
    text = "b,t,c,a\n5,0,no,1\n,1,no,2\n7,2,no,3\n"
    for chosen in ("a,b", "y1=a,y2=b", "y2=b,y1=a"):
        assert filtered("pair", text, f"--kind extended_kalman --columns {chosen}").rows == wanted
    assert filtered("pair", text, "--kind extended_kalman --columns b,a").rows != wanted


@pytest.mark.parametrize(("options", "reach"), [("", REACH), ("--level .5", norm.ppf(0.75))])
def test_forecasts_of_state_and_measurement_with_their_intervals(filtered, options, reach):
    found = filtered("level", PLAIN, f"--forecast 3 {options}")
    assert found.names == ["t", "x1", "sd1", "x1_low", "x1_high", "y1", "y1_low", "y1_high"]
    assert found.text("t") == list("0123456")
    mean, sd, expected, spread = level([*Y, *[np.nan] * 3]).T
    wanted = [mean, sd, mean - reach * sd, mean + reach * sd]
    wanted += [expected, expected - reach * spread, expected + reach * spread]
    np.testing.assert_allclose(found.numbers(*found.names[1:]).T, wanted, rtol=1e-12)
    shorter = filtered("level", PLAIN, options or "--level .95")
    assert shorter.rows == found.rows[:-3]


@pytest.mark.parametrize(
    ("cells", "options", "wanted"),
    [
        ("0 .5 1", "--forecast 2", "1.5, 2"),
        ("0 .5 1", "--forecast 2 --every .1", "1.1, 1.2"),
        ("0 .5 1", "--until 1.3 --every .1", "1.1, 1.2, 1.3"),
        ("2020-02-28 2020-02-29", "--unit days --forecast 1", "2020-03-01"),
        ("2020-02-28 2020-02-29", "--unit days --until 2020-03-01 --every .5", HALVES),
        ("2020-02-28T06:00Z 2020-02-29T06:00Z", "--unit days --forecast 1", "2020-03-01T06:00:00Z"),
        ("Fri Mon", "--unit rows --forecast 2", "+1, +2"),
    ],
)
def test_times_of_forecasts_are_written_as_the_table_writes_times(filtered, cells, options, wanted):
    cells = cells.split()
    text = "\n".join(["t,y1", *(f"{cell},1" for cell in cells)])
    found = filtered("wander", text, f"--kind extended_kalman {options}").text("t")
    assert found == cells + wanted.split(", ")


@pytest.mark.parametrize("lag", [None, 1])
def test_smoothing_equals_the_law_of_all_levels_and_measurements(filtered, lag):
    options = "--smooth --forecast 2" + (f" --lag {lag}" if lag else "")
    levels = 3 + 0.5 * np.minimum.outer(np.arange(6), np.arange(6))
    wanted = []
    for k in range(6):
        seen = [j for j in (0, 2, 3) if lag is None or j <= k + lag]
        gain = np.linalg.solve(levels[np.ix_(seen, seen)] + 2 * np.eye(len(seen)), levels[seen, k])
        wanted.append((1 + gain @ (Y[seen] - 1), np.sqrt(levels[k, k] - gain @ levels[seen, k])))
    found = filtered("level", PLAIN, options)
    np.testing.assert_allclose(found.numbers("x1", "sd1"), wanted, rtol=1e-12)


def test_inputs_move_the_state_and_shift_the_measurement(filtered):
    u = np.array([0.5, 1.0, -2.0, 0.25])
    rows = [f"{k},{y},{each}\n" for k, (y, each) in enumerate(zip(Y, u, strict=True))]
    text, options = "t,y1,heat\n" + "".join(rows), "--inputs u=heat --columns y1"
    found = filtered("heated", text, f"{options} --level .95")
    wanted = level(Y, u)[:, :3]
    np.testing.assert_allclose(found.numbers("x1", "sd1", "y1"), wanted, rtol=1e-12)
    smoothed = filtered("heated", text, f"{options} --smooth").numbers("x1")
    np.testing.assert_allclose(smoothed[-1], wanted[-1, 0], rtol=1e-12)
    assert abs(smoothed[0] - wanted[0, 0]) > 0.01


def test_a_filter_that_diverges_leaves_cells_empty_and_says_so(filtered, run, recwarn):
    found = filtered("growth", "t,y1\n0,.9\n1,1e300\n2,.2\n3,.3\n", code=1)
    lost = [not cell for cell in found.text("x1")]
    assert lost == sorted(lost)
    assert lost[-1]
    code, _, err = run("filter growth.py d.csv --out x.csv")
    assert (code, err.count("\n")) == (1, 1)
    assert f"{sum(lost)} of 4 rows" in err
    assert f"t = {found.text('t')[lost.index(True)]}" in err
    assert not [each for each in recwarn if issubclass(each.category, RuntimeWarning)]


ENDS = {"MemoryError()": 2, "ModuleNotFoundError(name='dask')": 2, "KeyboardInterrupt()": 130}


@pytest.mark.parametrize("error", ENDS)
def test_what_ends_a_filter_is_said_in_one_line(run, folder, error):
    own = "class Own:\n    def run(self, *_, **__):\n        raise " + error
    own += "\n    record = run\nfilter = Own()\nfilter.system = system\n"
    (folder / "own.py").write_text(MODELS["level"] + own)
    (folder / "d.csv").write_text(PLAIN)
    code, out, err = run("filter own.py d.csv --out x.csv")
    assert (code, out, err.count("\n")) == (ENDS[error], "", 1)


# Designed filters


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_a_designed_filter_forecasts_where_rows_are_empty(filtered, folder):
    system, options = zoo.van_der_pol(), {"paths": 400, "seed": 1, "nodes": 1}
    filter = synthesize(system, Memory(1), Taylor(), 0.5 * np.arange(4), **options)
    save(filter, folder / "f.npz")
    times = [0.0, 0.25, 0.5, 1.0]
    y = np.array([[0.5, 1.0], [np.nan, np.nan], [0.3, 0.7], [0.2, np.nan]])
    rows = "".join(f"{t},{a},{b}\n" for t, (a, b) in zip(times, y, strict=True))
    found = filtered("f.npz", "t,y1,y2\n" + rows, "--model pair.py --level .95")
    wanted = filter.run(times, y, covariances=True)
    np.testing.assert_array_equal(found.numbers("x1", "x2"), wanted.mean)
    deviations = np.sqrt(np.diagonal(wanted.cov, axis1=1, axis2=2))
    np.testing.assert_allclose(found.numbers("sd1", "sd2"), deviations, rtol=1e-14)
    assert np.isnan(deviations[[1, 3]]).all()
    ahead = filter.predict(filter.step(filter.initial(), 0.0, y[0]), 0.5)
    expected = filter.expect(ahead)
    reach = REACH * np.sqrt(np.diagonal(expected.cov))
    wanted = np.concatenate([expected.mean, expected.mean - reach, expected.mean + reach])
    names = [f"y{i}{end}" for end in ("", "_low", "_high") for i in (1, 2)]
    np.testing.assert_allclose(found.numbers(*names)[2], wanted, rtol=1e-12)
    assert np.isnan(found.numbers("y1")[1]).all()


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_modes_with_indicators_some_missing(filtered, folder):
    system = zoo.manoeuvring_target("noisy")
    filter = synthesize(system, Memory(1), Taylor(), range(4), paths=2000, seed=3)
    save(filter, folder / "f.npz")
    found = filtered("f.npz", "t,y1,j\n0,1.5,0\n1,,1\n2,-.25,\n3,2,1\n", "--model target.py")
    told = {"indicators": np.array([0, 1, -1, 1]), "covariances": True}
    wanted = filter.run(np.arange(4.0), Y[:, None], **told)
    assert found.names == ["t", "mode", "p1", "p2", "x1", "x2", "sd1", "sd2"]
    assert found.text("mode") == [str(mode) for mode in wanted.modes]
    np.testing.assert_array_equal(found.numbers("p1", "p2"), wanted.mode_prob)
    np.testing.assert_array_equal(found.numbers("x1", "x2"), wanted.mean)
