"""What an evaluation gives: errors with their standard errors, and paired differences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.evaluation.report import data_frame, html, text


class Evaluation(NamedTuple):
    """Accuracy of one filter; J times, c components.

    Attributes
    ----------
    times : ndarray, shape (J,)
    rms, rms_error : ndarray, shape (J, c)
        Root-mean-square error and its standard error, without the paths that diverged.
    rms_all : ndarray, shape (J, c)
        With them: infinite or absurd where the filter was. Paths whose truth left the range of
        numbers are in neither.
    bias, bias_error : ndarray, shape (J, c)
        Mean of the estimate minus the state, and its standard error.
    average, average_error : ndarray, shape (c,)
        Root of the mean square over paths and the times of the window, and its standard error.
    paths, scored : int
        Simulated paths, and those that are scored: neither the path itself nor any filter in the
        comparison diverged.
    diverged : int
        Paths on which this filter diverged: not finite, or beyond the bound.
    nees, nis : ndarray, shape (J,), or None
        Mean normalised squares of the estimation error and of the innovation, NaN where the
        filter claims no covariance. For a consistent filter their means are the numbers of
        components, of the innovation the mean number of those measured.
    nees_bounds, nis_bounds : pair of ndarray, shape (J,), or None
        Where such means lie with probability 0.95 if errors are Gaussian and consistent.
    seconds_per_step : float
        Time of the filter for one measurement of one path, in the batch that was run.
    total, total_error : ndarray, shape (J,)
        Root of the mean square summed over the components, and its standard error.
    average_total, average_total_error : float
        The same over paths and the times of the window.
    mode_error, mode_error_error : ndarray, shape (J,), or None
        Share of paths on which a filter of a switching system decided for a wrong mode, and its
        standard error; None where no modes are decided.
    average_mode_error, average_mode_error_error : float or None
        The same over paths and the times of the window.
    nees_ratio, nees_ratio_error, nis_ratio, nis_ratio_error : float or None
        Sums of the normalised squares over paths and the times of the window, divided by the
        numbers of components: 1 for a consistent filter. Errors at different times of a path
        depend on each other, so no chi-square law holds; the standard errors come from paths.
    coverage, coverage_error : ndarray, shape (J, c), or None
        Share of paths on which the state lies in the filter's interval of probability 0.95, and
        its standard error.
    average_coverage, average_coverage_error : ndarray, shape (c,), or None
        The same over paths and the times of the window.
    log_score, log_score_error : ndarray, shape (J,), or None
        Mean logarithm of the density that the filter predicted for what was measured, and its
        standard error; larger is better. NaN at times without a measurement, and where the
        density is zero, or not known, on some path. None for a filter without a likelihood.
    average_log_score, average_log_score_error : float or None
        The same over paths and the measurement times of the window.
    """

    times: np.ndarray
    rms: np.ndarray
    rms_error: np.ndarray
    rms_all: np.ndarray
    bias: np.ndarray
    bias_error: np.ndarray
    average: np.ndarray
    average_error: np.ndarray
    paths: int
    scored: int
    diverged: int
    nees: MaybeArray
    nis: MaybeArray
    nees_bounds: tuple[Any, ...] | None
    nis_bounds: tuple[Any, ...] | None
    seconds_per_step: float
    total: np.ndarray
    total_error: np.ndarray
    average_total: float
    average_total_error: float
    mode_error: MaybeArray = None
    mode_error_error: MaybeArray = None
    average_mode_error: Any = None
    average_mode_error_error: Any = None
    nees_ratio: Any = None
    nees_ratio_error: Any = None
    nis_ratio: Any = None
    nis_ratio_error: Any = None
    coverage: MaybeArray = None
    coverage_error: MaybeArray = None
    average_coverage: MaybeArray = None
    average_coverage_error: MaybeArray = None
    log_score: MaybeArray = None
    log_score_error: MaybeArray = None
    average_log_score: Any = None
    average_log_score_error: Any = None

    def __repr__(self) -> str:
        return (
            f"<Evaluation: {self.scored} of {self.paths} paths, average {_list(self, 'average')}>"
        )


class Difference(NamedTuple):
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
    log_score, log_score_error : ndarray, shape (J,), or None
        Difference of the log scores; None unless both filters have one.
    average_log_score, average_log_score_error : float or None
        The same of the averages over the measurement times of the window.
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
    log_score: MaybeArray = None
    log_score_error: MaybeArray = None
    average_log_score: Any = None
    average_log_score_error: Any = None

    def __repr__(self) -> str:
        return f"<Difference: average {_list(self, 'average')}>"


class Comparison(Mapping[str, Evaluation]):
    """Evaluations by name, and paired differences; read like a mapping, shown as a table.

    ``print`` leaves out what differs from run to run, the time of a step.
    """

    def __init__(
        self, evaluations: Any, squares: Any, cov: np.ndarray, scored: Any, more: tuple[str, ...]
    ) -> None:
        """Squares (F, J+1, c + 1 + len(more)) and their covariances over paths (F, F, ...): those
        of the components, their sum, and further numbers by name.
        """
        self._evaluations, self._more = evaluations, more
        self._squares, self._cov, self._scored = squares, cov, scored
        self._components = next(iter(evaluations.values())).rms.shape[1]

    def __getitem__(self, name: str) -> Evaluation:
        return self._evaluations[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._evaluations)

    def __len__(self) -> int:
        return len(self._evaluations)

    def difference(self, first: str, second: str) -> Difference:
        """Errors of `first` minus those of `second`, with the error of a paired comparison."""
        names = list(self)
        a, b = names.index(first), names.index(second)
        count, mean = self._components, self._squares[[a, b]]
        raw = mean[0] - mean[1]
        error = self._error(a, b, np.ones_like(mean))
        rms, slope = roots(mean[..., :count])
        apart, apart_error = rms[0] - rms[1], self._error(a, b, slope)
        found = {
            name: quadruple(raw[:, k], error[:, k]) for k, name in enumerate(self._more, count + 1)
        }
        return Difference(
            apart[:-1], apart_error[:-1], apart[-1], apart_error[-1],
            *quadruple(raw[:, count], error[:, count]),
            *found.get("mode", NOTHING), *found.get("log_score", NOTHING),
        )  # fmt: skip

    def _error(self, a, b, slope):
        """Standard error of slope[0] times a mean of `a` less slope[1] times one of `b`."""
        cov = self._cov[..., : slope.shape[2]]
        variance = (
            slope[0] ** 2 * cov[a, a]
            + slope[1] ** 2 * cov[b, b]
            - 2 * slope[0] * slope[1] * cov[a, b]
        )
        return np.sqrt(np.maximum(variance, 0.0) / self._scored)

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
            and, where there are such, ``nees_ratio``, ``average_log_score`` and
            ``average_mode_error``, each with its ``..._error``; ``seconds_per_step`` and the
            number of paths that ``diverged``.

        Raises
        ------
        ImportError
            pandas is not installed.
        ValueError
            Another number of names.
        """
        return data_frame(self, names)

    def __repr__(self) -> str:
        return text(self)

    def _repr_html_(self) -> str:
        return html(self)

    def __str__(self) -> str:
        width = max(map(len, self))
        lines = [f"{'filter':{width}}  time-averaged RMS error by component"]
        for name, found in self.items():
            row = "  ".join(
                f"{a:.4f} ± {e:.4f}"
                for a, e in zip(found.average, found.average_error, strict=True)
            )
            if found.average_mode_error is not None:
                row += (
                    f"  wrong mode {found.average_mode_error:.4f} "
                    f"± {found.average_mode_error_error:.4f}"
                )
            lost = f"  {found.diverged} of {found.paths} paths diverged" if found.diverged else ""
            lines.append(f"{name:{width}}  {row}{lost}")
        return "\n".join(lines)


NOTHING = (None, None, None, None)


def quadruple(value: np.ndarray, error: np.ndarray) -> tuple[Any, ...]:
    """Values (J,) and errors, average and its error, of (J+1,); nothing where none is known."""
    if np.isnan(value).all():
        return NOTHING
    return value[:-1], error[:-1], float(value[-1]), float(error[-1])


def _list(found, name):
    """Numbers with their errors, in a line."""
    pairs = zip(getattr(found, name), getattr(found, f"{name}_error"), strict=True)
    return ", ".join(f"{value:.4g} ± {error:.2g}" for value, error in pairs)


def roots(mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roots of mean squares, and the derivatives of a root by its mean square."""
    rms = np.sqrt(mean)
    return rms, np.divide(0.5, rms, out=np.zeros_like(rms), where=rms > 0)
