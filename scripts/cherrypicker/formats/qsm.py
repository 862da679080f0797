"""The binary ``.qsm`` of libqsm, format 2: nodes, and edges that are cylinders.

A header in text, then little-endian records: a node is its place as three float32 from the offset
that the header gives, an edge the two nodes' numbers (from 1) and what is in `EDGE`. Axes and
orders count from 1, the stem's. Reference: Roussel, The Arbor book, appendix B, and libqsm 1.0
(https://r-lidar.github.io/arbor_book/spec.html).
"""

import os

import numpy as np

from cherrypicker.files import atomic_path
from cherrypicker.formats.measured import MeasuredTree

EDGE = np.dtype(
    [
        ("source", "<u4"),
        ("target", "<u4"),
        ("radius", "<f4"),
        ("quality", "u1"),
        ("axis_id", "<u4"),
        ("branch_order", "u1"),
        ("subtree_length", "<f4"),  # longest way from the edge's end up to a tip
        ("distance_to_root", "<f4"),  # of the edge's start
    ]
)
# libqsm's levels of quality: a radius that points tell, one that was carried on from others
MEASURED, PROLONGED = 4, 1
_SPACED_OUT = 4  # decimals of the header's numbers, as libqsm writes them


def write_qsm(path: str | os.PathLike, tree: MeasuredTree) -> None:
    """Write a tree's cylinders."""
    skeleton, rows = tree.skeleton, tree.cylinders
    offset = np.round(skeleton.points[0], _SPACED_OUT)
    n_points = skeleton.fields.get("n_points", np.ones(len(skeleton)))
    edges = np.zeros(len(rows.node), dtype=EDGE)
    start = skeleton.parent[rows.node]
    edges["source"], edges["target"] = start + 1, rows.node + 1
    edges["radius"] = rows.radius
    edges["quality"] = np.where(n_points[rows.node] > 0, MEASURED, PROLONGED)
    edges["axis_id"], edges["branch_order"] = rows.branch + 1, rows.order + 1
    edges["subtree_length"] = skeleton.reach()[rows.node]
    edges["distance_to_root"] = skeleton.distance_to_root()[start]
    bounds = zip(("MIN", "MAX"), (skeleton.points.min(axis=0), skeleton.points.max(axis=0)))
    numbers = {f"{axis}_OFFSET": value for axis, value in zip("XYZ", offset)}
    for name, corner in bounds:
        numbers |= {f"{axis}{name}": value for axis, value in zip("XYZ", corner)}
    lines = [
        "# QSM Binary Format",
        "SIGNATURE QSMF",
        "VERSION 1.0",
        "FORMAT 2",
        "SOFTWARE CherryPicker",
        f"CREATED {tree.made}",
        f"NODES {len(skeleton)}",
        f"EDGES {len(edges)}",
        *(f"{name} {value:.{_SPACED_OUT}f}" for name, value in numbers.items()),
        f"TREENAME {tree.name}",
        f"MESSAGE unit {skeleton.unit}, frame {skeleton.frame}",
        "DATA binary",
    ]
    nodes = (skeleton.points - offset).astype("<f4")
    with atomic_path(path) as temporary:
        header = ("\n".join(lines) + "\n").encode("ascii")
        temporary.write_bytes(header + nodes.tobytes() + edges.tobytes())
