"""Weak labels of laser scans: trunk by order 0 of another tool's skeleton."""

import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker.pointcloud import PointCloud, write_cloud
from cherrypicker.skeleton import read_skeleton_csv
from cherrypicker_lab.training.segmentation.weak_labels import Scan, read_scan, wood_by_order

# a stem of 40 mm radius to 1 m, a thin lateral at 0.5 m; children before their parents, one
# radius left open
CSV = """id,parent,x,y,z,radius
7,5,0.0,0.0,1000.0,39.0
5,3,0.0,0.0,500.0,nan
9,5,400.0,0.0,700.0,8.0
3,-1,0.0,0.0,0.0,40.0
"""


def test_points_take_the_order_of_the_nearest_surface(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text(CSV)
    skeleton = read_skeleton_csv(path, 0.001)
    z = np.linspace(0.05, 0.95, 60)
    stem = np.column_stack([np.full(60, -0.04), np.zeros(60), z])
    share = np.linspace(0.25, 1.0, 60)
    lateral = np.column_stack([0.4 * share, np.full(60, 0.008), 0.5 + 0.2 * share])
    labels = wood_by_order(np.vstack([stem, lateral]), skeleton)
    assert (labels[:60] == Label.TRUNK).all() and (labels[60:] == Label.BRANCH).all()


def test_a_scan_comes_in_metres_from_its_own_corner(tmp_path):
    (tmp_path / "s.csv").write_text(CSV)
    points = np.array([[-40.0, 0, 100], [300, 8, 650], [-40, 0, 900]])
    write_cloud(tmp_path / "t.ply", PointCloud(points))
    cloud, labels = read_scan(Scan("t.ply", 0.001, "s.csv"), tmp_path)
    assert np.allclose(cloud.points.min(axis=0), 0)
    assert np.ptp(cloud.points[:, 2]) == pytest.approx(0.8)
    assert labels.tolist() == [Label.TRUNK, Label.BRANCH, Label.TRUNK]
    assert read_scan(Scan("t.ply"), tmp_path)[1] is None
