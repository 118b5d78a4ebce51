"""What the switching chapters record, computed again by programs that do not use the library.

The chapters compare the library's numbers with references that were typed from elsewhere. Both are
compared here with short programs on paths of their own: `oracles/exact_switching.py` on grids,
`oracles/switching_design.py` and `oracles/dependent_noises.py` by simulation.
"""

import csv
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from bookkit.claims import LEDGER, read_ledger
from bookkit.recording import read_verdicts
from oracles import dependent_noises
from oracles.exact_switching import bayes, errors, errors_of_order_two, remembered
from oracles.switching_design import (
    Filter,
    Scalar,
    Target,
    averages,
    constant,
    histories,
    scores,
    simulated,
)

ROOT = Path(__file__).resolve().parents[2]
CLAIMS = {claim.id: claim for claim in read_ledger(ROOT / LEDGER)}
SIMULATED = [
    claim.id for claim in CLAIMS.values() if claim.source == "tests/oracles/switching_design.py"
]
DESIGN = 5000  # paths
LIBRARY = {"RBPF 100": 2000}  # paths that the library's tables have seen, or 20 000
LONG = "50000 design paths"  # such designs take minutes, and are no better than those on 10 000
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


@pytest.mark.parametrize(
    ("sensor", "place", "measurements"), [("A1H", 0, 61), ("A1L", 1, 101), ("A2", 2, 121)]
)
def test_errors_of_the_exact_filter_of_order_two(sensor, place, measurements):
    """With steps of the memory of 0.4 and 0.2, whose errors are as 4 to 1.

    From k = 20 to 30 nothing changes.
    """
    claim, found = CLAIMS["SW-X2"], []
    for estimates in (31, 61):
        course = errors_of_order_two(sensor, 21, 65, estimates, measurements)[:, 10:]
        square, wrong = np.average(course, axis=1, weights=[1] * 10 + [11])
        found.append((np.sqrt(square), wrong))
    coarse, (fine, wrong) = found[0][0], found[1]
    places = [2 * place, 2 * place + 1, 6 + place]
    wanted, widths = np.array(claim.reference)[places], np.array(claim.widths)[places]
    assert np.all(np.abs([fine, wrong, fine - (coarse - fine) / 3] - wanted) < widths)


@pytest.mark.parametrize("length", [1, 2])
@pytest.mark.parametrize(("sensor", "place"), [("A1H", 0), ("A1L", 2), ("A2", 4)])
def test_errors_of_the_exact_filters_that_remember_measurements(sensor, place, length):
    """By sums over all measurements; from k = 20 to 30 nothing changes."""
    place += 6 * (length - 1)
    nodes = 61 if sensor == "A1H" else 81
    course = np.array([remembered(sensor, length, k, measurements=nodes) for k in range(10, 21)])
    square, wrong = np.average(course, axis=0, weights=[1] * 10 + [11])
    found = np.sqrt(square), wrong
    wanted = CLAIMS["SW-X3"].reference[place : place + 2]
    assert np.allclose(found, wanted, rtol=0, atol=CLAIMS["SW-X3"].widths[0])


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
    for wanted in (CLAIMS["SW-X10"].reference, recorded("SW-X10")):
        assert np.all(np.abs(value.ravel() - wanted) < BEYOND * np.sqrt(2) * doubt.ravel())


# --- filters with Gaussian functions, on simulated paths


@cache
def records():
    return read_verdicts(ROOT)


def recorded(id):
    """The library's numbers, as the notebook has recorded them."""
    (entry,) = records()[id].values()
    return entry["computed"]


@cache
def system_of(name):
    return Scalar(name) if name in ("A1H", "A1L", "A2") else Target(name.split()[1])


@cache
def paths_of(name, count=2000):
    system = system_of(name)
    return simulated(system, 31 if system.size == 1 else 41, count, 21)


def filter_of(name, label):
    """The filter that a label of the table means, before it is designed."""
    system = system_of(name)
    if label.endswith(", constant switching"):
        system, label = constant(system, 10_000, 22), label.removesuffix(", constant switching")
    if label in ("AOF-G", "IMM", "IMM-EKF", "known modes"):
        return Filter(system, linear=label == "IMM-EKF")
    parts = label.split()
    kind, order = next((p, int(q)) for p, q in pairwise(parts) if q.isdigit())
    counts = (0, order) if kind.startswith("FKP") else (order, 0)
    heard = label.endswith("with indicator")
    return Filter(system, *counts, "soft" in label, heard, linear=kind.endswith("-L"))


