"""Designed filters in files: what comes back, what a file holds, and damaged or hostile files."""

import json
import time
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import sympy
from numpy.testing import assert_array_equal

from seedslib import zoo
from seedslib.design import (
    BoundedPolynomial,
    Continuous,
    Polynomial,
    grid_synthesis,
    minimax_synthesis,
    simulated_synthesis,
    synthesize,
)
from seedslib.designed import Memory, SwitchingFilter, load, save
from seedslib.linearization import (
    Cubature,
    ExactGaussian,
    GaussHermite,
    Linearization,
    Taylor,
    Unscented,
)
from seedslib.models import DiscreteSystem, Noise, StochasticMap

pytestmark = pytest.mark.filterwarnings(
    "ignore:paths. .* too few paths", "ignore:availability", "ignore:y. the axes miss"
)
TIMES = np.array([0.0, 0.5, 1.0, 1.5])


def finite_order(memory, rule, **options):
    return synthesize(
        zoo.van_der_pol(), memory, rule, TIMES, **{"paths": 600, "seed": 3, "step": 0.05} | options
    )


def linear(**options):
    return synthesize(
        zoo.linear_gaussian(), Memory(2), Taylor(), TIMES, exact_moments=True, **options
    )


def modes(memory, **options):
    return synthesize(
        zoo.manoeuvring_target("noisy"),
        memory,
        ExactGaussian(),
        TIMES * 2,
        paths=3000,
        seed=1,
        **options,
    )


def tables(system, memory, **options):
    axes = {"x": (-8, 8, 41), "z": (-6, 6, 9), "y": (-16, 18, 31)}
    return grid_synthesis(system, memory, [0.0, 0.25, 0.5], **axes | options)


def cubic():
    a, b, c = sympy.symbols("a b c", real=True)
    return DiscreteSystem(
        StochasticMap((a,), [a / (1 + a**2) + b], Noise((b,))),
        StochasticMap((a,), [a**3 + a + c], Noise((c,))),
        [0.1],
        [[1.16]],
    )


SEED = np.random.SeedSequence([2**100, 7], spawn_key=(3,))
KINDS = {
    "affine": lambda: finite_order(Memory(2), ExactGaussian()).forecasting("constant"),
    "seed of two numbers": lambda: finite_order(Memory(1), Taylor(), seed=SEED),
    "finite memory": lambda: finite_order(Memory(0, 2), Unscented(1, 2, 0), nodes=1),
    "mixed": lambda: finite_order(Memory(1, 1), Cubature(), nodes=2),
    "polynomial": lambda: finite_order(
        Memory(1), GaussHermite(3), components=1, predictor=Polynomial(3, 2)
    ),
    "continuous": lambda: finite_order(Memory(1), Taylor(), predictor=Continuous()),
    "availability": lambda: finite_order(Memory(1), Taylor(), availability=[0.7, 1.0], nodes=0),
    "exact": lambda: replace(linear(), cycle=np.int64(2)),
    "schedule": lambda: linear(measured=[[True], [False], [True], [True]]),
    "modes": lambda: modes(Memory(2, 1, 1, True)),
    "modes in turn": lambda: replace(modes(Memory(1)), cycle=1),
    "table": lambda: tables(zoo.flip_process(), Memory(1)),
    "table of modes": lambda: tables(zoo.dependent_switching(), Memory(1, 0, 1)),
    "table from paths": lambda: simulated_synthesis(
        zoo.flip_process(),
        Memory(1),
        [0.0, 0.25],
        paths=300,
        seed=1,
        y=(-6, 6, 21),
        z=(-3, 3, 17),
    ),
    "minimax": lambda: minimax_synthesis(
        cubic(), Memory(1), TIMES, paths=600, seed=1, correction=BoundedPolynomial(2)
    ),
}


def run(filter, system, seed=2):
    data = system.simulate(filter.times, 20, seed)
    y = np.array(data.measurements)
    if filter.measured is not None:
        y[~filter.measured] = np.nan
    given = {} if data.indicators is None else {"indicators": data.indicators}
    return filter.run(filter.times, y, covariances=True, **given)


def assert_same(one, two):
    for a, b in zip(one, two, strict=True):
        assert (a is None) == (b is None)
        if a is not None:
            assert_array_equal(a, b)


@pytest.mark.parametrize("kind", KINDS)
def test_filter_comes_back_bit_for_bit_and_equal_filters_are_equal_bytes(kind, tmp_path):
    filter = KINDS[kind]()
    paths = [tmp_path / f"{k}.npz" for k in range(3)]
    save(filter, paths[0])
    back = load(paths[0], filter.system)
    save(back, paths[1])
    save(KINDS[kind](), paths[2])
    first = paths[0].read_bytes()
    assert first == paths[1].read_bytes() == paths[2].read_bytes()
    assert type(back) is type(filter)
    assert str(back) == str(filter)
    for name in ("memory", "design", "cycle", "between", "components", "linearization"):
        assert getattr(back, name, None) == getattr(filter, name, None)
    assert_same(run(back, filter.system), run(filter, filter.system))
    first = [part for part in getattr(back, "fits", [()])[0] if isinstance(part, np.ndarray)]
    for part in (back.times, *first):
        with pytest.raises(ValueError, match="read-only"):
            part[...] = 0.0


