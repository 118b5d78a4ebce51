"""Designed filters beside each other and as pictures, and what each kind predicts of itself."""

import dataclasses

import matplotlib.pyplot as plt
import numpy as np
import pytest
import sympy

from bookkit import plot_design
from seedslib import zoo
from seedslib.base import Axis
from seedslib.design import (
    Continuous,
    Polynomial,
    grid_synthesis,
    simulated_synthesis,
    synthesize,
    tabulated,
)
from seedslib.designed import Memory, finite_memory, large_order, load, save
from seedslib.evaluation import diff, evaluate
from seedslib.extra import learn
from seedslib.linearization import Cubature, ExactGaussian, Linearization, Taylor
from seedslib.models import JumpDiffusion, Noise

TIMES = 0.5 * np.arange(4)
GRID = {"x": (-3.5, 3.5, 121), "z": (-3.0, 3.0, 61), "y": (-8.0, 8.0, 81)}


class LeastSquares:
    """Cubic regression in all arguments, each by itself."""

    def fit(self, given, wanted):
        self.weights = np.linalg.lstsq(self._lifted(given), wanted, rcond=None)[0]
        return self

    def predict(self, given):
        return self._lifted(given) @ self.weights

    def _lifted(self, given):
        return np.concatenate([np.ones((len(given), 1)), given, given**2, given**3], axis=1)


def design(system=None, memory=None, rule=None, times=TIMES, **options):
    system = zoo.flip_process() if system is None else system
    memory = large_order(1) if memory is None else memory
    options = {"paths": 1500, "seed": 1, "step": 0.05, "nodes": 1} | options
    return synthesize(system, memory, ExactGaussian() if rule is None else rule, times, **options)


@pytest.fixture(scope="module")
def plain():
    return design()


@pytest.fixture(scope="module")
def table():
    return grid_synthesis(zoo.flip_process(), large_order(1), TIMES, nodes=1, **GRID)


@pytest.fixture
def closing():
    yield
    plt.close("all")


# What each kind predicts of itself

