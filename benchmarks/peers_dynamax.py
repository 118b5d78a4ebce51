"""Filters and smoothers of dynamax on the random models of ``tests/peers/models.py``.

Run by hand, ``python benchmarks/peers_dynamax.py``, where dynamax is installed (with jax it takes
some 430 MB, so it is not among the packages of ``make test``); the library need not be. Writes
``benchmarks/peers_dynamax.csv`` beside itself, which ``tests/peers/test_dynamax.py`` computes
again with ours.

dynamax adds 1e-9 to the diagonal of every matrix that it solves with. The cases that are called
"installed" have it so, the others without.
"""

from __future__ import annotations

import csv
import sys
from importlib.metadata import version
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from dynamax import generalized_gaussian_ssm as general
from dynamax import linear_gaussian_ssm as plain
from dynamax import nonlinear_gaussian_ssm as bends
from dynamax.utils.utils import psd_solve

from peers.models import DYNAMAX, Linear

PARTS = ("filtered_means", "filtered_covariances", "smoothed_means", "smoothed_covariances")


def kalman(model):
    params = plain.inference.make_lgssm_params(
        *(jnp.array(part) for part in (model.mean, model.cov, model.F, model.Q, model.H, model.R))
    )
    return plain.lgssm_smoother(params, jnp.array(model.y))


def nonlinear(model):
    return bends.ParamsNLGSSM(
        jnp.array(model.mean),
        jnp.array(model.cov),
        lambda x: model.move(x, jnp.sin),
        jnp.array(model.Q),
        lambda x: model.see(x, jnp.sin),
        jnp.array(model.R),
    )


def extended(model):
    return bends.extended_kalman_smoother(nonlinear(model), jnp.array(model.y))


def unscented(model, alpha=0.8, beta=2.0, kappa=1.0):
    values = bends.UKFHyperParams(alpha, beta, kappa)
    return bends.unscented_kalman_smoother(nonlinear(model), jnp.array(model.y), values)


def cubature(model):
    return unscented(model, 1.0, 0.0, 0.0)


def hermite(model):
    params = general.ParamsGGSSM(
        jnp.array(model.mean),
        jnp.array(model.cov),
        lambda x: model.move(x, jnp.sin),
        jnp.array(model.Q),
        lambda x: model.see(x, jnp.sin),
        lambda x: jnp.array(model.R),
    )
    rule = general.GHKFIntegrals(4)
    return general.conditional_moments_gaussian_smoother(params, rule, jnp.array(model.y))


def rows(name, method, found):
    loglik = float(found.marginal_loglik)
    yield name, method, "loglik", 0, repr(loglik)
    for part in PARTS:
        for k, row in enumerate(np.asarray(getattr(found, part))):
            yield name, method, part, k, " ".join(repr(float(v)) for v in row.reshape(-1))


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    table = []
    for solved in ("installed", "exact"):
        if solved == "exact":
            psd_solve.__defaults__ = (0.0,)
            jax.clear_caches()
        for name, model in DYNAMAX.items():
            if isinstance(model, Linear):
                methods = [kalman]
            else:
                methods = [extended, unscented, cubature, hermite]
            if solved == "installed" and name not in ("two states", "two bent states"):
                continue
            for method in methods[: 1 if solved == "installed" else None]:
                label = f"{method.__name__}, {solved}"
                table.extend(rows(name, label, method(model)))
    made = f"dynamax {version('dynamax')}, jax {version('jax')}, numpy {version('numpy')}"
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["model", "method", "quantity", "record", "values", "made_by"])
        writer.writerows([*row, made if k == 0 else ""] for k, row in enumerate(table))


if __name__ == "__main__":
    main()
