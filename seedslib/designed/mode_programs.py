"""Programs of filters of modes: a Gaussian distribution in each mode, carried or from a memory."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import add
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from seedslib.base.values import Values
from seedslib.designed.cells import CellFit
from seedslib.designed.lemmas import FAINT, ROUNDING
from seedslib.designed.memory import places
from seedslib.designed.program import DesignedProgram
from seedslib.designed.rules import SOFTEST
from seedslib.filters.kernels import cholesky, correct, lower_of, unpacked
from seedslib.filters.program import Program, any_of
from seedslib.filters.weights import TIE, logarithm
from seedslib.linearization.formulas import Formulas
from seedslib.linearization.moments import Weighted
from seedslib.tape.tape import Array, Number, Scalar, choose, isfinite, isnan, stacked

Gaussian: TypeAlias = tuple[np.ndarray, np.ndarray]
"""Mean (n,) and covariance (n, n)."""


class Mixture(NamedTuple):
    """Room for weighted Gaussian distributions.

    Attributes
    ----------
    log_prob : Array, shape (rows,)
    moments : Array, shape (rows, n (n + 3) / 2)
        Mean, and covariance on and below the diagonal.
    """

    log_prob: Array
    moments: Array

    @classmethod
    def of(cls, step: Program, name: str, rows: int, n: int, owner: str = "local") -> Mixture:
        """Arrays for so many distributions of n components."""
        log_prob = step.array(f"{name}_log_prob", (rows,), owner=owner)
        return cls(log_prob, step.array(f"{name}_moments", (rows, n * (n + 3) // 2), owner=owner))

    def store(self, row: int, log_prob: Number, mean: np.ndarray, cov: np.ndarray) -> None:
        """Fill a row."""
        self.log_prob.store(log_prob, row)
        self.moments.store([*mean, *lower_of(cov)], row)

    def parts(self, n: int) -> tuple[list[Number], list[Gaussian]]:
        """Logarithms of the weights, and the distributions."""
        return list(self.log_prob.all), [unpacked(row, n) for row in self.moments.all]


def switching(step: Any) -> None:
    """Record a `SwitchingFilter`: forecast of mode and state, then a correction in each mode.

    Raises
    ------
    TypeError, ValueError
        Moments without formulas, fits that are no `CellFit`.
    """
    filter, system, n, modes = step.filter, step.filter.system, step.n, step.modes
    _check(filter)
    if step.designed:
        k, t = step.begin()
        gap_before, gap = step.gap(k)
        if filter.memory.indicators:
            step.refuse(step.indicator < 0.0, "PARTLY")
        first, past = k < 1.0, step.past(n + filter.memory.log_odds * (modes - 1))
    else:
        t = step.timed()
        first = step.started.all < 1.0
    # with a memory they are results: a state in Python has them
    owner = "state" if step.floats or not step.designed else "local"
    carried = Mixture.of(step, "carried", modes, n, owner)
    parts = step.indicators if filter.rules.split else 1
    ahead = Mixture.of(step, "ahead", modes * parts, n)
    logs = [logarithm(start.probability) for start in system.initial]
    gaussians = [(start.mean, start.cov) for start in system.initial]
    if not step.designed:
        rows = [[*mean, *lower_of(cov)] for mean, cov in gaussians]
        step.initial = {"carried_log_prob": logs, "carried_moments": rows}
        logs, gaussians = carried.parts(n)
    with step.when(first):
        for i, (log, (mean, cov)) in enumerate(zip(logs, gaussians, strict=True)):
            for part in range(parts):  # all of it is in the first part
                ahead.store(i * parts + part, -np.inf if part else log, mean, cov)
    with step.when(~first):
        last = step.last_time.all if not step.designed else step.moment(k - 1.0)
        if step.designed:
            logs, gaussians = _recalled(step, k, past)
        _forecast(step, last, logs, gaussians, ahead, step.since(t - last))
    sensed = Mixture.of(step, "sensed", modes, n + step.m)
    possible = _sense(step, t, ahead, sensed)
    before, joints = sensed.parts(n + step.m)
    logs, means, covs = [], [], []
    for log, (mean, cov), sensor in zip(before, joints, system.sensors, strict=True):
        moments = mean[n:], cov[:n, n:], cov[n:, n:]
        mean, cov, loglik, _ = correct(step, mean[:n], cov[:n, :n], moments, sensor)
        if step.floats:  # it may have to be repaired
            pivots = np.diagonal(cholesky(step, cov, np.diagonal(cov)))
            step.defer(any_of([~(pivot > 0.0) for pivot in pivots]))
        logs.append(choose(log > -np.inf, log + loglik, -np.inf))
        means.append(mean)
        covs.append(cov)
    prob = step.array("prob", (modes,), owner="state")

    def store_weights(logs: Sequence[Number], probs: Sequence[Number], total: Number) -> Number:
        prob.store(probs)
        carried.log_prob.store(logs)
        return total

    loglik = store_weights(*normalised(logs))
    with step.when(~isfinite(loglik)):  # no mode explains the measurement: the forecast stays
        store_weights(*normalised(before))
    loglik = choose(possible, loglik, -np.inf)
    probs = list(prob.all)
    mean = reduce(add, [p * x for p, x in zip(probs, means, strict=True)])
    cov = mix(probs, means, covs, False)[2] if modes > 1 else covs[0]
    mode = _most_probable(probs)
    step.array("mode", (), "int", "state").store(mode)
    step.mean.store(mean)
    carried.moments.store([[*x, *lower_of(p)] for x, p in zip(means, covs, strict=True)])
    if not step.designed:
        step.cov.store(cov)
        step.loglik.store(loglik)
        step.last_time.store(t)
        step.started.store(1.0)
        return
    step.claim(cov, loglik, gap_before, gap)
    _remember(step, past, mean, mode, carried.log_prob, (before, joints))
    step.end(k)


def _check(filter: Any) -> None:
    fits = filter.fits
    if not isinstance(filter.linearization, Formulas):
        raise TypeError(
            "linearization: wanted formulas, Taylor or ExactGaussian, to write modes in C, got "
            f"{filter.linearization!r}"
        )
    if filter.rules.printed:
        raise ValueError("normalisation: wanted 'consistent' for C, got 'printed'")
    if filter.memory is None:
        return
    if not fits or not all(isinstance(fit, CellFit) for fit in fits):
        raise TypeError(
            "fits: wanted distributions in cells, for at least two measurements, to write in C"
        )


# Weights and mixtures, from logarithms of weights


def relative(logs: Sequence[Number]) -> tuple[list[Number], Number]:
    """Weights relative to the largest, and its logarithm, zero where that is not finite."""
    largest = reduce(np.maximum, logs)
    largest = choose(isfinite(largest), largest, 0.0)
    return [np.exp(log - largest) for log in logs], largest


def normalised(logs: Sequence[Number]) -> tuple[list[Number], list[Number], Number]:
    """Logarithms of weights whose sum is one, these weights, and the logarithm of the sum before.

    Where nothing has a finite weight, the logarithms as they are and the largest of them.
    """
    weights, largest = relative(logs)
    highest = reduce(np.maximum, logs)
    total = choose(isfinite(highest), reduce(add, weights), 1.0)
    log_total = np.log(total)
    shares = [weight / total for weight in weights]
    return [log - largest - log_total for log in logs], shares, highest + log_total


def mix(
    mass: Sequence[Number],
    means: Sequence[np.ndarray],
    covs: Sequence[np.ndarray],
    may_be_empty: bool,
) -> tuple[Number, np.ndarray, np.ndarray]:
    """Mass, mean and covariance of a mixture; of no mass, mean zero and unit covariance."""
    total = reduce(add, mass)
    empty = total == 0.0 if may_be_empty else False
    if may_be_empty:
        means = [choose(m > 0.0, x, 0.0) for m, x in zip(mass, means, strict=True)]
        covs = [choose(m > 0.0, p, 0.0) for m, p in zip(mass, covs, strict=True)]
    shares = [m / choose(empty, 1.0, total) for m in mass]
    mean = reduce(add, [share * x for share, x in zip(shares, means, strict=True)])
    deviations = [x - mean for x in means]
    within = reduce(add, [share * p for share, p in zip(shares, covs, strict=True)])
    between = [(s * d)[:, None] * d for s, d in zip(shares, deviations, strict=True)]
    return total, mean, choose(empty, np.eye(len(mean)), within + reduce(add, between))


def _most_probable(probs: Sequence[Number]) -> Number:
    """Number of the most probable mode, the first of those that are equal but for rounding."""
    mode: Number = 0.0
    for i in reversed(range(len(probs))):
        mode = choose(probs[i] >= (1.0 - TIE) * reduce(np.maximum, probs), float(i), mode)
    return mode


# Forecast and measurement


def _forecast(
    step: Program,
    t: Scalar,
    logs: list[Number],
    gaussians: list[Gaussian],
    ahead: Mixture,
    p: Values,
) -> None:
    """Forecast of mode and state from their distribution at time t: lemmas 4 and 6."""
    rules, pairs = step.filter.rules, list(enumerate(gaussians))
    if rules.switch is not None:  # the new mode drives the step: a switch, then a move
        switched = Mixture.of(step, "switched", step.modes, step.n)
        _combine(step, logs, [rules.switch[i](t, *one, p) for i, one in pairs], switched)
        logs, gaussians = switched.parts(step.n)
        pairs = list(enumerate(gaussians))
    _combine(step, logs, [rules.rows[i](t, *one, p) for i, one in pairs], ahead)


def _mass(branch: Weighted) -> Number:
    """Probability of a branch."""
    return np.asarray(branch.mass, dtype=object)[()]


def _combine(
    step: Program,
    logs: Sequence[Number],
    rows: Sequence[Sequence[Sequence[Weighted | None]]],
    into: Mixture,
) -> None:
    """Mixtures over the old modes: `rows` has for each of them the branches to the new ones."""
    weights, largest = relative(logs)
    flat = [[part for parts in row for part in parts] for row in rows]
    for new, column in enumerate(zip(*flat, strict=True)):
        old = [i for i, branch in enumerate(column) if branch is not None]
        masses, values = [_mass(column[i]) for i in old], [column[i].value for i in old]
        for mass in masses:
            if type(mass) is Scalar:  # no probability: arrays warn of it
                step.defer((mass < -ROUNDING) | (mass > 1.0 + ROUNDING))
        means, covs = [value.mean for value in values], [value.cov for value in values]
        if not old:
            into.store(new, -np.inf, np.zeros(step.n), np.eye(step.n))
            continue
        if len(old) == 1:
            log = logs[old[0]] + np.log(masses[0])
            into.store(new, log, *_where_possible(masses[0], log, means[0], covs[0]))
            continue
        mass = [weights[i] * part for i, part in zip(old, masses, strict=True)]
        sure = len(old) == len(rows) and all(type(m) is not Scalar and m > FAINT for m in masses)
        total, mean, cov = mix(mass, means, covs, not sure)
        into.store(new, largest + np.log(total), mean, cov)
        if sure:
            continue
        with step.when(total < FAINT):  # so little that it is formed again by itself
            mass, most = relative([logs[i] + np.log(m) for i, m in zip(old, masses, strict=True)])
            total, mean, cov = mix(mass, means, covs, True)
            into.store(new, most + np.log(total), mean, cov)


def _where_possible(mass: Number, log: Number, mean: np.ndarray, cov: np.ndarray) -> Gaussian:
    """Moments of a branch, where it has no mass mean zero and unit covariance."""
    if type(mass) is not Scalar:
        return mean, cov
    possible = log > -np.inf
    return choose(possible, mean, 0.0), choose(possible, cov, np.eye(len(mean)))


def _sense(step: Program, t: Scalar, ahead: Mixture, sensed: Mixture) -> Any:
    """State and measurement in each mode, given the indicator; whether any mode can have it."""
    if not step.indicators:
        _sense_value(step, t, ahead, sensed, 0)
        return True
    for value in range(step.indicators):
        with step.when(step.indicator == float(value)):
            _sense_value(step, t, ahead, sensed, value)
    possible = any_of([log != -np.inf for log in sensed.log_prob.all])
    with step.when((step.indicator < 0.0) | ~possible):  # an impossible one says nothing
        _sense_value(step, t, ahead, sensed, None)
    return possible


def _sense_value(
    step: Program, t: Scalar, ahead: Mixture, sensed: Mixture, value: int | None
) -> None:
    """The same for a value of the indicator, None where it is missing: lemma 3."""
    rules, n, p = step.filter.rules, step.n, step.at_time()
    log_prob, gaussians = ahead.parts(n)
    parts, size = len(log_prob) // step.modes, n + step.m
    for i in range(step.modes):
        reading = rules.unlabelled[i] if value is None else rules.readings[i][value]
        if reading is None:
            sensed.store(i, -np.inf, np.zeros(size), np.eye(size))
            continue
        rows = range(i * parts, (i + 1) * parts)
        branches = [reading(t, *gaussians[row], p) for row in rows]
        masses = [_mass(branch) for branch in branches]
        logs = [log_prob[row] + np.log(mass) for row, mass in zip(rows, masses, strict=True)]
        means, covs = zip(*map(_joint, branches), strict=True)
        if parts == 1:
            sensed.store(i, logs[0], *_where_possible(masses[0], logs[0], means[0], covs[0]))
        else:
            mass, largest = relative(logs)
            total, mean, cov = mix(mass, means, covs, True)
            sensed.store(i, largest + np.log(total), mean, cov)


def _joint(branch: Weighted) -> Gaussian:
    """Mean and covariance of the state and, below it, the value."""
    state, value = branch.state, branch.value
    cov = np.block([[state.cov, value.cross], [value.cross.T, value.cov]])
    return np.concatenate([state.mean, value.mean]), cov


# Memory


def _recalled(
    step: DesignedProgram, k: Scalar, past: dict[str, Array]
) -> tuple[list[Number], list[Gaussian]]:
    """Distribution of mode and state given the memory: (6.32) to (6.34)."""
    row, cell, u = k - 1.0, 0.0, past["memory"].all
    for name, count in (("modes", step.modes), ("indicators", step.indicators)):
        for j, value in enumerate(past[name].all if name in past else ()):
            # while the memory fills, what is not yet in it does not count
            cell = choose(k > float(j), cell * float(count) + value, cell)
    fits = {name: step.table(f"cell_{name}", v) for name, v in _cell_tables(step).items()}
    logs, gaussians = [], []
    for i in range(step.modes):
        at = row, cell, float(i)
        log, centre, white, gain, offset, cov = (fits[name][at] for name in CellFit._fields)
        deviation = u - centre
        for line in white:  # in the order of `CellFit.forecast`
            residual = reduce(add, [a * b for a, b in zip(line, deviation, strict=True)])
            log = log - 0.5 * residual * residual
        logs.append(log)
        mean = [reduce(add, [start, *line * u]) for start, line in zip(offset, gain, strict=True)]
        gaussians.append((stacked(mean), cov))
    largest = reduce(np.maximum, logs)
    logs = [log - largest for log in logs]
    log_total = np.log(reduce(add, [np.exp(log) for log in logs]))
    return [log - log_total for log in logs], gaussians


def _cell_tables(step: DesignedProgram) -> dict[str, np.ndarray]:
    """Parts of the fits by measurement, cell and mode, for the numbers of the full memory."""
    filter, memory, n, modes = step.filter, step.filter.memory, step.n, step.modes
    size, estimate = memory.order(n, step.m, modes), n + (modes - 1) * memory.log_odds
    cells = max(fit.log_weight.shape[-1] for fit in filter.fits)
    shapes = CellFit((), (size,), (size, size), (n, size), (n,), (n, n))
    tables = [np.zeros((len(filter.fits), cells, modes, *shape)) for shape in shapes]
    for row, fit in enumerate(filter.fits):
        used, all_rows = places(memory, estimate, step.m, row + 1), range(n)
        entries = CellFit(
            [], [used], [used, used], [all_rows, used], [all_rows], [all_rows, all_rows]
        )
        for table, values, where in zip(tables, fit, entries, strict=True):
            by_cell = np.moveaxis(values, (-1, -2), (0, 1))
            table[np.ix_([row], range(len(by_cell)), range(modes), *where)] = by_cell
    return dict(zip(CellFit._fields, tables, strict=True))


def _remember(
    step: DesignedProgram,
    past: dict[str, Array],
    mean: np.ndarray,
    mode: Number,
    log_prob: Array,
    sensed: tuple[list[Number], list[Gaussian]],
) -> None:
    """Put estimate, measurement, mode and indicator on the memory."""
    memory, y = step.filter.memory, step.y
    log_odds = []
    for log in log_prob.all[1:] if memory.log_odds else ():
        odds = log - log_prob[0]
        cut = np.minimum(np.maximum(odds, -SOFTEST), SOFTEST)
        log_odds.append(choose(isnan(odds), 0.0, cut))
    if memory.measurements:  # a missing one is remembered as what was expected
        logs, joints = sensed
        parts = zip(normalised(logs)[1], joints, strict=True)
        y = choose(isnan(y), reduce(add, [share * joint[0][step.n :] for share, joint in parts]), y)
    step.push(past, [*mean, *log_odds], y, mode)
