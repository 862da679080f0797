"""Models of one scan joined by the photos that they share.

COLMAP leaves a model that has come to share 20 photos with those before. Where two rings of a walk
hardly show the same wood, it makes one model of each and one across both: their shared photos say
how they lie to one another.
"""

import copy
import logging
from collections.abc import Sequence

import numpy as np
import pycolmap

from cherrypicker.sfm.export import registered_photos

logger = logging.getLogger(__name__)


def join_models(
    models: Sequence[pycolmap.Reconstruction],
) -> tuple[pycolmap.Reconstruction, list[pycolmap.Reconstruction]]:
    """Join to the first model all that agree with it on shared photos; it changes. And the others.

    How a model lies comes from three shared photos or more, each of which has to show three tenths
    of the points that both hold within 8 px of one place (RANSAC, the defaults of
    `pycolmap.align_reconstructions_via_reprojections`).
    """
    whole, *others = models
    n_before = len(models)
    while len(others) < n_before:  # what was joined may share photos with what was not
        n_before = len(others)
        others = [each for each in others if not _join(whole, each)]
    return whole, others


def _join(whole: pycolmap.Reconstruction, part: pycolmap.Reconstruction) -> bool:
    """Add what a model lacks of another, if they agree on shared photos; whether they do."""
    turn = pycolmap.align_reconstructions_via_reprojections(part, whole)
    if turn is None:
        return False
    part.transform(turn)
    missing = [each for each in registered_photos(part) if not whole.exists_image(each.image_id)]
    logger.info(
        f"a model of {part.num_reg_images()} photos brings {len(missing)} more to one of "
        f"{whole.num_reg_images()}"
    )
    for image in missing:
        frame = copy.copy(part.frames[image.frame_id])
        if not whole.exists_camera(image.camera_id):
            whole.add_camera(part.cameras[image.camera_id])
        if not whole.exists_rig(frame.rig_id):
            whole.add_rig(part.rigs[frame.rig_id])
        frame.reset_rig_ptr()
        whole.add_frame(frame)
        keypoints = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
        added = pycolmap.Image(image.name, keypoints, image.camera_id, image.image_id)
        added.frame_id = image.frame_id
        whole.add_image(added)
        whole.register_frame(image.frame_id)
    for point in part.points3D.values() if missing else ():
        free = [
            each
            for each in point.track.elements
            if not whole.images[each.image_id].points2D[each.point2D_idx].has_point3D()
        ]
        if len(free) > 1:
            whole.add_point3D(point.xyz, pycolmap.Track(free))
    return True
