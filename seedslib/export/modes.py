"""Programs of filters of systems with modes: IMM and designed switching filters."""

from __future__ import annotations

import numpy as np

from seedslib.designed.switching.filter import CellFit
from seedslib.designed.switching.rules import SOFTEST
from seedslib.export.kernels import (
    BranchMoments,
    correct,
    lower_of,
    mix,
    relative,
    staying,
    unpacked,
)
from seedslib.export.step import any_of
from seedslib.export.tape import Scalar, choose, compared, isfinite, isnan
from seedslib.filters.weights import TIE
from seedslib.models.maps import StochasticMap
from seedslib.models.switching import Branch


def switching(step):
    filter, system, n, L = step.filter, step.filter.system, step.n, step.modes
    rules, rule, size = filter.rules, filter.linearization, step.n * (step.n + 3) // 2
    mode, prob = step.array("mode", (), "int", "state"), step.array("prob", (L,), owner="state")
    lost, wanted = 0.0, []
    if step.designed:
        k, t = step.begin()
        before, after_gap = step.gaps(
            step.any_missing() | (step.indicator < 0.0 if step.indicators else False)
        )
        if filter.memory.indicators:
            step.refuse(step.indicator < 0.0, "PARTLY")
        first, old = k < 1.0, step.arrays["times"][np.maximum(k - 1.0, 0.0)]
        if filter.cycle:
            old = old + step.laps.all * (filter.times[-1] - filter.times[-1 - filter.cycle])
        score, law, remember = cells(step, k)
    else:
        t = step.timed()
        first, old = step.started.all < 1.0, step.last_time.all
        score, law = (
            step.array("score", (L,), owner="state"),
            step.array("law", (L, size), owner="state"),
        )
    each = step.indicators if rules.split else 1
    ahead, later = step.array("ahead", (L, each)), step.array("later", (L, each, size))
    starts = [
        (np.log(p.probability) if p.probability else -np.inf, p.mean, p.cov) for p in system.initial
    ]
    with step.when(first):
        for i, (s, mean, cov) in enumerate(starts):
            for g in range(each):
                ahead.store(s if g == 0 else -np.inf, i, g)
                later.store([*mean, *lower_of(cov)], i, g)
    with step.when(~first), step.since(t - old):
        heavy, high = relative(list(score.all))
        laws = [unpacked(law[i], n) for i in range(L)]
        if rules.switch is not None:  # the new mode drives the step: a switch, then a move
            still = [[b and b.still for b in row] for row in system.branches]
            rows = [list(BranchMoments(system, rule, old, *laws[i])(still[i])) for i in range(L)]
            mixed = [mixture([(heavy[i], rows[i][l]) for i in range(L)]) for l in range(L)]
            heavy, laws = [m[0] for m in mixed], [m[1:] for m in mixed]
        rows = []
        for i in range(L):
            branches = staying(system, i) if system.drives == "new" else system.branches[i]
            if rules.split:
                branches = [
                    b and r and Moved(_seen(b.map, r))
                    for b, row in zip(branches, system.readings, strict=True)
                    for r in row
                ]
            rows.append(list(BranchMoments(system, rule, old, *laws[i])(branches)))
        for p in range(L * each):
            total, mean, cov = mixture([(heavy[i], rows[i][p]) for i in range(L)])
            ahead.store(
                high + np.log(total) if type(total) is Scalar else -np.inf, p // each, p % each
            )
            later.store([*mean, *lower_of(cov)], p // each, p % each)
    width = n + step.m
    joint, sensed = step.array("joint", (L, width * (width + 3) // 2)), step.array("sensed", (L,))
    possible = step.array("possible", (1,))
    cases = [(-1, None)] + [(j, j) for j in range(step.indicators)]
    for number, j in cases:
        if step.indicators:
            with step.when(compared(step.indicator, "==", float(number))):
                sense(step, t, ahead, later, j, joint, sensed, each)
        else:
            sense(step, t, ahead, later, 0, joint, sensed, each)
    some = choose(any_of([s > -np.inf for s in sensed.all]), 1.0, 0.0)
    possible.store([some])
    if step.indicators:
        with step.when(some < 1.0):  # what no mode can show says nothing
            sense(step, t, ahead, later, None, joint, sensed, each)
    scores, laws, expected = [], [], []
    for i in range(L):
        mean, cov = unpacked(joint[i], width)
        moments = mean[n:], cov[:n, n:], cov[n:, n:]
        found, rest, density, _ = correct(mean[:n], cov[:n, :n], step.y, moments, n, rules.periods)
        scores.append(choose(sensed[i] > -np.inf, sensed[i] + density, -np.inf))
        laws.append((found, rest))
        expected.append(mean[n:])
    weight, high = relative(scores)
    total = high + np.log(sum(weight))
    sound = isfinite(total)
    kept, high_kept = relative(list(sensed.all))
    least = high_kept + np.log(sum(kept))
    scores = [choose(sound, a - total, b - least) for a, b in zip(scores, sensed.all, strict=True)]
    probs = [np.exp(s) for s in scores]
    loglik = choose(possible[0] > 0.0, total, -np.inf)
    mean, cov = mix(probs, [m for m, _ in laws], [p for _, p in laws], False)[1:]
    likeliest, chosen = probs[0], float(L - 1)
    for p in probs[1:]:
        likeliest = np.maximum(likeliest, p)
    for i in reversed(range(L - 1)):
        chosen = choose(probs[i] >= (1.0 - TIE) * likeliest, float(i), chosen)
    step.mean.store(mean)
    prob.store(probs)
    mode.store(chosen)
    if not step.designed:
        step.cov.store(cov)
        step.loglik.store(loglik)
        score.store(scores)
        law.store([[*m, *lower_of(p)] for m, p in laws])
        step.last_time.store(t)
        step.started.store(1.0)
        return
    step.cov.store(choose(after_gap, np.nan, cov))
    step.loglik.store(choose(before, np.nan, loglik))
    share = [w / sum(kept) for w in kept]
    seen = choose(
        np.array([isnan(p) for p in step.y]),
        sum(s * e for s, e in zip(share, expected, strict=True)),
        step.y,
    )
    remember(mean, seen, chosen, scores)
    step.end(k)


class Moved:
    constant = False

    def __init__(self, map):
        self.map = map


def _seen(move, reading):
    there = dict(zip(reading.map.state, move.expressions, strict=True))
    weight = move.weight_expression * reading.probability_expression.subs(there, simultaneous=True)
    return StochasticMap(move.state, move.expressions, move.noise, weight, time=move.time)


def mixture(pairs):
    """Law of the next state from weights of the old modes and what each makes of it."""
    known = [(w, row) for w, row in pairs if row is not None]
    if not known:
        n = (
            next(len(row[3]) for _, row in pairs if row is not None)
            if any(r for _, r in pairs)
            else 1
        )
        return -np.inf, np.zeros(n), np.eye(n)
    return mix(
        [w * row[0] for w, row in known],
        [row[3] for _, row in known],
        [row[5] for _, row in known],
        any(row[6] for _, row in known),
    )


def sense(step, t, ahead, later, j, joint, sensed, each):
    """Law of state and measurement in each mode, given the indicator; None is a missing one."""
    system, rule = step.filter.system, step.filter.linearization
    for i in range(step.modes):
        reading = Branch(system.sensors[i]) if j is None else system.readings[i][j]
        if reading is None:
            sensed.store(-np.inf, i)
            joint.store([0.0] * joint.shape[1], i)
            continue
        made = [
            next(iter(BranchMoments(system, rule, t, *unpacked(later[i, g], step.n))([reading])))
            for g in range(each)
        ]
        means = [np.concatenate([row[1], row[3]]) for row in made]
        covs = [np.block([[row[2], row[4]], [row[4].T, row[5]]]) for row in made]
        logs = [ahead[i, g] + np.log(row[0]) for g, row in enumerate(made)]
        if each == 1:
            sensed.store(logs[0], i)
            joint.store([*means[0], *lower_of(covs[0])], i)
            continue
        weight, high = relative(logs)
        total, mean, cov = mix(weight, means, covs, made[0][6])
        sensed.store(high + np.log(total), i)
        joint.store([*mean, *lower_of(cov)], i)


def cells(step, k):
    """What the memory says of mode and state; and how it is renewed."""
    filter, block, n, L = step.filter, step.filter.memory, step.n, step.modes
    if not all(isinstance(fit, CellFit) for fit in filter.fits):
        raise TypeError("fits: wanted laws in cells to write in C")
    odds = L - 1 if block.log_odds else 0
    d = (n + odds) * block.estimates + step.m * block.measurements
    memory = step.array("memory", (max(d, 1),), owner="state")
    modes = step.array("modes", (max(block.estimates, 1),), "int", "state")
    told = step.array("told", (max(block.indicators, 1),), "int", "state")
    score, law = step.array("score", (L,)), step.array("law", (L, n * (n + 3) // 2))
    one, most = n + odds, L**block.estimates * max(step.indicators, 1) ** block.indicators
    tables = {name: [] for name in CellFit._fields}
    for i, fit in enumerate(filter.fits):
        held, seen = min(i + 1, block.estimates), min(i + 1, block.measurements)
        there = np.r_[
            : one * held, one * block.estimates : one * block.estimates + step.m * seen
        ].astype(int)
        for name, part in zip(CellFit._fields, fit, strict=True):
            part = np.moveaxis(part, (-1, -2), (0, 1))
            wide = {"centre": (d,), "white": (d, d), "gain": (n, d)}.get(name, part.shape[2:])
            full = np.zeros((most, L, *wide))
            where = {
                "centre": (there,),
                "white": np.ix_(range(len(there)), there),
                "gain": (slice(None), there),
            }
            full[(slice(0, len(part)), slice(None), *where.get(name, ()))] = part
            tables[name].append(full)
    row, z = np.maximum(k - 1.0, 0.0), memory.all[:d]
    cell = 0.0
    for j in range(block.estimates):  # a memory that fills counts only what is there
        cell = choose(k > float(j), cell * float(L) + modes[j], cell)
    for j in range(block.indicators):
        cell = choose(k > float(j), cell * float(step.indicators) + told[j], cell)
    arrays = {name: step.table(f"cell_{name}", part) for name, part in tables.items()}
    with step.when(k >= 1.0):
        scores = []
        for i in range(L):
            weight, centre, white, gain, offset, cov = (
                arrays[name][row, cell, float(i)] for name in CellFit._fields
            )
            residual = white @ (z - centre) if d else np.zeros(0)
            scores.append(weight - 0.5 * (residual @ residual))
            law.store([*(gain @ z + offset), *lower_of(cov)], i)
        weights, high = relative(scores)
        score.store([s - high - np.log(sum(weights)) for s in scores])

    def remember(mean, seen, mode, scores):
        lead = []
        for s in scores[1:] if odds else ():
            gap = s - scores[0]
            lead.append(choose(isnan(gap), 0.0, np.minimum(np.maximum(gap, -SOFTEST), SOFTEST)))
        step.push(memory, [*mean, *lead], seen)
        for array, count, newest in (
            (modes, block.estimates, mode),
            (told, block.indicators, step.indicator),
        ):
            if count:
                array.store([newest, *array.all[: count - 1]])

    return score, law, remember
