"""The report page and its figures, for a ready cloud and for a scan from photos."""

import base64
import gzip
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from cherrypicker.errors import StageError
from cherrypicker.pointcloud import PointCloud, write_cloud
from cherrypicker.poses import Poses, write_poses
from cherrypicker.pruning.table import CUT_COLUMNS
from cherrypicker.report.raster import View, side_views, splat
from cherrypicker.report.stage_figures import (
    coverage_figure,
    example_figure,
    marker_crops,
    marker_figure,
)
from cherrypicker.report.text import with_uncertainty
from cherrypicker.report.tree import ReportOptions, report_tree
from cherrypicker.report.viewer import pick_points, viewer_data
from cherrypicker.skeleton import (
    Skeleton,
    axes,
    write_skeleton_graphml,
)
from cherrypicker.traits.branches import branch_rows, branches_csv, read_branches
from cherrypicker.traits.table import BRANCH_COLUMNS, Trait

READ = {"traits": "traits.json", "branches": "branches.csv", "skeleton": "skeleton.graphml"}
READ |= {"segmented": "segmented.ply", "contracted": "contracted.ply"}
PNGS = ("cloud", "label", "skeleton", "topology", "trunk", "thumbnail")


def y_skeleton(unit="m"):
    stem = [[0, 0, 0.05 * i] for i in range(21)]
    arms = [[s * 0.05 * i, 0, 1 + 0.05 * i] for s in (1, -1) for i in range(1, 9)]
    parent = [-1, *range(20), 20, *range(21, 28), 20, *range(29, 36)]
    return Skeleton(stem + arms, parent, [0.05] * 21 + [0.01] * 16, [1] * 21 + [2] * 16, unit=unit)


def scan(skeleton, unit="m", colors=True):
    rng = np.random.default_rng(0)
    node = rng.integers(0, len(skeleton), 4000)
    wood = skeleton.points[node] + 0.01 * rng.standard_normal((4000, 3))
    ground = np.column_stack([rng.uniform(-1, 1, (2000, 2)), np.zeros(2000)])
    points = np.vstack([wood, ground])
    labels = np.concatenate([skeleton.label[node], np.zeros(2000)]).astype(np.uint8)
    rgb = rng.random((len(points), 3)) if colors else None
    return PointCloud(points, rgb, fields={"label": labels}, unit=unit)


def traits(unit="m"):
    section = {"height_m": 0.3, "diameter_m": 0.1, "center": [0, 0, 0.3], "axis": [0, 0, 1]}
    section |= {"arc_deg": 360.0, "residual_m": 0.002, "n_points": 900, "source": "points"}
    return {
        "unit": unit,
        "height_m": 1.4,
        "height_m_se": 0.004,
        "height_m_ci90": [1.39, 1.41],
        "trunk_diameter_m": 0.1,
        "trunk_height_m": 0.3,
        "tcsa_cm2": 78.54,
        "total_length_m": 2.1,
        "n_tips": 2,
        "n_junctions": 1,
        "length_by_order_m": {"0": 1.0, "1": 1.1},
        "n_branches_by_order": {"0": 1, "1": 2},
        "trunk_diameters": {"0.50": 0.09},
        "trunk_diameters_se": {"0.50": 0.001},
        "trunk_sections": [section],
        "foot": [0.0, 0.0, 0.0],
        "flags": ["strange: <script>alert(1)</script>"],
    }


@pytest.fixture
def build(tmp_path):
    def run(tree="cherry", unit="m", colors=True, photos=(), date="", series="", **files):
        skeleton = y_skeleton(unit)
        cloud = scan(skeleton, unit, colors)
        write_skeleton_graphml(tmp_path / "skeleton.graphml", skeleton)
        write_cloud(tmp_path / "segmented.ply", cloud)
        write_cloud(tmp_path / "contracted.ply", cloud.select(cloud["label"] > 0))
        (tmp_path / "traits.json").write_text(json.dumps(traits(unit)))
        head = "branch_id,parent_id,order,length_m,chord_m,base_diameter_m,tip_diameter_m,"
        head += "insertion_angle_deg,azimuth_deg,base_height_m"
        (tmp_path / "branches.csv").write_text(f"{head}\n0,-1,0,1,1,0.1,0.1,0,0,0\n")
        report_tree(
            {"tree": tree, "date": date, "series": series},
            tmp_path / "report.html",
            {name: tmp_path / file for name, file in READ.items()}
            | {f"{name}_figure": tmp_path / f"figures/{name}.png" for name in PNGS}
            | files,
            ReportOptions(figure_width_px=500, viewer_points=2000),
            photos=photos,
        )
        return (tmp_path / "report.html").read_text(encoding="utf-8")

    run.folder = tmp_path
    return run


