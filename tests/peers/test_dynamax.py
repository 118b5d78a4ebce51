"""Filters and smoothers of dynamax, from the table that `benchmarks/peers_dynamax.py` wrote."""

import csv
from pathlib import Path

import numpy as np
import pytest

from peers.models import DYNAMAX, system
from seedslib.filters import (
    CovarianceFilter,
    KalmanFilter,
    cubature_kalman,
    extended_kalman,
    smooth,
    unscented_kalman,
)
from seedslib.linearization import GaussHermite

TABLE = Path(__file__).resolve().parents[2] / "benchmarks" / "peers_dynamax.csv"
FILTERS = {
    "kalman": (KalmanFilter, "lgssm_smoother"),
    "extended": (extended_kalman, "extended_kalman_smoother"),
    "unscented": (
        lambda made: unscented_kalman(made, alpha=0.8, beta=2.0, kappa=1.0),
        "unscented_kalman_smoother(.8, 2, 1)",
    ),
    "cubature": (cubature_kalman, "unscented_kalman_smoother(1, 0, 0), which is the cubature one"),
    "hermite": (
        lambda made: CovarianceFilter(made, GaussHermite(4)),
        "conditional_moments_gaussian_smoother with four Gauss-Hermite nodes",
    ),
}


@pytest.fixture(scope="module")
def told():
    """Arrays by model, method and quantity."""
    with TABLE.open(newline="") as file:
        rows = list(csv.DictReader(file))
    found = {}
    for row in rows:
        key = row["model"], row["method"], row["quantity"]
        found.setdefault(key, []).append([float(value) for value in row["values"].split()])
    return {key: np.array(values) for key, values in found.items()}


def pairs(told, name, method, solved):
    """Ours beside theirs: filter, smoother and the log-likelihood of the record."""
    model = DYNAMAX[name]
    filter, times = FILTERS[method][0](system(model)), np.arange(8.0)
    filtered, smoothed = filter.run(times, model.y), smooth(filter, times, model.y)
    theirs = {
        part: told[name, f"{method}, {solved}", part]
        for part in ("loglik", "filtered_means", "smoothed_means")
    }
    covs = [
        told[name, f"{method}, {solved}", f"{part}_covariances"].reshape(filtered.cov.shape)
        for part in ("filtered", "smoothed")
    ]
    return (
        (filtered.loglik.sum(), theirs["loglik"][0, 0]),
        (filtered.mean, theirs["filtered_means"]),
        (filtered.cov, covs[0]),
        (smoothed.mean, theirs["smoothed_means"]),
        (smoothed.cov, covs[1]),
    )


@pytest.mark.parametrize("name", [name for name in DYNAMAX if "bent" not in name])
def test_kalman_filter_and_smoother(name, told, held):
    held("dynamax", FILTERS["kalman"][1], *pairs(told, name, "kalman", "exact"))


@pytest.mark.parametrize("name", [name for name in DYNAMAX if "bent" in name])
@pytest.mark.parametrize("method", [name for name in FILTERS if name != "kalman"])
def test_nonlinear_filters_and_smoothers(name, method, told, held):
    held("dynamax", FILTERS[method][1], *pairs(told, name, method, "exact"))


@pytest.mark.parametrize(
    ("name", "method"), [("two states", "kalman"), ("two bent states", "extended")]
)
def test_what_it_adds_before_it_solves(name, method, told, held):
    reason = "adds 1e-9 to the diagonal of every matrix that it solves with"
    found = pairs(told, name, method, "installed")
    what = f"{FILTERS[method][1]}, as installed"
    held("dynamax", what, *found, bound=1e-7, reason=reason)
    assert max(np.abs(ours - theirs).max() for ours, theirs in found[1:]) > 1e-10
