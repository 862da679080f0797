"""Clouds as stereo sees them: visibility, depth noise and silhouettes."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.poses import Poses
from cherrypicker_lab.orchard.scene.cameras import CameraModel, Ring, look_at, ring_poses
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.seen.as_seen import AsSeen, see_scene
from cherrypicker_lab.orchard.seen.sampling import sample_scene
from cherrypicker_lab.orchard.seen.visibility import choose_views

EXACT = AsSeen(
    match_px=0.0, thin_noise=0.0, tail=0.0, jitter_px=0.0, flatten_m=1e-6, sink_m=0.0,
    sink_share=0.0, spill_px=0.0, blur_px=1e-6, mixed_loss=0.0, clutter_loss=0.0, width_px=-50.0,
    width_soft_px=0.5, patchiness=0.0, density_sigma=0.0, floaters=0.0, color_noise=0.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def scene():
    return generate_scene(
        21, habit="leader", height=2.2, neighbours=0, sign=False, ring=False, cube=False,
        post=False, roof=False, markers=[], sky="clear",
    )  # fmt: skip


def seen_by(scene, seen, n=6_000, **options):
    return see_scene(scene, n, np.random.default_rng(3), seen, look=False, **options)


def gap_to_wood(scene, cloud):
    """Signed distance of wood points to the tubes of the tree, (n,), m."""
    points = cloud["points"][cloud["tree"] == 0]
    skeleton = scene.target.skeleton()
    child = np.flatnonzero(skeleton.parent >= 0)
    a, b = skeleton.points[skeleton.parent[child]], skeleton.points[child]
    radii = np.maximum(skeleton.radius[child], 0.0)
    edges = cKDTree(0.5 * (a + b)).query(points, k=24, workers=1)[1]
    d = (b - a)[edges]
    t = np.einsum("nmi,nmi->nm", points[:, None] - a[edges], d) / (d**2).sum(2)
    foot = a[edges] + np.clip(t, 0, 1)[..., None] * d
    return (np.linalg.norm(points[:, None] - foot, axis=2) - radii[edges]).min(axis=1)


def test_without_imperfections_points_lie_on_the_surface(scene):
    cloud = seen_by(scene, EXACT, 3000)
    assert np.quantile(np.abs(gap_to_wood(scene, cloud)), 0.95) < 0.001
    ground = cloud["label"] == Label.GROUND
    level = scene.ground_height(cloud["points"][ground, :2])
    np.testing.assert_allclose(cloud["points"][ground, 2], level, atol=1e-9)


def test_depth_noise_grows_with_the_square_of_the_distance(scene):
    error = {}
    for distance in (2.0, 4.0):
        camera = CameraModel(width=1600, height=1600, focal_px=1000.0)
        poses = ring_poses([Ring(40, 1.0, distance, 0.9)], camera, seed=1)
        seen = dataclasses.replace(EXACT, match_px=0.3, pixel_m=distance / 1000.0)
        cloud = seen_by(scene, seen, 4000, poses=poses)
        ground = cloud["label"] == Label.GROUND
        near = ground & (np.hypot(*cloud["points"][:, :2].T) < 0.6)
        off = cloud["points"][near, 2] - scene.ground_height(cloud["points"][near, :2])
        slope = 1.0 / np.hypot(distance, 1.0)  # of the ray: depth error to height error
        error[distance] = np.std(off) / slope
        baseline = np.median(
            np.sort(np.linalg.norm(poses.centers[:, None] - poses.centers, axis=2), axis=1)[:, 1:5]
        )
        wanted = 0.3 * np.hypot(distance, 1.0) ** 2 / (1000.0 * baseline)
        assert error[distance] == pytest.approx(wanted, rel=0.25)


def test_only_what_photos_see_is_there(scene):
    camera = CameraModel(width=1200, height=1600, focal_px=800.0)
    centers = [np.array([2.4, y, 1.2]) for y in (-0.3, 0.0, 0.3)]
    poses = np.array([look_at(c, [0.0, 0.0, 1.0]) for c in centers])
    names = np.array(["a.jpg", "b.jpg", "c.jpg"])
    size = np.full(3, 1200), np.full(3, 1600)
    one_side = Poses(names, poses, np.repeat([camera.K], 3, axis=0), *size)
    cloud = seen_by(scene, EXACT, poses=one_side)
    trunk = cloud["label"] == Label.TRUNK
    assert cloud["normals"][trunk, 0].min() > -0.4
    assert (cloud["points"][trunk, 0]).mean() > 0.01
    everything = seen_by(scene, EXACT)
    assert everything["normals"][everything["label"] == Label.TRUNK, 0].min() < -0.95
    with pytest.raises(ValueError, match="see nothing"):
        seen_by(scene, dataclasses.replace(EXACT, min_views=4), poses=one_side)


def test_thick_wood_hides_what_is_behind_it():
    camera = CameraModel(width=800, height=800, focal_px=800.0)
    pose = look_at(np.array([0.0, -2.0, 1.0]), [0.0, 0.0, 1.0])
    poses = Poses(np.array(["a.jpg"]), pose[None], camera.K[None], np.array([800]), np.array([800]))
    post = np.column_stack([np.zeros(101), np.zeros(101), np.linspace(0.5, 1.5, 101)])
    points = np.array([[0.0, -0.05, 1.0], [0.0, 0.3, 1.0], [0.2, 0.3, 1.0], [0.0, 0.3, 1.9]])
    normals = np.tile([0.0, -1.0, 0.0], (4, 1))
    rng = np.random.default_rng(0)
    views, chosen = choose_views(rng, points, normals, poses, post, np.full(101, 0.05))
    assert views.tolist() == [1, 0, 1, 1]
    assert chosen.tolist() == [0, -1, 0, 0]
    views, _ = choose_views(rng, points, -normals, poses, post, np.full(101, 0.05))
    assert views.tolist() == [0, 0, 0, 0]


def test_photos_are_chosen_by_their_pixels():
    camera = CameraModel(width=800, height=800, focal_px=400.0)
    poses = [look_at(np.array([0.0, -y, 0.0]), [0.0, 0.0, 0.0]) for y in (1.0, 2.0)]
    two = Poses(
        np.array(["a.jpg", "b.jpg"]), np.array(poses), np.repeat([camera.K], 2, axis=0),
        np.full(2, 800), np.full(2, 800),
    )  # fmt: skip
    n = 20_000
    points, normals = np.zeros((n, 3)), np.tile([0.0, -1.0, 0.0], (n, 1))
    _, chosen = choose_views(
        np.random.default_rng(0), points, normals, two, np.zeros((0, 3)), np.zeros(0)
    )
    assert (chosen == 0).mean() == pytest.approx(0.8, abs=0.01)  # 1 : 1/4


def test_silhouettes_of_twigs_take_on_the_sky(scene):
    plain = seen_by(scene, EXACT, extent=1.0)
    fringed = seen_by(scene, dataclasses.replace(EXACT, spill_px=1.5, blur_px=1.0), extent=1.0)

    def light_of(cloud, low, high):
        mine = (cloud["radius"] > low) & (cloud["radius"] < high) & (cloud["tree"] == 0)
        return np.median(cloud["colors"][mine & (cloud["points"][:, 2] > 1.2)].mean(axis=1))

    assert light_of(fringed, 0, 0.004) > light_of(plain, 0, 0.004) + 0.05
    assert light_of(fringed, 0.02, 1) == pytest.approx(light_of(plain, 0.02, 1), abs=0.03)
    # the fringe lies outside the wood
    thin = fringed["radius"][fringed["tree"] == 0] < 0.004
    assert np.quantile(gap_to_wood(scene, fringed)[thin], 0.9) > 0.001


def test_thin_wood_is_lost_and_holes_are_empty(scene):
    whole = seen_by(scene, EXACT)
    lossy = seen_by(scene, dataclasses.replace(EXACT, width_px=4.0))

    def share_thin(cloud):
        wood = cloud["tree"] == 0
        return (cloud["radius"][wood] < 0.004).mean()

    assert share_thin(lossy) < 0.5 * share_thin(whole)
    holed = seen_by(scene, dataclasses.replace(EXACT, n_holes=8, hole_radius_m=0.15))
    assert len(holed["points"]) < len(whole["points"])


def test_as_seen_clouds_are_reproducible_and_labelled():
    for seed in (2, 3, 5):
        a, b = (sample_scene(generate_scene(seed), 8_000, rng=seed) for _ in range(2))
        assert a.points.tobytes() == b.points.tobytes()
        assert a.colors.tobytes() == b.colors.tobytes()
        assert len(a) > 3_000
        assert np.isfinite(a.points).all()
        assert {Label.GROUND, Label.TRUNK, Label.BRANCH} <= set(np.unique(a["label"]))
