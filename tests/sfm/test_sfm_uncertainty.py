"""How sure the cameras are follows from the adjustment, and parts without a common scale show."""

import numpy as np
import pycolmap
import pytest
from sfm_scene import similarity_errors
from test_sfm_refine import FOCAL, SIZE, pose_of

from cherrypicker.errors import StageError
from cherrypicker.sfm import sparse
from cherrypicker.sfm.refine import adjust
from cherrypicker.sfm.uncertainty import camera_uncertainty, tree_errors

N_CAMERAS = 12
NOISE_PX = 0.5


def ring_model(groups, noise_px, seed=0):
    """A ring of cameras and, for each group of them, 60 points that they alone observe."""
    rng = np.random.default_rng(seed)
    angles = np.radians(np.arange(N_CAMERAS) * 15.0)
    centers = np.column_stack([4 * np.cos(angles), 4 * np.sin(angles), np.sin(3 * angles)])
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", FOCAL, *SIZE)
    model.add_camera_with_trivial_rig(camera)
    points = [rng.uniform(-1, 1, (60, 3)) for _ in groups]
    places = {}  # (group, camera) -> index of its first observation
    for i, center in enumerate(centers):
        seen = []
        for g, members in enumerate(groups):
            if i in members:
                places[g, i] = len(seen)
                pixels = camera.img_from_cam(pose_of(center) * points[g])
                seen.extend(pixels + rng.normal(0, noise_px, pixels.shape))
        image = pycolmap.Image(name=f"{i:02d}", camera_id=1, image_id=i + 1)
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(uv) for uv in seen])
        model.add_image_with_trivial_frame(image, pose_of(center))
    for g, members in enumerate(groups):
        for j, point in enumerate(points[g]):
            track = pycolmap.Track()
            for i in members:
                track.add_element(i + 1, places[g, i] + j)
            model.add_point3D(point, track, np.zeros(3, np.uint8))
    model.update_point_3d_errors()
    return model, centers


def test_the_error_foretold_is_the_error_found():
    groups = [range(i, i + 4) for i in range(N_CAMERAS - 3)]
    found, foretold = [], []
    for seed in range(3):
        model, centers = ring_model(groups, NOISE_PX, seed)
        adjust(model)
        errors = camera_uncertainty(model)
        foretold += errors.values()
        at = np.array([model.images[i + 1].projection_center() for i in range(N_CAMERAS)])
        size = np.median(np.linalg.norm(centers - centers.mean(axis=0), axis=1))
        found += list(similarity_errors(at, centers) / size)
    ratio = np.sqrt(np.mean(np.square(found)) / np.mean(np.square(foretold)))
    assert 0.6 < ratio < 1.7


def test_wrong_matches_scatter_where_the_covariance_is_sure():
    """All of the ring's end are wrong; were they fewer, they would not pull at it at all."""
    groups = [range(i, i + 3) for i in range(N_CAMERAS - 2)]
    last, off, told, sure = f"{N_CAMERAS - 1:02d}", [], [], []
    for seed in range(4):
        model, centers = ring_model(groups, 0.1, seed)
        rng = np.random.default_rng(1 + seed)
        for point in model.images[N_CAMERAS].points2D:
            point.xy = point.xy + rng.normal(0, 3.0, 2)
        adjust(model)
        at = np.array([model.images[i + 1].projection_center() for i in range(N_CAMERAS)])
        found = similarity_errors(at, centers) / 4 * FOCAL  # px; the tree stands 4 away
        assert found.argmax() == N_CAMERAS - 1
        errors = tree_errors(model, seed=0, threads=1)
        assert max(errors, key=lambda name: errors[name]) == last
        size = np.median(np.linalg.norm(centers - centers.mean(axis=0), axis=1))
        off.append(found.max())
        told.append(errors[last])
        sure.append(camera_uncertainty(model)[last] * size / 4 * FOCAL)
    off_px, told_px, sure_px = (np.sqrt(np.mean(np.square(each))) for each in (off, told, sure))
    assert off_px / 4 < told_px < off_px
    assert sure_px < off_px / 12


def test_a_camera_that_a_small_part_of_the_tree_holds_is_told():
    """Those points it shows where they are; where it shows the rest of the tree they leave open."""
    groups = [range(i, i + 4) for i in range(N_CAMERAS - 3)]
    model, _ = ring_model(groups, NOISE_PX)
    adjust(model)
    sure = tree_errors(model, seed=0, threads=1)
    last = model.images[N_CAMERAS]
    seen = [point.point3D_id for point in last.points2D if point.has_point3D()]
    at = np.array([model.points3D[i].xyz for i in seen])
    for point_id in np.array(seen)[np.argsort(np.linalg.norm(at - at[0], axis=1))[8:]]:
        model.delete_observation(N_CAMERAS, element_of(model, point_id))
    loose = tree_errors(model, seed=0, threads=1)
    assert loose[last.name] > 2 * sure[last.name]


def test_a_camera_that_no_point_holds_is_not_known():
    model, _ = ring_model([range(i, i + 4) for i in range(N_CAMERAS - 3)], NOISE_PX)
    for point_id in [p.point3D_id for p in model.images[1].points2D if p.has_point3D()]:
        model.delete_point3D(point_id)
    told = tree_errors(model, seed=0, threads=1)
    assert told.pop("00") == np.inf
    assert np.isfinite(list(told.values())).all()


def element_of(model, point_id):
    """Which of the last camera's pixels shows a point."""
    elements = model.points3D[int(point_id)].track.elements
    return next(each.point2D_idx for each in elements if each.image_id == N_CAMERAS)


def test_parts_that_one_pair_of_photos_joins_have_no_common_scale():
    parts = [range(6), range(6, 12)]
    loose, _ = ring_model([*parts, (5, 6)], NOISE_PX)
    joined, _ = ring_model([*parts, (4, 5, 6, 7)], NOISE_PX)
    assert np.median([*camera_uncertainty(joined).values()]) < 0.01
    errors = camera_uncertainty(loose)
    assert np.median([*errors.values()]) > sparse.UNDETERMINED
    unsure = sparse.describe(errors)
    content = {"camera_std_fraction": unsure, "n_points": 180, "photos": {}}
    content |= {"n_registered": N_CAMERAS, "registered_fraction": 1.0}
    with pytest.raises(StageError, match="no common scale") as refused:
        sparse._enforce(content, 0.5, "photos/a")
    assert "trees.tsv" in refused.value.key
