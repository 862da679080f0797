"""Skeletons read from tables of nodes."""

import numpy as np
import pytest

from cherrypicker.errors import StageError
from cherrypicker.skeleton import read_skeleton_csv

CSV = """id,parent,x,y,z,radius
7,5,0.0,0.0,1000.0,39.0
5,3,0.0,0.0,500.0,{open}
9,5,400.0,0.0,700.0,8.0
3,-1,0.0,0.0,0.0,40.0
"""


@pytest.mark.parametrize("left_open", ["", "nan"])
def test_any_order_and_unit(tmp_path, left_open):
    path = tmp_path / "s.csv"
    path.write_text(CSV.format(open=left_open))
    skeleton = read_skeleton_csv(path, 0.001)
    assert skeleton.parent.tolist()[0] == -1 and (skeleton.parent[1:] < np.arange(1, 4)).all()
    assert skeleton.points[:, 2].max() == pytest.approx(1.0)
    assert skeleton.radius[1] == pytest.approx(0.04)  # the open one takes its parent's
    assert skeleton.label.tolist() == [1] * 4
    assert skeleton.fields["order"].tolist() == [0] * 4


def test_open_radii_up_to_the_root(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text("id,parent,x,y,z,radius\n0,-1,0,0,0,\n1,0,0,0,1,\n2,1,0,0,2,0.5\n")
    assert read_skeleton_csv(path).radius.tolist() == [0.5, 0.5, 0.5]
    path.write_text("id,parent,x,y,z,radius\n0,-1,0,0,0,\n1,0,0,0,1,\n")
    assert read_skeleton_csv(path).radius.tolist() == [0.0, 0.0]


def test_order_and_label(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text("id,parent,x,y,z,radius,order,label\n4,-1,0,0,0,1,0,1\n6,4,0,0,1,1,1,2\n")
    skeleton = read_skeleton_csv(path)
    assert skeleton.fields["order"].tolist() == [0, 1] and skeleton.label.tolist() == [1, 2]


@pytest.mark.parametrize(
    ("rows", "cause"),
    [
        (["0,-1,0,0,0,1", "1,0,0,0,1,1", "2,9,0,0,2,1"], "2 nodes without a parent"),
        (["0,-1,0,0,0,1", "1,2,0,0,1,1", "2,1,0,0,2,1"], "not one tree"),
        (["0,-1,0,0,0,1", "0,0,0,0,1,1"], "twice"),
        (["0,-1,0,0,0,1", "1,0,0,zero,1,1"], "row 3: 'zero' is no number"),
        (["0,-1,0,0,0,1", "1,0,0,inf,1,1"], "row 3: 'inf' is no number"),
        (["0,-1,0,0,0,1", "1,0,0"], "shorter than the header"),
        ([], "no rows"),
    ],
)
def test_what_is_no_tree_names_the_file(tmp_path, rows, cause):
    path = tmp_path / "tree.csv"
    path.write_text("\n".join(["id,parent,x,y,z,radius", *rows]))
    with pytest.raises(StageError, match=cause) as caught:
        read_skeleton_csv(path)
    assert caught.value.file == str(path)


def test_what_is_no_table(tmp_path):
    with pytest.raises(StageError, match="cannot be read"):
        read_skeleton_csv(tmp_path / "absent.csv")
    (tmp_path / "s.csv").write_text("id,parent,x\n0,-1,0\n")
    with pytest.raises(StageError, match="no y, z in the table"):
        read_skeleton_csv(tmp_path / "s.csv")
