"""Moments of a Gaussian law in the plane over polygons and unbounded polygonal regions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_positive, as_real
from seedslib.gaussian.arguments import align, blockwise
from seedslib.gaussian.regions.edges import edge_moments
from seedslib.gaussian.regions.geometry import outline
from seedslib.gaussian.regions.law import Cases, as_law, is_regular
from seedslib.gaussian.regions.line import singular_moments
from seedslib.gaussian.regions.regions import RegionMoments
from seedslib.gaussian.regions.slabs import slab_moments

_BLOCK = 8192


def polygon(
    mean: ArrayLike,
    cov: ArrayLike,
    vertices: ArrayLike,
    about: ArrayLike | None = None,
    *,
    rays: ArrayLike | None = None,
    tolerance: float = 1e-12,
) -> RegionMoments:
    """Mass, mean and covariance of a Gaussian law in the plane over simple polygons.

    Polygons may be non-convex, slender, huge, far in the tails; the law may be nearly or exactly
    singular. Two routes: the closed form over the edges (Kolessa, lemma 3, written without its
    special cases, with Owen's T for the mass) wherever the bound of its rounding errors stays
    below `tolerance`, and adaptive quadrature over slabs elsewhere, some ten times slower.

    Accuracy (against 50-digit references): ``ln P`` to 1e-13 ``max(1, |ln P|)``, the mean to
    1e-12 standard deviations of the conditioned law or to the last bits of its own
    representation, the covariance to 1e-12 of the product of the standard deviations. This
    includes correlations ``1 - 1e-14``, strips 1e-10 wide, polygons of size 1e9 and
    ``ln P = -1e8``. With a law so nearly singular that ``det(cov)`` is below 9e-16 of the product
    of the variances, which is what rounding makes of rank one, the law is taken to live on a line
    (or at a point); polygons are then half-open, so that a boundary point belongs to exactly one
    cell of a partition.

    Parameters
    ----------
    mean : array_like, shape (2, ...)
        Mean of the law. Batch axes come last and are broadcast among all arguments.
    cov : array_like, shape (2, 2, ...)
        Covariance, positive semidefinite.
    vertices : array_like, shape (V, 2, ...)
        Vertices in order, repeated consecutive ones are padding (see `pad_regions`). A bounded
        polygon may be given in either orientation.
    about : array_like, shape (2, ...), optional
        Reference point of `RegionMoments.second`; the origin if left out.
    rays : array_like, shape (2, 2, ...), optional
        Makes the region unbounded: ``rays[0]`` is the direction from the first vertex to
        infinity, ``rays[1]`` that from the last vertex. The boundary comes in along the first ray,
        runs through the vertices and goes out along the second one; the region lies on its
        *left*. A half-plane is one vertex with opposite rays, a wedge one vertex with two rays.
        Two zero rays mean a bounded polygon in the batch.
    tolerance : float
        Largest bound at which the closed form is accepted; 0 forces quadrature.

    Returns
    -------
    RegionMoments
        With `log_mass` (...), `mean` (2, ...), `cov` (2, 2, ...). Where a singular law misses the
        region, or ``ln P`` is below -1e15, `log_mass` is ``-inf`` and the conditioned moments are
        NaN.

    Raises
    ------
    TypeError
        An argument is not made of real numbers.
    ValueError
        Shapes that do not fit; NaN or infinities; a covariance that is not symmetric (relative
        1e-10) or not positive semidefinite (determinant below -1e-10 of the product of the
        variances); polygons that are degenerate (fewer than three distinct vertices, no area,
        an edge that turns back on itself), whose boundary touches or crosses itself, or whose
        vertices are beyond 1e18 standard deviations (use `rays`) where that matters.

    Examples
    --------
    The quadrant ``x > 1, y > 1`` of the standard law:

    >>> import numpy as np
    >>> quadrant = polygon([0, 0], np.eye(2), [[1, 1]], rays=[[0, 1], [1, 0]])
    >>> print(f"{quadrant.mass:.6f} {quadrant.mean[0]:.6f}")
    0.025171 1.525135
    """
    mean, cov = as_law(mean, cov, 2, 2)
    vertices = as_real("vertices", vertices)
    if vertices.ndim < 2 or vertices.shape[1] != 2 or vertices.shape[0] < 1:
        raise ValueError(f"vertices: wanted shape (V, 2, ...), got {vertices.shape}")
    shapes = [mean.shape[1:], cov.shape[2:], vertices.shape[2:]]
    if rays is not None:
        rays = as_real("rays", rays)
        if rays.shape[:2] != (2, 2):
            raise ValueError(f"rays: wanted shape (2, 2, ...), got {rays.shape}")
        shapes.append(rays.shape[2:])
    try:
        batch = np.broadcast_shapes(*shapes)
        region_batch = np.broadcast_shapes(*shapes[2:])
    except ValueError as error:
        raise ValueError(
            "mean, cov, vertices, rays: wanted batch axes that broadcast, got "
            + ", ".join(map(str, shapes))
        ) from error
    tolerance = as_positive("tolerance", tolerance, zero=True, infinite=True)
    shape = outline(_spread(vertices, 2, region_batch), _spread(rays, 2, region_batch))
    items = (mean, 1), (cov, 2), (shape.x, 1), (shape.y, 1), (shape.rays, 2), (shape.convex, 0)
    full = (_spread(item, axes, batch) for item, axes in items)
    cases = Cases(
        *(f if f is None else f.reshape(*f.shape[: f.ndim - len(batch)], -1) for f in full)
    )
    found = blockwise(
        lambda block: _moments(cases.take(block), tolerance), cases.convex.size, _BLOCK
    )
    moments = RegionMoments(*(part.reshape((*part.shape[:-1], *batch)) for part in found))
    return moments if about is None else moments.referred_to(about)


def pad_regions(regions: Sequence[ArrayLike]) -> np.ndarray:
    """Vertices of several polygons in one array, the shorter ones padded by their last vertex.

    Parameters
    ----------
    regions : sequence of array_like, each of shape (V_i, 2)

    Returns
    -------
    ndarray, shape (max V_i, 2, len(regions))
        As `polygon` takes it.

    Raises
    ------
    TypeError, ValueError
        No region at all, or one that is not a table of finite vertices.
    """
    tables = [as_real(f"regions[{i}]", region, ndim=2) for i, region in enumerate(regions)]
    for i, table in enumerate(tables):
        if table.shape[0] < 1 or table.shape[1] != 2:
            raise ValueError(f"regions[{i}]: wanted shape (V, 2), got {table.shape}")
    if not tables:
        raise ValueError("regions: wanted at least one region, got none")
    longest = max(table.shape[0] for table in tables)
    padded = [
        np.concatenate([table, np.repeat(table[-1:], longest - table.shape[0], axis=0)])
        for table in tables
    ]
    return np.stack(padded, axis=-1)


def _moments(cases: Cases, tolerance: float) -> list[np.ndarray]:
    """Log-mass, mean and covariance of each case, by the route that is right for it."""
    size = cases.convex.size
    found = [np.empty(size), np.empty((2, size)), np.empty((2, 2, size))]

    def put(where: np.ndarray, parts: Sequence[np.ndarray]) -> None:
        for whole, part in zip(found, parts, strict=True):
            whole[..., where] = part

    regular = is_regular(cases.cov)
    rest = np.flatnonzero(regular)
    if tolerance > 0.0 and rest.size:
        closed = edge_moments(cases.take(rest))
        good = closed.estimate <= tolerance
        put(rest[good], [item[..., good] for item in closed[:3]])
        rest = rest[~good]
    if rest.size:
        put(rest, slab_moments(cases.take(rest)))
    rest = np.flatnonzero(~regular)
    if rest.size:
        put(rest, singular_moments(cases.take(rest)))
    return found


def _spread(array: np.ndarray | None, axes: int, batch: tuple[int, ...]) -> np.ndarray | None:
    """The array with all batch axes behind its first `axes` axes."""
    if array is None:
        return None
    return np.broadcast_to(align(array, axes, len(batch)), (*array.shape[:axes], *batch))
