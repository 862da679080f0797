"""Readers of tables, configs, edits and records, with valid files to spoil."""

import contextlib

import numpy as np
from finished_tree import small_skeleton, write_finished_tree
from fuzz_bench import Reader
from workspace import PROJECT

from cherrypicker.accuracy.measures import read_measures
from cherrypicker.batch.batch import read_batch
from cherrypicker.batch.benchmarks import read_benchmark
from cherrypicker.batch.config import lookup, read_config_file, resolve_config
from cherrypicker.batch.rows import names_found, scans_of_several
from cherrypicker.batch.summary import summarise
from cherrypicker.batch.trees import Tree, read_trees
from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml, read_json, write_json
from cherrypicker.formats.measured import read_measured_tree
from cherrypicker.markers.references import check_scale
from cherrypicker.markers.scale_scene import scale_scene
from cherrypicker.pointcloud import PointCloud
from cherrypicker.poses import Poses
from cherrypicker.report.edit_file import edit_file
from cherrypicker.series.scan_files import read_scan
from cherrypicker.skeleton.edits import apply_edits, read_edits

SCHEMA = load_yaml(PROJECT / "workflow/schemas/config.schema.yaml")

_TREES = """tree\tphotos\tcloud\tscale\tmarker_dictionary\tmarker_sides_m\tdate\tseries\tcloud_up
# a remark
a\tphotos/a\t\t\tDICT_4X4_50\t7:0.20,8:0.15\t2026-03-01\trow 3\t
b\t\tb.ply\t0.5\t\t\t\t\t-y
"""
_MEASURES = """tree,trait,value,unit,who,height_m,azimuth_deg,x_m,y_m,z_m,order,note
a,trunk_diameter,64,mm,Ann,0.3,,,,,,
a,branch_diameter,20,mm,Ann,1.2,90,,,,1,"a note, quoted"
b,branch_diameter,2.1,cm,Bea,,,0.1,0.2,1.5,,
"""
_EDITS = """# Corrections by hand
edits:
  - cut: {at: [0.2, 0.1, 0.9]}
    note: a string of the trellis
  - {move: {from: [0, 0, 0.5], to: [0.01, 0, 0.5]}, tolerance_m: 0.2}
  - connect: {from: [0.5, 0.1, 0.9], to: [0, 0, 0.6]}
"""
_CONFIG = """sfm:
  max_features: 4096
  skip_unreadable: true
mvs: {max_image_size_px: 1600}
crop:
  target_xy: [0.5, -1.0]
scale:
  references:
    - {kind: distance, markers: [7, 8], length_m: 1.003}
    - {kind: charuco, length_m: 0.04, marker_m: 0.03, squares: [5, 7], dictionary: DICT_5X5_100}
    - {kind: trunk, length_m: 0.064, height_m: 0.3, tolerance_m: 0.002}
    - {kind: cube, length_m: 0.2, cells: 5}
    - kind: gps
"""
_SCALE = {"mode": "marker", "scale": 0.4, "scale_std": 1e-4, "unit": "m"}
_CROP = {"camera_distance": 6.0, "center_xy": [0.0, 0.0], "radius": 3.0, "source": "region"}


def _text(name, content):
    def make(folder):
        (folder / name).write_text(content, encoding="utf-8")
        return [folder / name]

    return make


def _batches(folder):
    """A table, a tree's own config and measures, as Snakemake's own process reads them."""
    rows = "tree\tcloud\tconfig\n" + f"a\ta.ply\t{folder}/a.yaml\nb\tb.ply\t\n"
    (folder / "trees.tsv").write_text(rows)
    (folder / "measures.csv").write_text(_MEASURES)
    (folder / "a.yaml").write_text(_CONFIG)
    return sorted(folder.iterdir())


