"""Ages along a tree: a Markov chain from the foot to each tip, with branches.

The state of the wood at a node is its type, age and phase (`cherrypicker.bearing.rates.Rates`).
Towards the tip it only gets younger, and a lateral is younger than what bears it, so that wood that
bears is at least two years old. What is seen are lengths, laterals, ends and radii. One pass from
the tips gathers what lies beyond each node, one from the foot tells each node's chances or draws
the whole tree (belief propagation on a tree: Pearl, Probabilistic Reasoning, 1988).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cherrypicker.bearing.rates import Rates
from cherrypicker.skeleton import Axis, Skeleton

_STEP_M = 1e-4  # to which lengths of edges are rounded: rates hardly change over it


@dataclass
class Ages:
    """What is known of the wood at each node, which stands for the edge below it.

    Attributes
    ----------
    chance : ndarray of shape (n_nodes, 2, n_ages), float64
        Of each type and age.
    drawn : ndarray of shape (n_draws, n_nodes), int64
        Trees drawn from what is known: at each node ``type * n_ages + age - 1``.
    length : ndarray of shape (n_nodes,), float64
        Of the edge, beyond the bark of what bears it.
    """

    chance: np.ndarray
    drawn: np.ndarray
    length: np.ndarray


def bare_lengths(skeleton: Skeleton, axis_list: list[Axis]) -> np.ndarray:
    """Length of each node's edge outside the wood that its axis hangs on, (n_nodes,) float64."""
    length = skeleton.edge_length.copy()
    for axis in axis_list:
        if axis.attach >= 0:
            far = np.cumsum(length[axis.nodes])
            far = np.maximum(far - skeleton.radius[axis.attach], 0.0)
            length[axis.nodes] = np.diff(far, prepend=0.0)
    return length


def _radius_chances(skeleton: Skeleton, radius: np.ndarray, length: np.ndarray, rates: Rates):
    """Relative chance of each node's radius by state, (n_nodes, n_states) float64."""
    spread = rates.of_states(rates.log_radius_sd)
    error = skeleton.fields.get("radius_error", np.zeros(len(skeleton)))
    thick = np.maximum(radius, 1e-4)
    variance = spread**2 + (np.nan_to_num(error) / thick)[:, None] ** 2
    off = np.log(thick)[:, None] - rates.of_states(rates.log_radius)
    log = -0.5 * (off**2 / variance + np.log(variance))
    log *= np.minimum(length / rates.radius_run_m, 1.0)[:, None]
    return np.exp(log - log.max(axis=1, keepdims=True))


def age_tree(
    skeleton: Skeleton,
    axis_list: list[Axis],
    radius: np.ndarray,
    rates: Rates,
    *,
    n_draws: int = 200,
    seed: int = 0,
) -> Ages:
    """Tell the ages of a tree's wood.

    Parameters
    ----------
    skeleton : Skeleton
        In metres.
    axis_list : list of Axis
        From `cherrypicker.skeleton.axes`: parents before children.
    radius : ndarray of shape (n_nodes,), float64
    rates : Rates
    n_draws : int, default 200
        How many trees are drawn, for the errors of sums.

    Returns
    -------
    Ages
    """
    length = bare_lengths(skeleton, axis_list)
    rounded, which = np.unique(np.round(length / _STEP_M), return_inverse=True)
    steps = rates.steps(rounded * _STEP_M)
    of_node = _radius_chances(skeleton, radius, length, rates)
    hung = {axis.nodes[0]: axis.attach for axis in axis_list if axis.attach >= 0}
    ways = {}  # of a node: how its state follows from its parent's
    order = []
    for axis in axis_list:
        before = axis.attach
        for node in axis.nodes:
            way = steps[which[node]]
            ways[node] = rates.lateral_rate @ way if node in hung else way
            order.append((node, before))
            before = node
    for axis in axis_list:
        of_node[axis.nodes[-1]] *= rates.end_rate
    beyond = of_node
    for node, before in reversed(order):
        beyond[node] /= beyond[node].max()
        if before >= 0:
            beyond[before] *= ways[node] @ beyond[node]
    return Ages(*_from_the_foot(order, ways, beyond, rates, n_draws, seed), length)


def _from_the_foot(order, ways, beyond, rates, n_draws, seed) -> tuple[np.ndarray, np.ndarray]:
    """Chances (n_nodes, 2, n_ages) and drawn trees (n_draws, n_nodes), see `Ages`."""
    rng = np.random.default_rng(seed)
    n_states, phases = beyond.shape[1], rates.phases
    chance = np.zeros_like(beyond)
    drawn = np.zeros((len(beyond), n_draws), dtype=np.int64)
    first = np.zeros(n_states)  # the foot is long wood of any age
    first[: rates.n_ages * phases : phases] = 1.0
    for node, before in order:
        if before < 0:
            chance[node] = first @ ways[node] * beyond[node]
            chance[node] /= chance[node].sum()
            drawn[node] = rng.choice(n_states, n_draws, p=chance[node])
            continue
        follows = ways[node] * beyond[node]
        total = follows.sum(axis=1, keepdims=True)
        follows /= np.where(total > 0, total, 1.0)
        chance[node] = chance[before] @ follows
        up_to = np.cumsum(follows, axis=1)[drawn[before]]
        # A draw is below the row's sum, which rounding leaves a little off 1
        at = rng.random((n_draws, 1)) * up_to[:, -1:]
        drawn[node] = (up_to <= at).sum(axis=1)
    chance = chance.reshape(len(beyond), 2, rates.n_ages, phases).sum(axis=3)
    return chance, (drawn // phases).T
