"""From the moments of the restricted components to the moments of the whole vector."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from seedslib.gaussian.arguments import align
from seedslib.gaussian.regions.law import as_law, is_regular, scaled
from seedslib.gaussian.regions.regions import RegionMoments
from seedslib.gaussian.regions.twofold import binary_scale, determinant


def lift(
    moments: RegionMoments, mean: ArrayLike, cov: ArrayLike, about: ArrayLike | None = None
) -> RegionMoments:
    """Moments of a Gaussian vector of which only the leading one or two components are restricted.

    Kolessa's lemma 1 in conditional form: with ``K = Gamma11^-1 Gamma12``, the restricted block's
    mean ``mu1`` and covariance ``C1`` give ``mu2 = m2 + K'(mu1 - m1)``, ``C12 = C1 K`` and
    ``C22 = Gamma22 - Gamma12' K + K' C1 K``; the mass is that of the block. A singular `Gamma11`
    is legal: a direction without spread explains nothing (``K`` is the pseudo-inverse's).
    `Gamma11` counts as singular where its determinant is below 9e-16 of the product of its
    variances, the rounding of a rank-one matrix; a zero variance is singular exactly.

    Parameters
    ----------
    moments : RegionMoments
        Of the leading components: from `interval` (one component) or `polygon` (two).
    mean : array_like, shape (n, ...)
        Mean of the whole unrestricted vector; batch axes broadcast against those of `moments`.
    cov : array_like, shape (n, n, ...)
        Its covariance.
    about : array_like, shape (n, ...), optional
        Reference point of `RegionMoments.second`; the origin if left out.

    Returns
    -------
    RegionMoments
        With `mean` (n, ...) and `cov` (n, n, ...). For ``n`` equal to the number of leading
        components it repeats `moments`.

    Raises
    ------
    TypeError
        An argument is not made of real numbers.
    ValueError
        Shapes that do not fit, entries that are not finite, a covariance that is not symmetric
        (relative 1e-10) or has a negative variance or a negative determinant (relative 1e-10).
    """
    if moments.scalar:
        lead_mean, lead_cov = moments.mean[None], moments.cov[None, None]
    else:
        lead_mean, lead_cov = moments.mean, moments.cov
    lead = lead_mean.shape[0]
    if lead not in (1, 2):
        raise ValueError(f"moments: wanted one or two leading components, got {lead}")
    mean, cov = as_law(mean, cov, lead)
    size = mean.shape[0]
    try:
        batch = np.broadcast_shapes(moments.log_mass.shape, mean.shape[1:], cov.shape[2:])
    except ValueError as error:
        raise ValueError(
            "mean, cov: wanted batch axes that broadcast with those of the moments, got "
            f"{mean.shape[1:]}, {cov.shape[2:]} and {moments.log_mass.shape}"
        ) from error
    gain = _regression(cov, lead)
    lifted_mean = np.empty((size, *batch))
    lifted_cov = np.empty((size, size, *batch))
    lifted_mean[:lead] = align(lead_mean, 1, len(batch))
    lifted_cov[:lead, :lead] = align(lead_cov, 2, len(batch))
    shift = [lead_mean[i] - mean[i] for i in range(lead)]
    for j in range(lead, size):
        # component j regressed on the block: its cross-covariance, mean, and what is left over
        k = gain[j - lead]
        cross = [sum(lead_cov[i, a] * k[a] for a in range(lead)) for i in range(lead)]
        lifted_mean[j] = mean[j] + sum(k[i] * shift[i] for i in range(lead))
        for i in range(lead):
            lifted_cov[i, j] = lifted_cov[j, i] = cross[i]
        for l in range(lead, j + 1):
            residual = cov[l, j] - sum(cov[i, l] * k[i] for i in range(lead))
            spread = sum(gain[l - lead][i] * cross[i] for i in range(lead))
            lifted_cov[l, j] = lifted_cov[j, l] = residual + spread
    lifted = RegionMoments(np.broadcast_to(moments.log_mass, batch), lifted_mean, lifted_cov)
    return lifted if about is None else lifted.referred_to(about)


def _regression(cov: np.ndarray, lead: int) -> list[list[np.ndarray]]:
    """Coefficients of each following component on the leading ones, pseudo-inverse semantics."""
    columns = range(lead, cov.shape[0])
    if lead == 1:
        known = cov[0, 0] > 0.0
        pivot = np.where(known, cov[0, 0], 1.0)
        return [[np.where(known, cov[0, j] / pivot, 0.0)] for j in columns]
    s, t, a, b, c = scaled(cov)
    regular = is_regular(cov)
    det = np.where(regular, determinant(a, b, b, c), 1.0)
    # rank one: Gamma11 = trace * w w', so that its pseudo-inverse is Gamma11 / trace^2
    largest = np.maximum(cov[0, 0], cov[1, 1])
    unit = binary_scale(largest)
    flat = [[cov[i, j] / unit for j in range(2)] for i in range(2)]
    trace = np.where(largest > 0.0, flat[0][0] + flat[1][1], 1.0)
    gain = []
    for j in columns:
        u, v = cov[0, j] / s, cov[1, j] / t
        full = determinant(c, b, v, u) / det / s, determinant(a, b, u, v) / det / t
        thin = [
            (flat[i][0] * (cov[0, j] / unit) + flat[i][1] * (cov[1, j] / unit)) / trace / trace
            for i in range(2)
        ]
        gain.append([np.where(regular, full[i], thin[i]) for i in range(2)])
    return gain
