"""Two dates of one tree: its frame, its branches' ids, what was cut and what grew."""

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import compare_series as stage
from cherrypicker.batch.finished import is_finished
from cherrypicker.batch.trees import Tree, series_of
from cherrypicker.bearing.measure import measure_bearing
from cherrypicker.bearing.two_dates import (
    DATED_COLUMNS,
    bearing_by_two_dates,
    odds_of_ages,
    seasons_between,
)
from cherrypicker.errors import StageError
from cherrypicker.files import write_json
from cherrypicker.formats.measured import read_measured_tree
from cherrypicker.pointcloud import PointCloud, write_cloud
from cherrypicker.report.series_page import series_page
from cherrypicker.series.changes import find_gone
from cherrypicker.series.compare import compare_scans
from cherrypicker.series.frame import marker_corners, marker_starts, moved_by
from cherrypicker.series.scan_files import read_scan
from cherrypicker.series.tables import TABLES, as_csv, growth_table, totals
from cherrypicker.series.wood import Wood, sample_wood
from cherrypicker.skeleton import Skeleton, axes, write_skeleton_graphml
from cherrypicker.traits.branches import branch_rows, branches_csv
from cherrypicker.traits.table import LIMB_COLUMNS
from cherrypicker_lab.orchard.grow.seasons import NEW
from cherrypicker_lab.series.judge import judge_step

FILES = ("report.html", "series.json", *(f"{name}.csv" for name in (*TABLES, "bearing")))


@pytest.fixture(scope="module")
def series(dates):
    return compare_scans([dates.grown.scan, dates.first.scan, dates.pruned.scan])


@pytest.fixture(scope="module")
def pruned(dates):
    comparison = compare_scans([dates.first.scan, dates.pruned.scan])
    return judge_step(
        comparison,
        dates.first.dated,
        dates.pruned.dated,
        dates.pruned.scan.wood,
        dates.pruned.frame,
    )


def test_scans_stand_by_date_in_the_frame_of_the_first(series, dates):
    assert [scan.tree for scan in series.scans] == ["first", "pruned", "grown"]
    back = np.linalg.inv(dates.pruned.frame)
    assert_allclose(series.steps[0].fit.matrix, back, atol=0.004)


def test_the_cuts_are_found_and_nothing_else(pruned):
    cuts = pruned["cuts"]
    assert cuts["n_true"] >= 5
    assert cuts["n_right"] == cuts["n_found"] == cuts["n_true"]
    assert pruned["removed_length_m"] == pytest.approx(pruned["true_removed_length_m"], rel=0.05)
    assert pruned["removed_volume_m3"] == pytest.approx(pruned["true_removed_volume_m3"], rel=0.1)
    assert pruned["false_removed_length_m"] < 0.01 * pruned["length_m"]
    assert pruned["new_length_m"] < 0.01 * pruned["length_m"]


def test_branches_keep_their_ids_over_pruning_and_a_year_of_growth(dates):
    grown = dates.grown
    comparison = compare_scans([dates.first.scan, grown.scan])
    judged = judge_step(comparison, dates.first.dated, grown.dated, grown.scan.wood, grown.frame)
    counts = judged["axes_10cm"]
    assert counts["n_right"] >= 0.95 * max(counts["n_true"], counts["n_found"]) > 10
    assert judged["cuts"]["n_right"] == judged["cuts"]["n_true"]
    assert judged["new_length_m"] == pytest.approx(judged["true_new_length_m"], rel=0.1)
    assert judged["false_removed_length_m"] < 0.01 * judged["length_m"]


def test_an_unchanged_tree_has_neither_cuts_nor_shoots(dates):
    (step,) = compare_scans([dates.first.scan, dates.again.scan]).steps
    assert len(step.gone.first) == 0
    assert step.later.wood.length[step.new.piece >= 0].sum() < 0.01 * step.later.wood.length.sum()
    assert step.scale_ratio == pytest.approx(1.0, abs=0.005)
    assert step.warnings == []


def test_ids_last_and_are_never_used_twice(series):
    first, pruned, grown = series.ids
    assert_allclose(first, np.arange(len(first)))
    for ids in series.ids:
        assert len(np.unique(ids)) == len(ids)
    removed = set(first) - set(pruned)
    assert removed and not removed & set(grown)
    assert min(set(grown) - set(pruned)) > max(first.max(), pruned.max())


