"""Sky masks: orientation, edges, twigs, and the shipped weights on drawn photos."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image, ImageOps

from cherrypicker.errors import StageError
from cherrypicker.photos import as_stored, upright
from cherrypicker.sky import likeness, masks, sizes
from cherrypicker.sky.mask_files import read_masks
from cherrypicker.sky.masks import MaskOptions, sky_mask
from cherrypicker.sky.scan import mask_photos, photos_by_stem
from cherrypicker.sky.unet import SkyUNet, load_weights
from cherrypicker_lab.training.sky.metrics import Confusion
from cherrypicker_lab.training.sky.synthesis import random_branches, random_sky
from cherrypicker_lab.training.sky.training import save_weights

WEIGHTS = Path(__file__).parents[2] / "resources/weights/sky_unet.npz"


class BrightTop(torch.nn.Module):
    """Stands in for the network: bright and in the upper half is sky."""

    stride = 1

    def forward(self, x):
        rows = torch.linspace(1, 0, x.shape[2]).view(1, 1, -1, 1)
        return 20.0 * torch.minimum(x.mean(dim=1, keepdim=True), rows - 0.5)


def scene(height=240, width=320, seed=0):
    """A photo with sky above, ground below, and the truth."""
    rng = np.random.default_rng(seed)
    image = np.empty((height, width, 3), np.uint8)
    image[: height // 2] = (190, 215, 240)
    image[height // 2 :] = (90, 70, 50)
    image = np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)
    sky = np.zeros((height, width), bool)
    sky[: height // 2] = True
    return image, sky


@pytest.mark.parametrize("orientation", range(1, 9))
def test_upright_is_what_exif_means(orientation):
    pixels = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    image = Image.fromarray(pixels)
    image.getexif()[0x0112] = orientation
    exif = image.getexif()
    exif[0x0112] = orientation
    expected = np.asarray(ImageOps.exif_transpose(image))
    assert np.array_equal(upright(pixels, orientation), expected)
    assert np.array_equal(as_stored(upright(pixels, orientation), orientation), pixels)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_mask_follows_the_stored_pixels(orientation):
    image, sky = scene()
    stored = np.ascontiguousarray(as_stored(image, orientation))
    mask = sky_mask(BrightTop(), stored, MaskOptions(), orientation)
    assert mask.dtype == np.uint8 and mask.shape == stored.shape[:2]
    assert np.mean((mask > 0) == as_stored(sky, orientation)) > 0.98


def test_thin_branches_that_the_network_never_saw_stay_out_of_the_sky():
    image, _ = scene(960, 1280)
    for column in range(100, 1200, 100):
        image[:480, column : column + 2] = (60, 50, 45)
    mask = sky_mask(BrightTop(), image, MaskOptions(working_side_px=320))
    twigs = mask[20:460, 100:1200:100]
    assert np.mean(twigs == 0) > 0.98
    assert np.mean(mask[20:460, 150:1200:100] == 255) > 0.98


def test_a_white_post_before_a_white_sky_stays_out_of_it_where_the_network_is_sure():
    image, probability = np.full((800, 1200, 3), 235, np.uint8), np.full((400, 600), 0.999)
    image[:, 600:608] = 228
    sure, in_doubt = probability.copy(), probability.copy()
    sure[:, 300:304], in_doubt[:, 300:304] = 0.001, 0.1
    for probability, share in ((sure, 0.0), (in_doubt, 1.0)):
        mask = np.full((800, 1200), 255, np.uint8)
        mask[:, 600:608] = 0
        told = likeness.tell_thin_things(image, mask, probability.astype(np.float32), 0.08)
        assert np.mean(told[100:700, 602:606] == 255) == pytest.approx(share, abs=0.05)


def test_sunlit_twigs_before_a_grey_cloud_stay_out_of_the_sky():
    """They hold hardly less blue than the cloud, but far more red."""
    image, _ = scene(960, 1280)
    image[:480] = (196, 196, 198)
    for column in range(100, 1200, 100):
        image[:480, column : column + 2] = (212, 204, 182)
    mask = sky_mask(BrightTop(), image, MaskOptions(working_side_px=320))
    assert np.mean(mask[20:460, 100:1200:100] == 0) > 0.98
    assert np.mean(mask[20:460, 150:1200:100] == 255) > 0.98


def test_gaps_that_the_network_took_for_wood_are_sky():
    """Narrow and of the sky's colour; a pale wall of that colour is wide and stays."""
    image, _ = scene(480, 640)
    image[:240, 300:400] = image[:240, 500:620] = (60, 50, 45)
    gaps = [304, 311, 387, 394]
    for column in gaps:
        image[:200, column : column + 2] = (190, 215, 240)
    image[:200, 510:610] = (186, 210, 236)
    probability = np.where(np.arange(480) < 240, 0.99, 0.0)[:, None].repeat(640, axis=1)
    probability[:240, 300:400] = probability[:240, 500:620] = 0.1
    options = MaskOptions(color_weight=0.0)
    mask = masks.mask_from_probability(image, probability.astype(np.float32), options)
    assert np.mean(mask[20:190, gaps] == 255) > 0.9
    assert np.mean(mask[20:190, np.subtract(gaps, 2)] == 0) > 0.98
    assert np.mean(mask[20:180, 520:600] == 0) > 0.98


