"""The batch's table and page, also when trees failed or files are broken."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cherrypicker.batch.summary import result_of, summarise
from cherrypicker.traits.table import TRAITS as TABLE

TRAITS = {"unit": "m", "height_m": 3.1234, "height_m_se": 0.01, "n_tips": 31, "flags": ["low: x"]}


@pytest.fixture
def batch(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results, logs = tmp_path / "results", tmp_path / "logs"

    def add_traits(tree, **changes):
        (results / tree).mkdir(parents=True, exist_ok=True)
        (results / tree / "traits.json").write_text(json.dumps(TRAITS | changes))

    def add_failure(tree, rule, state="failed", **changes):
        record = {"state": state, "rule": rule, "tree": tree, "cause": "no marker", "key": "scale"}
        record |= {"file": "a.jpg", "log": "logs/x.log", "time": "2026-03-01T10:00:00+0000"}
        folder = logs / "status" / tree
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{rule}.json").write_text(json.dumps(record | changes))

    def run(*trees):
        rows = [tree if isinstance(tree, dict) else {"tree": tree} for tree in trees]
        out = tmp_path / "traits.csv", tmp_path / "summary.html"
        summarise(rows, *out)
        with open(out[0], newline="") as stream:
            return list(csv.DictReader(stream)), out[1].read_text()

    run.add_traits, run.add_failure, run.root = add_traits, add_failure, tmp_path
    return run


def island(page):
    """The numbers behind the page's charts."""
    return json.loads(page.partition('id="batch">')[2].partition("</script>")[0])


def test_done_failed_and_not_run(batch):
    batch.add_traits("good")
    batch.add_failure("bad", "estimate_scale")
    batch.add_failure("killed", "estimate_depth", state="running")
    rows, page = batch("good", "bad", "killed", "new")
    by_tree = {row["tree"]: row for row in rows}
    assert [row["tree"] for row in rows] == ["good", "bad", "killed", "new"]
    assert by_tree["good"]["status"] == "done"
    assert float(by_tree["good"]["height_m"]) == pytest.approx(3.1234)
    assert by_tree["good"]["flags"] == "low: x"
    assert by_tree["bad"]["status"] == "failed"
    assert by_tree["bad"]["failed_stage"] == "estimate_scale"
    assert by_tree["bad"]["cause"] == "no marker"
    assert by_tree["bad"]["change"] == "scale"
    assert by_tree["killed"]["status"] == "interrupted"
    assert by_tree["new"]["status"] == "not run"
    assert page.index("estimate_scale") < page.index("3.123")


def test_numbers_of_a_tree_that_failed_again_are_not_shown(batch):
    batch.add_traits("tree")
    batch.add_failure("tree", "segment_cloud")
    rows, _ = batch("tree")
    assert rows[0]["status"] == "failed"
    assert rows[0]["height_m"] == ""


def test_a_failed_report_keeps_the_traits(batch):
    batch.add_traits("tree")
    batch.add_failure("tree", "report_tree")
    rows, _ = batch("tree")
    assert rows[0]["status"] == "failed"
    assert rows[0]["height_m"] != ""


@pytest.mark.parametrize("rule", ["measure_light", "measure_bearing", "propose_pruning"])
def test_a_failure_of_what_comes_after_the_traits_keeps_them_while_it_is_asked_for(batch, rule):
    batch.add_traits("tree")
    batch.add_failure("tree", rule)
    kind = rule.rpartition("_")[2]
    asked = result_of({"tree": "tree", "parts": (kind,)})
    assert (asked.status, asked.stage, asked.traits["n_tips"]) == ("failed", rule, 31)
    assert result_of({"tree": "tree"}).status == "done"


def test_an_old_failure_of_a_finished_tree_is_over(batch):
    batch.add_failure("tree", "estimate_scale")
    old = batch.root / "logs/status/tree/estimate_scale.json"
    os.utime(old, (1e9, 1e9))
    batch.add_traits("tree")
    rows, _ = batch("tree")
    assert rows[0]["status"] == "done"


def test_broken_files_of_one_tree_do_not_hide_the_others(batch):
    batch.add_traits("good")
    batch.add_traits("broken")
    (batch.root / "results/broken/traits.json").write_text("{")
    status = batch.root / "logs/status/strange"
    status.mkdir(parents=True)
    (status / "align_cloud.json").write_text("[]")
    rows, _ = batch("broken", "strange", "good")
    assert [row["status"] for row in rows] == ["failed", "failed", "done"]
    assert "not readable" in rows[0]["cause"]


def test_unscaled_tree_has_units_and_no_metres(batch):
    batch.add_traits("tree", unit="arbitrary", tcsa_cm2=52.0, flags=[])
    rows, page = batch("tree")
    assert rows[0]["unit"] == "arbitrary"
    assert "3.123 ± 0.010 units" in page
    table = page[page.index("<tbody>") : page.index("</tbody>")]
    assert "cm²" not in table
    assert " m<" not in table
    charted = island(page)
    names = [trait["name"] for trait in charted["traits"]]
    values = dict(zip(names, charted["trees"][0]["values"], strict=True))
    assert values["height_m"] is None
    assert values["n_tips"] == 31


def test_series_over_dates(batch):
    batch.add_traits("spring")
    batch.add_traits("autumn", height_m=3.6)
    _, page = batch(
        {"tree": "autumn", "date": "2026-10-01", "series": "row <1>"},
        {"tree": "spring", "date": "2026-03-01", "series": "row <1>"},
    )
    assert "row &lt;1&gt;" in page
    autumn, spring = island(page)["trees"]
    assert (autumn["date"], spring["date"]) == ("2026-10-01", "2026-03-01")
    assert (autumn["values"][0], spring["values"][0]) == (3.6, 3.1234)
    assert autumn["series"] == spring["series"] == "row <1>"


