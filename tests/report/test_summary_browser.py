"""The batch page in a browser: sorting, filtering, charts, links, print; nothing foreign runs."""

import contextlib
import json

import numpy as np
import pytest

from cherrypicker.batch.summary import summarise

HOSTILE = "</script><img src=x onerror=document.title='owned'>"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A batch of 16 trees, one of them failed, one far too high, one with a hostile series."""
    root = tmp_path_factory.mktemp("batch")
    rng, rows = np.random.default_rng(2), []
    for i in range(16):
        tree = f"tree{i:02d}"
        series = HOSTILE if i == 15 else f"pair{i // 2}"
        rows.append({"tree": tree, "series": series, "date": f"2026-0{1 + i % 2}-01"})
        area = float(np.exp(rng.normal(3.7, 0.3)))
        traits = {"unit": "m", "tcsa_cm2": area, "total_length_m": 0.5 * area, "n_tips": 40 + i}
        traits |= {"height_m": 9.0 if i == 5 else 2.0 + 0.02 * i, "height_m_se": 0.01}
        traits |= {"crown_volume_m3": 0.02 * area, "photo_precision": 0.99}
        traits |= {"flags": ["gaps_bridged: 2 %"] if i == 3 else []}
        own = root / "results" / tree
        own.mkdir(parents=True)
        if i == 4:  # spoilt files are of no tree that can be sorted
            rows[-1]["parts"] = ("measures", "pruning", "light", "bearing")
            (own / "pruning.json").write_text('{"n_cuts": 3, "targets": [{"limit": null}]}')
            (own / "light.json").write_text('{"sky_share": [')
            (own / "bearing.json").write_text('{"shoots": {}}')
        if i < 4:  # of those that come after nothing was asked for
            rows[-1]["parts"] = ("measures", "pruning", "light", "bearing")
            target = {"name": "limb_trunk_ratio", "limit": 1.0, "before": 0.7 + 0.2 * i}
            target |= {"after": 0.9, "after_se": None, "is_reached": True}
            targets = [target, {**target, "name": "renew_limbs", "limit": 0.0}]
            found = {"pruning": {"n_cuts": 9 - i, "targets": targets}}
            found |= {"light": {"sky_share": 0.9 - 0.2 * i}, "bearing": {"shoots": 30.4 + i}}
            for kind, content in found.items():
                (own / f"{kind}.json").write_text(json.dumps(content))
        (own / "traits.json").write_text(json.dumps(traits))
        (own / "report.html").write_text(f"<title>{tree}</title>")
        jobs = root / "benchmarks/fuse_depth"
        jobs.mkdir(parents=True, exist_ok=True)
        (jobs / f"{tree}.tsv").write_text(f"s\tmax_rss\tcpu_time\n{10 + i}\t900\t9\n")
    status = root / "logs/status/tree09"
    status.mkdir(parents=True)
    record = {"state": "failed", "rule": "segment_cloud", "cause": HOSTILE}
    (status / "segment_cloud.json").write_text(json.dumps(record))
    out = root / "results/traits.csv", root / "results/summary.html"
    with contextlib.chdir(root):
        summarise(rows, *out)
    return root / "results"


@pytest.fixture
def page(browser, folder):
    opened = browser.new_page(viewport={"width": 1100, "height": 900})
    opened.problems = []
    opened.on("pageerror", lambda error: opened.problems.append(str(error)))
    opened.on("request", lambda asked: opened.problems.append(asked.url))
    opened.goto((folder / "summary.html").as_uri())
    yield opened
    opened.close()


def shown(page):
    script = "rows => rows.filter(row => !row.hidden).map(row => row.cells[0].innerText.trim())"
    return page.eval_on_selector_all("#trees tbody tr", script)


def chart(page, title):
    return page.locator("#strips svg, #scatters svg, #costs svg").filter(has_text=title).first


def test_one_file_without_faults_and_nothing_foreign_runs(page, folder):
    assert page.problems == [(folder / "summary.html").as_uri()]
    assert page.title() == "CherryPicker: batch summary"
    assert page.locator("img[src=x]").count() == 0
    assert HOSTILE in page.locator("#trees").inner_text()


def test_failures_come_first_and_a_head_sorts(page):
    assert shown(page)[0] == "tree09"
    page.get_by_role("button", name="Height").click()
    assert shown(page)[0] == "tree00"
    assert shown(page)[-1] == "tree09"  # without a number
    page.get_by_role("button", name="Height").click()
    assert shown(page)[:2] == ["tree05", "tree15"]
    assert shown(page)[-1] == "tree09"


def test_trees_are_sorted_by_what_has_to_be_done(page):
    as_run = shown(page)
    for words, first in {
        "most over a target": ["tree03", "tree02", "tree01", "tree00"],
        "most cuts": ["tree00", "tree01", "tree02", "tree03"],
        "most shoots": ["tree03", "tree02", "tree01", "tree00"],
        "darkest": ["tree03", "tree02", "tree01", "tree00"],
        "least sure by the photos": ["tree00", "tree01"],
    }.items():
        page.select_option("#order", label=words)
        assert shown(page)[: len(first)] == first, words
        assert "tree09" in shown(page)[4:]  # failed, of which nothing is known
    page.select_option("#order", label="as run")
    assert shown(page) == as_run
    cells = page.locator("#trees tbody tr", has_text="tree02").locator("td").all_inner_texts()
    assert cells[3:7] == ["7", "Limb-to-trunk ratio: 1.10, at most 1", "32", "50 %"]
    least = page.locator("#trees tbody tr", has_text="tree01").locator("td").all_inner_texts()
    assert least[4] == "none"  # 0.9 of at most 1


def test_the_filter_holds_for_table_and_charts(page):
    assert chart(page, "Height").locator("circle").count() == 15
    page.fill("#filter", "height>2.1 tips<52 pair")
    page.wait_for_function("document.getElementById('count').textContent.startsWith('6 ')")
    assert shown(page) == ["tree05", "tree06", "tree07", "tree08", "tree10", "tree11"]
    assert chart(page, "Height").locator("circle").count() == 6
    page.fill("#filter", "gaps_bridged")
    page.wait_for_function("document.getElementById('count').textContent.startsWith('1 ')")
    assert shown(page) == ["tree03"]
    page.fill("#filter", "")
    page.select_option("#series", "pair2")
    assert shown(page) == ["tree04", "tree05"]


def test_a_column_that_does_not_fit_is_reached_and_the_name_stays(page):
    box = page.locator(".trees")
    assert box.evaluate("box => box.scrollWidth > box.clientWidth")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    box.evaluate("box => box.scrollLeft = box.scrollWidth")
    edge = box.bounding_box()
    last = page.locator("#trees thead th").last.bounding_box()
    assert last["x"] + last["width"] <= edge["x"] + edge["width"] + 1
    first = page.locator("#trees tbody th").first.bounding_box()
    assert first["x"] == pytest.approx(edge["x"], abs=2)
    page.click("#columns summary")
    page.get_by_role("checkbox", name="Tips").uncheck()
    assert page.locator("#trees thead th:visible").filter(has_text="Tips").count() == 0


def test_a_click_on_a_point_opens_the_tree(page):
    link = chart(page, "Height").locator("a").filter(has=page.locator("circle.apart"))
    assert link.get_attribute("href") == "tree05/report.html"
    link.locator("circle").hover()
    assert "tree05\n9 ± 0.01 m" in page.locator("#tip").inner_text()
    assert page.locator("#trees tr.hot th").inner_text() == "tree05"
    link.locator("circle").click()
    assert page.title() == "tree05"


def test_charts_by_series_and_date_pairs_and_costs(page):
    page.check("input[name=by][value=date]")
    height = chart(page, "Height")
    points = height.locator("polyline.run").evaluate_all(
        "lines => lines.map(line => line.points.length)"
    )
    assert points == [2] * 6  # of the eight pairs two have one scan with numbers
    assert "2026-01-01" in height.text_content()
    page.check("input[name=by][value=series]")
    assert chart(page, "Height").locator("line.median").count() == 9
    assert page.locator("#scatters circle").count() == 30
    assert page.locator("#scatters line.fit").count() == 2
    assert chart(page, "Time of a job").locator("circle").count() == 16


def test_print_shows_the_whole_table_on_white(page):
    page.emulate_media(media="print", color_scheme="dark")
    box = page.locator(".trees")
    assert box.evaluate("box => getComputedStyle(box).overflow") == "visible"
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert not page.locator("#filter").is_visible()
    page.emulate_media(media="screen", color_scheme="dark")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
