"""The tables that people have: names, separators, dates, gaps; forecasts with intervals."""

import logging

import numpy as np
import pytest

from seedslib.commands.cli import main
from seedslib.commands.models import load_model
from seedslib.commands.words import as_memory
from seedslib.designed import Memory, load

LINEAR = "from seedslib.models import LinearSystem\nsystem = LinearSystem"
LEVEL = LINEAR + "(1, .5, 1, 2, 1, 3)\n"
TWO = LINEAR + "([[1, 1], [0, 1]], [[.5, 0], [0, .1]], [[1, 0], [0, 1]], [[2, 0], [0, 1]]," \
    "[0, 0], [[1, 0], [0, 1]])\n"  # fmt: skip
SLOW = """
import logging
import sympy as sp
from seedslib.models import JumpDiffusion, Noise

x, v = sp.symbols("x v")
system = JumpDiffusion((x,), [-x / 9], [[1]], [x + v], Noise((v,)), [1], [[3]], step=.5)
"""
KALMAN = ["--kind", "KalmanFilter"]
QUANTILE = 1.959963984540054


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in (("level", LEVEL), ("slow", SLOW), ("two", TWO)):
        (tmp_path / f"{name}.py").write_text(text)


def filtered(read, model, *options, code=0):
    kind = ["--kind", "extended_kalman"] if model == "slow" else KALMAN
    assert main(["filter", f"{model}.py", "d.csv", *kind, *options, "--out", "x.csv"]) == code
    return read("x.csv")


def plain(read, write, model, text):
    """Estimates of the same record with times as numbers."""
    write("d.csv", text)
    return [row[1:] for row in filtered(read, model)]


PLAIN = "t,y1\n0,1.5\n1,\n2,-0.25\n3,2\n"


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("t,y1\n0,1.5\n1,NA\n2,-.25\n3,2\n", []),
        ("t,y1\n0,1.5\n1,NaN\n2,-.25\n3,2\n", []),
        ("t,y1\n0,1.5\n1,nan\n2,-.25\n3,2\n", []),
        ("t;y1\n0;1.5\n1;\n2;-.25\n3;2\n", []),
        ("t\ty1\n0\t1.5\n1\t\n2\t-.25\n3\t2\n", []),
        ("t , y1\n0, 1.5\n1,\n\n2, -.25\n3, 2\n", []),
        ('year,"a, b"\n0,1.5\n1,\n2,-.25\n3,2\n', ["--time", "year"]),
        ('t,"a, b"\n0,1.5\n1,\n2,-.25\n3,2\n', ["--columns", '"y1=a, b"']),
        ("temp,year\n1.5,0\n,1\n-.25,2\n2,3\n", ["--time", "year"]),
        ("who,temp,t\na,1.5,0\nb,,1\nc,-.25,2\nd,2,3\n", ["--columns", "temp"]),
        ("who,temp,t\na,1.5,0\nb,,1\nc,-.25,2\nd,2,3\n", ["--columns", "y1=temp"]),
    ],
)
def test_one_record_in_many_tables(read, write, text, options):
    wanted = plain(read, write, "level", PLAIN)
    write("d.csv", text)
    found = filtered(read, "level", *options)
    assert [row[1:] for row in found] == wanted
    time = options[1] if options[:1] == ["--time"] else "t"
    assert [row[0] for row in found] == [time, "0", "1", "2", "3"]


def test_columns_by_name_and_in_order(read, write):
    wanted = plain(read, write, "two", "t,y1,y2\n0,1,5\n1,2,\n2,3,7\n")
    write("d.csv", "b,t,c,a\n5,0,no,1\n,1,no,2\n7,2,no,3\n")
    for chosen in ("a,b", "y1=a,y2=b", "y2=b,y1=a"):
        assert [row[1:] for row in filtered(read, "two", "--columns", chosen)] == wanted
    swapped = [row[1:] for row in filtered(read, "two", "--columns", "b,a")]
    assert swapped[1] != wanted[1]


DAYS = ("2020-01-01", "2020-01-02", "2020-01-03", "2020-01-04")
HOURS = ("2020-01-01 22:00", "2020-01-01 23:00", "2020-01-02 00:00", "2020-01-02T01:00")
ZONES = (
    "2020-03-29T00:00+01:00", "2020-03-29T01:00+01:00", "2020-03-29T03:00+02:00",
    "2020-03-29T02:00Z",
)  # fmt: skip


