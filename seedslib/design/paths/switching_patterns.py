"""The pass of a switching design whose measurements and indicators arrive with probabilities.

As in `seedslib.design.paths.patterns` no pattern is waited for: each class of histories goes on
with every pattern on all the design paths, and each has laws of its own in the cells of the memory.
"""

from __future__ import annotations

from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from seedslib.base.progress import followed
from seedslib.design.cells import fit_cells
from seedslib.design.histories import Histories, patterns, shares
from seedslib.design.paths.forward_pass import as_read
from seedslib.design.paths.patterns import second_moments, where_late
from seedslib.design.paths.switching import cell_of, forecast_mean, moments_of_cells, score
from seedslib.designed.switching.fits import CellFit, ClassFit, cell_count
from seedslib.designed.switching.lemmas import total_covariance
from seedslib.models.kinds import elapsed
from seedslib.models.simulation import ARRIVALS

_estimate = attrgetter("mean")


def pattern_pass(
    walk: Any, system: Any, memory: Any, rules: Any, times: np.ndarray, held: Any,
    read: np.ndarray, rates: np.ndarray,
) -> tuple[Any, ...]:  # fmt: skip
    """Run the filter on the paths in each class of histories, and fit it before each step.

    Parameters
    ----------
    walk, system, memory, rules, times, held
        As the pass without availability has them.
    read : ndarray of bool, shape (K+1, m')
        Components that are read, the indicator the last.
    rates : ndarray, shape (m',)
        Probabilities that they arrive.

    Returns
    -------
    fits, scores, forecasts, thin, pairs, raised : as the pass without
    arrivals : list of Arrivals
    """
    n, m = system.state_size, system.measurement_size
    histories, forks = Histories(rates, n), []
    fits, scores, thin, pairs, raised = [], [], 0, 0, 0
    forecasts = [np.full(n, np.nan)]
    for k, t in enumerate(followed(times, "design")):
        if not forks:
            walk.begin(t)
            forks = [walk.each(lambda x: rules.start(x.shape[1:]), walk.states)]
        else:
            old, cells = times[k - 1], cell_count(memory, system, k - 1)
            with held.at(k - 1), elapsed(system, old, t):
                walk.advance(old, t)
                for c, fork in enumerate(forks):

                    def predict(state, c=c, fit=fits[-1], old=old, cells=cells):
                        cell = cell_of(system, state) + c * cells
                        law = rules.predict(old, fit.forecast(cell, state.past.vector))
                        return state._replace(law=law, corrected=False)

                    forks[c] = walk.each(predict, fork)
            squares = [
                walk.gather(lambda x, state: (x[:n] - forecast_mean(state.law)) ** 2, fork).mean
                for fork in forks
            ]
            forecasts.append(np.sqrt(histories.prob @ np.array(squares)))
        prob, kept, moments, claimed = {}, {}, {}, {}
        for c, number, there, chance in [
            (c, *way) for c in range(len(forks)) for way in patterns(read[k], rates)
        ]:

            def correct(state, y, k=k, t=t, there=there):
                y = as_read(there, y)
                seen = np.nan_to_num(y[m], nan=-1.0).astype(int) if system.indicators else None
                return rules.correct(state._replace(index=k, time=t), y[:m], seen, memory)

            if not kept:
                shown = walk.measure(t)
            with held.at(k):
                found = walk.kept(correct, forks[c], shown, array=_estimate)
            claimed[c, number] = walk.gather(_claimed, found).mean
            # of the law nothing more is wanted but the number of what was mended
            kept[c, number] = walk.each(lambda state: state._replace(law=None), found)
            moments[c, number] = second_moments(walk, n, found)
            prob[c, number] = chance * histories.prob[c]
        classes = histories.take(t, moments, prob)
        histories.noted(moments, prob, claimed)
        uniform, forks = walk.uniform(ARRIVALS), []
        for members in classes.members:
            mix = partial(_mixed, shares(members, prob))
            forks.append(walk.each(mix, uniform, *(kept[cell] for cell in members)))
        scores.append(score(walk, n, *forks, weights=classes.prob))
        if k + 1 == len(times):
            raised += sum(state.mended for fork in forks for state in fork)
            continue
        parts, cells = [], cell_count(memory, system, k)
        for fork in forks:
            scatters, left = moments_of_cells(walk, system, fork, cells)
            part, few, bent = fit_cells(scatters, n, left)
            parts.append(part)
            thin, pairs, raised = thin + few, pairs + cells * system.modes, raised + bent
        columns = zip(*parts, strict=True)
        whole = CellFit(*(np.concatenate(column, axis=-1) for column in columns))
        fits.append(ClassFit(whole))
    return fits, scores, forecasts, thin, pairs, raised, histories.arrivals


def _claimed(x, state):
    return np.einsum("jj...->j...", total_covariance(state.law))


def _mixed(shares, number, *states):
    """State whose paths are those of several, by uniform numbers and shares that sum to one."""
    found, ends = states[0], np.cumsum(shares)
    for share, other in zip(ends, states[1:], strict=False):
        late, raised = number >= share, found.mended + other.mended
        found = where_late(late, found, other)._replace(
            mode=np.where(late, other.mode, found.mode), mended=raised
        )
    return found
