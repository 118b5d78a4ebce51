"""What the switching pages record, computed again by programs that do not use the library.

`oracles/exact_switching.py` on grids, `oracles/switching_design.py` and
`oracles/dependent_noises.py` by simulation, on runs of their own.
"""

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bookkit.claims import LEDGER, read_ledger
from bookkit.recording import read_verdicts
from oracles import dependent_noises
from oracles.exact_switching import bayes, errors, errors_of_order_two, remembered
from oracles.switching_design import Filter, Scalar, Target, averages, scores, simulated
from seedslib import zoo
from seedslib.design import optimal_risk
from seedslib.designed import finite_memory, large_order

ROOT = Path(__file__).resolve().parents[2]
CLAIMS = {claim.id: claim for claim in read_ledger(ROOT / LEDGER)}
AXES = {"A1H": (-16, 18, 69), "A1L": (-11, 13, 121), "A2": (-8, 26, 137)}
DESIGN = 5000  # runs
BEYOND = 4.0  # standard errors


@pytest.mark.parametrize(
    ("sensor", "place", "grid"),
    [("A1H", 0, (65, 181, 81)), ("A1L", 2, (81, 201, 101)), ("A2", 4, (81, 201, 151))],
)
def test_errors_of_the_exact_filter_of_order_one(sensor, place, grid):
    squares, wrong = errors(sensor, 31, *grid)
    found = np.sqrt(squares[10:].mean()), wrong[10:].mean()
    wanted = CLAIMS["SW-X1"].reference[place : place + 2]
    assert np.allclose(found, wanted, rtol=0, atol=CLAIMS["SW-X1"].widths[0])


def test_errors_at_the_first_two_measurements():
    found = [np.sqrt(errors(sensor, 1)[0][0]) for sensor in ("A1H", "A1L", "A2")]
    found.append(np.sqrt(errors("A1H", 2, estimates=321)[0][1]))
    assert np.allclose(found, CLAIMS["SW-X4"].reference, rtol=0, atol=CLAIMS["SW-X4"].widths[0])


@pytest.mark.parametrize(("sensor", "measurements"), [("A1H", 61), ("A1L", 101), ("A2", 121)])
def test_errors_of_the_exact_filter_of_order_two(sensor, measurements):
    """The same nodes of the memory, others of the measurement; order one is apart by 0.01."""
    squares, wrong = errors_of_order_two(sensor, 6, 65, 31, measurements)
    axes = {"x": (-8, 8, 65), "z": (-6, 6, 31), "y": AXES[sensor]}
    risk = optimal_risk(zoo.scalar_switching(sensor), large_order(2), np.arange(6), **axes)
    assert np.allclose(squares, risk.mse, rtol=0, atol=1.5e-3)
    assert np.allclose(wrong, risk.mode_error, rtol=0, atol=1e-3)


@pytest.mark.parametrize("length", [1, 2])
@pytest.mark.parametrize("sensor", AXES)
def test_errors_of_the_exact_filters_that_remember_measurements(sensor, length):
    """By sums over all measurements."""
    found = remembered(sensor, length, 5, measurements=61 if sensor == "A1H" else 81)
    axes = {"x": (-8, 8, 65), "y": AXES[sensor]}
    risk = optimal_risk(zoo.scalar_switching(sensor), finite_memory(length), np.arange(6), **axes)
    assert np.allclose(found, [risk.mse[5], risk.mode_error[5]], rtol=0, atol=[1e-6, 2e-4])


def test_errors_with_dependent_noises():
    data = dependent_noises.simulated(21, 2000, 4)
    fits = dependent_noises.run(dependent_noises.simulated(21, 2000, 5), design=True)[2]
    runs = [
        dependent_noises.bayes(data),
        dependent_noises.run(data, printed=True),
        dependent_noises.run(data),
        dependent_noises.run(data, fits=fits),
    ]
    value, doubt = np.array([averages(scores(found, data, 5)) for found in runs]).swapaxes(0, 1)
    (entry,) = read_verdicts(ROOT)["SW-X10"].values()
    for wanted in (CLAIMS["SW-X10"].reference, entry["computed"]):
        assert np.all(np.abs(value.ravel() - wanted) < BEYOND * np.sqrt(2) * doubt.ravel())


# --- filters with Gaussian functions, on simulated runs


@cache
def table():
    """Share of wrong modes and RMS error by system and filter, as the library found them."""
    with (ROOT / "benchmarks/switching_order.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["part"] == "error"]
    return {
        (row["system"], row["filter"]): np.array([float(row["wrong_mode"]), float(row["value"])])
        for row in rows
    }


@cache
def data_of(name):
    system = Target(name.split()[1]) if name.startswith("B") else Scalar(name)
    return system, simulated(system, 31 if system.size == 1 else 41, 2000, 21)


@cache
def again(name, label):
    """Share of wrong modes and RMS error of the first component, and their standard errors."""
    system, data = data_of(name)
    if label == "grid Bayes":
        found = bayes(name, data[2])
    else:
        order = int(label.split()[1]) if label[:3] in ("FBP", "FKP") else "soft" in label
        counts = (0, order) if label.startswith("FKP") else (int(order), 0)
        heard, linear = label.endswith("with indicator"), label in ("IMM-EKF", "FBP-L 1")
        filter = Filter(system, *counts, "soft" in label, heard, linear=linear)
        if any(counts):
            filter = filter.designed(DESIGN, 24, len(data[0]))
        found = filter.run(data)[:2]
    value, doubt = averages(scores(found, data))
    return value[:2], doubt[:2]


LABELS = {
    "A1H": ("grid Bayes", "AOF-G", "IMM-EKF", "FBP-G 1", "FBP-L 1", "FKP-G 2", "FBP-G 2"),
    "A1L": ("soft FBP-G 1", "FKP-G 1"),
    "A2": ("AOF-G", "FBP-G 1", "FBP-L 1", "FKP-G 2"),
    "B noisy": ("AOF-G", "FBP-G 2", "FKP-G 1", "soft FBP-G 1", "FBP-G 1 with indicator"),
    "B exact": ("AOF-G", "FBP-G 1", "FBP-G 2"),
    "B none": ("AOF-G", "FBP-G 1", "FKP-G 1"),
}


@pytest.mark.parametrize(("name", "label"), [(s, label) for s in LABELS for label in LABELS[s]])
def test_numbers_of_the_gaussian_filters(name, label):
    value, doubt = again(name, label)
    width = BEYOND * doubt * np.sqrt(1 + 2000 / 20_000)  # of the runs here and in the table
    assert np.all(np.abs(value - table()[name, label]) <= width + 1e-9)


@pytest.mark.parametrize(
    ("label", "other"), [("IMM-EKF", "AOF-G"), ("FBP-G 1", "FKP-G 1"), ("FBP-L 1", "FBP-G 1")]
)
def test_a_filter_with_other_functions_is_told_apart(label, other):
    """The test above would see another rule for means, or another memory."""
    value, doubt = again("A1H", label)
    assert abs(value[1] - table()["A1H", other][1]) > BEYOND * np.sqrt(1.1) * doubt[1]
