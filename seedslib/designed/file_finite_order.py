"""What a file of a finite-order filter holds and how it is read back, for `seedslib.designed`."""

from __future__ import annotations

import math

import numpy as np

from seedslib.designed.file_arrays import measurement_times, node_times, prediction, shaped
from seedslib.designed.finite_order_rules import Start
from seedslib.designed.memory import Memory
from seedslib.designed.predictors import Affine, Continuous, Polynomial, PolynomialFit
from seedslib.designed.regression import AffineFit
from seedslib.linearization.moments import Moments

_PREDICTORS = {cls.__name__: cls for cls in (Affine, Polynomial, Continuous)}


def filter_arrays(filter) -> dict[str, np.ndarray]:
    """Arrays of a designed filter by their names in the file."""
    predicted, start = filter.predicted, filter.start
    found = {
        "times": filter.times,
        "predicted/times": predicted.times,
        "predicted/rms": predicted.rms,
        "predicted/error": predicted.error,
        "start/mean": start.mean,
        "start/cov": start.cov,
        "start/sensor_mean": start.moments.mean,
        "start/cross": start.moments.cross,
        "start/sensor_cov": start.moments.cov,
    }
    for k, fit in enumerate(filter.fits):
        found.update(_fit_arrays(f"measurement/{k + 1}", fit))
    for k, (nodes, fits) in enumerate(zip(filter.node_times, filter.node_fits, strict=True)):
        found[f"nodes/{k}/times"] = nodes
        for i, fit in enumerate(fits):
            found.update(_fit_arrays(f"nodes/{k}/{i}", fit))
    return found


def _fit_arrays(place, fit):
    return {
        f"{place}/{name}": value
        for name, value in fit._asdict().items()
        if isinstance(value, np.ndarray)
    }


def filter_parts(header, arrays) -> dict:
    """Fields of the filter in a file, each shape checked against the others."""
    memory = Memory(**header["memory"])
    options = dict(header["predictor"])
    predictor = _PREDICTORS[options.pop("name")](**options)
    components, n = int(header["components"]), len(shaped(arrays, "start/mean", (-1,)))
    m = len(shaped(arrays, "start/sensor_mean", (-1,)))
    times = measurement_times(arrays)
    intervals = len(times) - 1 + bool(header["tail"])
    moments = Moments(
        arrays["start/sensor_mean"],
        shaped(arrays, "start/cross", (n, m)),
        shaped(arrays, "start/sensor_cov", (m, m)),
    )
    start = Start(arrays["start/mean"], shaped(arrays, "start/cov", (n, n)), moments)
    sizes = [memory.dimension(k, components, m) for k in range(len(times))]
    extra = m if header["measured_nodes"] and not memory.measurements else 0
    continuous = isinstance(predictor, Continuous)
    grid, node_fits = node_times(arrays, times, intervals), []
    for k, nodes in enumerate(grid):
        count, targets = len(nodes), components
        if continuous:
            count, targets = len(nodes) + (k + 1 < len(times)), n
        node_fits.append(
            tuple(
                _affine_fit(arrays, f"nodes/{k}/{i}", targets, sizes[k] + extra)
                for i in range(count)
            )
        )
    fits = [
        _fit(arrays, f"measurement/{k}", predictor, n, sizes[k - 1]) for k in range(1, len(times))
    ]
    if not 1 <= components <= n:
        raise ValueError(f"{components} estimated components of {n}")
    return {
        "memory": memory,
        "predictor": predictor,
        "times": times,
        "node_times": grid,
        "components": components,
        "start": start,
        "fits": tuple(fits),
        "node_fits": tuple(node_fits),
        "predicted": prediction(header, arrays, times, components),
        "measured_nodes": bool(header["measured_nodes"]),
    }


def _affine_fit(arrays, place, targets, dimension):
    return AffineFit(
        shaped(arrays, f"{place}/gain", (targets, dimension)),
        shaped(arrays, f"{place}/offset", (targets,)),
        shaped(arrays, f"{place}/cov", (targets, targets)),
    )


def _fit(arrays, place, predictor, n, dimension):
    if not isinstance(predictor, Polynomial):
        return _affine_fit(arrays, place, n, dimension)
    entries = n * (n + 1) // 2
    # counted, not listed: a degree from a file may be anything
    powers, others = (
        math.comb(dimension + degree, degree) - 1
        for degree in (predictor.mean_degree, predictor.cov_degree)
    )
    return PolynomialFit(
        shaped(arrays, f"{place}/centre", (dimension,)),
        shaped(arrays, f"{place}/scale", (dimension,)),
        shaped(arrays, f"{place}/gain", (n, powers)),
        shaped(arrays, f"{place}/offset", (n,)),
        shaped(arrays, f"{place}/residual", (n, n)),
        shaped(arrays, f"{place}/cov_gain", (entries, others)),
        shaped(arrays, f"{place}/cov_offset", (entries,)),
        predictor.mean_degree,
        predictor.cov_degree,
    )
