"""What an evaluation gives: errors with their standard errors, and paired differences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import optional


@dataclass(frozen=True, repr=False)
class Evaluation:
    """Accuracy of one filter; J times, c components.

    Attributes
    ----------
    times : ndarray, shape (J,)
    paths, scored : int
        Simulated paths, and those that are scored: neither the path itself nor any filter in the
        comparison diverged.
    diverged : int
        Paths on which this filter diverged: not finite, or beyond the bound.
    seconds_per_step : float
        Time of the filter for one measurement of one path, in the batch that was run.
    rms, rms_error : ndarray, shape (J, c)
        Root-mean-square error and its standard error, without the paths that diverged.
    average, average_error : ndarray, shape (c,)
        Root of the mean square over paths and the times of the window, and its standard error.
    total, total_error : ndarray, shape (J,)
        Root of the mean square summed over the components, and its standard error.
    average_total, average_total_error : float
        The same over paths and the times of the window.
    bias, bias_error : ndarray, shape (J, c)
        Mean of the estimate minus the state, and its standard error.
    mode_error, mode_error_error : ndarray, shape (J,), or None
        Share of paths on which a filter of a switching system decided for a wrong mode, and its
        standard error; None where no modes are decided.
    average_mode_error, average_mode_error_error : float or None
        The same over paths and the times of the window.
    nees_ratio, nees_ratio_error, nis_ratio, nis_ratio_error : float or None
        Sums over paths and the times of the window of the normalised squares of the estimation
        error (NEES) and of the innovation (NIS), divided by the numbers of components: 1 for a
        consistent filter. Their standard errors come from paths, since errors at different times
        of a path depend on each other. None where the filter claims no covariance.
    average_coverage, average_coverage_error : ndarray, shape (c,), or None
        Share of paths and times of the window at which the state lies in the filter's interval of
        probability 0.95, and its standard error.
    """

    times: np.ndarray
    paths: int
    scored: int
    diverged: int
    seconds_per_step: float
    rms: np.ndarray
    rms_error: np.ndarray
    average: np.ndarray
    average_error: np.ndarray
    total: np.ndarray
    total_error: np.ndarray
    average_total: float
    average_total_error: float
    bias: np.ndarray
    bias_error: np.ndarray
    mode_error: MaybeArray = None
    mode_error_error: MaybeArray = None
    average_mode_error: Any = None
    average_mode_error_error: Any = None
    nees_ratio: Any = None
    nees_ratio_error: Any = None
    nis_ratio: Any = None
    nis_ratio_error: Any = None
    average_coverage: MaybeArray = None
    average_coverage_error: MaybeArray = None

    def __repr__(self) -> str:
        return f"<Evaluation: {self.scored} of {self.paths} paths, average {_averages(self)}>"


@dataclass(frozen=True, repr=False)
class Difference:
    """Errors of one filter minus those of another on the same paths, with standard errors.

    Attributes
    ----------
    rms, error : ndarray, shape (J, c)
        Difference of the root-mean-square errors and its standard error.
    average, average_error : ndarray, shape (c,)
        The same of the averages over the times of the window.
    square, square_error : ndarray, shape (J,)
        Difference of the mean-square errors summed over the components.
    average_square, average_square_error : float
        The same of the averages over the times of the window.
    mode, mode_error : ndarray, shape (J,), or None
        Difference of the shares of wrong modes; None unless both filters decide modes.
    average_mode, average_mode_error : float or None
        The same of the averages over the times of the window.
    """

    rms: np.ndarray
    error: np.ndarray
    average: np.ndarray
    average_error: np.ndarray
    square: np.ndarray
    square_error: np.ndarray
    average_square: float
    average_square_error: float
    mode: MaybeArray = None
    mode_error: MaybeArray = None
    average_mode: Any = None
    average_mode_error: Any = None

    def __repr__(self) -> str:
        return f"<Difference: average {_averages(self)}>"


class Comparison(Mapping[str, Evaluation]):
    """Evaluations by name, and paired differences; read like a mapping, shown as a table.

    ``print`` leaves out what differs from run to run, the time of a step.
    """

    def __init__(
        self, evaluations: dict[str, Evaluation], mean: np.ndarray, cov: np.ndarray, size: int
    ) -> None:
        """Means (F, J+1, C) of the squared errors of `size` components, of their sum and of wrong
        modes, and the covariances (F, F, J+1, C) of those means.
        """
        self._evaluations, self._mean, self._cov, self._size = evaluations, mean, cov, size

    def __getitem__(self, name: str) -> Evaluation:
        return self._evaluations[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._evaluations)

    def __len__(self) -> int:
        return len(self._evaluations)

    def difference(self, first: str, second: str) -> Difference:
        """Errors of `first` minus those of `second`, with the error of a paired comparison."""
        a, b = (list(self).index(name) for name in (first, second))
        mean, size = self._mean[[a, b]], self._size

        def error(slope, k):
            """Standard error of slope[0] times a mean of `a` less slope[1] times one of `b`."""
            own = slope[0] ** 2 * self._cov[a, a, :, k] + slope[1] ** 2 * self._cov[b, b, :, k]
            variance = own - 2 * slope[0] * slope[1] * self._cov[a, b, :, k]
            return np.sqrt(np.maximum(variance, 0.0))

        rms, slope = roots(mean[..., :size])
        value, value_error = rms[0] - rms[1], error(slope, slice(size))
        scores = {}
        for k, name in zip(range(size, mean.shape[2]), ("square", "mode"), strict=False):
            scores |= named(name, mean[0, :, k] - mean[1, :, k], error((1.0, 1.0), k))
        return Difference(value[:-1], value_error[:-1], value[-1], value_error[-1], **scores)

    def to_dataframe(self, names: Sequence[str] | None = None) -> Any:
        """A pandas table with a row for each filter.

        Parameters
        ----------
        names : sequence of str, optional
            Of the components; ``x1, x2, ...`` by default.

        Returns
        -------
        pandas.DataFrame
            Indexed by filter: the root-mean-square error over the window of each component
            and, where there are such, ``nees_ratio`` and ``average_mode_error``, each with
            its ``..._error``; ``seconds_per_step`` and the number of paths that ``diverged``.

        Raises
        ------
        ImportError
            pandas is not installed.
        ValueError
            Another number of names.
        """
        with optional("tables"):
            import pandas

        table: dict[str, list[Any]] = {}
        for name, pairs in self._columns(names).items():
            table[name] = [value for value, _ in pairs]
            if any(error is not None for _, error in pairs):
                table[f"{name}_error"] = [error for _, error in pairs]
        index = pandas.Index(list(self), name="filter")
        return pandas.DataFrame(table, index=index).astype({"diverged": int})

    def _columns(self, names: Sequence[str] | None = None) -> dict[str, list[tuple[Any, Any]]]:
        """Values and standard errors of all filters, by the name of the column."""
        rows = list(self.values())
        count = len(rows[0].average)
        names = [f"x{k + 1}" for k in range(count)] if names is None else list(names)
        if len(names) != count:
            raise ValueError(f"names: wanted {count}, got {len(names)}")
        columns = {
            name: [(row.average[k], row.average_error[k]) for row in rows]
            for k, name in enumerate(names)
        }
        for name in ("nees_ratio", "average_mode_error"):
            pairs = [(getattr(row, name), getattr(row, f"{name}_error")) for row in rows]
            if any(value is not None for value, _ in pairs):
                columns[name] = pairs
        for name in ("seconds_per_step", "diverged"):
            columns[name] = [(getattr(row, name), None) for row in rows]
        return columns

    def _table(self, columns: dict[str, list[tuple[Any, Any]]]) -> str:
        cells = [["filter", *self]]
        cells += [[name, *(_words(*pair) for pair in pairs)] for name, pairs in columns.items()]
        widths = [max(map(len, column)) for column in cells]
        return "\n".join(
            "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in zip(*cells, strict=True)
        )

    def __repr__(self) -> str:
        return self._table(self._columns())

    def __str__(self) -> str:
        columns = self._columns()
        del columns["seconds_per_step"]
        return self._table(columns)


def roots(mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roots of mean squares, and the derivatives of a root by its mean square."""
    rms = np.sqrt(mean)
    return rms, np.divide(0.5, rms, out=np.zeros_like(rms), where=rms > 0)


def named(name: str, value: np.ndarray, error: np.ndarray) -> dict[str, Any]:
    """Values (J,), average and their errors of arrays (J+1,), by name; {} where none is known."""
    if np.isnan(value).all():
        return {}
    return {
        name: value[:-1],
        f"{name}_error": error[:-1],
        f"average_{name}": float(value[-1]),
        f"average_{name}_error": float(error[-1]),
    }


def _words(value, error):
    if value is None or value != value:
        return "-"
    if isinstance(value, int):
        return str(value)
    return f"{value:.3g}" if error is None else f"{value:.4g} ± {error:.2g}"


def _averages(scores):
    pairs = zip(scores.average, scores.average_error, strict=True)
    return ", ".join(_words(*pair) for pair in pairs)
