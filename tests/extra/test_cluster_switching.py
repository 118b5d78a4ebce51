"""Designs of switching systems on a Dask cluster: the same bits as here."""

import distributed
import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.extra import cluster
from seedslib.linearization import ExactGaussian, Taylor

QUIET = {
    "dashboard_address": None, "silence_logs": 50, "threads_per_worker": 1,
    "scheduler_kwargs": {"dashboard_address": ":0"},
}  # fmt: skip


@pytest.fixture(scope="module")
def crew():
    """A cluster of two processes."""
    with (
        distributed.LocalCluster(n_workers=2, processes=True, **QUIET) as made,
        distributed.Client(made, set_as_default=False) as client,
        cluster(client) as crew,
    ):
        yield crew


@pytest.mark.parametrize(
    ("system", "memory", "rule"),
    [
        (zoo.scalar_switching(), Memory(1), ExactGaussian()),
        (zoo.manoeuvring_target("noisy"), Memory(0, 1, 1), Taylor()),
    ],
)
def test_a_cluster_finds_the_same_bits(crew, system, memory, rule):
    times = np.arange(3.0)
    here, there = (
        synthesize(system, memory, rule, times, paths=17_000, seed=5, workers=where)
        for where in (2, crew)
    )
    for a, b in zip(here.fits, there.fits, strict=True):
        for p, q in zip(a, b, strict=True):
            np.testing.assert_array_equal(p, q)
    for p, q in zip(here.predicted, there.predicted, strict=True):
        np.testing.assert_array_equal(p, q)
    np.testing.assert_equal(here.held_out._asdict(), there.held_out._asdict())
    assert here.held_out.paths == 2125
    assert here.design == there.design
