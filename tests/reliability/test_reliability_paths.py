"""Odd, read-only and full places; names beyond ASCII are in ``test_reliability_batch``."""

import errno
import os
import shutil

import numpy as np
import pytest
from reliability_scene import same_files, small_disk
from sfm_scene import write_orbit
from workspace import Workspace, small_tree

from cherrypicker.command.work_folder import check_writable
from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path, read_json, write_npz
from cherrypicker.pointcloud import write_cloud
from cherrypicker.sfm.features import FeatureOptions, extract_features


def test_a_full_disk_stops_its_tree_and_nothing_else(tmp_path):
    """One tree's results lie on a tiny disk; with room again, it is finished as the other was."""
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("a")
    shutil.copy(workspace.folder / "a.ply", workspace.folder / "b.ply")
    workspace.table("tree | cloud", "a | a.ply", "b | b.ply")
    results, targets = workspace.folder / "results", ("--until", "contract_cloud")
    with small_disk(results / "a", "60k") as disk:
        (disk / "keep").touch()  # or Snakemake would want to remove the empty mount
        printed = workspace.run(*targets, fails=True)
        assert sorted(path.name for path in disk.iterdir()) == ["keep"]
    (line,) = [line for line in printed.splitlines() if line.startswith("ERROR tree=a ")]
    assert "the disk is full" in line
    assert "results/a/segmented.ply" in line
    table = (results / "traits.csv").read_text().splitlines()
    assert table[1].startswith("a,failed,import_segmented_cloud,the disk is full")
    assert table[2].startswith("b,not run") and (results / "b/contracted.ply").exists()
    workspace.run(*targets)
    same_files(results / "a", results / "b", ignore=("keep",))


def test_a_full_disk_below_everything_still_tells_the_reason(tmp_path):
    """Logs, notes and results share the disk; nothing half-made is left under a final name."""
    with small_disk(tmp_path / "disk", "300k") as disk:
        workspace = Workspace(disk / "work")
        workspace.add_cloud("a")
        workspace.table("tree | cloud", "a | a.ply")
        # What Snakemake itself keeps holds the clone's path many times over; it has room.
        (tmp_path / "snakemake").mkdir()
        (workspace.folder / ".snakemake").symlink_to(tmp_path / "snakemake")
        room = os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize
        (disk / "ballast").write_bytes(b"0" * (room - 60_000))
        printed = workspace.run(fails=True)
        (line,) = [line for line in printed.splitlines() if line.startswith("ERROR tree=a ")]
        assert "No space left on device" in line
        assert not (workspace.folder / "results/a/segmented.ply").exists()
        (disk / "ballast").unlink()
        (workspace.folder / "a.ply").touch()
        assert "would run" not in workspace.run("--until", "import_segmented_cloud")
        assert (workspace.folder / "results/a/segmented.ply").exists()


def test_colmaps_database_on_a_full_disk(tmp_path):
    """SQLite and COLMAP write by themselves; they too leave nothing under the final names."""
    workspace = Workspace(tmp_path / "work")
    write_orbit(workspace.folder / "photos", 3)
    workspace.table("tree | photos | scale", "p | photos | none")
    with small_disk(workspace.folder / "results/p", "120k") as disk:
        (disk / "keep").touch()
        printed = workspace.run("--until", "extract_features", fails=True)
        assert [path.name for path in disk.rglob("*") if path.is_file()] == ["keep"]
    (line,) = [line for line in printed.splitlines() if line.startswith("ERROR tree=p ")]
    assert "MB are left on the disk of results/p/sfm" in line or "disk is full" in line


@pytest.mark.parametrize("kind", ["cloud", "arrays"])
def test_no_half_file_on_a_full_disk(tmp_path, kind):
    with small_disk(tmp_path / "disk", "16k") as disk:
        path = disk / "out.ply"
        with pytest.raises(OSError, match="No space left") as caught:
            if kind == "cloud":
                write_cloud(path, small_tree())
            else:
                write_npz(path, points=np.zeros((9000, 3)))
        assert caught.value.errno == errno.ENOSPC
        assert caught.value.filename == str(path)
        assert list(disk.iterdir()) == []


def test_a_full_disk_keeps_the_old_file(tmp_path):
    with small_disk(tmp_path / "disk", "16k") as disk:
        (disk / "out.bin").write_bytes(b"old")
        with pytest.raises(OSError, match="No space"), atomic_path(disk / "out.bin") as temporary:
            temporary.write_bytes(b"0" * 30_000)
        assert (disk / "out.bin").read_bytes() == b"old"


def test_a_read_only_results_folder_is_named_before_anything_runs(tmp_path):
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("a")
    workspace.table("tree | cloud", "a | a.ply")
    with small_disk(workspace.folder / "results", read_only=True):
        printed = workspace.run(fails=True)
        assert "cannot be written" in printed
        assert "file: results" in printed
        assert "Traceback" not in printed
    assert not (workspace.folder / "benchmarks").exists()
    assert "import_segmented_cloud" in workspace.run("--dry-run")


def test_read_only_folders_are_found_wherever_they_are(tmp_path):
    with small_disk(tmp_path / "results/a", read_only=True) as disk:
        check_writable([tmp_path / "logs", tmp_path / "results", tmp_path / "results/b"])
        for folder in (disk, disk / "not there yet"):
            with pytest.raises(StageError, match="cannot be written") as caught:
                check_writable([tmp_path, folder])
            assert caught.value.file == str(disk)
    (tmp_path / "file").touch()
    with pytest.raises(StageError, match="a folder is needed"):
        check_writable([tmp_path / "file"])


def test_photos_under_a_path_beyond_ascii_with_blanks(tmp_path):
    """COLMAP, SQLite and OpenCV open files by themselves, each in its own way."""
    folder = tmp_path / "Obstgärten 果樹/Reihe 7 & 8"
    photos, _ = write_orbit(folder / "Fotos", 3)
    for i, path in enumerate(photos):
        path.rename(path.with_name(f"Kirschbäume №{i} 'vorn'.JPG"))
    photos = sorted((folder / "Fotos").iterdir())
    database, listing = folder / "Ausgabe é/merkmale.db", folder / "Ausgabe é/fotos.json"
    extract_features(photos, database, listing, options=FeatureOptions(max_features=300))
    content = read_json(listing)
    assert all(photo["n_features"] > 50 for photo in content["photos"].values())
    assert set(content["photos"]) == {path.name for path in photos}


def test_a_photo_name_that_snakemake_would_fill_in_stops_its_own_tree(tmp_path):
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("a")
    for tree, name in (("p", "IMG<b>.jpg"), ("q", "{tree}.jpg")):
        (workspace.folder / tree).mkdir()
        (workspace.folder / tree / name).touch()
    workspace.table(
        "tree | cloud | photos | scale", "a | a.ply |  | ", "p |  | p | none", "q |  | q | none"
    )
    printed = workspace.run("--until", "extract_features", "import_segmented_cloud", fails=True)
    for tree, name in (("p", "IMG<b>.jpg"), ("q", "{tree}.jpg")):
        (line,) = [line for line in printed.splitlines() if f"ERROR tree={tree} " in line]
        assert name in line
        assert "rename the photo" in line
    assert (workspace.folder / "results/a/segmented.ply").exists()
