"""Any file and any table: a right answer, or one sentence that says what is wrong."""

import io
from contextlib import redirect_stderr, redirect_stdout

import numpy as np
import pandas
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracles.drawn import vectors
from seedslib import zoo
from seedslib.commands import main
from seedslib.design import synthesize
from seedslib.designed import large_order, load, save
from seedslib.linearization import Taylor

MODEL = "from seedslib.models import LinearSystem\nsystem = LinearSystem(1, .5, 1, 2, 1, 3)\n"
CELL = st.one_of(
    st.floats(width=64).map(repr),
    st.integers(-9, 9).map(str),
    st.sampled_from(["", "NA", "nan", "1e999", "-inf", "x", "1_0", "0x1", "1,5", "2026-01-02"]),
    st.text(alphabet="0123456789.eE+-, ;\t\"'", max_size=6),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("tables")
    (made / "m.py").write_text(MODEL)
    return made


@settings(max_examples=60)
@given(
    rows=st.lists(st.lists(CELL, min_size=1, max_size=3), max_size=6),
    head=st.sampled_from(["t,y1", "t;y1", "y1", "t,y1,y1", "a b"]),
)
def test_any_table_of_measurements(folder, rows, head):
    text = "\n".join([head, *(",".join(row) for row in rows)]) + "\n"
    (folder / "d.csv").write_text(text)
    (folder / "x.csv").unlink(missing_ok=True)
    said, printed = io.StringIO(), io.StringIO()
    with redirect_stderr(said), redirect_stdout(printed):
        given_ = ["filter", folder / "m.py", folder / "d.csv", "filter=KalmanFilter(system)"]
        code = main([*map(str, given_), "--out", str(folder / "x.csv")])
    assert "Traceback" not in said.getvalue()
    if code == 0:
        written = pandas.read_csv(folder / "x.csv", index_col=0)
        assert np.isfinite(written["x1"]).all()
    else:
        assert code in (1, 2)
        assert len(said.getvalue().strip().splitlines()) == 1
        assert code == 1 or not (folder / "x.csv").exists()


@pytest.fixture(scope="module")
def filter(folder):
    made = synthesize(
        zoo.linear_gaussian(), large_order(1), Taylor(), [0.0, 0.5, 1.0], paths=300, seed=1, nodes=1
    )
    save(made, folder / "f.npz")
    return made


@given(y=vectors((3, 1)))
def test_a_file_gives_the_filter_back(folder, filter, y):
    again = load(folder / "f.npz", zoo.linear_gaussian())
    one, other = (each.run(filter.times, y, covariances=True) for each in (filter, again))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def refused_or_equal(path, filter):
    """A file is refused by its name, or gives the very same filter."""
    try:
        again = load(path, zoo.linear_gaussian())
    except ValueError as refused:
        if path.name in str(refused):
            return
        raise
    y = np.array([[1.0], [0.5], [-0.25]])
    one, other = (each.run(filter.times, y, covariances=True) for each in (filter, again))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


@settings(max_examples=60)
@given(data=st.data())
def test_a_byte_that_changes_is_refused_or_does_no_harm(folder, filter, data):
    whole = (folder / "f.npz").read_bytes()
    place = data.draw(st.integers(0, len(whole) - 1))
    value = data.draw(st.integers(0, 255))
    (folder / "g.npz").write_bytes(whole[:place] + bytes([value]) + whole[place + 1 :])
    refused_or_equal(folder / "g.npz", filter)


@given(cut=st.integers(0, 400), more=st.binary(max_size=40))
def test_a_file_that_is_cut_or_goes_on_is_refused_or_does_no_harm(folder, filter, cut, more):
    whole = (folder / "f.npz").read_bytes()
    (folder / "g.npz").write_bytes(whole[: len(whole) - cut] + more)
    refused_or_equal(folder / "g.npz", filter)
