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
from seedslib.linearization import Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, v, w = sympy.symbols("x v w", real=True)
STEPS = np.arange(31.0)


def sine():
    move = StochasticMap([x], [x / 2 + 2 * sympy.sin(x) + w], Noise([w], cov=[[0.2]]))
    return DiscreteSystem(move, StochasticMap([x], [x + v], Noise([v])), [0.0], [[1.0]])


def heard(make):
    """A design and the beginnings of the sentences that it warned with."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made = make()
    assert {one.filename for one in caught} <= {__file__}  # they point at the caller
    return made, [str(one.message) for one in caught]


def doubtful(made):
    """Whether the numbers of a design are worth a warning: the rule, written out.

    A difference counts beyond 2 per cent and beyond 4 standard errors, or so many more as there
    are numbers compared; few design paths are believed as little as the held-out ones. So does an
    error that rests on few paths.
    """
    held, predicted = made.held_out, made.predicted
    rows = np.isin(predicted.times, held.times)
    pairs = [(predicted.rms[rows], predicted.error[rows], held.rms, held.error)]
    if held.mode_rate is not None:
        pairs.append(
            (
                predicted.mode_rate[:, None],
                predicted.mode_error[:, None],
                held.mode_rate[:, None],
                held.mode_error[:, None],
            )
        )
    wanted, wanted_error, found, error = (np.hstack(part) for part in zip(*pairs, strict=True))
    doubt = np.sqrt(16 + 2 * np.log(wanted.size))
    share = np.sqrt(made.design.paths / held.paths)
    both = np.sqrt(wanted_error**2 + np.maximum(error, share * wanted_error) ** 2)
    few = (found > wanted) & (error > 0.35 * found)
    few[:, 1 if held.mode_rate is not None else found.shape[1] :] = False  # of the state alone
    bad = (np.abs(found - wanted) > doubt * both) | few
    return bool((bad & (np.abs(found - wanted) > 0.02 * wanted)).any()) or held.diverged > 0


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
    return binned_synthesis(system, Memory(1), range(6), paths=paths, seed=seed, bins=16)


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
            assert worth[-1] == any(text.startswith("held out: errors") for text in said)
    assert 0 < sum(worth) < len(worth)


def test_a_cubic_forecast_with_a_long_memory_diverges_on_other_paths(tmp_path):
    system, times = sine(), STEPS[:21]
    options = {"predictor": Polynomial(3), "paths": 8000, "seed": 1}
    made, said = heard(lambda: synthesize(system, Memory(3, 3), Unscented(), times, **options))
    data = system.simulate(times, 2000, 5)
    error = made.run(times, data.measurements).mean - data.states
    assert np.sqrt(np.mean(error**2)) > 3 * made.predicted.rms.mean()
    assert any(text.startswith("held out: errors") for text in said)
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
