"""The renderer's own parts: rays, EXIF, meshes; Blender itself only where it is installed."""

import ast
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import numpy as np
import pytest
import render_scene
from PIL import Image

from cherrypicker.batch.watched_modules import imported_modules
from cherrypicker_lab.orchard.grow.tree import Axis
from cherrypicker_lab.orchard.render import blender, photo
from cherrypicker_lab.orchard.scene import ground
from cherrypicker_lab.orchard.scene.appearance import encode_srgb
from cherrypicker_lab.orchard.scene.boards import stem_ring
from cherrypicker_lab.orchard.scene.cameras import CameraModel, Ring, ring_poses
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.mesh import box


def test_its_environment_has_what_it_imports(project):
    script = project / "scripts/lab/render_scene.py"
    lines = (project / "envs/requirements-render.txt").read_text().splitlines()
    installed = {line.split("==")[0].lower() for line in lines if "==" in line}
    packages = packages_distributions()
    needed = set()
    for path in [script, *map(Path, imported_modules(script, project / "scripts"))]:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) else []
            tops = {name.partition(".")[0] for name in names} - sys.stdlib_module_names
            needed.update(packages.get(top, [top])[0].lower() for top in tops)
    ours = {"cherrypicker", "cherrypicker_lab", "lab_path"}
    assert {"numpy", "psutil"} <= needed
    assert needed - ours - installed - {"opencv-contrib-python-headless"} == set()


def test_pixel_rays_invert_the_projection():
    camera = CameraModel(width=60, height=90, focal_px=80.0)
    poses = ring_poses([Ring(3, 1.1, 2.4, 1.0)], camera, seed=2)
    for i in range(3):
        rays = photo.pixel_rays(poses.K[i], poses.cam_from_world[i], 60, 90)
        uv, depth = poses[i].project(poses.centers[i] + 3.0 * rays)
        assert depth.min() > 0
        columns, rows = np.meshgrid(np.arange(60) + 0.5, np.arange(90) + 0.5)
        np.testing.assert_allclose(uv, np.column_stack([columns.ravel(), rows.ravel()]), atol=1e-6)


def test_subdivision_keeps_the_surface():
    mesh = box((0.2, 0.3, 0.4))
    fine = blender.subdivided(mesh, 2)
    assert len(fine.faces) == 16 * len(mesh.faces)
    assert fine.face_areas().sum() == pytest.approx(mesh.face_areas().sum())
    np.testing.assert_allclose(fine.attributes["rest"], fine.vertices)


def test_photo_carries_the_focal_length_that_colmap_reads(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    camera = CameraModel(width=160, height=240, focal_px=210.0)
    picture = np.full((240, 160, 3), 120, np.uint8)
    path = tmp_path / "photo.jpg"
    photo.write_jpeg(path, picture, camera)
    assert Image.open(path).getexif()[0x0110] == camera.model
    guess = pycolmap.infer_camera_from_image(str(path))
    assert guess.has_prior_focal_length
    assert guess.mean_focal_length() == pytest.approx(210.0, rel=0.04)


@pytest.mark.parametrize("kind", sorted(ground.GROUNDS))
def test_ground_texture_is_the_ground_s_color_with_north_on_top(kind):
    half, size = 1.5, 24
    image = ground.bake_ground(3, half, size, kind)
    axis = (np.arange(size) + 0.5) / size * 2 * half - half
    places = np.stack(np.meshgrid(axis, -axis), axis=-1).reshape(-1, 2)
    wanted = 255 * encode_srgb(ground.ground_color(places, 3, kind)).reshape(size, size, 3)
    assert np.abs(image - wanted).max() < 1.0
    assert image.std() > 5


def test_grounds_differ_and_unknown_ones_are_refused():
    places = np.random.default_rng(0).uniform(-2, 2, (4000, 2))
    means = np.array([ground.ground_color(places, 3, kind).mean(axis=0) for kind in ground.GROUNDS])
    apart = np.linalg.norm(means[:, None] - means[None], axis=2) + np.eye(len(means))
    assert apart.min() > 0.005
    strip = np.column_stack([places[:, 0], 0.1 * places[:, 1]])
    away = strip + [0.0, 5.0]
    for kind, in_strip in (("mulch", True), ("gravel", False)):
        gap = np.subtract(*(ground.ground_color(at, 3, kind).mean(axis=0) for at in (strip, away)))
        assert (np.abs(gap).max() > 0.03) == in_strip
    with pytest.raises(ValueError, match="ground"):
        ground.ground_color(places, 3, "lava")


def test_a_stem_that_forks_at_8_cm_wears_a_ring_below_its_fork():
    stem = Axis(np.linspace([0, 0, 0], [0.01, 0, 0.08], 5), np.full(5, 0.03), order=0)
    sleeve = stem_ring(np.random.default_rng(0), 1, stem).mesh.vertices
    assert np.isfinite(sleeve).all()
    assert 0.03 < sleeve[:, 2].min() < sleeve[:, 2].max() < 0.1


@pytest.mark.slow
def test_rendered_ring_lies_where_the_truth_says(tmp_path, monkeypatch):
    pytest.importorskip("bpy")
    monkeypatch.setattr(blender, "GROUND_TEXTURES", ((1.25, 6.0), (3.5, 30.0)))
    monkeypatch.setattr(blender, "HORIZON_PIXEL_M", 0.5)
    scene = generate_scene(3, neighbours=0, ring=True, sky="overcast", sign=False, post=False)
    camera = CameraModel(width=240, height=360, focal_px=315.0)
    poses = ring_poses([Ring(2, 0.6, 1.2, 0.45)], camera, seed=1)
    monkeypatch.setattr(
        sys,
        "argv",
        ["render_scene", "--preset", "cherry_vase", "--output", str(tmp_path), "--noise", "0"],
    )
    render_scene.render(scene, poses, camera, tmp_path, render_scene.parse_arguments())
    sleeve = next(o for o in scene.objects if o.name == "ring").mesh.vertices
    for i in range(2):
        picture = np.asarray(Image.open(Path(tmp_path) / "photos" / poses.names[i])).astype(int)
        uv, _ = poses[i].project(sleeve)
        low, high = uv.min(0), uv.max(0)
        middle = tuple(np.round((low + high) / 2).astype(int)[::-1])
        assert picture[middle].min() > 150  # white sleeve
        beside = (middle[0], int(high[0]) + 6)
        assert picture[beside].min() < 150
