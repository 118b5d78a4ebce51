"""Design of finite-order filters: one forward pass over simulated paths, a fit before each step.

The design is a run of the filter on paths of the system itself, by the same lines that will run
online; before each step the forecast it needs is fitted to the paths. Paths are not stored.
"""

from __future__ import annotations

import warnings
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.blocks import BLOCK, as_seed_sequence, seed_record
from seedslib.base.checks import as_count, as_positive, outside
from seedslib.base.clock import step_count
from seedslib.design.forward_pass import ForwardPass
from seedslib.design.held_out import with_held_out
from seedslib.design.histories import certain
from seedslib.design.paths import Executor, PathSimulator, executor
from seedslib.design.regression import coefficients_of
from seedslib.designed.accuracy import Design
from seedslib.designed.finite_order import FiniteOrderFilter, Rules
from seedslib.designed.memory import Memory
from seedslib.designed.predictors import Affine, Continuous, Polynomial
from seedslib.linearization.moments import Linearization, as_linearization
from seedslib.models.kinds import KINDS, as_grid, as_system, in_steps, switches
from seedslib.models.simulation import Schedule

if TYPE_CHECKING:
    from seedslib.models.kinds import AnySystem

PATHS_PER_COEFFICIENT = 50
"""Fewer design paths than this for each dimension of the memory are worth a warning."""


def check_kinds(
    memory: Memory,
    predictor: Affine | Polynomial | Continuous,
    exact_moments: bool,
    availability: bool,
) -> None:
    """Refuse a memory, a predictor and options that do not go together.

    Raises
    ------
    TypeError, ValueError
        Which, and why.
    """
    if memory.indicators or memory.log_odds:
        raise ValueError(
            f"memory: wanted estimates and measurements, there are no modes here, got {memory}"
        )
    if not isinstance(predictor, Affine | Polynomial | Continuous):
        raise TypeError(f"predictor: wanted Affine, Polynomial or Continuous, got {predictor!r}")
    if isinstance(predictor, Continuous) and memory != Memory(1):
        raise ValueError(f"predictor: Continuous wants the memory of one estimate, got {memory}")
    if exact_moments and not isinstance(predictor, Affine):
        raise ValueError(f"exact_moments: wanted with Affine forecasts, got {predictor}")
    if availability and (exact_moments or isinstance(predictor, Continuous)):
        raise ValueError("availability: wanted Affine or Polynomial forecasts on simulated paths")


def check_paths(paths: int, coefficients: int) -> None:
    """Refuse fewer paths than coefficients, and warn of few.

    Raises
    ------
    ValueError
        Too few.
    """
    if paths <= coefficients + 1:
        raise ValueError(
            f"paths: wanted more than {coefficients + 1} for {coefficients} coefficients, "
            f"got {paths}"
        )
    if paths < PATHS_PER_COEFFICIENT * coefficients:
        warnings.warn(
            f"paths: {paths} are few for {coefficients} coefficients; "
            f"{PATHS_PER_COEFFICIENT * coefficients} or more are advised",
            stacklevel=outside(),
        )


def node_times(times: np.ndarray, nodes: int, step: float | None) -> tuple[np.ndarray, ...]:
    """Node times within each interval; every integration step where there is a `step`."""
    grids = []
    for start, end in pairwise(times):
        parts = nodes + 1 if step is None else step_count(start, end, step)
        grids.append(start + (end - start) * np.arange(1, parts) / parts)
    return tuple(grids)


_AFFINE = Affine()


