"""Where the photos of a model show places at the tree, and how far two models show them apart."""

import numpy as np
import pycolmap

from cherrypicker.placement.region import find_region
from cherrypicker.sfm.export import poses_of


def places_shown(model: pycolmap.Reconstruction) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Places of the region that all look at, by the id of each photo that shows them.

    Those places, (n, 3), and where it shows them, px, (n, 2). Where a photo shows none, they are
    the points that it sees.
    """
    region = find_region(poses_of(model))
    near = np.zeros((0, 3)) if region is None else region.samples
    places = {}
    for image_id in sorted(model.reg_image_ids()):
        image = model.images[image_id]
        camera = model.cameras[image.camera_id]
        pixels = _shown(model, image_id, near)
        inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
        places[image_id] = near[inside], pixels[inside]
        if not inside.any():
            seen = [p.point3D_id for p in image.points2D if p.has_point3D()]
            points = np.array([model.points3D[i].xyz for i in seen]).reshape(-1, 3)
            places[image_id] = points, _shown(model, image_id, points)
    return places


def shifts_of_places(
    moved: pycolmap.Reconstruction,
    model: pycolmap.Reconstruction,
    places: dict[int, tuple[np.ndarray, np.ndarray]],
) -> np.ndarray:
    """How far a model whose cameras have moved shows the places beside where the model shows them.

    It has the same photos, in any frame, and is laid over the other by its cameras, in place. The
    places are those of `places_shown`, in the frame of ``model``. Of each photo by increasing id
    the median over the places, px, (n_photos,); infinite without any.
    """
    ids = sorted(places)
    # Two cameras the adjustment itself holds
    if len(ids) > 2:
        back = pycolmap.estimate_sim3d(centers_of(moved, ids), centers_of(model, ids))
        if back:
            moved.transform(back)
    shifts = []
    for image_id in ids:
        own, pixels = places[image_id]
        apart = np.linalg.norm(_shown(moved, image_id, own) - pixels, axis=1)
        apart = np.nan_to_num(apart, nan=np.inf)
        shifts.append(np.median(apart) if len(apart) else np.inf)
    return np.array(shifts)


def centers_of(model: pycolmap.Reconstruction, ids: list[int]) -> np.ndarray:
    """Centres of photos, (n_photos, 3)."""
    return np.array([model.images[i].projection_center() for i in ids])


def _shown(model: pycolmap.Reconstruction, image_id: int, points: np.ndarray) -> np.ndarray:
    """Where a photo shows points (n, 3), px, (n, 2); NaN behind the camera."""
    image = model.images[image_id]
    pose = image.cam_from_world().matrix()
    local = points @ pose[:, :3].T + pose[:, 3]
    return np.asarray(model.cameras[image.camera_id].img_from_cam(local))
