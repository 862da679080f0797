"""What pruning and age do to a grown tree: stubs of cut branches, and fruiting spurs."""

import numpy as np

from cherrypicker_lab.orchard.grow.tree import Axis

STUB_M = (0.015, 0.06)
SPUR_M = (0.010, 0.035)
SPUR_RADIUS_M = (0.0021, 0.0035)
SPUR_ON_M = (0.0045, 0.02)  # radii of the wood that bears spurs
_NODE_STEP_M = 0.005


def dress_tree(tree, seed, *, stubs=0, spurs=0.0):
    """Cut branches back to stubs and set spurs, in place.

    Parameters
    ----------
    tree : Tree
    seed : int
    stubs : int
        Branches that bear the next order are cut to 15 to 60 mm, with all that they bore.
    spurs : float
        Spurs of 10 to 35 mm a metre of branch, on wood of 4.5 to 20 mm radius.
    """
    rng = np.random.default_rng([int(seed), 9])
    if stubs:
        _cut(rng, tree, int(stubs))
    if spurs > 0:
        _set_spurs(rng, tree, float(spurs))


def _cut(rng, tree, n):
    parents = np.array([axis.parent for axis in tree.axes])
    bearing = np.unique(parents[parents > 0])
    # a fork at the trunk's end is no branch to prune
    end = len(tree.axes[0].points) - 1
    bearing = [i for i in bearing if tree.axes[i].parent > 0 or tree.axes[i].parent_node < end]
    if not bearing:
        return
    cut = set(rng.choice(bearing, min(n, max(len(bearing) // 4, 1)), replace=False).tolist())
    gone = set()
    for i, axis in enumerate(tree.axes):
        if axis.parent in cut or axis.parent in gone:
            gone.add(i)
    for i in cut - gone:
        axis = tree.axes[i]
        base = tree.axes[axis.parent].radii[axis.parent_node]
        reach = base + rng.uniform(*STUB_M)  # the stub is what stands out of its parent
        keep = max(int(np.searchsorted(axis.arclength, reach)) + 1, 3)
        tree.axes[i] = axis.part(slice(keep))
    new_id = np.cumsum([i not in gone for i in range(len(tree.axes))]) - 1
    tree.axes[:] = [axis for i, axis in enumerate(tree.axes) if i not in gone]
    for axis in tree.axes[1:]:
        axis.parent = int(new_id[axis.parent])


def _set_spurs(rng, tree, per_metre):
    for number, axis in enumerate(list(tree.axes)):
        if axis.order == 0:
            continue
        bears = (axis.radii >= SPUR_ON_M[0]) & (axis.radii <= SPUR_ON_M[1])
        nodes = np.flatnonzero(bears)[1:-1]
        taken = {a.parent_node for a in tree.axes if a.parent == number}
        nodes = np.array([n for n in nodes if n not in taken], dtype=int)
        length = axis.arclength[-1] * len(nodes) / len(axis.points)
        n = min(rng.poisson(per_metre * length), len(nodes))
        for node in np.sort(rng.choice(nodes, n, replace=False)) if n else ():
            tangent = axis.tangents[node]
            side = np.cross(tangent, rng.normal(size=3))
            direction = side / np.linalg.norm(side) + 0.5 * tangent + [0.0, 0.0, 0.3]
            direction /= np.linalg.norm(direction)
            reach = axis.radii[node] + rng.uniform(*SPUR_M)
            s = np.linspace(0, reach, max(int(np.ceil(reach / _NODE_STEP_M)), 3) + 1)
            base = min(rng.uniform(*SPUR_RADIUS_M), 0.7 * axis.radii[node])
            radii = np.linspace(base, 0.9 * base, len(s))
            points = axis.points[node] + s[:, None] * direction
            tree.axes.append(Axis(points, radii, axis.order + 1, number, int(node)))
