"""The three steps on rendered photos whose cameras are known."""

import json
import shutil

import cv2
import numpy as np
import pycolmap
import pytest
from sfm_scene import FOCAL, centers_of, similarity_errors, texture, write_orbit

from cherrypicker.errors import StageError
from cherrypicker.poses import read_poses
from cherrypicker.sfm import mapping
from cherrypicker.sfm import pairs as paired
from cherrypicker.sfm.database import copy_database, image_ids
from cherrypicker.sfm.export import MODEL_FILES
from cherrypicker.sfm.features import FeatureOptions, Search, extract_features
from cherrypicker.sfm.mapping import Mapper, MappingOptions
from cherrypicker.sfm.matching import (
    MatchingOptions,
    likely_partners,
    match_features,
    match_pooled,
)
from cherrypicker.sfm.sparse import reconstruct_sparse
from cherrypicker.sfm.uncertainty import tree_errors

N_GOOD = 9


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    """An orbit, a blank photo and one of something else, with features and matches."""
    folder = tmp_path_factory.mktemp("scan with blanks")
    photos, poses = write_orbit(folder / "photos", N_GOOD, span_deg=130.0)
    blank = folder / "photos" / "x_blank.jpg"
    cv2.imwrite(str(blank), np.full((240, 320, 3), 128, np.uint8))
    stranger = folder / "photos" / "y_stranger.jpg"
    cv2.imwrite(str(stranger), texture(np.random.default_rng(99), 320)[:240])
    photos += [blank, stranger]
    extract_features(
        photos,
        folder / "features.db",
        folder / "photos.json",
        options=FeatureOptions(max_features=800),
    )
    match_features(folder / "features.db", folder / "database.db", MatchingOptions())
    return {"folder": folder, "photos": photos, "poses": poses}


@pytest.fixture(scope="module")
def model(scan):
    folder = scan["folder"]
    reconstruct_sparse(
        folder / "database.db",
        scan["photos"],
        folder / "photos.json",
        folder / "model",
        folder / "report.json",
        folder / "poses.npz",
        MappingOptions(),
    )
    return scan


def test_good_photos_register_where_they_were(model):
    poses = read_poses(model["folder"] / "poses.npz")
    assert list(poses.names) == sorted(poses.names)
    assert list(poses.names) == [path.name for path in model["photos"][:N_GOOD]]
    errors = similarity_errors(poses.centers, centers_of(model["poses"]))
    assert errors.max() < 0.03 * 3.5
    np.testing.assert_allclose(poses.K[:, 0, 0], FOCAL, rtol=0.05)


def test_poses_are_those_of_colmaps_undistortion(model, tmp_path):
    pycolmap.undistort_images(
        tmp_path, model["folder"] / "model", model["folder"] / "photos", output_type="COLMAP"
    )
    undistorted = pycolmap.Reconstruction(tmp_path / "sparse")
    poses = read_poses(model["folder"] / "poses.npz")
    for image in undistorted.images.values():
        camera = undistorted.cameras[image.camera_id]
        i = list(poses.names).index(image.name)
        assert (poses.width[i], poses.height[i]) == (camera.width, camera.height)
        np.testing.assert_allclose(poses.K[i], camera.calibration_matrix())
        np.testing.assert_allclose(poses.cam_from_world[i], image.cam_from_world().matrix())


def test_model_has_the_five_files(model):
    found = {path.name for path in (model["folder"] / "model").iterdir()}
    assert found == set(MODEL_FILES)


def test_report_tells_why_photos_are_missing(model):
    report = json.loads((model["folder"] / "report.json").read_text())
    assert report["n_photos"] == N_GOOD + 2
    assert report["n_registered"] == N_GOOD
    assert report["photos"]["x_blank.jpg"]["reason"].startswith("too few features")
    assert report["photos"]["y_stranger.jpg"]["reason"].startswith("no match")
    good = report["photos"][model["photos"][0].name]
    assert good["registered"] and good["reason"] == "" and good["n_points"] > 50
    assert 0 < report["mean_reprojection_error_px"] < 1
    assert report["pair_agreement"] > 0.9


