"""Properties that filters have: records alone and together, parts of a record, clocks, names of
modes."""

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from oracles.drawn import EIGHTHS, vectors
from seedslib import zoo
from seedslib.designed import SwitchingFilter
from seedslib.filters import GridBayesFilter, cubature_kalman, extended_kalman, unscented_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem

X, V, W = sp.symbols("x v w", real=True)
WALK = DiscreteSystem(
    StochasticMap((X,), [0.9 * X + sp.sin(X) / 4 + V], Noise((V,), cov=[[0.25]])),
    StochasticMap((X,), [X + X**2 / 16 + W], Noise((W,))),
    [0.5],
    [[1.0]],
)
STAY = np.array([[0.9, 0.1], [0.25, 0.75]])


def modes(order=(0, 1), moves=(0.9 * X, 0.5 * X + 1), starts=(0.0, 1.0)):
    """Two ways of moving, in this order."""
    order = list(order)
    return SwitchingSystem(
        (X,),
        [[moves[i] + V] for i in order],
        Noise((V,), cov=[[0.25]]),
        STAY[np.ix_(order, order)],
        [[X + W]] * 2,
        Noise((W,)),
        [((0.75, 0.25)[i], [starts[i]], [[1.0]]) for i in order],
    )


FILTERS = {
    "extended": lambda: extended_kalman(WALK),
    "unscented": lambda: unscented_kalman(WALK),
    "cubature": lambda: cubature_kalman(WALK),
    "grid": lambda: GridBayesFilter(WALK, [(-6.0, 6.0, 97)]),
    "modes": lambda: SwitchingFilter(modes(), Taylor()),
    "continuous": lambda: extended_kalman(zoo.linear_gaussian()),
}
MADE = {}
RECORDS = vectors((5, 1, 3), st.one_of(EIGHTHS, st.just(float("nan"))))


def known(name):
    if name not in MADE:
        MADE[name] = FILTERS[name]()
    return MADE[name]


def run(filter, times, y):
    options = {"covariances": True} if "covariances" in filter.takes else {}
    found = filter.run(times, y, **options)
    if y.ndim == 3 and found.cov.ndim == 3:  # of a linear system without gaps: one for all records
        cov = np.repeat(found.cov[..., None], y.shape[2], axis=-1)
        found = found._replace(cov=cov)
    return found


def parts(found):
    return [
        part for part in (found.mean, found.cov, found.mode_prob, found.loglik) if part is not None
    ]


def close(one, other, rtol=1e-10):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol)


@pytest.mark.parametrize("name", FILTERS)
@given(y=RECORDS)
def test_a_record_alone_is_as_one_of_many(name, y):
    filter, times = known(name), np.arange(5.0)
    whole = parts(run(filter, times, y))
    for i in range(y.shape[2]):
        alone = parts(run(filter, times, y[..., i]))
        close(alone, [part[..., i] for part in whole])


@pytest.mark.parametrize("name", FILTERS)
@given(y=RECORDS, start=st.sampled_from([0.0, -7.0, 1e6]))
def test_step_by_step_is_the_whole_run_whatever_the_clock_shows(name, y, start):
    """A record may be broken off anywhere: the state is all that the filter knows."""
    filter, times = known(name), np.arange(5.0)
    whole = run(filter, times, y[..., 0])
    state = filter.initial()
    for k, t in enumerate(times):
        state = filter.step(state, start + t, y[k, :, 0])
        told = filter.report(state)
        close([told.mean, told.cov], [whole.mean[k], whole.cov[k]], rtol=1e-8)


@given(RECORDS)
def test_names_of_modes_do_not_matter(y):
    times = np.arange(5.0)
    for rule in (Taylor(), ExactGaussian()):
        one, other = (
            run(SwitchingFilter(modes(order), rule), times, y) for order in ((0, 1), (1, 0))
        )
        close([one.mean, one.cov, one.loglik], [other.mean, other.cov, other.loglik])
        np.testing.assert_allclose(one.mode_prob, other.mode_prob[:, ::-1], rtol=1e-10)


@given(RECORDS)
def test_equal_modes_are_one(y):
    """Two modes that do the same are a filter without modes."""
    same = SwitchingFilter(modes(moves=2 * (0.9 * X,), starts=(0.5, 0.5)), Taylor())
    alone = DiscreteSystem(
        StochasticMap((X,), [0.9 * X + V], Noise((V,), cov=[[0.25]])),
        StochasticMap((X,), [X + W], Noise((W,))),
        [0.5],
        [[1.0]],
    )
    twice, once = (run(filter, np.arange(5.0), y) for filter in (same, extended_kalman(alone)))
    close([twice.mean, twice.cov, twice.loglik], [once.mean, once.cov, once.loglik])
    # what the modes are is known from their chain alone
    prob = np.array([0.75, 0.25])
    for found in twice.mode_prob:
        np.testing.assert_allclose(found, prob[:, None].repeat(3, axis=1), rtol=1e-10)
        prob = prob @ STAY
