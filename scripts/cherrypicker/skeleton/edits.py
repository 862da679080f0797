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
    # (3,) each: ``from`` and ``to``, or ``at``, in the skeleton's frame and unit
    places: dict[str, np.ndarray]
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


def apply_edits(
    skeleton: Skeleton, edits: list[Edit], path: str | os.PathLike | None = None
) -> tuple:
    """Apply edits one after the other.

    connect: the wood at ``from`` leaves what it hung on and hangs on the node at ``to``; a piece
    that was cut off before is joined there. cut: the wood from ``at`` outwards comes off; what no
    later ``connect`` joins again is gone. delete: the wood from ``at`` outwards is gone. move: the
    node at ``from`` goes to ``to``.

    With the skeleton comes a report: ``n_edits``, ``n_applied``, ``lost`` (a sentence each) and
    ``length_dropped``. A `StageError`, which names their file ``path``, where an edit would close a
    cycle, or nothing of the tree is left.
    """
    import networkx as nx

    n, points = len(skeleton), skeleton.points.copy()
    usual = float(np.median(skeleton.edge_length[1:])) if n > 1 else 0.0
    gap = skeleton.fields.get("gap", np.zeros(n, dtype=np.int64)).copy()
    wood = nx.DiGraph()  # from each node's parent to it
    wood.add_nodes_from(range(n))
    ways = zip(skeleton.parent[1:].tolist(), range(1, n), gap[1:].tolist(), strict=True)
    wood.add_weighted_edges_from(ways, weight="gap")
    lost = []
    for number, edit in enumerate(edits, start=1):
        anchors = ("from",) if edit.kind == "move" else PLACES[edit.kind]
        rows = np.array(list(wood), dtype=np.int64)  # what is not deleted
        away, nearest = cKDTree(points[rows]).query([edit.places[name] for name in anchors])
        missing = [name for name, far in zip(anchors, away) if far > edit.tolerance]
        if missing:
            lost.append(
                f"edit {number} ({edit}): no node within {edit.tolerance:g} of {missing[0]}"
            )
            logger.warning("lost %s", lost[-1])
            continue
        start, target = rows[nearest[[0, -1]]].tolist()
        if edit.kind == "move":
            points[start] = edit.places["to"]
        elif edit.kind == "connect":
            way, other = (nx.ancestors(wood, node) | {node} for node in (start, target))
            if not way & other:  # a piece turns round, so that it hangs from this node
                turned = list(wood.subgraph(way).edges.data("gap"))
                wood.remove_edges_from(turned)
                wood.add_weighted_edges_from(((b, a, g) for a, b, g in turned), weight="gap")
            elif start in other:
                raise StageError(
                    f"edit {number} ({edit}) would close a cycle: 'to' lies beyond 'from'",
                    file=path,
                    key="graph.edits",
                )
            wood.remove_edges_from(list(wood.in_edges(start)))
            length = np.linalg.norm(points[start] - points[target])
            wood.add_edge(target, start, gap=int(length > BARE_STEPS * usual))
        elif start == 0:
            cause = f"edit {number} ({edit}) would remove the root"
            raise StageError(cause, file=path, key="graph.edits")
        elif edit.kind == "cut":
            wood.remove_edges_from(list(wood.in_edges(start)))
        else:
            wood.remove_nodes_from({start, *nx.descendants(wood, start)})
        logger.info("applied edit %d (%s)", number, edit)
    keep = sorted({0, *nx.descendants(wood, 0)}) if 0 in wood else []  # what hangs on the root
    if len(keep) < 2:
        raise StageError("the edits leave nothing of the tree", file=path, key="graph.edits")
    for _, node, is_bare in wood.edges.data("gap"):
        gap[node] = is_bare
    edges = np.searchsorted(keep, np.array(wood.subgraph(keep).edges))
    order, parent = rooted_order(len(keep), edges, 0)
    changed = replace(skeleton, points=points, fields=skeleton.fields | {"gap": gap})
    edited = changed.take(np.array(keep)[order], parent)
    dropped = max(float(skeleton.edge_length.sum() - edited.edge_length.sum()), 0.0)
    report = {
        "n_edits": len(edits),
        "n_applied": len(edits) - len(lost),
        "lost": lost,
        "length_dropped": round(dropped, 6),
    }
    return edited, report
