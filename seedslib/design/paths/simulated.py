"""Design of finite-order filters: one forward pass over simulated paths, a fit before each step.

The design is a run of the filter on paths of the system itself, by the same lines that will run
online; before each step the forecast it needs is fitted to the paths. Paths are not stored.
"""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.blocks import BLOCK, as_seed_sequence, seed_record
from seedslib.base.checks import as_count, as_positive
from seedslib.base.values import Inputs
from seedslib.design.paths.arguments import (
    check_available,
    check_kinds,
    check_paths,
    node_times,
)
from seedslib.design.paths.forward_pass import ForwardPass
from seedslib.design.paths.held_out import examined, forecast_errors
from seedslib.design.paths.patterns import PatternPass
from seedslib.design.paths.walk import Walk, crew, require_range
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.finite_order_rules import Rules
from seedslib.designed.memory import Memory
from seedslib.designed.prediction import Design
from seedslib.designed.predictors import Affine, Continuous
from seedslib.linearization.moments import Linearization, as_linearization
from seedslib.models.kinds import KINDS, as_grid, as_system, course_of, in_steps, switches
from seedslib.models.simulation import Schedule

if TYPE_CHECKING:
    from seedslib.designed.switching.filter import SwitchingFilter
    from seedslib.models.discrete import DiscreteSystem
    from seedslib.models.jump_diffusion import JumpDiffusion
    from seedslib.models.kinds import AnySystem
    from seedslib.models.switching import SwitchingSystem

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
    inputs: Any = None, measured: Any = None, availability: Any = None,
) -> SwitchingFilter: ...  # fmt: skip


@overload
def synthesize(
    system: JumpDiffusion | DiscreteSystem, memory: Memory, linearization: Linearization,
    times: ArrayLike, *, predictor: Any = ..., nodes: Any = 4, components: Any = None,
    paths: Any = None, seed: Any = None, workers: Any = 1, horizon: Any = None,
    measured_nodes: Any = False, exact_moments: Any = False, step: Any = None,
    scheme: Any = "euler", bound: Any = np.inf, checkpoint: Any = None, inputs: Any = None,
    measured: Any = None, availability: Any = None,
) -> FiniteOrderFilter: ...  # fmt: skip


def synthesize(
    system: AnySystem, memory: Memory, linearization: Linearization, times: ArrayLike, *,
    predictor: Any = _AFFINE, nodes: Any = 4, components: int | None = None,
    paths: Count | None = None, seed: Seed | None = None, workers: Any = 1,
    horizon: float | None = None, measured_nodes: bool = False, exact_moments: bool = False,
    step: float | None = None, scheme: str = "euler", bound: float = np.inf,
    checkpoint: str | PathLike[str] | None = None, normalisation: str = "consistent",
    split: bool = True, inputs: Inputs | None = None, measured: ArrayLike | None = None,
    availability: ArrayLike | None = None,
) -> Any:  # fmt: skip
    """Design a filter of finite order for a system.

    Theorem 2 and corollary 1 of the jump-diffusion paper: the forecast from the memory is a
    regression, (6.3), and the correction takes Gaussian means, (6.2). With `Taylor` the filter
    is the paper's linearised one, with `ExactGaussian` its Gaussian one.

    Parameters
    ----------
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem
        A switching system takes `paths`, `seed`, `workers`, `inputs`, `measured`, `availability`,
        `normalisation` and `split` and gives a `SwitchingFilter`; see
        `seedslib.design.paths.switching.synthesize_switching`.
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
    as_linearization(linearization)
    require_range(system)
    if switching:
        from seedslib.design.paths.switching import synthesize_switching

        return synthesize_switching(
            system, memory, linearization, times, paths=paths, seed=seed, workers=workers,
            normalisation=normalisation, split=split, inputs=inputs, measured=measured,
            availability=availability,
        )  # fmt: skip
    times = as_grid("times", times, system)
    held = course_of(system, inputs, len(times))
    there, arriving = Schedule.of(measured, availability, len(times), system.sensor.size)
    if arriving is not None:
        check_available(predictor, exact_moments, checkpoint, horizon)
    n = system.state_size
    check_kinds(memory, predictor, measured_nodes, exact_moments)
    components = n if components is None else as_count("components", components, 1, n)
    options, size = {}, None
    if in_steps(system):
        if horizon is not None or exact_moments or isinstance(predictor, Continuous):
            raise ValueError(
                "system: horizon, exact_moments and Continuous want a system in continuous time"
            )
        nodes = 0 * as_count("nodes", nodes, 0)
    else:
        size = as_positive("step", system.step if step is None else step)
        options = {"step": size, "scheme": scheme}
    grid = node_times(times, nodes, horizon, size if isinstance(predictor, Continuous) else None)
    rules = Rules.of(system, memory, predictor, linearization, components, measured_nodes)

    def made(start, fits, node_fits, predicted, design):
        return FiniteOrderFilter(
            system=system, memory=memory, predictor=predictor, linearization=linearization,
            times=times, node_times=grid, components=components, start=start, fits=fits,
            node_fits=node_fits, predicted=predicted, design=design,
            measured_nodes=measured_nodes, rules=rules,
            measured=None if there.all() else there.copy(),
            availability=None if arriving is None else arriving.copy(),
        )  # fmt: skip

    if exact_moments:
        from seedslib.design.paths.exact_moments import linear_design

        return made(*linear_design(system, rules, times, grid, held, there))
    paths = as_count("paths", paths)
    check_paths(paths, memory, predictor, components, system.sensor.size, measured_nodes)
    root, bound, file = as_seed_sequence(seed), float(bound), None
    if checkpoint is not None:
        from seedslib.design.paths.checkpoint import Checkpoint, identity

        file = Checkpoint(checkpoint, identity(
            system, rules, linearization, predictor, times, grid, paths, root, options, bound,
            held, there,
        ))  # fmt: skip
    stops = np.concatenate([times, *grid])
    with crew(workers) as each:
        walk = Walk(system, paths, root, len(stops), each, options, bound)
        if arriving is None:
            forward = ForwardPass(walk, rules, predictor, there)
        else:
            forward = PatternPass(walk, rules, predictor, there, arriving)
        if file is not None:
            file.restore(forward)
        found = forward.design(times, grid, file and file.write, held)
        lost = forward.walk.warn_of_lost()
        designed = made(*found, Design(paths, BLOCK, *seed_record(root), lost))
        del forward, walk  # its paths are not wanted any more
        return examined(
            designed, root, paths, each, np.unique(stops), options=options, bound=bound,
            forecasts=forecast_errors(designed), course=held,
        )  # fmt: skip
