"""How comparisons, differences and evaluations show themselves."""

import re

import numpy as np
import pandas
import pytest

from seedslib import zoo
from seedslib.evaluation import compare
from seedslib.filters import Estimates, RaoBlackwellFilter, extended_kalman

TIMES = np.arange(5) * 0.5


@pytest.fixture(scope="module")
def found():
    system = zoo.van_der_pol()
    filters = {"ekf": extended_kalman(system), "<coarse>": extended_kalman(system, bound=4.5)}
    return compare(filters, system, TIMES, 400, 1, consistency=True)


def test_a_comparison_is_a_table_with_a_row_for_each_filter(found):
    head, *rows = repr(found).splitlines()
    assert re.split(r"\s\s+", head) == [
        "filter", "RMS x1", "RMS x2", "NEES / n", "log score", "µs a step", "diverged",
    ]  # fmt: skip
    for row, (name, one) in zip(rows, found.items(), strict=True):
        words = re.split(r"\s\s+", row)
        assert words[0] == name
        assert words[2] == f"{one.average[1]:.4g} ± {one.average_error[1]:.2g}"
        assert words[3] == f"{one.nees_ratio:.4g} ± {one.nees_ratio_error:.2g}"
        assert words[-1] == str(one.diverged)
    assert found["<coarse>"].diverged > 0
    page = found._repr_html_()
    assert page.count("<tr>") == 3
    assert "<td>&lt;coarse&gt;</td>" in page
    # what is printed does not differ from run to run
    assert "step" not in str(found)


def test_a_table_leaves_out_what_no_filter_has():
    target = zoo.manoeuvring_target("noisy")

    class Zero:
        """Estimates zero and decides nothing."""

        def run(self, times, measurements):
            return Estimates(np.zeros((len(times), 2, measurements.shape[2])))

    filters = {"zero": Zero(), "drawn": RaoBlackwellFilter(target, 4)}
    found = compare(filters, target, np.arange(4.0), 50, 1)
    assert "NEES" not in repr(found)
    assert "wrong mode" in repr(found)
    assert " -  " in repr(found).splitlines()[1]
    frame = found.to_dataframe()
    assert np.isnan(frame.loc["zero", "average_mode_error"])
    assert frame.loc["drawn", "average_mode_error"] == found["drawn"].average_mode_error


def test_a_data_frame_holds_the_numbers(found):
    frame = found.to_dataframe(["position", "speed"])
    assert list(frame.index) == list(found)
    for name, one in found.items():
        assert frame.loc[name, "speed"] == one.average[1]
        assert frame.loc[name, "speed_error"] == one.average_error[1]
        assert frame.loc[name, "average_log_score"] == one.average_log_score
        assert frame.loc[name, "diverged"] == one.diverged
    assert pandas.api.types.is_integer_dtype(frame["diverged"])
    with pytest.raises(ValueError, match="names: wanted 2, got 1"):
        found.to_dataframe(["position"])


def test_tuples_of_arrays_are_one_line(found):
    apart = found.difference("ekf", "<coarse>")
    assert repr(apart).startswith(f"<Difference: average {apart.average[0]:.4g} ± ")
    one = found["ekf"]
    assert repr(one).startswith(f"<Evaluation: {one.scored} of 400 paths, average ")
    for thing in (apart, one):
        assert "\n" not in repr(thing)
        assert len(repr(thing)) < 120
