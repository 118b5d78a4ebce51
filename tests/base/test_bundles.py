"""Bundles of blocks: whoever works on them together, each block has its own numbers."""

from itertools import chain

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base.blocks import BLOCK, in_blocks
from seedslib.base.bundles import BLOCKS, Bundle, bundles, drawn, normal, parts
from seedslib.design.paths.walk import Walk, crew
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap
from seedslib.models.simulation import simulate

COUNTS = (300, 300, 120)


def generators():
    return [np.random.default_rng(s) for s in np.random.SeedSequence(3).spawn(len(COUNTS))]


def apart(work):
    """What the blocks give one by one, side by side."""
    ends = np.cumsum([0, *COUNTS])
    found = [
        work(rng, slice(a, b)) for rng, a, b in zip(generators(), ends[:-1], ends[1:], strict=True)
    ]
    return np.concatenate(found, axis=-1)


def shaken():
    """Two Wiener processes, many jumps, and neither marks nor start Gaussian."""
    x, y, v, mark = sympy.symbols("x y v mark")
    return JumpDiffusion(
        [x, y], [y, -x], [[0.1, 0], [0, 0.2 * x]], [x + v], Noise([v]), [0.5, 1.0], np.eye(2),
        intensity=6 + x**2, jump=[0, mark],
        marks=Noise(
            [mark], cov=[[1 / 3]], sample=lambda rng, count: rng.uniform(-1, 1, (1, count))
        ),
        initial=lambda rng, count: np.stack([rng.random(count), rng.exponential(size=count)]),
    )  # fmt: skip


def counted():
    """A system in discrete time with dependent Gaussian noises."""
    x, y, v, w = sympy.symbols("x y v w")
    noise = Noise([v, w], mean=[0.1, 0.2], cov=[[1.0, 0.3], [0.3, 0.5]])
    sensor = StochasticMap([x, y], [x + v], Noise([v]))
    return DiscreteSystem(
        StochasticMap([x, y], [y + v, sympy.sin(x) + w], noise), sensor, np.zeros(2), np.eye(2)
    )


SYSTEMS = {
    "oscillator": zoo.van_der_pol,
    "kicked": zoo.kicked_duffing,
    "shaken": shaken,
    "discrete": counted,
    "switching": lambda: zoo.scalar_switching().hybrid,
    "target": lambda: zoo.manoeuvring_target().hybrid,
}


@pytest.fixture(params=SYSTEMS)
def system(request):
    return SYSTEMS[request.param]()


def test_a_bundle_starts_moves_and_measures_as_its_blocks_do(system):
    total = sum(COUNTS)
    start = system.initial_sample(Bundle(generators(), COUNTS), total)
    np.testing.assert_array_equal(
        start, apart(lambda rng, here: system.initial_sample(rng, here.stop - here.start))
    )
    stop = 0.37  # a system in discrete time makes one step of it
    moved = system.advance(start, 0.0, stop, Bundle(generators(), COUNTS))
    assert not np.array_equal(moved, start)
    np.testing.assert_array_equal(
        moved, apart(lambda rng, here: system.advance(start[:, here], 0.0, stop, rng))
    )
    shown = system.sensor.sample(stop, moved, Bundle(generators(), COUNTS))
    np.testing.assert_array_equal(
        shown, apart(lambda rng, here: system.sensor.sample(stop, moved[:, here], rng))
    )


def test_a_generator_goes_through_many_paths_block_by_block():
    """The first paths of many have the numbers of few, whatever the size of a block."""
    oscillator = zoo.van_der_pol()
    x = oscillator.initial_sample(np.random.default_rng(1), 2 * BLOCK + 100)
    many, few = (
        oscillator.advance(x[:, :count], 0.0, 0.5, np.random.default_rng(2))
        for count in (x.shape[1], 70)
    )
    np.testing.assert_array_equal(many[:, :70], few)
    places = [(here.start, here.stop) for _, here in parts(None, 2 * BLOCK + 100)]
    assert places == [(0, BLOCK), (BLOCK, 2 * BLOCK), (2 * BLOCK, 2 * BLOCK + 100)]


def test_draws_come_block_by_block():
    bundle = Bundle(generators(), COUNTS)
    expected = apart(lambda rng, here: rng.standard_normal((here.stop - here.start, 2)).T)
    np.testing.assert_array_equal(normal(bundle, 2, sum(COUNTS)), expected)
    child = Bundle(generators(), COUNTS).spawn(2)[1]
    np.testing.assert_array_equal(
        drawn(child, sum(COUNTS), np.random.Generator.random),
        apart(lambda rng, here: rng.spawn(2)[1].random(here.stop - here.start)),
    )


@pytest.mark.parametrize("blocks", [1, 2, 3, 16, 25, 32, 33, 49, 100, 123])
def test_bundles_are_even_and_do_not_change_the_blocks(blocks):
    paths = blocks * BLOCK - 5
    found = bundles(paths)
    assert list(chain(*found)) == in_blocks(lambda a, b, _: b - a, paths, 0)
    assert len(found) == 1 if blocks == 1 else len(found) % 2 == 0
    sizes = [len(counts) for counts in found]
    assert max(sizes) <= BLOCKS
    assert max(sizes) - min(sizes) <= 1


@pytest.mark.parametrize("name", ["kicked", "target"])
def test_a_walk_goes_along_the_simulated_paths(name):
    """Five blocks in two bundles on two threads, and what `simulate` makes of the same seed."""
    system, paths = SYSTEMS[name](), 4 * BLOCK + 11
    times = [0.0, 1.0, 2.0] if name == "target" else [0.0, 0.3, 0.6]
    options = {"step": 0.02, "scheme": "euler"} if name == "kicked" else {}
    made = simulate(system, times, paths, 9, **options)
    with crew(2) as each:
        walk = Walk(system, paths, np.random.SeedSequence(9), 3, each, options, np.inf)
        for k, t in enumerate(times):
            if k == 0:
                walk.begin(t)
            else:
                walk.advance(times[k - 1], t)
            np.testing.assert_array_equal(np.concatenate(walk.states, axis=1), made.states[k])
            shown = np.concatenate(walk.measure(t), axis=1)
            np.testing.assert_array_equal(shown, made.measurements[k])
        assert len(walk.states) == 2
