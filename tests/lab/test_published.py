"""The tables of the pages are those of docs/figures.json."""

import copy
import json
import re

import pytest

from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml, read_json
from cherrypicker_lab.published import (
    FIGURES,
    measure_peers,
    pages,
    peers_table,
    read_table,
    render,
)
from cherrypicker_lab.written_pages import SCHEMA, written_pages


@pytest.fixture(scope="module")
def figures(project):
    return read_json(project / FIGURES)


def test_a_page_says_what_was_measured(project, figures):
    """Where this fails: python scripts/lab/render_figures.py."""
    shown = pages(project)
    assert {project / "README.md", project / "docs/lab/traits.md"} < set(shown)
    for page in shown:
        text = page.read_text(encoding="utf-8")
        assert render(text, figures) == text, page


def test_a_written_page_follows_the_code(project):
    """Where this fails: python scripts/lab/render_figures.py."""
    for name, text in written_pages(project).items():
        assert (project / name).read_text(encoding="utf-8") == text


def keys_of(section, prefix=""):
    """Every key of a section of the schema that has a value of its own."""
    for key, entry in section["properties"].items():
        if entry.get("default") == {} and "properties" in entry:
            yield from keys_of(entry, f"{prefix}{key}.")
        else:
            yield prefix + key


def test_every_config_key_stands_on_one_page(project):
    schema = load_yaml(project / SCHEMA)
    pages = written_pages(project).values()
    told = [key for page in pages for key in re.findall(r"^\| `([\w.]+)` \| `", page, re.M)]
    assert sorted(told) == sorted(keys_of(schema))


def test_another_figure_is_another_page(project, figures):
    page = (project / "README.md").read_text(encoding="utf-8")
    other = copy.deepcopy(figures)
    other["demo"]["trees"]["cherry_vase"]["scale_error"] += 0.01
    changed = [a for a, b in zip(page.splitlines(), render(page, other).splitlines()) if a != b]
    assert [line.split(" | ")[0] for line in changed] == ["| scale error"]


def test_a_table_of_a_benchmark_is_taken_as_it_is():
    text = "Words.\n\n| tree | off by |\n| --- | ---: |\n| a \\| b | 0.1 % |\n| c |  |\n\nMore.\n"
    table = read_table(text)
    assert table["columns"] == ["tree", "off by"]
    assert table["rows"] == [["a \\| b", "0.1 %"], ["c", ""]]
    page = "<!-- figures: tables new -->\n<!-- end of figures -->"
    measured = {"tables": {"new": {"date": "2026-11-25", "command": "`make demo`"} | table}}
    shown = text.split("\n\n")[1] + "\n\nMeasured 2026-11-25 by `make demo`.\n"
    assert shown in render(page, measured)
    for bad in ("no table", "| a | b |\n|---|---|\n| c |\n"):
        with pytest.raises(StageError, match="table"):
            read_table(bad)


def test_figures_that_nobody_measured_are_an_error(figures):
    page = "<!-- figures: error_budget no_such_tree -->\n<!-- end of figures -->"
    with pytest.raises(StageError, match="no_such_tree"):
        render(page, figures)


def a_run(cpu_s, length_error, **more):
    graph = {"cpu_s": 1.0, "junctions": {"f1": 0.9}, "tips": {"f1": 0.8}}
    graph |= {"length_error": length_error, "ways_within_10pct": 0.99}
    return {"cpu_s": cpu_s, "peak_mb": 300.0, "graphs": {"own": graph | more, "tree": graph | more}}


@pytest.fixture
def peers(tmp_path):
    """Two trees that all programs have finished, a third on which PyTLidar fails."""
    programs = {
        "default": ("bare_default", "slbc_default"),
        "peer": ("peer_lbc", "peer_slbc"),
        "pytlidar": ("peer_pytlidar",),
    }
    for number, tree in enumerate(("fir_00", "larch_01", "pine_02")):
        for kind, names in programs.items():
            run = a_run(2.0 + 2 * number, 0.1 - 0.2 * number)
            if kind == "pytlidar":
                run = a_run(4.0, 0.02, radius={"below_4mm": 0.004, "above_12mm": -0.001})
                run["version"] = "1.1.2"
            if (number, kind) == (2, "pytlidar"):
                run = {"failed": "NaN"}
            settings = {setting: dict.fromkeys(names, run) for setting in ("noise", "holes")}
            report = {"tree": tree, "template": tree[:3], "settings": settings}
            path = tmp_path / f"{number:02d}" / f"scores_{kind}.json"
            path.parent.mkdir(exist_ok=True)
            path.write_text(json.dumps(report))
    return tmp_path


def test_peers_are_compared_on_the_trees_that_all_have_finished(peers):
    section = measure_peers(peers)
    assert list(section["trees"]) == ["fir_00", "larch_01"]
    table = peers_table(section)
    assert "Means over fir_00, larch_01." in table
    pytlidar = "| PyTLidar 1.1.2 | 5.0 | 300 | 0.90 | 0.80 | +8.0 |  | -2.0 | 2.0 % | 99 % |"
    assert pytlidar in table.splitlines()
    # CPU of contraction and graph; errors of a length do not cancel out
    assert "| ours | 4.0 | 300 | 0.90 | 0.80 |  |  |  | 10.0 % | 99 % |" in table.splitlines()


def test_a_peer_that_was_not_run_is_an_error(peers):
    for path in peers.glob("*/scores_pytlidar.json"):
        path.unlink()
    with pytest.raises(StageError, match="peer_pytlidar"):
        measure_peers(peers)