def test_mask_edge_lies_where_the_photo_has_it():
    image, sky = scene(960, 1280)
    mask = sky_mask(BrightTop(), image, MaskOptions(working_side_px=240))
    wrong = (mask > 0) != sky
    assert not wrong[:470].any() or np.mean(wrong[:470]) < 0.002
    assert np.mean(wrong[485:]) < 0.002


def test_strips_change_nothing(monkeypatch):
    image, _ = scene(500, 400, seed=3)
    whole = sky_mask(BrightTop(), image, MaskOptions(working_side_px=200))
    monkeypatch.setattr(sizes, "STRIP_ROWS", 37)
    assert np.array_equal(whole, sky_mask(BrightTop(), image, MaskOptions(working_side_px=200)))


def test_photo_without_sky_gives_an_empty_mask():
    image = np.full((100, 150, 3), 40, np.uint8)
    assert not sky_mask(BrightTop(), image, MaskOptions()).any()


def test_weights_survive_the_file(tmp_path):
    torch.manual_seed(0)
    net = SkyUNet((4, 8)).eval()
    save_weights(tmp_path / "a.npz", net)
    save_weights(tmp_path / "b.npz", net)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    x = torch.rand(1, 3, 30, 22)
    with torch.inference_mode():
        assert torch.allclose(load_weights(tmp_path / "a.npz")(x), net(x), atol=0.05)


def test_bad_weights_name_the_key(tmp_path):
    (tmp_path / "w.npz").write_bytes(b"nothing")
    with pytest.raises(StageError, match=r"sky\.weights"):
        load_weights(tmp_path / "w.npz")
    with pytest.raises(StageError, match=r"sky\.weights"):
        load_weights(tmp_path / "absent.npz")


def test_two_photos_of_one_stem_are_refused(tmp_path):
    for name in ("a.jpg", "A.png", "b.jpg"):
        Image.new("RGB", (8, 8)).save(tmp_path / name)
    with pytest.raises(StageError, match=r"A\.png, a\.jpg"):
        photos_by_stem(tmp_path)