class Page(HTMLParser):
    """Addresses that a page loads, and its visible text."""

    def __init__(self, text):
        super().__init__()
        self.sources, self.text, self.hidden = [], [], 0
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.hidden += tag in ("script", "style")
        self.sources += [value for key, value in attrs if key == "src"]
        self.sources += [v for key, v in attrs if key == "href" and tag == "link"]

    def handle_endtag(self, tag):
        self.hidden -= tag in ("script", "style")

    def handle_data(self, data):
        if not self.hidden:
            self.text.append(data)


def test_page_needs_no_network_and_escapes(build):
    text = build(tree='<i>"cherry"')
    page = Page(text)
    assert all(re.match("data:image/(webp|jpeg);base64,", source) for source in page.sources)
    assert "http" not in text.replace("http-equiv", "")
    assert "<script>alert" not in text
    assert "<i>" not in text
    assert text.index("alert(1)") < text.index("Trunk diameter")  # warnings come first
    assert "the stage that says so" in text[text.index("alert(1)") : text.index("Trunk diameter")]
    assert "1.4000 ± 0.0040 m" in text or "1.400 ± 0.004 m" in text
    for name in PNGS:
        with Image.open(build.folder / f"figures/{name}.png") as image:
            assert image.width >= 200


def test_equal_input_gives_equal_bytes(build):
    first = build(), (build.folder / "figures/topology.png").read_bytes()
    assert (build(), (build.folder / "figures/topology.png").read_bytes()) == first


def test_unscaled_page_does_not_say_metres(build):
    page = Page(build(unit="arbitrary", colors=False))
    text = " ".join(page.text)
    assert "arbitrary units" in text
    assert not re.search(r"\d m\b|\[m\]|metre|cm²|m³|m²", text.replace("in metres", "metre"))


def test_light_is_told_where_it_was_measured(build):
    without = build()
    assert not re.search(r"\blight\b|sky_share", " ".join(Page(without).text), re.I)
    assert "light.csv" not in without
    (build.folder / "light.json").write_text('{"star": 0.2, "sky_share": 0.8, "limbs": []}')
    (build.folder / "light.csv").write_text("branch_id,limb_rank,sky_share\n0,,0.75\n")
    files = {"light": build.folder / "light.json", "light_axes": build.folder / "light.csv"}
    text = build(**files)
    assert "<h2>Light</h2>" in text and 'href="light.csv"' in text and "75 % of the sky" in text
    (build.folder / "light.csv").write_text("branch_id,limb_rank,sky_share\n0,,dark\n")
    with pytest.raises(StageError, match="table of light .*'dark'"):
        build(**files)


def test_pruning_is_told_on_a_sheet_where_it_was_asked_for(build):
    assert "Pruning" not in build()
    target = {"name": "height_m", "limit": 1.0, "before": 1.4, "after": 0.99, "after_se": 0.01}
    told = {"preset": "tall_spindle", "source": "a <book>", "notes": ["no width"]}
    told["keep"] = []
    told["targets"] = [target | {"is_reached": True}]
    (build.folder / "pruning.json").write_text(json.dumps(told))
    cells = {"cut": "1", "branch_id": "0", "node": "5", "kind": "heading", "n_tips_after": "2"}
    cells |= {"reasons": "over_height", "n_limbs_after": "3", "ratio_low": "", "ratio_high": ""}
    names = [name for name, column in CUT_COLUMNS.items() if column.kind != "maybe"]
    names += ["ratio_low", "ratio_high"]
    lines = [",".join(names), ",".join(cells.get(name, "0.99") for name in names)]
    (build.folder / "pruning.csv").write_text("\n".join(lines) + "\n")
    files = {"pruning": build.folder / "pruning.json", "cuts": build.folder / "pruning.csv"}
    text = build(**files)
    assert "<h2>Pruning: tall spindle</h2>" in text and 'href="pruning.csv"' in text
    assert (
        "1 (heading: over height)" in text and "0.99 ± 0.01 m" in text and "a &lt;book&gt;" in text
    )
    (build.folder / "pruning.csv").write_text(lines[0] + "\n")
    assert "Nothing to cut" in build(**files)
    for lost in (told, told["targets"][0]):
        key, value = lost.popitem()
        (build.folder / "pruning.json").write_text(json.dumps(told))
        with pytest.raises(StageError, match=f"no '{key}'") as caught:
            build(**files)
        assert str(caught.value.file).endswith("pruning.json")
        lost[key] = value


