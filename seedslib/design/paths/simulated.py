"""Design of finite-order filters: one forward pass over simulated paths, a fit before each step.

The design is a run of the filter on paths of the system itself, by the same lines that will run
online; before each step the forecast it needs is fitted to the paths. Paths are not stored.
"""

from __future__ import annotations

import warnings
from os import PathLike
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.blocks import BLOCK, as_seed_sequence, seed_record
from seedslib.base.checks import as_count, as_times, is_whole
from seedslib.base.clock import step_count, when
from seedslib.base.values import Inputs
from seedslib.design.fitting import coefficients_of
from seedslib.design.paths.forward_pass import ForwardPass
from seedslib.design.paths.held_out import examined, forecast_errors
from seedslib.design.paths.walk import Walk, crew
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.finite_order_rules import Rules
from seedslib.designed.memory import Memory
from seedslib.designed.prediction import Design
from seedslib.designed.predictors import Affine, Continuous, Polynomial
from seedslib.linearization.moments import Linearization
from seedslib.models.kinds import KINDS, as_grid, as_system, course_of, in_steps, switches

if TYPE_CHECKING:
    from seedslib.designed.switching.filter import SwitchingFilter
    from seedslib.models.discrete import DiscreteSystem
    from seedslib.models.jump_diffusion import JumpDiffusion
    from seedslib.models.kinds import AnySystem
    from seedslib.models.switching import SwitchingSystem

PATHS_PER_COEFFICIENT = 50
"""Fewer design paths than this for each dimension of the memory are worth a warning."""

_AFFINE = Affine()

OF_ONE_MODE = (
    "predictor", "components", "horizon", "measured_nodes", "exact_moments", "checkpoint", "step",
    "scheme", "bound",
)  # fmt: skip
"""Options of a system without modes."""

OF_MODES = ("normalisation", "split")
"""Options of a system with them."""


# options are not typed by their values: programs keep them in dictionaries
@overload
def synthesize(
    system: SwitchingSystem, memory: Memory, linearization: Linearization, times: ArrayLike, *,
    paths: Any, seed: Any, workers: Any = 1, normalisation: Any = "consistent", split: Any = True,
    inputs: Any = None,
) -> SwitchingFilter: ...  # fmt: skip


@overload
def synthesize(
    system: JumpDiffusion | DiscreteSystem, memory: Memory, linearization: Linearization,
    times: ArrayLike, *, predictor: Any = ..., nodes: Any = 4, components: Any = None,
    paths: Any = None, seed: Any = None, workers: Any = 1, horizon: Any = None,
    measured_nodes: Any = False, exact_moments: Any = False, step: Any = None,
    scheme: Any = "euler", bound: Any = np.inf, checkpoint: Any = None, inputs: Any = None,
) -> FiniteOrderFilter: ...  # fmt: skip


