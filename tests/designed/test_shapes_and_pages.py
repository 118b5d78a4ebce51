"""What fits together in a designed filter, and what its page says, word by word."""

from types import SimpleNamespace

import numpy as np
import pytest

from seedslib.base.clock import Clock
from seedslib.designed.prediction import (
    Design,
    HeldOut,
    Prediction,
    accuracy,
    finite_order_page,
    later_times,
    sensor_lines,
    shown_rows,
    switching_page,
)
from seedslib.designed.shapes import (
    check_array,
    check_covariances,
    check_errors,
    check_fields,
    check_nodes,
    check_times,
)

TIMES = np.array([0.0, 0.5, 2.0])
STOPS = np.array([0.0, 0.25, 0.5, 2.0])
PREDICTED = Prediction(STOPS, np.full((4, 2), [0.5, 0.25]), np.full((4, 2), [0.0125, 0.5]), True)
HELD = HeldOut(TIMES, np.full((3, 2), 0.625), np.full((3, 2), 0.03), np.ones((3, 2)), 700, 0)
RATES = {"mode_rate": np.full(3, 0.25), "mode_error": np.full(3, 0.01)}


def test_arrays():
    good = np.ones((2, 3))
    check_array("a", good, 2, None)
    check_array("a", good * np.nan, 2, 3, finite=False)
    check_fields("f", SimpleNamespace(a=good, b=good[0]), a=(2, 3), b=(None,))
    for array, shape, kind, match in (
        ([1.0], (1,), TypeError, "a: wanted an array of float64, got list"),
        (good.astype(int), (2, 3), TypeError, "a: wanted an array of float64, got int64"),
        (good, (3, 2), ValueError, "a"),
        (good, (2,), ValueError, "a"),
        (good * np.inf, (2, 3), ValueError, "a: wanted finite numbers"),
    ):
        with pytest.raises(kind, match=match):
            check_array("a", array, *shape)
    with pytest.raises(ValueError, match=r"f\.b"):
        check_fields("f", SimpleNamespace(a=good, b=good[0]), a=(2, 3), b=(4,))


def test_covariances():
    good, rounded = np.diag([2.0, 0.5]), np.diag([1.0, -1e-14])
    check_covariances("c", [good, rounded, np.eye(3), np.empty((0, 2, 2))])
    check_covariances("c", np.stack([good, rounded]))
    for bad in (np.diag([1.0, -0.1]), np.diag([-1.0, -1.0]), np.array([[1.0, 2.0], [2.0, 1.0]])):
        with pytest.raises(ValueError, match="c: wanted positive semidefinite covariances"):
            check_covariances("c", [good, bad, np.eye(3)])


def test_times_and_nodes():
    check_times(TIMES)
    for bad in (TIMES[::-1].copy(), np.array([0.0, 0.0]), np.empty(0)):
        with pytest.raises(ValueError, match="times: wanted an increasing grid"):
            check_times(bad)

    def nodes(*rows, fits=None):
        rows = tuple(np.array(row, dtype=float) for row in rows)
        return SimpleNamespace(
            times=TIMES, node_times=rows, node_fits=rows if fits is None else fits
        )

    check_nodes(nodes(), 2, 3)
    check_nodes(nodes([0.2, 0.3], []), 2, 3)
    check_nodes(nodes([0.2], [1.0], [2.5, 9.0]), 2, 3)
    for bad in (nodes([0.2]), nodes([0.2], [1.0], [3.0], [4.0]), nodes([0.2], [1.0], fits=((),))):
        with pytest.raises(ValueError, match="node_times, node_fits: wanted 2 intervals"):
            check_nodes(bad, 2, 3)
    with pytest.raises(ValueError, match="wanted 2 intervals"):
        check_nodes(nodes([0.2], [1.0], [3.0]), 2)
    for k, rows in enumerate([([0.5], []), ([], [0.5]), ([], [], [2.0])]):
        with pytest.raises(ValueError, match=rf"node_times\[{k}\]: outside of their interval"):
            check_nodes(nodes(*rows) if k == 2 else nodes(*rows, []), 2, 3)
    with pytest.raises(ValueError, match=r"node_times\[1\]"):
        check_nodes(nodes([], [1.5, 1.0]), 2, 3)


def test_errors_of_a_design():
    check_errors(None, None, TIMES, 2)
    check_errors(PREDICTED, HELD, TIMES, 2)
    check_errors(PREDICTED, HELD, TIMES, None)
    modes = PREDICTED._replace(mode_rate=np.full(4, np.nan), mode_error=np.ones(4))
    check_errors(modes, HELD._replace(**RATES), TIMES, 2)
    check_errors(None, HELD._replace(**RATES), TIMES, 2)
    short = PREDICTED._replace(times=STOPS[1:])
    for predicted, held, match in (
        (short, None, "predicted.times: wanted those of the measurements"),
        (PREDICTED._replace(rms=PREDICTED.rms[1:]), None, "predicted.rms"),
        (PREDICTED._replace(rms=PREDICTED.rms[:, :1]), None, "predicted.rms"),
        (PREDICTED._replace(error=PREDICTED.error[:, :1]), None, "predicted.error"),
        (modes._replace(mode_rate=np.ones(3)), None, "predicted.mode_rate"),
        (modes._replace(mode_error=np.ones(3)), None, "predicted.mode_error"),
        (PREDICTED, HELD._replace(rms=HELD.rms[1:]), "held_out.rms"),
        (PREDICTED, HELD._replace(error=HELD.error[:, :1]), "held_out.error"),
        (PREDICTED, HELD._replace(deviation=HELD.deviation[1:]), "held_out.deviation"),
        (PREDICTED, HELD._replace(**{**RATES, "mode_rate": np.ones(4)}), "held_out.mode_rate"),
        (PREDICTED, HELD._replace(**{**RATES, "mode_error": np.ones(4)}), "held_out.mode_error"),
    ):
        with pytest.raises(ValueError, match=match):
            check_errors(predicted, held, TIMES, 2)
    with pytest.raises(TypeError, match=r"held_out\.mode_rate"):
        check_errors(modes, HELD, TIMES, 2)