def test_scan_from_photos_has_its_stages(build):
    folder = build.folder
    photos = folder / "photos"
    sky = folder / "sky"
    photos.mkdir()
    sky.mkdir()
    names = [f"$a_{i}$.jpg" for i in range(4)]
    for name in names:
        Image.new("RGB", (60, 40), (90, 120, 200)).save(photos / name)
        Image.new("L", (60, 40), 255).save(sky / name.replace("jpg", "png"))
    (photos / "broken.jpg").write_bytes(b"no image")
    r = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    matrices = [np.column_stack([r, -r @ [0.3 * i, -2.0, 1.0]]) for i in range(4)]
    K = np.tile(np.eye(3), (4, 1, 1))
    poses = Poses(names, matrices, K, [60] * 4, [40] * 4)
    write_poses(folder / "poses.npz", poses)
    cloud = scan(y_skeleton())
    write_cloud(folder / "aligned.ply", cloud)
    np.savez(folder / "denoise.npz", removed_by=np.arange(len(cloud)) % 10 == 0)
    reports = {
        "sfm": {
            "n_photos": 5,
            "n_registered": 4,
            "photos": {"broken.jpg": {"registered": False, "reason": "blurred <b>"}},
        },
        "align": {"up_to_ground_deg": 0.41, "warnings": ["a <u>hedge</u>"]},
        "crop": {
            "n_points": 10,
            "n_kept": 6,
            "box": {"x": [-1, 1], "y": [-1, 1]},
            "source": "region",
            "center_xy": [0, 0],
            "radius": 1,
            "warnings": ["the cameras look at no common place"],
        },
        "denoise": {"n_input": 6000, "n_removed_statistical": 600, "n_output": 5400},
        "scale": {
            "mode": "marker",
            "unit": "m",
            "scale": 0.5,
            "scale_std": 0.001,
            "markers": [{"id": 7, "side_m": 0.2, "side_lengths": [0.4, 0.4, 0.4, 0.4]}],
            "false_reads": [{"id": 17, "n_images": 4, "photos": []}],
        },
    }
    for name, content in reports.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
    text = build(
        photos=[photos / name for name in [*names, "broken.jpg"]],
        sparse=folder / "sfm.json",
        align_report=folder / "align.json",
        crop_report=folder / "crop.json",
        denoise_report=folder / "denoise.json",
        scale=folder / "scale.json",
        metric_poses=folder / "poses.npz",
        aligned=folder / "aligned.ply",
        aligned_poses=folder / "poses.npz",
        cropped=folder / "aligned.ply",
        denoised_by=folder / "denoise.npz",
        sky_masks=sky,
        depth=folder / "depth",
    )
    assert "4 of 5" in text
    assert "blurred &lt;b&gt;" in text
    assert "a &lt;u&gt;hedge&lt;/u&gt;" in text
    assert "the cameras look at no common place" in text
    assert "600 of 6,000 (10.0 %)" in text
    assert "0.5 ± 0.001 m per unit (0.20 %)" in text
    assert "17 (4 photos)" in text
    for heading in ("sparse model", "Sky and depth", "Alignment", "Denoising", "Scale"):
        assert heading in text


