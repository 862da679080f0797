"""Rendered photos and their maps against the truth they were rendered from. Needs Blender's bpy.

Run them with the environment that renders: `.venv-render/bin/python -m pytest -m render
tests/lab/orchard/test_orchard_rendered.py`.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import render_scene
from PIL import Image
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker_lab.orchard.render import blender
from cherrypicker_lab.orchard.render.photo import SKY_ID, decode_srgb
from cherrypicker_lab.orchard.render.wind import sway
from cherrypicker_lab.orchard.scene.backdrop import backdrop
from cherrypicker_lab.orchard.scene.cameras import CameraModel, Ring, ring_poses
from cherrypicker_lab.orchard.scene.layout import generate_scene

pytest.importorskip("bpy", reason="renders with Blender: run it in the environment that has bpy")
pytestmark = [pytest.mark.slow, pytest.mark.render]

CAMERA = CameraModel(width=480, height=360, focal_px=330.0, k1=-0.12, k2=0.01)
MARKERS = [
    {"dictionary": "DICT_5X5_100", "id": 7, "side_m": 0.2, "pose": "standing", "xy": (0.5, -0.5),
     "azimuth": 2.5},
    {"dictionary": "DICT_APRILTAG_36h11", "id": 9, "side_m": 0.2, "pose": "standing",
     "xy": (0.65, 0.1), "azimuth": 3.0},
]  # fmt: skip


class Rendered:
    """Two photos of a scene with wind, buds, relief, a net and a lens of strong distortion."""

    def __init__(self, folder):
        self.folder = folder
        self.scene = generate_scene(
            3, habit="vase", height=1.6, trunk_radius=0.04, neighbours=1, row_spacing=2.0,
            markers=MARKERS, sky="overcast", sign=False, ring=True, cube=False, post=True,
            roof=False, wind=0.02, buds=20.0, relief=1.0, ground="gravel", net="along",
        )  # fmt: skip
        rings = [Ring(1, 0.7, 1.6, 0.45, -0.35), Ring(1, 1.1, 1.7, 0.5, -0.8)]
        self.poses = ring_poses(
            rings, CAMERA, seed=1, ground=self.scene.ground_height,
            obstacles=self.scene.neighbour_wood(),
        )  # fmt: skip
        self.render()

    def render(self):
        sys.argv = [
            "render_scene",
            "--preset",
            "cherry_vase",
            "--output",
            "-",
            "--noise",
            "0",
            "--maps",
        ]
        args = render_scene.parse_arguments()
        render_scene.render(self.scene, self.poses, CAMERA, self.folder, args)

    def photo(self, i):
        return np.asarray(Image.open(self.folder / "photos" / self.poses.names[i]))

    def maps(self, i):
        truth, stem = self.folder / "truth", Path(self.poses.names[i]).stem
        with np.load(truth / "depth" / f"{stem}.npz") as stored:
            maps = dict(stored)
        return maps | {"semantic": np.asarray(Image.open(truth / "semantic" / f"{stem}.png"))}

    def seen(self, i, points, *, distortion=True):
        """COLMAP's RADIAL model by hand: pixels of points (n, 3)."""
        pose = self.poses.cam_from_world[i]
        local = points @ pose[:, :3].T + pose[:, 3]
        u = local[:, :2] / local[:, 2:]
        r2 = (u**2).sum(axis=1, keepdims=True)
        if distortion:
            u = u * (1 + CAMERA.k1 * r2 + CAMERA.k2 * r2**2)
        return CAMERA.focal_px * u + [CAMERA.width / 2, CAMERA.height / 2]

    def directions(self):
        """Undistorted rays (h, w, 3) of the pixels in the camera's frame, z = 1."""
        x, y = np.meshgrid(np.arange(CAMERA.width) + 0.5, np.arange(CAMERA.height) + 0.5)
        u = np.stack([x - CAMERA.width / 2, y - CAMERA.height / 2], axis=-1) / CAMERA.focal_px
        straight = cv2.undistortPoints(
            u.reshape(-1, 1, 2), np.eye(3), np.array([CAMERA.k1, CAMERA.k2, 0.0, 0.0])
        )
        return np.concatenate([straight.reshape(u.shape), np.ones(x.shape + (1,))], axis=-1)

    def places(self, i):
        """World positions (h, w, 3) of the depth map."""
        pose = self.poses.cam_from_world[i]
        local = self.directions() * self.maps(i)["depth"][..., None]
        return (local - pose[:, 3]) @ pose[:, :3]

    def tree_nodes(self, number, i=None):
        """Nodes and radii of a tree as it stands in a photo, or at rest."""
        tree = self.scene.trees[number]
        moved = sway(tree, self.scene.wind_m, self.scene.seed, i) if i is not None else None
        fine = [np.linspace(0, len(a.points) - 1, 4 * len(a.points)) for a in tree.axes]
        nodes, radii = [], []
        for k, (axis, at) in enumerate(zip(tree.axes, fine)):
            points = axis.points if moved is None else axis.points + moved[k]
            n = np.arange(len(points))
            nodes.append(np.stack([np.interp(at, n, c) for c in points.T], axis=1))
            radii.append(np.interp(at, n, axis.radii))
        return np.concatenate(nodes) + self.scene.offsets[number], np.concatenate(radii)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    patch = pytest.MonkeyPatch()
    patch.setattr(blender, "GROUND_TEXTURES", ((1.25, 3.0), (3.5, 12.0)))
    patch.setattr(blender, "HORIZON_PIXEL_M", 0.5)
    patch.setattr(sys, "argv", sys.argv)
    yield Rendered(Path(tmp_path_factory.mktemp("rendered")))
    patch.undo()


