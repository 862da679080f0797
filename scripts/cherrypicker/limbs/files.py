"""Limbs on disk: what was grown once, all later stages read."""

import os

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import read_npz, write_npz
from cherrypicker.limbs.growth import Limbs
from cherrypicker.limbs.orchard import Orchard
from cherrypicker.limbs.tubes import Limb, Tube

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
    """Read what `write_orchard` wrote; a `StageError` where the file is missing or broken."""
    arrays = read_npz(path, _ARRAYS)
    n_limbs, n_entered = arrays["n_limbs"], arrays["n_entered"]

    def parts(name: str, counts: np.ndarray) -> list[np.ndarray]:
        if len(arrays[name]) != counts.sum():
            raise ValueError(f"{len(arrays[name])} rows of {name} for {counts.sum()}")
        return np.split(arrays[name], np.cumsum(counts))[:-1]

    try:
        tubes = map(Tube, parts("nodes", arrays["n_nodes"]), parts("radius", arrays["n_nodes"]))
        limbs = [Limb(tube, int(up)) for tube, up in zip(tubes, arrays["parent"], strict=True)]
        if len(limbs) != n_limbs.sum():
            raise ValueError(f"{len(limbs)} limbs for {n_limbs.sum()}")
        members = iter(parts("member", n_entered[n_limbs > 0]))
        ends = np.cumsum(n_limbs)
        found = [
            Limbs(limbs[end - n_own : end], next(members), *map(float, rest)) if n_own else None
            for end, n_own, rest in zip(ends, n_limbs, arrays["of_limbs"], strict=True)
        ]
        return Orchard(
            arrays["owner"].astype(np.int64),
            arrays["sample"],
            float(arrays["spacing"]),
            arrays["base"],
            parts("entered", n_entered),
            found,
        )
    except (ValueError, IndexError) as error:
        raise StageError(f"its arrays do not fit together ({error})", file=path) from error