def test_the_choice_of_the_target_is_shown_with_its_runner_up(build):
    def candidate(x, score, is_target):
        return {
            "base": [x, 0.25, 0.1],
            "mass": 9035,
            "height": 2.3,
            "distance": None,
            "score": score,
            "crop_target_xy": [2 * x, 0.5],
            "is_target": is_target,
        }

    candidates = [candidate(0.5, 1.0, True), candidate(-0.75, 0.6, False)]
    choice = {"source": "wood", "unit": "m", "candidates": candidates, "margin": 0.4}
    path = build.folder / "target.json"
    path.write_text(json.dumps(choice | {"runner_up": candidates[1], "warnings": []}))
    text = build(target=path)
    for shown in ("its wood", "x -0.75, y 0.25 m", "40 % of the score", "9,035", "-1.5, 0.5"):
        assert shown in text
    alone = {"runner_up": None, "margin": 1.0, "candidates": candidates[:1], "warnings": []}
    path.write_text(json.dumps(choice | alone))
    assert "of the score" not in build(target=path)


def test_coverage_is_drawn_where_it_lies():
    region = {"center": [0.0, 0.0, 1.0], "radius": 1.0}
    coverage = {"region": region, "camera_distance": 3.0, "n_across": 4, "voxel_size": 0.5}
    coverage |= {"cells": [0, 63], "n_framing": [5, 2], "n_holding": [1, 0]}
    figure = coverage_figure(coverage, {"transform": np.eye(4).tolist()}, 400)
    framing = figure.axes[0].images[0]
    left, right, bottom, top = framing.get_extent()
    assert right - left == top - bottom == pytest.approx(2.0)
    assert framing.get_array().compressed().tolist() == [5, 2]


def test_unreadable_photos_make_no_example(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"no image")
    assert example_figure([tmp_path / "a.jpg"], None, None) is None


def test_marker_crops_show_the_largest_views_first(tmp_path):
    r = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks along +y
    names = ["far.jpg", "near.jpg", "other.jpg"]
    matrices = [np.column_stack([r, -r @ [0.0, y, 0.0]]) for y in (-4.0, -2.0, -2.0)]
    poses = Poses(names, matrices, np.tile(np.eye(3), (3, 1, 1)), [200] * 3, [100] * 3)

    class Lenses:
        def to_photo(self, i, in_camera):
            return 100 * in_camera[:, :2] / in_camera[:, 2:] + [100, 50]

    corners = [[-0.1, 0, 0.1], [0.1, 0, 0.1], [0.1, 0, -0.1], [-0.1, 0, -0.1]]
    scale = {"markers": [{"id": 7, "used": True, "corners": corners, "images": names[:2]}]}
    scale["markers"].append({"id": 8, "used": False})
    (crops,) = marker_crops(scale, poses, Lenses())
    assert [crop[1] for crop in crops] == ["near.jpg", "far.jpg"]
    np.testing.assert_allclose(crops[0][2][0], [95, 45])
    Image.new("RGB", (200, 100)).save(tmp_path / "near.jpg")
    assert marker_figure(scale, poses, Lenses(), [tmp_path / "near.jpg"]) is not None
    assert marker_figure(scale, poses, Lenses(), []) is None


def test_splat_puts_the_nearest_point_on_top():
    view = View("front", np.zeros(2), np.ones(2))
    # seen along +y: the smaller y is nearer
    points = np.array([[0.5, 0.9, 0.5], [0.5, 0.1, 0.5], [0.5, 0.5, 0.5]])
    image = splat(points, np.eye(3), view, 10, size=1)
    assert image[4, 5].tolist() == [0, 1, 0, 1]
    assert image[0, 0, 3] == 0


def test_side_views_hold_every_point():
    points = np.random.default_rng(0).standard_normal((100, 3))
    for view in side_views(points):
        flat = view.flatten(points)
        assert (flat >= view.low).all()
        assert (flat <= view.high).all()


def array(text, kind):
    return np.frombuffer(gzip.decompress(base64.b64decode(text)), kind)


def test_viewer_data_is_what_was_given():
    skeleton = y_skeleton()
    data = viewer_data(skeleton, scan(skeleton), n_points=500)
    assert [item["id"] for item in data["classes"]] == [0, 1, 2]
    shown = data["skeleton"]
    points = array(shown["points"], "<f4").reshape(-1, 3) + data["origin"]
    np.testing.assert_allclose(points, skeleton.points, atol=1e-6)
    assert array(shown["parent"], "<i4").tolist() == skeleton.parent.tolist()
    assert len(array(data["cloud"]["positions"], "u1")) == 6 * 500
    assert [branch["order"] for branch in shown["branches"]] == [0, 1, 1]