def _results(folder):
    write_finished_tree(folder / "results/a")
    write_finished_tree(folder / "results/b")
    write_json(folder / "results/a/measures.json", {"pairs": [{"trait": "height_m", "ours": 1.0}]})
    record = {"rule": "crop_roi", "state": "failed", "cause": "no", "time": "2026-03-01T10:00:00+0"}
    write_json(folder / "logs/status/a/crop_roi.json", record)
    (folder / "benchmarks/crop_roi").mkdir(parents=True)
    row = "s\tcpu_time\tmax_rss\n1.5\t1.2\t300.1\n"
    (folder / "benchmarks/crop_roi/a.tsv").write_text(row)
    names = ["traits.json", "measures.json", "crop_roi.json", "a.tsv"]
    found = {path.name: path for path in sorted(folder.rglob("*")) if "b" not in path.parts}
    return [found[name] for name in names]


def _finished(folder):
    write_finished_tree(folder / "a")
    return [folder / "a/skeleton.graphml", folder / "a/branches.csv"]


def _scan(folder):
    return [*_finished(folder), folder / "a/segmented.ply"]


def _records(folder):
    write_json(folder / "scale.json", _SCALE)
    write_json(folder / "crop.json", _CROP)
    return [folder / "scale.json", folder / "crop.json"]


def _found_trees(folder):
    found = folder / "results/row/trees.json"
    found.parent.mkdir(parents=True)
    write_json(found, {"trees": [{"number": 1}, {"number": 2}], "unit": "m"})
    return [found]


def config_of(path):
    """A tree's own config, as it is read at the start, and its references."""
    settings = resolve_config(SCHEMA, read_config_file(path), source=str(path))
    scans_of_several({"a": Tree("a")}, {"a": settings}, "trees.tsv", "config.yaml")
    check_scale("", "marker", "DICT_4X4_50", "7:0.2", lookup(settings, "scale.references"))


def trees_of(path):
    """The table, and the marker columns of its rows as they are judged at the start."""
    for row in read_trees(path):
        try:
            check_scale(row.scale, "marker", row.marker_dictionary, row.marker_sides_m)
        except StageError as error:
            if error.key is None:
                raise


def edits_of(path):
    """A tree's edits, applied as by the stage, and shown on the page where they are sound."""
    edits = read_edits(path)
    edit_file("a", path.read_text(encoding="utf-8"))
    apply_edits(small_skeleton(), edits)


def batch_of(path):
    folder = path.parent
    tables = {"trees": str(folder / "trees.tsv"), "measures": str(folder / "measures.csv")}
    return read_batch(SCHEMA, tables)


def scaled(path):
    n = 3
    pose, K = np.tile(np.eye(3, 4), (n, 1, 1)), np.tile(np.eye(3), (n, 1, 1))
    poses = Poses(np.array(list("abc")), pose, K, np.full(n, 320), np.full(n, 240))
    cloud = PointCloud(np.random.default_rng(0).random((50, 3)) * 3)
    scale_scene(
        cloud, poses, read_json(path.parent / "scale.json"), read_json(path.parent / "crop.json")
    )


def summary_with(path):
    """The batch's page while one tree's own file is spoilt: it must always be written."""
    folder = next(parent for parent in path.parents if (parent / "results").is_dir())
    trees = [{"tree": name, "date": "", "series": ""} for name in "ab"]
    out = folder / "results/traits.csv", folder / "results/summary.html"
    with contextlib.chdir(folder):
        summarise(trees, *out)
    if "\nb," not in out[0].read_text():
        raise AssertionError("the other tree is missing")


def measured_tree(path):
    return read_measured_tree(path.parent)


def scan_of(path):
    return read_scan(path.parent, "a", "2026-03-01")


def trees_found(path):
    with contextlib.chdir(path.parents[2]):
        return names_found(path.parent.name)


READERS = [
    Reader("trees", trees_of, _text("trees.tsv", _TREES)),
    Reader("measures", read_measures, _text("measures.csv", _MEASURES)),
    Reader("edits", edits_of, _text("a.yaml", _EDITS)),
    Reader("config", config_of, _text("a.yaml", _CONFIG)),
    Reader("batch", batch_of, _batches),
    Reader("summary", summary_with, _results),
    Reader("finished_tree", measured_tree, _finished),
    Reader("scan_of_a_series", scan_of, _scan),
    Reader("scale_record", scaled, _records),
    Reader("found_trees", trees_found, _found_trees),
    Reader("benchmark", read_benchmark, _text("a.tsv", "s\tcpu_time\tmax_rss\n1.5\t1.2\t300\n")),
]
