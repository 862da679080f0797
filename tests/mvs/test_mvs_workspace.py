"""Maps are in COLMAP's layout, and broken ones are found out."""

import numpy as np
import pycolmap
import pytest

from cherrypicker.errors import StageError
from cherrypicker.mvs.workspace import is_whole_map, read_map, write_map


def test_depth_map_is_what_colmap_reads_and_writes(tmp_path):
    depth = np.random.default_rng(0).random((3, 5)).astype(np.float32) + 1.0
    write_map(tmp_path / "ours.bin", depth)
    theirs = pycolmap.DepthMap()
    theirs.read(tmp_path / "ours.bin")
    np.testing.assert_array_equal(theirs.to_array(), depth)
    pycolmap.DepthMap.from_array(depth, 0.5, 3.0).write(tmp_path / "theirs.bin")
    assert (tmp_path / "theirs.bin").read_bytes() == (tmp_path / "ours.bin").read_bytes()
    np.testing.assert_array_equal(read_map(tmp_path / "theirs.bin", (5, 3), 1), depth)


def test_normal_map_holds_one_plane_after_the_other(tmp_path):
    normals = np.random.default_rng(1).normal(size=(3, 5, 3)).astype(np.float32)
    write_map(tmp_path / "ours.bin", normals)
    np.testing.assert_array_equal(read_map(tmp_path / "ours.bin", (5, 3), 3), normals)
    theirs = pycolmap.NormalMap()
    theirs.read(tmp_path / "ours.bin")
    # to_array hands the memory on as if it were interleaved; COLMAP itself, as the fusion in
    # test_mvs_depth shows, indexes it by plane
    planes = theirs.to_array().reshape(3, 3, 5)
    np.testing.assert_array_equal(np.moveaxis(planes, 0, -1), normals)


def test_a_map_cut_short_or_of_another_photo_is_told(tmp_path):
    path = tmp_path / "map.bin"
    write_map(path, np.ones((4, 6), dtype=np.float32))
    assert is_whole_map(path, (6, 4), 1)
    for size, channels in (((4, 6), 1), ((6, 4), 3)):
        assert not is_whole_map(path, size, channels)
        with pytest.raises(StageError, match="its photo's size"):
            read_map(path, size, channels)
    path.write_bytes(path.read_bytes()[:-1])
    assert not is_whole_map(path, (6, 4), 1)
    with pytest.raises(StageError, match="cut short"):
        read_map(path, (6, 4), 1)


@pytest.mark.parametrize("content", [b"", b"no header at all", b"3&x&1&abc", b"3&3&1&"])
def test_no_map_is_told(tmp_path, content):
    path = tmp_path / "map.bin"
    path.write_bytes(content)
    assert not is_whole_map(path, (3, 3), 1)
    with pytest.raises(StageError, match="no COLMAP map"):
        read_map(path, (3, 3), 1)
    with pytest.raises(StageError, match="missing"):
        read_map(tmp_path / "none.bin", (3, 3), 1)
