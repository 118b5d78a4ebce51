"""The scalar Riemann problem on the unit circle, and the causal Wiener filter.

Given G without zeros and g on the circle, find functions analytic inside and outside with
``Phi+ = G Phi- + g``. With the index kappa of G and the canonical functions
``X+ = exp(Gamma+)``, ``X- = t^-kappa exp(Gamma-)``, ``G = X+/X-``, the solution is
``Phi+- = X+- (Psi+- + P)``, where ``g / X+ = Psi+ - Psi-`` and P is a polynomial that is free up
to its degree. All projections are fast Fourier transforms, so for data analytic near the circle
the error falls geometrically with the number of nodes ``t_j = exp(2 pi i j / M)``.

Arrays have the nodes along their first axis.

May import: base.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from seedslib.base.checks import as_count, as_covariance, as_real

__all__ = ["RiemannSolution", "WienerGain", "circle", "solve_riemann", "wiener_gain", "winding"]

FEWEST, MOST = 8, 2**20  # nodes
ZERO = 1e-12  # |G| below this part of its largest value counts as a zero on the circle
PHASE = 0.9 * np.pi  # largest step of the phase between nodes that still gives a certain index
TAIL = 1e-10  # relative size of the last Fourier coefficients beyond which M is too small
SOLVABLE = 1e-9  # relative size of a coefficient that counts as zero in a condition
LOST = 1e-8  # relative error in the boundary condition of resolved data, left by rounding


@dataclass(frozen=True, eq=False)
class RiemannSolution:
    """Boundary values of a solution and what is known of its existence.

    Attributes
    ----------
    plus, minus : complex ndarray (M, ...)
        Phi+ and Phi- on the nodes; ``plus = G minus + g`` there in every case.
    index : int
        Winding number kappa of G.
    constants : int
        Number of free constants, the coefficients of P.
    conditions : complex ndarray (number, ...)
        Moments of ``g / X+`` that must vanish; empty for kappa >= 0.
    solvable : bool
        Whether they do, for every right side. If not, a `minus` has a pole at infinity.
    tail : float
        Relative size of the last Fourier coefficients that were used: the resolution.
    """

    plus: np.ndarray
    minus: np.ndarray
    index: int
    constants: int
    conditions: np.ndarray
    solvable: bool
    tail: float


@dataclass(frozen=True, eq=False)
class WienerGain:
    """Stationary filter of a stable system from one scalar spectral factorization.

    Attributes
    ----------
    gain : ndarray (n,)
        Gain of the stationary Kalman filter, the impulse response at lag 0.
    lag_gains : ndarray (N + 1, n)
        Gains of the fixed-lag smoothers up to lag N, of the filter first.
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


def circle(nodes: int) -> NDArray[np.complex128]:
    """Nodes ``exp(2 pi i j / M)`` of the unit circle, shape ``(M,)``."""
    return np.exp(2j * np.pi * np.arange(nodes) / nodes)


def winding(values: np.ndarray) -> int:
    """Index: turns of the phase of ``(M,)`` values around the closed circle.

    Raises
    ------
    ValueError
        A zero on the circle, or a phase step between nodes of 0.9 pi or more, where the
        number of turns is uncertain.
    """
    sizes = np.abs(values)
    if not sizes.min() > ZERO * sizes.max():
        raise ValueError(f"coefficient: wanted no zero on the circle, got {sizes.min():.3g}")
    steps = np.angle(np.roll(values, -1) / values)
    if np.abs(steps).max() >= PHASE:
        largest = f"{np.abs(steps).max():.3g} with {len(values)} nodes; take more nodes"
        raise ValueError(f"coefficient: wanted phase steps below 0.9 pi, got {largest}")
    return round(steps.sum() / (2 * np.pi))


