"""A file knows its model by what the model's functions do, in any units and however written."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base import Input
from seedslib.design import grid_synthesis, synthesize
from seedslib.designed import Memory, load, save
from seedslib.linearization import Cubature, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem

pytestmark = pytest.mark.filterwarnings("ignore:paths", "ignore:y. the axes miss")
a, b, v, w, z = sympy.symbols("a b v w z", real=True)
t = sympy.Symbol("t")
u = Input("u")

# Each builder takes relative changes of its numbers; components are in unlike units.


def jumping(
    drift=0,
    late=0,
    diffusion=0,
    rate=0,
    jump=0,
    spread=0,
    sensor=0,
    noise=0,
    cross=0,
    mean0=0,
    cov0=0,
):
    """Metres beside a coefficient of size 1e-9, and functions of time."""
    small = 1e-9
    return JumpDiffusion(
        (a, b),
        [-a / 100 + 50 * t, (1 + drift) * small * sympy.cos(t * (1 + late)) - b / 3],
        [[50, 0], [cross * small, (1 + diffusion) * small]],
        [a * (1 + sensor) + 20 * v, b + t * small * w * (1 + noise)],
        Noise((v, w)),
        [1000 * (1 + mean0), 2 * small],
        np.diag([1e4, 1e-18 * (1 + cov0)]),
        intensity=(1 + rate) * (1 + t) / 100,
        jump=[0, (1 + jump) * small * (z + a / 1000)],
        marks=Noise((z,), mean=0.5, cov=[[1 + spread]]),
        time=t,
        step=0.25,
    )


def discrete(dynamics=0, gain=0, sensor=0, noise=0, cross=0, unit=1, time=0):
    """Range in metres (or another unit), bearing in radians."""
    scale = sympy.nsimplify(unit)
    moved = [a + 30 * scale * (1 + dynamics) * v, b * (1 + gain) + 0.01 * (1 + t * time) * w]
    shown = [a + 100 * scale * v, b + sensor / 10**4 + (1 + noise) * w / 10**4 + cross * v / 10**4]
    return DiscreteSystem(
        StochasticMap((a, b), moved, Noise((v, w)), time=t),
        StochasticMap((a, b), shown, Noise((v, w)), time=t),
        [2e5 * unit, 0.5],
        np.diag([1e8 * unit**2, 1e-2]),
    )


def switching(exact=0, outlier=0, rare=0, told=0, moves=0, start=0, mean0=0, cov0=0, drives="old"):
    """A sensor that is exact in one mode and an outlier in the other; a rare switch."""
    leave, tell = 1e-6 * (1 + rare), (1 + told) / (4 + a**2 / 1e6)
    return SwitchingSystem(
        (a,),
        [[a + (1 + moves) * v / 10], [a / 2 + 3 * v]],
        Noise((v,)),
        [[1 - leave, leave], [0.5, 0.5]],
        [[a + (1 + exact) * w / 10**4], [a + 100 * (1 + outlier) * w]],
        Noise((w,)),
        [(0.5 * (1 + start), [1e3 * (1 + mean0)], [[1 + cov0]]), (0.5 * (1 - start), [1e3], [[1]])],
        indicator=[[tell, 1 - tell], [0.9, 0.1]],
        drives=drives,
    )


def design(build, **given):
    paths = 300 if build is switching else 200
    return synthesize(
        build(**given), Memory(1), Taylor(), [0.0, 1.0, 2.0], paths=paths, seed=1, nodes=0
    )


CHANGES = [
    *[
        (jumping, {name: size}, said)
        for name, size, said in (
            ("drift", 1e-4, "drift"),
            ("late", 1e-3, "drift"),
            ("diffusion", 1e-4, "diffusion"),
            ("rate", 1e-4, "intensity"),
            ("jump", 1e-4, "jump"),
            ("spread", 1e-4, "jump"),
            ("sensor", 1e-6, "sensor"),
            ("noise", 1e-4, "sensor"),
            ("cross", 1e-4, "diffusion"),
            ("mean0", 1e-6, "mean0"),
            ("cov0", 1e-4, "cov0"),
        )
    ],
    *[
        (discrete, {name: size}, said)
        for name, size, said in (
            ("dynamics", 1e-5, "dynamics"),
            ("gain", 1e-6, "dynamics"),
            ("sensor", 1e-3, "sensor"),
            ("noise", 1e-5, "sensor"),
            ("cross", 1e-4, "sensor"),
            ("time", 1e-4, "dynamics"),
        )
    ],
    *[
        (switching, {name: size}, said)
        for name, size, said in (
            ("exact", 1e-2, "readings"),
            ("outlier", 1e-4, "readings"),
            ("rare", 1e-3, "switching"),
            ("told", 1e-6, "readings"),
            ("moves", 1e-5, "switching"),
            ("start", 1e-6, "initial"),
            ("mean0", 1e-6, "initial"),
            ("cov0", 1e-6, "initial"),
            ("drives", "new", "drive"),
        )
    ],
]


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Path of a file for each builder, made when first asked for."""
    folder, made = tmp_path_factory.mktemp("files"), {}

    def path(build):
        if build not in made:
            made[build] = folder / f"{build.__name__}.npz"
            save(design(build), made[build])
        return made[build]

    return path


