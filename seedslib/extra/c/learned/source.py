"""C of a filter whose output functions were learned: arguments, functions, forecasts, the step."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.extra.c.forecasts import POWERS, held, polynomials
from seedslib.extra.c.learned.networks import network_source
from seedslib.extra.c.learned.trees import tree_source
from seedslib.extra.c.records import STATE, between, frame, going_on, push
from seedslib.extra.c.source import constants
from seedslib.extra.c.tables import STEP
from seedslib.extra.learned import LearnedFilter

_KINDS = {
    "MLPRegressor": network_source, "HistGradientBoostingRegressor": tree_source,
    "GradientBoostingRegressor": tree_source, "RandomForestRegressor": tree_source,
    "ExtraTreesRegressor": tree_source, "DecisionTreeRegressor": tree_source,
    "ExtraTreeRegressor": tree_source,
}  # fmt: skip
"""Regressors of scikit-learn that have C."""

_LINKED = ("poisson", "gamma")
"""Losses of regressors that learn the logarithm."""

_OUTPUT = """\
/* Output function of measurement k at its arguments: the measurement, then the memory. */
static inline void @name_output_(int k, const double *point, double *out)
{
    double given[@NAME_AXES];
    int i;
    for (i = 0; i < @NAME_AXES; i++) {
        const double p = (point[i] - @name_middle[k][i]) * @name_unit[k][i];
        given[i] = p < @name_low[k][i] ? @name_low[k][i] : p;
        if (p > @name_high[k][i]) given[i] = @name_high[k][i];
    }
    @name_learned_(k, given, out);
}
"""

_AHEAD = """\
/* Forecast from the memory: before the first measurement, for a later one, or at a node. */
static inline void @name_ahead_(int k, const double *u, double *mean)
{
"""

_NODES = """\
/* Forecasts at the nodes from the last measurement to the next, at
 * @name_node_times[@name_node_start[s->k - 1]]@LATER and on. Returns their number. */
static inline int @name_nodes(const @name_state *s, double *out)
{
    int n;
    if (s->k == 0) return 0;
    for (n = @name_node_start[s->k - 1]; n < @name_node_start[s->k]; n++) {
        @name_ahead_(@NAME_TIMES - 1 + n, s->memory, out);
        out += @NAME_ESTIMATE;
    }
    return @name_node_start[s->k] - @name_node_start[s->k - 1];
}

static inline void @name_end_(const @name_state *s, double *out)
{
    @name_ahead_(s->k - 1, s->memory, out);
}
"""

_MARKS = {
    "@TABLE": "", "@TOLD": "", "@WATCH": "", "@DECIDE": "", "@LETTERS": "", "@NEAREST": "",
    "@FIRST": "0", "@LOOK": "",
    "@AHEAD": """\
        memcpy(found, @name_prior, sizeof @name_prior);
        if (s->k > 0) @name_ahead_(s->k - 1, s->memory, found);
""",
    "@OUTPUT": """\
        memcpy(point + @NAME_MEASUREMENT, s->memory, sizeof s->memory);
        @name_output_(s->k, point, found);
""",
}  # fmt: skip


def learned_source(filter: LearnedFilter) -> tuple[dict[Any, Any], str]:
    """Macros and C of a `LearnedFilter`.

    Raises
    ------
    TypeError, ValueError
        A regressor that has no C, only one measurement, forecasts that look further back.
    """
    outputs, blind = zip(*filter.steps, strict=True)
    if len(outputs) < 2:
        raise ValueError(f"times: wanted at least two for C, got {len(outputs)}")
    models = [output.models for output in outputs]
    kind = type(models[0][0])
    if kind.__module__.partition(".")[0] != "sklearn" or kind.__name__ not in _KINDS:
        raise TypeError(
            "regressor: wanted a network or trees of scikit-learn for C, got "
            f"{kind.__name__}; read it off as tables first: filter.tabulated(y=..., z=...)"
        )
    for model in (model for row in models for model in row):
        if getattr(model, "loss", "squared_error") in _LINKED:
            raise ValueError(f"loss: wanted a loss of means for C, got {model.loss!r}")
    macros, timing = frame(filter)
    m, size = macros["MEASUREMENT"], macros["MEASUREMENT"] + filter.order
    macros |= {"AXES": size, "ROWS": filter.components, "MODELS": len(models[0])}
    macros["HELD_MEASUREMENTS"] = filter.memory.measurements
    places = [np.r_[:m, m + held(filter, k - 1)] for k in range(len(outputs))]
    more, functions = _KINDS[kind.__name__](models, places, size)
    nodes = [(k, fit.fit) for k, row in enumerate(filter.node_fits) for fit in row]
    ahead = [*enumerate(fit.fit for fit in blind[1:]), *nodes]
    tables, powers = polynomials(filter, ahead, ahead[0][1].mean_degree)
    text = "\n".join([
        timing, _arguments(outputs, places, size), functions, _OUTPUT,
        constants("@name_prior", blind[0].estimate), constants("@name_cov", filter.covariances),
        tables + _AHEAD + POWERS.replace("@ROWS", "@NAME_ESTIMATE") + "}\n",
        STATE, push(filter), STEP, _NODES, between(filter),
    ])  # fmt: skip
    for mark, part in _MARKS.items():
        text = text.replace(mark, part)
    return {**macros, **more, **powers}, going_on(filter, text)


def _arguments(outputs: Any, places: list[np.ndarray], size: int) -> str:
    """Tables by which arguments are standardised; what is not yet remembered becomes zero."""
    rows = np.zeros((4, len(outputs), size))
    for k, (output, there) in enumerate(zip(outputs, places, strict=True)):
        rows[:, k, there] = output.centre, output.scale, *output.ends
    names = ("middle", "unit", "low", "high")
    return "".join(constants(f"@name_{n}", part) for n, part in zip(names, rows, strict=True))
