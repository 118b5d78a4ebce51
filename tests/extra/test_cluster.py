"""Designs on a Dask cluster: the same bits as here, also when workers are lost."""

import os
import pickle
import platform
import subprocess
import sys

import cloudpickle
import distributed
import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import Affine, Continuous, Polynomial, synthesize
from seedslib.design.paths.checkpoint import Checkpoint
from seedslib.design.paths.walk import Crew, Walk
from seedslib.designed import Memory
from seedslib.extra import cluster, dask_crew
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

TACTS = np.arange(3) * 0.5
BASE = {"paths": 17_000, "seed": 5, "step": 0.1, "nodes": 1}
QUIET = {
    "dashboard_address": None, "silence_logs": 50, "threads_per_worker": 1,
    "scheduler_kwargs": {"dashboard_address": "127.0.0.1:0"},
}  # fmt: skip

AS_STARTED = []


@pytest.fixture(scope="module")
def one():
    """A cluster of one worker in this process."""
    with (
        distributed.LocalCluster(n_workers=1, processes=False, **QUIET) as made,
        distributed.Client(made, set_as_default=False) as client,
        cluster(client) as crew,
    ):
        yield crew


@pytest.fixture(scope="module")
def two():
    """A cluster of two processes, which have told how they keep memory as they were started."""
    with (
        distributed.LocalCluster(n_workers=2, processes=True, **QUIET) as made,
        distributed.Client(made, set_as_default=False) as client,
    ):
        AS_STARTED.extend(client.run(_faults_of_arrays).values())
        with cluster(client) as crew:
            yield crew


@pytest.mark.parametrize("size", ["one", "two"])
@pytest.mark.parametrize(
    ("memory", "predictor", "options"),
    [
        (Memory(2), Affine(), {"measured_nodes": True}),
        (Memory(1, 1), Polynomial(2, 2), {"nodes": 0}),
        (Memory(1), Continuous(), {"horizon": 1.2, "step": 0.25}),
    ],
)
def test_a_cluster_finds_the_same_bits(oscillator, request, size, memory, predictor, options, same):
    options = BASE | options | {"predictor": predictor}
    client = request.getfixturevalue(size)
    here = synthesize(oscillator, memory, ExactGaussian(), TACTS, **options)
    there = synthesize(oscillator, memory, ExactGaussian(), TACTS, workers=client, **options)
    assert same(here, there)


@pytest.mark.parametrize(
    ("system", "memory", "rule"),
    [
        (zoo.scalar_switching(), Memory(1), ExactGaussian()),
        (zoo.manoeuvring_target("noisy"), Memory(0, 1, 1), Taylor()),
    ],
)
def test_a_cluster_finds_the_same_bits_for_a_system_of_modes(two, system, memory, rule):
    times = np.arange(3.0)
    here, there = (
        synthesize(system, memory, rule, times, paths=17_000, seed=5, workers=where)
        for where in (2, two)
    )
    for a, b in zip(here.fits, there.fits, strict=True):
        for p, q in zip(a, b, strict=True):
            np.testing.assert_array_equal(p, q)
    for p, q in zip(here.predicted, there.predicted, strict=True):
        np.testing.assert_array_equal(p, q)
    np.testing.assert_equal(here.held_out._asdict(), there.held_out._asdict())
    assert here.held_out.paths == 2125
    assert here.design == there.design


def test_an_address_is_enough_and_few_blocks_too(oscillator, two, same):
    options = BASE | {"paths": 500}
    with cluster(two.client.scheduler.address) as crew:
        there = synthesize(oscillator, Memory(1), Taylor(), TACTS, workers=crew, **options)
    assert same(there, synthesize(oscillator, Memory(1), Taylor(), TACTS, **options))
    assert two.client.status == "running"


def test_jumps_and_paths_that_are_left_out(two, same):
    """Impulses, a bound that cuts some paths off, functions that only a closure knows."""
    x, z, v = sympy.symbols("x z v")
    system = JumpDiffusion(
        (x,), [x**3 - x], [[0.1]], [x + v], Noise((v,)), [0], [[0.09]], intensity=x**2 + 0.1,
        jump=[z], marks=Noise((z,), cov=[[0.01]]),
        initial=lambda rng, count: rng.standard_normal((1, count)) * 0.3,
    )  # fmt: skip
    options = BASE | {"bound": 1.2, "step": 0.02}
    with pytest.warns(UserWarning, match="diverged"):
        here = synthesize(system, Memory(1), ExactGaussian(), TACTS, **options)
    with pytest.warns(UserWarning, match=f"{here.design.diverged} of 17000"):
        there = synthesize(system, Memory(1), ExactGaussian(), TACTS, workers=two, **options)
    assert here.design.diverged > 10
    assert same(here, there)


