"""Nothing that stands in the data is executed by a page."""

import csv
import re

import pytest
from reliability_scene import MARKUP
from test_report import build  # noqa: F401
from test_summary import batch  # noqa: F401

from cherrypicker.batch.trees import read_trees
from cherrypicker.errors import StageError

LOADED = re.compile(r"<(img|script|iframe|object|link|svg/onload)[^>]*(onerror|src=x|alert)", re.I)


def is_inert(text):
    """Whether none of the markup that we put into the data became markup of the page."""
    return not LOADED.search(text) and "<script>alert" not in text and "javascript:" not in text


def test_an_id_cannot_hold_markup(tmp_path):
    for name in (MARKUP, "a<b", "a&b", 'a"b', "a'b", "{{7*7}}"):
        (tmp_path / "t.tsv").write_text(f"tree\tcloud\n{name}\ta.ply\n")
        with pytest.raises(StageError, match="an id has letters"):
            read_trees(tmp_path / "t.tsv")


def test_every_text_of_a_report_is_escaped(build):  # noqa: F811
    """The id, the notes and the warnings, in the page and in the data of its 3D view."""
    text = build(tree=MARKUP, series=MARKUP, date="{{7*7}} </script>")
    assert is_inert(text)
    assert text.count("</script>") == build().count("</script>")
    assert "{{7*7}}" in text, "shown as it is, not as 49"
    assert text.count("&lt;script&gt;alert(1)") >= 3


def test_every_text_of_the_batch_page_is_escaped(batch):  # noqa: F811
    batch.add_traits("good", flags=[MARKUP], unit=MARKUP, height_m=MARKUP)
    failure = {"cause": MARKUP, "file": MARKUP, "key": MARKUP, "log": MARKUP}
    batch.add_failure("bad", "estimate_scale", **failure)
    batch.add_failure("odd", MARKUP.replace("/", ""), state="running")
    batch.add_traits("spring")
    batch.add_traits("autumn")
    rows, page = batch(
        "good",
        "bad",
        "odd",
        {"tree": "spring", "date": "2026-03-01", "series": MARKUP},
        {"tree": "autumn", "date": "2026-10-01", "series": MARKUP},
        {"tree": "noted", "date": MARKUP, "series": "javascript&colon;alert(1)"},
    )
    assert is_inert(page)
    assert rows[1]["cause"] == MARKUP, "the table keeps the text as it is"


@pytest.mark.parametrize("formula", ["=1+1", "+1", "-1+2", "@SUM(A1)", "=cmd|' /C calc'!A0"])
def test_the_table_starts_no_formula(batch, formula):  # noqa: F811
    """A spreadsheet that opens traits.csv must not compute what a note says."""
    batch.add_failure("bad", "estimate_scale", cause=formula)
    rows, _ = batch({"tree": "bad", "series": formula})
    for column in ("cause", "series"):
        assert rows[0][column] == f"'{formula}"
    text = (batch.root / "traits.csv").read_text()
    assert len(list(csv.reader(text.splitlines()))) == 2


def test_numbers_below_zero_stay_numbers(batch):  # noqa: F811
    batch.add_traits("tree", height_m=-0.5)
    rows, _ = batch("tree")
    assert float(rows[0]["height_m"]) == -0.5
