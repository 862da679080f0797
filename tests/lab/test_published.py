"""The tables of the pages are those of docs/figures.json."""

import copy

import pytest

from cherrypicker.errors import StageError
from cherrypicker.files import read_json
from cherrypicker_lab.published import FIGURES, PAGES, render


@pytest.fixture(scope="module")
def figures(project):
    return read_json(project / FIGURES)


@pytest.mark.parametrize("name", PAGES)
def test_a_page_says_what_was_measured(project, figures, name):
    """Where this fails: python scripts/lab/render_figures.py."""
    page = (project / name).read_text(encoding="utf-8")
    assert "<!-- figures: " in page
    assert render(page, figures) == page


def test_another_figure_is_another_page(project, figures):
    page = (project / "README.md").read_text(encoding="utf-8")
    other = copy.deepcopy(figures)
    other["demo"]["trees"]["cherry_vase"]["scale_error"] += 0.01
    changed = [a for a, b in zip(page.splitlines(), render(page, other).splitlines()) if a != b]
    assert [line.split(" | ")[0] for line in changed] == ["| scale error"]


def test_figures_that_nobody_measured_are_an_error(figures):
    page = "<!-- figures: error_budget no_such_tree -->\n<!-- end of figures -->"
    with pytest.raises(StageError, match="no_such_tree"):
        render(page, figures)
