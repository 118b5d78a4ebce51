"""The likelihood of a volatility model on the S&P 500: nodes, cells, particles, and its maximum."""

import csv
import warnings

import numpy as np
import pytest
import sympy
from scipy.special import logsumexp

from oracles.programs import BENCHMARKS, load
from seedslib.base import Nodes, Parameter, assigned
from seedslib.filters import GridBayesFilter
from seedslib.models import DiscreteSystem, Noise, StochasticMap


@pytest.fixture(scope="module")
def routes():
    return load("spx_likelihood")


@pytest.fixture(scope="module")
def returns(routes):
    return routes.returns()


@pytest.fixture(scope="module")
def published(routes, returns):
    """Likelihood of the published values on a hundred cells, and what each step loses."""
    return routes.root_cells(returns, routes.PUBLISHED, 100)


def rows(name):
    with (BENCHMARKS / name).open(newline="") as file:
        return list(csv.DictReader(file))


def by_filter(y, values, count):
    """The library's filter; the return of the day before is bound at each step."""
    mu, kappa, theta, xi, rho, sigma0 = values.tolist()
    V = sympy.Symbol("V", positive=True)
    Z, W = sympy.symbols("Z W", real=True)
    before = Parameter("before", 0.0)
    moved = V + kappa * (theta - V) + xi * rho * (before - mu + V / 2)
    first = float(moved.subs({V: sigma0**2, before: 0.0}))
    system = DiscreteSystem(
        StochasticMap([V], [moved + xi * sympy.sqrt((1 - rho**2) * V) * Z], Noise([Z])),
        StochasticMap([V], [mu - V / 2 + sympy.sqrt(V) * W], Noise([W])),
        first, xi**2 * (1 - rho**2) * sigma0**2,
    )  # fmt: skip
    u = (np.arange(count) + 0.5) * np.arcsinh(30.0) / count
    r = 0.003 * np.sinh(u)
    nodes = Nodes(r**2, 2 * r * 0.003 * np.cosh(u) * (u[1] - u[0]))
    filter, total = GridBayesFilter(system, nodes), 0.0
    state = filter.initial()
    for k, shown in enumerate(y):
        with assigned({before: y[k - 1] if k else 0.0}), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what falls below zero is lost, as it should be
            state = filter.step(state, float(k), [shown])
        total += state.loglik
    return total


def test_the_filter_equals_cells_on_a_part_of_the_record(routes, returns):
    y, values = returns[:250], routes.PUBLISHED
    found = by_filter(y, values, 400)
    coarse, fine = (routes.root_cells(y, values, n)[0] for n in (400, 800))
    assert found == pytest.approx(fine + (fine - coarse) / 3, abs=2e-3)
    each = [routes.by_particles(y, values, 20_000, seed) for seed in range(8)]
    mean = logsumexp(each) - np.log(8)
    error = np.std(np.exp(each - mean), ddof=1) / np.sqrt(8)
    assert abs(found - mean) < 4 * error
    assert error < 0.1


def test_rows_of_the_table_are_computed_again(routes, returns, published):
    table = {(row["route"], row["size"]): row for row in rows("spx_likelihood.csv")}
    made = {"nodes": routes.by_nodes(returns, routes.PUBLISHED, 100), "cells": published}
    for name, (found, lost) in made.items():
        assert found == pytest.approx(float(table[name, "100"]["loglik"]), abs=2e-6)
        assert lost.max() == pytest.approx(float(table[name, "100"]["lost_most"]), abs=2e-6)
    # the fault that must show: what falls below the lowest cell put into it
    clipped = routes.log_cells(returns, routes.PUBLISHED, 200, clip=True)[0]
    assert clipped == pytest.approx(float(table["clipped", "200"]["loglik"]), abs=5e-6)
    assert clipped > float(table["cells of log V", "200"]["loglik"]) + 5.0


def test_the_committed_maximum_is_one(routes, returns, published):
    """The likelihood falls on both sides of it along a few directions."""
    found = {row["parameter"]: row for row in rows("spx_maximum.csv")}
    best, errors = (
        np.array([float(found[n][c]) for n in routes.NAMES]) for c in ("value", "error")
    )
    middle = routes.root_cells(returns, best, 100)[0]
    assert middle > published[0] + 0.1
    told = {row["parameter"]: row for row in rows("spx_sides.csv") if row["about"] == "best"}
    for k, name in ((5, "sigma0"), (1, "kappa")):
        move = errors * np.eye(6)[k]
        sides = [routes.root_cells(returns, best + sign * move, 100)[0] for sign in (-1, 1)]
        assert max(sides) < middle - 0.1
        lost = [float(told[name][side]) for side in ("below", "above")]
        assert [middle - side for side in sides] == pytest.approx(lost, abs=1e-5)
