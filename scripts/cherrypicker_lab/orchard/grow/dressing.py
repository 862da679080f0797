"""What pruning and age do to a grown tree: stubs of cut branches, fruiting spurs, wild shoots."""

import numpy as np

from cherrypicker_lab.orchard.grow.growth import curve
from cherrypicker_lab.orchard.grow.tree import Axis, borne_by, without

STUB_M = (0.015, 0.06)
SPUR_M = (0.010, 0.035)
SPUR_RADIUS_M = (0.0021, 0.0035)
SPUR_ON_M = (0.0045, 0.02)  # radii of the wood that bears spurs
_NODE_STEP_M = 0.005


def dress_tree(tree, seed, *, stubs=0, spurs=0.0):
    """Cut branches back to stubs and set spurs, in place.

    `stubs` branches that bear the next order are cut to 15 to 60 mm, with all that they bore.
    `spurs` is the number of spurs of 10 to 35 mm on a metre of branch, on wood of 4.5 to 20 mm
    radius.
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
    gone = borne_by(tree.axes, cut)
    for i in cut - gone:
        axis = tree.axes[i]
        base = tree.axes[axis.parent].radii[axis.parent_node]
        reach = base + rng.uniform(*STUB_M)  # the stub is what stands out of its parent
        keep = max(int(np.searchsorted(axis.arclength, reach)) + 1, 3)
        tree.axes[i] = axis.part(slice(keep))
    tree.axes[:] = without(tree.axes, gone)


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


# What makes trees differ from the generator's own: (low, high), drawn for a tree
SHOOTS_A_M = (0.3, 6.0)  # one-year shoots of a kind a metre of wood; logarithmically even
SHOOT_M = (0.06, 0.9)  # their lengths
SHOOT_BASE_M = (0.0022, 0.0035)  # radius of a short one's foot; 6 mm more a metre of length
SHOOT_TIP_M = (0.0012, 0.0022)
TWIGS_AT_END = (0, 4)  # twigs that go on where an axis ends
CLUSTERS_A_M = (0.5, 12.0)  # clusters of spurs a metre of wood
CLUSTER_M = (0.010, 0.030)  # the spurs' lengths
CLUSTER_RADIUS_M = (0.0020, 0.0045)
DROOP_A_M = (0.1, 0.9)  # how far a drooping limb hangs down at a metre off the stem, m
LOWEST_LIMB_M, LOWEST_SHOOT_M = 0.15, 0.03
BEARS_M = 0.0032  # thinner wood bears no more shoots
MOST = 250  # shoots or clusters of a kind on a tree


def _places(rng, axes, per_metre):
    """Random (axis, node): on average so many a metre of wood thick enough, at most `MOST`."""
    places = []
    for number, axis in enumerate(axes):
        thick = np.flatnonzero(axis.radii >= BEARS_M)[1:]
        length = axis.arclength[-1] * len(thick) / len(axis.points)
        nodes = rng.choice(thick, rng.poisson(per_metre * length)) if len(thick) else ()
        places += [(number, int(node)) for node in nodes]
    return [places[i] for i in rng.permutation(len(places))[:MOST]]


def _shoot(rng, tree, number, node, upright, *, longest=None):
    """Append a shoot: upright 1 grows to the sky, -1 hangs, 0 goes on as its parent does."""
    mother = tree.axes[number]
    length = float(np.exp(rng.uniform(*np.log(SHOOT_M))))
    length = min(length, longest or length)
    aside = rng.normal(size=3) * [1.0, 1.0, 0.4]
    direction = {1: [0.0, 0.0, 1.6], -1: [0.0, 0.0, -0.5], 0: 1.8 * mother.tangents[node]}[upright]
    upturn = {1: 1.0, -1: -2.5, 0: 0.2}[upright] * rng.uniform(0.2, 1.2)
    points = curve(rng, mother.points[node], direction + aside, length, wiggle=0.5, upturn=upturn)
    low = np.flatnonzero(points[:, 2] < LOWEST_SHOOT_M)
    points = points[: low[0]] if len(low) else points
    if len(points) < 3:
        return
    base = min(rng.uniform(*SHOOT_BASE_M) + 0.006 * length, 0.8 * mother.radii[node])
    tip = min(rng.uniform(*SHOOT_TIP_M), 0.9 * base)
    radii = np.linspace(base, tip, len(points))
    tree.axes.append(Axis(points, radii, min(mother.order + 1, 4), number, node))


def _spur_cluster(rng, tree, number, node):
    """Append two to five spurs that fan out from one place."""
    mother = tree.axes[number]
    for _ in range(int(rng.integers(2, 6))):
        way = rng.normal(size=3) + 0.4 * mother.tangents[node] + [0.0, 0.0, 0.3]
        reach = mother.radii[node] + rng.uniform(*CLUSTER_M)
        points = mother.points[node] + np.linspace(0, reach, 5)[:, None] * way / np.linalg.norm(way)
        radius = min(rng.uniform(*CLUSTER_RADIUS_M), 0.8 * mother.radii[node])
        radii = radius * np.linspace(rng.uniform(0.6, 1.0), 1.0, 5)
        tree.axes.append(Axis(points, radii, min(mother.order + 1, 4), number, node))


def thin_out(rng, tree, share):
    """Take a share of the limbs off the stem, with all that they bear: young or pruned trees."""
    limbs = [i for i, axis in enumerate(tree.axes) if axis.parent == 0]
    cut = {i for i in limbs if rng.random() < share}
    tree.axes[:] = without(tree.axes, cut | borne_by(tree.axes, cut))


def droop_limbs(rng, tree, share):
    """Hang a share of the limbs down, with all that they bear, in place."""
    hung = {}
    for number, axis in enumerate(tree.axes):
        if axis.parent < 0:
            continue
        if axis.parent in hung:
            hung[number] = hung[axis.parent]
        elif axis.order == 1 and rng.random() < share:
            hung[number] = (number, axis.points[0].copy(), rng.uniform(*DROOP_A_M))
    for limb in {each[0] for each in hung.values()}:
        borne = [tree.axes[number] for number, each in hung.items() if each[0] == limb]
        _, foot, fall = hung[limb]
        away = [np.square(axis.points[:, :2] - foot[:2]).sum(axis=1) for axis in borne]
        room = [np.divide(axis.points[:, 2] - LOWEST_LIMB_M, square, where=square > 1e-4,
                          out=np.full(len(square), np.inf)).min()
                for axis, square in zip(borne, away)]  # fmt: skip
        for axis, square in zip(borne, away):
            axis.points[:, 2] -= np.clip(fall, 0.0, max(min(room), 0.0)) * square


def run_wild(rng, tree, *, twigs=False):
    """Grow what our own forms lack: shoots, clusters of spurs, drooping limbs; in place.

    With `twigs`, twigs go on where the axes end, as in a tree whose scan ends there.
    """
    if rng.random() < 0.35:
        thin_out(rng, tree, rng.uniform(0.2, 0.95))
    droop_limbs(rng, tree, rng.choice([0.0, rng.random()]))
    axes = list(tree.axes)
    if twigs:
        for number, axis in enumerate(axes):
            for _ in range(int(rng.integers(*TWIGS_AT_END))):
                _shoot(rng, tree, number, len(axis.points) - 1, 0, longest=0.4)
    for upright, share in ((1, 0.7), (-1, 0.4), (0, 0.7)):
        if rng.random() < share:
            for place in _places(rng, axes, np.exp(rng.uniform(*np.log(SHOOTS_A_M)))):
                _shoot(rng, tree, *place, upright)
    if rng.random() < 0.6:
        for place in _places(rng, axes[1:], rng.uniform(*CLUSTERS_A_M)):
            _spur_cluster(rng, tree, place[0] + 1, place[1])
