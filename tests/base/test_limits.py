"""Requests without limits: each is refused at once, in one sentence."""

import numpy as np
import pytest

from seedslib import zoo
from seedslib.base import blocks
from seedslib.base.clock import MOST_STEPS, Clock, step_count
from seedslib.commands.cli import main
from seedslib.design import Polynomial, synthesize
from seedslib.designed import Memory
from seedslib.filters import GridBayesFilter, ParticleFilter, extended_kalman
from seedslib.filters.integration import adaptive
from seedslib.linearization import Taylor
from seedslib.models import FellerChain, PlaneChain, propagation, simulation
from seedslib.two_step import KalmanBucyFilter, LinearDiffusion

FAR = [0.0, 1e12]
MANY = 10**14
ENDLESS = r"times: wanted at most 10000000 steps in one interval, got .* and 1000000000000"


def test_steps_are_counted_up_to_a_limit():
    assert step_count(0.0, MOST_STEPS * 0.25, 0.25) == MOST_STEPS
    wanted = r"times: .* got 1e\+07 of 0.25 between 0 and 2500000.25"
    with pytest.raises(ValueError, match=wanted):
        step_count(0.0, (MOST_STEPS + 1) * 0.25, 0.25)
    for stop, step in ((np.inf, 1.0), (1.0, 1e-300), (np.nan, 1.0), (1e300, 1e-300)):
        with pytest.raises(ValueError, match="times: wanted at most"):
            step_count(0.0, stop, step)


@pytest.mark.parametrize("integrator", ["rk4", "euler", "adaptive"])
def test_a_span_without_end(integrator):
    filter = extended_kalman(zoo.linear_gaussian(), integrator=integrator)
    with pytest.raises(ValueError, match=ENDLESS):
        filter.run(FAR, np.zeros((2, 1)))
    state = filter.predict(filter.initial(), 0.0)
    with pytest.raises(ValueError, match=ENDLESS):
        filter.step(state, 1e12, np.zeros(1))


def test_it_is_one_rule_for_all_that_move_by_steps():
    linear = zoo.linear_gaussian()
    plane = PlaneChain(linear, [(-4.0, 4.0, 13)] * 2, 0.25)
    for call in (
        lambda: simulation.simulate(linear, FAR, 3, 1),
        lambda: ParticleFilter(linear, 10).run(FAR, np.zeros((2, 1))),
        lambda: plane.move(plane.start()[:, None], *FAR),
        lambda: synthesize(linear, Memory(1), Taylor(), FAR, nodes=0, paths=500, seed=1),
        lambda: Clock(np.arange(5.0)).prolonged(1e12, 1),
    ):
        with pytest.raises(ValueError, match=ENDLESS):
            call()


def test_what_needs_no_steps_goes_any_way():
    system = LinearDiffusion(
        drift=-1, noise_intensity=0.5, sensor=1, sensor_intensity=0.1, mean0=0, cov0=4
    )
    cov = KalmanBucyFilter(system).moments(FAR).cov
    np.testing.assert_allclose(cov[1], 0.25, rtol=1e-12)  # the noise over twice the rate
    assert np.isfinite(system.simulate(FAR, 2, 1).states).all()


def test_moments_of_varying_coefficients_have_an_end(monkeypatch):
    monkeypatch.setattr(propagation, "MOST_STEPS", 1000)
    system = LinearDiffusion(
        drift=lambda t: np.cos(t) - 1.5, noise_intensity=0.5, sensor=1, sensor_intensity=0.1,
        mean0=0, cov0=4,
    )  # fmt: skip
    assert system.transition(0.0, 1.0)[0].item() == pytest.approx(np.exp(np.sin(1.0) - 1.5))
    with pytest.raises(ValueError, match=r"at most 1000 looks .* more between 0 and 1000000"):
        system.transition(0.0, 1e6)