def _map_again(model, folder, options):
    """Report of the matched scan mapped with other options, into a folder."""
    reconstruct_sparse(
        model["folder"] / "database.db",
        model["photos"],
        model["folder"] / "photos.json",
        folder / "model",
        folder / "report.json",
        folder / "poses.npz",
        options,
    )
    return json.loads((folder / "report.json").read_text())


def test_too_few_registered_is_an_error_with_the_key(model, tmp_path):
    options = MappingOptions(min_registered_fraction=0.9)
    with pytest.raises(StageError, match="9 of 11") as caught:
        _map_again(model, tmp_path, options)
    assert "sfm.min_registered_fraction" in caught.value.key
    assert (tmp_path / "report.json").is_file(), "the report explains the failure"
    assert not (tmp_path / "poses.npz").exists()


def test_equal_input_gives_equal_databases(scan, tmp_path):
    folder = scan["folder"]
    extract_features(
        scan["photos"],
        tmp_path / "features.db",
        tmp_path / "photos.json",
        options=FeatureOptions(max_features=800),
        threads=2,
    )
    assert (tmp_path / "features.db").read_bytes() == (folder / "features.db").read_bytes()
    options = MatchingOptions()
    match_features(folder / "features.db", tmp_path / "database.db", options, threads=2)
    assert (tmp_path / "database.db").read_bytes() == (folder / "database.db").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "database.db",
        "features.db",
        "photos.json",
    ]


def test_pooled_descriptors_bring_back_the_matches_of_a_photo(scan, tmp_path, monkeypatch):
    """Its matches are gone; those of others, and its features, stay as they are."""
    database = copy_database(scan["folder"] / "database.db", tmp_path / "database.db")
    name = scan["photos"][3].name
    with pycolmap.Database.open(database) as opened:
        own = image_ids(database)[name]
        before = np.array(opened.read_keypoints(own))
        for other in image_ids(database).values():
            if other != own and opened.exists_two_view_geometry(own, other):
                opened.delete_two_view_geometry(own, other)
        others = opened.num_inlier_matches()
    assert name not in {each for pair in kept_pairs(database) for each in pair}
    search = Search(scan["folder"] / "photos", FeatureOptions(max_features=800))
    unguided = copy_database(database, tmp_path / "unguided.db")
    match_pooled(database, [name], search)
    none = np.empty((0, 2), np.uint32)
    monkeypatch.setattr("cherrypicker.sfm.matching.guided_matches", lambda *given: none)
    match_pooled(unguided, [name], search)
    partners = {each for pair in kept_pairs(database) if name in pair for each in pair} - {name}
    assert {scan["photos"][2].name, scan["photos"][4].name} <= partners
    with pycolmap.Database.open(database) as opened:
        np.testing.assert_array_equal(np.array(opened.read_keypoints(own)), before)
        guided = opened.num_inlier_matches()
    with pycolmap.Database.open(unguided) as opened:
        assert guided - others > 1.1 * (opened.num_inlier_matches() - others) > 0


def kept_pairs(database):
    names = {image_id: name for name, image_id in image_ids(database).items()}
    with pycolmap.Database.open(database) as opened:
        pair_ids, counts = opened.read_two_view_geometry_num_inliers()
    pairs = [pycolmap.pair_id_to_image_pair(i) for i, n in zip(pair_ids, counts) if n]
    return [(names[a], names[b]) for a, b in pairs]


def test_likely_partners_match_most_or_stand_next(scan):
    names = [path.name for path in scan["photos"]]
    partners = likely_partners(scan["folder"] / "database.db", [names[0], "x_blank.jpg"])
    assert (names[0], names[1]) in partners
    assert ("x_blank.jpg", "y_stranger.jpg") in partners
    assert all(names[0] in pair or "x_blank.jpg" in pair for pair in partners)


