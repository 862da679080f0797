"""Alignment: known vertical and ground come out of scenes in arbitrary frames."""

from dataclasses import replace

import numpy as np
import pytest
from scan_scene import (
    arbitrary_frame,
    ground_points,
    look_at_poses,
    ring,
    rotation_about,
    tree_points,
)

from cherrypicker.errors import StageError
from cherrypicker.geometry.directions import angle_deg, rodrigues
from cherrypicker.geometry.ground_surface import robust_plane
from cherrypicker.placement.align import align
from cherrypicker.placement.ground import AlignOptions
from cherrypicker.placement.region import look_at_point
from cherrypicker.placement.up import photos_up

TARGET = np.array([0.0, 0.0, 1.2])


def aligned_errors(points, poses, **options):
    """Tilt in degrees, and the aligned coordinates (true units) of the true origin."""
    moved, moved_poses, (scale, q, shift) = arbitrary_frame(points, poses)
    result = align(moved, moved_poses, **options)
    up = result.rotation @ q @ [0, 0, 1.0]
    origin = (result.rotation @ shift + result.translation) / scale
    return angle_deg(up, [0, 0, 1.0]), origin, result


def assert_below_what_is_looked_at(origin):
    """The aim of each photo is off by 10 cm, so that of all by a few; the ground is at z = 0."""
    assert np.hypot(*origin[:2]) < 0.1
    assert abs(origin[2]) < 0.02


def scene(rng, centers, *, hills=0.0, extra=(), **cameras):
    points = np.concatenate([ground_points(rng, hills=hills), tree_points(rng), *extra])
    return points, look_at_poses(centers, TARGET + rng.normal(0, 0.1, (len(centers), 3)), **cameras)


