"""The benchmark's naive floor, its copies of workspaces and its agreement without truth."""

import numpy as np
import pycolmap
import pytest
from stereo_scene import Surface, write_scene

from cherrypicker.errors import StageError
from cherrypicker.mvs.backends.choice import run_backend
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.workspace import View, Workspace
from cherrypicker_lab.dense.agreement import sparse_agreement
from cherrypicker_lab.dense.backends import ALL_BACKENDS
from cherrypicker_lab.dense.copies import copy_workspace
from cherrypicker_lab.dense.sgbm import rectify, slopes


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A plane behind an upright cylinder, five photos, matched by SGBM."""
    folder = tmp_path_factory.mktemp("stereo")
    surfaces = [Surface(seed=1), Surface(radius=0.12, center=(0.2, 0.0, 3.4), seed=2)]
    K, poses, depths = write_scene(folder, surfaces, n_views=5, width=320, height=240)
    shares = run_backend(ALL_BACKENDS["sgbm"], Workspace(folder), StereoOptions())
    return folder, depths, {"maps": list(shares), "share_with_depth": shares}


def test_sgbm_depths_are_right_and_not_few(scene):
    folder, depths, manifest = scene
    assert len(manifest["maps"]) == 5
    workspace = Workspace(folder)
    for view, true in zip(workspace.views, depths):
        found = workspace.read_depth(view, "geometric")
        known = (found > 0) & (true > 0)
        assert known.mean() > 0.7
        error = np.abs(found[known] / true[known] - 1)
        assert np.median(error) < 0.01
        assert (error < 0.02).mean() > 0.8
        assert abs(np.median(found[known] / true[known]) - 1) < 0.003  # no shift of half a pixel


def test_sgbm_normals_face_the_camera(scene):
    folder, depths, _ = scene
    workspace = Workspace(folder)
    normals = workspace.read_normals(workspace.views[2], "geometric")
    known = workspace.read_depth(workspace.views[2], "geometric") > 0
    np.testing.assert_allclose(np.linalg.norm(normals[known], axis=1), 1.0, atol=1e-4)
    assert (normals[known] @ [0.0, 0.0, -1.0] > 0.9).mean() > 0.7


def make_view(center, *, turn=0.0):
    K = np.array([[200.0, 0, 80], [0, 200, 60], [0, 0, 1]])
    R = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    return View("a", K, R, -R @ np.asarray(center, float), 160, 120)


@pytest.mark.parametrize("center", [(0.3, 0, 0), (-0.3, 0.1, 0), (0.02, 0.3, 0), (0, -0.3, 0.05)])
def test_rectified_rows_are_epipolar_lines(center):
    left, right = make_view((0, 0, 0)), make_view(center, turn=-0.1 * np.sign(center[0]))
    pair = rectify(left, right, 2.0, 5.0)
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.3, 0.3, (20, 2)), rng.uniform(2.2, 4.5, 20)])
    seen = []
    for view, K in ((left, pair.K_left), (right, pair.K_right)):
        at = (points - view.center) @ pair.rotation.T @ K.T
        seen.append(at[:, :2] / at[:, 2:])
    np.testing.assert_allclose(seen[0][:, 1], seen[1][:, 1], atol=1e-9)
    disparity = seen[0][:, 0] - seen[1][:, 0]
    assert (disparity >= 0).all()
    assert (disparity < pair.n_disparities).all()
    depth = (points - left.center) @ pair.rotation[2]
    np.testing.assert_allclose(
        pair.K_left[0, 0] * pair.baseline / (disparity + pair.shift), depth, rtol=1e-9
    )
    inside = (seen[0] >= [pair.n_disparities, 0]) & (seen[0] <= [pair.width, pair.height])
    assert inside.all()


def test_cameras_behind_one_another_are_refused():
    with pytest.raises(StageError, match="behind one another"):
        rectify(make_view((0, 0, 0)), make_view((0, 0, 1.0)), 2.0, 5.0)


def test_disparities_always_fit_into_sixteen_bits():
    left, right = make_view((0, 0, 0)), make_view((3.0, 0, 0), turn=-0.4)
    pair = rectify(left, right, 0.15, 50.0)
    assert pair.n_disparities < 2048
    assert pair.K_left[0, 0] < 200
    nearest = pair.K_left[0, 0] * pair.baseline / 0.15 - pair.shift
    assert 0.5 * pair.n_disparities < nearest < 2 * pair.n_disparities


def test_slopes_of_a_plane_are_exact_beside_an_edge():
    y, x = np.mgrid[:20, :30].astype(np.float32)
    inverse = 0.25 + 0.0002 * x - 0.0001 * y
    inverse[:, 15:] += 0.1
    inverse[5, 5] = 0.0
    found = slopes(inverse)
    np.testing.assert_allclose(found[2:-2, 2:-2, 0][inverse[2:-2, 2:-2] > 0], 0.0002, atol=2e-6)
    np.testing.assert_allclose(found[2:-2, 2:-2, 1][inverse[2:-2, 2:-2] > 0], -0.0001, atol=2e-6)


def test_agreement_counts_right_depths_only(scene, tmp_path):
    folder, depths, _ = scene
    copy_workspace(folder, tmp_path)
    with pytest.raises(StageError):
        Workspace(tmp_path).read_depth(Workspace(tmp_path).views[0], "geometric")
    assert sparse_agreement(tmp_path)["share"] == 0.0
    workspace = Workspace(tmp_path)
    normals = np.zeros((240, 320, 3), np.float32)
    for i, (view, depth) in enumerate(zip(workspace.views, depths)):
        factor = 1.02 if i == 0 else 1.0
        workspace.write_maps(view, "geometric", factor * depth, normals)
    report = sparse_agreement(tmp_path)
    assert report["by_photo"]["view0.png"] < 0.02
    assert min(report["by_photo"][f"view{i}.png"] for i in range(1, 5)) > 0.85
    assert report["share_where_known"] == pytest.approx(report["share"], abs=0.05)


def test_copies_are_smaller_and_keep_their_geometry(scene, tmp_path):
    folder, _, _ = scene
    copy_workspace(folder, tmp_path, megapixels=0.0192, max_photos=3)
    workspace = Workspace(tmp_path)
    assert [view.name for view in workspace.views] == ["view0.png", "view1.png", "view2.png"]
    assert (workspace.views[0].width, workspace.views[0].height) == (160, 120)
    model = pycolmap.Reconstruction(tmp_path / "sparse")
    errors = []
    for image in model.images.values():
        for point in image.points2D:
            if point.has_point3D():
                xyz = model.points3D[point.point3D_id].xyz
                errors.append(np.abs(image.project_point(xyz) - point.xy).max())
    assert len(errors) > 300
    assert max(errors) < 1e-6
    with pytest.raises(StageError, match="0.08 megapixels"):
        copy_workspace(folder, tmp_path / "larger", megapixels=1.0)