def solve_riemann(
    coefficient: ArrayLike, right: ArrayLike, polynomial: object = None, at_infinity: str = "zero"
) -> RiemannSolution:
    """Solve ``Phi+ = G Phi- + g`` on the unit circle for any index of G.

    ===========  ==============================  ===================================
    index        Phi- zero at infinity           Phi- finite at infinity
    ===========  ==============================  ===================================
    kappa >= 0   kappa free constants            kappa + 1 free constants
    kappa < 0    -kappa conditions               -kappa - 1 conditions
    ===========  ==============================  ===================================

    Parameters
    ----------
    coefficient, right : array_like (M,) and (M, ...)
        G and g on the nodes of `circle`; several right sides at once along further axes.
    polynomial : array_like (constants,) or (constants, ...), optional
        Coefficients of P, the constant first; zero by default.
    at_infinity : {"zero", "finite"}
        What is asked of Phi- at infinity.

    Returns
    -------
    RiemannSolution
        Also where the conditions fail: see `RiemannSolution.solvable`.

    Raises
    ------
    ValueError
        Fewer than 8 nodes, a zero of G on the circle, an index that the nodes leave uncertain, a
        wrong number of constants, a G whose canonical functions range so far that digits are lost.

    Warns
    -----
    UserWarning
        The last Fourier coefficients exceed 1e-10 of the largest: too few nodes, or data that are
        not analytic near the circle.
    """
    g, free = np.asarray(coefficient, complex), np.asarray(right, complex)
    if g.ndim != 1 or g.size < FEWEST or not np.isfinite(g).all():
        raise ValueError(f"coefficient: wanted {FEWEST} finite numbers or more, got {g.shape}")
    if free.shape[:1] != g.shape or not free.size or not np.isfinite(free).all():
        raise ValueError(f"right: wanted {g.size} rows of finite numbers, got {free.shape}")
    if at_infinity not in ("zero", "finite"):
        raise ValueError(f"at_infinity: wanted 'zero' or 'finite', got {at_infinity!r}")
    index, t, finite = winding(g), circle(g.size), at_infinity == "finite"
    constants, missing = max(index + finite, 0), max(-index - finite, 0)
    p = np.asarray(np.zeros(constants) if polynomial is None else polynomial, complex)
    if p.shape[:1] != (constants,) or p.shape[1:] not in ((), free.shape[1:]):
        raise ValueError(f"polynomial: wanted {constants} free constants, got shape {p.shape}")
    p = np.tensordot(t[:, None] ** np.arange(constants), p, axes=1)
    p = p.reshape(p.shape + (1,) * (free.ndim - p.ndim))
    column = (slice(None),) + (None,) * (free.ndim - 1)

    shift = t[-index * np.arange(g.size) % g.size]  # t^-index, exactly
    # the continuous logarithm, not the principal one
    logarithm = _fourier(np.log(np.abs(g)) + 1j * np.unwrap(np.angle(shift * g)))
    gamma_plus, gamma_minus = _split(logarithm)
    with np.errstate(all="ignore"):  # an overflow is refused below
        x_plus, x_minus = np.exp(gamma_plus)[column], (shift * np.exp(gamma_minus))[column]
        moments = _fourier(free / x_plus)
        psi_plus, psi_minus = _split(moments)
        plus, minus = x_plus * (psi_plus + p), x_minus * (psi_minus + p)
        error = np.abs(plus - g[column] * minus - free).max(axis=0)
        tail = max(_tail(moments), _tail(logarithm, 1.0))
    size = np.maximum(np.abs(plus).max(axis=0), np.abs(free).max(axis=0))
    if tail > TAIL:
        few = f"the last Fourier coefficients are {tail:.2g} of the largest with {g.size} nodes"
        warnings.warn(f"riemann: {few}; take more nodes", stacklevel=2)
    elif not (error <= LOST * size).all():
        raise ValueError("coefficient: wanted canonical functions whose range leaves digits")
    conditions, largest = moments[g.size - missing :][::-1], np.abs(moments).max(axis=0)
    solvable = bool((np.abs(conditions) <= SOLVABLE * largest).all())
    return RiemannSolution(plus, minus, index, constants, conditions, solvable, tail)