def test_adaptive_steps_arrive_where_times_are_large():
    """Steps below the distance of two numbers would leave the time as it is."""
    calls = []

    def rate(t, y):
        calls.append(t)
        assert len(calls) < 10**6
        return [-y[0]]

    (found,) = adaptive(rate, [1.0], 1e12, 1e12 + 0.25, 1e-5)
    assert found == pytest.approx(np.exp(-0.25), rel=1e-9)
    assert len(calls) <= 6 * 0.25 / np.spacing(1e12) + 1

    calls.clear()  # a jump that no step resolves is given up, by steps of that distance too

    def jumping(t, y):
        return [rate(t, y)[0] * (1e9 if t > 1e12 + 0.1 else 1.0)]

    (found,) = adaptive(jumping, [1.0], 1e12, 1e12 + 0.25, 1e-5)
    assert np.isnan(found)


@pytest.fixture
def small(monkeypatch):
    """A machine of a gigabyte."""
    monkeypatch.setattr(blocks, "room", lambda: 1e9)


def test_the_room_is_that_of_this_machine():
    assert 2**26 < blocks.room() < 2**60
    blocks.require_room("paths", 1, blocks.room())
    with pytest.raises(ValueError, match=r"paths: wanted what fits in .* GB of memory, got 7, "):
        blocks.require_room("paths", 7, 1.01 * blocks.room())


@pytest.mark.usefixtures("small")
def test_what_does_not_fit_is_refused_before_it_grows():
    linear, flip = zoo.linear_gaussian(), zoo.flip_process()
    times = [0.0, 0.5]
    told = "wanted what fits in 1 GB of memory, got "
    for name, call in (
        ("paths", lambda: simulation.simulate(linear, times, 20_900_000, 1)),
        ("paths", lambda: zoo.manoeuvring_target().simulate(times, MANY, 1)),
        ("paths", lambda: synthesize(linear, Memory(1), Taylor(), times, paths=MANY, seed=1)),
        ("paths", lambda: blocks.in_blocks(print, MANY, 1)),
        ("nodes", lambda: synthesize(linear, Memory(1), Taylor(), times, nodes=MANY, paths=9)),
        ("particles", lambda: ParticleFilter(linear, MANY)),
        ("axis", lambda: FellerChain(flip, (-3.0, 3.0, 12_000))),
        ("axis", lambda: GridBayesFilter(zoo.scalar_switching(), (-3.0, 3.0, MANY))),
        ("axes", lambda: PlaneChain(linear, [(-3.0, 3.0, 10_000)] * 2)),
    ):
        with pytest.raises(ValueError, match=rf"^({name}|x): (count: )?{told}"):
            call()


@pytest.mark.usefixtures("small")
def test_and_what_fits_is_not(monkeypatch):
    monkeypatch.setattr(simulation, "in_blocks", lambda *_, **__: None)
    # 2 times of 2 states and a measurement, 48 bytes a path
    made = simulation.simulate(zoo.linear_gaussian(), [0.0, 0.5], 1000, 1)
    assert made.states.nbytes + made.measurements.nbytes == 48 * 1000
    FellerChain(zoo.flip_process(), (-3.0, 3.0, 11_000))


def test_a_degree_without_end_is_counted_and_not_listed():
    with pytest.raises(ValueError, match="paths: wanted more than 5000000050000000 for"):
        synthesize(
            zoo.linear_gaussian(), Memory(1), Taylor(), [0.0, 0.5], paths=500, seed=1,
            predictor=Polynomial(99_999_999, 0),
        )  # fmt: skip


def test_the_commands_say_it_in_a_line(tmp_path, monkeypatch, capsys, refused):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.py").write_text("from seedslib import zoo\nsystem = zoo.van_der_pol()\n")
    design = ["design", "m.py", "--memory", "estimates=1", "--out", "o.npz"]
    many = refused(capsys, main, *design, "--times", "0:1:0.5", "--paths", MANY)
    assert many.startswith("seedslib: paths: wanted what fits in ")
    assert "steps in one interval" in refused(capsys, main, *design, "--times", "0,1e12")

    def full(*_, **__):
        raise MemoryError("Unable to allocate 728. TiB")

    monkeypatch.setattr("seedslib.design.synthesize", full, raising=False)
    told = refused(capsys, main, *design, "--times", "0:1:0.5")
    assert told == "seedslib: not enough memory: Unable to allocate 728. TiB\n"