@pytest.mark.parametrize("kind", ["polynomial", "modes", "table of modes"])
def test_file_holds_plain_numbers_and_a_header_that_people_read(kind, tmp_path):
    """Neither compressed nor dated; every member is a vector of numbers that NumPy reads."""
    path, filter = tmp_path / "f.npz", KINDS[kind]()
    save(filter, path)
    with np.load(path, allow_pickle=False) as archive:
        assert {archive[name].dtype.kind for name in archive.files} <= set("biuf")
        header = json.loads(archive["header"].tobytes().decode())
        times = header["filter"]["times"]
        place = slice(times["start"], times["start"] + len(filter.times))
        assert archive[times["array"]][place].tolist() == filter.times.tolist()
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            assert entry.date_time == (1980, 1, 1, 0, 0, 0)
            assert entry.compress_type == zipfile.ZIP_STORED
    assert header["filter"]["class"] == type(filter).__name__
    assert header["filter"]["memory"]["estimates"] == filter.memory.estimates


class Mine(Linearization):
    def moments(self, map, spread=True):
        return Taylor().moments(map, spread)


def test_only_designed_filters_of_descriptions_are_saved(tmp_path):
    made = linear()
    foreign = synthesize(zoo.van_der_pol(), Memory(1), Mine(), TIMES, paths=500, seed=1)
    own = minimax_synthesis(
        cubic(), Memory(1), TIMES, paths=300, seed=1, correction=lambda t, m, y: y - m
    )
    bank = SwitchingFilter(zoo.manoeuvring_target(), GaussHermite(3))
    for filter, name in (
        ({}, "filter"),
        (bank, "filter"),
        (replace(made, predictor=object()), "predictor"),
        (foreign, "linearization"),
        (own, "correction"),
    ):
        with pytest.raises(TypeError, match=name):
            save(filter, tmp_path / "x.npz")
    assert not list(tmp_path.iterdir())


# Damage


@pytest.fixture(scope="module")
def contents(tmp_path_factory):
    """The bytes of a file of each kind, and its filter; made when first asked for."""
    made, path = {}, tmp_path_factory.mktemp("files") / "f.npz"

    def content(kind):
        if kind not in made:
            filter = KINDS[kind]()
            save(filter, path)
            made[kind] = path.read_bytes(), filter
        return made[kind]

    return content


INFINITE, AXIS = float("inf"), {"class": "Axis", "low": -1.0, "high": 1.0}
HOSTILE = [
    # kind, path in the header, what is put there
    ("affine", [], [1]),
    ("affine", ["format"], "another"),
    ("affine", ["version"], 1),
    ("affine", ["filter"], None),
    ("affine", ["points"], {"array": "float64", "start": 0, "shape": [3, 0]}),
    ("affine", ["filter", "class"], "os.system"),
    ("affine", ["filter", "class"], "Memory"),
    ("affine", ["filter", "linearization"], {"class": "Magic"}),
    ("affine", ["filter", "linearization"], {"class": "Taylor", "power": 9}),
    ("affine", ["filter", "memory"], {"class": "Memory", "estimates": 10**30}),
    ("affine", ["filter", "memory", "estimates"], -1),
    ("affine", ["filter", "memory", "estimates"], 3),
    ("affine", ["filter", "memory", "estimates"], INFINITE),
    ("affine", ["filter", "components"], "two"),
    ("affine", ["filter", "between"], "cubic"),
    ("affine", ["filter", "cycle"], 9),
    ("affine", ["filter", "fits", 0, "gain", "shape"], [2, 3]),
    ("affine", ["filter", "fits", 0, "gain", "shape"], [10**9, 10**9]),
    ("affine", ["filter", "fits", 0, "gain", "start"], 10**9),
    ("affine", ["filter", "fits", 0, "gain", "array"], "float16"),
    ("table of modes", ["filter", "memory", "estimates"], 2),
    ("table of modes", ["filter", "steps", 0, "update", "axes"], [AXIS | {"count": 10**12}]),
]


@pytest.mark.parametrize("number", range(len(HOSTILE)))
def test_file_that_contradicts_itself_or_asks_for_too_much(contents, tmp_path, number):
    """One sentence, and at once."""
    kind, place, value = HOSTILE[number]
    *where, last = place or [None]
    content, filter = contents(kind)
    path = tmp_path / "f.npz"
    path.write_bytes(content)
    with np.load(path) as archive:
        vectors = {name: archive[name] for name in archive.files}
    header = json.loads(vectors["header"].tobytes())
    part = header
    for step in where:
        part = part[step]
    if last is None:
        header = value
    else:
        part[last] = value
    vectors["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    np.savez(path, **vectors)
    start = time.perf_counter()
    with pytest.raises(ValueError, match=r"^f\.npz: "):
        load(path, filter.system)
    assert time.perf_counter() - start < 4.0


def test_files_of_other_arrays_are_refused(contents, tmp_path):
    """Members that are damaged or no arrays of numbers; pickles are never read."""
    content, filter = contents("affine")
    path = tmp_path / "f.npz"
    path.write_bytes(content)
    with zipfile.ZipFile(path) as archive:
        old = {entry.filename: archive.read(entry) for entry in archive.infolist()}
    for part in (old["float64.npy"][:60], b"numbers"):
        with zipfile.ZipFile(path, "w") as archive:
            for name, member in {**old, "float64.npy": part}.items():
                archive.writestr(name, member)
        with pytest.raises(ValueError, match=r"^f\.npz: "):
            load(path, filter.system)
    for arrays in (
        {"times": np.array([object()], dtype=object)},
        {"x": np.arange(3)},
        {"header": np.frombuffer(b"[" * 100_000, dtype=np.uint8)},
        {"header": np.frombuffer(b"\xff\xfe", dtype=np.uint8)},
    ):
        np.savez(path, **arrays)
        with pytest.raises(ValueError, match=r"^f\.npz: "):
            load(path, filter.system)
