"""A designed filter in words and numbers."""

from __future__ import annotations

import numpy as np

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
    ]
    tacts = np.searchsorted(predicted.times, times - 1e-9 * max(1.0, abs(times[-1])))
    shown = tacts if len(tacts) <= ROWS else tacts[np.linspace(0, len(tacts) - 1, ROWS).astype(int)]
    for j in shown:
        row = "  ".join(
            f"{rms:.4f}" + (f" ± {error:.4f}" if predicted.in_sample else "")
            for rms, error in zip(predicted.rms[j], predicted.error[j], strict=True)
        )
        lines.append(f"    t = {predicted.times[j]:<8g} {row}")
    return "\n".join(lines)