@pytest.mark.parametrize(
    ("cells", "unit"),
    [
        (DAYS, "days"), (HOURS, "hours"), (ZONES, "hours"), (("20200101", *DAYS[1:]), "days"),
        (("2019-12-31", "2020-01-31", "2020-02-29", "x"), "rows"),
    ],
)  # fmt: skip
def test_dates_are_numbers_in_a_unit_and_written_back(read, write, cells, unit):
    wanted = plain(read, write, "level", PLAIN)
    write("d.csv", "".join(f"{c},{y}\n" for c, y in zip(("day", *cells), ("flow", "1.5", "", "-.25",
          "2"), strict=True)))  # fmt: skip
    found = filtered(read, "level", "--time", "day", "--unit", unit)
    assert [row[1:] for row in found] == wanted
    assert [row[0] for row in found] == ["day", *cells]


def test_irregular_dates_of_a_continuous_model(read, write):
    wanted = plain(read, write, "slow", "t,y1\n2,1.5\n2.5,\n26,-0.25\n")
    text = "t,y1\n1999-12-31T02:00,1.5\n1999-12-31 02:30,NA\n2000-01-01T02:00:00,-.25\n"
    write("d.csv", text)
    rows = filtered(read, "slow", "--unit", "hours", "--epoch", "1999-12-31")
    assert [row[1:] for row in rows] == wanted
    first, second = float(wanted[1][0]), float(wanted[2][0])
    assert second == pytest.approx(first * np.exp(-0.5 / 9), rel=1e-6)
    write("d.csv", text.replace("02:30", "02:00:00.500"))
    found = filtered(read, "slow", "--unit", "seconds")
    assert float(found[2][1]) == pytest.approx(first * np.exp(-0.5 / 9), rel=1e-6)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("t;y1\n0;1,5\n", [], "row 2, column y1: wanted a number with a decimal point, got '1,5'"),
        ('t,y1\n0,"-1,5e3"\n', [], "wanted a number with a decimal point, got '-1,5e3'"),
        ("t,y1\n0,n/a\n", [], "row 2, column y1: wanted a number, got 'n/a'"),
        ("t,y1\nNA,1\n", [], "row 2, column t: wanted a number, got 'NA'"),
        ("day,y\n2020-01-01,1\n", ["--time", "day"],
         "row 2, column day: wanted a number, got '2020-01-01'; dates want --unit days|hours|"),
        ("t,y1\n2020-01-01,1\n0,2\n", ["--unit", "days"],
         "row 3, column t: wanted a date such as 2020-01-31 or 2020-01-31T12:00, got '0'"),
        ("t,y1\n01.02.2020,1\n", ["--unit", "days"], "row 2, column t: wanted a date such as"),
        ("t,y1\n2020-01-01,1\n2020-01-01T12:00Z,1\n", ["--unit", "days"],
         "row 3, column t: wanted a zone in all dates or in none, got '2020-01-01T12:00Z'"),
        ("t,y1\n2020-01-02,1\n2020-01-01,1\n", ["--unit", "days"],
         "row 3, column t: wanted a time after 2020-01-02, got 2020-01-01"),
        ("t,y1\n2020-01-31,1\n2020-02-29,1\n2020-03-31,1\n", ["--unit", "days"],
         "d.csv: times: wanted equal steps"),
        ("t,y1\n0,1\n", ["--unit", "years"], "unit: wanted one of days, hours, seconds, rows; g"),
        ("t,y1\n0,1\n", ["--epoch", "2020-01-01"], "unit: wanted one of days, hours, seconds; got"),
        ("t,y1\n0,1\n", ["--unit", "days", "--epoch", "1.1."], "epoch: wanted a date such as"),
        ("t,y1\n0,1\n", ["--time", "day"], "wanted one column called day, got t,y1"),
        ("t,a,a\n0,1,2\n", ["--columns", "a"], "wanted one column called a, got t,a,a"),
        ("t,a,b\n0,1,2\n", ["--time", "t"],
         "wanted a column for y1 beside t, got a,b; choose with --columns"),
        ("t,a,b\n0,1,2\n", ["--columns", "a,b"], "columns: wanted y1=COLUMN, or 1 names in this"),
        ("t,a,b\n0,1,2\n", ["--columns", "y2=a"], "wanted one column called y2=a, got t,a,b"),
        ("t,a\n0,1,5\n", ["--columns", "a"], "row 2: wanted 2 cells, got 3"),
        ("", ["--columns", "a"], "wanted one column called t, got an empty file"),
        ("t,a\n", ["--columns", "a"], "wanted a row for each measurement, got none"),
    ],
)  # fmt: skip
def test_what_is_refused_names_file_row_and_column(
    capsys, write, refused, tmp_path, text, options, message
):
    write("d.csv", text)
    told = refused(capsys, main, "filter", "level.py", "d.csv", *KALMAN, *options, "--out", "x.csv")
    assert message in told
    assert message.split(":")[0] in ("unit", "epoch", "columns") or "d.csv" in told
    assert not (tmp_path / "x.csv").exists()