def test_the_first_points_are_a_sample_of_all(monkeypatch):
    skeleton, n_first = y_skeleton(), 300
    cloud = scan(skeleton)
    monkeypatch.setattr("cherrypicker.report.viewer._N_FIRST", n_first)
    shown = viewer_data(skeleton, cloud, n_points=len(cloud))["cloud"]
    steps = array(shown["positions"], "u1").reshape(3, 2, -1).astype(int)
    places = (steps[:, 0] + 256 * steps[:, 1]).T / 65535 * shown["span"]
    assert shown["first"] == n_first < len(places) == len(cloud)
    spread = np.ptp(cloud.points, axis=0)
    np.testing.assert_allclose(np.ptp(places[:n_first], axis=0), spread, rtol=0.1)
    for part in (steps[:, 1, :n_first], steps[:, 1, n_first:]):
        assert (np.diff(np.array([1, 256, 65536]) @ part) >= 0).all()  # by cells


def test_a_place_far_from_the_origin_keeps_its_decimals():
    """A cloud in a country's grid: 32 bits would hold it to half a metre."""
    skeleton = y_skeleton()
    skeleton.points += [4_500_000.0, 5_300_000.0, 300.0]
    data = viewer_data(skeleton, scan(skeleton), n_points=100)
    points = array(data["skeleton"]["points"], "<f4").reshape(-1, 3) + data["origin"]
    np.testing.assert_allclose(points, skeleton.points, rtol=0, atol=1e-5)


def test_a_point_belongs_to_the_wood_whose_surface_it_lies_on():
    skeleton = y_skeleton()
    near_stem = skeleton.points[10] + [0.048, 0, -0.01]
    points = np.array([near_stem, [0.29, 0.0, 1.29], [1.0, 1.0, 1.0], [0.0, 0.0, 0.5]])
    cloud = PointCloud(points, fields={"label": np.array([1, 2, 2, 0], np.uint8)})
    nodes = array(viewer_data(skeleton, cloud, n_points=4)["cloud"]["nodes"], "<i4")
    assert sorted(nodes.tolist()) == [-1, -1, 10, 26]  # the upper ends of the edges


def test_wood_is_shown_before_the_rest():
    labels = np.repeat(np.array([0, 2], np.uint8), [10_000, 500])
    picked = pick_points(labels, 1000, np.random.default_rng(0))
    assert len(picked) == 1000
    assert (labels[picked] == 2).sum() == 500


@pytest.mark.parametrize(
    ("value", "error", "name", "unit", "expected"),
    [
        (1.23456, 0.0123, "x_m", "m", "1.235 ± 0.012 m"),
        (1.2, None, "x_m3", "arbitrary", "1.200 units³"),
        (0.5, None, "x_share", "m", "0.500"),
        (None, None, "x_m", "m", "–"),
        (float("nan"), None, "x_m", "m", "–"),
    ],
)
def test_numbers_with_errors(value, error, name, unit, expected):
    assert with_uncertainty(value, error, Trait(name, "X", ""), unit) == expected


def test_branches_as_the_traits_write_them(tmp_path):
    skeleton = y_skeleton("m")
    rows = branch_rows(skeleton, axes(skeleton), 0.0)
    path = tmp_path / "branches.csv"
    path.write_text(branches_csv(rows))
    read = read_branches(path)
    assert [set(row) for row in read] == [set(BRANCH_COLUMNS)] * len(rows)
    assert read[0]["parent_id"] == -1 and isinstance(read[0]["flags"], str)
    assert any(row["lateral_spacing_m"] is None for row in read)  # an axis without laterals
    assert [row["length_m"] for row in read] == pytest.approx(
        [row["length_m"] for row in rows], abs=1e-5
    )


def test_an_axis_without_a_length_is_told(tmp_path):
    path = tmp_path / "branches.csv"
    path.write_text("branch_id,parent_id,order,length_m\n0,-1,0,\n")
    with pytest.raises(StageError, match="table of branches"):
        read_branches(path)
