"""Designed filters in files: what comes back, and what is refused with which words."""

import dataclasses
import json
import re
import time
import zipfile

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import Affine, Continuous, Polynomial, simulated_synthesis, synthesize
from seedslib.designed import Memory, finite_memory, load, save
from seedslib.linearization import Cubature, ExactGaussian, Linearization, Taylor, Unscented
from seedslib.models import JumpDiffusion, Noise, StochasticMap

TACTS = np.arange(4) * 0.5
GRID = np.linspace(0, 1.5, 31)

FAMILY = {
    "affine": (Memory(2), Affine(), ExactGaussian(), {}),
    "remark 1": (Memory(1), Affine(), Taylor(), {"measured_nodes": True}),
    "finite memory": (finite_memory(2), Affine(), Unscented(1, 2, 0), {"nodes": 1}),
    "mixed": (Memory(1, 1), Affine(), Cubature(), {"nodes": [[0.2], [], [1.1, 1.2]]}),
    "polynomial": (Memory(1), Polynomial(3, 2), ExactGaussian(), {"components": 1}),
    "polynomial mean": (Memory(1), Polynomial(2, 0), ExactGaussian(), {}),
    "continuous": (Memory(1), Continuous(), Taylor(), {}),
}


@pytest.fixture(scope="module")
def oscillator():
    return zoo.van_der_pol()


@pytest.fixture(scope="module")
def data(oscillator):
    return oscillator.simulate(GRID, 20, 9, measured=np.arange(4) * 10)


def design(system, name="affine"):
    memory, predictor, rule, options = FAMILY[name]
    return synthesize(
        system, memory, rule, TACTS, predictor=predictor, paths=2000, seed=3, step=0.05, **options
    )


@pytest.fixture
def file(tmp_path, oscillator):
    path = tmp_path / "filter.npz"
    save(design(oscillator), path)
    return path


@pytest.mark.parametrize("name", FAMILY)
def test_what_was_saved_comes_back_bit_for_bit(tmp_path, oscillator, data, name):
    filter = design(oscillator, name)
    save(filter, tmp_path / "filter.npz")
    found = load(tmp_path / "filter.npz", zoo.van_der_pol())
    one, two = (f.run(GRID, data.measurements) for f in (filter, found))
    np.testing.assert_array_equal(one.mean, two.mean)
    np.testing.assert_array_equal(one.loglik, two.loglik)
    for field in ("memory", "predictor", "linearization", "components", "design", "between"):
        assert getattr(found, field) == getattr(filter, field)
    for a, b in zip(found.predicted, filter.predicted, strict=True):
        np.testing.assert_array_equal(a, b)
    assert str(found) == str(filter)


@pytest.mark.parametrize("name", FAMILY)
def test_equal_filters_are_equal_bytes(tmp_path, name):
    for k in range(2):
        save(design(zoo.van_der_pol(), name), tmp_path / f"{k}.npz")
    save(load(tmp_path / "0.npz", zoo.van_der_pol()), tmp_path / "2.npz")
    first = (tmp_path / "0.npz").read_bytes()
    assert first == (tmp_path / "1.npz").read_bytes() == (tmp_path / "2.npz").read_bytes()


def test_kind_of_forecast_is_kept(tmp_path, oscillator):
    save(design(oscillator).forecasting("constant"), tmp_path / "filter.npz")
    assert load(tmp_path / "filter.npz", oscillator).between == "constant"


def test_exact_moments_and_a_large_seed(tmp_path):
    system = zoo.linear_gaussian()
    made = synthesize(system, Memory(2), Taylor(), TACTS, exact_moments=True, horizon=2)
    save(made, tmp_path / "a.npz")
    found = load(tmp_path / "a.npz", system)
    assert found.design.exact
    assert found.horizon == 2
    seed = np.random.SeedSequence([2**100, 7], spawn_key=(3,))
    made = synthesize(system, Memory(1), Taylor(), TACTS, paths=500, seed=seed, step=0.1)
    save(made, tmp_path / "b.npz")
    assert load(tmp_path / "b.npz", system).design == made.design
    assert made.design.entropy == [2**100, 7]


def test_the_header_can_be_read_by_people(file):
    with np.load(file, allow_pickle=False) as archive:
        header = json.loads(archive["header"].tobytes().decode())
        assert archive["times"].tolist() == TACTS.tolist()
    assert header["format"] == "seedslib designed filter"
    filter = header["filter"]
    assert filter["class"] == "FiniteOrderFilter"
    assert filter["memory"]["estimates"] == 2
    assert filter["linearization"] == {"class": "ExactGaussian"}
    assert filter["design"]["paths"] == 2000
    assert "x1**2" in header["model"]["sensor"]