def test_the_dictionary_names_every_column_with_its_unit(batch):
    batch.add_traits("tree", tcsa_cm2=52.0, height_m_ci90=[3.1, 3.2])
    rows, _ = batch("tree", "new")
    package = json.loads((batch.root / "datapackage.json").read_text())
    resource = package["resources"][0]
    fields = {field["name"]: field for field in resource["schema"]["fields"]}
    assert resource["path"] == "traits.csv"
    assert list(fields) == list(rows[0])
    assert (rows[0]["height_m_ci90_low"], rows[0]["height_m_ci90_high"]) == ("3.1", "3.2")
    for name, trait in TABLE.items():
        assert fields[name]["title"] == trait.title
        assert fields[name]["unit"] == trait.unit
        spelled = trait.unit.replace("1/", "per_").replace("/", "_")
        assert trait.unit == "1" or name.endswith(f"_{spelled}")
        assert fields[name]["description"] == trait.definition != ""


def test_the_columns_of_earlier_versions_keep_their_places(batch):
    batch.add_traits("tree")
    rows, _ = batch("tree")
    before = "tree,status,failed_stage,cause,change,date,series,unit,height_m,trunk_diameter_m,"
    before += "trunk_height_m,tcsa_cm2,crown_width_m,crown_volume_m3,total_length_m,n_junctions,"
    before += (
        "n_tips,photo_precision,photo_recall,height_m_se,trunk_diameter_m_se,tcsa_cm2_se,flags"
    )
    assert ",".join(rows[0]).startswith(before + ",")


def test_jobs_are_summed_by_stage_in_the_order_of_the_stages(batch):
    batch.add_traits("tree")
    batch.add_traits("other")
    for rule, tree, seconds in (("measure_traits", "tree", 30), ("fuse_depth", "tree", 90)):
        folder = batch.root / "benchmarks" / rule
        folder.mkdir(parents=True)
        head = "s\tmax_rss\tcpu_time\n"
        (folder / f"{tree}.tsv").write_text(f"{head}{seconds}\t2000\t60\n")
        (folder / "stranger.tsv").write_text(f"{head}9999\t2000\t60\n")
        (folder / "other.tsv").write_text(f"{head}NA\tNA\tNA\n")
    _, page = batch("tree", "other")
    jobs = {stage["rule"]: stage["jobs"] for stage in island(page)["stages"]}
    assert jobs == {"fuse_depth": [[0, 90.0, 2.0]], "measure_traits": [[0, 30.0, 2.0]]}
    assert list(jobs) == ["fuse_depth", "measure_traits"]
    assert "1 min 30 s" in page
    assert "9999" not in page


def test_hand_measurements_that_cannot_be_read_hide_nothing(batch):
    batch.add_traits("tree")
    (batch.root / "results/tree/measures.json").write_text("[")
    rows, page = batch("tree")
    assert rows[0]["status"] == "done"
    assert "Against hand measurements" not in page
    assert len((batch.root / "accuracy.csv").read_text().splitlines()) == 1


def test_measurements_that_are_gone_from_the_table_do_not_count(batch):
    batch.add_traits("a")
    pair = {"trait": "height_m", "found": 3.1, "measured": 3.0}
    (batch.root / "results/a/measures.json").write_text(json.dumps({"measures": [pair]}))
    batch.add_failure("a", "compare_measures", time="2099-03-01T10:00:00+0000")
    (row,), _ = batch({"tree": "a", "parts": ()})
    assert row["status"] == "done"
    assert "3.0" not in (batch.root / "measures.csv").read_text()


def test_links_only_to_what_is_there(batch):
    batch.add_traits("tree")
    result = result_of({"tree": "tree"})
    assert (result.report, result.thumbnail) == ("", "")
    (batch.root / "results/tree/report.html").write_text("x")
    _, page = batch("tree")
    assert 'href="tree/report.html"' in page


def test_summary_is_light_to_import():
    """Snakemake's main process imports it for every run."""
    code = (
        "import sys; import cherrypicker.batch.summary, cherrypicker.report.summary_page; "
        "print([m for m in ('scipy', 'matplotlib', 'pycolmap', 'torch') if m in sys.modules])"
    )
    scripts = Path(__file__).parents[2] / "scripts"
    out = subprocess.run(
        [sys.executable, "-c", code], cwd=scripts, capture_output=True, text=True, check=True
    )
    assert out.stdout.strip() == "[]"


def test_a_series_links_to_its_page_and_its_failure_is_told(batch):
    rows = [
        {"tree": tree, "date": date, "series": "row 3"}
        for tree, date in (("a", "2025-02-11"), ("b", "2026-02-14"))
    ]
    for row in rows:
        batch.add_traits(row["tree"])
    (batch.root / "results/series/row_3").mkdir(parents=True)
    (batch.root / "results/series/row_3/report.html").write_text("page")
    _, page = batch(*rows)
    assert page.count('<a href="series/row_3/report.html">row 3</a>') == 2
    assert "<h2>Failed</h2>" not in page
    batch.add_failure("_batch", "compare_series.row_3", cause="no two dates")
    _, page = batch(*rows)
    failed = page.partition("<h2>Failed</h2>")[2].partition("</table>")[0]
    assert "series row 3" in failed and "no two dates" in failed
    _, page = batch({"tree": "a"}, {"tree": "b"})  # the series has left the table
    assert "<h2>Failed</h2>" not in page
