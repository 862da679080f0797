"""What stereo leaves out as clear sky, and that it never is a twig."""

import cv2
import numpy as np
import pytest
from stereo_scene import Surface, write_scene

from cherrypicker.errors import StageError
from cherrypicker.mvs.backends.choice import estimate_workspace
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.raster import CLEAR_BELOW, SkyMasks, make_raster, write_rasters
from cherrypicker.mvs.workspace import Workspace
from cherrypicker.sky.mask_files import HIDDEN

# A cylinder about four pixels wide before plain grey
WALL = [Surface(seed=5)]
TWIG = [Surface(center=(0.1, 0.0, 3.5), radius=0.045, seed=3)]


def cloudy_sky(height=240, width=320, seed=0):
    """Broad clouds with sensor noise, (height, width, 3) uint8."""
    rng = np.random.default_rng(seed)
    clouds = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 20)
    noise = rng.normal(size=(height, width, 3)) * 2.0
    photo = np.array([190, 205, 230]) + 25.0 * (clouds / clouds.std())[..., None] + noise
    return np.clip(photo, 0, 255).astype(np.uint8)


def clear_sky(photo, sky):
    """Where a photo shows clear sky, by its mask."""
    return make_raster(photo, sky, np.zeros_like(sky)) < CLEAR_BELOW


def test_clouds_are_left_out_and_thin_twigs_are_not_however_wrong_the_mask():
    photo = cloudy_sky()
    twig = np.zeros(photo.shape[:2], np.uint8)
    cv2.line(twig, (40, 220), (250, 20), 1, 1)
    cv2.line(twig, (100, 160), (220, 170), 1, 2)
    photo[twig > 0] = (photo[twig > 0] * 0.6).astype(np.uint8)
    skipped = clear_sky(photo, np.ones(twig.shape, bool))
    assert not skipped[twig > 0].any()
    aside = cv2.dilate(twig, np.ones((9, 9), np.uint8)) == 0
    assert skipped[aside].mean() > 0.95


def test_nothing_outside_the_mask_is_left_out():
    sky = np.zeros((240, 320), bool)
    sky[:100] = True
    skipped = clear_sky(cloudy_sky(), sky)
    assert skipped[:100].mean() > 0.95
    assert not skipped[100:].any()


def write_masks(folder, masks):
    folder.mkdir()
    for i, mask in enumerate(masks):
        cv2.imwrite(str(folder / f"view{i}.png"), np.where(mask, 255, 0).astype(np.uint8))


def evidence_of(folder):
    """Say what the photos of a scene show by its masks; return the folder of the rasters."""
    poses = Workspace(folder / "scene").poses
    masks = SkyMasks(folder / "sky", folder / "scene/sparse")
    write_rasters(folder / "scene/images", poses, masks, folder / "evidence")
    return folder / "evidence"


def test_masks_of_all_sky_keep_the_twig_and_clear_the_rest(tmp_path):
    scene = tmp_path / "scene"
    _, _, depths = write_scene(scene, TWIG, n_points=3000)
    write_masks(tmp_path / "sky", [np.ones_like(d, dtype=bool) for d in depths])
    options = StereoOptions(min_texture=0.0)
    estimate_workspace(scene, options, backend="cpu", evidence=evidence_of(tmp_path))
    workspace = Workspace(scene)
    found = workspace.read_depth(workspace.views[2], "photometric")
    twig = depths[2] > 0.0
    far = cv2.dilate(twig.astype(np.uint8), np.ones((15, 15), np.uint8)) == 0
    assert not found[far].any()
    near = np.abs(found - depths[2]) < 0.03 * depths[2]
    assert near[twig].mean() > 0.6


def test_maps_of_other_masks_are_computed_again(tmp_path):
    scene = tmp_path / "scene"
    _, _, depths = write_scene(scene, TWIG, n_points=3000)
    write_masks(tmp_path / "sky", [d == 0.0 for d in depths])
    workspace = Workspace(scene)
    paths = [workspace.depth_path(view, "photometric") for view in workspace.views]

    def times():
        evidence = evidence_of(tmp_path)
        estimate_workspace(scene, StereoOptions(), backend="cpu", evidence=evidence)
        return [path.stat().st_mtime_ns for path in paths]

    before = times()
    assert times() == before
    cv2.imwrite(str(tmp_path / "sky" / "view3.png"), np.zeros(depths[3].shape, np.uint8))
    assert all(after > time for after, time in zip(times(), before))


def test_what_a_user_hides_gets_no_depth(tmp_path):
    scene = tmp_path / "scene"
    _, _, depths = write_scene(scene, WALL, n_points=3000)
    kinds = np.zeros(depths[2].shape, np.uint8)
    kinds[:, :40], kinds[:, 120:] = HIDDEN, 255
    write_masks(tmp_path / "sky", [np.zeros(d.shape, bool) for d in depths])
    cv2.imwrite(str(tmp_path / "sky" / "view2.png"), kinds)
    workspace = Workspace(scene)
    estimate_workspace(scene, StereoOptions(), backend="cpu", evidence=evidence_of(tmp_path))
    for kind in ("photometric", "geometric"):
        found = workspace.read_depth(workspace.views[2], kind) > 0
        assert not found[:, :40].any()
        assert found[20:100, 45:115].mean() > 0.7
        # Texture is no clear sky, whatever the mask
        assert found[20:100, 125:150].any()


def test_a_missing_mask_is_told(tmp_path):
    write_scene(tmp_path / "scene", TWIG)
    workspace = Workspace(tmp_path / "scene")
    masks = SkyMasks(tmp_path / "sky", tmp_path / "scene" / "sparse")
    with pytest.raises(StageError, match="sky mask is missing"):
        masks.both(workspace.views[0])


def test_a_mask_is_seen_through_the_lens(tmp_path):
    """A distorted photo's mask, seen undistorted, is where the lens puts it."""
    import pycolmap

    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(
            camera_id=1, model="SIMPLE_RADIAL", width=160, height=120, params=[150, 80, 60, -0.3]
        )
    )
    image = pycolmap.Image(name="view0.png", camera_id=1, image_id=1)
    model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    (tmp_path / "model").mkdir()
    model.write(tmp_path / "model")
    stored = np.zeros((120, 160), bool)
    stored[:, 120:] = True
    write_masks(tmp_path / "sky", [stored])
    write_scene(tmp_path / "scene", TWIG)
    view = Workspace(tmp_path / "scene").views[0]
    seen = SkyMasks(tmp_path / "sky", tmp_path / "model").both(view)[0]
    # x = 120 px lies at r (1 - 0.3 r^2) = 40 / 150 in the middle row, so at r = 0.2734 or 121.0 px
    assert not seen[60, :120].any()
    assert seen[60, 122:].all()