def wiener_gain(
    transition: ArrayLike,
    sensor: ArrayLike,
    state_noise: ArrayLike,
    sensor_noise: ArrayLike,
    *,
    nodes: int | None = None,
) -> WienerGain:
    """Stationary filter of ``x_k = sum_d A_d x_{k-1-d} + w_k``, ``y_k = C x_k + v_k``, scalar y.

    With t for one delay, the causal Wiener filter H solves the Riemann problem
    ``H = -Phi- / S_y + S_xy / S_y`` of index 0. The factor ``S_y = S |phi|^2`` is the exponential
    of half the Fourier series of ``log S_y``; the gains of the filter and of its fixed-lag
    smoothers are Fourier coefficients of ``S_xy / (S conj(phi))``, whose nonnegative part is
    ``H phi``.

    Parameters
    ----------
    transition : array_like (n, n) or (N + 1, n, n)
        ``A_d`` for the delays d = 0..N; zero matrices at the end give gains of longer lags.
    sensor : array_like (n,) or (1, n)
    state_noise : array_like (n, n)
        Covariance of w; may be singular.
    sensor_noise : float
        Variance of v, positive.
    nodes : int, optional
        Nodes on the circle, by default doubled until the spectra are resolved.

    Raises
    ------
    ValueError
        An unstable system (it has no stationary spectrum; the formulas would answer, wrongly), or
        eigenvalues too near the circle for the nodes.
    """
    a = as_real("transition", transition)
    a = a[None] if a.ndim == 2 else a
    if a.ndim != 3 or 0 in a.shape or a.shape[1] != a.shape[2]:
        raise ValueError(f"transition: wanted (n, n) or (N + 1, n, n), got {a.shape}")
    size = a.shape[1]
    c = as_real("sensor", np.ravel(sensor), (size,))
    q = as_covariance("state_noise", state_noise, size)
    r = as_covariance("sensor_noise", sensor_noise, 1, definite=True).item()
    count = max(256, 2 ** int(np.ceil(np.log2(16 * len(a) * size))))
    count = count if nodes is None else as_count("nodes", nodes, 4 * len(a))
    while True:
        gain, last = _wiener(a, c, q, r, count), nodes is not None or count >= MOST // size
        if gain.tail <= (TAIL if last else 1e-14):
            return gain
        if last:
            near = "an eigenvalue of transition is too near the unit circle"
            raise ValueError(f"nodes: wanted the spectra resolved, got {count} nodes; {near}")
        count *= 2


def _wiener(a: np.ndarray, c: np.ndarray, q: np.ndarray, r: float, nodes: int):
    delays = np.zeros((nodes, *a.shape[1:]))
    delays[0], delays[1 : 1 + len(a)] = np.eye(a.shape[1]), -a
    symbol = _series(delays)
    determinant = np.linalg.det(symbol)
    sizes = np.abs(determinant)
    tail = _tail(_fourier(np.log(np.maximum(sizes, 1e-300))), 1.0)
    # each eigenvalue outside the circle is a zero inside, and turns the phase once
    if sizes.min() <= ZERO * sizes.max() or (tail <= TAIL and winding(determinant)):
        raise ValueError("transition: wanted eigenvalues inside the unit circle, got one outside")
    w = np.linalg.inv(symbol)
    cross = w @ q @ w.conj().swapaxes(1, 2) @ c
    cepstrum = _fourier(np.log((cross @ c).real + r))
    half, innovation = cepstrum.copy(), float(np.exp(cepstrum[0].real))
    half[0], half[(nodes + 1) // 2 :] = 0.0, 0.0
    phi = np.exp(_series(half))
    gains = _fourier(cross / (phi.conj() * innovation)[:, None])
    causal = _split(gains)[0] / phi[:, None]
    # Joseph's form of the error's spectrum: the difference of variances would lose a small one
    error = w - causal[:, :, None] * (c @ w)[:, None, :]
    cov = error @ q @ error.conj().swapaxes(1, 2) + r * causal[:, :, None] * causal.conj()[:, None]
    impulse, lag_gains = _fourier(causal)[: nodes // 2].real, gains[-np.arange(len(a))].real
    tail, cov = max(tail, _tail(cepstrum, 1.0), _tail(gains)), cov.real.mean(axis=0)
    return WienerGain(lag_gains[0], lag_gains, impulse, innovation, cov, nodes, tail)


def _fourier(values: np.ndarray) -> np.ndarray:
    return np.fft.fft(values, axis=0) / len(values)


def _series(coefficients: np.ndarray) -> np.ndarray:
    return np.fft.ifft(coefficients, axis=0) * len(coefficients)


def _split(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cauchy projections: ``h = h+ - h-``, the Nyquist mode counted as negative."""
    half = (len(coefficients) + 1) // 2
    plus, minus = coefficients.copy(), -coefficients
    plus[half:], minus[:half] = 0.0, 0.0
    return _series(plus), _series(minus)


def _tail(coefficients: np.ndarray, scale: float = 0.0) -> float:
    """Size of the highest frequencies (the last sixteenth), relative to the largest or `scale`."""
    nodes, sizes = len(coefficients), np.abs(coefficients)
    width, middle, largest = max(1, nodes // 32), nodes // 2, max(sizes.max(), scale)
    return float(sizes[middle - width : middle + width + 1].max() / largest) if largest else 0.0
