"""The photos of a scan as witnesses: what they say about points of its cloud."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from cherrypicker.denoising.evidence import EvidenceOptions, SkyEvidence, sky_evidence
from cherrypicker.lens import PhotoLenses
from cherrypicker.photos import read_photo
from cherrypicker.poses import Poses
from cherrypicker.sky.mask_files import read_masks


def photos_as_witnesses(
    poses: Poses, model: Path, photo_folder: Path, masks: Path, options: EvidenceOptions
) -> Callable[[np.ndarray], SkyEvidence]:
    """Return what `cherrypicker.denoising.denoise.denoise_cloud` asks about points.

    Parameters
    ----------
    poses : Poses
        In the cloud's frame; undistorted pinhole.
    model : Path
        Folder of the sparse model, for the lenses.
    photo_folder, masks : Path
        The photos as stored, and ``{stem}.png`` of each.

    Returns
    -------
    callable
        ``evidence_of(asked)``, see `cherrypicker.denoising.evidence.sky_evidence`.

    Raises
    ------
    StageError
        When the model is unreadable or lacks a photo; by the callable, when a photo or a mask is
        missing, unreadable or of another size.
    """
    lenses = PhotoLenses(model, poses.names)

    def look(i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        name = str(poses.names[i])
        sky, hidden = read_masks(Path(masks) / f"{Path(name).stem}.png", lenses.shape(i))
        return read_photo(Path(photo_folder) / name), sky, hidden

    return partial(sky_evidence, poses=poses, to_photo=lenses.to_photo, look=look, options=options)
