"""What jobs ask for, from the size of a scan."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from workspace import PROJECT, small_tree

from cherrypicker.batch.config import resolve_config
from cherrypicker.batch.resources import (
    ScanSize,
    count_pairs,
    count_points,
    mb_to_ask,
    minutes_to_ask,
    size_of_photos,
    threads_to_ask,
)
from cherrypicker.batch.scans import size_of_scan, sizes_of
from cherrypicker.batch.trees import Tree
from cherrypicker.files import load_yaml
from cherrypicker.pointcloud import write_cloud

SETTINGS = resolve_config(load_yaml(PROJECT / "workflow/schemas/config.schema.yaml"), {})
# Largest resident MB of single stages, by size and number of the photos and by threads
MEASURED_MB = {
    # 23 photos of 1600 x 1200 px, 3.9 million points
    ((1600, 1200), 23, 2): {
        "extract_features": 1241,
        "match_features": 241,
        "reconstruct_sparse": 207,
        "estimate_depth": 726,
        "fuse_depth": 1329,
        "align_cloud": 708,
        "crop_roi": 773,
        "segment_sky": 699,
        "denoise_cloud": 900,
        "scale_cloud": 509,
        "segment_cloud": 1013,
        "contract_cloud": 785,
        "extract_graph": 734,
        "measure_traits": 511,
        "report_tree": 1313,
    },
    # 48 photos of 800 x 1200 px, 2.3 million points
    ((800, 1200), 48, 2): {
        "extract_features": 691,
        "match_features": 486,
        "reconstruct_sparse": 350,
        "estimate_depth": 541,
        "fuse_depth": 875,
        "segment_sky": 610,
        "denoise_cloud": 829,
        "estimate_scale": 404,
        "segment_cloud": 1116,
        "contract_cloud": 480,
        "report_tree": 982,
    },
    # 66 photos of 1200 x 800 px, 6.2 million points, 2.2 of them after the crop
    ((1200, 800), 66, 2): {
        "extract_features": 411,
        "match_features": 317,
        "reconstruct_sparse": 344,
        "segment_sky": 708,
        "estimate_depth": 628,
        "fuse_depth": 1366,
        "align_cloud": 1201,
        "crop_roi": 763,
        "denoise_cloud": 736,
        "estimate_scale": 394,
        "scale_cloud": 391,
        "segment_cloud": 1041,
        "contract_cloud": 533,
        "extract_graph": 559,
        "measure_traits": 650,
        "report_tree": 1440,
    },
    # 250 photos of 4000 x 3000 px
    ((4000, 3000), 250, 2): {
        "extract_features": 887,
        "match_features": 780,
        "segment_sky": 941,
    },
    # 8 photos of 12 megapixels
    ((2828, 4242), 8, 1): {
        "extract_features": 1286,
        "match_features": 192,
        "undistort_photos": 259,
        "segment_sky": 707,
        "estimate_scale": 481,
    },
}


def scan(n_photos=48, size=(800, 1200), **mvs):
    return size_of_photos([size] * n_photos, SETTINGS | {"mvs": SETTINGS["mvs"] | mvs})


PHOTO_STAGES = scan().stages


def test_a_scan_that_needs_it_has_its_photos_prepared(tmp_path):
    plain, tree = tmp_path / "plain", Tree("a", photos=str(tmp_path / "plain"))
    plain.mkdir()
    for i in range(3):
        Image.new("RGB", (400, 300)).save(plain / f"{i}.png")

    def size(row=tree, **photos):
        settings = {**SETTINGS, "photos": {**SETTINGS["photos"], **photos}}
        return size_of_scan(row, settings)

    assert "prepare_photos" not in size().stages
    reduced = size(max_size_px=200)
    assert reduced.stages[0] == "prepare_photos"
    assert reduced.photo_mp == pytest.approx(0.25 * size().photo_mp)
    assert size(replace(tree, masks="own")).is_prepared
    (plain / "walk.mp4").touch()
    assert size().is_prepared and size().photos == 3, "a film that does not open is none"


@pytest.mark.parametrize("key", MEASURED_MB, ids=str)
def test_the_measured_peaks_lie_within_what_is_asked_for(key):
    size, n_photos, threads = key
    for rule, peak_mb in MEASURED_MB[key].items():
        expected = scan(n_photos, size).memory_mb(rule, threads)
        assert peak_mb < mb_to_ask(rule, scan(n_photos, size), threads) - 250, rule
        assert expected < 4 * peak_mb, rule


def test_light_is_paid_for_where_the_config_asks_for_it():
    """371 MB at most on the demo trees, with leaves and a row."""
    lit = size_of_photos([(800, 1200)] * 48, {**SETTINGS, "light": {"enabled": True}})
    assert set(lit.stages) - set(PHOTO_STAGES) == {"measure_light"}
    assert mb_to_ask("measure_light", lit) - 250 > 371


def test_pruning_is_paid_for_where_the_config_names_a_preset():
    """200 MB on a tree of 65 m."""
    pruned = size_of_photos([(800, 1200)] * 48, {**SETTINGS, "pruning": {"preset": "ltr_100"}})
    assert set(pruned.stages) - set(PHOTO_STAGES) == {"propose_pruning"}
    assert mb_to_ask("propose_pruning", pruned) - 250 > 200


def test_photos_are_taken_as_enlarged_where_the_features_are_sought_so():
    large, small = scan(10, (4000, 3000)), scan(10, (800, 1200))
    assert large.sift_mp == pytest.approx(43.2)
    assert small.sift_mp == pytest.approx(4 * 10 * small.largest_feature_mp)


def test_later_stages_keep_less_in_memory_for_what_the_crop_leaves():
    whole = ScanSize(points_m=2.0, most_points_m=4.0, most_cropped_m=4.0)
    cropped = replace(whole, most_cropped_m=2.0)
    assert whole.memory_mb("crop_roi") == cropped.memory_mb("crop_roi")
    assert whole.memory_mb("segment_cloud") - cropped.memory_mb("segment_cloud") == 2 * 215
    assert whole.disk_mb("segment_cloud") == pytest.approx(2 * 34)


def test_more_and_larger_photos_ask_for_more_and_so_does_each_attempt():
    small, many, large = scan(20), scan(250), scan(20, (4000, 3000))
    for rule in ("extract_features", "match_features", "estimate_depth", "report_tree"):
        assert mb_to_ask(rule, many) >= mb_to_ask(rule, small)
        assert minutes_to_ask(rule, many) >= minutes_to_ask(rule, small)
    assert mb_to_ask("extract_features", large) > mb_to_ask("extract_features", small)
    assert minutes_to_ask("estimate_depth", many) > 5 * minutes_to_ask("estimate_depth", small)
    assert threads_to_ask("estimate_depth", many) == 8
    assert threads_to_ask("estimate_depth", scan(3, (320, 240))) == 1
    for rule in PHOTO_STAGES:
        first, second = (mb_to_ask(rule, many, attempt=attempt) for attempt in (1, 2))
        assert 1.7 * first < second <= 2 * first
        assert minutes_to_ask(rule, many, attempt=2) > minutes_to_ask(rule, many)
        assert minutes_to_ask(rule, many, threads=8) <= minutes_to_ask(rule, many)


def test_feature_extraction_pays_memory_for_every_thread():
    one, eight = (mb_to_ask("extract_features", scan(250, (4000, 3000)), n) for n in (1, 8))
    assert eight > 5 * one


def test_a_gpu_takes_the_stereo_off_the_cpu():
    on_cpu, on_gpu = scan(250, backend="cpu"), scan(250, backend="cuda")
    assert on_gpu.cpu_s("estimate_depth") < 0.5 * on_cpu.cpu_s("estimate_depth")
    assert threads_to_ask("estimate_depth", on_gpu) <= 2
    assert on_cpu.cost("fuse_depth") == on_gpu.cost("fuse_depth")


def test_photos_that_are_missing_ask_for_the_least():
    nothing = size_of_photos([], SETTINGS)
    for rule in PHOTO_STAGES:
        assert threads_to_ask(rule, nothing) == 1
        assert 0 < mb_to_ask(rule, nothing) < 2000
        assert 0 < minutes_to_ask(rule, nothing) <= 15


@pytest.mark.parametrize(
    ("n_photos", "config", "n_pairs"),
    [
        (80, {}, 80 * 79 // 2),
        (250, {}, 250 * 38),
        (250, {"exhaustive_max_photos": 250}, 250 * 249 // 2),
        (5, {"exhaustive_max_photos": 2}, 10),
        (0, {}, 0),
    ],
)
def test_pairs_follow_the_way_of_pairing(n_photos, config, n_pairs):
    assert count_pairs(n_photos, SETTINGS["sfm"] | config) == n_pairs


def test_points_of_a_cloud_come_from_its_header(tmp_path):
    write_cloud(tmp_path / "a.ply", small_tree(n_points=3000))
    n_points = len(small_tree(n_points=3000).points)
    assert count_points(tmp_path / "a.ply") == n_points
    ready = size_of_scan(Tree("a", cloud=str(tmp_path / "a.ply")), SETTINGS)
    assert ready.points_m == ready.most_cropped_m == pytest.approx(n_points / 1e6)
    (tmp_path / "broken.ply").write_bytes(b"ply\nno header")
    (tmp_path / "empty.ply").write_bytes(b"")
    for name in ("broken.ply", "empty.ply", "missing.ply", "missing.xyz"):
        assert count_points(tmp_path / name) == 0
    (tmp_path / "a.xyz").write_text("1.000000 2.000000 3.000000 \n" * 1000)
    assert 700 < count_points(tmp_path / "a.xyz") < 1400


def test_points_of_a_laser_scan_come_from_its_header(tmp_path):
    laspy = pytest.importorskip("laspy")
    for version in ("1.2", "1.4"):
        header = laspy.LasHeader(point_format=3 if version == "1.2" else 6, version=version)
        las = laspy.LasData(header)
        las.x = las.y = las.z = np.arange(321.0)
        las.write(tmp_path / "a.las")
        assert count_points(tmp_path / "a.las") == 321
    (tmp_path / "cut.las").write_bytes(b"LASF" + bytes(20))
    assert count_points(tmp_path / "cut.las") == 0
    long = bytearray(b"LASF" + bytes(251))
    long[25] = 4
    struct.pack_into("<Q", long, 247, 5_000_000_000)
    (tmp_path / "long.las").write_bytes(long)
    assert count_points(tmp_path / "long.las") == 5_000_000_000


def test_sizes_come_from_headers_and_what_cannot_be_read_is_left_out(tmp_path):
    for name, size in (("a.png", (30, 20)), ("b.jpg", (64, 48))):
        Image.new("RGB", size).save(tmp_path / name)
    (tmp_path / "c.jpg").write_bytes(b"no photo")
    photos = [tmp_path / name for name in ("a.png", "b.jpg", "c.jpg", "gone.jpg")]
    assert sizes_of(photos) == [(30, 20), (64, 48)]
