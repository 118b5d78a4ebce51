"""Designed filters of switching systems beside each other and as pictures."""

import dataclasses

import matplotlib.pyplot as plt
import numpy as np
import pytest

from bookkit import plot_design
from seedslib import zoo
from seedslib.design import grid_synthesis, synthesize
from seedslib.designed import Memory, SwitchingFilter, finite_memory, large_order, load, save
from seedslib.evaluation import diff
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import SwitchingSystem

pytestmark = pytest.mark.filterwarnings("ignore:paths. .* too few paths of their own")

TIMES = np.arange(4.0)
GRID = {"x": (-8, 8, 81), "z": (-6, 6, 31), "y": (-16, 18, 69)}
SYSTEM = zoo.scalar_switching("A1H")


def design(system=SYSTEM, memory=None, rule=None, times=TIMES, paths=4000, seed=1, **options):
    memory = large_order(1) if memory is None else memory
    rule = Taylor() if rule is None else rule
    return synthesize(system, memory, rule, times, paths=paths, seed=seed, **options)


@pytest.fixture(scope="module")
def plain():
    return design()


@pytest.fixture(scope="module")
def table():
    return grid_synthesis(SYSTEM, large_order(1), TIMES, **GRID)


@pytest.fixture
def closing():
    yield
    plt.close("all")


# Differences


def test_designs_are_equal_to_themselves_and_to_their_files(tmp_path, plain, table):
    for made in (plain, table):
        save(made, tmp_path / "f.npz")
        for other in (made, load(tmp_path / "f.npz", zoo.scalar_switching("A1H"))):
            found = diff(made, other)
            assert found.equal
            assert str(found).endswith("nothing differs")
    assert diff(plain, design()).equal
    unknown = diff(table, load(tmp_path / "f.npz"))
    assert [tuple(change) for change in unknown.changes] == [("model", "known", "unknown")]
    assert not np.nanmax([np.nanmax(part) for part in unknown.coefficients.values()])


def test_a_changed_gain_shows_where_and_how_much(plain):
    fits = list(plain.fits)
    fits[1] = fits[1]._replace(gain=fits[1].gain * 1.25)
    found = diff(plain, dataclasses.replace(plain, fits=tuple(fits)))
    assert not found.equal
    assert found.changes == ()
    for name, apart in found.coefficients.items():
        wanted = [0.0, 0.2 if name == "gain" else 0.0, 0.0]
        assert apart[:3] == pytest.approx(wanted, abs=1e-15)
        assert np.isnan(apart[3])  # no forecast starts at the last measurement
    row = next(line for line in str(found).splitlines() if line.startswith("  t = 1 "))
    assert "0.2" in row.split()


def test_the_same_law_factored_otherwise_does_not_differ(plain):
    """Rotations of the whitened memory and a shift of all log-weights change no forecast."""
    made = design(memory=large_order(2))
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    fits = [
        fit if fit.white.shape[0] == 1 else fit._replace(
            white=np.einsum("ab,bcLC->acLC", turn, fit.white), log_weight=fit.log_weight + 3.0
        )
        for fit in made.fits
    ]  # fmt: skip
    found = diff(made, dataclasses.replace(made, fits=tuple(fits)))
    assert max(np.nanmax(apart) for apart in found.coefficients.values()) < 1e-14


def test_predicted_errors_of_states_and_modes(plain):
    predicted = plain.predicted
    worse = predicted._replace(
        rms=1.1 * predicted.rms, mode_rate=predicted.mode_rate + 0.05,
        mode_error=0.75 * predicted.mode_error,
    )  # fmt: skip
    found = diff(plain, dataclasses.replace(plain, predicted=worse))
    assert found.predicted.difference == pytest.approx(0.1 * predicted.rms)
    assert found.modes.difference[:, 0] == pytest.approx(np.full(4, 0.05))
    assert found.modes.error[:, 0] == pytest.approx(1.25 * predicted.mode_error)
    assert found.modes.z[:, 0] == pytest.approx(0.04 / predicted.mode_error)
    text = str(found)
    assert "predicted part of wrong modes, second minus first" in text
    assert text.count("(+0.0500 ± ") == 4
    only_modes = dataclasses.replace(
        plain, predicted=predicted._replace(mode_rate=predicted.mode_rate + 0.05)
    )
    assert not diff(plain, only_modes).equal
    assert not diff(plain, dataclasses.replace(plain, predicted=None)).modes.times.size