def test_array_functions_in_discrete_time(two, same):
    dynamics = StochasticMap.from_functions(
        1, 1, lambda t, x, v: 0.9 * x + np.sin(x) / (1 + t) + v, Noise(1)
    )
    sensor = StochasticMap.from_functions(1, 1, lambda t, x, v: x + v, Noise(1))
    system = DiscreteSystem(dynamics, sensor, [0], [[1]])
    options = {"paths": 17_000, "seed": 1}
    here, there = (
        synthesize(system, Memory(2), Cubature(), np.arange(4), workers=where, **options)
        for where in (1, two)
    )
    assert same(here, there)


class Stopped(Exception):
    """The run ends here."""


@pytest.mark.parametrize("there_first", [True, False])
def test_a_design_moves_between_threads_and_a_cluster(
    oscillator, two, tmp_path, monkeypatch, there_first, same
):
    where = [two, 1] if there_first else [1, two]
    path, write = tmp_path / "design", Checkpoint.write

    def once(self, forward, last):
        write(self, forward, last)
        raise Stopped

    monkeypatch.setattr(Checkpoint, "write", once)
    with pytest.raises(Stopped):
        synthesize(
            oscillator, Memory(2), Taylor(), TACTS, checkpoint=path, workers=where[0], **BASE
        )
    monkeypatch.setattr(Checkpoint, "write", write)
    found = synthesize(
        oscillator, Memory(2), Taylor(), TACTS, checkpoint=path, workers=where[1], **BASE
    )
    assert same(found, synthesize(oscillator, Memory(2), Taylor(), TACTS, **BASE))


def _faults_of_arrays():
    import resource

    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(30):
        np.ones(500_000)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="a setting of glibc")
def test_workers_keep_the_memory_of_arrays(two):
    """As Dask starts a worker, each of these arrays is worth some 1000 page faults."""
    after = two.client.run(_faults_of_arrays).values()
    assert len(AS_STARTED) == len(after) == 2
    assert min(AS_STARTED) > 20_000
    assert max(after) < 5000


def test_a_lost_worker_changes_nothing(oscillator, two, monkeypatch, same):
    """Killed in the middle: its blocks are made again from their streams."""
    options = BASE | {"nodes": 0}
    here = synthesize(oscillator, Memory(2), Taylor(), TACTS, **options)
    fetch, looked = dask_crew.Cluster.fetch, []

    def deadly(self, name):
        found = fetch(self, name)
        looked.append(name)
        if len(looked) == 3:
            os.kill(next(iter(self.client.run(os.getpid).values())), 9)
        return found

    monkeypatch.setattr(dask_crew.Cluster, "fetch", deadly)
    there = synthesize(oscillator, Memory(2), Taylor(), TACTS, workers=two, **options)
    assert len(looked) > 4
    assert same(here, there)


@pytest.mark.parametrize("lost", ["workers", "scheduler"])
def test_a_lost_cluster_is_an_error(oscillator, monkeypatch, lost):
    """No worker is left and none comes: not a wait without end."""
    monkeypatch.setattr(dask_crew, "PATIENCE", 0.3)
    fetch, looked = dask_crew.Cluster.fetch, []
    with (
        distributed.LocalCluster(n_workers=1, processes=False, **QUIET) as made,
        distributed.Client(made, set_as_default=False) as client,
    ):

        def deadly(self, name):
            looked.append(name)
            if len(looked) == 3:
                made.close() if lost == "scheduler" else made.scale(0)
            return fetch(self, name)

        monkeypatch.setattr(dask_crew.Cluster, "fetch", deadly)
        with (
            cluster(client) as crew,
            pytest.raises(RuntimeError, match=r"cluster was lost .*; with a checkpoint"),
        ):
            synthesize(oscillator, Memory(1), Taylor(), TACTS, workers=crew, **BASE)
        if lost == "workers":
            with pytest.raises(ValueError, match=r"no worker came within 0.3 s"), cluster(client):
                pass


def test_errors_of_the_work_come_home(one):
    def sampler(rng, count):
        raise ArithmeticError("no such law")

    x, v = sympy.symbols("x v")
    system = JumpDiffusion((x,), [-x], [[1]], [x + v], Noise((v,)), [0], [[1]], initial=sampler)
    with pytest.raises(ArithmeticError, match="no such law"):
        synthesize(system, Memory(1), Taylor(), TACTS, workers=one, **BASE)


def test_other_versions_on_a_worker_are_refused(oscillator, two, monkeypatch):
    monkeypatch.setattr(dask_crew, "_versions", lambda: ("9.9.9", "1.0", "3.0"))
    with pytest.raises(RuntimeError, match=r"a worker has seedslib, .*, wanted 9.9.9, 1.0, 3.0"):
        synthesize(oscillator, Memory(1), Taylor(), TACTS, workers=two, **BASE)


