"""A designed filter in words and numbers."""

from __future__ import annotations

import numpy as np

from seedslib.designed.prediction import held_out_words, with_held_out

ROWS = 12


def headline(designed) -> str:
    """One line: order, memory, forecast, linearization."""
    return (
        f"order {designed.order}: {designed.memory}; {designed.predictor}; {designed.linearization}"
    )


def summary(designed) -> str:
    """Page of text: what the filter is, how it was designed, how accurate it says it is."""
    design, predicted, times = designed.design, designed.predicted, designed.times
    nodes = sum(len(t) for t in designed.node_times)
    made = "exact moments"
    if not design.exact:
        made = f"{design.paths} paths, seed {design.entropy}"
        if design.diverged:
            made += f", {design.diverged} diverged paths left out"
    lines = [
        f"Finite-order filter of {headline(designed)}",
        f"  estimates    {designed.components} of {len(designed.start.mean)} state components",
        f"  measurements {len(times)}, from {times[0]:g} to {times[-1]:g}; {nodes} nodes between",
        f"  forecasts    {designed.between}",
        f"  designed on  {made}",
        "  predicted root-mean-square errors"
        + (" (in-sample, with standard errors)" if predicted.in_sample else ""),
        *held_out_words(designed.held_out),
    ]
    tacts = designed.clock.rows(predicted.times)
    shown = np.arange(len(tacts))
    if len(tacts) > ROWS:
        shown = np.linspace(0, len(tacts) - 1, ROWS).astype(int)
    for k, j in zip(shown, tacts[shown], strict=True):
        row = "  ".join(
            f"{rms:.4f}" + (f" ± {error:.4f}" if predicted.in_sample else "")
            for rms, error in zip(predicted.rms[j], predicted.error[j], strict=True)
        )
        lines += with_held_out(f"    t = {predicted.times[j]:<8g} {row}", designed.held_out, k)
    return "\n".join(lines)