def synthesize(
    system: AnySystem, memory: Memory, linearization: Linearization, times: ArrayLike, *,
    predictor: Any = _AFFINE, nodes: Any = 4, components: int | None = None,
    paths: Count | None = None, seed: Seed | None = None, workers: Any = 1,
    horizon: float | None = None, measured_nodes: bool = False, exact_moments: bool = False,
    step: float | None = None, scheme: str = "euler", bound: float = np.inf,
    checkpoint: str | PathLike[str] | None = None, normalisation: str = "consistent",
    split: bool = True, inputs: Inputs | None = None,
) -> Any:  # fmt: skip
    """Design a filter of finite order for a system.

    Theorem 2 and corollary 1 of the jump-diffusion paper: the forecast from the memory is a
    regression, (6.3), and the correction takes Gaussian means, (6.2). With `Taylor` the filter
    is the paper's linearised one, with `ExactGaussian` its Gaussian one.

    Parameters
    ----------
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem
        A switching system takes `paths`, `seed`, `workers`, `inputs`, `normalisation` and `split`
        and gives a `SwitchingFilter`; see `seedslib.design.paths.switching.synthesize_switching`.
    memory : Memory
    linearization : Linearization
        How the moments of the sensor are taken.
    times : array_like, shape (K+1,)
        Times of the measurements; the first is that of the initial law.
    predictor : Affine, Polynomial or Continuous
    nodes : int or sequence of array_like
        Number of evenly spaced nodes inside each interval between measurements, or the node
        times of each. `Continuous` has a node at every integration step instead; a system in
        discrete time has none.
    components : int, optional
        n': the first components of the state are estimated (default all).
    paths : int
        Design paths. When the design is finished, an eighth of that number, at least 512, of
        other paths tells what it is worth on paths it has not seen: `held_out`.
    seed : int, SeedSequence or Generator
        The design paths are ``system.simulate(stops, paths, seed)`` with all measurement times
        and nodes as stops; those held out have a stream of their own.
    workers : int or Crew
        Threads, or a crew such as `seedslib.extra.cluster` makes; the filter does not depend on
        it, bit by bit.
    horizon : float, optional
        Last time to forecast, after the last measurement.
    measured_nodes : bool
        Let the forecasts at the nodes look at the last measurement as well as at the memory
        that its estimate is in: remark 1 of the paper.
    exact_moments : bool
        Take exact moments instead of simulated ones, for a linear system with a linear sensor;
        `paths` and `seed` are then not used, and nothing is held out: the errors are exact.
    step : float, optional
        Largest integration step of the simulation; the system's own by default.
    scheme : {"euler", "heun"}
    bound : float
        A design path with a component beyond it is left out from there on, as are paths that
        overflow.
    checkpoint : path, optional
        File that a design is written to after each step between measurements; the same call goes
        on from it, to the same numbers, here or on a cluster. It is replaced as a whole and
        stays when the design is finished; the held-out paths are then run again.
    normalisation, split
        As `SwitchingFilter`.
    inputs : mapping of Input to array_like, shape (K+1,), optional
        Values of the inputs that the system mentions. A run is told them again; an input of which
        only a law is known is a component of the state.

    Returns
    -------
    FiniteOrderFilter or SwitchingFilter
        The second for a switching system. `predicted` are its errors on the design paths,
        `held_out` those on other paths; printed, they stand side by side.

    Raises
    ------
    TypeError, ValueError
        An argument that does not fit; too few paths; moments that are not finite; a checkpoint
        that is damaged or belongs to another design.
    RuntimeError
        A crew elsewhere was lost, or has other versions of the libraries.
    NoClosedForm
        The linearization has no formulas for this sensor; the message offers one that works.

    Warns
    -----
    UserWarning
        Few paths for the memory's dimension; an estimate without information; paths left out.
        On the paths held out: errors that are not the predicted ones, an estimate worse than a
        constant, paths on which the filter diverges; corrections worse than their forecasts.
        Of a switching system also many thin pairs of cell and mode, and mended covariances.
    """
    given = locals()
    as_system("system", system, *KINDS)
    switching = switches(system)
    for name in OF_ONE_MODE if switching else OF_MODES:
        if given[name] != synthesize.__kwdefaults__[name]:
            if not switching:
                raise TypeError(f"{name}: wanted for a switching system only")
            raise ValueError(f"{name}: wanted none for a switching system, got {given[name]!r}")
    if not isinstance(memory, Memory):
        raise TypeError(f"memory: wanted a Memory, got {memory!r}")
    if not isinstance(linearization, Linearization):
        raise TypeError(f"linearization: wanted a Linearization, got {linearization!r}")
    if switching:
        from seedslib.design.paths.switching import synthesize_switching

        return synthesize_switching(
            system, memory, linearization, times, paths=paths, seed=seed, workers=workers,
            normalisation=normalisation, split=split, inputs=inputs,
        )  # fmt: skip
    times = as_grid("times", times, system)
    held = course_of(system, inputs, len(times))
    n = system.state_size
    _check_kinds(memory, predictor, measured_nodes, exact_moments)
    components = n if components is None else as_count("components", components, 1, n)
    options, size = {}, None
    if in_steps(system):
        if horizon is not None or exact_moments or isinstance(predictor, Continuous):
            raise ValueError(
                "system: horizon, exact_moments and Continuous want a system in continuous time"
            )
        nodes = 0
    else:
        size = float(system.step if step is None else step)
        if not 0 < size < np.inf:
            raise ValueError(f"step: wanted a positive number, got {step}")
        options = {"step": size, "scheme": scheme}
    grid = _nodes(times, nodes, horizon, size if isinstance(predictor, Continuous) else None)
    rules = Rules.of(system, memory, predictor, linearization, components, measured_nodes)

    def made(start, fits, node_fits, predicted, design):
        return FiniteOrderFilter(
            system=system, memory=memory, predictor=predictor, linearization=linearization,
            times=times, node_times=grid, components=components, start=start, fits=fits,
            node_fits=node_fits, predicted=predicted, design=design,
            measured_nodes=measured_nodes, rules=rules,
        )  # fmt: skip

    if exact_moments:
        from seedslib.design.paths.exact_moments import linear_design

        return made(*linear_design(system, rules, times, grid, held))
    paths = as_count("paths", paths)
    _check_paths(paths, memory, predictor, components, system.sensor.size, measured_nodes)
    root, bound, file = as_seed_sequence(seed), float(bound), None
    if checkpoint is not None:
        from seedslib.design.paths.checkpoint import Checkpoint, identity

        file = Checkpoint(checkpoint, identity(
            system, rules, linearization, predictor, times, grid, paths, root, options, bound, held
        ))  # fmt: skip
    stops = np.concatenate([times, *grid])
    with crew(workers) as each:
        forward = ForwardPass(
            Walk(system, paths, root, len(stops), each, options, bound), rules, predictor
        )
        if file is not None:
            file.restore(forward)
        found = forward.design(times, grid, file and file.write, held)
        lost = forward.walk.warn_of_lost()
        designed = made(*found, Design(paths, BLOCK, *seed_record(root), lost))
        del forward  # its paths are not wanted any more
        return examined(
            designed, root, paths, each, np.unique(stops), options=options, bound=bound,
            forecasts=forecast_errors(designed), course=held,
        )  # fmt: skip