def test_folder_of_photos_gives_a_mask_each(tmp_path):
    photos = tmp_path / "photos"
    photos.mkdir()
    image, sky = scene()
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(image).save(photos / "one.JPG", quality=95)
    turned = Image.fromarray(np.ascontiguousarray(as_stored(image, 6)))
    turned.save(photos / "two.png", exif=exif)
    Image.fromarray(np.zeros_like(image)).save(photos / "three.jpg")
    samples = mask_photos(
        BrightTop(), photos, tmp_path / "sky", MaskOptions(), n_samples=300, seed=1
    )
    again = mask_photos(
        BrightTop(), photos, tmp_path / "sky2", MaskOptions(), n_samples=300, seed=1
    )
    assert sorted(p.name for p in (tmp_path / "sky").iterdir()) == [
        "one.png",
        "three.png",
        "two.png",
    ]
    assert np.mean(read_masks(tmp_path / "sky/one.png", (240, 320))[0] == sky) > 0.98
    assert np.mean(read_masks(tmp_path / "sky/two.png")[0] == as_stored(sky, 6)) > 0.98
    assert not read_masks(tmp_path / "sky/three.png")[0].any()
    assert np.array_equal(samples, again) and len(samples) == 200
    assert np.abs(samples.mean(axis=0) - (190, 215, 240)).max() < 5
    with pytest.raises(StageError, match="320 x 240"):
        read_masks(tmp_path / "sky/one.png", (10, 10))


def test_a_photo_that_cannot_be_read_costs_the_others_nothing(tmp_path, caplog):
    photos, sky = tmp_path / "photos", tmp_path / "sky"
    photos.mkdir()
    Image.fromarray(scene()[0]).save(photos / "b.jpg")
    for name in ("a.jpg", "c.jpg"):
        (photos / name).write_bytes((photos / "b.jpg").read_bytes()[:500])
    mask_photos(BrightTop(), photos, sky, MaskOptions(), n_samples=300, seed=1)
    assert [path.name for path in sky.iterdir()] == ["b.png"]
    assert "a.jpg has no mask" in caplog.text and "c.jpg has no mask" in caplog.text
    (photos / "b.jpg").unlink()
    with pytest.raises(StageError, match="cannot be read") as caught:
        mask_photos(BrightTop(), photos, sky, MaskOptions(), n_samples=300, seed=1)
    assert caught.value.file == str(photos / "a.jpg")


def test_what_a_user_hides_is_neither_sky_nor_a_sample_of_its_colours(tmp_path):
    image, sky = scene()
    image[:60] = (250, 20, 20)  # what the user hides, and the network would call sky
    hidden = np.zeros(sky.shape, bool)
    hidden[:60] = True
    for name in ("photos", "own"):
        (tmp_path / name).mkdir()
    Image.fromarray(image).save(tmp_path / "photos/a.png")
    Image.fromarray(np.where(hidden, 0, 255).astype(np.uint8)).save(tmp_path / "own/a.png.png")
    samples = mask_photos(
        BrightTop(),
        tmp_path / "photos",
        tmp_path / "sky",
        MaskOptions(),
        n_samples=300,
        seed=1,
        photo_masks=tmp_path / "own",
    )
    told, kept = read_masks(tmp_path / "sky/a.png")
    assert np.array_equal(kept, hidden) and not told[hidden].any()
    assert told[70:110].mean() > 0.95
    assert samples[:, 1].min() > 150


def test_shipped_weights_find_drawn_skies_and_spare_twigs():
    net = load_weights(WEIGHTS)
    rng = np.random.default_rng(20)
    confusion = Confusion()
    for _ in range(6):
        shape = (360, 480)
        image = random_sky(rng, shape)
        sky = np.ones(shape, bool)
        texture = cv2.resize(rng.random((60, 80)).astype(np.float32), (480, 360))
        ground = texture[..., None] * np.array([0.35, 0.30, 0.22], np.float32)
        image[220:], sky[220:] = ground[220:], False
        image, cover = random_branches(rng, image)
        sky &= cover < 0.5
        pixels = (np.clip(image, 0, 1) * 255).astype(np.uint8)
        confusion.add(sky_mask(net, pixels, MaskOptions()) / 255.0, sky)
    scores = confusion.summary()
    assert scores["f1_sky"] > 0.9 and scores["f1_ground"] > 0.9
