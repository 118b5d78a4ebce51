"""What the commands refuse: exit code 2, one line on stderr that names what is wrong."""

import os

import pytest

from seedslib import zoo
from seedslib.design import synthesize, tabulated
from seedslib.designed import Memory, finite_memory, save
from seedslib.linearization import Taylor

LEVEL = """
from seedslib.base import Input, Parameter
from seedslib.models import LinearSystem
q, r = Parameter("q", .5, positive=True), Parameter("r", 2., positive=True)
system = LinearSystem(1, q, 1, r, 1, 3)
"""
FILES = {
    "level.py": LEVEL,
    "heated.py": LEVEL.replace("1, 3)", "1, 3, B=1, inputs=(Input('u'),))"),
    "flip.py": "from seedslib import zoo\nsystem = zoo.flip_process()\ntimes = (0, 0.5)\n",
    "target.py": "from seedslib import zoo\nsystem = zoo.manoeuvring_target('noisy')\n"
    "times = range(4)\n",
    "none.py": "x = 1\n",
    "exits.py": "import sys\nsys.exit(3)\n",
    "number.py": "filter = 3\n",
    "wrong.py": "\n\nx = 1 / 0\n",
    "mine.py": LEVEL + "from seedslib.filters import Filter\nclass Mine(Filter):\n"
    "    def __init__(self):\n        self.system = system\nfilter = Mine()\n",
    "d.csv": "t,y1\n0,1\n1,2\n3,1\n",
    "days.csv": "day,y1\n2020-01-01,1\n2020-01-02,1\n",
}


@pytest.fixture(scope="module")
def designs(tmp_path_factory):
    folder, options = tmp_path_factory.mktemp("designs"), {"paths": 300, "seed": 1, "nodes": 0}
    for name, memory in (("table", Memory(1)), ("past", finite_memory(1))):
        made = synthesize(zoo.flip_process(), memory, Taylor(), [0, 0.5, 1], **options)
        save(tabulated(made, y=(-8, 8, 9), z=(-3, 3, 7)), folder / f"{name}.npz")
    save(made, folder / "plain.npz")
    target = zoo.manoeuvring_target("noisy")
    modes = synthesize(target, Memory(1), Taylor(), range(4), paths=2000, seed=1)
    save(modes, folder / "modes.npz")
    (folder / "short.npz").write_bytes((folder / "table.npz").read_bytes()[:900])
    return folder


@pytest.fixture(autouse=True)
def files(folder, designs):
    for name, text in FILES.items():
        (folder / name).write_text(text)
    for path in designs.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())


