"""A re-run of a notebook: numbers within their tolerance, the rest to the letter."""

import pytest

from bookkit.comparison import differences
from bookkit.recording import MIME


def cell(values=None, claims=None, **tolerances):
    return [{"data": {MIME: {"values": values or {}, "claims": claims or {}, **tolerances}}}]


REPRODUCED, REFUTED = (
    {"TS-X1": {"verdict": verdict, "computed": [1.0]}} for verdict in ("reproduced", "refuted")
)


@pytest.mark.parametrize(
    ("stored", "computed", "names"),
    [
        (cell({"x": 0.5407}), cell({"x": 0.5407 * (1 + 1e-9)}), []),
        (cell({"x": 0.5407}), cell({"x": 0.4407}), ["x"]),
        (cell({"v": [1.0, 2.0]}), cell({"v": [1.0, 2.0 + 1e-9]}), []),
        (cell({"v": [1.0, 2.0]}), cell({"v": [1.0, 2.1]}), ["v"]),
        (cell({"s": "a"}), cell({"s": "b"}), ["s"]),
        (cell({"x": 1.0}, rtol=1e-3), cell({"x": 1.0005}, rtol=1e-3), []),
        (cell({"x": 1.0}, rtol=1.0), cell({"x": 1.0}), ["x"]),  # another tolerance
        (cell({"n": 20_000_001}), cell({"n": 20_000_000}), ["n"]),
        (cell({"n": 20_000_001}, rtol=1e-3), cell({"n": 20_000_000}, rtol=1e-3), []),
        (cell({"x": True}), cell({"x": 1}), ["x"]),
        (cell({"x": 1.0}), cell({"y": 1.0}), ["x", "y"]),
        (cell(claims=REPRODUCED), cell(claims=REFUTED), ["TS-X1.verdict"]),
    ],
)
def test_differences_name_what_is_not_within_its_stored_tolerance(stored, computed, names):
    assert [line.split(":")[0] for line in differences(stored, computed)] == names
