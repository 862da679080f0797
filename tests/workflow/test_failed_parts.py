"""A part of a tree's page that fails: the page is made without it, says so, and is made anew."""

import csv

import pytest
from workspace import Workspace, project_with_own

RAYS = "scripts/cherrypicker/light/rays.py"
PARTS = {"bearing": {"enabled": True}, "pruning": {"preset": "ltr_100"}}
LIGHT = {"enabled": True, "place_deg": [48.0, 9.0]}
SEASON = ["2026-04-01", "2026-10-31"]
WHY = "the season ends, 2026-04-01, before it begins, 2026-10-31"


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    """A tree whose light fails, of few rays; the tests go on with it, in order."""
    folder = tmp_path_factory.mktemp("batch")
    project = project_with_own(RAYS, folder / "clone")
    text = (project / RAYS).read_text()
    assert text.count("N_RAYS = 200_000") == 1
    (project / RAYS).write_text(text.replace("N_RAYS = 200_000", "N_RAYS = 2_000"))
    workspace = Workspace(folder / "work", project)
    workspace.add_cloud("a")
    workspace.table("tree | cloud", "a | a.ply")
    in_season(workspace, SEASON[::-1])
    return workspace


def in_season(workspace, season):
    workspace.configure({**PARTS, "light": {**LIGHT, "season": season}})


def test_a_part_that_a_run_ended_before_is_not_said_to_need_what_failed(batch):
    light_first = ("--prioritize", "results/a/light.json")  # of jobs that wait any may be next
    ran = batch.ran("--workflow-profile", "none", "--cores", "1", *light_first, fails=True)
    assert ("report_tree", "a") in ran and ("measure_bearing", "a") not in ran
    page = (batch.folder / "results/a/report.html").read_text()
    told = "measure_bearing: it was not run: what it needs failed, or the run ended before"
    assert told in page and f"no light: measure_light: {WHY}" in page


def test_a_tree_whose_light_fails_has_a_page_that_says_so(batch):
    results = batch.folder / "results"
    ran = batch.ran(fails=True)
    assert {("report_tree", "a"), ("measure_bearing", "a"), ("summarise_batch", "")} <= ran
    assert f"ERROR tree=a rule=measure_light: {WHY}" in batch.printed
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
    assert batch.ran(fails=True) == {("summarise_batch", "")}
    # What the page says goes with the reason
    in_season(batch, ["2026-10-31", "2026-05-01"])
    assert ("report_tree", "a") in batch.ran(fails=True)
    assert "ends, 2026-05-01, before" in (results / "a/report.html").read_text()

    in_season(batch, SEASON)
    expected = {("measure_light", "a"), ("propose_pruning", "a"), ("report_tree", "a")}
    assert batch.ran() == expected | {("summarise_batch", "")}
    page = (results / "a/report.html").read_text()
    assert "<h2>Light</h2>" in page and "<h2>Pruning" in page and "measure_light" not in page

    # Cuts of the light before are none of this page
    in_season(batch, SEASON[::-1])
    assert ("report_tree", "a") in batch.ran(fails=True)
    assert (results / "a/pruning.json").exists()
    assert "<h2>Pruning" not in (results / "a/report.html").read_text()


def test_a_tree_without_what_its_page_needs_has_no_page(batch):
    (batch.folder / "b.ply").write_bytes(b"ply\n")
    batch.table("tree | cloud", "b | b.ply")
    ran = batch.ran(fails=True)
    assert ran == {("summarise_batch", "")}
    assert not (batch.folder / "results/b/report.html").exists()
