"""Hand corrections of a skeleton, anchored in space so that they survive another run.

An edit names places, not nodes: the nearest node within a tolerance is meant. Where none is, the
edit is lost, which is reported and changes nothing. The result is one rooted tree, or an error.
"""

import logging
import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.errors import StageError
from cherrypicker.files import is_number, parse_yaml
from cherrypicker.skeleton.model import Skeleton, rooted_order

logger = logging.getLogger(__name__)

PLACES = {"connect": ("from", "to"), "cut": ("at",), "delete": ("at",), "move": ("from", "to")}
TOLERANCE_M = 0.05
BARE_STEPS = 3.0  # usual edge lengths from which a new edge bridges missing data


@dataclass
class Edit:
    """One correction."""

    kind: str  # {"connect", "cut", "delete", "move"}
    # dict of str to ndarray of shape (3,): ``from`` and ``to``, or ``at``, in the skeleton's
    # frame and unit
    places: dict
    tolerance: float = TOLERANCE_M  # how far the node that is meant may lie from its place

    def __str__(self) -> str:
        places = ", ".join(
            f"{name} ({', '.join(f'{value:g}' for value in place)})"
            for name, place in self.places.items()
        )
        return f"{self.kind} {places}"


def read_edits(path: str | os.PathLike, tree: str | None = None) -> list[Edit]:
    """Read a tree's edits: a YAML list under ``edits``, applied in its order.

    `tree` is the only one that a key ``tree`` beside ``edits`` may name. A `StageError` where the
    file cannot be read, is of another tree, or an entry is no edit.
    """
    try:
        content = parse_yaml(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StageError(f"the edits cannot be read ({error})", file=path) from error
    content = content if isinstance(content, dict) else {}
    named, entries = content.get("tree", tree), content.get("edits")
    if tree is not None and named != tree:
        raise StageError(f"the edits are of tree {named!r}, not of {tree!r}", file=path, key="tree")
    if not isinstance(entries, list):
        raise StageError("no list under 'edits'", file=path, key="edits")
    return [_parsed(entry, number, path) for number, entry in enumerate(entries, start=1)]


def _parsed(entry: dict, number: int, path: str | os.PathLike) -> Edit:
    key = f"edits, entry {number}"
    kinds = [kind for kind in PLACES if isinstance(entry, dict) and kind in entry]
    if len(kinds) != 1 or not set(entry) <= {kinds[0], "tolerance_m", "note"}:
        raise StageError(
            f"an edit has one of {', '.join(PLACES)}, and may have tolerance_m and note",
            file=path,
            key=key,
        )
    kind, given = kinds[0], entry[kinds[0]]
    if not isinstance(given, dict) or set(given) != set(PLACES[kind]):
        raise StageError(f"{kind} needs {' and '.join(PLACES[kind])}", file=path, key=key)
    for place in given.values():
        if not (isinstance(place, list) and len(place) == 3 and all(map(is_number, place))):
            raise StageError("a place is three finite numbers [x, y, z]", file=path, key=key)
    tolerance = entry.get("tolerance_m", TOLERANCE_M)
    if not (is_number(tolerance) and tolerance > 0):
        raise StageError("tolerance_m must be a positive number", file=path, key=key)
    places = {name: np.array(given[name], dtype=np.float64) for name in PLACES[kind]}
    return Edit(kind, places, float(tolerance))


def apply_edits(skeleton: Skeleton, edits: list[Edit]) -> tuple:
    """Apply edits one after the other.

    connect: the wood at ``from`` leaves what it hung on and hangs on the node at ``to``; a piece
    that was cut off before is joined there. cut: the wood from ``at`` outwards comes off; what no
    later ``connect`` joins again is gone. delete: the wood from ``at`` outwards is gone. move: the
    node at ``from`` goes to ``to``.

    With the skeleton comes a report: ``n_edits``, ``n_applied``, ``lost`` (a sentence each) and
    ``length_dropped``. A `StageError` where an edit would close a cycle, or nothing of the tree is
    left.
    """
    tree = _EditedTree(skeleton)
    lost = []
    for number, edit in enumerate(edits, start=1):
        anchors = ("from",) if edit.kind == "move" else PLACES[edit.kind]
        nodes = [tree.nearest(edit.places[name], edit.tolerance) for name in anchors]
        missing = [name for name, node in zip(anchors, nodes) if node < 0]
        if missing:
            lost.append(
                f"edit {number} ({edit}): no node within {edit.tolerance:g} of {missing[0]}"
            )
            logger.warning("lost %s", lost[-1])
            continue
        tree.apply(number, edit, nodes)
        logger.info("applied edit %d (%s)", number, edit)
    edited, dropped = tree.result()
    report = {
        "n_edits": len(edits),
        "n_applied": len(edits) - len(lost),
        "lost": lost,
        "length_dropped": round(dropped, 6),
    }
    return edited, report


class _EditedTree:
    """Nodes and parents while they are edited; -1 is the parent of the root and of cut pieces."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self.points, self.parent = skeleton.points.copy(), skeleton.parent.copy()
        self.gap = skeleton.fields.get("gap", np.zeros(len(skeleton), dtype=np.int64)).copy()
        self.alive = np.ones(len(skeleton), dtype=bool)

    def nearest(self, place: np.ndarray, tolerance: float) -> int:
        """Living node nearest to a place, -1 if none lies within the tolerance."""
        rows = np.flatnonzero(self.alive)
        distance, index = cKDTree(self.points[rows]).query(place)
        return int(rows[index]) if distance <= tolerance else -1

    def apply(self, number: int, edit: Edit, nodes: list[int]) -> None:
        """Apply one edit whose nodes were found."""
        if edit.kind == "move":
            self.points[nodes[0]] = edit.places["to"]
        elif edit.kind == "connect":
            start, target = nodes
            way, other = self._way_down(start), self._way_down(target)
            if way[-1] != other[-1]:  # a piece turns round, so that it hangs from this node
                self.parent[way[1:]], self.gap[way[1:]] = way[:-1], self.gap[way[:-1]]
            elif start in other:
                raise StageError(
                    f"edit {number} ({edit}) would close a cycle: 'to' lies beyond 'from'",
                    key="graph.edits",
                )
            self.parent[start] = target
            length = np.linalg.norm(self.points[start] - self.points[target])
            usual = float(np.median(self.skeleton.edge_length[1:])) if len(self.parent) > 1 else 0.0
            self.gap[start] = int(length > BARE_STEPS * usual)
        elif nodes[0] == 0:
            raise StageError(f"edit {number} ({edit}) would remove the root", key="graph.edits")
        elif edit.kind == "cut":
            self.parent[nodes[0]] = -1
        else:
            self.alive[self._beyond(nodes[0])] = False

    def _way_down(self, node: int) -> list[int]:
        way = [node]
        while self.parent[way[-1]] >= 0:
            way.append(int(self.parent[way[-1]]))
        return way

    def _beyond(self, node: int) -> np.ndarray:
        """A node and all that hangs on it, (n_nodes,) bool."""
        beyond = np.zeros(len(self.parent), dtype=bool)
        beyond[node] = True
        while True:
            more = ~beyond & (self.parent >= 0) & beyond[np.maximum(self.parent, 0)]
            if not more.any():
                return beyond
            beyond |= more

    def result(self) -> tuple[Skeleton, float]:
        """Skeleton of what hangs on the root, and the length of what does not."""
        keep = self._beyond(0) & self.alive
        if np.count_nonzero(keep) < 2:
            raise StageError("the edits leave nothing of the tree", key="graph.edits")
        rows, place = np.flatnonzero(keep), np.cumsum(keep) - 1
        edges = np.stack([place[self.parent[rows[1:]]], np.arange(1, len(rows))], axis=1)
        order, parent = rooted_order(len(rows), edges, 0)
        old, fields = self.skeleton, self.skeleton.fields | {"gap": self.gap}
        edited = replace(old, points=self.points, fields=fields).take(rows[order], parent)
        return edited, max(float(old.edge_length.sum() - edited.edge_length.sum()), 0.0)
