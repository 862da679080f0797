"""Limbs on disk: what one stage grew, the next joins."""

from __future__ import annotations

import os

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import read_npz, write_npz
from cherrypicker.limbs.growth import Limbs
from cherrypicker.limbs.tubes import Limb, Tube

__all__ = ["read_limbs", "write_limbs"]

_ARRAYS = ("nodes", "radius", "n_nodes", "parent", "member", "spacing", "noise", "claimed")


def write_limbs(path: str | os.PathLike, found: Limbs | None) -> None:
    """Write limbs as NPZ; None, where none were grown, as a file without arrays.

    ``nodes`` (n_nodes, 3) and ``radius`` (n_nodes,) hold all limbs one after the other, ``n_nodes``
    and ``parent`` (n_limbs,) how many nodes are whose and the parent's number, ``member``
    (n_points,) the limb of each point that entered the contraction.
    """
    if found is None:
        write_npz(path)
        return
    tubes = [limb.tube for limb in found.limbs]
    write_npz(
        path,
        nodes=np.vstack([tube.nodes for tube in tubes]),
        radius=np.concatenate([tube.radius for tube in tubes]),
        n_nodes=np.array([len(tube.nodes) for tube in tubes]),
        parent=np.array([limb.parent for limb in found.limbs]),
        member=found.member,
        spacing=np.float64(found.spacing),
        noise=np.float64(found.noise),
        claimed=np.float64(found.claimed),
    )


def read_limbs(path: str | os.PathLike) -> Limbs | None:
    """Read what `write_limbs` wrote.

    Raises
    ------
    StageError
        If the file is missing or broken.
    """
    arrays = read_npz(path)
    if not arrays:
        return None
    missing = [name for name in _ARRAYS if name not in arrays]
    if missing:
        raise StageError(f"no {', '.join(missing)} in it", file=path)
    ends = np.cumsum(arrays["n_nodes"])[:-1]
    nodes, radius = np.split(arrays["nodes"], ends), np.split(arrays["radius"], ends)
    limbs = [Limb(Tube(*own), int(parent)) for *own, parent in zip(nodes, radius, arrays["parent"])]
    spacing, noise, claimed = (float(arrays[name]) for name in ("spacing", "noise", "claimed"))
    return Limbs(limbs, arrays["member"], spacing, noise, claimed)