def test_choices_that_differ_are_named(plain):
    other = design(memory=Memory(1, 1), rule=ExactGaussian(), paths=3000, seed=5, times=TIMES[:3])
    found = diff(plain, other)
    changed = {change.name: change[1:] for change in found.changes}
    assert changed == {
        "memory": ("1 estimate", "1 estimate, 1 measurement"),
        "linearization": ("Taylor()", "ExactGaussian()"),
        "measurement times": ("4 from 0 to 3 by 1", "3 from 0 to 2 by 1"),
        "designed on": ("4000 paths of seed 1", "3000 paths of seed 5"),
    }
    assert set(found.same) == {"kind", "later steps", "normalisation", "model"}
    assert np.isnan(found.coefficients["gain"]).all()
    longer = diff(plain, design(memory=large_order(2))).coefficients
    assert longer["gain"][0] == 0.0
    assert np.isnan(longer["gain"][1:]).all()
    # gains of one shape that weigh other things
    assert np.isnan(diff(plain, design(memory=finite_memory(1))).coefficients["gain"]).all()


def test_models_that_differ_are_named(plain):
    found = diff(plain, design(zoo.scalar_switching("A1L")))
    changed = {change.name: change for change in found.changes}
    assert "readings differs" in changed["model"].second
    assert "model (readings)" in changed
    target = diff(plain, design(zoo.manoeuvring_target()))
    changed = {change.name: change[1:] for change in target.changes}
    assert changed["model (state components)"] == ("1", "2")
    again = SwitchingSystem.from_maps(
        [[b.map for b in row] for row in SYSTEM.branches],
        [[b.map for b in row] for row in SYSTEM.readings],
        SYSTEM.initial,
    )
    assert diff(plain, design(again)).equal


def test_tables_are_compared_at_nodes(table):
    steps = list(table.steps)
    shown = steps[2].shown
    mode = shown.mode.copy()
    mode.flat[:: mode.size // 10] = 1 - mode.flat[:: mode.size // 10]
    changed = shown._replace(estimate=shown.estimate * -0.5, mode=mode)
    steps[2] = steps[2]._replace(shown=changed)
    found = diff(table, dataclasses.replace(table, steps=tuple(steps))).coefficients
    assert found["output"] == pytest.approx([0.0, 0.0, 1.5, 0.0])
    assert found["output mode"][2] == pytest.approx((mode != shown.mode).mean())
    assert found["output mode"][[0, 1, 3]].tolist() == found["forecast mode"][[0, 1, 3]].tolist()
    finer = grid_synthesis(SYSTEM, large_order(1), TIMES, **{**GRID, "y": (-16, 18, 137)})
    apart = diff(table, finer).coefficients["output"]
    assert 0.0 < apart.max() < 0.1


def test_kinds_that_do_not_compare(plain, table):
    mixed = diff(plain, table)
    assert {c.name for c in mixed.changes} >= {"kind", "functions", "linearization"}
    assert not mixed.comparable
    assert "no coefficients that could be compared" in str(mixed)
    with pytest.raises(TypeError, match="second: wanted a filter of a switching system, got int"):
        diff(plain, 3)
    with pytest.raises(TypeError, match="first: wanted a FiniteOrderFilter, got dict"):
        diff({}, plain)
    with pytest.raises(TypeError, match="second: wanted a designed filter"):
        diff(plain, SwitchingFilter(SYSTEM, Taylor()))


# Pictures


@pytest.mark.usefixtures("closing")
def test_picture_of_predicted_errors_and_wrong_modes(plain, table):
    for made in (plain, table):
        predicted = made.predicted
        left, right = plot_design(made).axes
        np.testing.assert_array_equal(left.get_lines()[0].get_ydata(), predicted.rms[:, 0])
        (line,) = right.get_lines()
        np.testing.assert_array_equal(line.get_ydata(), predicted.mode_rate)
        edge = right.collections[0].get_paths()[0].vertices[:, 1]
        top = (predicted.mode_rate + 2 * predicted.mode_error).max()
        assert edge.max() == pytest.approx(top)
        assert right.get_ylim()[0] == 0.0
        assert right.get_ylabel() == "part of wrong modes"


@pytest.mark.usefixtures("closing")
def test_pictures_that_cannot_be_drawn(plain):
    assert len(plot_design(design(zoo.steady_target())).axes) == 1
    with pytest.raises(ValueError, match="measurement: wanted none for a switching system"):
        plot_design(plain, measurement=1)
    with pytest.raises(ValueError, match="wanted a filter with predicted errors"):
        plot_design(SwitchingFilter(SYSTEM, Taylor()))