def _check_kinds(memory, predictor, measured_nodes, exact_moments):
    if memory.indicators or memory.log_odds:
        raise ValueError(
            f"memory: wanted estimates and measurements, there are no modes here, got {memory}"
        )
    if not isinstance(predictor, Affine | Polynomial | Continuous):
        raise TypeError(f"predictor: wanted Affine, Polynomial or Continuous, got {predictor!r}")
    if isinstance(predictor, Continuous) and (memory != Memory(1) or measured_nodes):
        raise ValueError(f"predictor: Continuous wants the memory of one estimate, got {memory}")
    if exact_moments and not isinstance(predictor, Affine):
        raise ValueError(f"exact_moments: wanted with Affine forecasts, got {predictor}")


def _check_paths(paths, memory, predictor, components, measured, measured_nodes):
    order = memory.order(components, measured)
    coefficients = max(coefficients_of(predictor, order), order + measured * measured_nodes)
    if paths <= coefficients + 1:
        raise ValueError(
            f"paths: wanted more than {coefficients + 1} for {coefficients} coefficients, "
            f"got {paths}"
        )
    if paths < PATHS_PER_COEFFICIENT * coefficients:
        warnings.warn(
            f"paths: {paths} are few for {coefficients} coefficients; "
            f"{PATHS_PER_COEFFICIENT * coefficients} or more are advised",
            stacklevel=3,
        )


def _nodes(times, nodes, horizon, step) -> tuple:
    """Node times within each interval; with a horizon also after the last measurement."""
    ends = list(times[1:])
    if horizon is not None:
        if not times[-1] < horizon < np.inf:
            raise ValueError(
                f"horizon: wanted a time after the last measurement at {when(times[-1])}, "
                f"got {horizon}"
            )
        ends.append(float(horizon))
    whole = is_whole(nodes)
    if whole:
        as_count("nodes", nodes, 0)
    if not whole and step is None:
        nodes = list(nodes)
        if len(nodes) != len(ends):
            raise ValueError(f"nodes: wanted {len(ends)} lists of times, got {len(nodes)}")
    found = []
    for k, (start, end) in enumerate(zip(times, ends, strict=False)):
        inside = k < len(times) - 1
        if step is not None or whole:
            parts = nodes + 1 if step is None else step_count(start, end, step)
            grid = start + (end - start) * np.arange(1, parts) / parts
        else:
            grid = as_times(f"nodes[{k}]", nodes[k]) if len(nodes[k]) else np.empty(0)
            if len(grid) and not (start < grid[0] and grid[-1] < end):
                raise ValueError(
                    f"nodes: wanted times between {when(start)} and {when(end)}, "
                    f"got {grid[0]:g} to {grid[-1]:g}"
                )
        found.append(grid if inside else np.append(grid, end))
    return tuple(found)
