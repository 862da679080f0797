"""Other stems of the crop against the classes of the points that stand there."""

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.pointcloud import PointCloud
from cherrypicker.traits.other_stems import only_trees

STEM = {"radius": 0.1, "height": 1.0}


def _column(x, label, rng):
    points = rng.uniform([x - 0.05, -0.05, 0.0], [x + 0.05, 0.05, 0.5], (200, 3))
    return points, np.full(200, label, np.uint8)


def test_a_marker_on_a_stake_is_no_second_tree_and_a_stem_is():
    rng = np.random.default_rng(0)
    columns = [_column(2.0, Label.MARKER, rng), _column(4.0, Label.TRUNK, rng)]
    columns.append(_column(4.0, Label.GROUND, rng))
    points, label = (np.concatenate(part) for part in zip(*columns))
    cloud = PointCloud(points, fields={"label": label})
    stems = [{"x": x, "y": 0.0, **STEM} for x in (1.0, 2.0, 3.0)]
    crop = {"other_stems": stems, "box": 1}
    # Twice the unit: they stand at x = 2 (the marker), 4 (the stem) and 6 (nothing left to tell).
    assert only_trees(crop, cloud, 2.0) == {"other_stems": stems[1:], "box": 1}
    assert only_trees({"box": 1}, cloud, None) == {"other_stems": [], "box": 1}
