"""Long work tells how far it has come to whoever listens, and to nobody else."""

import logging

import numpy as np
import pytest

from seedslib import zoo
from seedslib.base import progress
from seedslib.base.progress import followed, listening
from seedslib.commands.cli import main
from seedslib.design import grid_synthesis, simulated_synthesis, synthesize
from seedslib.designed import Memory
from seedslib.extra import learn
from seedslib.linearization import ExactGaussian

TIMES = np.arange(4) * 0.5
MODEL = "from seedslib import zoo\nsystem = zoo.flip_process()\ntimes = [0, 0.5, 1]\n"


@pytest.fixture
def slow(monkeypatch):
    """Every look at the clock finds it four tenths of a second later."""
    now = iter(np.arange(1000) * 0.4)
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(now))


def test_nobody_listens_and_nothing_is_done():
    steps = range(5)
    assert followed(steps, "work") is steps


def test_a_line_a_second_with_the_time_left(slow, caplog):
    """Twenty steps of .4 s: told after 3, 6, ... of them, and at the end."""
    with caplog.at_level(logging.INFO, logger="seedslib"):
        assert list(followed(range(20), "work")) == list(range(20))
    lines = [record.getMessage() for record in caplog.records]
    assert lines[0] == "work: step 3 of 20, about 7 s left"  # 1.2 s for 3, so 6.8 s for 17
    assert [int(line.split()[2]) for line in lines[:-1]] == [3, 6, 9, 12, 15, 18]
    assert lines[-1] == "work: all 20 steps in 8.0 s"


def test_listening_ends(capsys):
    with listening():
        list(followed([1], "work"))
    assert capsys.readouterr().err == "work: all 1 steps in 0.0 s\n"
    with listening(False):
        list(followed([1], "work"))
    list(followed([1], "work"))
    assert capsys.readouterr().err == ""


class Mean:
    """A regressor."""

    def fit(self, points, wanted):
        self.value = wanted.mean()
        return self

    def predict(self, points):
        return np.full(len(points), self.value)


FLIP, TARGET = zoo.flip_process(), zoo.manoeuvring_target("noisy")
X = (-8, 8, 41)
HOW = {"paths": 4000, "seed": 1}
DESIGNS = {
    "design": lambda: synthesize(FLIP, Memory(1), ExactGaussian(), TIMES, **HOW),
    "design of modes": lambda: synthesize(
        TARGET, Memory(1), ExactGaussian(), np.arange(4.0), **HOW
    ),
    "design on a grid": lambda: grid_synthesis(FLIP, Memory(1), TIMES, x=X, z=X, y=X),
    "design of tables": lambda: simulated_synthesis(FLIP, Memory(1), TIMES, y=X, z=X, **HOW),
    "learning": lambda: learn(FLIP, Memory(1), TIMES, regressor=Mean(), **HOW),
}


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("what", DESIGNS)
def test_designs_say_how_far_they_are(what, caplog):
    quiet = DESIGNS[what]()
    assert not caplog.records
    with caplog.at_level(logging.INFO, logger="seedslib"):
        told = DESIGNS[what]()
    last = [record.getMessage() for record in caplog.records][-1]
    assert last.startswith(f"{what.removesuffix(' of modes')}: all ")
    np.testing.assert_array_equal(quiet.predicted.rms, told.predicted.rms)


def test_the_command_tells_on_request(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.py").write_text(MODEL)
    words = ["design", "model.py", "--memory", "estimates=1", "--paths", "4000", "--nodes", "0"]
    assert main([*words, "--out", "f.npz"]) == 0
    quiet = capsys.readouterr()
    assert "steps" not in quiet.err
    assert main([*words, "--out", "f.npz", "--verbose"]) == 0
    told = capsys.readouterr()
    assert "design: all 2 steps in " in told.err
    assert told.out == quiet.out