def test_rodrigues_maps_and_is_a_rotation():
    rng = np.random.default_rng(0)
    for source in [*rng.normal(size=(20, 3)), np.array([0, 0, -1.0]), np.array([0, 0, 1.0])]:
        rotation = rodrigues(source)
        turned = rotation @ source / np.linalg.norm(source)
        np.testing.assert_allclose(turned, [0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)


def test_a_robust_plane_is_the_same_in_any_unit():
    rng = np.random.default_rng(0)
    xy, noise = rng.uniform(-2, 2, (400, 2)), rng.normal(0, 0.001, 400)
    z = 0.1 + 0.2 * xy[:, 0] + noise + np.where(rng.random(400) < 0.2, 0.1, 0.0)
    plane = robust_plane(xy, z)
    np.testing.assert_allclose(plane, [0.1, 0.2, 0.0], atol=5e-4)
    np.testing.assert_allclose(robust_plane(xy / 100, z / 100), plane * [0.01, 1, 1], rtol=1e-9)
    np.testing.assert_allclose(robust_plane(xy, 1 - xy[:, 1]), [1, 0, -1], atol=1e-12)


def test_look_at_point_of_a_ring_and_of_a_row():
    rng = np.random.default_rng(1)
    points, poses = scene(rng, ring())
    point, distance, is_common = look_at_point(poses, points)
    assert is_common and np.linalg.norm(point - TARGET) < 0.1
    assert distance == pytest.approx(3.0, rel=0.1)
    row = np.column_stack([np.linspace(-1, 1, 20), np.full(20, -3.0), np.full(20, 1.2)])
    poses = look_at_poses(row, row + [0, 3, 0])
    point, _, is_common = look_at_point(poses, points)
    assert not is_common and abs(point[0]) < 0.3
    assert abs(point[1]) < 1.5


def test_camera_up_needs_no_ground_and_survives_rolls_and_portrait_photos():
    rng = np.random.default_rng(2)
    centers = ring(36)
    turns = np.where(rng.random(36) < 0.4, 1, 0)
    poses = look_at_poses(centers, TARGET, roll_deg=1.5 + rng.normal(0, 2, 36), turns=turns)
    result = photos_up(poses)
    assert angle_deg(result.up, [0, 0, 1]) < 1.0
    np.testing.assert_array_equal(result.turns, turns)


def test_level_ring_of_sideways_photos_needs_exif_for_the_sign():
    centers = ring(32, heights=(1.2,))
    for turn in (1, 3):
        poses = look_at_poses(centers, TARGET, turns=turn)
        up = photos_up(poses, stated_turns=np.full(32, turn)).up
        assert angle_deg(up, [0, 0, 1]) < 0.5


def test_flat_ground_ring():
    rng = np.random.default_rng(3)
    points, poses = scene(rng, ring())
    tilt, origin, result = aligned_errors(points, poses)
    assert tilt < 0.3
    assert_below_what_is_looked_at(origin)
    assert result.report["half_turn"]["agree"]


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_hilly_ground_with_handheld_rolls(seed):
    rng = np.random.default_rng(seed)
    points, poses = scene(rng, ring(45), hills=0.06, roll_deg=rng.normal(0.5, 1.5, 45))
    tilt, origin, result = aligned_errors(points, poses)
    assert tilt < 1.0
    assert_below_what_is_looked_at(origin)
    assert result.report["ground_to_cameras_deg"] > 0


def test_true_slope_keeps_the_stem_vertical():
    rng = np.random.default_rng(7)
    ground = ground_points(rng)
    ground[:, 2] += np.tan(np.radians(8)) * ground[:, 0]
    points = np.concatenate([ground, tree_points(rng)])
    centers = ring()
    centers[:, 2] += np.tan(np.radians(8)) * centers[:, 0]
    tilt, origin, result = aligned_errors(points, look_at_poses(centers, TARGET))
    assert tilt < 1.0
    assert abs(origin[2]) < 0.03
    assert any("slopes" in warning for warning in result.report["warnings"])


def test_a_wall_and_a_hedge_do_not_win():
    rng = np.random.default_rng(8)
    n = 120_000
    wall = np.column_stack([rng.uniform(-6, 6, n), np.full(n, 4.0), rng.uniform(0, 5, n)])
    hedge = np.column_stack(
        [np.full(n, -4.5) + rng.normal(0, 0.1, n), rng.uniform(-6, 6, n), rng.uniform(0, 3, n)]
    )
    points, poses = scene(rng, ring(), extra=[wall, hedge])
    tilt, origin, _ = aligned_errors(points, poses)
    assert tilt < 0.5
    assert_below_what_is_looked_at(origin)
    # From one side, in front of the wall, with half of the photos upright.
    points, poses = scene(
        rng, ring(20, arc_deg=100, heights=(1.0, 1.8)), extra=[wall], turns=np.arange(20) % 2
    )
    tilt, _, _ = aligned_errors(points, poses)
    assert tilt < 1.0


def test_a_roof_over_the_cameras_does_not_win():
    rng = np.random.default_rng(9)
    n = 150_000
    roof = np.column_stack([rng.uniform(-6, 6, (n, 2)), np.full(n, 3.2)])
    points, poses = scene(rng, ring(), extra=[roof])
    tilt, origin, _ = aligned_errors(points, poses)
    assert tilt < 0.5
    assert abs(origin[2]) < 0.03


@pytest.mark.parametrize("what", ["netting among the cameras", "a field below a wall"])
def test_a_level_plane_larger_than_the_ground_does_not_win(what):
    """Level as the ground and denser, but not what most cameras stand over."""
    rng = np.random.default_rng(22)
    n = 200_000
    if what == "netting among the cameras":  # a third of them stand below it
        level = np.column_stack([rng.uniform(-4, 4, (n, 2)), rng.normal(1.2, 0.005, n)])
    else:
        level = np.column_stack([rng.uniform((3, -7), (8, 7), (n, 2)), rng.normal(-2, 0.005, n)])
    points, poses = scene(rng, ring(), extra=[level])
    few_left = np.hypot(*points[:, :2].T) < 3.5
    points = points[few_left | (np.abs(points[:, 2]) > 0.5)]
    tilt, origin, result = aligned_errors(points, poses)
    assert tilt < 0.5
    assert_below_what_is_looked_at(origin)
    ground, *others = [plane["n_inliers"] for plane in result.report["candidates"]]
    assert ground < max(others)


@pytest.mark.parametrize("n_below", [0, 40, 300])
def test_the_ground_behind_a_tall_tree_is_ground_where_none_is_framed_before_it(n_below):
    rng = np.random.default_rng(6)
    angle = np.radians(np.linspace(-80, 80, 12))
    centers = np.column_stack([-4 * np.cos(angle), 4 * np.sin(angle), np.full(12, 2.0)])
    points, _ = scene(rng, centers)
    poses = look_at_poses(centers, TARGET + [0, 0, 1.0] + rng.normal(0, 0.1, (12, 3)))
    is_framed = poses.frames(points).any(axis=0)
    points = points[is_framed & ((points[:, 0] > 1) | (points[:, 2] > 0.1))]
    strays = np.column_stack([rng.uniform(2, 5, (n_below, 2)), np.full(n_below, -1.0)])
    tilt, origin, result = aligned_errors(np.vstack([points, strays]), poses)
    assert result.report["ground_found"]
    assert any("no photo frames the ground" in each for each in result.report["warnings"])
    assert tilt < 0.5
    assert abs(origin[2]) < 0.02


def test_photos_all_sideways_and_from_one_side():
    rng = np.random.default_rng(10)
    points, poses = scene(rng, ring(24, arc_deg=120), turns=1)
    tilt, origin, _ = aligned_errors(points, poses, stated_turns=np.ones(24, int))
    assert tilt < 1.0
    assert_below_what_is_looked_at(origin)


@pytest.mark.parametrize("pitch_deg", [0, 15])
@pytest.mark.parametrize("yaw_deg", [0.5, 4])
def test_photos_square_to_a_row_leave_the_way_across_it_to_the_ground(yaw_deg, pitch_deg):
    """Nearly parallel photos: their rolls tell up along the row, and hardly anything across it."""
    rng = np.random.default_rng(21)
    n = 40
    centers = np.column_stack([np.linspace(-2, 2, n), rng.normal(-3, 0.1, n), np.full(n, 1.5)])
    yaw, pitch = np.radians(rng.normal(0, yaw_deg, n)), np.radians(rng.normal(pitch_deg, 1, n))
    ahead = np.column_stack([np.sin(yaw), np.cos(yaw), -np.tan(pitch)])
    poses = look_at_poses(centers, centers + ahead, roll_deg=rng.normal(0, 2, n))
    points = np.concatenate([ground_points(rng), tree_points(rng)])
    tilt, _, result = aligned_errors(points, poses)
    assert tilt < 1.0
    assert result.report["cameras_sigma_deg"] > 3.0
    assert not any("slopes" in warning for warning in result.report["warnings"])


def test_what_stands_there_does_not_move_the_origin():
    """A post nearer to the middle than the stem, and a neighbour: no question of the alignment."""
    rng = np.random.default_rng(11)
    n = 4000
    phi = rng.uniform(0, 2 * np.pi, n)
    post = np.column_stack(
        [0.5 + 0.03 * np.cos(phi), 0.3 + 0.03 * np.sin(phi), rng.uniform(0, 1.3, n)]
    )
    neighbour = tree_points(rng, foot=(2.0, 0.4, 0.0))
    points, poses = scene(rng, ring(), extra=[post, neighbour])
    _, with_them, _ = aligned_errors(points, poses)
    _, without, _ = aligned_errors(points[: -len(post) - len(neighbour)], poses)
    assert_below_what_is_looked_at(with_them)
    np.testing.assert_allclose(with_them, without, atol=0.01)


def test_a_stem_that_leans_by_25_degrees_does_not_move_the_origin():
    """The cameras look at its crown; the foot stands where it stands."""
    rng = np.random.default_rng(16)
    foot = np.array([-1.2 * np.tan(np.radians(25)), 0.0, 0.0])
    tree = tree_points(rng)
    tree[:, 0] += np.tan(np.radians(25)) * tree[:, 2]
    points = np.concatenate([ground_points(rng), tree + foot])
    tilt, origin, _ = aligned_errors(points, look_at_poses(ring(), TARGET))
    assert tilt < 0.5
    np.testing.assert_allclose(origin, 0, atol=0.02)


def test_a_statue_has_the_same_origin():
    rng = np.random.default_rng(12)
    directions = rng.normal(size=(20000, 3))
    statue = directions / np.linalg.norm(directions, axis=1)[:, None] * 0.9 + [0, 0, 0.9]
    points = np.concatenate([ground_points(rng), statue])
    tilt, origin, _ = aligned_errors(points, look_at_poses(ring(), TARGET))
    assert tilt < 0.5
    np.testing.assert_allclose(origin, 0, atol=0.05)


def test_no_ground_uses_the_cameras_and_says_so():
    rng = np.random.default_rng(13)
    points, poses = scene(rng, ring())
    tree = points[points[:, 2] > 0.15]
    tilt, _, result = aligned_errors(tree, poses)
    assert tilt < 0.5
    assert not result.report["ground_found"]


def test_without_a_ground_cameras_held_anyhow_tell_no_vertical():
    rng = np.random.default_rng(21)
    poses = look_at_poses(ring(), TARGET)
    anyhow = np.linalg.qr(rng.normal(size=(len(poses), 3, 3)))[0]
    anyhow *= np.linalg.det(anyhow)[:, None, None]
    poses = replace(poses, cam_from_world=anyhow @ poses.cam_from_world)
    with pytest.raises(StageError, match="do not tell the vertical") as caught:
        align(tree_points(rng), poses)
    assert caught.value.key == "align.ground_distance_fraction"
    with pytest.raises(StageError, match="no plane") as caught:
        align(tree_points(rng), poses, AlignOptions(up_from="ground"))
    assert caught.value.key == "align.up_from"


def test_equal_input_gives_equal_output():
    rng = np.random.default_rng(14)
    points, poses = scene(rng, ring())
    first, second = align(points, poses), align(points, poses)
    np.testing.assert_array_equal(first.rotation, second.rotation)
    np.testing.assert_array_equal(first.translation, second.translation)


def test_too_few_points_are_refused():
    rng = np.random.default_rng(15)
    points, poses = scene(rng, ring())
    with pytest.raises(StageError, match="too few") as caught:
        align(points[:20], poses)
    assert caught.value.key == "mvs"


def on_a_slope(rng, degrees=8):
    """A tree on ground that rises towards x, and cameras that follow it."""
    rise = np.tan(np.radians(degrees))
    ground, centers = ground_points(rng), ring()
    ground[:, 2] += rise * ground[:, 0]
    centers[:, 2] += rise * centers[:, 0]
    return np.concatenate([ground, tree_points(rng)]), look_at_poses(centers, TARGET)


@pytest.mark.parametrize("plane", ["judged", "ransac"])
def test_up_from_ground_is_the_grounds_normal(plane):
    points, poses = on_a_slope(np.random.default_rng(17))
    options = AlignOptions(plane=plane, up_from="ground")
    tilt, _, result = aligned_errors(points, poses, options=options)
    assert tilt == pytest.approx(8, abs=0.5)
    assert result.report["up_to_ground_deg"] == pytest.approx(0, abs=1e-6)
    assert aligned_errors(points, poses)[0] < 1.0


def test_each_source_of_up_is_what_it_says():
    """Ground that slopes towards x under cameras all held askew towards y: neither is the other."""
    rng = np.random.default_rng(20)
    points, poses = on_a_slope(rng, 3)
    centers, askew = poses.centers, rotation_about([1, 0, 0], 2)
    held = look_at_poses(centers, TARGET, roll_deg=rng.normal(0, 1, len(centers)))
    turns = np.array([rotation @ askew for rotation in held.rotations])
    shifts = -np.einsum("nij,nj->ni", turns, centers)[:, :, None]
    poses = replace(held, cam_from_world=np.concatenate([turns, shifts], axis=2))
    of_ground = np.array([-np.tan(np.radians(3)), 0, 1.0])
    of_cameras = askew.T @ [0, 0, 1.0]

    def up_by(up_from):
        options = AlignOptions(up_from=up_from)
        return align(points, poses, options).rotation.T @ [0, 0, 1.0]

    ground, cameras, auto = (up_by(up_from) for up_from in ("ground", "cameras", "auto"))
    assert angle_deg(ground, of_ground) < 0.5
    assert angle_deg(cameras, of_cameras) < 0.5
    # A slope that the photos are sure of hardly pulls at what both say.
    assert 0.005 < angle_deg(auto, cameras) < 0.05 < angle_deg(auto, ground)


PAPER = AlignOptions(plane="ransac", up_from="ground", flip="mass")


def test_the_paper_turns_a_plain_scene_upright_by_the_plane_alone():
    rng = np.random.default_rng(18)
    points, poses = scene(rng, ring())
    tilt, origin, result = aligned_errors(points, poses, options=PAPER)
    assert tilt < 0.5
    assert_below_what_is_looked_at(origin)
    assert [len(result.report["candidates"]), result.report["plane"]] == [1, "ransac"]
    again = aligned_errors(points, poses, options=PAPER)[2]
    np.testing.assert_array_equal(result.rotation, again.rotation)


def test_the_plane_alone_is_the_largest_whatever_it_is():
    rng = np.random.default_rng(8)
    n = 120_000
    wall = np.column_stack([rng.uniform(-6, 6, n), np.full(n, 4.0), rng.uniform(0, 5, n)])
    points, poses = scene(rng, ring(), extra=[wall])
    assert aligned_errors(points, poses, options=PAPER)[0] == pytest.approx(90, abs=1)
    judged = AlignOptions(up_from="ground", flip="mass")
    assert aligned_errors(points, poses, options=judged)[0] < 0.5


@pytest.mark.parametrize(
    ("plane", "up_from"),
    [("judged", "ground"), ("judged", "auto"), ("judged", "cameras"), ("ransac", "ground")],
)
def test_the_centre_of_mass_says_which_side_is_up(plane, up_from):
    rng = np.random.default_rng(19)
    below = rng.uniform((6, -3, -3), (9, 3, -2), (20000, 3))  # a valley, heavier than the tree
    points, poses = scene(rng, ring(), extra=[below])
    by_mass = AlignOptions(plane=plane, up_from=up_from, flip="mass")
    tilt, origin, _ = aligned_errors(points, poses, options=by_mass)
    assert tilt > 179
    assert abs(origin[2]) < 0.05
    by_cameras = AlignOptions(plane=plane, up_from=up_from)
    assert aligned_errors(points, poses, options=by_cameras)[0] < 0.5
