"""The scoreboard of real scans: what was found has a number, what stopped a cause."""

import numpy as np

from cherrypicker.files import write_json, write_text
from cherrypicker_lab.real_photos import markdown, scan_row

DONE = {"failed_stage": "", "cause": "", "flags": "unscaled: no scale; gaps_bridged: two; of 3 cm"}
FAILED = {"failed_stage": "reconstruct_sparse", "cause": "3 of 9 photos", "flags": ""}


def _finished(tmp_path):
    folder = tmp_path / "results/oak"
    write_json(
        folder / "sfm/report.json",
        {"n_registered": 7, "n_photos": 9, "mean_reprojection_error_px": 0.512},
    )
    # of three voxels that the photos call wood, one is held; clear sky speaks against the last
    counts = {"n_framing": [20] * 4, "p_wood": [0.9, 0.8, 0.7, 0.2]}
    write_json(folder / "dense/coverage.json", {**counts, "n_holding": [4, 0, 0, 4]})
    check = {"photo_precision": 0.9, "photo_recall": 0.8, "photo_sky_share": 0.75}
    write_json(folder / "photo_check.json", check)
    for stage, seconds in (("estimate_depth", 90.0), ("fuse_depth", 30.0)):
        write_text(tmp_path / f"benchmarks/{stage}/oak.tsv", f"s\tcpu_time\n1\t{seconds}\n")


def test_a_finished_and_a_failed_scan_have_a_row(tmp_path):
    _finished(tmp_path)
    folders = tmp_path / "results", tmp_path / "benchmarks"
    rows = {"oak": scan_row("oak", *folders, DONE), "elm": scan_row("elm", *folders, FAILED)}
    assert np.isclose(rows["oak"]["held"], 1 / 3) and np.isclose(rows["oak"]["cpu_min"], 2.0)
    assert rows["oak"]["outcome"] == "unscaled, gaps_bridged"
    assert rows["elm"]["outcome"] == "reconstruct_sparse: 3 of 9 photos"
    table = markdown(rows)
    assert "| oak | 7 of 9 | 0.51 | 33% | 0.900 | 0.800 | 75% | 2 |" in table
    assert "| elm | - | - | - | - | - | - | 0 | reconstruct_sparse" in table