def test_another_tree_is_left_out_and_the_others_go_on(dates):
    twin = dates.again.scan
    wood = twin.wood.moved(np.diag([1.0, 1.0, -1.0, 1.0]))  # upside down
    other = type(twin)("other", "2024-02-15", wood, twin.branches, twin.cloud)
    comparison = compare_scans([dates.first.scan, other, twin])
    assert [scan.tree for scan in comparison.scans] == ["first", "again"]
    assert "is it another tree" in comparison.left_out["other"]
    other = type(twin)("other", "2019-02-15", wood, twin.branches, twin.cloud)  # and comes first
    comparison = compare_scans([dates.first.scan, other, twin])
    assert [scan.tree for scan in comparison.scans] == ["first", "again"]
    assert "is it another tree" in comparison.left_out["other"]
    with pytest.raises(StageError, match="no two scans"):
        compare_scans([dates.first.scan, other])


def test_a_foot_that_was_found_too_low_does_not_hide_the_frame(dates):
    again = dates.again.scan
    wood = Wood(**{name: values.copy() for name, values in vars(again.wood).items()})
    wood.points[0] -= [0.0, 0.0, 0.12]
    scan = type(again)("again", again.date, wood, again.branches, again.cloud)
    (step,) = compare_scans([dates.first.scan, scan]).steps
    assert_allclose(step.fit.matrix, np.linalg.inv(dates.again.frame), atol=0.004)


def test_a_wrong_scale_is_warned_of(dates):
    again = dates.again.scan
    wood = Wood(1.03 * again.wood.points, *list(vars(again.wood).values())[1:])
    scan = type(again)("again", again.date, wood, again.branches, 1.03 * again.cloud)
    (step,) = compare_scans([dates.first.scan, scan]).steps
    assert any(line.startswith("scale_differs") for line in step.warnings)


def stem_with_limbs(n_limbs=3, thin=0.004):
    """Wood: a stem of 2 m and limbs of 0.5 m on it, of samples a centimetre apart."""
    parts = [(np.column_stack([np.zeros((201, 2)), np.arange(201) / 100]), 0.03, -1)]
    for limb in range(n_limbs):
        out = np.column_stack([np.arange(1, 51) / 100, np.zeros(50), np.full(50, 0.5 * (limb + 1))])
        parts.append((out, thin, 50 * (limb + 1)))
    parent, axis, n = [], [], 0
    for number, (points, _, foot) in enumerate(parts):
        parent.append(np.append(foot, n + np.arange(len(points) - 1)))
        axis.append(np.full(len(points), number))
        n += len(points)
    length = np.full(n, 0.01)
    radius = np.concatenate([np.full(len(points), thick) for points, thick, _ in parts])
    points = np.concatenate([points for points, _, _ in parts])
    none = np.zeros(n)
    return Wood(
        points,
        radius,
        length,
        np.concatenate(parent),
        np.concatenate(axis),
        none,
        np.arange(n),
    )


def test_a_limb_that_is_not_there_was_cut_a_short_twig_was_missed():
    wood = stem_with_limbs()
    is_there = wood.axis != 2
    gone = find_gone(wood, is_there)
    assert_allclose(gone.piece >= 0, ~is_there)
    assert wood.axis[gone.first] == [2]
    short = np.ones(len(wood), dtype=bool)
    short[np.flatnonzero(wood.axis == 1)[-6:]] = False  # 6 cm at its tip
    assert (find_gone(wood, short).piece < 0).all()


def test_a_gap_in_what_goes_on_is_no_cut():
    wood = stem_with_limbs()
    is_there = np.ones(len(wood), dtype=bool)
    is_there[np.flatnonzero(wood.axis == 1)[10:22]] = False
    assert (find_gone(wood, is_there).piece < 0).all()


def test_wood_that_hung_on_a_removed_limb_by_a_wrong_joint_stays():
    wood = stem_with_limbs()
    wood.parent[np.flatnonzero(wood.axis == 3)[0]] = np.flatnonzero(wood.axis == 2)[-1]
    gone = find_gone(wood, wood.axis != 2)
    assert_allclose(gone.piece >= 0, wood.axis == 2)


