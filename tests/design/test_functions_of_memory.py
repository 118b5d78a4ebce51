"""One remembered estimate of the Van der Pol oscillator: tables, networks, lines and particles."""

import numpy as np
import pytest
from sklearn.neural_network import MLPRegressor

from seedslib import zoo
from seedslib.design import Polynomial, simulated_synthesis, synthesize
from seedslib.designed import large_order
from seedslib.evaluation import compare
from seedslib.extra import learn
from seedslib.filters import ParticleFilter, assumed_density
from seedslib.linearization import ExactGaussian

TIMES = 0.5 * np.arange(5)


@pytest.fixture(scope="module")
def filters():
    system, one, rule = zoo.van_der_pol(), large_order(1), ExactGaussian()
    network = MLPRegressor(
        hidden_layer_sizes=(32, 32), early_stopping=True, n_iter_no_change=3,
        learning_rate_init=1e-2, max_iter=200, batch_size=1000,
    )  # fmt: skip
    design = {"paths": 8000, "seed": 1, "nodes": 0}
    return system, {
        "table": simulated_synthesis(
            system, one, TIMES, z=[(-4, 4, 21), (-6, 6, 21)], y=[(-3, 14, 15), (-8, 8, 13)],
            **design,
        ),
        "network": learn(system, one, TIMES, regressor=network, joint=True, sets=2, **design),
        "polynomial": synthesize(
            system, one, rule, TIMES, predictor=Polynomial(3, 4), **design
        ),
        "affine": synthesize(system, one, rule, TIMES, **design),
        "FNA": assumed_density(system, step=0.05),
    }  # fmt: skip


def test_table_polynomial_and_network_of_the_oscillator(filters):
    """Table before polynomial, both and the network before the assumed density, the line last."""
    system, made = filters
    found = compare(made, system, TIMES, 16_384, 2, components=1, bound=20)
    for better, worse in (
        ("table", "polynomial"), ("polynomial", "FNA"), ("network", "FNA"), ("FNA", "affine"),
    ):  # fmt: skip
        apart = found.difference(better, worse)
        assert apart.average[0] < -4 * apart.average_error[0], (better, worse)


def test_two_numbers_against_particles(filters):
    system, made = filters
    rivals = {str(count): ParticleFilter(system, count, step=0.05) for count in (20, 200)}
    rivals |= {name: made[name] for name in ("table", "network", "affine")}
    found = compare(rivals, system, TIMES, 1024, 3, components=1)
    for name in ("table", "network"):
        level, less = (found.difference(name, count) for count in ("200", "20"))
        assert abs(level.average[0]) < max(4 * level.average_error[0], 0.01)
        assert less.average[0] < -2 * less.average_error[0]
    lost = found.difference("affine", "200")
    assert lost.average[0] > 4 * lost.average_error[0]