def test_detected_markers_lie_where_pose_and_lens_put_them(rendered):
    gaps, as_pinhole = [], []
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 3
    parameters.relativeCornerRefinmentWinSize = 10.0  # of a module: the window is 3 px
    for i in range(2):
        # sRGB makes white grow over black edges by a third of a pixel: light does not
        light = decode_srgb(rendered.photo(i) / 255.0).mean(axis=-1)
        grey = np.round(255 * np.clip(light / 0.75, 0, 1)).astype(np.uint8)
        for marker in rendered.scene.markers:
            book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, marker["dictionary"]))
            corners, ids, _ = cv2.aruco.ArucoDetector(book, parameters).detectMarkers(grey)
            for quad, number in zip(corners, [] if ids is None else ids.ravel()):
                if number == marker["id"]:
                    truth = np.array(marker["corners"])
                    found = quad[0] + 0.5  # OpenCV's pixel centres are whole
                    gaps.append(found - rendered.seen(i, truth))
                    as_pinhole.append(found - rendered.seen(i, truth, distortion=False))
    assert len(gaps) >= 3
    gaps, as_pinhole = np.array(gaps), np.array(as_pinhole)  # (n, 4, 2)
    assert np.linalg.norm(gaps.mean(axis=1), axis=1).max() < 0.25
    assert np.median(np.linalg.norm(gaps, axis=2)) < 0.5
    assert np.linalg.norm(gaps, axis=2).max() < 1.0
    assert np.linalg.norm(as_pinhole.mean(axis=1), axis=1).min() > 0.7


def test_exif_gives_the_pipeline_its_focal_length(rendered):
    pycolmap = pytest.importorskip("pycolmap")
    guess = pycolmap.infer_camera_from_image(str(rendered.folder / "photos/IMG_0001.jpg"))
    assert guess.has_prior_focal_length
    assert guess.mean_focal_length() == pytest.approx(CAMERA.focal_px, rel=0.04)


@pytest.mark.parametrize("i", [0, 1])
def test_depth_is_that_of_the_surfaces(rendered, i):
    maps, places = rendered.maps(i), rendered.places(i)
    ground = (maps["semantic"] == Label.GROUND) & (maps["depth"] < 4)
    level = rendered.scene.ground_height(places[ground][:, :2])
    assert np.quantile(np.abs(places[ground][:, 2] - level), 0.99) < 0.01
    for number in np.unique(maps["tree"][maps["tree"] != 255]):
        here = places[maps["tree"] == number]
        nodes, radii = rendered.tree_nodes(number, i)
        distance, nearest = cKDTree(nodes).query(here)
        off = distance - radii[nearest]
        assert abs(np.median(off)) < 0.0015
        assert np.quantile(off, 0.9) < 0.008  # buds stand out
    for marker in rendered.scene.markers:
        corners = np.array(marker["corners"])
        middle = np.round(rendered.seen(i, corners.mean(axis=0)[None])[0] - 0.5).astype(int)
        if not (0 <= middle[0] < CAMERA.width and 0 <= middle[1] < CAMERA.height):
            continue
        x, y = middle
        if maps["semantic"][y, x] != Label.MARKER:
            continue
        normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
        normal /= np.linalg.norm(normal)
        assert abs((places[y, x] - corners[0]) @ normal) < 0.002


