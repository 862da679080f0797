"""The skeleton as SWC, the table of neuron tracings that many viewers of trees read.

Reference: Cannon et al., J. Neurosci. Methods 84, 1998.
"""

import os

from cherrypicker.classes import Label
from cherrypicker.files import write_text
from cherrypicker.skeleton.model import Skeleton


def write_skeleton_swc(path: str | os.PathLike, skeleton: Skeleton) -> None:
    """Write ``skeleton.swc``: id (from 1), type, x, y, z, radius, parent (-1 for the root)."""
    lines = [
        f"# frame={skeleton.frame} unit={skeleton.unit}",
        "# id type x y z radius parent (type 2 = trunk, 3 = any other wood)",
    ]
    columns = (skeleton.points, skeleton.radius, skeleton.label, skeleton.parent)
    for node, (place, radius, label, parent) in enumerate(zip(*(c.tolist() for c in columns)), 1):
        x, y, z = place
        above = parent + 1 if parent >= 0 else -1
        kind = 2 if label == Label.TRUNK else 3  # an axon, or a dendrite
        lines.append(f"{node} {kind} {x:.6f} {y:.6f} {z:.6f} {radius:.6f} {above}")
    write_text(path, "\n".join(lines) + "\n")
