import numpy as np
import pytest

from seedslib import zoo
from seedslib.base.blocks import as_seed_sequence, in_blocks
from seedslib.models.simulation import as_measured, simulate


def test_blocks_come_back_in_order_with_their_own_streams():
    def work(start, stop, stream):
        return start, stop, np.random.default_rng(stream).random()

    one = in_blocks(work, 25, 3, block=10)
    two = in_blocks(work, 25, 3, workers=2, block=10)
    assert one == two
    assert [(a, b) for a, b, _ in one] == [(0, 10), (10, 20), (20, 25)]
    assert len({r for _, _, r in one}) == 3
    # a block has the same stream however many follow
    assert in_blocks(work, 5, 3, block=10)[0][2] == one[0][2]


def test_seeds():
    draws = [
        np.random.default_rng(as_seed_sequence(seed)).random()
        for seed in (5, np.int64(5), np.random.SeedSequence(5))
    ]
    assert len(set(draws)) == 1
    used = np.random.SeedSequence(5)
    used.spawn(3)
    assert as_seed_sequence(used).spawn(1)[0].generate_state(1) == (
        np.random.SeedSequence(5).spawn(1)[0].generate_state(1)
    )
    generator = np.random.default_rng(1)
    first, second = as_seed_sequence(generator), as_seed_sequence(generator)
    assert first.entropy != second.entropy
    for bad in (None, 1.5, True, "7"):
        with pytest.raises(TypeError, match="seed: wanted"):
            as_seed_sequence(bad)


def test_measured_times():
    assert as_measured(None, 3).tolist() == [True] * 3
    assert as_measured([0, -1], 3).tolist() == [True, False, True]
    assert as_measured([False, True, False], 3).tolist() == [False, True, False]
    with pytest.raises(ValueError, match="measured: wanted a mask of shape"):
        as_measured([True], 3)
    with pytest.raises(ValueError, match="measured: wanted indices"):
        as_measured([3], 3)


def test_unmeasured_times_are_nan_and_do_not_change_the_paths():
    system = zoo.linear_gaussian()
    times = [0.0, 0.25, 0.5]
    full = system.simulate(times, 10, 1)
    part = system.simulate(times, 10, 1, measured=[0, 2])
    np.testing.assert_array_equal(full.states, part.states)
    assert np.isnan(part.measurements[1]).all()
    np.testing.assert_array_equal(part.measurements[[0, 2]], full.measurements[[0, 2]])


def test_paths_that_explode_show_it_without_a_warning():
    run = zoo.van_der_pol().simulate([0.0, 60.0], 50, 1, step=1.5)
    assert not np.isfinite(run.states[1]).all()
    assert np.isfinite(run.states[0]).all()


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"times": [0.0, 0.0]}, ValueError, "times: wanted strictly increasing"),
        ({"times": []}, ValueError, "times: wanted"),
        ({"paths": 0}, ValueError, "paths: wanted at least 1, got 0"),
        ({"paths": 2.5}, TypeError, "paths: wanted a whole number"),
        ({"seed": None}, TypeError, "seed: wanted"),
        ({"workers": 0}, ValueError, "workers: wanted at least 1"),
    ],
)
def test_bad_arguments(change, error, message):
    given = {"times": [0.0, 1.0], "paths": 2, "seed": 0} | change
    with pytest.raises(error, match=message):
        simulate(zoo.linear_gaussian(), **given)
