import subprocess
import sys

import pytest

from cherrypicker.errors import StageError
from cherrypicker_lab.outputs import compare_folders


@pytest.fixture
def folders(tmp_path):
    before, after = tmp_path / "before", tmp_path / "after"
    for folder in (before, after):
        (folder / "tree/sky").mkdir(parents=True)
        (folder / "tree/metric.ply").write_bytes(b"\x00points")
        (folder / "tree/sky/a.png").write_bytes(b"mask")
    return before, after


def compare(project, *arguments):
    command = [sys.executable, project / "scripts/lab/compare_outputs.py", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_equal_folders(project, folders):
    done = compare(project, *folders)
    assert (done.returncode, done.stdout) == (0, "2 of 2 files equal byte for byte\n")


def test_one_byte_one_missing_and_one_new_file_are_named(project, folders):
    before, after = folders
    (after / "tree/metric.ply").write_bytes(b"\x01points")
    (after / "tree/sky/a.png").rename(after / "tree/sky/b.png")
    done = compare(project, *folders)
    assert done.returncode == 1
    assert done.stdout.splitlines() == [
        "differs: tree/metric.ply",
        "only before: tree/sky/a.png",
        "only after: tree/sky/b.png",
        "0 of 3 files equal byte for byte",
    ]


def test_equal_size_and_time_do_not_hide_a_difference(folders):
    before, after = folders
    (after / "tree/metric.ply").write_bytes(b"\x00pointz")
    assert compare_folders(before, after).different == ["tree/metric.ply"]
    assert compare_folders(before, after, ["*.ply"]).is_equal


def test_nothing_is_not_equal(tmp_path):
    assert not compare_folders(tmp_path, tmp_path).is_equal
    with pytest.raises(StageError, match="no such folder"):
        compare_folders(tmp_path, tmp_path / "x")
