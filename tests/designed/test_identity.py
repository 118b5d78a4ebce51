"""A model is known by its file in mixed units: metres beside radians, one mode beside another."""

import numpy as np
import pytest
import sympy

from seedslib.design import synthesize
from seedslib.designed import Memory, large_order, load, save
from seedslib.linearization import Cubature, ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem

r, b, c, v1, v2, w1, w2 = sympy.symbols("r b c v1 v2 w1 w2")


def bearing(variance, *, shift=0, cross=0, unit=1):
    """Range in metres (or another unit), bearing in radians."""
    root = sympy.sqrt(sympy.nsimplify(variance))
    return DiscreteSystem(
        StochasticMap((r, b), [r, b], Noise()),
        StochasticMap(
            (r, b), [r + 100 * unit * v1, b + shift + root * v2 + root * cross * v1],
            Noise((v1, v2)),
        ),
        [2e5 * unit, 0.5], np.diag([1e8 * unit**2, 1e-2]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("files") / "f.npz"
    made = synthesize(
        bearing(1e-8), large_order(1), Taylor(), [0, 1, 2], paths=500, seed=1, nodes=0
    )
    save(made, path)
    return path


@pytest.mark.parametrize("variance", [1e-4, 1.01e-8, 1.000001e-8, 0.99e-8, 1e-3])
def test_the_variance_of_a_bearing_beside_a_range(saved, variance):
    with pytest.raises(ValueError, match=r"another model: its .*sensor differs \(cov\)"):
        load(saved, bearing(variance))


def test_a_mean_and_a_correlation_beside_a_range(saved):
    with pytest.raises(ValueError, match=r"its .*sensor differs \(mean\) by up to 1e-07 of"):
        load(saved, bearing(1e-8, shift=1e-7))
    with pytest.raises(ValueError, match=r"its .*sensor differs \(cov\)"):
        load(saved, bearing(1e-8, cross=1e-4))


def test_the_same_model_written_otherwise(saved):
    noise = Noise((v1, v2), cov=np.diag([1e4, 1e-8]))
    plain = StochasticMap((r, b), [r + v1, b + v2], noise)
    turned = 0.1 * 3 - 0.3  # 5.6e-17, not zero
    numeric = StochasticMap.from_functions(
        2, 2, lambda t, x, v: np.stack([x[0] + v[0], x[1] + v[1] + turned * x[0] * 1e-5]), noise
    )
    still = StochasticMap((r, b), [r, b], Noise())
    # a linear sensor has the same moments by points as by derivatives
    for sensor, rule in ((plain, None), (numeric, Cubature())):
        system = DiscreteSystem(still, sensor, [2e5, 0.5], np.diag([1e8, 1e-2]))
        assert load(saved, system, linearization=rule).order == 2


def test_the_verdict_does_not_depend_on_the_unit(tmp_path):
    for unit in (1e-9, 1e-3, 1e6):
        made = synthesize(
            bearing(1e-8, unit=unit), large_order(1), Taylor(), [0, 1], paths=300, seed=1, nodes=0
        )
        save(made, tmp_path / "f.npz")
        assert load(tmp_path / "f.npz", bearing(1e-8, unit=unit)).order == 2
        for other in (bearing(1.00001e-8, unit=unit), bearing(1e-8, unit=unit * (1 + 1e-6))):
            with pytest.raises(ValueError, match="another model"):
                load(tmp_path / "f.npz", other)


def satellite(drag=1e-9, kick=1e-7, rate=1e-3):
    """Position in metres, a coefficient of size 1e-9, a clock error of nanoseconds."""
    return JumpDiffusion(
        (r, b, c), [-r / 100, drag - b, 0], [[50, 0], [0, kick], [0, 0]], [r + v1], Noise((v1,)),
        [7e6, 0, 0], np.diag([1e6, 1e-16, 1e-18]), intensity=sympy.sympify(rate),
        jump=[0, 0, 1e-9 * w1],
        marks=Noise((w1,)), step=0.1,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"drag": 1.0001e-9}, "drift"),
        ({"kick": 1.0001e-7}, "diffusion"),
        ({"rate": 1.0001e-3}, "intensity"),
    ],
)
def test_rates_of_small_components(tmp_path, changes, what):
    made = synthesize(satellite(), Memory(1), Taylor(), [0, 1.0], paths=300, seed=1, nodes=0)
    save(made, tmp_path / "f.npz")
    assert load(tmp_path / "f.npz", satellite()).order == 3
    with pytest.raises(ValueError, match=f"its {what} differs"):
        load(tmp_path / "f.npz", satellite(**changes))


def modes(variance=1e-8, other=1e4, rare=1e-6):
    """A sensor that is exact in one mode and an outlier in the other."""
    stays = [[1 - rare, rare], [0.5, 0.5]]
    return SwitchingSystem(
        (r,), [[r + v1]] * 2, Noise((v1,), cov=[[1e-2]]), stays,
        [[r + sympy.sqrt(variance) * w1], [r + sympy.sqrt(other) * w1]], Noise((w1,)),
        [(0.5, [1e3], [[1]])] * 2,
    )  # fmt: skip


@pytest.mark.filterwarnings("ignore:paths")
@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"variance": 1.01e-8}, r"readings differs \(cov\)"),
        ({"other": 1.0001e4}, r"readings differs \(cov\)"),
        ({"rare": 1.001e-6}, r"switching differs \((cov|mean|probability)\)"),
    ],
)
def test_modes_have_scales_of_their_own(tmp_path, changes, what):
    made = synthesize(modes(), Memory(1), Taylor(), [0, 1.0, 2.0], paths=500, seed=1)
    save(made, tmp_path / "f.npz")
    assert load(tmp_path / "f.npz", modes()).order == made.order
    with pytest.raises(ValueError, match=f"another model: its {what}"):
        load(tmp_path / "f.npz", modes(**changes))


@pytest.mark.parametrize("rule", [ExactGaussian(), Cubature()])
def test_rules_that_subtract_large_moments_know_their_model(tmp_path, rule):
    """E y^2 - (E y)^2 of a square far from zero: sixteen digits less eight."""

    def square(x):
        return JumpDiffusion((r,), [-r], [[1]], [x + v1], Noise((v1,)), [1e4], [[1]], step=0.1)

    made = synthesize(square(r**2), Memory(1), rule, [0, 0.5], paths=300, seed=1, nodes=0)
    save(made, tmp_path / "f.npz")
    other = (r - 1) ** 2 + 2 * r - 1
    assert load(tmp_path / "f.npz", square(other)).order == 1


@pytest.mark.parametrize(
    "points", [np.empty((3, 0)), np.ones((3, 1)), np.full((3, 12), np.nan), np.ones((2, 12))]
)
def test_a_file_that_looks_nowhere_is_refused(saved, tmp_path, points, rewrite):
    path = tmp_path / "f.npz"
    path.write_bytes(saved.read_bytes())
    with np.load(path) as archive:
        names = [name for name in archive.files if name.startswith("probe_values/")]
        kept = {name: archive[name][: points.shape[1]] for name in names}
    kept |= {name: kept[name] for name in ("probe_values/mean0", "probe_values/cov0")}
    rewrite(path, probe_x=points, **kept)
    with pytest.raises(ValueError, match=r"contradicts itself \(probe_x of shape"):
        load(path, bearing(1e-4))