def test_samples_are_even_and_hang_on_their_parents(dates):
    wood = dates.first.scan.wood
    step = np.linalg.norm(wood.points[1:] - wood.points[wood.parent[1:]], axis=1)
    # noisy nodes make the polylines longer than the chords between samples
    assert np.quantile(step, 0.99) < 0.02
    assert (wood.parent[1:] < np.arange(1, len(wood))).all()
    skeleton = dates.first.skeleton
    assert wood.length.sum() == pytest.approx(skeleton.edge_length.sum(), rel=0.01)


def test_markers_give_the_frame_where_they_stayed():
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(4, 3))
    turn = np.eye(3)[[1, 2, 0]]
    transform = np.eye(4)
    transform[:3] = np.column_stack([turn, [2.0, 4.0, 6.0]])
    marker = {"id": 7, "used": True, "corners": corners.tolist()}
    scale = {"dictionary": "DICT", "markers": [marker, {"id": 8, "used": False}], "scale": 0.5}
    twice = marker | {"id": 9, "n_places": 2}
    scale["markers"] += [twice, twice]
    found = marker_corners(scale, {"transform": transform.tolist()})
    assert list(found) == [("DICT", 7)]
    assert_allclose(found["DICT", 7], 0.5 * corners @ turn.T + [1.0, 2.0, 3.0], atol=1e-9)
    later = {("DICT", 7): found["DICT", 7] + [0.1, 0.0, 0.0], ("DICT", 9): corners}
    (start,) = marker_starts(found, later)
    assert_allclose(start[:3, 3], [-0.1, 0.0, 0.0], atol=1e-9)
    assert moved_by(found, later) == {"DICT 7": pytest.approx(0.1)}


def test_the_tables_and_the_page_say_what_changed(series):
    tables = {name: make(series) for name, (make, _) in TABLES.items()}
    for name, (_, columns) in TABLES.items():
        rows = list(csv.DictReader(io.StringIO(as_csv(tables[name], columns))))
        assert len(rows) == len(tables[name]) > 0
    numbers = totals(series)
    json.dumps(numbers, allow_nan=False)
    first, second = numbers["steps"]
    cuts = [row for row in tables["cuts"] if row["to_tree"] == "pruned"]
    assert first["n_cuts"] == len(cuts)
    assert sum(row["length_m"] for row in cuts) == pytest.approx(first["removed_length_m"])
    assert second["n_shoots"] == sum(row["to_tree"] == "grown" for row in tables["shoots"])
    before = {row["series_branch_id"] for row in tables["branches"] if row["tree"] == "first"}
    assert {row["series_branch_id"] for row in cuts} <= before
    trunk = tables["growth"][0]
    assert trunk["series_branch_id"] == 0
    assert trunk["base_diameter_growth_m"] == pytest.approx(0.0, abs=0.005)
    page = series_page("row <1>", series, tables, numbers["steps"])
    assert "row &lt;1&gt;" in page and "row <1>" not in page
    assert "http" not in page.replace("http://www.w3.org", "")
    assert page.count('class="cut"') == 2 * (first["n_cuts"] + second["n_cuts"])


def test_a_removed_volume_ends_where_its_diameters_do(series, dates):
    first = dates.first.scan
    ends = [
        {"base_diameter_low_m": mid - 0.001, "base_diameter_high_m": mid + 0.002}
        for mid in (row["base_diameter_m"] for row in first.branches)
    ]
    told = [row | more for row, more in zip(first.branches, ends, strict=True)]
    found = compare_scans([replace(first, branches=told), dates.pruned.scan])
    (numbers,), (step,) = totals(found)["steps"], found.steps
    wood, gone = step.earlier.wood, step.gone.piece >= 0
    radius, length = wood.radius[gone], wood.length[gone]
    middle = np.array([row["base_diameter_m"] for row in told])[wood.axis[gone]]
    low = np.pi * (radius * (1 - 0.001 / middle)) ** 2 @ length
    high = np.pi * (radius * (1 + 0.002 / middle)) ** 2 @ length
    assert numbers["removed_volume_low_m3"] == pytest.approx(low)
    assert numbers["removed_volume_high_m3"] == pytest.approx(high)
    rows = TABLES["cuts"][0](found)
    assert sum(row["volume_high_m3"] for row in rows) == pytest.approx(high)
    tables = {name: make(found) for name, (make, _) in TABLES.items()}
    page = series_page("row", found, tables, [numbers])
    assert f"({1e6 * low:.0f} to {1e6 * high:.0f})" in page
    assert totals(series)["steps"][0]["removed_volume_low_m3"] is None  # no radius has an error