# The same model written otherwise, and other models


def rewritten(**changes):
    """Van der Pol with other names, scaled noises and the drift multiplied out."""
    a, b, u, w = sympy.symbols("a b u w")
    parts = {
        "state": (a, b),
        "drift": [b, 2 * b - 2 * b * a**2 - (sympy.pi / 10) ** 2 * a],
        "diffusion": [[0, 0], [a * sympy.Rational(3, 5), -a * sympy.Rational(4, 5)]],
        "sensor": [a**2 + u / 2, b + 2 * w],
        "noise": Noise((u, w), cov=[[4, 0], [0, 0.25]]),
        "mean0": [2, 0],
        "cov0": [[0.15, 0], [0, 0.15]],
    }
    return JumpDiffusion(**(parts | changes))


def test_the_same_model_written_otherwise_is_accepted(file, data):
    found = load(file, rewritten())
    expected = load(file, zoo.van_der_pol()).run(GRID, data.measurements).mean
    np.testing.assert_allclose(found.run(GRID, data.measurements).mean, expected, rtol=1e-9)


def test_the_same_model_as_array_functions_is_accepted(tmp_path):
    symbolic = zoo.van_der_pol()
    save(
        synthesize(symbolic, Memory(1), Cubature(), TACTS, paths=500, seed=1),
        tmp_path / "filter.npz",
    )
    sensor = StochasticMap.from_functions(
        2, 2, lambda t, x, v: np.stack([x[0] ** 2 + v[0], x[1] + v[1]]), Noise(2),
        mean=lambda t, x: np.stack([x[0] ** 2, x[1]]),
        cov=lambda t, x: np.broadcast_to(
            np.eye(2).reshape(2, 2, *(1,) * (x.ndim - 1)), (2, 2, *x.shape[1:])
        ),
    )  # fmt: skip
    omega = 0.1 * np.pi
    numeric = JumpDiffusion.from_functions(
        lambda t, x: np.stack([x[1], -(omega**2) * x[0] + 2 * x[1] * (1 - x[0] ** 2)]),
        lambda t, x: np.stack([0 * x[0], x[0]])[:, None],
        sensor, [2, 0], np.diag([0.15, 0.15]),
    )  # fmt: skip
    found = load(tmp_path / "filter.npz", numeric)
    state = found.step(found.initial(), 0.0, [4.0, 0.0])
    assert np.isfinite(state.mean).all()


a, b, u, w = sympy.symbols("a b u w")


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"drift": [b, 2 * b - 2.000001 * b * a**2 - (sympy.pi / 10) ** 2 * a]}, "drift"),
        ({"diffusion": [[0, 0], [a, a / 1000]]}, "diffusion"),
        ({"sensor": [a**2 + u / 2, b + a / 10**6 + 2 * w]}, "sensor"),
        ({"noise": Noise((u, w), cov=[[4, 0.001], [0.001, 0.25]])}, "sensor"),
        ({"mean0": [2, 1e-6]}, "mean0"),
        ({"cov0": [[0.15, 0.001], [0.001, 0.15]]}, "cov0"),
        ({"intensity": sympy.Rational(1, 100), "jump": [0, a]}, "intensity"),
    ],
)
def test_another_model_is_refused_by_name(file, changes, what):
    with pytest.raises(ValueError, match=f"another model: its .*{what}"):
        load(file, rewritten(**changes))


def test_a_model_of_another_size_is_refused(file):
    with pytest.raises(ValueError, match="another model: it has 2 state components, not 1"):
        load(file, zoo.flip_process())
    with pytest.raises(ValueError, match="another model"):
        load(file, zoo.kicked_duffing())


def test_jumps_are_part_of_the_model(tmp_path):
    flip = zoo.flip_process()
    made = synthesize(flip, Memory(1), ExactGaussian(), TACTS, paths=500, seed=1, step=0.02)
    save(made, tmp_path / "flip.npz")
    assert load(tmp_path / "flip.npz", zoo.flip_process()).order == 1
    for other in (zoo.flip_process(flip=2.1), zoo.flip_process(rate=(0.3, 0.21))):
        with pytest.raises(ValueError, match=r"its (intensity|jump)"):
            load(tmp_path / "flip.npz", other)


# Damage


