"""Pages that are written from the code: config keys from the schema, traits and flags from tables.

`scripts/lab/render_figures.py` writes them, and a test compares both.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from cherrypicker.files import load_yaml
from cherrypicker.traits.flags import FLAGS
from cherrypicker.traits.table import BRANCH_COLUMNS, LIMB_COLUMNS, TRAITS

SCHEMA = "workflow/schemas/config.schema.yaml"
#: First line of a page that nobody writes by hand.
WRITTEN = "<!-- written by scripts/lab/render_figures.py -->"
#: Purpose to the schema's sections that serve it; "" are the keys outside sections.
PURPOSES = {
    "The batch": ("", "keep"),
    "Photos and cameras": ("photos", "sfm"),
    "The cloud": ("mvs", "sky", "align", "crop", "denoise"),
    "Scale": ("scale",),
    "Labels": ("segment",),
    "Skeleton": ("contract", "skeleton", "graph", "photo_check"),
    "Traits, light, bearing, pruning, pages": ("traits", "light", "bearing", "pruning", "report"),
}
LAB_PURPOSES = {
    "Training": ("train_sky", "train_segment"),
    "Generated trees and benchmarks": ("orchard", "benchmark"),
}
_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


def written_pages(project: Path) -> dict[str, str]:
    """Return the text of every written page by its path in the project."""
    schema = load_yaml(project / SCHEMA)
    return {
        "docs/keys.md": keys_page(schema, "Config keys", PURPOSES),
        "docs/lab/keys.md": keys_page(schema, "Laboratory: config keys", LAB_PURPOSES, up="../"),
        "docs/trait_list.md": trait_page(),
    }


def keys_page(
    schema: Mapping[str, Any], title: str, purposes: Mapping[str, tuple[str, ...]], up: str = ""
) -> str:
    """Return a page of config keys as Markdown, by what they are for.

    The schema is the config's, as JSON schema. The purposes are headings, each with the schema's
    sections below it, "" for the keys outside sections; `up` leads from the page to the folder
    ``docs``.
    """
    lines = [
        WRITTEN,
        "",
        f"# {title}",
        "",
        f"From [the schema](../{up}{SCHEMA}), which refuses any other key. *Read by* names the "
        "stages that a change reruns.",
    ]
    for purpose, sections in purposes.items():
        lines += ["", f"## {purpose}"]
        for name in sections:
            section = schema["properties"][name] if name else {"properties": _loose_keys(schema)}
            said = " ".join(section.get("description", "").split())
            lines += ["", f"### `{name}`"] if name else []
            lines += ["", said] if said else []
            lines += ["", "| key | default | what |", "|---|---|---|"]
            lines += _key_rows(section, section.get("stages", []), f"{name}." if name else "", up)
    return "\n".join(lines) + "\n"


def _loose_keys(schema: Mapping[str, Any]) -> dict[str, Any]:
    return {name: entry for name, entry in schema["properties"].items() if not _is_section(entry)}


def _is_section(entry: Mapping[str, Any]) -> bool:
    return entry.get("default") == {} and "properties" in entry


def _key_rows(section: Mapping[str, Any], stages: list[str], prefix: str, up: str) -> Iterator[str]:
    for key, entry in section["properties"].items():
        if _is_section(entry):
            yield from _key_rows(entry, entry.get("stages", stages), f"{prefix}{key}.", up)
        else:
            yield _key_row(prefix + key, entry, stages, up)


def _key_row(name: str, entry: Mapping[str, Any], stages: list[str], up: str) -> str:
    kind = entry.get("type", "")
    kind = " or ".join(kind) if isinstance(kind, list) else kind
    bounds = [f"{sign} {entry[word]}" for word, sign in _BOUNDS.items() if word in entry]
    allowed = ", ".join(
        f"`{each}`" for each in entry.get("enum", []) if each is not None
    ) or ", ".join(bounds)
    what = " ".join(entry.get("description", "").split()).replace("|", "\\|")
    what += f" *{kind.capitalize()}*{': ' if allowed else ''}{allowed}."
    if "paper" in entry:
        what += f" [Under `method: paper`]({up}paper.md#keys) `{entry['paper']}`."
    if read_by := ", ".join(f"`{stage}`" for stage in entry.get("stages", stages)):
        what += f" Read by {read_by}."
    default = yaml.safe_dump(entry.get("default"), default_flow_style=True, width=10**6)
    default = default.removesuffix("\n").removesuffix("\n...").strip()
    return f"| `{name}` | `{default}` | {what} |"


def trait_page() -> str:
    """Return the page of every trait, column and flag as Markdown."""
    lines = [
        WRITTEN,
        "",
        "# Every trait and flag",
        "",
        "From [the table of traits](../scripts/cherrypicker/traits/table.py), in `traits.json` and "
        "`traits.csv`; [Traits](traits.md) says how sure they are. A unit of 1 is a count or a "
        "share.",
        "",
        "| name | title | unit | error | definition |",
        "|---|---|---|---|---|",
    ]
    for trait in TRAITS.values():
        error = "yes" if trait.has_error else ""
        what = trait.definition.replace("|", "\\|")
        lines.append(f"| `{trait.name}` | {trait.title} | {trait.unit} | {error} | {what} |")
    for file, columns in (("branches.csv", BRANCH_COLUMNS), ("limbs.csv", LIMB_COLUMNS)):
        shown = ", ".join(
            f"`{column.name}` ({column.title})" for column in columns.values() if column.title
        )
        lines += ["", f"The tree's page shows of `{file}`: {shown}."]
    lines += [
        "",
        "## Flags",
        "",
        "From [the table of flags](../scripts/cherrypicker/traits/flags.py). They stand in "
        "`traits.json`, on the tree's page and in the batch's table.",
        "",
        "| flag | what it says | what helps |",
        "|---|---|---|",
    ]
    for flag in FLAGS.values():
        said = re.sub(r"\{[^{}]*\}", "…", flag.sentence).replace("|", "\\|")
        lines.append(f"| `{flag.name}` | {said} | {flag.advice} |")
    return "\n".join(lines) + "\n"