def test_a_removed_volumes_lengths_end_where_the_scale_does(dates):
    """A scale that is 2 % off makes lengths so too, besides the radii that know of it."""
    first = dates.first.scan
    ends = ("base_diameter_low_m", "base_diameter_high_m")
    told = [row | dict.fromkeys(ends, row["base_diameter_m"]) for row in first.branches]
    scan = replace(first, branches=told, scale_error=0.02)
    (numbers,) = totals(compare_scans([scan, dates.pruned.scan]))["steps"]
    volume = numbers["removed_volume_m3"]
    assert numbers["removed_volume_low_m3"] == pytest.approx(volume * (1 - 1.645 * 0.02), rel=1e-3)
    assert numbers["removed_volume_high_m3"] == pytest.approx(volume * (1 + 1.645 * 0.02), rel=1e-3)


def test_a_scan_in_another_frame_has_its_scales_error(dates):
    scan = replace(dates.pruned.scan, scale_error=0.02)
    assert scan.moved(dates.pruned.frame).scale_error == 0.02


def write_results(folder, found):
    folder.mkdir(parents=True)
    write_skeleton_graphml(folder / "skeleton.graphml", found.skeleton)
    rows = branch_rows(found.skeleton, axes(found.skeleton), 0.0)
    (folder / "branches.csv").write_text(branches_csv(rows))
    (folder / "limbs.csv").write_text(branches_csv([], LIMB_COLUMNS))
    (folder / "traits.json").write_text('{"tcsa_cm2": 12.0}')
    label = np.ones(len(found.scan.cloud), dtype=np.uint8)
    write_cloud(folder / "segmented.ply", PointCloud(found.scan.cloud, fields={"label": label}))


@pytest.fixture(scope="module")
def results(dates, tmp_path_factory):
    folder = tmp_path_factory.mktemp("series") / "results"
    write_results(folder / "a", dates.first)
    write_results(folder / "b", dates.pruned)
    write_results(folder / "grown", dates.grown)
    return folder