def test_what_is_no_scheduler(oscillator, monkeypatch):
    monkeypatch.setattr(dask_crew, "CONNECT", 0.5)
    with pytest.raises(TypeError, match=r"workers: wanted a whole number or a Crew, got 'tcp"):
        synthesize(oscillator, Memory(1), Taylor(), TACTS, workers="tcp://127.0.0.1:9", **BASE)
    wanted = r"scheduler: wanted an address or a distributed.Client"
    with pytest.raises(TypeError, match=wanted), cluster(8786):
        pass
    nothing = r"nothing answers at tcp://127.0.0.1:9"
    with pytest.raises(ValueError, match=nothing), cluster("tcp://127.0.0.1:9"):
        pass


def test_dask_is_not_loaded_without_a_scheduler():
    script = (
        "import sys; from seedslib.design import synthesize; "
        "from seedslib.design.paths import simulated, walk; "
        "from seedslib.design.paths import checkpoint; "
        "print(*{'dask', 'distributed', 'cloudpickle'} & set(sys.modules))"
    )
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    assert found.stdout.split() == []


@pytest.mark.parametrize("crew", ["here", "one", "two"])
def test_a_walk_leaves_paths_out_wherever_it_is(oscillator, request, crew):
    """The first hundred of 9000 columns are not finite: they leave all averages."""
    each = Crew() if crew == "here" else request.getfixturevalue(crew)
    walk = Walk(oscillator, 9000, np.random.SeedSequence(1), 2, each, {}, np.inf)
    walk.begin(0.0)

    def marked(x):
        return np.where(np.arange(x.shape[1]) < 50, np.nan, x[:1])

    shown = walk.kept(marked, walk.states)
    assert walk.lost == 100
    found = walk.gather(lambda x, y: np.concatenate([x[:1], y]), shown)
    assert found.count == 8900
    assert found.mean[0] == found.mean[1]
    assert all((part[:, :50] == 0).all() for part in shown)
    walk.advance(0.0, 0.1)
    with pytest.raises(ValueError, match="wanted at most the 2 that were announced"):
        walk.advance(0.1, 0.2)


# What travels


def _decay(t, x):
    return -x


def _level(t, x):
    return np.ones((1, *x.shape))


def _shown(t, x, v):
    return x + v


def _systems():
    sensor = StochasticMap.from_functions(1, 1, _shown, Noise(1))
    discrete = zoo.van_der_pol().sensor
    x1, x2, w = sympy.symbols("x1 x2 w")
    return {
        "van der pol": zoo.van_der_pol(),
        "duffing": zoo.kicked_duffing(),
        "flip": zoo.flip_process(),
        "functions": JumpDiffusion.from_functions(_decay, _level, sensor, [0.0], [[1.0]]),
        "discrete": DiscreteSystem(
            StochasticMap((x1, x2), [x2, sympy.sin(x1) + w], Noise((w,))), discrete, [0, 0],
            np.eye(2),
        ),
    }  # fmt: skip


@pytest.mark.parametrize("name", ["van der pol", "duffing", "flip", "functions", "discrete"])
@pytest.mark.parametrize("pickler", [pickle, cloudpickle])
def test_systems_travel_used_or_not(name, pickler):
    """By plain pickle where no closure is in them; compiled again to the same bits."""
    system = _systems()[name]
    times = np.arange(3) * 0.5 if name != "discrete" else np.arange(3)
    fresh = pickler.loads(pickler.dumps(system))
    data = system.simulate(times, 300, 1)
    if name == "duffing":
        assert (system.intensity(0.0, data.states[0]) > 0).all()
        system.drift_map.conditional_moments(0.0, data.states[0])
    if isinstance(system, JumpDiffusion):
        system.spread_map.value(0.0, data.states[0], np.empty((0, 300)))
    used = pickler.loads(pickler.dumps(system))
    for copy in (fresh, used):
        again = copy.simulate(times, 300, 1)
        np.testing.assert_array_equal(again.states, data.states)
        np.testing.assert_array_equal(again.measurements, data.measurements)
        # the copy is a system like any other: other code, same formulas
        rule = GaussHermite(3)
        a, b = (rule.moments(part.sensor)(0.0, part.mean0, part.cov0) for part in (copy, system))
        np.testing.assert_array_equal(a.cov, b.cov)


@pytest.mark.parametrize(
    "thing",
    [Taylor(), ExactGaussian(), Unscented(1, 2, 0), Cubature(), GaussHermite(5), Memory(2, 1),
     Affine(), Polynomial(2, 1), Continuous()],
    ids=lambda thing: type(thing).__name__,
)  # fmt: skip
def test_descriptions_travel(thing):
    assert pickle.loads(pickle.dumps(thing)) == thing