@pytest.mark.parametrize(("times", "why"), [(20.0, "known within"), (np.inf, "held by nothing")])
def test_a_camera_that_is_not_known_is_in_no_later_file(model, tmp_path, monkeypatch, times, why):
    """It leaves model and poses, and the report says so; so does one that no point holds."""
    worst = model["photos"][4].name

    def told(*args, **kwargs):
        errors = tree_errors(*args, **kwargs)
        return {name: error * (times if name == worst else 1) for name, error in errors.items()}

    monkeypatch.setattr(mapping, "tree_errors", told)
    options = MappingOptions()
    report = _map_again(model, tmp_path, options)
    assert report["n_left_out"] == 1
    assert report["photos"][worst]["reason"].startswith(f"left out: its camera is {why}")
    poses = read_poses(tmp_path / "poses.npz")
    used = {image.name for image in pycolmap.Reconstruction(tmp_path / "model").images.values()}
    assert used == set(poses.names) == {n for n, f in report["photos"].items() if f["registered"]}
    assert worst not in used
    assert (poses.error_px > 0).all() and poses.error_px.max() < options.max_camera_error_px


def test_the_error_allowed_grows_with_photos_larger_than_searched(scan, tmp_path):
    photos, database = scan["folder"] / "photos", scan["folder"] / "database.db"  # of 320 px
    for size, limit in ((320, 2.0), (640, 2.0), (160, 4.0), (0, 2.0)):
        options = MappingOptions(max_camera_error_px=2.0, max_image_size_px=size)
        assert Mapper(database, photos, tmp_path, options).limit_px == pytest.approx(limit)


def test_nothing_matches(tmp_path):
    rng = np.random.default_rng(5)
    photos = []
    for i in range(3):
        photos.append(tmp_path / f"{i}.png")
        cv2.imwrite(str(photos[-1]), texture(rng, 200))
    extract_features(
        photos, tmp_path / "f.db", tmp_path / "l.json", options=FeatureOptions(max_features=300)
    )
    with pytest.raises(StageError, match="no two of 3 photos match"):
        match_features(tmp_path / "f.db", tmp_path / "m.db", MatchingOptions())
    assert not (tmp_path / "m.db").exists()


def test_featureless_photos(tmp_path):
    photos = []
    for i in range(3):
        photos.append(tmp_path / f"{i}.png")
        cv2.imwrite(str(photos[-1]), np.full((60, 80, 3), 40 + i, np.uint8))
    with pytest.raises(StageError, match="no photo shows any feature"):
        extract_features(photos, tmp_path / "f.db", tmp_path / "l.json", FeatureOptions())


def test_broken_inputs_are_named(tmp_path):
    with pytest.raises(StageError, match="missing") as caught:
        match_features(tmp_path / "none.db", tmp_path / "m.db", MatchingOptions())
    assert caught.value.file.endswith("none.db")
    (tmp_path / "text.db").write_text("no database" * 100)
    with pytest.raises(StageError, match="not a COLMAP database"):
        match_features(tmp_path / "text.db", tmp_path / "m.db", MatchingOptions())
    assert [path.name for path in tmp_path.iterdir()] == ["text.db"]


def test_retrieval_pairing_beyond_the_limit(scan, tmp_path, caplog, monkeypatch):
    caplog.set_level("INFO")
    monkeypatch.setattr(paired, "N_ALIKE", 3)
    monkeypatch.setattr(paired, "N_PARTNERS", 1)
    options = MatchingOptions(exhaustive_max_photos=5)
    match_features(scan["folder"] / "features.db", tmp_path / "m.db", options)
    assert "retrieval pairing" in caplog.text
    of_all = kept_pairs(scan["folder"] / "database.db")
    assert N_GOOD - 1 <= len(kept_pairs(tmp_path / "m.db")) <= len(of_all)


def test_relative_paths(scan, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scan["folder"] / "photos", "my photos")
    photos = sorted(tmp_path.glob("my photos/photo*"))[:3]
    photos = [path.relative_to(tmp_path) for path in photos]
    extract_features(photos, "a/f.db", "a/l.json", options=FeatureOptions(max_features=300))
    match_features("a/f.db", "b/m.db", MatchingOptions())
    assert (tmp_path / "b" / "m.db").is_file()