def test_the_stage_names_a_broken_scan_and_compares_the_others(results, tmp_path, monkeypatch):
    monkeypatch.chdir(results.parent)
    (results / "c").mkdir()
    days = ["2024-02-01", "2025-02-01", "2026-02-01"]
    files = [str(tmp_path / name) for name in FILES]
    stage.main("row 1", ["a", "b", "c"], days, *files, unfinished=["d"])
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)
    numbers = json.loads((tmp_path / "series.json").read_text())
    assert numbers["left_out"].keys() == {"c", "d"}
    assert numbers["steps"][0]["n_cuts"] >= 5
    with open(tmp_path / "bearing.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert {(row["tree"], row["date"]) for row in rows} == {("b", "2025-02-01")}
    shoots = numbers["steps"][0]["bearing"]["shoots"]
    assert f"{shoots:.0f}, " in (tmp_path / "report.html").read_text()
    with pytest.raises(StageError, match="fewer than two"):
        stage.main("row 1", ["a", "c"], days[:2], *files)


def dated(step, first, last):
    """The same step of other days."""
    return replace(
        step, earlier=replace(step.earlier, date=first), later=replace(step.later, date=last)
    )


def test_growing_seasons_lie_between_winters(series):
    step = series.steps[1]
    days = {"2026-02-20": 0, "2026-12-01": 1, "2027-04-01": 1, "2027-11-20": 2}
    for last, n_seasons in days.items():
        assert seasons_between(dated(step, "2025-12-10", last)) == n_seasons
    with pytest.raises(StageError, match="no ISO dates: '2025', '2026-12-01'"):
        seasons_between(dated(step, "2025", "2026-12-01"))


def test_wood_that_the_earlier_scan_lacks_is_of_the_season_between(series, dates, results):
    step, ids = series.steps[1], series.ids[2]
    is_new = dates.grown.dated.node_numbers == NEW
    odds = odds_of_ages(step, 1, 6)
    assert np.mean(odds[is_new, 0] > 0) > 0.85 and np.mean(odds[~is_new, 0] < 0) > 0.97
    assert not odds[:, 1:].any() and (odds_of_ages(step, 2, 6)[:, 1] == odds[:, 0]).all()

    tree = read_measured_tree(results / "grown")
    length = tree.skeleton.edge_length[is_new].sum()

    def off(rows):
        """How far the length of one-year wood is from the truth, as a share."""
        return sum(row["length_m"] for row in rows if row["age_years"] == 1) / length - 1

    told, rows = bearing_by_two_dates(step, ids, results / "grown")
    _, alone = measure_bearing(tree, [])
    assert abs(off(rows)) < 0.1 < abs(off(alone))
    assert told["seasons"] == 1 and set(rows[0]) == set(DATED_COLUMNS)
    assert {row["series_branch_id"] for row in rows} <= set(ids.tolist())
    same_winter = dated(step, "2025-12-10", "2026-02-01")
    assert bearing_by_two_dates(same_winter, ids, results / "grown") == (None, [])


def test_a_series_whose_limbs_cannot_be_read_tells_no_ages_and_says_so(
    results, tmp_path, monkeypatch
):
    monkeypatch.chdir(results.parent)
    limbs = results / "b" / "limbs.csv"
    before = limbs.read_text()
    limbs.write_text("rank,branch_id,area_cm2\n1,x,2\n")
    files = [str(tmp_path / name) for name in FILES]
    stage.main("row 1", ["a", "b"], ["2024-02-01", "2025-02-01"], *files)
    limbs.write_text(before)
    (step,) = json.loads((tmp_path / "series.json").read_text())["steps"]
    assert step["bearing"] is None and step["n_cuts"] >= 5
    assert any("no_ages" in line and "limbs.csv" in line for line in step["warnings"])


def test_what_became_of_proposed_cuts_is_told(results, tmp_path, monkeypatch):
    monkeypatch.chdir(results.parent)
    files = [str(tmp_path / name) for name in FILES]
    given = "row 1", ["a", "b"], ["2024-02-01", "2025-02-01"], *files
    stage.main(*given)
    with open(tmp_path / "cuts.csv", newline="") as stream:
        cuts = list(csv.DictReader(stream))
    with open(tmp_path / "growth.csv", newline="") as stream:
        whole = [row for row in csv.DictReader(stream) if float(row["removed_m"]) == 0]
    uncut = max((row for row in whole if row["order"] == "1"), key=lambda r: r["length_before_m"])
    plan = results / "a" / "pruning.csv"
    made, missed = cuts[0]["series_branch_id"], uncut["series_branch_id"]
    lines = f"cut,branch_id,along_m\n1,{made},{cuts[0]['left_m']}\n2,{missed},0.05\n"
    plan.write_text(lines)
    stage.main(*given, pruning=[str(plan)])
    told = json.loads((tmp_path / "series.json").read_text())["steps"][0]["proposed"]
    assert (told["made_cuts"], told["missed_cuts"]) == ([1], [2])
    assert told["n_more_cuts"] == len(cuts) - 1 and told["more_length_m"] > 0.25
    assert "1 made, missed: 2" in (tmp_path / "report.html").read_text()


def test_of_a_series_with_a_failure_the_finished_scans_are_left(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for tree in "ab":
        (tmp_path / "results" / tree).mkdir(parents=True)
        (tmp_path / "results" / tree / "traits.json").write_text('{"unit": "m"}')
    rows = [Tree(tree, series="row 1", date=f"202{n}-02-01") for n, tree in enumerate("abc")]
    assert series_of(filter(is_finished, rows)) == {"row_1": rows[:2]}
    assert series_of(filter(is_finished, rows[1:])) == {}


def test_a_scan_without_date_or_scale_is_refused(results, tmp_path):
    with pytest.raises(StageError, match="tree a .* no date") as refused:
        read_scan(results / "a", "a", "")
    assert refused.value.key == "date in trees.tsv"
    arbitrary = Skeleton(np.eye(3), [-1, 0, 1], np.ones(3), np.ones(3), unit="arbitrary")
    write_skeleton_graphml(tmp_path / "skeleton.graphml", arbitrary)
    rows = branch_rows(arbitrary, axes(arbitrary), 0.0)
    (tmp_path / "branches.csv").write_text(branches_csv(rows))
    with pytest.raises(StageError, match="tree t has no scale"):
        read_scan(tmp_path, "t", "2026-01-01")


def test_a_number_that_is_none_is_told_with_its_branch(results, tmp_path):
    for name in ("skeleton.graphml", "segmented.ply", "branches.csv"):
        (tmp_path / name).write_bytes((results / "a" / name).read_bytes())
    head, first, second, *rest = (tmp_path / "branches.csv").read_text().splitlines()
    cells = second.split(",")
    for value, told in (
        ("inf", "branch 1 has no finite number as its length_m: inf"),
        ("2 m", r"could not convert string to float: '2 m', after 1 rows"),
    ):
        cells[head.split(",").index("length_m")] = value
        (tmp_path / "branches.csv").write_text("\n".join([head, first, ",".join(cells), *rest]))
        with pytest.raises(StageError, match=told):
            read_scan(tmp_path, "a", "2026-01-01")


def test_what_photos_say_of_diameters_counts_in_volumes(results, dates, tmp_path):
    scan = read_scan(results / "a", "a", "2026-01-01")
    assert_allclose(scan.wood.radius, sample_wood(dates.first.skeleton).radius, rtol=0.06)
    skeleton = dates.first.skeleton
    axis_list = axes(skeleton)
    nodes = axis_list[1].nodes
    widths = 2 * skeleton.radius[nodes] + 0.004
    seen = {"branch_id": 1, "diameter": widths.mean(), "diameter_se": 1e-5}
    check = {"branches": [seen | {"widths": widths.tolist()}]}
    for name in ("skeleton.graphml", "segmented.ply"):
        (tmp_path / name).write_bytes((results / "a" / name).read_bytes())
    table = branch_rows(skeleton, axis_list, 0.0, photo_check=check)
    (tmp_path / "branches.csv").write_text(branches_csv(table))
    write_json(tmp_path / "photo_check.json", check)
    wider = 2 * (read_scan(tmp_path, "a", "2026-01-01").wood.radius - scan.wood.radius)
    is_seen = scan.wood.axis == 1
    assert (wider[~is_seen] == 0).all()
    # As much at its thick end as at its tip
    assert wider[is_seen].min() > 0.003 and wider[is_seen].max() < 0.0041


def test_growth_is_as_unsure_as_both_diameters(dates):
    def told(scan, low, high):
        ends = [
            {"base_diameter_low_m": d - low, "base_diameter_high_m": d + high}
            for d in (row["base_diameter_m"] for row in scan.branches)
        ]
        rows = [row | end for row, end in zip(scan.branches, ends, strict=True)]
        return replace(scan, branches=rows)

    before, after = told(dates.first.scan, 0.003, 0.004), told(dates.grown.scan, 0.001, 0.002)
    for row in growth_table(compare_scans([before, after])):
        grown = row["base_diameter_growth_m"]
        assert grown - row["base_diameter_growth_low_m"] == pytest.approx(np.hypot(0.001, 0.004))
        assert row["base_diameter_growth_high_m"] - grown == pytest.approx(np.hypot(0.002, 0.003))


def test_the_error_of_a_scans_scale_is_a_share_of_it(results, tmp_path):
    for name in ("skeleton.graphml", "segmented.ply", "branches.csv"):
        (tmp_path / name).write_bytes((results / "a" / name).read_bytes())
    assert read_scan(tmp_path, "a", "2026-01-01").scale_error == 0.0
    (tmp_path / "scale.json").write_text('{"scale": 4.0, "scale_std": 0.08}')
    assert read_scan(tmp_path, "a", "2026-01-01").scale_error == pytest.approx(0.02)
