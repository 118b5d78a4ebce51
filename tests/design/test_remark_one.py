"""Remark 1 of the jump-diffusion paper: forecasts from the measurement and the memory before it."""

import numpy as np

from seedslib import zoo
from seedslib.design import plane_steps, synthesize
from seedslib.designed import large_order
from seedslib.linearization import ExactGaussian
from seedslib.models import PlaneChain

AHEAD = 0.4
ERRORS = {2: (0.414, 0.434, 0.395), 3: (0.479, 0.568, 0.453)}
"""Another program's errors at t_2 + 0.4 and t_3 + 0.4: affine in U, (Y, U before), (U, Y)."""


def test_affine_forms_of_the_remark():
    system, tacts, count = zoo.van_der_pol(), 0.5 * np.arange(5), 16_000
    filter = synthesize(system, large_order(1), ExactGaussian(), tacts, paths=count, seed=1)
    grid = np.sort(np.append(tacts, [tacts[k] + AHEAD for k in ERRORS]))
    at = np.searchsorted(grid, tacts)
    runs = []
    for seed in (2, 3):
        data = system.simulate(grid, count, seed, measured=at)
        y = data.measurements[at]
        runs.append((data.states[:, 0], y, filter.run(tacts, y).mean))
    for k, wanted in ERRORS.items():
        here = np.searchsorted(grid, tacts[k] + AHEAD - 1e-9)
        found = []
        for pick in (
            lambda y, z, k=k: [*z[k]],
            lambda y, z, k=k: [*y[k], *z[k - 1]],
            lambda y, z, k=k: [*z[k], *y[k]],
        ):
            rows = [np.stack([np.ones(count), *pick(y, z)]) for _, y, z in runs]
            weights = np.linalg.lstsq(rows[0].T, runs[0][0][here], rcond=None)[0]
            square = (runs[1][0][here] - weights @ rows[1]) ** 2
            found.append((np.sqrt(square.mean()), square.std() / np.sqrt(count)))
        for (rms, error), other in zip(found, wanted, strict=True):
            assert abs(rms**2 - other**2) < 5 * error
        plain, letter, both = (rms for rms, _ in found)
        assert both < 0.98 * plain
        assert letter > 1.03 * plain


def test_exact_functions_of_both_arguments():
    """E X'² - E f² is the error of f(y, u); the same by forecasting every posterior law."""

    class Kept(PlaneChain):
        def move(self, law, start, stop):
            self.after = law / law.sum()
            return super().move(law, start, stop)

    chain = Kept(zoo.linear_gaussian(), [(-5, 5, 25), (-5, 5, 25)], 0.2)
    values = np.stack([chain.values[0], chain.values[0] ** 2])
    mean, square = chain.back(values, 0.0, AHEAD)
    steps = []
    for step in plane_steps(chain, [0, 0.5, 1], z=[(-3, 4, 8), (-3, 3, 7)], y=(-9, 9, 25)):
        steps.append((step, getattr(chain, "after", None)))
    (step, _), (_, after) = steps[1:]
    first = step.likelihood @ (step.law * mean[:, None])
    known = step.mass > 1e-290
    both = square @ step.law.sum(axis=1) - (first[known] ** 2 / step.mass[known]).sum()
    memory = square @ after.sum(axis=1) - ((mean @ after) ** 2 / after.sum(axis=0)).sum()
    assert both < memory
    # forecasting the posterior laws themselves, a column each
    error = 0.0
    for cell in np.argsort(step.mass.sum(axis=0))[-3:]:
        for event in np.argsort(step.mass[:, cell])[-3:]:
            law = step.likelihood[event] * step.law[:, cell]
            later = PlaneChain.move(chain, law[:, None], 0.0, AHEAD)[:, 0]
            guess = first[event, cell] / step.mass[event, cell]
            error = max(error, abs(chain.values[0] @ later / later.sum() - guess))
    assert error < 2e-3
