"""Two designed filters beside each other: choices, coefficients and predicted errors."""

from dataclasses import replace

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import Continuous, Polynomial, grid_synthesis, synthesize, tabulated
from seedslib.designed import Memory, finite_memory, large_order, load, save
from seedslib.evaluation import diff
from seedslib.extra import learn
from seedslib.linearization import Cubature, ExactGaussian, Taylor
from seedslib.models import JumpDiffusion, Noise

pytestmark = pytest.mark.filterwarnings("ignore:paths. .* too few paths of their own")
TIMES = 0.5 * np.arange(4)
GRID = {"x": (-3.5, 3.5, 61), "z": (-3.0, 3.0, 31), "y": (-8.0, 8.0, 41)}
FLIP, MODES = zoo.flip_process(), zoo.scalar_switching("A1H")


def design(system=FLIP, memory=None, rule=None, times=TIMES, **options):
    options = {"paths": 1000, "seed": 1, "step": 0.05, "nodes": 1} | options
    return synthesize(system, memory or large_order(1), rule or ExactGaussian(), times, **options)


def of_modes(system=MODES, memory=None, **options):
    options = {"paths": 2000, "seed": 1} | options
    return synthesize(system, memory or large_order(1), Taylor(), np.arange(4.0), **options)


def grids(system=FLIP, times=TIMES, **options):
    return grid_synthesis(system, large_order(1), times, **{**GRID, **options})


def of_mode_grids(**options):
    axes = {"x": (-8, 8, 41), "z": (-6, 6, 21), "y": (-16, 18, 35)} | options
    return grid_synthesis(MODES, large_order(1), np.arange(4.0), **axes)


class LeastSquares:
    def fit(self, given, wanted):
        self.weights = np.linalg.lstsq(np.column_stack([np.ones(len(given)), given]), wanted)[0]
        return self

    def predict(self, given):
        return np.column_stack([np.ones(len(given)), given]) @ self.weights


def changed(found):
    return {change.name: change[1:] for change in found.changes}


@pytest.mark.parametrize("make", [design, of_modes, grids, of_mode_grids])
def test_a_design_equals_its_twin_and_its_file_and_changes_are_found_where_they_are(make, tmp_path):
    one = make()
    save(one, tmp_path / "f.npz")
    for other in (make(), load(tmp_path / "f.npz", one.system)):
        assert diff(one, other).equal
    if make in (design, of_modes):
        fits = [fit._replace(gain=fit.gain * 1.25) if k == 1 else fit
                for k, fit in enumerate(one.fits)]  # fmt: skip
        other = replace(one, fits=tuple(fits), **({"rules": None} if make is design else {}))
        # the forecast of a regression leads to the measurement, that of modes starts from it
        changes = {("gain", 2 if make is design else 1): 0.2}
    else:
        found = diff(one, load(tmp_path / "f.npz"))
        assert [tuple(change) for change in found.changes] == [("model", "known", "unknown")]
        steps, shown = list(one.steps), one.steps[2].shown
        new = {"estimate": shown.estimate * -0.5}
        if shown.mode is not None:
            new["mode"] = 1 - shown.mode
        steps[2] = steps[2]._replace(shown=shown._replace(**new))
        other = replace(one, steps=tuple(steps))
        changes = {("output", 2): 1.5, ("output mode", 2): 1.0}
    found = diff(one, other)
    assert not found.equal
    assert found.changes == ()
    for name, part in found.coefficients.items():
        wanted = [changes.get((name, k), 0.0) for k in range(4)]
        np.testing.assert_allclose(np.nan_to_num(part), wanted, atol=1e-14)
    assert "t = " in str(found)
    predicted = one.predicted
    worse = predicted._replace(rms=predicted.rms * 1.1, error=predicted.error * 0.75)
    found = diff(one, replace(one, predicted=worse)).predicted
    assert found.difference == pytest.approx(0.1 * predicted.rms)
    assert found.error == pytest.approx(1.25 * predicted.error)
    if "mode" in make.__name__:
        worse = predicted._replace(mode_rate=predicted.mode_rate + 0.05)
        found = diff(one, replace(one, predicted=worse)).modes
        assert found.difference[:, 0] == pytest.approx(np.full(4, 0.05))


def test_choices_and_models_that_differ_are_named_and_what_weighs_other_things_is_not_compared():
    plain, read = design(), np.array([[True], [True], [False], [True]])
    other = design(
        memory=Memory(1, 1), rule=Cubature(), predictor=Polynomial(2, 0), paths=900, seed=5,
        times=[0.0, 0.5, 1.2], measured=read[1:], availability=0.9,
    )  # fmt: skip
    found = diff(plain, other)
    names = changed(found)
    assert names["memory"] == ("1 estimate", "1 estimate, 1 measurement")
    assert names["designed on"] == ("1000 paths of seed 1", "900 paths of seed 5")
    assert {"linearization", "forecast", "measurement times", "schedule"} <= set(names)
    assert set(found.same) >= {"kind", "components", "model"}
    assert found.times.tolist() == [0.0, 0.5]
    for again in (design(memory=finite_memory(1)), design(predictor=Continuous())):
        assert np.isnan(diff(plain, again).coefficients["gain"]).all()
    mixed = diff(of_modes(), of_mode_grids())
    assert not mixed.comparable
    a, b, v = sympy.symbols("a b v")
    one, two, three = (
        design(JumpDiffusion((x,), [drift], [[1]], [x + v], Noise((v,)), [0], [[1]]), rule=Taylor())
        for x, drift in ((a, 1 - a**3), (b, (1 - b) * (1 + b + b**2)), (b, 1 - 2 * b**3))
    )
    assert "model" in diff(one, two).same
    assert {"model", "model (drift)"} <= set(changed(diff(one, three)))
    vector = diff(one, design(zoo.linear_gaussian(), rule=Taylor()))
    assert changed(vector)["model (state components)"] == ("1", "2")


def test_functions_are_compared_at_the_nodes_of_tables():
    made = design(zoo.linear_gaussian(), rule=Taylor(), components=1)
    coarse, fine = (tabulated(made, y=(-8, 8, n), z=(-6, 6, n)) for n in (5, 17))
    for part in diff(coarse, fine).coefficients.values():
        assert np.nanmax(part) < 1e-12
    learned = learn(
        FLIP, large_order(1), TIMES, paths=1000, seed=1, nodes=1, regressor=LeastSquares()
    )
    read = learned.tabulated(y=(-8, 8, 41), z=(-3, 3, 41))
    for pair in ((learned, read), (read, learned)):
        assert diff(*pair).coefficients["output"] == pytest.approx(0.0, abs=1e-12)
