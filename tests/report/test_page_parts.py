"""Parts of the page that need no browser: advice, the file of corrections, cameras, facts."""

import re

import numpy as np
import pytest
import yaml

from cherrypicker.errors import StageError
from cherrypicker.poses import Poses
from cherrypicker.report.branches import branch_facts, branch_table
from cherrypicker.report.cameras import camera_views
from cherrypicker.report.edit_file import edit_file
from cherrypicker.report.text import column_cell, column_head
from cherrypicker.traits.flags import FLAGS, advice_for

LINE = "- delete: {at: [1, 2, 3]}\n"


def test_every_warning_of_the_target_has_its_advice(project):
    text = (project / "scripts/cherrypicker/wood/target.py").read_text(encoding="utf-8")
    warnings = re.findall(r'f?"(target_[a-z]+): ', text)
    assert len(warnings) == 2 and FLAGS.keys() >= set(warnings)
    assert advice_for("unscaled: the scan has no scale") == FLAGS["unscaled"].advice
    assert advice_for("a stage's own words: 3").startswith("Look at the stage")


@pytest.mark.parametrize(
    "text",
    [
        "edits:\n  - cut: {at: [0, 0, 1]}  # by hand\n    note: why\n",
        "edits:\n- cut:\n    at:\n    - 0\n    - 0\n    - 1",
        "edits: [{cut: {at: [0, 0, 1]}}]\n",
        "# nothing yet\nedits: []\n",
        "",
    ],
)
def test_lines_follow_a_file_of_corrections(text):
    about = edit_file("cherry", text)
    before = (yaml.safe_load(text) or {}).get("edits") or []
    after = yaml.safe_load(about["text"] + about["indent"] + LINE)["edits"]
    assert after == [*before, {"delete": {"at": [1, 2, 3]}}]
    assert about["n"] == len(before) and about["name"] == "cherry.yaml"
    if "#" in text and before:
        assert about["text"] == text  # comments stay


def test_a_camera_sees_its_picture_where_the_poses_say():
    r = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks along +y
    K = np.array([[800.0, 0, 500], [0, 800, 300], [0, 0, 1]])
    poses = Poses(
        ["a.jpg", "b.jpg"],
        [np.column_stack([r, -r @ [0, -2.0, 1.0]])] * 2,
        [K] * 2,
        [1000] * 2,
        [600] * 2,
    )

    def read(name, longest_px):
        if name == "b.jpg":
            raise StageError("no image")
        return np.zeros((round(0.6 * longest_px), longest_px, 3), np.uint8)

    first, second = camera_views(poses, read, {"a.jpg": "worst_photo"})
    assert first["photo"].startswith("data:image/jpeg;base64,") and second["photo"] == ""
    assert (first["picture"], second["picture"]) == ("worst_photo", "")
    u, v, w = first["matrix"] @ [0.25, 0.0, 1.0, 1.0]
    assert (u / w, v / w) == pytest.approx((0.42 * 600, 0.42 * 300))
    corner = np.array(first["rays"][0])
    assert corner @ [0.625, -1, -0.375] < 0 < corner[2] and corner[0] < 0


def test_what_is_said_of_a_branch():
    row = {"branch_id": 1, "parent_id": 0, "order": 1, "length_m": 0.5, "tip_diameter_m": 0.01}
    row |= {"base_diameter_m": 0.02, "base_diameter_low_m": 0.019, "base_diameter_high_m": 0.022}
    row |= {"insertion_angle_deg": 40.0, "insertion_angle_low_deg": None, "base_height_m": 0.4}
    row |= {"flags": "low_arc <b>", "base_n_points": 1200, "base_arc_deg": 120.0, "p_exists": 0.97}
    told = dict(branch_facts(row, "arbitrary"))
    assert told["diameter at the base"] == "0.0200 units (0.0190 to 0.0220)"
    assert told["angle"] == "40.0°"
    assert told["there, by the photos"] == "97 %"
    assert told["flags"] == "points on under half of its girth; <b>"
    table = branch_table([row])
    length = table["columns"][3]
    assert column_head(length, "arbitrary") == "length [units]"
    assert column_cell(length, table["rows"][0]) == "0.500"
