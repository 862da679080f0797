"""The pages name what there is: keys, commands, scripts, one version."""

import os
import re
import tomllib

import pytest
import yaml

import cherrypicker
from cherrypicker.accuracy.measures import COLUMNS as MEASURES_COLUMNS
from cherrypicker.batch.trees import COLUMNS as TREES_COLUMNS
from cherrypicker.files import load_yaml
from cherrypicker.formats.table import FORMATS
from cherrypicker.markers.references import KINDS
from cherrypicker_lab.written_pages import WRITTEN

# Written from others, or told of the past
NOT_READ = {"CHANGELOG.md"}


@pytest.fixture(scope="module")
def pages(project):
    """Text of every page that people write, by its name."""
    found = [*project.glob("*.md"), *project.glob(".github/*.md")]
    found += [
        path for room in ("docs", "config", "resources") for path in project.glob(f"{room}/**/*.md")
    ]
    names = {path.relative_to(project).as_posix() for path in found} - NOT_READ
    texts = {name: (project / name).read_text(encoding="utf-8") for name in names}
    return {name: text for name, text in texts.items() if not text.startswith(WRITTEN)}


# By hand: on the pages of docs/lab, and on all others
MOST_WORDS_IN_LABORATORY = 5475
MOST_WORDS = 19936

# Sections whose tables describe and are not measured
DESCRIBED = {
    "docs/api.md: Coming from pc-skeletor",
    "docs/command.md: `export`",
    "docs/paper.md: Equations",
    "docs/paper.md: Parameters",
    "docs/photographing.md: How far away",
    "docs/scale.md: What can be known",
    "resources/demo/README.md: The demo orchard",
}


def undated_tables(pages):
    """Sections with two rows of decimals and more, and no date in them or in one around them."""
    for page, text in pages.items():
        around = []  # level, whether there is a date; the page's title does not count for others
        for title, body in re.findall(
            r"^(#+ .*)\n((?:(?!#+ ).*\n?)*)", re.sub(r"(?ms)^```.*?^```", "", text), re.M
        ):
            level = len(title) - len(title.lstrip("#"))
            dated = bool(re.search(r"\d{4}-\d\d-\d\d", body))
            around = [each for each in around if each[0] < level]
            if len(re.findall(r"^\|.*\d\.\d", body, re.M)) > 1 and not (
                dated or any(known for outer, known in around if outer > 1)
            ):
                yield f"{page}: {title.lstrip('# ')}"
            around.append((level, dated))


def test_every_measured_table_says_when(pages):
    assert set(undated_tables(pages)) == DESCRIBED


def torn_tables(pages):
    """Rows of tables that do not hang on a head and its rule."""
    for page, text in pages.items():
        plain = re.sub(r"(?ms)^```.*?^```", "", text)
        for block in re.findall(r"(?:^[ ]*\|.*\n?)+", plain, re.M):
            rows = block.splitlines()
            if len(rows) < 3 or not re.fullmatch(r"[ ]*\|([ ]?:?-+:?[ ]?\|)+", rows[1]):
                yield f"{page}: {rows[0]}"


def test_no_table_is_torn(pages):
    """A line amid a table ends it, and what follows is no table any more."""
    assert list(torn_tables(pages)) == []


def test_a_torn_table_is_found():
    page = "| a | b |\n|---|---|\n| c | 0.1 |\n\nMeasured.\n| d | 0.2 |\n"
    assert list(torn_tables({"a.md": page})) == ["a.md: | d | 0.2 |"]


def test_a_table_without_a_date_is_found():
    page = "# Page, 2026-11-23\n\n## Old\n\n| a | 0.1 |\n| b | 0.2 |\n"
    dated = page.replace("## Old\n", "## Old\n\nMeasured 2026-11-22.\n\n### Part\n")
    assert list(undated_tables({"a.md": page, "b.md": dated})) == ["a.md: Old"]


def test_every_config_key_that_a_page_names_exists(project, pages):
    schema = load_yaml(project / "workflow/schemas/config.schema.yaml")
    keys = {
        name: set(entry.get("properties", {}))
        for name, entry in schema["properties"].items()
        if entry.get("default") == {}
    }
    named = {
        (page, section, key)
        for page, text in pages.items()
        for section, key in re.findall(r"`([a-z_]+)\.([a-z]\w+)`", text)
        if section in keys
    }
    files = (
        *("csv", "graphml", "html", "json", "md", "npy", "npz", "ply", "png", "py", "swc", "yaml"),
    )
    missing = [each for each in named if each[2] not in keys[each[1]] and each[2] not in files]
    assert len(named) > 60
    assert missing == []


def slug(heading):
    """The anchor that GitHub and the site give a heading."""
    words = re.sub(r"[^\w\- ]", "", re.sub(r"\[(.*?)\]\(.*?\)", r"\1", heading).lower())
    return words.replace(" ", "-")


