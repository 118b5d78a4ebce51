"""Designs on paths that they have not seen: what is found there, and when it is worth a warning."""

import dataclasses
import warnings

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base.blocks import as_seed_sequence, child
from seedslib.design import (
    Continuous,
    Polynomial,
    grid_synthesis,
    simulated_synthesis,
    synthesize,
    tabulated,
)
from seedslib.design.paths.held_out import STREAM
from seedslib.designed import Memory, load, save
from seedslib.evaluation import evaluate
from seedslib.linearization import ExactGaussian, Taylor, Unscented
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

x, v, w = sympy.symbols("x v w", real=True)
TIMES = np.arange(5) * 0.5
STEPS = np.arange(31.0)
SINE = x / 2 + 2 * sympy.sin(x)


def heard(make):
    """A design and the sentences that it warned with."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made = make()
    return made, [str(one.message) for one in caught]


def sine(sensor=x, drive=None):
    noise = Noise([w], cov=[[0.2]]) if drive is None else drive
    move = StochasticMap([x], [SINE + w], noise)
    return DiscreteSystem(move, StochasticMap([x], [sensor + v], Noise([v])), [0.0], [[1.0]])


# What is found


def test_errors_are_those_of_a_run_on_other_paths(oscillator):
    """By hand: the stream of the key, 625 paths at all nodes, the filter's own run."""
    options = {"paths": 5000, "step": 0.05, "nodes": 1}
    made = synthesize(oscillator, Memory(2), ExactGaussian(), TIMES, seed=7, **options)
    stops = np.arange(9) * 0.25
    stream = child(as_seed_sequence(7), STREAM).spawn(1)[0]
    data = oscillator.simulate(stops, 625, stream, measured=range(0, 9, 2), step=0.05)
    error = made.run(TIMES, data.measurements[::2]).mean - data.states[::2]
    held = made.held_out
    assert (held.paths, held.diverged) == (625, 0)
    square = error**2
    np.testing.assert_allclose(held.rms, np.sqrt(square.mean(axis=2)), rtol=1e-12)
    spread = square.std(axis=2) / 25.0 / (2.0 * held.rms)
    np.testing.assert_allclose(held.error, spread, rtol=1e-10)
    np.testing.assert_allclose(held.deviation, data.states[::2].std(axis=2), rtol=1e-12)
    np.testing.assert_array_equal(held.times, made.times)


def test_the_design_itself_does_not_know_of_them(oscillator):
    """Seeds of all kinds give the numbers of before, and a generator is drawn from once."""
    options = {"paths": 2000, "step": 0.05, "nodes": 1}

    def made(seed):
        return synthesize(oscillator, Memory(1), ExactGaussian(), TIMES, seed=seed, **options)

    one, two = made(3), made(np.random.SeedSequence(3))
    np.testing.assert_array_equal(one.held_out.rms, two.held_out.rms)
    rng, other = np.random.default_rng(5), np.random.default_rng(5)
    drawn = made(rng)
    root = as_seed_sequence(other)
    assert rng.integers(1 << 40) == other.integers(1 << 40)
    np.testing.assert_array_equal(drawn.fits[1].gain, made(root).fits[1].gain)
    # the first estimate is the regression on the states of the paths of the seed
    data = oscillator.simulate(np.arange(9) * 0.25, 2000, 3, step=0.05)
    np.testing.assert_allclose(one.start.mean, data.states[0].mean(axis=1), rtol=1e-12)
    np.testing.assert_allclose(one.start.moments.mean, data.measurements[0].mean(axis=1))


def test_they_agree_with_an_evaluation(oscillator):
    options = {"paths": 40_000, "step": 0.05}
    made = synthesize(oscillator, Memory(1), ExactGaussian(), TIMES, seed=1, nodes=0, **options)
    found = evaluate(made, oscillator, TIMES, 5000, 99, step=0.05)
    z = (found.rms - made.held_out.rms) / np.hypot(found.rms_error, made.held_out.error)
    assert np.abs(z).max() < 4.5


