"""A part of a tree's page that fails: the page is made without it, says so, and is made anew."""

import csv

from workspace import Workspace

PARTS = {"bearing": {"enabled": True}, "pruning": {"preset": "ltr_100"}}
LIGHT = {"enabled": True, "latitude_deg": 48.0, "longitude_deg": 9.0}
SEASON = ["2026-04-01", "2026-10-31"]
WHY = "the season ends, 2026-04-01, before it begins, 2026-10-31"


def a_batch(tmp_path, season=SEASON[::-1]):
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("a")
    workspace.table("tree | cloud", "a | a.ply")
    workspace.configure({**PARTS, "light": {**LIGHT, "season": season}})
    return workspace


def test_a_tree_whose_light_fails_has_a_page_that_says_so(tmp_path):
    workspace = a_batch(tmp_path)
    results = workspace.folder / "results"
    ran = workspace.ran(fails=True)
    assert {("report_tree", "a"), ("measure_bearing", "a"), ("summarise_batch", "")} <= ran
    assert f"ERROR tree=a rule=measure_light: {WHY}" in workspace.printed
    page = (results / "a/report.html").read_text()
    assert f"no light: measure_light: {WHY}" in page and "change: light.season" in page
    assert "no pruning: propose_pruning: it was not run" in page
    assert "<h2>Bearing wood</h2>" in page and "<h2>Light</h2>" not in page
    with open(results / "traits.csv", newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert (row["status"], row["failed_stage"]) == ("failed", "measure_light")
    assert row["change"] and row["height_m"]
    summary = (results / "summary.html").read_text()
    assert 'href="a/report.html"' in summary and "One-year shoots" in summary

    # Nothing has changed: neither has the page; what fails is tried again
    assert workspace.ran(fails=True) == {("summarise_batch", "")}
    # What the page says goes with the reason
    workspace.configure({**PARTS, "light": {**LIGHT, "season": ["2026-10-31", "2026-05-01"]}})
    assert ("report_tree", "a") in workspace.ran(fails=True)
    assert "ends, 2026-05-01, before" in (results / "a/report.html").read_text()

    workspace.configure({**PARTS, "light": {**LIGHT, "season": SEASON}})
    expected = {("measure_light", "a"), ("propose_pruning", "a"), ("report_tree", "a")}
    assert workspace.ran() == expected | {("summarise_batch", "")}
    page = (results / "a/report.html").read_text()
    assert "<h2>Light</h2>" in page and "<h2>Pruning" in page and "measure_light" not in page

    # Cuts of the light before are none of this page
    workspace.configure({**PARTS, "light": {**LIGHT, "season": SEASON[::-1]}})
    assert ("report_tree", "a") in workspace.ran(fails=True)
    assert (results / "a/pruning.json").exists()
    assert "<h2>Pruning" not in (results / "a/report.html").read_text()


def test_a_part_that_a_run_ended_before_is_not_said_to_need_what_failed(tmp_path):
    workspace = a_batch(tmp_path)
    light_first = ("--prioritize", "results/a/light.json")  # of jobs that wait any may be next
    ran = workspace.ran("--workflow-profile", "none", "--cores", "1", *light_first, fails=True)
    assert ("report_tree", "a") in ran and ("measure_bearing", "a") not in ran
    page = (workspace.folder / "results/a/report.html").read_text()
    told = "measure_bearing: it was not run: what it needs failed, or the run ended before"
    assert told in page and f"no light: measure_light: {WHY}" in page


def test_a_tree_without_what_its_page_needs_has_no_page(tmp_path):
    workspace = a_batch(tmp_path)
    (workspace.folder / "a.ply").write_bytes(b"ply\n")
    ran = workspace.ran(fails=True)
    assert ran == {("summarise_batch", "")}
    assert not (workspace.folder / "results/a/report.html").exists()
