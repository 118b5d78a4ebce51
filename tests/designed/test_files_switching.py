"""Files of switching filters: the same bytes, the same numbers, and what is refused."""

import dataclasses
import warnings

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import grid_synthesis, synthesize
from seedslib.designed import Memory, SwitchingFilter, large_order, load, save
from seedslib.linearization import ExactGaussian, GaussHermite
from seedslib.models import Noise, SwitchingSystem

TIMES = np.arange(5.0)


@pytest.fixture(scope="module")
def target():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        memory = Memory(2, 1, 1, True)
        return synthesize(
            zoo.manoeuvring_target(), memory, ExactGaussian(), TIMES, paths=4000, seed=1
        )


@pytest.fixture(scope="module")
def tables():
    grids = {"x": (-8, 8, 81), "z": (-6, 6, 61), "y": (-16, 18, 69)}
    return grid_synthesis(zoo.scalar_switching(), large_order(1), TIMES, **grids)


def test_gaussian_filter_comes_back_to_the_bit(target, tmp_path):
    first, second = tmp_path / "a.npz", tmp_path / "b.npz"
    save(target, first)
    system = zoo.manoeuvring_target()
    back = load(first, system)
    save(back, second)
    assert first.read_bytes() == second.read_bytes()
    data = system.simulate(TIMES, 30, 2)
    a, b = (f.run(TIMES, data.measurements, indicators=data.indicators) for f in (target, back))
    for p, q in zip(a, b, strict=True):
        np.testing.assert_array_equal(p, q)
    assert back.design == target.design
    assert back.memory == target.memory


def test_tables_come_back_to_the_bit_with_and_without_their_model(tables, tmp_path):
    first, second = tmp_path / "a.npz", tmp_path / "b.npz"
    save(tables, first)
    system = zoo.scalar_switching()
    save(load(first, system), second)
    assert first.read_bytes() == second.read_bytes()
    data = system.simulate(TIMES, 30, 2)
    wanted, found = (f.run(TIMES, data.measurements) for f in (tables, load(first)))
    np.testing.assert_array_equal(wanted.mean, found.mean)
    np.testing.assert_array_equal(wanted.modes, found.modes)
    with pytest.raises(ValueError, match="loaded without"):
        save(load(first), second)


def rewritten():
    """The manoeuvring target in other symbols, with noises of other sizes."""
    p, s, a, b = sympy.symbols("p s a b", real=True)
    return SwitchingSystem(
        state=(p, s),
        dynamics=[
            [p + s + a, sympy.Rational(49, 50) * s + 2 * a],
            [p + s + 0.5 + 5 * a, 0.9 * s + 1 + 10 * a],
        ],
        noise=Noise((a,), cov=[[0.0025]]),
        switching=[[1 - 0.05, 0.05], [0.15, 1 - 0.15]],
        sensor=[[p + 2 * b], [p + 6 * b]],
        sensor_noise=Noise((b,), cov=[[0.25]]),
        initial=[(0.8, [0, 0], [[4, 0], [0, 1]]), (0.2, [0, 0], [[4, 0], [0, 1]])],
        indicator=[[0.9, 0.1], [0.2, 0.8]],
    )


def test_the_same_model_written_otherwise_is_accepted(target, tmp_path):
    save(target, tmp_path / "a.npz")
    back = load(tmp_path / "a.npz", rewritten())
    data = zoo.manoeuvring_target().simulate(TIMES, 30, 2)
    a, b = (f.run(TIMES, data.measurements, indicators=data.indicators) for f in (target, back))
    np.testing.assert_allclose(a.mean, b.mean, atol=1e-9)


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (lambda: zoo.manoeuvring_target("exact"), "another model: its readings differs"),
        (lambda: zoo.manoeuvring_target("none"), "it has 2 values of an indicator, not 0"),
        (lambda: zoo.scalar_switching(), "it has 2 state components, not 1"),
        (lambda: zoo.flip_process(), "another model, one that has modes"),
        (lambda: None, "wanted the model too"),
    ],
)
def test_other_models_are_refused(target, tmp_path, system, message):
    save(target, tmp_path / "a.npz")
    with pytest.raises(ValueError, match=message):
        load(tmp_path / "a.npz", system())


def test_a_changed_probability_is_another_model(tables, tmp_path):
    save(tables, tmp_path / "a.npz")
    with pytest.raises(ValueError, match="another model: its readings"):
        load(tmp_path / "a.npz", zoo.scalar_switching("A1L"))


def test_models_without_modes_and_their_files_do_not_mix(tmp_path):
    other = synthesize(
        zoo.flip_process(), large_order(1), ExactGaussian(), [0.0, 0.25], paths=300, seed=1
    )
    save(other, tmp_path / "a.npz")
    with pytest.raises(ValueError, match="another model, one without modes"):
        load(tmp_path / "a.npz", zoo.scalar_switching())


def test_damaged_files_are_refused(target, tmp_path):
    path = tmp_path / "a.npz"
    save(target, path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="damaged or cut short"):
        load(path, zoo.manoeuvring_target())
    broken = bytearray(whole)
    broken[len(whole) // 3] ^= 255
    path.write_bytes(bytes(broken))
    with pytest.raises(ValueError, match=r"damaged|contradicts"):
        load(path, zoo.manoeuvring_target())


@pytest.mark.parametrize("memory", [large_order(2), Memory(0, 1), Memory(1, 0, 1)])
def test_tables_of_another_memory_are_refused(tables, tmp_path, memory, header):
    """A header that tells of a memory with more, fewer or other numbers than the tables take."""
    path = tmp_path / "a.npz"
    save(tables, path)
    header(path, memory={"class": "Memory", **dataclasses.asdict(memory)})
    with pytest.raises(ValueError, match=r"contradicts itself \(.*other axes than the memory"):
        load(path)


def test_filters_without_a_design_have_no_file(tmp_path):
    with pytest.raises(TypeError, match="without a memory"):
        save(SwitchingFilter(zoo.manoeuvring_target(), GaussHermite(3)), tmp_path / "a.npz")
