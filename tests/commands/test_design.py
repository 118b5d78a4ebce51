"""``python -m seedslib design`` against the designs of Python."""

import runpy

import numpy as np
import pytest

from seedslib.design import Continuous, Polynomial, stationary, synthesize, tabulated
from seedslib.designed import Memory, finite_memory, load
from seedslib.linearization import Cubature, ExactGaussian, Taylor, Unscented

SYSTEMS = {
    "pair": "zoo.van_der_pol()",
    "flip": "zoo.flip_process()\ntimes = (0, .25, .5)",
    "target": "zoo.manoeuvring_target('noisy')\ntimes = range(4)",
}
DAYS = "day;t;y\n2020-01-01;0;a\n2020-01-02;.5;b\n2020-01-04;1.5;c\n"


def reading(rows, columns, **options):
    """Components that are not read at some of four times."""
    found = np.ones((4, 2), dtype=bool)
    found[rows, columns] = False
    return {"measured": found, **options}


STEPS, GRID = 0.5 * np.arange(4), "--times 0:1.5:0.5 --nodes 1"
BENT = {"predictor": Polynomial(2, 1), "seed": 7, "components": 1}
BENT_WORDS = "--predictor polynomial:2,1 --seed 7 --components 1 --workers 2"
CONTINUOUS, TARGET = {"predictor": Continuous()}, "--linearization taylor --measured indicator=0,3"
TABLE, LASTING = {"y": (-8, 8, 9), "z": (-3, 3, 7)}, {"tolerance": 9.0, "cycle": 2, "seed": 1}
FEWER = reading([1, 3], [1, 1], availability=[0.8, 1.0])
UNSCENTED, HOURS = "--linearization unscented:1,2,0", "--unit hours --epoch 2019-12-31 --nodes 0"
EXACT, ONE, PAST = ExactGaussian(), Memory(1), finite_memory(2)
DESIGNS = [
    (f"pair estimates=1 {GRID}", ONE, EXACT, STEPS, {}),
    (f"pair estimates=1 {GRID} {UNSCENTED} {BENT_WORDS}", ONE, Unscented(1, 2, 0), STEPS, BENT),
    (f"pair measurements=2 {GRID} --linearization cubature --verbose", PAST, Cubature(), STEPS, {}),
    (f"pair small_order {GRID} --predictor continuous", ONE, EXACT, STEPS, CONTINUOUS),
    (f"pair small_order {GRID} --availability 0.8,1 --measured y2=0:1:1", ONE, EXACT, STEPS, FEWER),
    (f"pair small_order {GRID} --measured 0,1", ONE, EXACT, STEPS, reading([[1], [3]], [0, 1])),
    (f"pair finite_memory:2 --times @days.csv:day {HOURS}", PAST, EXACT, [24, 48, 96], {}),
    ("flip small_order --nodes 1 --table y=-8:8:9 z=-3:3:7", ONE, EXACT, [0, 0.25, 0.5], {}),
    (
        "flip small_order --times 0:3:.25 --nodes 1 --stationary 9 --cycle 2",
        ONE,
        EXACT,
        0.25 * np.arange(13),
        {},
    ),
    (
        "target estimates=1,log_odds --linearization taylor",
        Memory(1, log_odds=True),
        Taylor(),
        range(4),
        {},
    ),
    (f"target estimates=1 {TARGET}", ONE, Taylor(), range(4), reading([1, 2], [1, 1])),
]


@pytest.mark.filterwarnings("ignore:paths", "ignore:availability", "ignore:cov0")
@pytest.mark.parametrize(("line", "memory", "rule", "times", "options"), DESIGNS)
def test_a_designed_filter_equals_that_of_python(run, folder, line, memory, rule, times, options):
    (folder / "days.csv").write_text(DAYS)
    model, words = line.split(" ", 1)
    (folder / f"{model}.py").write_text(f"from seedslib import zoo\nsystem = {SYSTEMS[model]}\n")
    code, out, err = run(f"design {model}.py --paths 600 --out f.npz --memory {words}")
    assert code == 0
    assert ("3 steps" in err) == ("verbose" in words) == bool(err)
    system = runpy.run_path(f"{model}.py")["system"]
    nodes = {} if model == "target" else {"nodes": int("--nodes 1" in words)}
    wanted = synthesize(system, memory, rule, times, **{"paths": 600, "seed": 0} | nodes | options)
    wanted = tabulated(wanted, **TABLE) if "table" in words else wanted
    wanted = stationary(wanted, **LASTING) if "stationary" in words else wanted
    assert out == f"{wanted}\nwritten to f.npz\n"
    found = load("f.npz", system)
    np.testing.assert_array_equal(found.times, wanted.times)
    data = system.simulate(wanted.times, 3, 1)
    y, told, read = data.measurements, {}, options.get("measured")
    if read is not None:
        y[~read[:, : y.shape[1]]] = np.nan
    if data.indicators is not None:
        seen = True if read is None else read[:, 1:]
        told["indicators"] = np.where(seen, data.indicators, -1)
    one, other = (each.run(wanted.times, y, **told).mean for each in (found, wanted))
    np.testing.assert_array_equal(one, other)
