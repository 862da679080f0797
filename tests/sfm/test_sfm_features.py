"""Features of large photos: searched without enlarging them where that gives enough."""

import sqlite3
from contextlib import closing

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.spatial import cKDTree
from sfm_scene import texture

from cherrypicker.sfm import features
from cherrypicker.sfm.features import FeatureOptions, Search, extract_features
from cherrypicker.sfm.photo_files import megapixels

N_WANTED = 200


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """Three photos with more features than wanted and one, the second, that is blurred."""
    folder = tmp_path_factory.mktemp("photos")
    paths = []
    for i in range(4):
        photo = texture(np.random.default_rng(i), 420)[:300]
        if i == 1:
            photo = cv2.GaussianBlur(photo, (0, 0), 8.0)
        paths.append(folder / f"{i}.png")
        cv2.imwrite(str(paths[-1]), photo)
    return paths


def extract(photos, folder, monkeypatch, plain_first_mp):
    """Return the positions and sizes of each photo's features."""
    searched = []
    search = pycolmap.extract_features

    def watched(*files, image_names, extraction_options, **how):
        searched.append((extraction_options.sift.first_octave, image_names))
        search(*files, image_names=image_names, extraction_options=extraction_options, **how)

    with monkeypatch.context() as patch:
        patch.setattr(features, "PLAIN_FIRST_MP", plain_first_mp)
        patch.setattr(pycolmap, "extract_features", watched)
        extract_features(
            photos,
            folder / "f.db",
            folder / "l.json",
            options=FeatureOptions(max_features=N_WANTED),
        )
    with closing(sqlite3.connect(folder / "f.db")) as connection:
        rows = connection.execute(
            "SELECT name, rows, cols, data FROM images JOIN keypoints USING (image_id)"
        ).fetchall()
    return searched, {
        name: np.frombuffer(data, np.float32).reshape(n_rows, n_columns)[:, :2]
        for name, n_rows, n_columns, data in rows
    }


def test_large_photos_are_enlarged_only_where_features_are_few(photos, tmp_path, monkeypatch):
    (tmp_path / "always").mkdir()
    (tmp_path / "never").mkdir()
    _, always = extract(photos, tmp_path / "always", monkeypatch, np.inf)
    searched, found = extract(photos, tmp_path / "never", monkeypatch, 0.0)
    names = [photo.name for photo in photos]
    assert searched == [(0, names), (-1, ["1.png"])]
    # searched again: as if it had been enlarged at once
    np.testing.assert_array_equal(found["1.png"], always["1.png"])
    for name in ("0.png", "2.png", "3.png"):
        assert len(found[name]) > N_WANTED
        assert abs(len(found[name]) - len(always[name])) < 0.1 * len(always[name])
        distance, _ = cKDTree(found[name]).query(always[name])
        assert (distance < 0.5).mean() > 0.85


def test_the_size_that_counts_is_the_one_searched():
    assert megapixels(4000, 3000, 2400) == pytest.approx(4.32)
    assert megapixels(4000, 3000, 0) == pytest.approx(12.0)
    assert megapixels(800, 1200, 2400) == pytest.approx(0.96)


@pytest.mark.parametrize("plain_first_mp", [0.0, np.inf])
def test_pooled_descriptors_are_of_the_same_features(photos, tmp_path, monkeypatch, plain_first_mp):
    extract(photos, tmp_path, monkeypatch, plain_first_mp)
    monkeypatch.setattr(features, "PLAIN_FIRST_MP", plain_first_mp)
    before = contents(tmp_path / "f.db")
    search = Search(photos[0].parent, FeatureOptions(max_features=N_WANTED))
    features.find_features(tmp_path / "f.db", ["0.png", "1.png"], search, pooled=True)
    after = contents(tmp_path / "f.db")
    for name, (keypoints, descriptors) in before.items():
        assert after[name][0] == keypoints
        assert (after[name][1] == descriptors) is (name in ("2.png", "3.png"))


def contents(database):
    """Keypoints and descriptors of each photo, as stored."""
    with closing(sqlite3.connect(database)) as connection:
        rows = connection.execute(
            "SELECT name, keypoints.data, descriptors.data FROM images "
            "JOIN keypoints USING (image_id) JOIN descriptors USING (image_id)"
        ).fetchall()
    return {name: blobs for name, *blobs in rows}


def test_what_a_mask_hides_has_no_feature(photos, tmp_path):
    height, width = cv2.imread(str(photos[0])).shape[:2]
    mask = np.full((height, width), 255, np.uint8)
    mask[:, : width // 2] = 0
    (tmp_path / "masks").mkdir()
    for photo in photos:
        cv2.imwrite(str(tmp_path / "masks" / f"{photo.name}.png"), mask)
    files = tmp_path / "f.db", tmp_path / "l.json"
    extract_features(photos, *files, FeatureOptions(), masks=tmp_path / "masks")
    with closing(sqlite3.connect(files[0])) as connection:
        rows = connection.execute("SELECT rows, cols, data FROM keypoints").fetchall()
    assert len(rows) == len(photos)
    for n_rows, n_columns, data in rows:
        at = np.frombuffer(data, np.float32).reshape(n_rows, n_columns)[:, 0]
        assert n_rows > 0 and at.min() >= width // 2 - 1
