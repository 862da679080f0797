"""What MkDocs does beyond the pages of this folder.

Files at other places of the project become pages (README, CHANGELOG, model cards), the pages of
config keys and traits are written from the schema and from the table of traits, links that lead out
of `docs/` reach copies of the files they name, and equations become MathML. A link to a file that
is not there fails the strict build.
"""

from __future__ import annotations

import html
import logging
import posixpath
import re
import sys
from pathlib import Path

import yaml
from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

PROJECT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(PROJECT / "scripts"))

from cherrypicker.traits.table import BRANCH_COLUMNS, LIMB_COLUMNS, TRAITS  # noqa: E402

logger = logging.getLogger("mkdocs.hooks")

#: Files of the project outside this folder that are pages of the site.
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    ".github/CONTRIBUTING.md": "contributing.md",
    ".github/CODE_OF_CONDUCT.md": "conduct.md",
    ".github/SECURITY.md": "security.md",
    "config/README.md": "config.md",
    "resources/demo/README.md": "demo.md",
    "resources/weights/sky_unet.md": "model_sky.md",
    "resources/weights/dgcnn.md": "model_classes.md",
}
_ORIGIN = {page: path for path, page in PAGES.items()}
_LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)\s]+)")
_FENCE = re.compile(r"(^```.*?^```\s*?$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)


def on_files(files: Files, config: dict) -> Files:
    """Add the pages from elsewhere, the written ones, and the files that links name."""
    for path, page in PAGES.items():
        text = (PROJECT / path).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=text))
    files.append(File.generated(config, "config_keys.md", content=config_keys()))
    files.append(File.generated(config, "trait_list.md", content=trait_list()))
    for page in list(files.documentation_pages()):
        for target in _targets(page.content_string, _origin(page.src_uri)):
            copy = f"source/{target}"
            is_new = files.get_file_from_path(copy) is None
            if is_new and _site_path(target) == copy and (PROJECT / target).is_file():
                files.append(File.generated(config, copy, abs_src_path=str(PROJECT / target)))
    return files


def on_page_markdown(markdown: str, page, config: dict, files: Files) -> str:
    """Turn the links of a page as it stands in the project into links of the site."""
    origin = _origin(page.file.src_uri)
    here = posixpath.dirname(page.file.src_uri)

    def replaced(match: re.Match) -> str:
        path, _, anchor = match[1].partition("#")
        target = _resolved(path, origin)
        if target is None:
            logger.warning("%s: the link %s leads out of the project", origin, match[1])
            return match[1]
        if (PROJECT / target).is_dir():
            return posixpath.relpath("architecture.md", here or ".")
        link = posixpath.relpath(_site_path(target), here or ".")
        return f"{link}#{anchor}" if anchor else link

    parts = _FENCE.split(markdown)
    return "".join(part if part.startswith("`") else _LINK.sub(replaced, part) for part in parts)


def on_page_content(content: str, page, config: dict, files: Files) -> str:
    r"""Turn \(...\) and \[...\] into MathML, which needs no script."""
    content = re.sub(
        r'<div class="arithmatex">\\\[(.*?)\\\]</div>',
        lambda match: convert(html.unescape(match[1]).strip(), display="block"),
        content,
        flags=re.DOTALL,
    )
    return re.sub(
        r'<span class="arithmatex">\\\((.*?)\\\)</span>',
        lambda match: convert(html.unescape(match[1]).strip()),
        content,
        flags=re.DOTALL,
    )


def _origin(src_uri: str) -> str:
    """Where in the project a page comes from."""
    return _ORIGIN.get(src_uri, f"docs/{src_uri}")


def _resolved(path: str, origin: str) -> str | None:
    target = posixpath.normpath(posixpath.join(posixpath.dirname(origin), path))
    return None if target.startswith("../") else target


