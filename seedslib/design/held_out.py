"""The accuracy of a finished filter on paths that its design has not seen."""

from __future__ import annotations

import dataclasses
import math
import warnings
from contextlib import suppress
from typing import Any

import numpy as np

from seedslib.base.blocks import child
from seedslib.base.checks import outside
from seedslib.base.clock import when
from seedslib.design.paths import LARGEST
from seedslib.design.regression import DOMINATED
from seedslib.designed.accuracy import Accuracy
from seedslib.evaluation import evaluate

SHARE, LEAST = 8, 512
"""There is one held-out path for so many design paths, but at least so many."""

STREAM = 0x48454C44
"""Key of the held-out paths among the children of the seed: no block of a design has it."""

DOUBT = 4.0
"""Standard errors that a single difference must have to be one."""

SOME = 0.02
"""A smaller part of an error than this is not worth a warning."""

ROUNDING = 1e-9
"""An error that is a smaller part of the first state than this is rounding."""


def with_held_out(
    filter: Any, root: np.random.SeedSequence, paths: int, workers: Any, **options: Any
) -> Any:
    """The filter with its errors on held-out paths, by its own `run`.

    Parameters
    ----------
    filter : FiniteOrderFilter, SwitchingFilter or OutputFilter
        As it was designed, with the errors that it predicts.
    root : SeedSequence
        Of the design; the design paths do not depend on what is done here.
    paths : int
        Design paths.
    workers : int or Executor
        Threads; an executor elsewhere is left alone.
    **options
        As `seedslib.evaluation.compare` takes them.

    Warns
    -----
    UserWarning
        Errors that differ from the predicted ones, or that rest on few paths.
    """
    count, system = max(LEAST, -(-paths // SHARE)), filter.system
    nothing = np.full_like(filter.predicted.rms[: len(filter.times)], np.nan)
    held_out = Accuracy(filter.times, nothing, nothing, paths=count, diverged=count)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", UserWarning)  # of the run: the design has given its own
        with suppress(ValueError):  # of less than two paths on which it has not diverged
            scores = evaluate(
                filter,
                system,
                filter.times,
                count,
                child(root, STREAM),
                bound=LARGEST,
                measured=filter.measured,
                availability=filter.availability,
                workers=workers if isinstance(workers, int) else 1,
                **options,
            )
            modes = scores.mode_error, scores.mode_error_error
            errors = scores.rms, scores.rms_error, False, *modes
            held_out = Accuracy(filter.times, *errors, count, scores.diverged)
    size = np.abs(system.mean0) + np.sqrt(np.diagonal(system.cov0))
    _warn(filter.predicted, held_out, ROUNDING * size, math.sqrt(paths / count))
    return dataclasses.replace(filter, held_out=held_out)


def _warn(predicted: Accuracy, held_out: Accuracy, rounding: np.ndarray, more_paths: float) -> None:
    """Warn of errors that are not the predicted ones.

    `rounding` is the size of errors that do not count, `more_paths` the root of the number of
    design paths by that of held-out paths.
    """
    rows, n = np.searchsorted(predicted.times, held_out.times), held_out.rms.shape[1]
    wanted, wanted_error = (part[rows] for part in _with_modes(predicted))
    rms, error = _with_modes(held_out)
    rounding = np.append(rounding[:n], np.zeros(rms.shape[1] - n))
    # the same chance of a false alarm whatever the number of comparisons
    doubt = math.sqrt(DOUBT**2 + 2.0 * math.log(rms.size))
    # few paths that miss the large errors have standard errors that are too small
    both = np.hypot(wanted_error, np.maximum(error, more_paths * wanted_error))
    difference = np.abs(rms - wanted)
    bad = difference > doubt * both
    bad[:, :n] |= ((error > DOMINATED * rms) & (rms > wanted))[:, :n]
    bad &= (difference > SOME * wanted) & (np.maximum(rms, wanted) > rounding)
    if bad.any() or held_out.diverged:
        ratio = np.where(bad, difference / np.maximum(wanted, np.finfo(float).tiny), -1.0)
        k, i = np.unravel_index(ratio.argmax(), ratio.shape)
        diverged = f"; on {held_out.diverged} of them the filter diverged" * bool(held_out.diverged)
        warnings.warn(
            f"held out: errors on {held_out.paths} other paths are not the predicted ones at "
            f"{np.count_nonzero(bad.any(axis=1))} of {len(bad)} times, most at "
            f"{when(held_out.times[k])}: {rms[k, i]:.4g} ± {error[k, i]:.2g} for {wanted[k, i]:.4g}"
            f"{diverged}; take more design paths, or forecasts of a lower degree or a shorter "
            "memory",
            stacklevel=outside(),
        )


def _with_modes(accuracy: Accuracy) -> tuple[np.ndarray, np.ndarray]:
    """Errors and standard errors, with the part of wrong modes as last column where it is known."""
    if accuracy.mode_rate is None:
        return accuracy.rms, accuracy.error
    rms = np.column_stack([accuracy.rms, accuracy.mode_rate])
    return rms, np.column_stack([accuracy.error, accuracy.mode_error])
