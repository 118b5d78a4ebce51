"""Modes that do not matter: never reached, never left, of no effect; and runs path by path."""

import numpy as np
import pytest
import scipy.linalg
import sympy
from numpy.testing import assert_allclose

from seedslib import zoo
from seedslib.base import Input
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.filters import smooth
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem

x, v, w = sympy.symbols("x v w", real=True)
TIMES = np.arange(5.0)
MOVES = [[0.9 * x + 0.4 + 0.3 * v], [0.5 * x - 0.7 + 0.8 * v], [1.2 * x + 2 * v]]
SEES = [[x + 0.5 * w], [1.3 * x + 0.7 * w], [x + w]]
LAWS = [(0.6, [0.3], [[1.2]]), (0.4, [-0.5], [[0.7]])]
SWITCH = [[0.85, 0.15], [0.3, 0.7]]
Y = np.random.default_rng(4).normal(size=(5, 1, 6))


def system(switch, laws, count=2, **more):
    noises = Noise((v,)), Noise((w,))
    return SwitchingSystem((x,), MOVES[:count], noises[0], switch, SEES[:count], noises[1], laws,
                           **more)  # fmt: skip


def wide(switch):
    """The same with a third mode that nothing leads to."""
    return [[*row, 0] for row in switch] + [[0.2, 0.8, 0]]


@pytest.mark.parametrize("drives", ["old", "new"])
def test_a_mode_that_nothing_leads_to(drives):
    two = system(SWITCH, LAWS, drives=drives)
    three = system(wide(SWITCH), [*LAWS, (0, [5.0], [[1.0]])], 3, drives=drives)
    for run in (lambda s: SwitchingFilter(s, Taylor()).run(TIMES, Y, covariances=True),
                lambda s: smooth(SwitchingFilter(s, Taylor()), TIMES, Y)):  # fmt: skip
        found, wanted = run(three), run(two)
        assert_allclose(found.mean, wanted.mean, rtol=1e-9, atol=1e-12)
        assert_allclose(found.cov, wanted.cov, rtol=1e-9, atol=1e-12)
        assert_allclose(found.mode_prob[:, :2], wanted.mode_prob, rtol=1e-9, atol=1e-12)
        assert (found.mode_prob[1:, 2] == 0).all()
        if wanted.loglik is not None:
            assert_allclose(found.loglik, wanted.loglik, rtol=1e-9, atol=1e-12)


def test_modes_that_never_switch_do_not_ask_which_of_them_drives():
    found = [
        smooth(SwitchingFilter(system(np.eye(2).tolist(), LAWS, drives=d), Taylor()), TIMES, Y)
        for d in ("old", "new")
    ]
    for name in ("mean", "cov", "mode_prob"):
        assert_allclose(*(getattr(each, name) for each in found), rtol=1e-9, atol=1e-12)


def test_smoothing_with_the_new_mode_is_that_of_pairs_of_modes():
    """(old, new) with the old one driving is new with the new driving: at the first step exactly.

    Of one step, the pairs before it have one law each.
    """
    start, chain = np.array([0.6, 0.4]), np.array(SWITCH)
    alike = [SEES[0]] * 2
    law = [(p, [0.3], [[1.2]]) for p in start]
    single = SwitchingSystem((x,), MOVES[:2], Noise((v,)), SWITCH, alike, Noise((w,)), law,
                             drives="new")  # fmt: skip
    ahead = [np.kron(np.eye(2)[j], chain[j]).tolist() for _ in (0, 1) for j in (0, 1)]
    pairs = SwitchingSystem(
        (x,), [MOVES[j] for _ in (0, 1) for j in (0, 1)], Noise((v,)), ahead, alike * 2,
        Noise((w,)), [(p, [0.3], [[1.2]]) for p in (start[:, None] * chain).ravel()],
    )  # fmt: skip
    one, two = (smooth(SwitchingFilter(s, Taylor()), TIMES[:2], Y[:2]) for s in (single, pairs))
    assert_allclose(one.mean, two.mean, rtol=1e-9, atol=1e-12)
    assert_allclose(one.cov, two.cov, rtol=1e-9, atol=1e-12)
    by_old = two.mode_prob.reshape(2, 2, 2, -1).sum(axis=2)
    assert_allclose(one.mode_prob[0], by_old[0], rtol=1e-9, atol=1e-12)


