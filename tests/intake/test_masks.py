"""A user's own masks: where they lie on the photo, which ones are refused, what they hide."""

import numpy as np
import pycolmap
import pytest
from PIL import Image
from sfm_scene import write_orbit

from cherrypicker.errors import StageError
from cherrypicker.intake.kinds import captures_in
from cherrypicker.intake.masks import match_masks, read_hidden, read_user_mask
from cherrypicker.intake.prepare import PrepareOptions, prepare_photos
from cherrypicker.sfm.database import image_ids
from cherrypicker.sfm.features import FeatureOptions, extract_features

SHAPE = (40, 60)


def save(path, mask, orientation=1):
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(np.where(mask, 0, 255).astype(np.uint8)).save(path, exif=exif)


@pytest.mark.parametrize("own_turn", [1, 6])
def test_a_mask_is_laid_over_the_photo_as_one_sees_it(tmp_path, own_turn):
    """A sideways photo: its sensor's left edge is the top of what one sees."""
    top = np.zeros((SHAPE[1], SHAPE[0]), bool)
    top[:15] = True
    save(tmp_path / "a.png", np.rot90(top, 1) if own_turn == 6 else top, own_turn)
    hidden = read_user_mask(tmp_path / "a.png", "a.jpg", SHAPE, 6)
    wanted = np.zeros(SHAPE, bool)
    wanted[:, :15] = True
    assert np.array_equal(hidden, wanted)


@pytest.mark.parametrize(
    ("name", "shape", "cause"),
    [
        ("a.png", (30, 60), "the mask has 60 x 30 pixels, a.jpg as one sees it 60 x 40"),
        ("b.png", SHAPE, "belongs to no photo"),
        ("a.jpg.png", SHAPE, "has two masks"),
    ],
)
def test_masks_that_do_not_fit_are_refused(tmp_path, name, shape, cause):
    if name != "a.png":
        save(tmp_path / "a.png", np.zeros(SHAPE, bool))
    save(tmp_path / name, np.zeros(shape, bool))
    with pytest.raises(StageError, match=cause) as caught:
        read_user_mask(match_masks(tmp_path, ["a.jpg"])["a.jpg"], "a.jpg", SHAPE, 1)
    assert caught.value.key == "masks in trees.tsv" and ".png" in caught.value.file


def test_the_mask_of_a_photo_that_is_left_out_is_passed_over(tmp_path):
    save(tmp_path / "a.png", np.zeros(SHAPE, bool))
    save(tmp_path / "b.HEIC.png", np.zeros(SHAPE, bool))
    assert [*match_masks(tmp_path, ["a.jpg"], ["b.HEIC"])] == ["a.jpg"]


def test_a_folder_without_masks_and_a_broken_mask_are_refused(tmp_path):
    with pytest.raises(StageError, match="holds no mask"):
        match_masks(tmp_path, ["a.jpg"])
    with pytest.raises(StageError, match="is missing"):
        match_masks(tmp_path / "none", ["a.jpg"])
    (tmp_path / "a.png").write_bytes(b"no PNG")
    with pytest.raises(StageError, match="cannot be read"):
        read_user_mask(tmp_path / "a.png", "a.jpg", SHAPE, 1)


def test_what_is_hidden_gives_no_features_and_a_photo_without_a_mask_is_used_whole(tmp_path):
    write_orbit(tmp_path / "photos", 3)
    captures = captures_in(tmp_path / "photos")
    with Image.open(captures[0]) as image:
        width, height = image.size
    left = np.zeros((height, width), bool)
    left[:, : width // 2] = True
    (tmp_path / "own").mkdir()
    for path in captures[:2]:
        save(tmp_path / "own" / f"{path.stem}.png", left)
    photos, masks = tmp_path / "ready", tmp_path / "masks"
    options = PrepareOptions(max_size_px=width // 2)
    listing = prepare_photos(captures, photos, masks, options, user_masks=tmp_path / "own")
    names = sorted(listing["photos"])
    assert listing["without_mask"] == [captures[2].name]
    assert [listing["photos"][name]["hidden"] for name in names] == [0.5, 0.5, 0.0]
    hidden = read_hidden(masks, names[0], (height // 2, width // 2))
    assert hidden[:, : width // 4].all() and not hidden[:, width // 4 + 1 :].any()
    database = tmp_path / "f.db"
    extract_features(
        sorted(photos.iterdir()), database, tmp_path / "l.json", FeatureOptions(), masks=masks
    )
    with pycolmap.Database.open(database) as features:
        across = {
            name: features.read_keypoints(number)[:, 0] / (width // 2)
            for name, number in image_ids(database).items()
        }
    for name, is_masked in zip(names, (True, True, False), strict=True):
        assert len(across[name]) > 20
        assert (across[name].min() >= 0.5) == is_masked
