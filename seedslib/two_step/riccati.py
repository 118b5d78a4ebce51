"""Exact step of the Riccati equation as a composable map of covariances.

Over a step the error covariance of the Kalman-Bucy filter goes through

    P -> A P (I + G P)⁻¹ Aᵀ + Q,    A = Φ11⁻ᵀ, G = Φ11⁻¹ Φ12, Q = Φ21 Φ11⁻¹,

where Φ = exp(hM) is the exponential of the Hamiltonian matrix. G and Q are positive
semidefinite, two maps compose into a third of the same form, and so a long step is reached by
doubling a short one: no ill-conditioned exponential, no loss of symmetry.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from seedslib.base.semidefinite import symmetrized
from seedslib.models.propagation import balanced, halvings
from seedslib.two_step.linear import PlantMatrices


class RiccatiStep(NamedTuple):
    """The map ``P -> A P (I + G P)⁻¹ Aᵀ + Q``: transition A, information G, noise Q, all (n,n)."""

    transition: np.ndarray
    information: np.ndarray
    noise: np.ndarray

    def then(self, later: RiccatiStep) -> RiccatiStep:
        """Compose with the step that follows, `later`."""
        n = self.noise.shape[0]
        inner = np.linalg.solve(
            np.eye(n) + later.information @ self.noise,
            np.hstack([later.transition.T, later.information @ self.transition]),
        )
        move, info = inner[:, :n].T, inner[:, n:]
        return RiccatiStep(
            move @ self.transition,
            symmetrized(self.information + self.transition.T @ info),
            symmetrized(later.noise + move @ self.noise @ later.transition.T),
        )

    def closed_loop(self, cov: np.ndarray) -> np.ndarray:
        """Transition matrix of the estimation error, ``A (I + P G)⁻¹``, from covariance P."""
        eye = np.eye(cov.shape[0])
        return np.linalg.solve(eye + self.information @ cov, self.transition.T).T

    def apply(self, cov: np.ndarray) -> np.ndarray:
        """Covariance after the step."""
        return symmetrized(self.closed_loop(cov) @ cov @ self.transition.T + self.noise)


def hamiltonian(drift: np.ndarray, information: np.ndarray, diffusion: np.ndarray) -> np.ndarray:
    """Matrix ``[[-Fᵀ, HᵀR⁻¹H], [GQGᵀ, F]]``, shape (2n, 2n)."""
    return np.block([[-drift.T, information], [diffusion, drift]])


def riccati_step(
    drift: np.ndarray, information: np.ndarray, diffusion: np.ndarray, step: float
) -> RiccatiStep:
    """Exact Riccati map over a step of constant coefficients.

    Parameters
    ----------
    drift, information, diffusion : ndarray
        F, HᵀR⁻¹H and GQGᵀ, all (n, n).
    step : float
        Length of the step.
    """
    unit, *scaled = balanced(drift, information, diffusion)
    matrix = hamiltonian(*scaled)
    doublings = halvings(np.linalg.norm(matrix, 1) * step)
    n = drift.shape[0]
    power = expm(matrix * (step / 2**doublings))
    right = np.linalg.solve(power[:n, :n], np.hstack([np.eye(n), power[:n, n:]]))
    noise = np.linalg.solve(power[:n, :n].T, power[n:, :n].T).T
    result = RiccatiStep(right[:, :n].T, symmetrized(right[:, n:]), symmetrized(noise))
    for _ in range(doublings):
        result = result.then(result)
    column = unit[:, None]
    move, info, noise = result
    return RiccatiStep(move * (column / unit), info / column / unit, noise * column * unit)


def information_rate(known: PlantMatrices, seen: np.ndarray) -> np.ndarray:
    """Information rate HᵀR⁻¹H of the measured components, shape (n, n)."""
    sensor = known.sensor[seen]
    noise = known.sensor_intensity[np.ix_(seen, seen)]
    return symmetrized(sensor.T @ np.linalg.solve(noise, sensor))
