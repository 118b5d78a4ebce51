"""``python -m seedslib design`` against the designs of Python."""

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import (
    Continuous,
    Polynomial,
    stationary,
    synthesize,
    tabulated,
)
from seedslib.designed import Memory, finite_memory, load
from seedslib.linearization import Cubature, ExactGaussian, Taylor, Unscented

MODELS = {
    "oscillator.py": "from seedslib import zoo\nsystem = zoo.van_der_pol()\n",
    "flip.py": "from seedslib import zoo\ndef system():\n    return zoo.flip_process()\n"
    "times = (0, 0.25, 0.5)\n",
    "target.py": "from oscillator import zoo\nsystem = zoo.manoeuvring_target('noisy')\n"
    "times = range(4)\n",
}
SYSTEMS = {
    "oscillator": zoo.van_der_pol,
    "flip": zoo.flip_process,
    "target": lambda: zoo.manoeuvring_target("noisy"),
}
FEW = {"paths": 600, "seed": 0}
STEPS = 0.5 * np.arange(4)


@pytest.fixture(autouse=True)
def models(folder):
    for name, text in MODELS.items():
        (folder / name).write_text(text)
    rows = "2020-01-01;0;a\n2020-01-02;.5;b\n2020-01-04;1.5;c\n"
    (folder / "days.csv").write_text("day;t;y\n" + rows)


def mask(rows, columns):
    found = np.ones((4, 2), dtype=bool)
    found[rows, columns] = False
    return found


def plain(memory=None, rule=None, times=STEPS, **options):
    memory, rule = memory or Memory(1), rule or ExactGaussian()
    return lambda system: synthesize(system, memory, rule, times, **{**FEW, "nodes": 1, **options})


def modes(memory, **options):
    options = {**FEW, **options}
    return lambda system: synthesize(system, memory, Taylor(), np.arange(4.0), **options)


GRID = "--times 0:1.5:0.5 --nodes 1"
DESIGNS = [
    ("oscillator", f"estimates=1 {GRID}", plain()),
    (
        "oscillator",
        f"estimates=1,measurements=1 {GRID} --linearization unscented:1,2,0 "
        "--predictor polynomial:2,1 --seed 7 --components 1 --workers 2",
        plain(Memory(1, 1), Unscented(1, 2, 0), predictor=Polynomial(2, 1), seed=7, components=1),
    ),
    (
        "oscillator",
        "measurements=2 --times @days.csv --linearization cubature --verbose",
        plain(finite_memory(2), Cubature(), [0, 0.5, 1.5], nodes=4),
    ),
    ("oscillator", f"small_order {GRID} --predictor continuous", plain(predictor=Continuous())),
    (
        "oscillator",
        f"small_order {GRID} --availability 0.8,1 --measured y2=0:1:1",
        plain(availability=[0.8, 1.0], measured=mask([1, 3], [1, 1])),
    ),
    ("oscillator", f"small_order {GRID} --measured 0,1", plain(measured=mask([[1], [3]], [0, 1]))),
    (
        "oscillator",
        "small_order --times @days.csv:day --unit days --nodes 1",
        plain(times=[0, 1, 3]),
    ),
    (
        "oscillator",
        "small_order --times @days.csv:day --unit hours --epoch 2019-12-31 --nodes 0",
        plain(times=[24, 48, 96], nodes=0),
    ),
    (
        "flip",
        "small_order --nodes 1 --table y=-8:8:9 z=-3:3:7",
        lambda system: tabulated(plain(times=[0, 0.25, 0.5])(system), y=(-8, 8, 9), z=(-3, 3, 7)),
    ),
    (
        "flip",
        "small_order --times 0:3:.25 --nodes 1 --stationary 9 --cycle 2",
        lambda system: stationary(plain(times=0.25 * np.arange(13))(system), 9.0, cycle=2, seed=1),
    ),
    ("target", "estimates=1,log_odds --linearization taylor", modes(Memory(1, log_odds=True))),
    (
        "target",
        "estimates=1 --linearization taylor --measured indicator=0,3",
        modes(Memory(1), measured=mask([1, 2], [1, 1])),
    ),
]


@pytest.mark.filterwarnings("ignore:paths", "ignore:availability", "ignore:cov0")
@pytest.mark.parametrize(("model", "options", "make"), DESIGNS)
def test_a_designed_filter_equals_that_of_python(run, folder, model, options, make):
    code, out, err = run(f"design {model}.py --paths 600 --out f.npz --memory {options}")
    assert code == 0
    assert ("2 steps" in err) == ("verbose" in options) == bool(err)
    system = SYSTEMS[model]()
    wanted = make(system)
    assert out == f"{wanted}\nwritten to f.npz\n"
    found = load("f.npz", system)
    np.testing.assert_array_equal(found.times, wanted.times)
    y = system.simulate(wanted.times, 3, 1)
    told = {} if y.indicators is None else {"indicators": y.indicators}
    data = y.measurements
    read = getattr(wanted, "measured", None)
    if read is not None:
        data[~read[:, : data.shape[1]]] = np.nan
        told = {k: np.where(read[:, -1:], v, -1) for k, v in told.items()}
    one, other = (each.run(wanted.times, data, **told).mean for each in (found, wanted))
    np.testing.assert_array_equal(one, other)