@pytest.mark.parametrize(("build", "change", "said"), CHANGES)
def test_model_with_one_number_changed_is_another_and_rounding_is_not(saved, build, change, said):
    """By what differs, each component in its own units; a part in 1e11 is the same model."""
    with pytest.raises(ValueError, match=f"another model: its .*{said}"):
        load(saved(build), build(**change))
    if "drives" not in change:
        rounded = dict.fromkeys(change, 1e-11)
        assert load(saved(build), build(**rounded)).memory == Memory(1)


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e6])
def test_verdict_does_not_depend_on_the_unit(tmp_path, unit):
    save(design(discrete, unit=unit), tmp_path / "f.npz")
    assert load(tmp_path / "f.npz", discrete(unit=unit)).order == 2
    for change in ({"noise": 1e-5}, {"dynamics": 1e-5}, {"unit": unit * (1 + 1e-6)}):
        with pytest.raises(ValueError, match="another model"):
            load(tmp_path / "f.npz", discrete(**{"unit": unit} | change))


def oscillator():
    """Van der Pol with other names and scaled noises, multiplied out."""
    omega = sympy.pi / 10
    return JumpDiffusion(
        (a, b),
        [b, 2 * b - 2 * b * a**2 - omega**2 * a],
        [[0, 0], [a * sympy.Rational(3, 5), -a * sympy.Rational(4, 5)]],
        [a**2 + v / 2, b + 2 * w],
        Noise((v, w), cov=[[4, 0], [0, 0.25]]),
        [2, 0],
        [[0.15, 0], [0, 0.15]],
    )


def test_same_model_written_otherwise_is_accepted(tmp_path):
    times = np.array([0.0, 0.5, 1.0])
    made = synthesize(zoo.van_der_pol(), Memory(1), Cubature(), times, paths=300, seed=1)
    save(made, tmp_path / "f.npz")
    found = load(tmp_path / "f.npz", oscillator())
    y = zoo.van_der_pol().simulate(times, 5, 2).measurements
    np.testing.assert_allclose(found.run(times, y).mean, made.run(times, y).mean, rtol=1e-9)
    for other, said in (
        (zoo.flip_process(), "2 state components, not 1"),
        (zoo.kicked_duffing(), "it"),
        (zoo.scalar_switching(), "2 state components, not 1"),
    ):
        with pytest.raises(ValueError, match=f"another model.*{said}"):
            load(tmp_path / "f.npz", other)


def test_tables_know_their_model_and_models_of_modes(tmp_path):
    path, axes = tmp_path / "t.npz", {"x": (-8, 8, 41), "z": (-6, 6, 9), "y": (-16, 18, 31)}
    flip = zoo.flip_process()
    save(grid_synthesis(flip, Memory(1), [0.0, 0.25, 0.5], **axes), path)
    assert load(path, zoo.flip_process()).order == 1
    for other, said in (
        (zoo.flip_process(flip=1.99), "jump"),
        (zoo.flip_process(rate=(0.2, 0.3)), "intensity"),
        (zoo.van_der_pol(), "1 state components, not 2"),
        (zoo.scalar_switching(), "only one of them"),
    ):
        with pytest.raises(ValueError, match=f"another model.*{said}"):
            load(path, other)
    save(grid_synthesis(zoo.scalar_switching(), Memory(1), [0, 1], **axes), path)
    with pytest.raises(ValueError, match="another model: its readings"):
        load(path, zoo.scalar_switching("A1L"))
    with pytest.raises(ValueError, match="only one of them"):
        load(path, flip)


def test_model_without_a_value_somewhere_is_known_again(tmp_path):
    """Known start at 2; looked at below zero too, where the root has no value."""

    def system(inside, factor=0.1):
        root = [[factor * sympy.sqrt(inside(a))]]
        return JumpDiffusion((a,), [1 - a], root, [a + v], Noise((v,)), [2], [[0]])

    made = synthesize(system(lambda x: x), Memory(1), Taylor(), [0, 0.5, 1], paths=300, seed=1)
    save(made, tmp_path / "f.npz")
    assert load(tmp_path / "f.npz", system(lambda x: x)).order == 1
    for other in (system(lambda x: x, factor=0.11), system(abs)):
        with pytest.raises(ValueError, match="diffusion"):
            load(tmp_path / "f.npz", other)