KINDS = {
    "affine": lambda: design(paths=8000),
    "polynomial": lambda: design(paths=8000, predictor=Polynomial(3, 2)),
    "continuous": lambda: design(paths=8000, rule=Taylor(), predictor=Continuous()),
    "exact moments": lambda: design(zoo.linear_gaussian(), rule=Taylor(), exact_moments=True),
    "grid": lambda: grid_synthesis(zoo.flip_process(), large_order(1), TIMES, nodes=1, **GRID),
    "simulated": lambda: simulated_synthesis(
        zoo.flip_process(), large_order(1), TIMES, paths=4000, seed=1, nodes=1
    ),
    "learned": lambda: learn(
        zoo.flip_process(), large_order(1), TIMES, paths=4000, seed=1, nodes=1,
        regressor=LeastSquares(),
    ),
    "read off": lambda: tabulated(
        design(paths=8000), y=(-9, 9, 121), z=(-5, 5, 61)
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_predicts_its_errors_with_standard_errors(kind):
    made = KINDS[kind]()
    predicted = made.predicted
    shape = (len(predicted.times), made.components)
    assert predicted.rms.shape == predicted.error.shape == shape
    assert np.isin(TIMES, predicted.times).all()
    assert ((predicted.error == 0.0) == made.design.exact).all()
    found = evaluate(made, made.system, TIMES, 8000, 77, step=0.01)
    at = np.searchsorted(predicted.times, TIMES)
    error = np.hypot(predicted.error[at], found.rms_error)
    # a grid and the larger step of a design add a little of their own
    allowed = 4 * error + 0.01 * found.rms
    assert (np.abs(predicted.rms[at] - found.rms) < allowed).all()


# Differences


def test_a_design_is_equal_to_itself_and_to_its_twin(tmp_path, plain):
    save(plain, tmp_path / "f.npz")
    for other in (plain, design(), load(tmp_path / "f.npz", zoo.flip_process())):
        found = diff(plain, other)
        assert found.equal
        assert str(found).endswith("nothing differs")


def test_a_changed_gain_shows_where_and_how_much(plain):
    fits = list(plain.fits)
    fits[1] = fits[1]._replace(gain=fits[1].gain * 1.25)
    found = diff(plain, dataclasses.replace(plain, fits=tuple(fits), rules=None))
    assert not found.equal
    assert found.changes == ()
    assert found.coefficients["gain"][1:] == pytest.approx([0.0, 0.2, 0.0], abs=1e-15)
    for name, apart in found.coefficients.items():
        if name != "gain":
            assert np.nanmax(apart) == 0.0
    row = next(line for line in str(found).splitlines() if line.startswith("  t = 1 "))
    assert "0.2" in row.split()


def test_predicted_errors_differ_by_their_combined_standard_errors(plain):
    rms, error = plain.predicted.rms * 1.1, plain.predicted.error * 0.75
    other = dataclasses.replace(plain, predicted=plain.predicted._replace(rms=rms, error=error))
    found = diff(plain, other).predicted
    assert found.difference == pytest.approx(0.1 * plain.predicted.rms)
    assert found.error == pytest.approx(1.25 * plain.predicted.error)
    assert found.z == pytest.approx(0.08 * plain.predicted.rms / plain.predicted.error)
    turned = diff(other, plain).predicted
    assert turned.z == pytest.approx(-found.z)


def test_designs_on_other_paths_differ_by_a_standard_normal_z():
    """Sixty independent pairs: the mean square of z is one within its own standard error."""
    system, z = zoo.linear_gaussian(), []
    for k in range(60):
        pair = [
            design(system, times=TIMES[:2], rule=Taylor(), nodes=0, paths=400, seed=2 * k + i)
            for i in (0, 1)
        ]
        z.append(diff(*pair).predicted.z[-1])
    square = np.square(z).mean(axis=0)
    assert (np.abs(square - 1.0) < 3.5 * np.sqrt(2 / 60)).all()


def test_choices_that_differ_are_named(plain):
    other = design(
        memory=Memory(1, 1), rule=Cubature(), predictor=Polynomial(2, 0), paths=900, seed=5,
        times=TIMES[:3],
    )  # fmt: skip
    found = diff(plain, other)
    changed = {change.name: change[1:] for change in found.changes}
    assert changed["memory"] == ("1 estimate", "1 estimate, 1 measurement")
    assert changed["linearization"] == ("ExactGaussian()", "Cubature()")
    assert changed["forecast"][1] == "Polynomial(mean_degree=2, cov_degree=0)"
    assert changed["designed on"] == ("1500 paths of seed 1", "900 paths of seed 5")
    assert changed["measurement times"] == ("4 from 0 to 1.5 by 0.5", "3 from 0 to 1 by 0.5")
    assert set(found.same) == {
        "kind", "components", "measured nodes", "between", "later steps", "model",
    }  # fmt: skip
    assert found.times.tolist() == TIMES[:3].tolist()
    text = str(found)
    assert all(name in text for name in changed)


def test_numbers_that_weigh_other_things_are_not_compared(plain):
    """One estimate and one measurement make gains of one shape that mean different things."""
    found = diff(plain, design(memory=finite_memory(1)))
    assert plain.fits[0].gain.shape == (1, 1)
    assert np.isnan(found.coefficients["gain"]).all()
    assert found.coefficients["start"][0] == 0.0
    # before the second estimate fills it, the longer memory holds the same
    longer = diff(plain, design(memory=large_order(2)))
    assert np.isfinite(longer.coefficients["gain"]).tolist() == [False, True, False, False]
    assert np.isnan(diff(plain, design(predictor=Polynomial(1, 0))).coefficients["gain"]).all()
    flowing = diff(plain, design(predictor=Continuous())).coefficients
    assert np.isnan(flowing["gain"]).all()
    moved = diff(plain, design(nodes=[[0.1], [0.6], [1.1]]))
    assert np.isnan(moved.coefficients["nodes: gain"]).all()


def test_a_model_is_the_same_however_it_is_written():
    a, b, v = sympy.symbols("a b v")

    def model(x, drift):
        return JumpDiffusion((x,), [drift], [[1]], [x + v], Noise((v,)), [0], [[1]])

    one, two, three = (
        design(model(x, drift), rule=Taylor())
        for x, drift in ((a, 1 - a**3), (b, (1 - b) * (1 + b + b**2)), (b, 1 - 2 * b**3))
    )
    assert "model" in diff(one, two).same
    changed = {change.name: change for change in diff(one, three).changes}
    assert "drift differs" in changed["model"].second
    assert changed["model (drift)"].second == "[1 - 2*b**3]"
    vector = diff(one, design(zoo.linear_gaussian(), rule=Taylor()))
    assert {c.name: c[1:] for c in vector.changes}["model (state components)"] == ("1", "2")


def test_a_model_that_is_not_known_is_said(tmp_path, table):
    save(table, tmp_path / "t.npz")
    found = diff(table, load(tmp_path / "t.npz"))
    assert [tuple(change) for change in found.changes] == [("model", "known", "unknown")]
    assert all(np.nanmax(apart) == 0.0 for apart in found.coefficients.values())


def test_a_linearization_of_ones_own_is_known_by_its_name():
    class Mine(Linearization):
        def moments(self, map, spread=True):
            return Taylor().moments(map, spread)

    assert diff(design(rule=Mine()), design(rule=Mine())).equal
    changed = {c.name: c for c in diff(design(rule=Mine()), design(rule=Taylor())).changes}
    assert changed["linearization"].first == "Mine"


def test_tables_are_compared_as_functions(table):
    steps = list(table.steps)
    shown = steps[2].shown
    steps[2] = steps[2]._replace(shown=shown._replace(estimate=shown.estimate * -0.5))
    other = dataclasses.replace(table, steps=tuple(steps))
    found = diff(table, other).coefficients
    assert found["output"] == pytest.approx([0.0, 0.0, 1.5, 0.0])
    assert np.nanmax(found["forecast"]) == np.nanmax(found["nodes: forecast"]) == 0.0


def test_tables_of_one_function_on_other_nodes_do_not_differ():
    made = design(zoo.linear_gaussian(), rule=Taylor(), components=1)
    coarse, fine = (tabulated(made, y=(-8, 8, n), z=(-6, 6, n)) for n in (5, 17))
    found = diff(coarse, fine)
    assert [change.name for change in found.changes] == ["functions"]
    for apart in found.coefficients.values():
        assert np.nanmax(apart) < 1e-12


def test_a_learned_function_is_compared_with_its_table():
    learned = KINDS["learned"]()
    read = learned.tabulated(y=(-8, 8, 41), z=(-3, 3, 41))
    for pair in ((learned, read), (read, learned)):
        found = diff(*pair)
        assert found.coefficients["output"] == pytest.approx(0.0, abs=1e-12)
    assert diff(learned, learned).equal
    twin = KINDS["learned"]()
    assert np.isnan(diff(learned, twin).coefficients["output"]).all()
    assert not diff(learned, twin).equal


def test_only_designs_are_compared(plain):
    with pytest.raises(TypeError, match="second: wanted a FiniteOrderFilter, got dict"):
        diff(plain, {})


# Pictures


@pytest.mark.usefixtures("closing")
def test_picture_of_predicted_errors():
    made = design(zoo.linear_gaussian(), rule=Taylor())
    (ax,) = plot_design(made).axes
    *curves, marks = ax.get_lines()
    assert len(curves) == 2
    for i, (line, area) in enumerate(zip(curves, ax.collections, strict=True)):
        np.testing.assert_array_equal(line.get_xdata(), made.predicted.times)
        np.testing.assert_array_equal(line.get_ydata(), made.predicted.rms[:, i])
        edge = area.get_paths()[0].vertices
        rms, error = made.predicted.rms[:, i], made.predicted.error[:, i]
        assert edge[:, 1].max() == pytest.approx((rms + 2 * error).max())
        assert edge[:, 1].min() == pytest.approx((rms - 2 * error).min())
    np.testing.assert_array_equal(marks.get_xdata(), TIMES)
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["component 1", "component 2", "measurements"]
    assert ax.get_ylim()[0] == 0.0


@pytest.mark.usefixtures("closing")
def test_picture_of_an_output_function(table):
    left, right = plot_design(table).axes
    assert left.get_lines()[0].get_ydata() == pytest.approx(table.predicted.rms[:, 0])
    lines = right.get_lines()
    assert len(lines) == 5
    for line, u in zip(lines, (-3.0, -1.5, 0.0, 1.5, 3.0), strict=True):
        y = line.get_xdata()
        wanted = table.output(3, y[None], np.full((1, len(y)), u)).mean[0]
        np.testing.assert_array_equal(line.get_ydata(), wanted)
        assert line.get_label() == f"memory u = {u:g}"
    first = plot_design(table, measurement=0).axes[1]
    assert len(first.get_lines()) == 1
    assert first.get_title() == "Output function at t = 0"


@pytest.mark.usefixtures("closing")
def test_picture_of_what_has_no_scalar_table(plain, table):
    assert len(plot_design(plain).axes) == 1
    long = simulated_synthesis(
        zoo.flip_process(), large_order(2), TIMES, paths=300, seed=1, nodes=0,
        y=Axis(-6, 6, 9), z=Axis(-3, 3, 9),
    )  # fmt: skip
    assert plot_design(long).axes[1].get_title() == "Output function at t = 0.5"
    with pytest.raises(ValueError, match=r"can be drawn \(0, 1\), got 2"):
        plot_design(long, measurement=2)
    with pytest.raises(ValueError, match=r"can be drawn \(none\), got 0"):
        plot_design(plain, measurement=0)
    with pytest.raises(TypeError, match="designed: wanted a FiniteOrderFilter, got int"):
        plot_design(3)