def test_files_cut_short_are_refused(file, oscillator):
    content = file.read_bytes()
    for length in (0, 1, 3, 40, len(content) // 2, len(content) - 30, len(content) - 1):
        file.write_bytes(content[:length])
        with pytest.raises(ValueError, match=r"not a designed filter|damaged or cut short"):
            load(file, oscillator)


def test_a_flipped_bit_is_refused_or_does_no_harm(file, oscillator, data):
    content = file.read_bytes()
    expected = load(file, oscillator).run(GRID, data.measurements).mean
    messages = []
    for position in np.random.default_rng(0).integers(0, len(content), 150):
        broken = bytearray(content)
        broken[position] ^= 1 << int(position % 8)
        file.write_bytes(bytes(broken))
        try:
            found = load(file, oscillator)
        except ValueError as error:
            messages.append(str(error))
        else:
            np.testing.assert_array_equal(found.run(GRID, data.measurements).mean, expected)
    assert len(messages) > 100
    assert all(text.startswith("filter.npz: ") for text in messages)


@pytest.mark.parametrize("names", [("fits/0/gain", "fits/1/gain"), ("probe_x", "probe_x")])
def test_arrays_that_changed_places_or_numbers_are_refused(file, oscillator, names):
    """Whole and well-formed members, so that only the sum over all of them tells."""
    with np.load(file) as archive:
        arrays = dict(archive)
    one, two = (arrays[name] for name in names)
    arrays |= {names[0]: two, names[1]: one * (1 + 1e-15)}
    with file.open("wb") as stream:
        np.savez(stream, **arrays)
    with pytest.raises(ValueError, match=r"filter\.npz: damaged or altered"):
        load(file, oscillator)


@pytest.mark.parametrize(
    ("part", "changes", "message"),
    [
        (
            "fits",
            {"gain": np.zeros((2, 3))},
            r"fits\[1\].gain: wanted shape \(2, 4\), got \(2, 3\)",
        ),
        ("fits", {"offset": np.full(2, np.nan)}, r"fits\[1\].offset: wanted finite numbers"),
        ("fits", {"cov": -np.eye(2)}, "fits: wanted positive semidefinite"),
        ("start", {"mean": [2.0, 0.0]}, "start.mean: wanted an array of float64, got list"),
        ("start", {"cov": np.eye(3)}, r"start.cov: wanted shape \(2, 2\)"),
        ("predicted", {"rms": np.zeros((1, 2))}, r"predicted.rms: wanted shape \(16, 2\)"),
        ("held_out", {"rms": np.zeros((1, 2))}, r"held_out.rms: wanted shape \(4, 2\)"),
    ],
)
def test_a_filter_is_not_made_of_parts_that_do_not_fit(oscillator, part, changes, message):
    made = design(oscillator)
    given = getattr(made, part)
    if part == "fits":
        given = (given[0], given[1]._replace(**changes), given[2])
    else:
        given = given._replace(**changes)
    with pytest.raises((TypeError, ValueError), match=message):
        dataclasses.replace(made, **{part: given})


def test_foreign_files_are_refused(tmp_path, oscillator):
    text, other, empty = (tmp_path / name for name in ("a.txt", "b.npz", "c.zip"))
    text.write_text("PKnot")
    np.savez(other, x=np.arange(3))
    with zipfile.ZipFile(empty, "w"):
        pass
    with pytest.raises(ValueError, match=r"a\.txt: damaged"):
        load(text, oscillator)
    for path in (other, empty):
        with pytest.raises(ValueError, match="not a designed filter"):
            load(path, oscillator)
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.npz", oscillator)


def test_pickles_are_refused(file, oscillator):
    np.savez(file, times=np.array([object()], dtype=object))
    with pytest.raises(ValueError, match="damaged or cut short"):
        load(file, oscillator)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "another"}, "not a seedslib designed filter (it says 'another')"),
        ({"version": 1}, "wanted version 3 of the format, got 1"),
        ({"version": 2}, "wanted version 3 of the format, got 2"),
        ({"version": 4}, "wanted version 3 of the format, got 4 of a newer seedslib"),
        ({"version": "new"}, "wanted version 3 of the format, got 'new'"),
        ({"filter": None}, "contradicts itself"),
        ({"sizes": None}, "contradicts itself"),
        ({"filter": "FiniteOrderFilter"}, "contradicts itself"),
    ],
)
def test_heads_of_other_files(file, oscillator, changes, message, header):
    header(file, None, **changes)
    with pytest.raises(ValueError, match=re.escape(message)):
        load(file, oscillator)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"class": "Memory"}, "contradicts itself"),
        ({"class": "os.system"}, "contradicts itself"),
        ({"linearization": {"class": "Magic"}}, "its linearization 'Magic' is not the library's"),
        ({"linearization": {"class": "Taylor", "power": 9}}, "contradicts itself"),
        ({"memory": None}, "contradicts itself"),
        ({"memory": {"class": "Memory", "estimates": -1}}, "contradicts itself"),
        ({"memory": {"class": "Memory", "estimates": 3}}, "contradicts itself"),
        ({"memory": {"class": "Affine"}}, "contradicts itself"),
        ({"predictor": {"class": "os.system"}}, "contradicts itself"),
        ({"predictor": {"class": "Continuous"}}, "contradicts itself"),
        ({"components": 1}, "contradicts itself"),
        ({"components": "two"}, "contradicts itself"),
        ({"between": "cubic"}, "contradicts itself"),
        ({"node_times": []}, "contradicts itself"),
    ],
)
def test_headers_that_do_not_fit(file, oscillator, changes, message, header):
    header(file, **changes)
    with pytest.raises(ValueError, match=message):
        load(file, oscillator)