# Forecasts


def by_hand(y):
    """Local level with q = .5, r = 2: mean, variance, and what is expected of y, at each time."""
    m, p, rows = 1.0, 3.0, []
    for k, v in enumerate(y):
        p += 0.5 * (k > 0)
        e, s = m, p + 2
        if np.isfinite(v):
            m, p = m + p / s * (v - m), p * 2 / s
        rows.append((m, p, e, s))
    return np.array(rows)


NAMES = ["t", "x1", "sd1", "x1_low", "x1_high", "y1", "y1_low", "y1_high"]


@pytest.mark.parametrize("level", [None, 0.5])
def test_forecasts_of_state_and_measurement_with_their_intervals(read, write, level):
    write("d.csv", PLAIN)
    options = [] if level is None else ["--level", str(level)]
    names, *rows = filtered(read, "level", "--forecast", "3", *options)
    assert names == NAMES
    assert [row[0] for row in rows] == ["0", "1", "2", "3", "4", "5", "6"]
    mean, var, expected, spread = by_hand([1.5, np.nan, -0.25, 2, *[np.nan] * 3]).T
    width = QUANTILE if level is None else 0.6744897501960817
    wanted = [mean, np.sqrt(var)]
    wanted += [mean - width * np.sqrt(var), mean + width * np.sqrt(var), expected]
    wanted += [expected - width * np.sqrt(spread), expected + width * np.sqrt(spread)]
    np.testing.assert_allclose(np.array(rows)[:, 1:].astype(float).T, wanted, rtol=1e-12)


def test_intervals_without_forecasts(read, write):
    write("d.csv", PLAIN)
    longer = filtered(read, "level", "--forecast", "1")
    assert filtered(read, "level", "--level", ".95") == longer[:-1]
    assert filtered(read, "level")[0] == NAMES[:3]


@pytest.mark.parametrize(
    ("first", "options", "cells"),
    [
        ("0", ["--forecast", "2"], ["1.5", "2"]),
        ("0", ["--forecast", "2", "--every", ".1"], ["1.1", "1.2"]),
        ("0", ["--until", "1.3", "--every", ".1"], ["1.1", "1.2", "1.3"]),
        ("0", ["--until", "2.2"], ["1.5", "2"]),
        ("2020-02-28", ["--unit", "days", "--forecast", "2"], ["2020-03-01", "2020-03-02"]),
        ("2020-02-28", ["--unit", "days", "--until", "2020-03-01T12:00", "--every", ".75"],
         ["2020-02-29 18:00:00", "2020-03-01 12:00:00"]),
        ("2020-02-28T06:00Z", ["--unit", "days", "--forecast", "1"], ["2020-03-01T06:00:00Z"]),
        ("Fri", ["--unit", "rows", "--forecast", "2"], ["+1", "+2"]),
    ],
)  # fmt: skip
def test_times_of_forecasts_are_written_as_the_table_writes_times(
    read, write, first, options, cells
):
    later = {"0": ["0.5", "1"], "Fri": ["Mon", "Tue"], "2020-02-28": ["2020-02-29"]}
    later = later.get(first, ["2020-02-29T06:00Z"])
    write("d.csv", "\n".join(["t,y1", *(f"{cell},1" for cell in (first, *later))]))
    rows = filtered(read, "slow", *options)
    got = [row[0] for row in rows[2 + len(later) :]]
    assert got == cells


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--every", "1"], "forecast: wanted a positive number of steps, or --until, one"),
        (["--forecast", "0"], "forecast: wanted a positive number of steps"),
        (["--forecast", "1", "--until", "9"], "or --until, one of the two"),
        (["--forecast", "1"], "every: wanted the step of the forecasts"),
        (["--forecast", "1", "--every", "0"], "every: wanted a positive step, got 0"),
        (["--until", "1", "--every", "1"], "until: wanted up to a million positive steps"),
        (["--until", "soon", "--every", "1"], "until: wanted a number, got 'soon'"),
        (["--level", "1"], "level: wanted a number between 0 and 1, got 1"),
    ],
)
def test_forecasts_that_are_refused(capsys, write, refused, options, message):
    write("d.csv", "t,y1\n0,1\n1,1\n3,1\n")
    arguments = ["filter", "slow.py", "d.csv", "--kind", "extended_kalman", *options]
    assert message in refused(capsys, main, *arguments, "--out", "x.csv")


