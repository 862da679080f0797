"""Count the rates of `cherrypicker.bearing.rates.Rates` on trees whose ages are known."""

import numpy as np

from cherrypicker.bearing.ages import bare_lengths
from cherrypicker.skeleton import axes

N_AGES, PHASES = 6, 6
FEW = 0.5  # that every count is taken to have had besides: nothing allowed is impossible
RADIUS_RUN_M = 0.2  # chosen on seen leaders and vases, docs/lab/bearing.md


def count_rates(trees):
    """Rates as plain numbers for YAML, by the names of `Rates`."""
    shape = (2, N_AGES)
    length, runs, laterals, ends = (np.zeros(shape) for _ in range(4))
    on = np.zeros((N_AGES, 2))  # next increment after long wood: long, short
    lateral = np.zeros((N_AGES, 2, N_AGES))
    radii = []  # of each tree: state and logarithm of its nodes
    for tree in trees:
        axis_list = axes(tree.skeleton)
        step = bare_lengths(tree.skeleton, axis_list)
        age, kind = np.minimum(tree.age, N_AGES) - 1, tree.is_spur.astype(int)
        np.add.at(length, (kind, age), step)
        for axis in axis_list:
            nodes = axis.nodes[step[axis.nodes] > 0]
            if not len(nodes):
                continue
            states = np.stack([kind[nodes], tree.age[nodes]], axis=1)
            first = np.append(True, (np.diff(states, axis=0) != 0).any(axis=1))
            np.add.at(runs, (kind[nodes[first]], age[nodes[first]]), 1)
            for at in np.flatnonzero(first)[1:]:
                if kind[nodes[at - 1]] == 0:
                    on[age[nodes[at - 1]], kind[nodes[at]]] += 1
            if tree.age[nodes[-1]] > 1:
                ends[kind[nodes[-1]], age[nodes[-1]]] += 1
            foot = axis.attach
            if foot >= 0 and tree.age[nodes[0]] < tree.age[foot]:
                laterals[kind[foot], age[foot]] += 1
                lateral[age[foot], kind[nodes[0]], age[nodes[0]]] += kind[foot] == 0
        outside = step > 0
        state = N_AGES * kind[outside] + age[outside]
        radii.append((state, np.log(tree.skeleton.radius[outside])))
    allowed = np.arange(N_AGES) < np.arange(N_AGES)[:, None]
    allowed[-1] = True
    lateral = (lateral + FEW) * allowed[:, None, :]
    total = np.maximum(lateral.sum(axis=(1, 2), keepdims=True), 1e-12)
    rates = {
        "increment_m": length / np.maximum(runs, 1),
        "laterals_a_m": (laterals + FEW) / length,
        "ends_a_m": (ends + FEW) / length,
        "goes_short": (on[:, 1] + FEW) / (on.sum(axis=1) + 2 * FEW),
        "lateral": lateral / total,
    }
    rates["laterals_a_m"][:, 0] = rates["ends_a_m"][:, 0] = 0.0
    mean, within, of_trees = _radii(radii)
    rates |= {"log_radius": mean.reshape(shape), "log_radius_sd": within.reshape(shape)}
    plain = {name: np.round(values, 4).tolist() for name, values in rates.items()}
    plain["log_radius_tree_sd"] = round(of_trees, 4)
    return {"phases": PHASES, **plain, "radius_run_m": RADIUS_RUN_M}


def _radii(radii):
    """Mean and spread of logarithms by state, and the spread of the trees' own offsets."""
    state, log = (np.concatenate(each) for each in zip(*radii, strict=True))
    tree = np.repeat(np.arange(len(radii)), [len(each) for each, _ in radii])
    n = np.maximum(np.bincount(state, minlength=2 * N_AGES), 1)
    offset = np.zeros(len(radii))
    for _ in range(20):
        mean = np.bincount(state, log - offset[tree], 2 * N_AGES) / n
        offset = np.bincount(tree, log - mean[state]) / np.bincount(tree)
        offset -= offset.mean()
    within = np.sqrt(np.bincount(state, (log - mean[state] - offset[tree]) ** 2, 2 * N_AGES) / n)
    return mean, within, float(offset.std())
