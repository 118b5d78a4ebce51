"""The causal Wiener filter as a Riemann problem: the stationary Kalman filter without Riccati."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from seedslib.base.checks import as_count, as_covariance, as_real, as_shape
from seedslib.base.semidefinite import square_root
from seedslib.riemann.fourier import ZERO, UnresolvedError, fourier, series, tail, winding
from seedslib.riemann.problem import FEWEST, MOST, TAIL, solve_boundary_values


@dataclass(frozen=True, eq=False)
class WienerGain:
    """Stationary filter of a stable system from one scalar spectral factorization.

    Attributes
    ----------
    gain : ndarray (n,)
        Gain of the stationary Kalman filter, the impulse response at lag 0.
    lag_gains : ndarray (lags + 1, n)
        Gains of the fixed-lag smoothers, of the filter first.
    impulse : ndarray (M // 2, n)
        Causal Wiener filter: the estimate is ``sum_j impulse[j] y[k - j]``.
    innovation : float
        Variance of the innovation.
    cov : ndarray (n, n)
        Covariance of the filtered estimate's error.
    nodes : int
    tail : float
        Relative size of the last Fourier coefficients.
    """

    gain: np.ndarray
    lag_gains: np.ndarray
    impulse: np.ndarray
    innovation: float
    cov: np.ndarray
    nodes: int
    tail: float


def wiener_gain(
    transition: object,
    sensor: object,
    state_noise: object,
    sensor_noise: object,
    *,
    lags: int | None = None,
    nodes: int | None = None,
) -> WienerGain:
    """Stationary filter of ``x_k = sum_d A_d x_{k-1-d} + w_k``, ``y_k = C x_k + v_k``, scalar y.

    With t for one delay, the causal Wiener filter H solves the Riemann problem
    ``H = -Phi- / S_y + S_xy / S_y`` of index 0. The factor ``S_y = S |phi|^2`` is the exponential
    of half the Fourier series of ``log S_y``; the gains of the filter and of its
    fixed-lag smoothers are Fourier coefficients of ``S_xy / (S conj(phi))``.

    Parameters
    ----------
    transition : array_like (n, n) or (N + 1, n, n)
        ``A_d`` for the delays d = 0..N.
    sensor : array_like (n,) or (1, n)
    state_noise : array_like (n, n)
        Covariance of w; may be singular.
    sensor_noise : float
        Variance of v, positive.
    lags : int, optional
        Largest lag of the smoothing gains, by default N (what a delay filter needs).
    nodes : int, optional
        Nodes on the circle, by default doubled until the spectra are resolved.

    Raises
    ------
    TypeError, ValueError
        Wrong shapes or covariances, more than one measurement, an unstable system (it has no
        stationary spectrum; the formulas would answer, wrongly), eigenvalues too near the
        circle for the nodes.
    """
    a = as_real("transition", transition)
    a = a[None] if a.ndim == 2 else a
    if a.ndim != 3 or 0 in a.shape or a.shape[1] != a.shape[2]:
        raise ValueError(f"transition: wanted (n, n) or (N + 1, n, n), got {a.shape}")
    size = a.shape[1]
    c = as_real("sensor", sensor)
    if c.ndim == 2 and len(c) > 1:
        raise ValueError(f"sensor: wanted one measurement, got {len(c)}; use a Riccati equation")
    c = as_shape("sensor", c.reshape(-1) if c.ndim == 2 else c, (size,))
    factor = square_root(as_covariance("state_noise", state_noise, size))
    r = as_real("sensor_noise", sensor_noise)
    if r.size != 1:
        raise ValueError(f"sensor_noise: wanted one number, got shape {r.shape}")
    r = as_covariance("sensor_noise", r.reshape(1, 1), definite=True).item()
    lags = len(a) - 1 if lags is None else as_count("lags", lags, 0)
    least = max(FEWEST, 2 * (len(a) + lags))
    if least > MOST // size:
        raise ValueError(f"lags: wanted at most {MOST // size} nodes, got {least} for {lags} lags")
    if nodes is not None:
        count = most = as_count("nodes", nodes, least)
    else:
        count, most = max(256, 2 ** int(np.ceil(np.log2(4 * least * size)))), MOST // size
    while True:
        try:
            result = _wiener(a, c, factor, r, lags, count)
            if result.tail <= (TAIL if count >= most else 1e-14):
                return result
            reason = f"a tail of {result.tail:.2g}"
        except UnresolvedError:
            reason = "an uncertain phase"
        if count >= most:
            raise ValueError(
                f"nodes: wanted the spectra resolved, got {reason} with {count} nodes; "
                "an eigenvalue of transition is too near the unit circle"
            )
        count *= 2


def _wiener(
    a: np.ndarray, c: np.ndarray, factor: np.ndarray, r: float, lags: int, nodes: int
) -> WienerGain:
    delays = np.zeros((nodes, *a.shape[1:]))
    delays[0], delays[1 : 1 + len(a)] = np.eye(a.shape[1]), -a
    symbol = series(delays)
    determinant = np.linalg.det(symbol)
    sizes = np.abs(determinant)
    if sizes.min() <= ZERO * sizes.max():
        raise ValueError("transition: wanted a stable system, got an eigenvalue on the unit circle")
    unstable = winding(determinant)  # a zero inside the circle for each eigenvalue outside
    turns = tail(fourier(np.log(sizes)), 1.0)
    if unstable and turns > TAIL:
        raise UnresolvedError("transition: wanted a phase that the nodes resolve")
    if unstable:
        raise ValueError(
            "transition: wanted a stable system, got an unstable one (eigenvalues outside the "
            f"unit circle: {unstable})"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        response = np.linalg.solve(symbol, np.broadcast_to(factor, symbol.shape))
        seen = c @ response
        cross = (response @ seen.conj()[:, :, None])[..., 0]
        spectrum = (np.abs(seen) ** 2).sum(axis=1) + r
        size = float(max(spectrum.max(), np.abs(cross).max()))
    if not (np.isfinite(size) and spectrum.min() > ZERO * spectrum.max()):
        raise ValueError(
            "state_noise, sensor: wanted a spectrum of y in the range of numbers and within "
            f"twelve digits, got {spectrum.min():.3g} to {size:.3g}"
        )
    causal = solve_boundary_values(-1.0 / spectrum, cross / spectrum[:, None], None, "zero")

    cepstrum = fourier(np.log(spectrum))
    innovation = float(np.exp(cepstrum[0].real))
    inner = cepstrum.copy()
    inner[0], inner[(nodes + 1) // 2 :] = 0.0, 0.0
    phi = np.exp(series(inner))
    gains = fourier(cross / (phi.conj() * innovation)[:, None])
    # Joseph's form of the error's spectrum: the difference of variances would lose a small one
    filtered = causal.plus
    error = response - filtered[:, :, None] * seen[:, None, :]
    cov = np.einsum("kiq,kjq->ij", error, error.conj()).real
    cov += r * np.einsum("ki,kj->ij", filtered, filtered.conj()).real
    return WienerGain(
        gain=gains[0].real, lag_gains=gains[-np.arange(lags + 1)].real,
        impulse=fourier(causal.plus)[: nodes // 2].real, innovation=innovation,
        cov=cov / nodes, nodes=nodes, tail=max(turns, tail(cepstrum, 1.0), tail(gains)),
    )  # fmt: skip