# A line of a command, and behind the bar what its message names.
DESIGN = """
flip.py --memory estimates | memory
flip.py --linearization magic | linearization
flip.py --predictor polynomial:0 | predictor
flip.py --times 0:1:0 | times
flip.py --times @days.csv:day | days.csv, column day
flip.py --table y=1:0:3 | table
flip.py --times 0:1:1 --unit days | unit
flip.py --table y=-3:3:9 --availability .9 | table
flip.py --availability often | availability
flip.py --measured y2=0:2:1 | measured
flip.py --measured 0:1 | measured
flip.py --out . | out
level.py | times
none.py | none.py, system
exits.py | exits.py, line 2
flip.py --components 2 | components
flip.py --paths 2 | paths
flip.py --seed -1 | seed
flip.py --nodes -1 | nodes
flip.py --availability 1.2 | availability
flip.py --measured 0,2.5 | measured
flip.py --out nowhere/f.npz | out
flip.py --out flip.py | out
flip.py --times 0:3:.5 --stationary 1e-9 | tolerance
target.py --nodes 2 | nodes
missing.py | missing.py
wrong.py | wrong.py, line 3
"""
FILTER = """
level.py d.csv | kind
level.py d.csv --kind KalmanFilter --set q | set
number.py d.csv --kind KalmanFilter | number.py, system
table.npz table.npz | table.npz
plain.npz d.csv --kind KalmanFilter | kind
flip.py d.csv --kind extended_kalman --forecast 1 --every 0 | every
flip.py d.csv --kind extended_kalman --time t --columns b | d.csv, b
level.py d.csv --kind ekf | kind
flip.py d.csv --kind KalmanFilter | flip.py, system
level.py d.csv --kind KalmanFilter --particles 5 | particles
flip.py d.csv --kind ParticleFilter --seed -1 | seed
target.py d.csv --kind GridBayesFilter --grid 0:1 | grid
level.py d.csv --kind KalmanFilter --set s=1 | set
level.py d.csv --kind KalmanFilter --lag 1 | lag
level.py d.csv --kind KalmanFilter --model level.py | model
level.py d.csv --kind KalmanFilter | d.csv, times
flip.py d.csv --kind extended_kalman --forecast 0 | forecast
flip.py d.csv --kind extended_kalman --forecast 1 | every
flip.py d.csv --kind extended_kalman --until soon --every 1 | until
flip.py d.csv --kind extended_kalman --level 1 | level
flip.py d.csv --kind extended_kalman --unit years | unit
flip.py d.csv --kind extended_kalman --unit days --epoch 1.1. | epoch
flip.py d.csv --kind extended_kalman --unit days | d.csv, row 2, column t
flip.py d.csv --kind extended_kalman --time day | d.csv, day
flip.py d.csv --kind extended_kalman --columns a,b | columns
flip.py d.csv --kind extended_kalman --out d.csv | out
heated.py d.csv --kind KalmanFilter | inputs
heated.py d.csv --kind KalmanFilter --inputs u=y1 --columns t --forecast 1 | forecast
number.py d.csv | number.py
mine.py days.csv --unit rows --time day --smooth | smooth
level.py d.csv --kind ParticleFilter --seed 1 --smooth | smooth
plain.npz d.csv | plain.npz, --model
plain.npz d.csv --model target.py | model
short.npz d.csv | short.npz
"""
FIT = """
flip.py d.csv --kind extended_kalman | free
level.py d.csv --kind KalmanFilter --free z | free
plain.npz d.csv --kind KalmanFilter | model
"""
COMMANDS = {
    "design --memory estimates=1 --paths 300 --out f.npz": DESIGN,
    "filter --out x.csv": FILTER,
    "fit --out fit.json": FIT,
}
ROWS = [f"{start} {row}" for start, rows in COMMANDS.items() for row in rows.strip().split("\n")]


def refused(run, folder, line, words):
    before = {path: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    code, out, err = run(line)
    assert (code, out, err.count("\n")) == (2, "", 1)
    for word in words.split(", "):
        assert word in err
    assert {path: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before


@pytest.mark.parametrize("row", ROWS)
def test_a_line_is_refused_by_name_and_nothing_is_written(run, folder, row):
    refused(run, folder, *row.split(" | "))


@pytest.mark.parametrize(
    ("filter", "text", "place"),
    [
        ("table", "t,y1\n", "d.csv"),
        ("table", "t,y1\n0,1\n\n0.5,1,3\n", "d.csv, row 4"),
        ("table", 't,y1\n0,"1,5"\n', "d.csv, row 2, column y1"),
        ("table", "t,y1\n0,1\n0.5,inf\n", "d.csv, row 3, column y1"),
        ("table", "t,y1\n0,1\n0.5,1\n0.5,1\n", "d.csv, row 4, column t"),
        ("table", "t,y1\n0,1\n0.3,1\n", "d.csv, row 3"),
        ("table", "t,y1\n0,1\n0.5,1\n1,1\n2,\n", "d.csv, row 5"),
        ("past", "t,y1\n0,1\n0.5,\n", "d.csv, y"),
        ("modes", "t,y1,j\n0,1,2\n", "d.csv, row 2, column j"),
        ("modes", "t,y1,j\n0,1,0\n1,1,-1\n", "d.csv, row 3, column j"),
        ("modes", "t,y1,j\n0,1,0\n.5,,\n", "d.csv, row 3"),
    ],
)
def test_a_record_is_refused_by_its_row(run, folder, filter, text, place):
    (folder / "d.csv").write_text(text)
    model = " --model target.py" if filter == "modes" else ""
    refused(run, folder, f"filter {filter}.npz d.csv{model} --out x.csv", place)


def test_a_file_that_is_read_is_known_again_by_other_spellings_and_links(run, folder):
    (folder / "sub").mkdir()
    (folder / "soft").symlink_to("d.csv")
    os.link(folder / "d.csv", folder / "hard")
    for name in ("./d.csv", "sub/../d.csv", folder / "d.csv", "soft", "hard"):
        refused(run, folder, f"filter flip.py d.csv --kind extended_kalman --out {name}", "out")
