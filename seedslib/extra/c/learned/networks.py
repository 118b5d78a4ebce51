"""C of networks: layer after layer a matrix product and a function of each number."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.extra.c.source import constants

_ACTIVATIONS = {
    "identity": "sum", "relu": "sum > 0.0 ? sum : 0.0", "tanh": "tanh(sum)",
    "logistic": "1.0 / (1.0 + exp(-sum))",
}  # fmt: skip

_NETWORK = """\
/* The networks of measurement k: each row of a layer is its offset, then its weights. */
static inline void @name_learned_(int k, const double *given, double *out)
{
    double from[@NAME_WIDEST], to[@NAME_WIDEST];
    int model, layer, i, j;
    for (model = 0; model < @NAME_MODELS; model++) {
        int place = 0;
        memcpy(from, given, @NAME_AXES * sizeof *from);
        for (layer = 0; layer < @NAME_LAYERS; layer++) {
            for (i = 0; i < @name_width[layer + 1]; i++) {
                double sum = @name_weight[k][model][place++];
                for (j = 0; j < @name_width[layer]; j++) {
                    sum += @name_weight[k][model][place++] * from[j];
                }
                to[i] = layer < @NAME_LAYERS - 1 ? (@ACTIVATED) : sum;
            }
            memcpy(from, to, (size_t)@name_width[layer + 1] * sizeof *to);
        }
        memcpy(out + model * (@NAME_ROWS / @NAME_MODELS), from,
               (@NAME_ROWS / @NAME_MODELS) * sizeof *out);
    }
}
"""


def network_source(
    models: list[list[Any]], places: list[np.ndarray], size: int
) -> tuple[dict[Any, Any], str]:
    """Macros and C of networks of one shape.

    Parameters
    ----------
    models : list of list of MLPRegressor
        Of each measurement.
    places : list of ndarray of int
        Where the arguments of each measurement's networks are among all.
    size : int
        Number of all arguments.
    """
    first = models[0][0]
    widths = [size, *(part.shape[1] for part in first.coefs_)]
    weights = []
    for row, there in zip(models, places, strict=True):
        weights.append([])
        for model in row:
            entry = np.zeros((size, model.coefs_[0].shape[1]))
            entry[there] = model.coefs_[0]
            parts = zip([entry, *model.coefs_[1:]], model.intercepts_, strict=True)
            flat = [np.column_stack([offset, part.T]).ravel() for part, offset in parts]
            weights[-1].append(np.concatenate(flat))
    text = constants("@name_width", widths, "int") + constants("@name_weight", weights)
    macros = {"LAYERS": len(widths) - 1, "WIDEST": max(widths)}
    return macros, text + _NETWORK.replace("@ACTIVATED", _ACTIVATIONS[first.activation])