def test_maps_are_those_of_the_tree_in_the_wind(rendered):
    maps, places = rendered.maps(0), rendered.places(0)
    here = places[(maps["tree"] == 0) & (maps["semantic"] == Label.BRANCH)]
    medians = []
    for photo in (None, 0, 1):
        nodes, radii = rendered.tree_nodes(0, photo)
        distance, nearest = cKDTree(nodes).query(here)
        medians.append(np.median(np.abs(distance - radii[nearest])))
    assert medians[1] < 0.5 * medians[0]
    assert medians[1] < 0.5 * medians[2]


@pytest.mark.parametrize("i", [0, 1])
def test_normals_are_in_the_camera_s_frame(rendered, i):
    maps = rendered.maps(i)
    normals, there = maps["normals"].astype(float), maps["depth"] > 0
    np.testing.assert_allclose(np.linalg.norm(normals[there], axis=1), 1.0, atol=0.01)
    assert ((normals * rendered.directions()).sum(axis=-1)[there] < 0.01).mean() > 0.999
    turn = rendered.poses.cam_from_world[i][:, :3]
    ground = (maps["semantic"] == Label.GROUND) & (maps["depth"] < 4)
    assert (normals[ground] @ turn).mean(axis=0)[2] > 0.9
    trunk = maps["semantic"] == Label.TRUNK
    nodes, _ = rendered.tree_nodes(0, i)
    outward = rendered.places(i)[trunk] - nodes[cKDTree(nodes).query(rendered.places(i)[trunk])[1]]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert np.median(((normals[trunk] @ turn) * outward).sum(axis=1)) > 0.9


@pytest.mark.parametrize("i", [0, 1])
def test_semantic_ids_and_trees(rendered, i):
    maps = rendered.maps(i)
    kinds = set(np.unique(maps["semantic"]))
    wanted = {Label.GROUND, Label.TRUNK, Label.BRANCH, Label.MARKER, Label.ROOF, SKY_ID}
    assert wanted <= kinds
    wood = np.isin(maps["semantic"], (Label.TRUNK, Label.BRANCH))
    np.testing.assert_array_equal(wood, maps["tree"] != 255)
    np.testing.assert_array_equal(maps["depth"] == 0, maps["semantic"] > Label.SUPPORT_POST)
    rays = rendered.directions().reshape(-1, 3) @ rendered.poses.cam_from_world[i][:, :3]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    _, is_sky = backdrop(rays, rendered.scene.light.sky, rendered.scene.seed)
    free = (maps["depth"] == 0).ravel()
    agree = (maps["semantic"].ravel() == SKY_ID)[free] == is_sky[free]
    assert agree.mean() > 0.98
    photo = rendered.photo(i).astype(int)
    light = photo.sum(axis=-1) / 3
    sky, floor = maps["semantic"] == SKY_ID, maps["semantic"] == Label.GROUND
    assert np.median(light[sky]) > np.median(light[floor]) + 10


def test_an_interrupted_run_goes_on_with_equal_bytes(rendered):
    files = sorted(p for p in rendered.folder.rglob("*") if p.is_file())
    assert len(files) == 6
    before = {p: p.read_bytes() for p in files}
    kept = rendered.folder / "photos/IMG_0001.jpg"
    stamp = kept.stat().st_mtime_ns
    for p in files:
        if p.stem == "IMG_0002":
            p.unlink()
    rendered.render()
    assert kept.stat().st_mtime_ns == stamp
    assert {p: p.read_bytes() for p in files} == before
