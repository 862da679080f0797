"""Trees that we did not grow: skeletons of scanned or digitised trees as trees of a scene.

A skeleton is a CSV file ``id,parent,x,y,z,radius`` in metres, z up, parent -1 at the root. Its
course and branching are taken; its radii are not, which scans floor at what they resolve: they
follow from what each piece of wood bears (Murray's law, Shinozaki's pipes, with a drawn exponent).
"""

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.skeleton.csv_table import read_nodes, rooted_skeleton
from cherrypicker_lab.orchard.grow.growth import end_trunk_by_rule
from cherrypicker_lab.orchard.grow.tree import Axis, Tree

# (low, high) of what is drawn for a tree:
HEIGHT_M = (1.3, 4.5)  # as those of the generator's own trees; logarithmically even
STRETCH = (0.85, 1.2)  # of its height against its width
STEM_RATIO = (0.008, 0.022)  # radius of the stem's foot per height
TIP_RADIUS_M = (0.0020, 0.0045)  # no wood is thinner
EXPONENT = (2.0, 2.7)  # radius**exponent of a stem is the sum of its branches'
GROWTH = (0.5, 6.0)  # what a metre of wood without a branch adds to that sum, in tips
FLARE = (0.0, 0.5)  # how much wider the stem's foot is, over the lowest 5 cm


def read_skeleton(path):
    """Parents (n,), -1 at the root, children of each node, nodes from the root outwards, points.

    Raises a `StageError` if the file is missing or is no skeleton of one tree.
    """
    nodes = read_nodes(path)
    rooted_skeleton(nodes, path)  # says where the nodes are not one tree
    row_of = {number: row for row, number in enumerate(nodes["id"].tolist())}
    parents = np.array([row_of.get(number, -1) for number in nodes["parent"].tolist()])
    if len(parents) < 3:
        raise StageError(f"a tree of {len(parents)} nodes is too small", file=path)
    children = [[] for _ in parents]
    for node, parent in enumerate(parents):
        if parent >= 0:
            children[parent].append(node)
    order = [int(np.flatnonzero(parents < 0)[0])]
    for node in order:
        order += children[node]
    return parents, children, order, nodes["points"]


def tree_from_skeleton(path, rng):
    """A `Tree` of a skeleton file, turned, mirrored, scaled and with radii at random.

    Its foot stands at the origin; the twigs that the skeleton lacks are not added. Errors are those
    of `read_skeleton`.
    """
    parents, children, order, points = read_skeleton(path)
    points = points - points[order[0]]
    height = np.exp(rng.uniform(*np.log(HEIGHT_M)))
    turn = rng.uniform(-np.pi, np.pi)
    c, s = np.cos(turn), np.sin(turn)
    way = np.array([[c, -s, 0], [s, c, 0], [0, 0, rng.uniform(*STRETCH)]])
    way[:, 0] *= rng.choice([-1, 1])
    points = points @ way.T
    points *= height / points[:, 2].max()
    steps = np.linalg.norm(points - points[parents], axis=1)
    growth, exponent = rng.uniform(*GROWTH), rng.uniform(*EXPONENT)
    borne = np.zeros(len(points))
    for node in reversed(order):
        borne[node] = max(borne[node], 1.0)
        if parents[node] >= 0:
            borne[parents[node]] += borne[node] + growth * steps[node]
    foot = height * rng.uniform(*STEM_RATIO)
    radii = foot * (borne / borne[order[0]]) ** (1 / exponent)
    radii = np.maximum(radii, min(rng.uniform(*TIP_RADIUS_M), 0.5 * foot))
    tree = Tree("elsewhere", _axes(points, radii, borne, children, order[0]),
                int(rng.integers(1 << 30)))  # fmt: skip
    stem = tree.axes[0]
    stem.radii = stem.radii * (1 + rng.uniform(*FLARE) * np.exp(-stem.arclength / 0.05))
    end_trunk_by_rule(tree)
    return tree


def _axes(points, radii, borne, children, root):
    """Axes that go on into the child that bears most; parents before children."""
    axes, waiting = [], [(root, None, -1, -1)]
    for first, start, parent, parent_node in waiting:
        row = [first] if start is None else [start, first]
        while children[row[-1]]:
            row.append(max(children[row[-1]], key=borne.__getitem__))
        order = 0 if parent < 0 else min(axes[parent].order + 1, 4)
        thick = radii[row].copy()
        if start is not None:
            thick[0] = thick[1]  # a branch is no thicker inside its parent than outside
        axes.append(Axis(points[row].copy(), thick, order, parent, parent_node))
        for node, (at, onward) in enumerate(zip(row[:-1], row[1:])):
            if start is not None and node == 0:
                continue
            number = len(axes) - 1
            waiting += [(other, at, number, node) for other in children[at] if other != onward]
    return axes