def synthesize(
    system: AnySystem,
    memory: Memory,
    linearization: Linearization,
    times: ArrayLike,
    *,
    predictor: Affine | Polynomial | Continuous = _AFFINE,
    nodes: Count = 4,
    components: int | None = None,
    paths: Count | None = None,
    seed: Seed | None = None,
    workers: int | Executor = 1,
    exact_moments: bool = False,
    step: float | None = None,
    scheme: str = "euler",
    normalisation: str = "consistent",
    measured: ArrayLike | None = None,
    availability: ArrayLike | None = None,
) -> Any:
    """Design a filter of finite order for a system.

    Theorem 2 and corollary 1 of the jump-diffusion paper: the forecast from the memory is a
    regression, (6.3), and the correction takes Gaussian means, (6.2). With `Taylor` the filter
    is the paper's linearised one, with `ExactGaussian` its Gaussian one.

    Parameters
    ----------
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem
        A switching system takes `paths`, `seed`, `workers` and `normalisation` and gives a
        `SwitchingFilter`; see `seedslib.design.switching.synthesize_switching`.
    memory : Memory
    linearization : Linearization
        How the moments of the sensor are taken.
    times : array_like, shape (K+1,)
        Times of the measurements; the first is that of the initial distribution.
    predictor : Affine, Polynomial or Continuous
    nodes : int
        Number of evenly spaced nodes inside each interval between measurements. `Continuous` has
        a node at every integration step instead; a system in discrete time has none.
    components : int, optional
        n': the first components of the state are estimated (default all).
    paths : int
        Design paths. When the design is finished, an eighth of that number, at least 512, of
        other paths tells what it is worth on paths it has not seen: `held_out`.
    seed : int, SeedSequence or Generator
        The design paths are ``system.simulate(stops, paths, seed)`` with all measurement times
        and nodes as stops; those held out have a stream of their own.
    workers : int or Executor
        Threads, or an executor such as `seedslib.extra.cluster` makes; the filter does not depend
        on it, bit by bit.
    exact_moments : bool
        Take exact moments instead of simulated ones, for a linear system with a linear sensor;
        `paths` and `seed` are then not used, and nothing is held out: the errors are exact.
    step : float, optional
        Largest integration step of the simulation; the system's own by default.
    scheme : {"euler", "heun"}
    normalisation
        As `SwitchingFilter`.
    measured : array_like, optional
        The schedule of the sensor, where it is known in advance: as `simulate` takes it, a mask
        (K+1,) of the times that are measured, or (K+1, m) of the components that are read at
        each. The filter expects just those, and knows its errors with them; a further gap is one
        that it does not know of.
    availability : float or array_like, shape (m,), optional
        Probabilities with which the components that are read arrive. The forecasts are then those
        of what has arrived, by classes of histories, see `seedslib.design.histories`: errors,
        likelihoods and what is expected are known after gaps too, likely or not. The work is that
        of a design for each class, and up to 64 of them.

    Returns
    -------
    FiniteOrderFilter or SwitchingFilter
        The second for a switching system. `predicted` are its errors on the design paths,
        `held_out` those on other paths; printed, they stand side by side.

    Raises
    ------
    TypeError, ValueError
        An argument that does not fit; too few paths; moments that are not finite.
    RuntimeError
        A cluster was lost, or has other versions of the libraries.
    NoClosedForm
        The linearization has no formulas for this sensor; the message offers one that works.

    Warns
    -----
    UserWarning
        Few paths for the memory's dimension; an estimate without information; paths left out;
        errors on the paths held out that are not the predicted ones. Of a switching system also
        many pairs of cell and mode with few paths.
    """
    as_system("system", system, *KINDS)
    if not isinstance(memory, Memory):
        raise TypeError(f"memory: wanted a Memory, got {memory!r}")
    as_linearization(linearization)
    if switches(system):
        from seedslib.design.switching import synthesize_switching

        for name, given in (
            ("predictor", predictor != _AFFINE),
            ("components", components is not None),
            ("exact_moments", exact_moments),
            ("step", step is not None),
            ("scheme", scheme != "euler"),
            ("measured", measured is not None),
            ("availability", availability is not None),
        ):
            if given:
                raise ValueError(f"{name}: wanted none for a switching system")
        return synthesize_switching(
            system,
            memory,
            linearization,
            times,
            paths=paths,
            seed=seed,
            workers=workers,
            normalisation=normalisation,
        )
    if normalisation != "consistent":
        raise ValueError("normalisation: wanted for a switching system only")
    times = as_grid("times", times, system)
    schedule = Schedule.of(measured, availability, len(times), system.sensor.size)
    mask, availability = certain(schedule)
    check_kinds(memory, predictor, exact_moments, availability is not None)
    n = system.state_size
    components = n if components is None else as_count("components", components, 1, n)
    nodes, options, size = as_count("nodes", nodes, 0), {}, None
    if in_steps(system):
        if exact_moments or isinstance(predictor, Continuous):
            raise ValueError("system: exact_moments and Continuous want one in continuous time")
        nodes = 0
    else:
        size = as_positive("step", system.step if step is None else step)
        options = {"step": size, "scheme": scheme}
    grid = node_times(times, nodes, size if isinstance(predictor, Continuous) else None)
    rules = Rules.of(system, memory, predictor, linearization, components)
    filter = partial(
        FiniteOrderFilter,
        system=system,
        memory=memory,
        predictor=predictor,
        linearization=linearization,
        times=times,
        node_times=grid,
        components=components,
        measured=None if mask.all() else mask,
        availability=availability,
    )
    if exact_moments:
        from seedslib.design.exact_moments import linear_design

        return filter(**linear_design(system, rules, times, grid, mask))
    paths = as_count("paths", paths)
    check_paths(paths, coefficients_of(predictor, memory.order(components, system.sensor.size)))
    root = as_seed_sequence(seed)
    with executor(workers) as each:
        simulator = PathSimulator(system, paths, root, each, options)
        forward = ForwardPass(simulator, rules, predictor, mask, availability)
        parts = forward.design(times, grid)
        design = Design(paths, BLOCK, *seed_record(root), simulator.warn_of_diverged())
    del simulator, forward  # their paths are not needed any more
    designed = filter(**parts, design=design)
    return with_held_out(designed, root, paths, workers, **options)
