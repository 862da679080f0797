"""S-LBC over LBC against the trunk's radius: what is measured, gathered and drawn."""

import json

import numpy as np
import pytest
from PIL import Image
from skeleton_shapes import labelled_cloud, tube

from cherrypicker.errors import StageError
from cherrypicker.skeleton.model import Skeleton
from cherrypicker_lab.orchard.skeleton_set import make_set_tree
from cherrypicker_lab.skeletons.trunk_ratio import (
    draw_ratio,
    gather_trunks,
    measure_trunk,
    write_ratio_table,
)


def test_a_trunk_of_three_centimetres_starts_nine_square_centimetres_away():
    height = np.arange(0, 0.41, 0.05)
    axis = np.column_stack([np.zeros((len(height), 2)), height])
    order = np.zeros(len(height), int)
    truth = Skeleton(axis, np.arange(-1, len(axis) - 1), 0.03 + 0 * height, order + 1)
    points = tube((0, 0, 0), (0, 0, 0.4), 0.03, 20_000, rng=np.random.default_rng(3))
    cloud = labelled_cloud(points, np.ones(len(points)))
    found = measure_trunk(cloud, truth, ["compound", "cao"], max_iterations=1)
    assert found["n_points"] == len(points)
    assert found["uncontracted"] == pytest.approx(18, abs=0.5)  # both ways
    for rule in ("compound", "cao"):
        assert found[rule]["slbc"] < found[rule]["lbc"] < 18


def test_tables_hold_means_of_trees(tmp_path):
    runs = {
        "a": {"uncontracted": 5.0, "compound": {"lbc": 4.0, "slbc": 1.0}},
        "b": {"uncontracted": 7.0, "compound": {"lbc": 8.0, "slbc": 2.0}},
        "a_cao": {"uncontracted": 5.0, "cao": {"lbc": 10.0, "slbc": 9.0}},
    }
    for name, values in runs.items():
        report = {"tree": name[0], "trunk_radius": 0.12, "settings": {"noise": values}}
        (tmp_path / f"{name}.json").write_text(json.dumps(report))
    found = gather_trunks(sorted(tmp_path.glob("*.json")))
    text = write_ratio_table(found)
    assert "| compound | noise | 12 | 2 | 6.00 | 6.00 | 1.50 | 0.25 |" in text
    assert "| cao | noise | 12 | 1 | 5.00 | 10.00 | 9.00 | 0.90 |" in text
    draw_ratio(found, tmp_path / "ratio.png")
    assert Image.open(tmp_path / "ratio.png").width > Image.open(tmp_path / "ratio.png").height
    with pytest.raises(StageError, match="nothing was measured"):
        gather_trunks([])


def test_the_set_grows_trunks_of_the_radius_asked_for():
    thin, thick = (make_set_tree(0, 1, trunk_radius=radius) for radius in (0.05, 0.12))
    assert len(thick.noise) > len(thin.noise)
    widths = [
        np.median(t.skeleton.radius[np.asarray(t.skeleton.label) == 1]) for t in (thin, thick)
    ]
    assert widths[1] / widths[0] == pytest.approx(2.4, rel=0.1)