def _site_path(target: str) -> str:
    if target in PAGES:
        return PAGES[target]
    return target.removeprefix("docs/") if target.startswith("docs/") else f"source/{target}"


def _targets(markdown: str, origin: str) -> list[str]:
    """Files of the project that a page links to."""
    text = "".join(part for part in _FENCE.split(markdown) if not part.startswith("`"))
    found = (_resolved(match[1].partition("#")[0], origin) for match in _LINK.finditer(text))
    return [target for target in found if target is not None]


def config_keys() -> str:
    """Return the page of every config key, from the schema."""
    file = PROJECT / "workflow/schemas/config.schema.yaml"
    schema = yaml.safe_load(file.read_text(encoding="utf-8"))
    lines = [
        "# Config keys",
        "",
        "Written from [the schema](../workflow/schemas/config.schema.yaml), which refuses any "
        "other key. *Read by* names the stages that a change reruns.",
        "",
        "## Top level",
        "",
        *_HEAD,
    ]
    sections = {}
    for name, entry in schema["properties"].items():
        if entry.get("default") == {} and "properties" in entry:
            sections[name] = entry
        else:
            lines.append(_key_row(name, entry, []))
    for name, section in sections.items():
        lines += ["", f"## {name}", "", section.get("description", ""), "", *_HEAD]
        lines += _key_rows(section, section.get("stages", []))
    return "\n".join(lines) + "\n"


_HEAD = ["| key | default | what |", "|---|---|---|"]


def _key_rows(section: dict, stages: list[str], prefix: str = "") -> list[str]:
    rows = []
    for key, entry in section["properties"].items():
        if entry.get("type") == "object" and "properties" in entry and entry.get("default") == {}:
            rows += _key_rows(entry, entry.get("stages", stages), f"{prefix}{key}.")
        else:
            rows.append(_key_row(prefix + key, entry, stages))
    return rows


def _key_row(name: str, entry: dict, stages: list[str]) -> str:
    kind = entry.get("type", "")
    kind = " or ".join(kind) if isinstance(kind, list) else kind
    bounds = [f"{sign} {entry[word]}" for word, sign in _BOUNDS.items() if word in entry]
    allowed = ", ".join(f"`{each}`" for each in entry.get("enum", [])) or ", ".join(bounds)
    what = " ".join(entry.get("description", "").split()).replace("|", "\\|")
    what += f" *{kind.capitalize()}*{': ' if allowed else ''}{allowed}."
    if "paper" in entry:
        what += f" [Under `method: paper`](paper.md#keys) `{entry['paper']}`."
    if read_by := ", ".join(f"`{stage}`" for stage in entry.get("stages", stages)):
        what += f" Read by {read_by}."
    default = yaml.safe_dump(entry.get("default"), default_flow_style=True, width=10**6)
    default = default.removesuffix("\n").removesuffix("\n...").strip()
    return f"| `{name}` | `{default}` | {what} |"


_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


def trait_list() -> str:
    """Return the page of every trait and column, from the table of traits."""
    lines = [
        "# Every trait",
        "",
        "Written from [the table of traits](../scripts/cherrypicker/traits/table.py); "
        "[Traits](traits.md) says how each is measured and how sure it is.",
        "",
        "## `traits.json` and `traits.csv`",
        "",
        "| name | title | unit | with a standard error | what |",
        "|---|---|---|---|---|",
    ]
    for trait in TRAITS.values():
        error = "yes" if trait.has_error else ""
        what = trait.definition.replace("|", "\\|")
        lines.append(f"| `{trait.name}` | {trait.title} | {trait.unit} | {error} | {what} |")
    for file, columns in (("branches.csv", BRANCH_COLUMNS), ("limbs.csv", LIMB_COLUMNS)):
        lines += ["", f"## `{file}`", "", "| column | on the page |", "|---|---|"]
        lines += [f"| `{column.name}` | {column.title} |" for column in columns.values()]
    return "\n".join(lines) + "\n"