def test_modes_that_always_change_swap_what_drives():
    """The new mode is the other one, so that its moves are those of the other in the old timing."""
    swap = [[0, 1], [1, 0]]
    one = system(swap, LAWS, drives="new")
    other = SwitchingSystem((x,), MOVES[1::-1], Noise((v,)), swap, SEES[:2], Noise((w,)), LAWS)
    for run in (lambda s: SwitchingFilter(s, Taylor()).run(TIMES, Y, covariances=True),
                lambda s: smooth(SwitchingFilter(s, Taylor()), TIMES, Y)):  # fmt: skip
        found, wanted = run(one), run(other)
        for name in ("mean", "cov", "mode_prob"):
            assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-9, atol=1e-12)


def test_an_input_of_each_path():
    """A batch of records, each with its own course, is these records one by one."""
    u = Input("u")
    moves = StochasticMap([x], [0.8 * x + u + 0.3 * v], Noise((v,)))
    known = DiscreteSystem(moves, StochasticMap([x], [x + u / 5 + w], Noise((w,))), [0], [[1]])
    course = np.random.default_rng(2).normal(size=5)
    filter = synthesize(known, Memory(1), Taylor(), TIMES, inputs={u: course}, paths=300, seed=1)
    told = course[:, None] + 0.3 * np.arange(6)
    many = filter.run(TIMES, Y, inputs={u: told})
    grid = filter.run(TIMES, Y.reshape(5, 1, 2, 3), inputs={u: told.reshape(5, 2, 3)})
    assert_allclose(grid.mean.reshape(5, 1, 6), many.mean, rtol=1e-13)
    for path in range(6):
        alone = filter.run(TIMES, Y[..., path], inputs={u: told[:, path]})
        assert_allclose(many.mean[..., path], alone.mean, rtol=1e-9, atol=1e-12)
    with pytest.raises(ValueError, match="u"):
        filter.run(TIMES, Y, inputs={u: told[:, :5]})


def test_one_measurement_and_what_follows():
    """The time that is forecast for says how near two times are."""
    start = 1.6e9
    filter = synthesize(zoo.linear_gaussian(), Memory(1), Taylor(), [start], horizon=start + 2.0,
                        nodes=1, paths=300, seed=1)  # fmt: skip
    assert filter.horizon == start + 2.0
    assert filter.clock.tolerance == pytest.approx(2.0**-50 * (start + 2.0))
    near = synthesize(zoo.linear_gaussian(), Memory(1), Taylor(), [0.0], horizon=2.0, nodes=1,
                      paths=300, seed=1)  # fmt: skip
    assert near.clock.tolerance == pytest.approx(2e-9)


def test_node_forecasts_that_see_the_measurement():
    """Exact moments of (state, estimate, measurement): by the regression written out.

    One of two components is estimated, so that the measurement tells more than the estimate.
    """
    a, b = sympy.symbols("a b")
    drift = sympy.Matrix([b, -a - b / 2])
    system = JumpDiffusion(
        (a, b), list(drift), [[0], [0.7]], [a + b / 3 + w], Noise((w,), cov=[[0.2]]), [0.4, -0.3],
        [[1.0, 0.3], [0.3, 0.8]], step=0.05,
    )  # fmt: skip
    options = {"components": 1, "nodes": 1, "measured_nodes": True}
    exact = synthesize(system, Memory(1), ExactGaussian(), [0.0, 1.0], exact_moments=True,
                       **options)  # fmt: skip
    cov, look = np.array([[1.0, 0.3], [0.3, 0.8]]), np.array([1.0, 1 / 3])
    square = look @ cov @ look + 0.2
    gain = (cov @ look)[0] / square
    # estimate = const + gain y: of the two regressors one is left, and it is the measurement
    move = scipy.linalg.expm(0.5 * np.array([[0, 1], [-1, -0.5]]))
    slope = (move @ cov @ look)[0] / square
    (fit,) = exact.node_fits[0]
    assert fit.gain.shape == (1, 2)
    assert fit.gain @ [gain, 1.0] == pytest.approx([slope], rel=1e-9)
    drawn = synthesize(system, Memory(1), ExactGaussian(), [0.0, 1.0], paths=4000, seed=2,
                       **options)  # fmt: skip
    (other,) = drawn.node_fits[0]
    assert other.gain @ [gain, 1.0] == pytest.approx([slope], abs=0.04)
    assert fit.cov == pytest.approx(other.cov, rel=0.1)


def test_an_estimate_that_carries_nothing_is_told():
    blind = DiscreteSystem(
        StochasticMap([x], [0.8 * x + 0.3 * v], Noise((v,))),
        StochasticMap([x], [3 + 0 * w], Noise((w,))), [0.5], [[1]],
    )  # fmt: skip
    with pytest.warns(UserWarning, match="memory: the estimate of component 0 at time") as heard:
        synthesize(blind, Memory(1), Taylor(), TIMES[:2], paths=100, seed=1)
    assert len(heard) == 2