def filter(**changes):
    parts = {
        "order": 3, "memory": "<memory>", "predictor": "<forecast>", "linearization": "<rule>",
        "components": 2, "start": SimpleNamespace(mean=np.zeros(5)), "times": TIMES, "cycle": 0,
        "node_times": (STOPS[1:2], STOPS[:0]), "between": "interpolated", "clock": Clock(TIMES),
        "design": Design(4000, 500, 17, (), 6), "predicted": PREDICTED, "held_out": None,
        "measured": None, "availability": None, "fits": (),
    }  # fmt: skip
    return SimpleNamespace(**{**parts, **changes})


PAGE = """\
Finite-order filter of order 3: <memory>; <forecast>; <rule>
  estimates    2 of 5 state components
  measurements 3, from 0 to 2; 1 nodes between
  forecasts    interpolated
  designed on  4000 paths, seed 17, 6 diverged paths left out
  predicted root-mean-square errors (in-sample, with standard errors)
    t = 0        0.5000 ± 0.0125  0.2500 ± 0.5000
    t = 0.5      0.5000 ± 0.0125  0.2500 ± 0.5000
    t = 2        0.5000 ± 0.0125  0.2500 ± 0.5000"""


def test_the_page_of_a_filter():
    assert finite_order_page(filter()) == PAGE
    exact = filter(
        predicted=PREDICTED._replace(in_sample=False), cycle=2, held_out=HELD,
        design=Design(0, 0, None, (), exact=True), measured=np.array([[True, False]] * 3),
        availability=np.array([0.5, 1.0]),
        fits=[SimpleNamespace(prob=np.ones(c)) for c in (2, 7, 3)],
    )  # fmt: skip
    assert finite_order_page(exact).splitlines()[4:] == [
        "  schedule     3 of 6 components are read",
        "  availability 0.5, 1; up to 7 classes of histories",
        "  later times  the last 2 steps serve all in turn",
        "  designed on  exact moments",
        "  predicted root-mean-square errors",
        "  after the bar: on 700 paths that the design has not seen",
        "    t = 0        0.5000  0.2500 | 0.6250 ± 0.0300  0.6250 ± 0.0300",
        "    t = 0.5      0.5000  0.2500 | 0.6250 ± 0.0300  0.6250 ± 0.0300",
        "    t = 2        0.5000  0.2500 | 0.6250 ± 0.0300  0.6250 ± 0.0300",
    ]


def test_the_page_of_a_filter_of_modes():
    predicted = Prediction(
        TIMES, np.full((3, 1), 0.5), np.full((3, 1), 0.125), True, *RATES.values()
    )
    held = HeldOut(TIMES, *(np.full((3, 1), c) for c in (0.75, 0.0625, 1)), 90, 4, *RATES.values())
    modes = filter(system=SimpleNamespace(modes=4), predicted=predicted, held_out=held, cycle=1,
                   design=Design(300, 100, 5, (), 0, False, 2, 12, 3))  # fmt: skip
    assert switching_page(modes).splitlines() == [
        "Filter of 4 modes, of <memory>; <rule>",
        "  order        3",
        "  designed on  300 paths, seed 5",
        "  mended       2 of 12 thin pairs of cell and mode, 3 covariances",
        "  later times  the last step serves all",
        "  predicted errors of state and part of wrong modes (in-sample)",
        "  after the bar: on 90 paths that the design has not seen, 4 of them diverged",
        *(
            f"    t = {t:<8} 0.5000 ± 0.1250  modes 0.2500 ± 0.0100"
            " | 0.7500 ± 0.0625  modes 0.2500 ± 0.0100"
            for t in ("0", "0.5", "2")
        ),
    ]
    plain = filter(system=SimpleNamespace(modes=4), memory=None, design=None, predicted=None)
    assert switching_page(plain).splitlines() == [
        "Filter of 4 modes, carries the laws of all modes; <rule>", "  order        3",
    ]  # fmt: skip


def test_lines_that_are_too_long_stand_below_each_other():
    several = filter(
        predicted=PREDICTED._replace(rms=np.full((4, 6), 0.5), error=np.full((4, 6), 0.01)),
        held_out=HELD._replace(rms=np.full((3, 6), 0.75), error=np.full((3, 6), 0.02)),
    )
    lines = accuracy(several)
    assert len(lines) == 7
    assert lines[1] == "    t = 0        " + "  ".join(["0.5000 ± 0.0100"] * 6)
    assert lines[2] == "                | " + "  ".join(["0.7500 ± 0.0200"] * 6)


def test_rows_of_a_page():
    assert shown_rows(3).tolist() == [0, 1, 2]
    many = shown_rows(1000)
    assert many[0] == 0
    assert many[-1] == 999
    assert len(shown_rows(1)) == 1
    assert sensor_lines(filter()) == []
    assert later_times(filter()) == "  later times  none after the last time"