@pytest.mark.parametrize(
    "changes",
    [
        {"times": None},
        {"times": np.array([0.0, 0.5, 0.5, 1.0])},
        {"fits/0/gain": np.zeros((2, 3))},
        {"fits/1/cov": np.full((2, 2), np.nan)},
        {"fits/1/cov": -np.eye(2)},
        {"start/mean": np.zeros(2, dtype=np.float32)},
        {"node_fits/1/2/offset": None},
        {"probe_x": None},
    ],
)
def test_arrays_that_do_not_fit(file, oscillator, changes, rewrite):
    rewrite(file, **changes)
    with pytest.raises(ValueError, match="contradicts itself"):
        load(file, oscillator)


def test_a_linearization_of_ones_own_is_given_again(tmp_path, oscillator):
    class Mine(Linearization):
        def moments(self, map, spread=True):
            return Taylor().moments(map, spread)

    made = synthesize(oscillator, Memory(1), Mine(), TACTS, paths=500, seed=1)
    save(made, tmp_path / "mine.npz")
    with pytest.raises(ValueError, match="'Mine' is not the library's"):
        load(tmp_path / "mine.npz", oscillator)
    assert load(tmp_path / "mine.npz", oscillator, linearization=Mine()).order == 2
    with pytest.raises(ValueError, match="another model: its moments of the sensor"):
        load(tmp_path / "mine.npz", oscillator, linearization=ExactGaussian())


def test_only_designed_filters_are_saved(tmp_path):
    with pytest.raises(TypeError, match="filter: wanted a FiniteOrderFilter, got dict"):
        save({}, tmp_path / "x.npz")
    made = design(zoo.van_der_pol())
    own = dataclasses.replace(made, predictor=object())
    with pytest.raises(TypeError, match="predictor: wanted a description or numbers, got object"):
        save(own, tmp_path / "x.npz")
    assert not list(tmp_path.iterdir())


# More damage, and files of tables


def table_file(folder):
    """A small table filter in a file, and the filter."""
    made = simulated_synthesis(
        zoo.flip_process(), Memory(1), [0.0, 0.25, 0.5], paths=300, seed=1, nodes=1,
        y=(-6, 6, 21), z=(-3, 3, 17),
    )  # fmt: skip
    save(made, folder / "table.npz")
    return folder / "table.npz", made


def test_a_table_runs_without_its_model(tmp_path):
    path, made = table_file(tmp_path)
    data = zoo.flip_process().simulate(made.times, 30, 2)
    found = load(path)
    assert np.array_equal(
        found.run(made.times, data.measurements).mean, made.run(made.times, data.measurements).mean
    )
    assert str(found) == str(made)
    assert found.order == made.order
    with pytest.raises(ValueError, match="filter: wanted one with its model"):
        save(found, tmp_path / "again.npz")


def test_a_table_is_read_without_what_models_want(tmp_path, command):
    path, _ = table_file(tmp_path)
    program = "import sys; from seedslib.designed import load; load('table.npz'); "
    told = command(path.parent, "-c", program + "print('sympy' in sys.modules)")
    assert told.stdout == "False\n"


def test_any_other_filter_wants_its_model(file):
    with pytest.raises(ValueError, match=r"filter\.npz: .* wanted the model too"):
        load(file)


