"""What a design says against itself, by errors on paths that it has not seen."""

import dataclasses
import warnings

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import (
    Polynomial,
    binned_synthesis,
    synthesize,
)
from seedslib.designed import Memory, load, save
from seedslib.linearization import ExactGaussian, Taylor, Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, v, w = sympy.symbols("x v w", real=True)
STEPS = np.arange(31.0)


def sine(sensor=x, drive=None):
    noise = Noise([w], cov=[[0.2]]) if drive is None else drive
    move = StochasticMap([x], [x / 2 + 2 * sympy.sin(x) + w], noise)
    return DiscreteSystem(move, StochasticMap([x], [sensor + v], Noise([v])), [0.0], [[1.0]])


@pytest.fixture(scope="module")
def flat():
    """A sensor that is flat where the state often is, and noise with wide tails."""

    def sample(rng, count):
        return rng.laplace(scale=2**-0.5, size=(1, count))

    return sine(x**2, Noise([w], cov=[[1.0]], sample=sample))


def heard(make):
    """A design and the beginnings of the sentences that it warned with."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made = make()
    assert {one.filename for one in caught} <= {__file__}  # they point at the caller
    return made, [str(one.message) for one in caught]


def doubtful(made, forecasts=None):
    """Which sentences the numbers of a design are worth: the rules, written out.

    A difference counts beyond 2 per cent and beyond 4 standard errors, or so many more as there
    are numbers compared; few design paths are believed as little as the held-out ones.
    """
    held, predicted = made.held_out, made.predicted
    rows = np.isin(predicted.times, held.times)
    rms, error = predicted.rms[rows], predicted.error[rows]
    doubt = np.sqrt(16 + 2 * np.log(rms.size))
    share = np.sqrt(made.design.paths / held.paths)
    both = np.sqrt(error**2 + np.maximum(held.error, share * error) ** 2)

    def worse(a, b, standard):
        return (a - b > doubt * standard) & (a - b > 0.02 * b)

    said = {"predicted": worse(held.rms, rms, both) | worse(rms, held.rms, both)}
    constant = held.deviation / np.sqrt(2 * held.paths)
    said["constant"] = worse(held.rms, held.deviation, np.hypot(held.error, constant))
    if held.mode_rate is not None:
        apart = np.abs(held.mode_rate - predicted.mode_rate)
        own = predicted.mode_error
        both = np.sqrt(own**2 + np.maximum(held.mode_error, share * own) ** 2)
        said["modes"] = (apart > doubt * both) & (apart > 0.02 * predicted.mode_rate)
    return {name: bool(bad.any()) for name, bad in said.items()}


SENTENCES = {
    "predicted": "held out: root-mean-square",
    "constant": "held out: the estimate",
    "modes": "held out: the part of wrong modes",
}


def affine(paths, seed):
    return synthesize(
        zoo.van_der_pol(),
        Memory(2),
        Unscented(),
        [0.0, 0.5, 1.0],
        paths=paths,
        seed=seed,
        nodes=1,
        step=0.1,
    )


def quartic(paths, seed):
    return synthesize(
        sine(),
        Memory(2, 2),
        Unscented(),
        range(4),
        paths=paths,
        seed=seed,
        predictor=Polynomial(4, 0),
    )


def counted(paths, seed):
    system = zoo.scalar_switching()
    return binned_synthesis(system, Memory(1), range(6), paths=paths, seed=seed, bins=16, least=1)


@pytest.mark.parametrize(
    ("make", "sizes"), [(affine, (25, 60)), (quartic, (80, 150)), (counted, (1500, 12_000))]
)
def test_warnings_are_given_where_the_numbers_are_worth_them_and_nowhere_else(make, sizes):
    """Designs on few paths: some carry over and some do not."""
    worth = []
    for paths in sizes:
        for seed in range(8):
            made, said = heard(lambda seed=seed, paths=paths: make(paths, seed))
            worth.append(doubtful(made))
            for name, wanted in worth[-1].items():
                assert wanted == any(text.startswith(SENTENCES[name]) for text in said)
            diverged = any("the filter diverged" in text for text in said)
            assert diverged <= (made.held_out.diverged > 0)
    assert 0 < sum(row["predicted"] for row in worth) < len(worth)
    if make is counted:
        assert 0 < sum(row["modes"] for row in worth) < len(worth)


def test_a_useless_linearization_is_worse_than_a_constant_and_than_its_forecasts(flat):
    made, said = heard(lambda: synthesize(flat, Memory(1), Taylor(), STEPS, paths=5000, seed=0))
    worse = [text for text in said if text.startswith("held out: the estimate is worse")]
    forecast = [text for text in said if text.startswith("correction: ")]
    assert len(worse) == len(forecast) == 1
    ratio = made.held_out.rms[:, 0] / made.held_out.deviation[:, 0]
    assert (ratio > 1).mean() > 0.5
    _, said = heard(lambda: synthesize(flat, Memory(1), ExactGaussian(), STEPS, paths=5000, seed=0))
    assert not said


def test_a_cubic_forecast_with_a_long_memory_diverges_on_other_paths(tmp_path):
    system, times = sine(), STEPS[:21]
    options = {"predictor": Polynomial(3), "paths": 8000, "seed": 1}
    made, said = heard(lambda: synthesize(system, Memory(3, 3), Unscented(), times, **options))
    data = system.simulate(times, 2000, 5)
    error = made.run(times, data.measurements).mean - data.states
    assert np.sqrt(np.mean(error**2)) > 3 * made.predicted.rms.mean()
    assert any("diverged on" in text for text in said)
    assert made.held_out.diverged > 0
    short, said = heard(lambda: synthesize(system, Memory(1), Unscented(), times, **options))
    assert not said
    assert short.held_out.diverged == 0
    # what was found goes with the filter, through files too
    save(short, tmp_path / "a.npz")
    again = load(tmp_path / "a.npz", system)
    np.testing.assert_equal(again.held_out._asdict(), short.held_out._asdict())
    assert dataclasses.replace(short).held_out is short.held_out
    with pytest.raises(ValueError, match="read-only"):
        short.held_out.rms[0] = 0.0
