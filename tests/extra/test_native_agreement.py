"""C and JavaScript along records: the first part of the table of `native_agreement`."""

import csv
import shutil

import numpy as np
import pytest

from oracles.programs import BENCHMARKS, load

pytestmark = pytest.mark.skipif(
    None in (shutil.which("cc"), shutil.which("node")), reason="no compiler or no node"
)


@pytest.fixture(scope="module")
def program():
    return load("native_agreement")


def table():
    with (BENCHMARKS / "native_agreement.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_hundred_steps_are_those_of_the_table(program):
    """Rounding of double; of float within three times what the table says of its own record."""
    known = {
        (row["language"], row["real"]): float(row["apart"])
        for row in table()
        if (row["filter"], row["steps"]) == ("extended", "100")
    }
    for _, language, real, steps, apart, _, alike in program.compare("extended", 100):
        assert steps == 100
        if real == "double":
            assert float(apart) < 1e-12
            assert alike
        else:
            assert 1e-8 < float(apart) < 3 * known[language, real]


def test_the_table_is_whole():
    """Both languages to the end, odd numbers answered alike; one filter is known to run away.

    Float stays within what its header states.
    """
    rows = table()
    names = {row["filter"] for row in rows}
    for name in names:
        for language, real in (("C", "double"), ("C", "float"), ("JavaScript", "double")):
            key = name, language, real
            own = [r for r in rows if (r["filter"], r["language"], r["real"]) == key]
            away = {int(row["steps"]): float(row["apart"]) for row in own}
            assert max(away) >= 10_000
            assert (np.diff(list(away.values())) >= 0).all()
            if real == "double":
                assert {row["odd"] for row in own} == {"True"}
                assert away[100] < 1e-12
                last = away[max(away)]
                assert last > 1.0 if name == "designed, polynomial" else last < 1e-12
            else:
                assert max(away.values()) < float(own[0]["bound"])
    assert "designed, polynomial" in names
