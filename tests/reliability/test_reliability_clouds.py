"""Clouds and arrays from elsewhere: read right or refused by name, and nothing is executed."""

import io
import pickle
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import torch
from reliability_scene import odd_clouds, table_of, two_trees, write_ply
from workspace import PROJECT, small_tree

from cherrypicker.classes import Label
from cherrypicker.contraction.contract_wood import contract_wood
from cherrypicker.errors import StageError
from cherrypicker.files import read_npz
from cherrypicker.graph.extract import extract_skeleton
from cherrypicker.intake.clouds import import_cloud
from cherrypicker.pointcloud import PointCloud, read_cloud, write_cloud
from cherrypicker.poses import read_poses
from cherrypicker.segmentation.dgcnn import load_weights


class Payload:
    """Creates a file when it is unpickled."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return open, (self.path, "w")


def test_the_payload_of_these_tests_is_live(tmp_path):
    pickle.loads(pickle.dumps(Payload(tmp_path / "executed"))).close()
    assert (tmp_path / "executed").exists()


@pytest.mark.parametrize("kind", ["array", "member", "header"])
def test_pickled_objects_in_an_npz_are_never_unpickled(tmp_path, kind):
    path, executed = tmp_path / "poses.npz", tmp_path / "executed"
    if kind == "array":
        np.savez(path, names=np.array([Payload(executed)], dtype=object))
    else:
        with zipfile.ZipFile(path, "w") as archive:
            content = pickle.dumps(Payload(executed))
            if kind == "header":
                stream = io.BytesIO()
                np.lib.format.write_array_header_1_0(
                    stream, {"descr": "|O", "fortran_order": False, "shape": (1,)}
                )
                content = stream.getvalue() + content
            archive.writestr("names.npy", content)
    for read in (read_npz, read_poses):
        with pytest.raises(StageError, match=r"poses\.npz") as caught:
            read(path)
        assert caught.value.file == str(path)
    assert not executed.exists()


@pytest.mark.parametrize("content", ["torch", "pickle"])
def test_network_weights_with_objects_are_never_unpickled(tmp_path, content):
    path, executed = tmp_path / "weights.pt", tmp_path / "executed"
    if content == "torch":
        torch.save({"state": Payload(executed)}, path)
    else:
        path.write_bytes(pickle.dumps(Payload(executed)))
    with pytest.raises(StageError) as caught:
        load_weights(path)
    assert caught.value.file == str(path)
    assert not executed.exists()


@pytest.mark.parametrize("encoding", ["ascii", "binary_big_endian", "binary_little_endian"])
def test_every_encoding_is_the_same_cloud(tmp_path, encoding):
    cloud = small_tree(0, n_points=400)
    write_ply(tmp_path / "a.ply", table_of(cloud), encoding)
    back = import_cloud(tmp_path / "a.ply")
    np.testing.assert_allclose(back.points, cloud.points, atol=1e-6)
    np.testing.assert_array_equal(back["label"], cloud["label"])
    assert back.colors is None


@pytest.mark.parametrize("name", ["nan", "short", "long", "long_ascii", "points_0", "label_42"])
def test_a_broken_file_is_refused_by_name(tmp_path, name):
    _, reason = odd_clouds(tmp_path)[name]
    with pytest.raises(StageError, match=reason) as caught:
        import_cloud(tmp_path / f"{name}.ply")
    assert str(tmp_path / f"{name}.ply") in str(caught.value)


@pytest.mark.parametrize("promised", [-1, 10**15])
def test_an_absurd_count_is_refused_before_any_memory_is_taken(tmp_path, promised):
    write_ply(tmp_path / "a.ply", {"x": np.zeros(3, np.float32)}, promised=promised)
    with pytest.raises(StageError, match=f"promises {promised:,} vertices"):
        read_cloud(tmp_path / "a.ply")


def test_ascii_labels_that_their_type_cannot_hold_are_refused(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
    header += "property float z\nproperty uchar label\nend_header\n"
    for value in ("257", "-1", "1.5", "nan"):
        (tmp_path / "a.ply").write_text(header + f"0 0 0 {value}\n")
        with pytest.raises(StageError, match="is no uchar"):
            import_cloud(tmp_path / "a.ply")


def test_faces_after_the_vertices_are_no_surplus(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    header += "property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
    (tmp_path / "a.ply").write_text(header + "end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    assert len(read_cloud(tmp_path / "a.ply")) == 3


@pytest.mark.parametrize("n_points", [1, 3, 49])
def test_too_few_wood_points_name_the_key(n_points):
    cloud = small_tree(0, n_points=400).select(np.arange(n_points))
    with pytest.raises(StageError, match=f"{n_points} points") as caught:
        contract_wood(cloud)
    assert "contract.classes" in caught.value.key


@pytest.mark.parametrize("n_copies", [60, 5000])
def test_copies_of_one_point_are_refused(n_copies):
    cloud = PointCloud(
        np.tile([[1.0, 2.0, 3.0]], (n_copies, 1)),
        fields={"label": np.full(n_copies, Label.TRUNK, np.uint8)},
    )
    with pytest.raises(StageError):
        contract_wood(cloud)


def test_copies_of_points_do_not_change_the_tree():
    """A scan that holds each point three times is the scan that holds it once."""
    cloud = small_tree(0)
    tripled = cloud.select(np.repeat(np.arange(len(cloud)), 3))
    lengths = []
    for each in (cloud, tripled):
        contracted, report = contract_wood(each)
        skeleton = extract_skeleton(contracted, each, limbs=report["limbs"])
        lengths.append(skeleton.edge_length.sum())
    assert lengths[1] == pytest.approx(lengths[0], rel=0.02)


def test_of_two_disjoint_trees_one_is_measured_whole():
    cloud = two_trees()
    contracted, report = contract_wood(cloud)
    assert contracted.points[:, 0].max() < 2.0
    alone, _ = contract_wood(small_tree(0))
    assert len(contracted) == pytest.approx(len(alone), rel=0.02)


def test_a_damaged_text_cloud_is_refused(tmp_path):
    for text in ("1 2 3\n4 5\n", "1 2 3\nnan 5 6\n", "", "\n\n", "1 2\n3 4\n"):
        (tmp_path / "a.xyz").write_text(text)
        with pytest.raises(StageError) as caught:
            import_cloud(tmp_path / "a.xyz")
        assert caught.value.file == str(tmp_path / "a.xyz")


def test_a_script_tells_a_broken_cloud_on_one_line_too(tmp_path):
    (tmp_path / "a.ply").write_text("no cloud")
    script = [sys.executable, str(PROJECT / "scripts/import_cloud.py")]
    options = ["--cloud", str(tmp_path / "a.ply"), "--imported", str(tmp_path / "b.ply")]
    done = subprocess.run([*script, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("error: not a PLY file")
    assert len(done.stderr.splitlines()) == 1
    write_cloud(tmp_path / "a.ply", small_tree(0, n_points=400))
    assert subprocess.run([*script, *options], check=False).returncode == 0