def broken_links(project, pages):
    """Links to files that are not there, and to headings that the page does not have."""
    plain = {name: re.sub(r"(?ms)^```.*?^```", "", text) for name, text in pages.items()}

    def headings(name):
        text = plain[name] if name in plain else (project / name).read_text(encoding="utf-8")
        return {slug(heading) for heading in re.findall(r"^#+ (.*)$", text, re.M)}

    for page, text in plain.items():
        for path, anchor in re.findall(r"\]\((?![a-z]+:)([^)#\s]*)#?([^)\s]*)\)", text):
            found = project / page if not path else (project / page).parent / path
            name = os.path.relpath(found, project)
            if not found.exists() or (anchor and anchor not in headings(name)):
                yield f"{page}: {path}#{anchor}"


def test_no_link_is_broken(project, pages):
    changes = {name: (project / name).read_text(encoding="utf-8") for name in NOT_READ}
    assert list(broken_links(project, pages | changes)) == []


@pytest.mark.parametrize(
    ("page", "section", "names"),
    [
        ("config/README.md", "Columns of `trees.tsv`", TREES_COLUMNS),
        ("docs/batch.md", "Hand measurements", MEASURES_COLUMNS),
        ("docs/command.md", "`export`", FORMATS),
        ("docs/scale.md", "What can be known", KINDS),
    ],
)
def test_every_column_format_and_known_length_has_a_row(pages, page, section, names):
    body = pages[page].split(f"## {section}\n")[1].split("\n## ")[0]
    cells = " ".join(re.findall(r"^\| (`.*?) \|", body, re.M))
    assert set(re.findall(r"`([\w-]+)`", cells)) == set(names)


def words_by_hand(text):
    """How many words of a page people wrote: those with a letter or a digit, no rendered table."""
    plain = re.sub(r"(?s)<!-- figures: .*?<!-- end of figures -->", "", text)
    return sum(bool(re.search(r"\w", word)) for word in plain.split())


def test_there_are_no_more_words_than_there_were(pages):
    """Who says something new says something else shorter; a smaller number goes in here."""
    words = {name: words_by_hand(text) for name, text in pages.items()}
    in_laboratory = sum(each for name, each in words.items() if name.startswith("docs/lab/"))
    assert in_laboratory <= MOST_WORDS_IN_LABORATORY
    assert sum(words.values()) - in_laboratory <= MOST_WORDS


def test_every_script_and_target_that_a_page_calls_exists(project, pages):
    rules = {
        name
        for path in project.glob("workflow/rules/**/*.smk")
        for name in re.findall(r"^rule (\w+):", path.read_text(encoding="utf-8"), re.M)
    }
    called, scripts = set(), set()
    for text in pages.values():
        scripts.update(re.findall(r"python (?:PROJECT/)?(scripts/[\w/]+\.py)", text))
        called.update(re.findall(r"`snakemake (?:--[\w-]+ \w+ )?([a-z_]+)`", text))
        called.update(re.findall(r"^snakemake (?:--cores \w+ )?([a-z_]+)\b(?![/.])", text, re.M))
    assert len(called) > 8 and len(scripts) > 8
    assert called <= rules
    assert not [path for path in scripts if not (project / path).is_file()]


def test_every_file_that_readme_promises_comes_from_a_rule(project, pages):
    rules = "".join(
        path.read_text(encoding="utf-8") for path in project.glob("workflow/rules/**/*.smk")
    )
    promised = re.findall(
        r"`(?:results/)?([\w{}/]+\.(?:ply|npz|json|csv|graphml|html))`", pages["README.md"]
    )
    assert len(promised) > 20
    assert [name for name in promised if name not in rules] == []


def test_readme_names_what_is_pinned(project, pages):
    described = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))
    least, most = re.search(
        r">=(3\.\d+),<(3\.\d+)", described["project"]["requires-python"]
    ).groups()
    span = f"Python {least} to 3.{int(most.split('.')[1]) - 1}"
    pinned = (project / "envs/requirements.txt").read_text(encoding="utf-8")
    (version,) = re.findall(r"^pycolmap==(\S+)", pinned, re.M)
    assert span in pages["README.md"] and span in pages["docs/install.md"]
    assert f"pycolmap-cuda12=={version}" in pages["README.md"]
    profile = yaml.safe_load((project / "profiles/default/profile.yaml").read_text("utf-8"))
    assert "gpu=1" in profile["resources"]  # one rule on the GPU at a time


def test_there_is_one_version(project):
    described = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))
    cited = yaml.safe_load((project / "CITATION.cff").read_text(encoding="utf-8"))
    assert described["project"]["version"] == cherrypicker.__version__ == cited["version"]
    changes = (project / "CHANGELOG.md").read_text(encoding="utf-8")
    newest, date = re.findall(r"^## \[(\d[\d.]*)\] - (\S+)$", changes, re.M)[0]
    assert (newest, date) == (cited["version"], str(cited["date-released"]))
    images = set()
    for name in ("envs/Dockerfile", "profiles/kubernetes/profile.yaml", "docs/cluster.md"):
        text = (project / name).read_text(encoding="utf-8")
        images.update(re.findall(r"cherrypicker:(\d[\d.]*\d)", text))
    assert images == {newest.rpartition(".")[0]}


def test_every_page_stands_in_the_sites_contents(project):
    """Else `make docs`, which is strict, fails."""
    contents = (project / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:")[1]
    named = set(re.findall(r": ([\w/]+\.md)$", contents, re.M))
    docs = project / "docs"
    assert {path.relative_to(docs).as_posix() for path in docs.rglob("*.md")} <= named