@pytest.mark.parametrize("workers", [1, 2])
def test_files_and_threads_keep_every_bit(tmp_path, workers):
    system = zoo.scalar_switching()
    made = synthesize(
        system, Memory(1), ExactGaussian(), STEPS[:5], paths=40_000, seed=1, workers=workers
    )
    held = made.held_out
    assert held.paths == 5000
    save(made, tmp_path / "a.npz")
    again = load(tmp_path / "a.npz", system)
    np.testing.assert_equal(again.held_out._asdict(), held._asdict())
    data = system.simulate(STEPS[:5], 2048, child(as_seed_sequence(1), STREAM).spawn(3)[0])
    found = made.run(data.times, data.measurements)
    wrong = (found.modes != data.modes).mean(axis=1)
    assert np.abs(held.mode_rate - wrong).max() < 0.03
    lines = str(again).splitlines()
    assert max(map(len, lines)) <= 100
    assert lines[-1].count("modes") == 2
    assert f"{held.rms[-1, 0]:.4f} ± {held.error[-1, 0]:.4f}" in lines[-1]
    with pytest.raises(ValueError, match="read-only"):
        held.rms[0] = 0.0


def test_tables_are_examined_too_and_exact_designs_are_not(tmp_path):
    flip, axes = zoo.flip_process(), {"z": (-3, 3, 61), "y": (-8, 8, 61)}
    made, said = heard(
        lambda: simulated_synthesis(flip, Memory(1), TIMES[:3], paths=4000, seed=1, **axes)
    )
    assert not said
    # the predicted errors are of paths that a function has not seen: the two must agree
    at = np.searchsorted(made.predicted.times, made.times)
    z = made.held_out.rms - made.predicted.rms[at]
    assert np.abs(z / np.hypot(made.held_out.error, made.predicted.error[at])).max() < 4.5
    save(made, tmp_path / "a.npz")
    np.testing.assert_equal(load(tmp_path / "a.npz").held_out._asdict(), made.held_out._asdict())
    assert "512 paths that the design has not seen" in str(made)
    grid = grid_synthesis(flip, Memory(1), TIMES[:3], x=(-3.5, 3.5, 71), **axes)
    assert grid.held_out is None
    save(grid, tmp_path / "b.npz")
    assert load(tmp_path / "b.npz").held_out is None
    linear = zoo.linear_gaussian()
    exact = synthesize(linear, Memory(1), Taylor(), TIMES, exact_moments=True)
    assert exact.held_out is None
    # a table read off another filter is another filter
    single = synthesize(flip, Memory(1), ExactGaussian(), TIMES[:3], paths=2000, seed=1)
    assert tabulated(single, **axes).held_out is None


def test_switching_tables_are_examined_too():
    made = simulated_synthesis(zoo.scalar_switching(), Memory(1), STEPS[:3], paths=3000, seed=1)
    held = made.held_out
    z = held.mode_rate - made.predicted.mode_rate
    assert np.abs(z / np.hypot(held.mode_error, made.predicted.mode_error)).max() < 4.5
    assert "on 512 paths" in str(made)


def test_paths_that_the_system_loses_are_nobodys_error():
    system = JumpDiffusion(
        (x,), [x**3 - x], [[0.1]], [x + v], Noise([v]), [0], [[0.09]], step=0.02,
        initial=lambda rng, count: rng.standard_normal((1, count)) * 0.3,
    )  # fmt: skip
    made, said = heard(
        lambda: synthesize(
            system, Memory(1), ExactGaussian(), TIMES, paths=5000, seed=1, nodes=0, bound=1.2
        )
    )
    assert made.design.diverged
    assert made.held_out.diverged == 0
    assert np.isfinite(made.held_out.rms).all()
    assert not [text for text in said if "held out" in text]


# When it is worth a warning


