"""Limbs on disk: what was grown once, all later stages read."""

from __future__ import annotations

import os

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import read_npz, write_npz
from cherrypicker.limbs.growth import Limbs
from cherrypicker.limbs.orchard import Orchard
from cherrypicker.limbs.tubes import Limb, Tube

__all__ = ["read_orchard", "write_orchard"]

_ARRAYS = (
    *("owner", "sample", "spacing", "base", "entered", "n_entered"),
    *("nodes", "radius", "n_nodes", "parent", "member", "n_limbs", "of_limbs"),
)
_OF_LIMBS = ("spacing", "noise", "claimed")  # columns of ``of_limbs``


def write_orchard(path: str | os.PathLike, found: Orchard) -> None:
    """Write the limbs of all stems as NPZ.

    ``owner``, ``sample``, ``spacing`` and ``base`` are those of `Orchard`. ``entered`` and
    ``member`` hold the rows of all stems one after the other, ``n_entered`` (n_stems,) how many are
    whose; so do ``nodes`` (n_nodes, 3) and ``radius`` (n_nodes,) with those of all limbs,
    ``n_nodes`` and ``parent`` (n_limbs,) how many are whose and the number of the parent among the
    stem's, -1 for the stem's own, ``n_limbs`` (n_stems,) how many limbs a stem has, 0 where none
    were grown, and ``of_limbs`` (n_stems, 3) their spacing, noise and claimed share.
    """
    grown = [each for each in found.limbs if each is not None]
    limbs = [limb for each in grown for limb in each.limbs]
    write_npz(
        path,
        owner=found.owner.astype(np.int16),  # of as many points as the cloud has
        sample=found.sample,
        spacing=np.float64(found.spacing),
        base=np.reshape(found.bases, (-1, 3)),
        entered=np.concatenate([np.empty(0, np.int32), *found.entered]),
        n_entered=np.array([len(rows) for rows in found.entered], dtype=np.int64),
        nodes=np.vstack([np.empty((0, 3)), *(limb.tube.nodes for limb in limbs)]),
        radius=np.concatenate([np.empty(0), *(limb.tube.radius for limb in limbs)]),
        n_nodes=np.array([len(limb.tube.nodes) for limb in limbs], dtype=np.int64),
        parent=np.array([limb.parent for limb in limbs], dtype=np.int64),
        member=np.concatenate([np.empty(0, np.int64), *(each.member for each in grown)]),
        n_limbs=np.array([len(each.limbs) if each else 0 for each in found.limbs], dtype=np.int64),
        of_limbs=np.array(
            [[getattr(each, name) if each else 0.0 for name in _OF_LIMBS] for each in found.limbs]
        ).reshape(-1, len(_OF_LIMBS)),
    )


def read_orchard(path: str | os.PathLike) -> Orchard:
    """Read what `write_orchard` wrote.

    Raises
    ------
    StageError
        If the file is missing or broken.
    """
    arrays = read_npz(path, _ARRAYS)
    try:
        return _orchard(arrays)
    except (ValueError, IndexError) as error:
        raise StageError(f"its arrays do not fit together ({error})", file=path) from error


def _orchard(arrays: dict[str, np.ndarray]) -> Orchard:
    ends = np.cumsum(arrays["n_nodes"])[:-1]
    tubes = zip(np.split(arrays["nodes"], ends), np.split(arrays["radius"], ends), strict=True)
    limbs = [Limb(Tube(*own), int(up)) for own, up in zip(tubes, arrays["parent"], strict=False)]
    entered = np.split(arrays["entered"], np.cumsum(arrays["n_entered"])[:-1])
    found: list[Limbs | None] = []
    first = first_member = 0
    for n_own, own, rest in zip(arrays["n_limbs"], entered, arrays["of_limbs"], strict=True):
        if not n_own:
            found.append(None)
            continue
        member = arrays["member"][first_member : first_member + len(own)]
        spacing, noise, claimed = map(float, rest)
        found.append(Limbs(limbs[first : first + n_own], member, spacing, noise, claimed))
        first, first_member = first + n_own, first_member + len(own)
    if (first, first_member) != (len(limbs), len(arrays["member"])):
        raise ValueError("limbs or members that no stem has")
    return Orchard(
        arrays["owner"].astype(np.int64),
        arrays["sample"],
        float(arrays["spacing"]),
        arrays["base"],
        entered[: len(found)],
        found,
    )