@cache
def course(name, label, paths=DESIGN):
    """Wrong modes (steps, paths) and squares of errors (steps, n, paths) of a filter."""
    data = paths_of(name)
    if label == "grid Bayes":
        found = bayes(name, data[2])
    elif label.startswith("RBPF"):
        found = histories(system_of(name), data, int(label.split()[1]))
    else:
        filter = filter_of(name, label)
        if filter.estimates + filter.measurements:
            thin = filter.system.size * filter.estimates >= 6  # eight cells and more
            filter = filter.designed(3 * paths if thin else paths, 24, len(data[0]))
        found = filter.run(data)[:2]
    return found[0] != data[0], (found[1] - data[1]) ** 2


def root(square):
    """Root of a mean over paths and its error a path."""
    mean = square.mean()
    return np.sqrt(mean), (square - mean) / (2 * np.sqrt(mean))


def ratio(first, second):
    value = first[0] / second[0]
    return value, value * (first[1] / first[0] - second[1] / second[0])


def again(row):
    """A line of the table of references: the value found here and its standard error."""
    name, label, quantity, at = (row[part] for part in ("system", "filter", "quantity", "at"))
    name = "target, exact indicator" if name == "target" else name
    paths = int(at.split()[0]) if at.endswith("design paths") else DESIGN
    times = slice(int(at), int(at) + 1) if at.isdigit() else slice(10, None)

    def of(label):
        wrong, square = course(name, label, paths)
        wrong, square = wrong[times].mean(axis=0), square[times].mean(axis=0)
        if quantity.endswith("wrong modes"):
            return wrong.mean(), wrong - wrong.mean()
        if quantity.endswith("mean squares"):
            return square.sum(axis=0).mean(), square.sum(axis=0) - square.sum(axis=0).mean()
        return root(square[int(quantity.startswith("velocity"))])

    if " minus " in label:
        first, second = (of(part) for part in label.split(" minus "))
        value, away = first[0] - second[0], first[1] - second[1]
    elif " over " in label:
        value, away = ratio(*(of(part) for part in label.split(" over ")))
    elif quantity.startswith("excess"):
        value, away = ratio(of(label), of("IMM"))  # which an exact indicator tells the modes
        value, away = 100 * (value - 1), 100 * away
    else:
        value, away = of(label)
    return value, np.sqrt(np.mean(away**2) / len(away))


def lines(id):
    """Lines of the table, with the library's number where the notebook records it."""
    with (ROOT / "benchmarks/switching_reference.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["claim"] == id]
    wanted, ours, found = list(CLAIMS[id].reference), list(recorded(id)), []
    for row in rows:
        told = bool(wanted) and float(row["value"]) == wanted[0]
        found.append((row, ours.pop(0) if told else None))
        wanted = wanted[1:] if told else wanted
    assert not wanted + ours, f"{id}: numbers of the ledger that no line belongs to"
    return found


@pytest.mark.parametrize("id", SIMULATED)
def test_numbers_of_the_gaussian_filters(id):
    """Four standard errors of the difference; the references saw about as many paths."""
    for row, ours in lines(id):
        if row["at"] == LONG:
            continue
        value, doubt = again(row)
        theirs, digit = row["value"], 0.5 * 10.0 ** -len(row["value"].partition(".")[2])
        where = f"{row['system']}, {row['filter']}, {row['quantity']}, {row['at']}"
        width = BEYOND * np.hypot(doubt, float(row["error"] or doubt)) + digit * bool(doubt)
        assert abs(value - float(theirs)) <= width, where
        if ours is not None:
            width = BEYOND * doubt * np.sqrt(1 + 2000 / LIBRARY.get(row["filter"], 20_000))
            assert abs(value - ours) <= width, where


@pytest.mark.parametrize("indicator", ["noisy", "none"])
def test_what_histories_of_modes_are_worth(indicator):
    """The gain over the IMM filter on common paths, which is known better than either error."""
    name = f"target, {indicator} indicator"
    squares = [
        course(name, label)[1][10:].sum(axis=1).mean(axis=0) for label in ("RBPF 100", "IMM")
    ]
    gain = squares[0] - squares[1]
    with (ROOT / "benchmarks/switching_target.csv").open(newline="") as file:
        rows = {(row["indicator"], row["name"]): row for row in csv.DictReader(file)}
    row = rows[indicator, "RBPF 100 minus IMM again"]
    width = BEYOND * np.hypot(float(row["square_error"]), gain.std() / np.sqrt(len(gain)))
    assert abs(gain.mean() - float(row["square"])) < width


def test_a_filter_with_other_functions_is_told_apart():
    """The test above would see another rule for means, another memory, another indicator."""
    numbers = {(r["filter"], r["quantity"]): float(r["value"]) for r, _ in lines("SW-X20")}
    for label, other in (("IMM-EKF", "AOF-G"), ("FBP-G 1", "FKP-G 1"), ("FBP-L 1", "FBP-G 1")):
        row = {"system": "A1H", "filter": label, "quantity": "RMS error", "at": "10 to 30"}
        value, doubt = again(row)
        assert abs(value - numbers[other, "RMS error"]) > BEYOND * np.sqrt(2) * doubt
