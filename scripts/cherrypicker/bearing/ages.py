"""Ages along a tree: a Markov chain from the foot to each tip, with branches.

The state of the wood at a node is its type, age and phase (`cherrypicker.bearing.rates.Rates`).
Towards the tip it only gets younger, and a lateral is younger than what bears it, so that wood that
bears is at least two years old. What is seen are lengths, laterals, ends and radii. One pass from
the tips gathers what lies beyond each node, one from the foot tells each node's chances
(belief propagation on a tree: Pearl, Probabilistic Reasoning, 1988).
"""

from dataclasses import dataclass

import numpy as np

from cherrypicker.bearing.rates import LONG, Rates
from cherrypicker.skeleton import Axis, Skeleton

_STEP_M = 2e-4  # to which lengths of edges are rounded: a hundredth of the shortest increment


@dataclass
class Ages:
    """What is known of the wood at each node, which stands for the edge below it."""

    chance: np.ndarray  # (n_nodes, 2, n_ages) float64: of each type and age
    length: np.ndarray  # (n_nodes,) float64: of the edge, beyond the bark of what bears it


def bare_lengths(skeleton: Skeleton, axis_list: list[Axis]) -> np.ndarray:
    """Length of each node's edge outside the wood that its axis hangs on, (n_nodes,) float64."""
    length = skeleton.edge_length.copy()
    for axis in axis_list:
        if axis.attach >= 0:
            far = np.cumsum(length[axis.nodes])
            far = np.maximum(far - skeleton.radius[axis.attach], 0.0)
            length[axis.nodes] = np.diff(far, prepend=0.0)
    return length


def age_tree(
    skeleton: Skeleton, axis_list: list[Axis], rates: Rates, dated: np.ndarray | None = None
) -> Ages:
    """Tell the ages of a tree's wood, by its skeleton in metres and its axes, bearers first.

    How thick wood of an age is differs by tree and by scan: the ages are those at several such
    factors, weighed by how well the whole tree agrees with each. What another date tells, ``dated``
    (n_nodes, n_ages), are log odds a metre of each age, see `cherrypicker.bearing.two_dates`.
    """
    length = bare_lengths(skeleton, axis_list)
    chain = _Chain(skeleton.parent, axis_list, length, rates)
    # Log likelihood of each node's radius by state, (n_nodes, n_states)
    error = np.nan_to_num(skeleton.fields.get("radius_error", np.zeros(len(skeleton))))
    is_known = skeleton.radius > 0
    thick = np.where(is_known, skeleton.radius, 1.0)
    variance = rates.of_states(rates.log_radius_sd) ** 2 + (error / thick)[:, None] ** 2
    off = np.log(thick)[:, None] - rates.of_states(rates.log_radius)
    says = (is_known * np.minimum(length / rates.radius_run_m, 1.0))[:, None]
    dated = np.zeros((len(skeleton), rates.n_ages)) if dated is None else dated
    by_date = np.repeat(np.tile(length[:, None] * dated, 2), rates.phases, axis=1)
    spread = rates.log_radius_tree_sd
    factors, found = spread * np.linspace(-2.0, 2.0, 9), []
    for thicker in factors:
        seen = -0.5 * ((off - thicker) ** 2 / variance + np.log(variance)) * says
        beyond, log = chain.from_the_tips(seen + by_date)
        found.append((log - 0.5 * (thicker / spread) ** 2, beyond))
    logs = np.array([log for log, _ in found])
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    chance = np.zeros((len(skeleton), 2, rates.n_ages))
    for (_, beyond), share in zip(found, weight, strict=True):
        chance += share * chain.from_the_foot(beyond)
    return Ages(chance, length)


class _Chain:
    """The chain on one tree: what follows from what, and what is asked of the ends."""

    def __init__(
        self, parent: np.ndarray, axis_list: list[Axis], length: np.ndarray, rates: Rates
    ) -> None:
        self.rates, self.parent = rates, parent.tolist()
        self.tips = [axis.nodes[-1] for axis in axis_list]
        rounded, which = np.unique(np.round(length / _STEP_M), return_inverse=True)
        steps = rates.steps(rounded * _STEP_M)
        laterals = rates.lateral_rate @ steps
        self.ways = steps[which]  # of each node: how its state follows from the one before
        starts = [axis.nodes[0] for axis in axis_list if axis.attach >= 0]
        self.ways[starts] = laterals[which[starts]]
        first = np.zeros((2, rates.n_ages, rates.phases))
        first[LONG, :, 0] = 1 / rates.n_ages  # the foot is long wood of any age
        self.first = first.ravel() @ self.ways[0]

    def from_the_tips(self, seen: np.ndarray) -> tuple[np.ndarray, float]:
        """Gather what lies beyond each node, (n_nodes, n_states), and the tree's log likelihood."""
        most = seen.max(axis=1, keepdims=True)
        beyond, log = np.exp(seen - most), float(most.sum())
        beyond[self.tips] *= self.rates.end_rate
        for node in reversed(range(len(beyond))):
            total = beyond[node].max()
            beyond[node] /= total
            log += np.log(total)
            if node:
                beyond[self.parent[node]] *= self.ways[node] @ beyond[node]
        return beyond, log + float(np.log(self.first @ beyond[0]))

    def from_the_foot(self, beyond: np.ndarray) -> np.ndarray:
        """Chances (n_nodes, 2, n_ages), see `Ages`."""
        chance = np.zeros_like(beyond)
        chance[0] = self.first * beyond[0]
        chance[0] /= chance[0].sum()
        for node in range(1, len(beyond)):  # parents before children
            follows = self.ways[node] * beyond[node]
            total = follows.sum(axis=1, keepdims=True)
            follows /= np.where(total > 0, total, 1.0)
            chance[node] = chance[self.parent[node]] @ follows
        by_age = chance.reshape(len(beyond), 2, self.rates.n_ages, self.rates.phases)
        return by_age.sum(axis=3)
