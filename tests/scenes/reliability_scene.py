"""Damaged and odd input for the tests of the reliability table."""

import subprocess
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from workspace import small_tree

from cherrypicker.pointcloud import PointCloud, write_cloud

MARKUP = '<img src=x onerror="alert(1)"><script>alert(1)</script>'


def write_ply(path, table, encoding="binary_little_endian", promised=None):
    """Write columns (name to array) as a PLY of any encoding, with any count in its header."""
    kinds = {"f4": "float", "f8": "double", "u1": "uchar", "i1": "char", "i4": "int"}
    n = len(next(iter(table.values()))) if promised is None else promised
    lines = ["ply", f"format {encoding} 1.0", f"element vertex {n}"]
    lines += [f"property {kinds[values.dtype.str[1:]]} {name}" for name, values in table.items()]
    header = "\n".join([*lines, "end_header\n"]).encode()
    if encoding == "ascii":
        rows = np.column_stack([values.astype(float) for values in table.values()])
        body = "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in rows).encode()
    else:
        order = ">" if encoding == "binary_big_endian" else "<"
        dtype = [(name, order + values.dtype.str[1:]) for name, values in table.items()]
        body = np.rec.fromarrays(list(table.values()), dtype=dtype).tobytes()
    Path(path).write_bytes(header + body)


def table_of(cloud):
    """Return the columns of a labelled cloud for :func:`write_ply`."""
    columns = dict(zip("xyz", cloud.points.astype(np.float32).T))
    return {**columns, "label": cloud["label"]}


def two_trees(apart_m=4.0):
    """Return a labelled cloud of two trees that do not touch; the first is the larger."""
    first, second = small_tree(0), small_tree(1)
    points = np.concatenate([first.points, 0.7 * second.points + [apart_m, 0, 0]])
    return PointCloud(points, fields={"label": np.concatenate([first["label"], second["label"]])})


def odd_clouds(folder):
    """Write one file of each kind of damage; return what a user is told about each.

    Returns
    -------
    dict of str to (str, str)
        By file stem: the stage that refuses the cloud, and a part of the reason.
    """
    folder = Path(folder)
    good = table_of(small_tree(0, n_points=600))
    n = len(good["x"])
    broken = {name: values.copy() for name, values in good.items()}
    broken["y"][[3, 8]] = np.nan, np.inf
    write_ply(folder / "nan.ply", broken)
    write_ply(folder / "short.ply", good, promised=n + 7)
    write_ply(folder / "long.ply", good, promised=n - 7)
    write_ply(folder / "long_ascii.ply", good, "ascii", promised=n - 7)
    for count in (0, 1, 3):
        few = {name: values[:count] for name, values in good.items()}
        write_ply(folder / f"points_{count}.ply", few)
    bare = {name: good[name][:3] for name in "xyz"}
    write_ply(folder / "bare_3.ply", bare)
    labels = {**good, "label": np.full(n, 42, np.uint8)}
    write_ply(folder / "label_42.ply", labels)
    same = {name: np.repeat(values[:1], 500) for name, values in good.items()}
    write_ply(folder / "same.ply", same)
    imported = "import_segmented_cloud"
    return {
        "nan": (imported, f"2 of {n:,} points are not finite"),
        "short": (imported, f"promises {n + 7:,} vertices, the file holds {n:,}"),
        "long": (imported, f"promises {n - 7:,} vertices, the file holds {n:,}"),
        "long_ascii": (imported, "the file holds more"),
        "points_0": (imported, "empty"),
        "points_1": ("grow_limbs", "1 points"),
        "points_3": ("grow_limbs", "3 points"),
        "bare_3": ("segment_cloud", "3 points, too few"),
        "label_42": (imported, "the first is 42"),
        "same": ("contract_cloud", ""),
    }


def write_small_cloud(path, seed=0):
    """Write the small labelled tree under any path."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_cloud(path, small_tree(seed))


@contextmanager
def small_disk(folder, size="64k", *, read_only=False):
    """Mount a tiny file system on a folder; skips, and says so, where that is not allowed.

    Root may write anywhere whatever the permissions say, so only a mount shows what a full or a
    read-only disk does.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    options = f"size={size}" + (",ro" if read_only else "")
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        pytest.skip("DISK NOT TESTED: there is no `mount` here")
    if done.returncode != 0:
        pytest.skip(f"DISK NOT TESTED: mounting needs root ({done.stderr.strip()})")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def same_files(first, second, *, ignore=()):
    """Assert that two folders hold the same files with the same bytes."""
    listed = [
        {
            path.relative_to(folder).as_posix()
            for path in Path(folder).rglob("*")
            if path.is_file() and path.name not in ignore
        }
        for folder in (first, second)
    ]
    assert listed[0] == listed[1]
    for name in sorted(listed[0]):
        assert (Path(first) / name).read_bytes() == (Path(second) / name).read_bytes(), name
