"""Linear, quadratic, cubic and quartic forms: optimal estimates and exact errors by matrices.

Equations (3.1), (3.2), (3.8), (3.9) and theorem 2 of Choi, Song, Shin (2019), and the errors of
the cubic and quartic forms, which the paper leaves open. Matrices of quadratic forms are replaced
by their symmetric parts, which the printed cubic and quartic rows need. Means may carry batch
axes, last.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_shape
from seedslib.gaussian.arguments import gaussian_arguments
from seedslib.gaussian.errors.functions import MeanSquareErrors
from seedslib.gaussian.errors.joint import as_joint_law
from seedslib.gaussian.means.kernels import inner_product, times


def linear_mean(A: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
    """``E A x = A m``, shape (p, ...).

    Parameters
    ----------
    A : array_like (p, n)
        Any matrix.
    mean, cov : array_like (n, ...), (n, n) or (n, n, ...)
        Law of x.

    Raises
    ------
    TypeError, ValueError
        Bad matrix, mean or covariance.
    """
    mean, _ = gaussian_arguments(mean, cov)
    return np.tensordot(as_shape("A", A, (-1, len(mean))), mean, axes=1)


def quadratic_mean(A: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
    """``E x'Ax = tr AP + m'Am``, shape (...).

    Parameters
    ----------
    A : array_like (n, n)
        Its symmetric part counts.
    mean, cov : array_like (n, ...), (n, n) or (n, n, ...)
        Law of x.

    Raises
    ------
    TypeError, ValueError
        Bad matrix, mean or covariance.
    """
    mean, cov = gaussian_arguments(mean, cov)
    A = _symmetric("A", A, len(mean))
    return _trace(A, cov) + inner_product(mean, times(A, mean))


def cubic_mean(A: ArrayLike, B: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
    """``E Ax x'Bx = 2 APBm + Am (m'Bm + tr BP)``, shape (p, ...).

    Parameters
    ----------
    A : array_like (p, n)
        Any matrix.
    B : array_like (n, n)
        Its symmetric part counts.
    mean, cov : array_like (n, ...), (n, n) or (n, n, ...)
        Law of x.

    Raises
    ------
    TypeError, ValueError
        Bad matrix, mean or covariance.
    """
    mean, cov = gaussian_arguments(mean, cov)
    A, B = as_shape("A", A, (-1, len(mean))), _symmetric("B", B, len(mean))
    bm = times(B, mean)
    return times(A, 2 * times(cov, bm) + mean * (inner_product(mean, bm) + _trace(B, cov)))


def quartic_mean(A: ArrayLike, B: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
    """``E x'Ax x'Bx = 2 tr APBP + 4 m'APBm + (tr AP + m'Am)(tr BP + m'Bm)``, shape (...).

    Parameters
    ----------
    A, B : array_like (n, n)
        Their symmetric parts count.
    mean, cov : array_like (n, ...), (n, n) or (n, n, ...)
        Law of x.

    Raises
    ------
    TypeError, ValueError
        Bad matrix, mean or covariance.
    """
    mean, cov = gaussian_arguments(mean, cov)
    A, B = _symmetric("A", A, len(mean)), _symmetric("B", B, len(mean))
    am, bm = times(A, mean), times(B, mean)
    crossed = np.einsum("ij,jk...,kl,li...->...", A, cov, B, cov)
    ends = (_trace(A, cov) + inner_product(mean, am)) * (_trace(B, cov) + inner_product(mean, bm))
    return 2 * crossed + 4 * inner_product(am, times(cov, bm)) + ends


def quadratic_errors(
    A: ArrayLike, mean: ArrayLike, cov: ArrayLike, error_cov: ArrayLike
) -> MeanSquareErrors:
    """Exact errors of the estimates of ``x'Ax``, equations (3.8) and (3.9).

    The optimal error is evaluated as ``2 tr APAP + 4 tr APA(C - P) + 4 m'APAm``, a sum of
    nonnegative terms; the plug-in loses ``tr^2 AP`` more.

    Parameters
    ----------
    A : array_like (n, n)
        Its symmetric part counts.
    mean, cov, error_cov : array_like (n,), (n, n), (n, n)
        Mean and covariance C of the state, error covariance P <= C.

    Returns
    -------
    MeanSquareErrors
        Two numbers.

    Raises
    ------
    TypeError, ValueError
        Bad matrix, mean or covariances, ``error_cov exceeds cov``.
    """
    mean, cov, error_cov = as_joint_law(mean, cov, error_cov)
    A = _symmetric("A", A, mean.size)
    known, am = cov - error_cov, A @ mean
    inner = A @ error_cov @ A
    optimal = 2 * np.sum(inner * error_cov) + 4 * np.sum(inner * known) + 4 * am @ error_cov @ am
    return MeanSquareErrors(float(optimal), float(optimal + np.sum(A * error_cov) ** 2))


def cubic_errors(
    A: ArrayLike, B: ArrayLike, mean: ArrayLike, cov: ArrayLike, error_cov: ArrayLike
) -> MeanSquareErrors:
    """Exact error matrices of the estimates of ``Ax x'Bx``; beyond the paper.

    Parameters
    ----------
    A : array_like (p, n)
        Any matrix.
    B : array_like (n, n)
        Its symmetric part counts.
    mean, cov, error_cov : array_like (n,), (n, n), (n, n)
        Mean and covariance C of the state, error covariance P <= C.

    Returns
    -------
    MeanSquareErrors
        Two matrices (p, p).

    Raises
    ------
    TypeError, ValueError
        As `quadratic_errors`.
    """
    mean, cov, error_cov = as_joint_law(mean, cov, error_cov)
    A, B = as_shape("A", A, (-1, mean.size)), _symmetric("B", B, mean.size)
    alpha, beta = A @ mean, B @ mean
    second = cov + np.outer(mean, mean)
    first = A * (mean @ beta + np.sum(B * cov)) + 2 * A @ second @ B

    def one(X: np.ndarray) -> np.ndarray:
        return first @ X @ first.T

    def two(X: np.ndarray, Y: np.ndarray) -> np.ndarray:
        return (
            4 * (A @ X @ A.T * (beta @ Y @ beta) + np.outer(A @ X @ beta, A @ Y @ beta))
            + 4 * _both(np.outer(A @ X @ B @ Y @ beta, alpha))
            + 2 * np.outer(alpha, alpha) * _pair(B, X, B, Y)
        )

    def three(X: np.ndarray, Y: np.ndarray, Z: np.ndarray) -> np.ndarray:
        chain = A @ X @ B @ Y @ B @ Z @ A.T
        return 2 * A @ X @ A.T * _pair(B, Y, B, Z) + 4 * chain

    optimal = _differences((one, two, three), cov, error_cov)
    bias = 2 * A @ error_cov @ B + A * np.sum(B * error_cov)
    excess = bias @ (cov - error_cov + np.outer(mean, mean)) @ bias.T
    optimal = 0.5 * _both(optimal)
    return MeanSquareErrors(optimal, optimal + excess)


def quartic_errors(
    A: ArrayLike, B: ArrayLike, mean: ArrayLike, cov: ArrayLike, error_cov: ArrayLike
) -> MeanSquareErrors:
    """Exact errors of the estimates of ``x'Ax x'Bx``; beyond the paper.

    Parameters
    ----------
    A, B : array_like (n, n)
        Their symmetric parts count.
    mean, cov, error_cov : array_like (n,), (n, n), (n, n)
        Mean and covariance C of the state, error covariance P <= C.

    Returns
    -------
    MeanSquareErrors
        Two numbers.

    Raises
    ------
    TypeError, ValueError
        As `quadratic_errors`.
    """
    mean, cov, error_cov = as_joint_law(mean, cov, error_cov)
    A, B = _symmetric("A", A, mean.size), _symmetric("B", B, mean.size)
    alpha, beta = A @ mean, B @ mean
    level_a, level_b = mean @ alpha + np.sum(A * cov), mean @ beta + np.sum(B * cov)
    slope = 2 * (2 * A @ cov @ beta + alpha * level_b) + 2 * (2 * B @ cov @ alpha + beta * level_a)
    crossed = 4 * A @ (cov + np.outer(mean, mean)) @ B
    curvature = 2 * A * level_b + 2 * B * level_a + crossed + crossed.T

    def one(X: np.ndarray) -> float:
        return slope @ X @ slope

    def two(X: np.ndarray, Y: np.ndarray) -> float:
        return 0.5 * _pair(curvature, X, curvature, Y)

    def three(X: np.ndarray, Y: np.ndarray, Z: np.ndarray) -> float:
        straight = (
            _pair(A, X, A, Y) * (beta @ Z @ beta)
            + _pair(B, X, B, Y) * (alpha @ Z @ alpha)
            + 2 * _pair(A, X, B, Y) * (alpha @ Z @ beta)
        )
        chains = (
            beta @ X @ A @ Y @ A @ Z @ beta
            + alpha @ X @ B @ Y @ B @ Z @ alpha
            + 2 * alpha @ X @ A @ Y @ B @ Z @ beta
        )
        return 8 * (straight + 2 * chains)

    def four(X: np.ndarray, Y: np.ndarray, Z: np.ndarray, W: np.ndarray) -> float:
        pairs = _pair(A, X, A, Y) * _pair(B, Z, B, W) + _pair(A, X, B, Y) * _pair(A, Z, B, W)
        return 4 * (pairs + 4 * np.trace(A @ X @ A @ Y @ B @ Z @ B @ W))

    optimal = _differences((one, two, three, four), cov, error_cov)
    known = cov - error_cov
    twisted = A @ error_cov @ B
    traces = np.sum(A * error_cov), np.sum(B * error_cov)
    bias = 2 * (twisted + twisted.T) + traces[0] * B + traces[1] * A
    constant = 2 * _pair(A, error_cov, B, error_cov) + traces[0] * traces[1]
    level = constant + np.sum(bias * known) + mean @ bias @ mean
    spread = 2 * _pair(bias, known, bias, known) + 4 * mean @ bias @ known @ bias @ mean
    return MeanSquareErrors(float(optimal), float(optimal + level**2 + spread))


def _differences(
    forms: Sequence[Callable], cov: np.ndarray, error_cov: np.ndarray
) -> np.ndarray | float:
    """``sum_k form_k(C, ..., C) - form_k(C - P, ..., C - P)`` of k-linear forms, not subtracted.

    One of the arguments after another is exchanged; each exchange leaves a P in its place.
    """
    known = cov - error_cov
    return sum(
        sum(form(*[cov] * k, error_cov, *[known] * (order - 1 - k)) for k in range(order))
        for order, form in enumerate(forms, start=1)
    )


def _pair(A: np.ndarray, X: np.ndarray, B: np.ndarray, Y: np.ndarray) -> float:
    """``tr A X B Y``."""
    return np.sum((A @ X) * (B @ Y).T)


def _both(matrix: np.ndarray) -> np.ndarray:
    return matrix + matrix.T


def _trace(A: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """``tr A P`` for P (n, n) or (n, n, ...)."""
    return np.einsum("ij,ji...->...", A, cov)


def _symmetric(name: str, value: ArrayLike, size: int) -> np.ndarray:
    return 0.5 * _both(as_shape(name, value, (size, size)))
