"""Designs on a Dask cluster: the bits of one thread, also when a worker is lost."""

import contextlib
import os
import subprocess
import sys

import dask
import distributed
import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import Continuous, Executor, Polynomial, synthesize
from seedslib.designed import Memory
from seedslib.extra import cluster
from seedslib.linearization import Cubature, ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

TIMES = 0.5 * np.arange(3)
BASE = {"paths": 17_000, "seed": 5, "step": 0.1, "nodes": 1}
QUIET = {"dashboard_address": None, "silence_logs": 50, "threads_per_worker": 1}
QUIET["scheduler_kwargs"] = {"dashboard_address": "127.0.0.1:0"}


def running(size, processes):
    """Workers of a local cluster: what makes a design run on it."""
    with (
        distributed.LocalCluster(n_workers=size, processes=processes, **QUIET) as made,
        distributed.Client(made, set_as_default=False) as client,
        cluster(client) as workers,
    ):
        yield workers


@pytest.fixture(scope="module")
def processes():
    yield from running(2, True)


def numbers(filter):
    """All numbers of a design, as bytes."""
    fits = [*filter.fits, *(fit for row in getattr(filter, "node_fits", ()) for fit in row)]
    parts = [part for each in (*fits, filter.predicted, filter.held_out or ()) for part in each]
    return [np.asarray(part).tobytes() for part in parts if part is not None]


def functions(mark="none", parent=0):
    """A system of array functions that only closures know; they may end the process of a worker.

    From the second step on, while the file `mark` is there, which the first to die takes away.
    """

    def move(t, x, v):
        if t >= 1.0 and os.getpid() != parent:
            with contextlib.suppress(FileNotFoundError):
                os.remove(mark)
                os._exit(9)
        return 0.9 * x + np.sin(x) / (1 + t) + v

    dynamics = StochasticMap.from_functions(1, 1, move, Noise(1))
    sensor = StochasticMap.from_functions(1, 1, lambda t, x, v: x + v, Noise(1))
    return DiscreteSystem(dynamics, sensor, [0], [[1]])


def bounded():
    """Jumps, an initial distribution by a closure, and paths that run away."""
    x, z, v = sympy.symbols("x z v")
    jumps = {"intensity": sympy.Rational(1, 2), "jump": [z], "marks": Noise((z,), cov=[[0.01]])}
    dist = {"initial": lambda rng, count: rng.standard_normal((1, count)) * 0.3, **jumps}
    return JumpDiffusion((x,), [x**3 - x], [[0.1]], [x + v], Noise((v,)), [0], [[0.09]], **dist)


PLAIN = {"paths": 17_000, "seed": 5}
OSCILLATOR, EXACT = zoo.van_der_pol, ExactGaussian()
DESIGNS = {
    "affine": (OSCILLATOR, Memory(2), EXACT, TIMES, {}),
    "polynomial": (OSCILLATOR, Memory(1, 1), EXACT, TIMES, {"predictor": Polynomial(2, 2)}),
    "continuous": (OSCILLATOR, Memory(1), EXACT, TIMES, {"predictor": Continuous()}),
    "lost paths": (bounded, Memory(1), EXACT, TIMES, {"step": 0.02}),
    "functions": (functions, Memory(2), Cubature(), np.arange(4), {}),
    "modes": (zoo.manoeuvring_target, Memory(0, 1, 1), Taylor(), np.arange(3.0), {}),
}


@pytest.mark.filterwarnings("ignore:.*diverged:UserWarning")
@pytest.mark.parametrize("name", DESIGNS)
def test_a_design_on_a_cluster_has_the_bits_of_one_thread(name, processes):
    model, memory, rule, times, options = DESIGNS[name]
    options = (BASE if times is TIMES else PLAIN) | options
    system = model()
    here = synthesize(system, memory, rule, times, **options)
    there = synthesize(system, memory, rule, times, workers=processes, **options)
    assert numbers(here) == numbers(there)
    assert here.design == there.design
    if name == "lost paths":
        assert here.design.diverged > 0


def plain(**options):
    return synthesize(zoo.van_der_pol(), Memory(1), Taylor(), TIMES, **BASE, **options)


def test_an_address_is_enough_and_a_client_is_left_open(processes):
    with cluster(processes.client.scheduler.address) as workers:
        assert numbers(plain(workers=workers)) == numbers(plain())
    with cluster(processes.client) as workers:
        assert isinstance(workers, Executor)
    assert processes.client.status == "running"


def test_an_error_of_the_work_comes_home_and_leaves_the_cluster_fit():
    """With the worker in this process."""

    def sampler(rng, count):
        raise ArithmeticError("no such distribution")

    x, v = sympy.symbols("x v")
    system = JumpDiffusion((x,), [-x], [[1]], [x + v], Noise((v,)), [0], [[1]], initial=sampler)
    for workers in running(1, False):
        with pytest.raises(ArithmeticError, match="no such distribution"):
            synthesize(system, Memory(1), Taylor(), TIMES, workers=workers, **BASE)
        assert numbers(plain(workers=workers)) == numbers(plain())


def test_a_lost_worker_changes_nothing(processes, tmp_path):
    mark = tmp_path / "mark"
    system = functions(str(mark), os.getpid())
    here = synthesize(system, Memory(2), Cubature(), np.arange(4), **PLAIN)
    mark.touch()
    there = synthesize(system, Memory(2), Cubature(), np.arange(4), workers=processes, **PLAIN)
    assert not mark.exists()
    assert numbers(here) == numbers(there)


def test_a_lost_cluster_is_an_error(tmp_path):
    mark = tmp_path / "mark"
    mark.touch()
    system = functions(str(mark), os.getpid())
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
        for workers in running(1, True):
            with pytest.raises(RuntimeError, match="cluster was lost"):
                synthesize(system, Memory(1), Cubature(), np.arange(4), workers=workers, **PLAIN)


def test_dask_is_not_loaded_without_a_cluster():
    script = (
        "import sys; from seedslib.design import synthesize, stationary; import seedslib.extra; "
        "print(*{'dask', 'distributed', 'cloudpickle'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    assert done.stdout.split() == []
