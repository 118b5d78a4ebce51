"""Random filters in an evaluation: numbers of their own in every block; gaps in consistency."""

import numpy as np
import pytest
import sympy

from seedslib.base.blocks import as_seed_sequence, child
from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.evaluation import compare
from seedslib.evaluation.scoring import FILTERS
from seedslib.filters import Estimates, ParticleFilter, extended_kalman
from seedslib.linearization import ExactGaussian
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, w, v = sympy.symbols("x w v")
TIMES = np.arange(6.0)


@pytest.fixture(scope="module")
def system():
    return DiscreteSystem(
        StochasticMap([x], [0.9 * x + w], Noise([w])), StochasticMap([x], [x + v], Noise([v])),
        [0.0], [[1.0]],
    )  # fmt: skip


class Drawn:
    """Estimates that are random numbers and nothing else."""

    takes = ("seed",)

    def __init__(self):
        self.seen = []

    def run(self, times, measurements, *, seed=0):
        rng = np.random.default_rng(seed)
        mean = rng.standard_normal((len(times), 1, measurements.shape[2]))
        self.seen.append(mean[0, 0, :50])
        return Estimates(mean)


def test_random_filters_share_no_numbers_between_blocks_or_with_each_other(system):
    filters = {"one": Drawn(), "two": Drawn(), "plain": extended_kalman(system)}
    compare(filters, system, TIMES, 3 * 2048, 1)
    seen = np.array([row for name in ("one", "two") for row in filters[name].seen])
    assert seen.shape == (6, 50)
    assert len(np.unique(seen)) == seen.size
    # with 50 numbers a row independent rows are correlated by about 0.14
    assert np.abs(np.corrcoef(seen) - np.eye(6)).max() < 0.6


def test_comparisons_repeat_and_do_not_depend_on_threads(system):
    def once(workers):
        filters = {"drawn": ParticleFilter(system, 30), "plain": extended_kalman(system)}
        return compare(filters, system, TIMES, 2 * 2048 + 100, 1, workers=workers)

    one, two = once(1), once(2)
    for name in one:
        np.testing.assert_array_equal(one[name].rms, two[name].rms)
    # the paths are common: a random filter beside it changes nothing for another
    alone = compare({"plain": extended_kalman(system)}, system, TIMES, 2 * 2048 + 100, 1)
    np.testing.assert_array_equal(alone["plain"].rms, one["plain"].rms)


def test_the_stream_of_a_filter_is_none_of_the_paths():
    """Keys of the simulation inside of a block are numbers of blocks; these are not."""
    stream = as_seed_sequence(1).spawn(1)[0]
    own = child(stream, FILTERS, 0)
    assert own.spawn_key == (0, FILTERS, 0)
    assert FILTERS > 1 << 30


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_consistency_leaves_out_what_a_designed_filter_does_not_know(system):
    """Every second path loses a measurement: squares of the others alone, recomputed by hand."""
    designed = synthesize(system, Memory(1), ExactGaussian(), TIMES, paths=4000, seed=1)

    class Gaps:
        """The system with a sensor that fails on every second path at time 2."""

        def __getattr__(self, name):
            return getattr(system, name)

        def simulate(self, *arguments, **options):
            made = system.simulate(*arguments, **options)
            made.measurements[2, :, ::2] = np.nan
            return made

    filters = {"designed": designed, "kalman": extended_kalman(system)}
    with pytest.warns(UserWarning, match=r"consistency: n[ei]") as heard:
        found = compare(filters, Gaps(), TIMES, 1000, 3, consistency=True)
    text = [str(one.message) for one in heard if "consistency" in str(one.message)]
    assert any("nees of 'designed' is known on 500 of 1000 paths" in line for line in text)
    assert not any("nees of 'kalman'" in line for line in text)
    assert np.isfinite(found["designed"].nees).all()
    data = system.simulate(TIMES, 1000, as_seed_sequence(3).spawn(1)[0])
    whole = designed.run(TIMES, data.measurements[..., 1::2], covariances=True)
    error = (whole.mean - data.states[..., 1::2])[:, 0]
    wanted = (error**2 / whole.cov[:, 0, 0]).mean(axis=1)
    np.testing.assert_allclose(found["designed"].nees[2:], wanted[2:], rtol=1e-12)
    wide, narrow = (np.subtract(*found[name].nees_bounds[::-1]) for name in filters)
    np.testing.assert_array_less(narrow[2:], wide[2:])
    np.testing.assert_allclose(narrow[:2], wide[:2])
    # the Kalman filter knows its error on all paths
    assert np.isfinite(found["kalman"].nees).all()