@pytest.mark.parametrize("known", [True, False])
def test_damaged_tables_are_refused_or_do_no_harm(tmp_path, known):
    path, made = table_file(tmp_path)
    system = zoo.flip_process() if known else None
    y = zoo.flip_process().simulate(made.times, 30, 2).measurements
    expected = made.run(made.times, y).mean
    content, refused = path.read_bytes(), 0
    broken = [content[:length] for length in (0, 2, 50, len(content) // 3, len(content) - 1)]
    for position in np.random.default_rng(1).integers(0, len(content), 80):
        flipped = bytearray(content)
        flipped[position] ^= 0x10
        broken.append(bytes(flipped))
    for each in broken:
        path.write_bytes(each)
        try:
            found = load(path, system)
        except ValueError as error:
            refused += str(error).startswith("table.npz: ")
        else:
            assert np.array_equal(found.run(made.times, y).mean, expected)
    assert refused > 60


def test_a_picture_is_refused(tmp_path, oscillator):
    path = tmp_path / "plot.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(200))
    with pytest.raises(ValueError, match=r"plot\.png: not a designed filter \(not an npz file\)"):
        load(path, oscillator)


def test_other_parameters_another_sensor_another_size_are_refused(tmp_path):
    path, _ = table_file(tmp_path)
    x, v = sympy.symbols("x v")
    flip = zoo.flip_process()
    sensor = StochasticMap((x,), [x + v], Noise((v,)))
    for other, reason in (
        (zoo.flip_process(flip=1.99), "its jump"),
        (zoo.flip_process(rate=(0.2, 0.3)), "its intensity"),
        (zoo.van_der_pol(), "it has 1 state components, not 2"),
        (
            JumpDiffusion.from_functions(
                flip.drift, flip.diffusion, sensor, flip.mean0, flip.cov0,
                intensity=flip.intensity, jump=flip.jump,
            ),
            "its likelihood",
        ),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=rf"another model: {reason}"):
            load(path, other)


def test_an_archive_that_unpacks_to_more_than_its_size_is_not_unpacked(tmp_path, oscillator):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("header.npy", bytes(30_000_000))
    with pytest.raises(ValueError, match="30000000 bytes in a file of"):
        load(path, oscillator)


@pytest.mark.parametrize(
    "text", [b"[" * 100_000, b"[1]", b"null", b"\xff\xfe", b'{"format": "seedslib designed filter"']
)
def test_headers_that_are_none(file, oscillator, text, rewrite):
    rewrite(file, header=np.frombuffer(text, dtype=np.uint8))
    with pytest.raises(ValueError, match="no header of one"):
        load(file, oscillator)


def test_a_degree_beyond_reason_is_refused_at_once(tmp_path, oscillator, header):
    path = tmp_path / "filter.npz"
    save(design(oscillator, "polynomial"), path)
    with np.load(path) as archive:
        fits = json.loads(archive["header"].tobytes().decode())["filter"]["fits"]
    for fit in fits:
        fit["mean_degree"] = 10**6
    header(path, fits=fits)
    start = time.perf_counter()
    with pytest.raises(ValueError, match="contradicts itself"):
        load(path, oscillator)
    assert time.perf_counter() - start < 2.0


@pytest.mark.parametrize(
    "changes",
    [
        {"predicted/rms": np.ones((3, 2))},
        {"predicted/times": np.linspace(0.01, 1.4, 16)},
        {"node_times/0": np.array([0.1, 0.3, 0.2, 0.4])},
        {"node_times/1": np.array([0.1, 0.2, 0.3, 0.4])},
    ],
)
def test_times_that_do_not_fit(file, oscillator, changes, rewrite):
    rewrite(file, **changes)
    with pytest.raises(ValueError, match="contradicts itself"):
        load(file, oscillator)


def square_root_model(inside, factor=0.1):
    """Known start at 2; the model is also looked at below zero, where the root has no value."""
    x, v = sympy.symbols("x v")
    diffusion = [[factor * sympy.sqrt(inside(x))]]
    return JumpDiffusion((x,), [1 - x], diffusion, [x + v], Noise((v,)), [2], [[0]])


def test_a_model_without_a_value_somewhere_is_known_again(tmp_path):
    def plain(x):
        return x

    made = synthesize(square_root_model(plain), Memory(1), Taylor(), TACTS, paths=500, seed=1)
    save(made, tmp_path / "root.npz")
    assert load(tmp_path / "root.npz", square_root_model(plain)).order == 1
    with pytest.raises(ValueError, match="its diffusion differs"):
        load(tmp_path / "root.npz", square_root_model(plain, factor=0.11))
    with pytest.raises(ValueError, match="its diffusion has a value in only one of them"):
        load(tmp_path / "root.npz", square_root_model(abs))
