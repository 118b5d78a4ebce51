"""The committed tables of the switching pages: parts of them computed again, and the references."""

import csv
import warnings
from pathlib import Path

import numpy as np
import pytest
import sympy

from bookkit.claims import read_ledger
from seedslib import zoo
from seedslib.design import grid_synthesis, optimal_risk, synthesize
from seedslib.designed import SwitchingFilter, finite_memory, large_order
from seedslib.designed.switching.lemmas import decide, weigh
from seedslib.evaluation import compare
from seedslib.filters import GridBayesFilter
from seedslib.linearization import ExactGaussian, GaussHermite, Taylor
from seedslib.models import Noise, SwitchingSystem

ROOT = Path(__file__).resolve().parents[2]
TIMES = np.arange(31.0)
SENSORS = ("A1H", "A1L", "A2")
KINDS = {"G": ExactGaussian(), "L": Taylor()}


def rows(name):
    with (ROOT / "benchmarks" / f"{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def designed(system, memory, linearization, paths, times=TIMES):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # cells that few paths visit
        return synthesize(system, memory, linearization, times, paths=paths, seed=71)


@pytest.fixture(scope="module")
def scored():
    """For each sensor filters without a design and designs, on 1500 paths."""
    found = {}
    for sensor in SENSORS:
        system = zoo.scalar_switching(sensor)
        filters = {
            f"FBP-{kind} {l}": designed(system, large_order(l), means, 3000)
            for kind, means in KINDS.items()
            for l in ((1,) if sensor == "A2" else (1, 3))
        }
        rules = {kind: filters[f"FBP-{kind} 1"].rules for kind in KINDS}
        filters["AOF-G"] = SwitchingFilter(system, KINDS["G"], rules=rules["G"])
        filters["IMM-EKF"] = SwitchingFilter(system, KINDS["L"], rules=rules["L"])
        found[sensor] = compare(filters, system, TIMES, 1500, 72, window=(10, 30))
    return found


def within(found, error, value, other, beyond=4.0):
    """Within four standard errors of the difference."""
    assert abs(found - value) < beyond * np.hypot(error, other)


# The data file of references


def test_references_of_the_ledger_are_those_of_the_data_file():
    """Each number once, but those that four standard errors do not tell from zero."""
    source, held = "benchmarks/switching_reference.csv", {}
    for row in rows("switching_reference"):
        held.setdefault(row["claim"], []).append(float(row["value"]))
    claims = {c.id: c for c in read_ledger(ROOT / "book" / "claims.yml") if c.source == source}
    assert set(claims) == set(held)
    for name, claim in claims.items():
        left = iter(held[name])
        assert all(value in left for value in claim.reference), name  # in their order
        assert all(
            w < abs(v) or v == w == 0 for v, w in zip(claim.reference, claim.widths, strict=True)
        )
    dropped = {name: len(held[name]) - len(c.reference) for name, c in claims.items()}
    assert {name: n for name, n in dropped.items() if n} == {"SW-X16": 7, "SW-X25": 15}


# Tables computed again


@pytest.mark.parametrize("sensor", SENSORS)
def test_filters_of_all_sensors_are_those_of_the_table(scored, sensor):
    table = {
        r["filter"]: [float(r[n]) for n in ("wrong_mode", "wrong_mode_error", "rms", "rms_error")]
        for r in rows("switching_scalar")
        if r["part"] == "average" and r["sensor"] == sensor
    }
    for name in ("AOF-G", "IMM-EKF", "FBP-G 1", "FBP-L 1"):
        one, (wrong, wrong_error, rms, rms_error) = scored[sensor][name], table[name]
        within(one.average_mode_error, one.average_mode_error_error, wrong, wrong_error)
        within(one.average[0], one.average_error[0], rms, rms_error)


@pytest.mark.parametrize("sensor", ["A1H", "A2"])
def test_course_of_the_table(scored, sensor):
    for row in rows("switching_scalar"):
        if (
            row["part"] == "time"
            and row["sensor"] == sensor
            and row["filter"] in ("AOF-G", "IMM-EKF")
        ):
            one, k = scored[sensor][row["filter"]], int(row["at"])
            within(one.rms[k, 0], one.rms_error[k, 0], float(row["rms"]), float(row["rms_error"]))
            wrong = float(row["wrong_mode"]), float(row["wrong_mode_error"])
            within(one.mode_error[k], one.mode_error_error[k], *wrong)


def paired(system):
    return {
        (r["filter"], r["other"]): [
            float(r[n]) for n in ("wrong_mode", "wrong_mode_error", "value", "error")
        ]
        for r in rows("switching_order")
        if r["part"] == "difference" and r["system"] == system
    }


def test_differences_that_can_be_told_from_zero(scored):
    here = scored["A1L"].difference("FBP-G 1", "AOF-G")
    there = paired("A1L")["FBP-G 1", "AOF-G"]
    within(here.average_square, here.average_square_error, *there[2:])
    assert here.average_square > 3 * here.average_square_error
    here = scored["A2"].difference("FBP-G 1", "AOF-G")
    within(here.average_mode, here.average_mode_error, *paired("A2")["FBP-G 1", "AOF-G"][:2])
    assert here.average_mode < -3 * here.average_mode_error


def test_with_little_noise_the_bank_is_better(scored):
    """And with strong noise, or two states for a measurement, the designed filters are."""
    for kind in KINDS:
        for l in (1, 3):
            name = f"FBP-{kind} {l}"
            quiet = scored["A1L"].difference(name, "IMM-EKF")
            assert quiet.average_square > 3 * quiet.average_square_error
            loud = scored["A1H"].difference(name, "IMM-EKF")
            assert loud.average_square < -3 * loud.average_square_error
            both = paired("A2")[name, "IMM-EKF"]
            assert both[2] < -3 * both[3]


@pytest.mark.parametrize("sensor", ["A1L", "A2"])
def test_linearised_filters_lose_more_with_the_other_sensors(scored, sensor):
    for linear, gaussian in (("IMM-EKF", "AOF-G"), ("FBP-L 1", "FBP-G 1")):
        apart = scored[sensor].difference(linear, gaussian)
        assert apart.average_square > 3 * apart.average_square_error
        within(
            apart.average_square, apart.average_square_error, *paired(sensor)[linear, gaussian][2:]
        )


def test_a_third_order_makes_a_gaussian_filter_worse(scored):
    """A1L on 2000 paths; designs on fewer paths than the table's lose a little more."""
    apart = scored["A1L"].difference("FBP-G 3", "FBP-G 1")
    third, second = (paired("A1L")[f"FBP-G {l + 1}", f"FBP-G {l}"] for l in (2, 1))
    assert third[2] > 3 * third[3]
    assert second[2] < -3 * second[3]
    assert apart.average_square > third[2] + second[2] - 4 * apart.average_square_error
    fourth = paired("B noisy")["FBP-G 4", "FBP-G 3"]
    assert fourth[2] > 3 * fourth[3]


def test_measurements_are_better_to_remember_where_the_sign_is_open():
    system = zoo.scalar_switching("A2")
    filters = {
        "FBP": designed(system, large_order(3), KINDS["G"], 5000),
        "FKP": designed(system, finite_memory(3), KINDS["G"], 5000),
    }
    apart = compare(filters, system, TIMES, 1000, 73, window=(10, 30)).difference("FBP", "FKP")
    assert apart.average_square > 3 * apart.average_square_error


@pytest.mark.parametrize(("indicator", "last"), [("exact", 4), ("noisy", 3)])
def test_orders_of_the_target_three_and_four(indicator, last):
    """The table; orders one to three of the exact indicator run in another test."""
    table = {r["name"]: r for r in rows("switching_target") if r["indicator"] == indicator}
    for l in range(2, last + 1):
        line = table[f"FBP {l} minus FBP {l - 1}"]
        assert float(line["square"]) < -3 * float(line["square_error"])
    none = {r["name"]: r for r in rows("switching_target") if r["indicator"] == "none"}
    line = none["FBP 3 minus FBP 2"]
    assert float(line["mode"]) > 3 * float(line["mode_error"])


def test_a_row_of_the_table_of_exact_filters():
    """Order two with the coarsest memory: the whole row, to its digits."""
    wanted = ["A1H", "estimates", "2", "0.8"]
    (row,) = (
        r for r in rows("switching_exact")
        if [r[n] for n in ("sensor", "memory", "order", "memory_step")] == wanted
    )  # fmt: skip
    risk = optimal_risk(
        zoo.scalar_switching("A1H"), large_order(2), TIMES, x=(-8, 8, 81), z=(-6, 6, 16),
        y=(-16, 18, 137),
    )  # fmt: skip
    assert np.sqrt(risk.mse[10:].mean()) == pytest.approx(float(row["rmse"]), abs=1e-5)
    assert risk.mode_error[10:].mean() == pytest.approx(float(row["mode_error"]), abs=1e-5)


def test_a_point_of_the_sweep():
    """Deviation 0.5 at the full rate: the exact filter is closer to the Bayes filter."""
    system, order = zoo.scalar_switching("A1H", deviation=0.5), large_order(1)
    filters = {
        "bayes": GridBayesFilter(system, (-8, 8, 121)),
        "fbp_g": designed(system, order, KINDS["G"], 5000),
        "exact": grid_synthesis(
            system, order, TIMES, x=(-8, 8, 121), z=(-6, 6, 61), y=(-10, 12, 221)
        ),
    }
    found = compare(filters, system, TIMES, 1000, 74, window=(10, 30))
    apart = found.difference("fbp_g", "exact")
    assert apart.average[0] > 3 * apart.average_error[0]
    with (ROOT / "sweeps" / "switching_noise.csv").open(newline="") as file:
        (point,) = (
            r for r in csv.DictReader(file) if (r["deviation"], r["rate"]) == ("0.5", "1.0")
        )
    for name in ("exact", "fbp_g"):
        more, base = found.difference(name, "bayes"), found["bayes"].average[0] / 100
        wanted = float(point[f"more_{name}"]), float(point[f"more_error_{name}"])
        within(more.average[0] / base, more.average_error[0] / base, *wanted)


def test_times_of_single_steps_are_whole_tables():
    """Latencies belong to one machine: it is named, and no step is faster than none."""
    found = rows("switching_step")
    assert {r["filter"] for r in found} >= {"exact FBP 1", "FBP-G 1", "FBP-L 1"}
    for row in found:
        assert row["processor"]
        assert 0 < float(row["median"]) <= float(row["slowest"])
        assert int(row["steps"]) == 29 * len(TIMES)


# Theorem 3 in its corrected order


def steps_by_the_lemmas(filter, y, stale=False):
    """Correct, decide, push, take the cell, forecast, with the library's lemmas one by one."""
    rules, blocks, found = filter.rules, [], []
    law = rules.initial((y.shape[-1],))
    l = filter.memory.estimates
    for k, shown in enumerate(y):
        posterior, _ = weigh(rules.sense(float(k), law, None), shown)
        mode, estimate = decide(posterior)
        found.append(estimate)
        if k == len(y) - 1:
            break
        old, blocks = blocks, [(mode, estimate), *blocks][:l]
        held = old if stale and k else blocks
        cell = sum(m * 2**c for c, (m, _) in enumerate(reversed(held)))
        vector = np.concatenate([e for _, e in held])
        law = rules.predict(float(k), filter.fits[k].forecast(cell, vector))
    return np.array(found)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sensor", SENSORS)
def test_every_sensor_order_and_kind_follows_the_corrected_steps(sensor, kind):
    system, times = zoo.scalar_switching(sensor), np.arange(8.0)
    y = system.simulate(times, 50, 75).measurements
    for l in (1, 2, 3):
        filter = designed(system, large_order(l), KINDS[kind], 800, times)
        run = filter.run(times, y).mean
        np.testing.assert_allclose(steps_by_the_lemmas(filter, y), run, rtol=1e-9, atol=1e-9)
        if l == 1:  # the printed order: the memory before the decision
            assert np.abs(steps_by_the_lemmas(filter, y, stale=True) - run).max() > 0.5


def test_one_mode_is_the_ordinary_filter():
    """The recursion of one normal law, typed by hand: no probabilities, means by six nodes."""
    x, v, w = sympy.symbols("x v w", real=True)
    system, times = SwitchingSystem(
        state=(x,), dynamics=[[x + sympy.sin(x) + v / 2]], noise=Noise((v,)), switching=[[1]],
        sensor=[[x / 2 + x**2 / 5 + w]], sensor_noise=Noise((w,)), initial=[(1.0, [0], [[1]])],
    ), np.arange(6.0)  # fmt: skip
    filter = synthesize(system, large_order(2), GaussHermite(6), times, paths=1000, seed=77)
    y = system.simulate(times, 100, 76).measurements
    rule, weights = np.polynomial.hermite_e.hermegauss(6)
    weights = weights[:, None] / np.sqrt(2 * np.pi)

    def moments(mean, var, function):
        at = mean + np.sqrt(var) * rule[:, None]
        middle = (weights * function(at)).sum(axis=0)
        apart = function(at) - middle
        return middle, (weights * (at - mean) * apart).sum(axis=0), (weights * apart**2).sum(axis=0)

    mean, var, held, found = np.zeros(100), np.ones(100), [], []
    for k, shown in enumerate(y[:, 0]):
        mu, cross, spread = moments(mean, var, lambda at: at / 2 + at**2 / 5)
        held = [mean + cross / (spread + 1) * (shown - mu), *held][:2]
        found.append(held[0])
        if k < 5:
            fit = filter.fits[k]
            centre = np.tensordot(fit.gain[0, :, 0, 0], held, 1) + fit.offset[0, 0, 0]
            mean, _, var = moments(centre, fit.cov[0, 0, 0, 0], lambda at: at + np.sin(at))
            var = var + 0.25
    np.testing.assert_allclose(found, filter.run(times, y).mean[:, 0], rtol=1e-9, atol=1e-9)