def test_what_nothing_has_told_is_not_forecast(read, write):
    write("level.py", LINEAR + "(1, .5, 1, 2, 0, 0, diffuse=(0,))\n")
    write("d.csv", "t,y1\n0,\n1,4\n2,5\n")
    rows = filtered(read, "level", "--level", ".95")
    assert [row[NAMES.index("y1")] for row in rows[1:]] == ["", "", "4.0"]
    assert [row[2] == "" for row in rows[1:]] == [True, False, False]


# Designs


def test_times_of_a_design_from_a_table_and_what_it_tells(capsys, write, read):
    write("days.csv", "day;t;y\n2020-01-01;0;1\n2020-01-02;.5;1\n2020-01-04;1.5;1\n")
    design = ["design", "slow.py", "--memory", "measurements=2", "--paths", "400", "--nodes", "0"]
    days = ["--times", "@days.csv:day", "--unit", "days"]
    early = [*days, "--epoch", "2019-12-31"]
    plain = ["--times", "@days.csv"]
    for times, wanted in ((plain, [0, 0.5, 1.5]), (early, [1, 2, 4]), (days, [0, 1, 3])):
        assert main([*design, *times, "--out", "f.npz"]) == 0
        assert capsys.readouterr().err == ""
        filter = load("f.npz", load_model("slow.py").system)
        assert filter.times.tolist() == wanted
    assert filter.memory == as_memory("measurements=2") == Memory(measurements=2) == Memory(0, 2)
    assert main([*design, *days, "--verbose", "--out", "g.npz"]) == 0
    assert "design: all 2 steps" in capsys.readouterr().err
    logger = logging.getLogger("seedslib")
    assert logger.level == logging.NOTSET
    assert [type(h) for h in logger.handlers] == [logging.NullHandler]
    arguments = ["f.npz", "days.csv", "--model", "slow.py", "--time", "day", "--columns", "y"]
    assert main(["filter", *arguments, "--unit", "days", "--level", ".95", "--out", "x.csv"]) == 0
    names, *rows = read("x.csv")
    assert names == ["day", *NAMES[1:]]
    state = filter.predict(filter.initial(), 0.0)
    expected = filter.expect(filter.predict(filter.correct(state, np.array([1.0])), 1.0))
    low, high = expected.mean[0] + np.array([-1, 1]) * QUANTILE * np.sqrt(expected.cov[0, 0])
    assert [float(cell) for cell in rows[1][5:]] == pytest.approx([expected.mean[0], low, high])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--times", "@none.csv"], "none.csv"),
        (["--times", "@d.csv"], "d.csv: wanted one column called t, got day,y"),
        (["--times", "@d.csv:day"], "row 2, column day: wanted a number, got '2020"),
        (["--times", "@d.csv:y"], "times: wanted strictly increasing times"),
        (["--times", "0:1:1", "--unit", "days"], "unit, epoch: wanted --times @FILE.csv"),
        (["--times", "@d.csv:day", "--unit", "days", "--out", "d.csv"], "than the times d.csv"),
    ],
)
def test_times_of_a_design_that_are_refused(capsys, write, refused, options, message):
    write("d.csv", "day,y\n2020-01-01,1\n2020-01-02,1\n")
    arguments = ["design", "slow.py", "--memory", "estimates=1", "--paths", "400"]
    assert message in refused(capsys, main, *arguments, "--out", "f.npz", *options)
