"""C of trees, alone, in forests and boosted: arrays that a loop walks from the root to a leaf."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.extra.c.source import constants

_TREES = """\
/* The leaf that a tree leads to; a step to the left is one to the next node. */
static inline int @name_leaf_(int node, const double *given)
{
    while (@name_argument[node] >= 0) {
        const int left = given[@name_argument[node]] <= @name_bound[node];
        node = left ? node + 1 : @name_right[node];
    }
    return node;
}

/* The trees of measurement k: their sum, or their mean. */
static inline void @name_learned_(int k, const double *given, double *out)
{
    int model, tree, i;
    for (model = 0; model < @NAME_MODELS; model++) {
        const int all = k * @NAME_MODELS + model;
        double *found = out + model * (@NAME_ROWS / @NAME_MODELS);
        for (i = 0; i < @NAME_ROWS / @NAME_MODELS; i++) found[i] = @name_base[all];
        for (tree = @name_first[all]; tree < @name_first[all + 1]; tree++) {
            const int leaf = @name_leaf_(@name_root[tree], given);
            @ADD
        }
@MEAN    }
}
"""

_ONE = "*found += @name_bound[leaf];"
_SEVERAL = """\
for (i = 0; i < @NAME_ROWS / @NAME_MODELS; i++) {
                found[i] += @name_leaves[@name_right[leaf]][i];
            }"""
_MEAN = """\
        for (i = 0; i < @NAME_ROWS / @NAME_MODELS; i++) {
            found[i] /= (double)(@name_first[all + 1] - @name_first[all]);
        }
"""


class Tree(NamedTuple):
    """Nodes of a tree, the left one behind each that has some.

    Attributes
    ----------
    argument : ndarray of int, shape (N,)
        Which one is compared; -1 of a leaf.
    bound : ndarray, shape (N,)
        Largest value with which the left node comes.
    right : ndarray of int, shape (N,)
        Number of the other node.
    values : ndarray, shape (N, outputs)
    """

    argument: np.ndarray
    bound: np.ndarray
    right: np.ndarray
    values: np.ndarray


def tree_source(
    models: list[list[Any]], places: list[np.ndarray], size: int
) -> tuple[dict[Any, Any], str]:
    """Macros and C of trees; arguments as of `network_source`.

    Raises
    ------
    ValueError
        Boosted trees that begin with a model of another kind, categories.
    """
    argument, bound, right, leaves, roots = [], [], [], [], []
    base, first, nodes = [], [0], 0
    for row, there in zip(models, places, strict=True):
        for model in row:
            start, trees = _trees(model)
            base.append(start)
            for tree in trees:
                roots.append(nodes)
                leaf = tree.argument < 0
                argument.append(np.where(leaf, -1, there[tree.argument]))
                one = tree.values.shape[1] == 1
                bound.append(np.where(leaf, tree.values[:, 0] if one else 0.0, tree.bound))
                number = len(leaves) + np.cumsum(leaf) - 1  # of its row of several values
                leaves += [] if one else tree.values[leaf].tolist()
                right.append(np.where(leaf, 0 if one else number, tree.right + nodes))
                nodes += len(leaf)
            first.append(len(roots))
    small = "signed char" if size < 128 else "int"
    text = constants("@name_argument", np.concatenate(argument), small)
    text += constants("@name_bound", np.concatenate(bound))
    text += constants("@name_right", np.concatenate(right), "int")
    text += constants("@name_root", roots, "int") + constants("@name_first", first, "int")
    text += constants("@name_base", base)
    text += constants("@name_leaves", leaves) if leaves else ""
    mean = hasattr(models[0][0], "estimators_") and not hasattr(models[0][0], "init_")
    body = _TREES.replace("@ADD", _SEVERAL if leaves else _ONE)
    return {}, text + body.replace("@MEAN", _MEAN if mean else "")


def _trees(model: Any) -> tuple[float, list[Tree]]:
    """What the sum of the trees of a regressor begins with, and the trees."""
    if hasattr(model, "_predictors"):  # boosted on histograms
        rounds = [tree.nodes for (tree,) in model._predictors]
        if any(nodes["is_categorical"].any() for nodes in rounds):
            raise ValueError("regressor: wanted numbers alone for C, got categories")
        return float(np.ravel(model._baseline_prediction)[0]), [_histogram(n) for n in rounds]
    if hasattr(model, "init_"):  # boosted
        constant = getattr(model.init_, "constant_", None)
        if constant is None and model.init != "zero":
            raise ValueError(f"init: wanted a constant for C, got {type(model.init_).__name__}")
        trees = [_exact(tree.tree_) for tree in np.ravel(model.estimators_)]
        trees = [tree._replace(values=model.learning_rate * tree.values) for tree in trees]
        return 0.0 if constant is None else float(np.ravel(constant)[0]), trees
    return 0.0, [_exact(tree.tree_) for tree in getattr(model, "estimators_", [model])]


def _histogram(nodes: np.ndarray) -> Tree:
    leaf = nodes["is_leaf"].astype(bool)
    order = _order(np.where(leaf, -1, nodes["left"].astype(int)), nodes["right"].astype(int))
    return _ordered(
        order, np.where(leaf, -1, nodes["feature_idx"].astype(int)), nodes["num_threshold"],
        nodes["right"].astype(int), nodes["value"][:, None],
    )  # fmt: skip


def _exact(tree: Any) -> Tree:
    order = _order(tree.children_left, tree.children_right)
    leaf = tree.children_left < 0
    return _ordered(
        order, np.where(leaf, -1, tree.feature), single_bound(tree.threshold),
        tree.children_right, tree.value[:, :, 0],
    )  # fmt: skip


def _order(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Numbers of the nodes, each left one behind the one above it."""
    found, waiting = [], [0]
    while waiting:
        node = waiting.pop()
        found.append(node)
        if left[node] >= 0:
            waiting += [int(right[node]), int(left[node])]
    return np.array(found)


def _ordered(order, argument, bound, right, values) -> Tree:
    place = np.zeros(len(order), dtype=int)
    place[order] = np.arange(len(order))
    return Tree(argument[order], bound[order], place[right[order]], values[order])


def single_bound(bound: np.ndarray) -> np.ndarray:
    """Largest numbers that are at most `bound` when they are rounded to single precision.

    The trees of scikit-learn compare such numbers; with these bounds nothing is to be rounded.
    """
    below = np.asarray(bound, dtype=np.float32)
    below = np.where(below > bound, np.nextafter(below, np.float32(-np.inf)), below)
    above = np.nextafter(below, np.float32(np.inf))
    middle = 0.5 * (below.astype(float) + above.astype(float))
    even = below.view(np.int32) % 2 == 0  # a tie is rounded to an even last digit
    return np.where(even, middle, np.nextafter(middle, -np.inf))