def test_a_cubic_forecast_with_a_long_memory_does_not_carry_over():
    system = sine()
    made, said = heard(
        lambda: synthesize(
            system, Memory(3, 3), Unscented(), STEPS, predictor=Polynomial(3), paths=20_000, seed=1
        )
    )
    data = system.simulate(STEPS, 2000, 5)
    error = made.run(STEPS, data.measurements).mean - data.states
    assert np.sqrt(np.mean(error**2)) > 5 * made.predicted.rms.mean()  # as the case has it
    assert any("held out: the filter diverged on" in text for text in said)
    assert made.held_out.diverged > 0
    assert f"{made.held_out.diverged} of them diverged" in str(made)
    short, said = heard(
        lambda: synthesize(
            system, Memory(1), Unscented(), STEPS, predictor=Polynomial(3), paths=20_000, seed=1
        )
    )
    assert not said
    assert short.held_out.diverged == 0


@pytest.fixture(scope="module")
def flat():
    """A sensor that is flat where the state often is, seen along its tangent."""

    def sample(rng, count):
        return rng.laplace(scale=2**-0.5, size=(1, count))

    return sine(x**2, Noise([w], cov=[[1.0]], sample=sample))


def test_a_useless_linearization_says_so(flat):
    made, said = heard(lambda: synthesize(flat, Memory(1), Taylor(), STEPS, paths=5000, seed=0))
    worse = [text for text in said if "worse than the mean of the state" in text]
    forecast = [text for text in said if "worse than the forecast that it corrects" in text]
    assert len(worse) == len(forecast) == 1
    assert "component 0" in worse[0]
    assert "another linearization" in worse[0]
    assert (made.held_out.rms > made.held_out.deviation).mean() > 0.5
    _, said = heard(lambda: synthesize(flat, Memory(1), ExactGaussian(), STEPS, paths=5000, seed=0))
    assert not said


@pytest.mark.parametrize(("paths", "text"), [(100, "are not the predicted"), (400, "diverged")])
def test_fitting_noise_is_noticed(paths, text):
    """69 coefficients on few paths: the errors in-sample are a promise only.

    On the 400 the few errors of some hundreds are all of the root-mean-square, so its standard
    error is as large as itself.
    """
    options = {"predictor": Polynomial(4, 0), "paths": paths, "seed": 1}
    made, said = heard(lambda: synthesize(sine(), Memory(2, 2), Unscented(), STEPS[:5], **options))
    assert "are few for" in said[0]
    assert any(text in line for line in said[1:])
    assert made.held_out.rms[-1, 0] > 100 * made.predicted.rms[-1, 0]


@pytest.mark.parametrize("name", ["van_der_pol", "flip_process", "linear_gaussian"])
def test_designs_of_the_zoo_warn_of_nothing(name):
    system = getattr(zoo, name)()
    for seed in range(3):
        for memory, predictor in ((Memory(2), None), (Memory(1), Continuous())):
            options = {} if predictor is None else {"predictor": predictor}
            _, said = heard(
                lambda m=memory, o=options, s=seed: synthesize(
                    system, m, ExactGaussian(), TIMES, paths=3000, seed=s, nodes=1, **o
                )
            )
            assert not said


def test_the_numbers_of_a_warning_are_those_of_the_filter(flat):
    made, said = heard(lambda: synthesize(flat, Memory(1), Taylor(), STEPS[:6], paths=5000, seed=0))
    (text,) = [text for text in said if "worse than the mean" in text]
    ratio = made.held_out.rms[:, 0] / made.held_out.deviation[:, 0]
    k = int(np.argmax(ratio))
    assert f"at time {k}: {made.held_out.rms[k, 0]:.4g}" in text
    assert f"for {made.held_out.deviation[k, 0]:.4g}" in text
    assert dataclasses.replace(made).held_out is made.held_out


@pytest.mark.parametrize("tables", [False, True])
def test_a_warning_points_at_the_line_of_the_caller(flat, tables):
    def made():
        if tables:
            return simulated_synthesis(flat, Memory(1), STEPS, paths=500, seed=0, nodes=0)
        return synthesize(flat, Memory(1), Taylor(), STEPS, paths=5000, seed=0)

    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        made()
    about = [one for one in found if "held out" in str(one.message)]
    assert about or tables
    assert {one.filename for one in about} <= {__file__}
