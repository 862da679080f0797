"""Numbers and words of the pages: units and uncertainties, and the templates that they fill."""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cherrypicker.files import is_number
from cherrypicker.traits.table import TRAITS, BranchColumn, Trait
from cherrypicker.units import unit_ending, unit_word

if TYPE_CHECKING:
    import jinja2


_THUMBNAIL_PX = (120, 120)  # some 3 kB a tree


def page_template(name: str) -> jinja2.Template:
    """Return a page's template; all text that goes into it is escaped."""
    import jinja2  # every run of Snakemake imports this module, and few write a page

    class Missing(jinja2.StrictUndefined):
        """What a template asks in vain; of a file's record, that tells key and file itself."""

        __slots__ = ()

        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            if isinstance(self._undefined_obj, dict):
                self._undefined_obj[self._undefined_name]

    loader = jinja2.FileSystemLoader(Path(__file__).resolve().parent)
    pages = jinja2.Environment(loader=loader, autoescape=True, undefined=Missing)
    for function in (column_head, column_cell, told, with_uncertainty):
        pages.globals[function.__name__] = function
    return pages.get_template(name)


def script_json(content: dict) -> str:
    """Return JSON that cannot end the script element that it stands in."""
    return json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")


def data_url(kind: str, content: bytes) -> str:
    """Return the address of a file that the page itself holds, by its media type."""
    return f"data:{kind};base64," + base64.b64encode(content).decode("ascii")


def thumbnail_url(path: Path) -> str:
    """Return a picture as a small data URL; empty where there is none to be read."""
    from PIL import Image  # as above

    try:
        with Image.open(path) as picture:
            picture.thumbnail(_THUMBNAIL_PX, Image.Resampling.BOX, reducing_gap=1.0)
            stream = io.BytesIO()
            picture.convert("RGB").quantize().save(stream, "PNG")
    except OSError:
        return ""
    return data_url("image/png", stream.getvalue())


def tell(text: str, record: Mapping[str, Any]) -> str:
    """Return a format string filled from a record; empty where the record lacks a part of it.

    A None inside of a part counts as lacking where the string says how to format it.
    """
    known = {name: value for name, value in record.items() if value is not None}
    try:
        return text.format_map(known)
    except (KeyError, TypeError, ValueError):
        return ""


def tell_all(facts: Mapping[str, str], record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return names and texts of what a record has of some facts, formats by their names."""
    told = [(name, tell(text, record)) for name, text in facts.items()]
    return [(name, text) for name, text in told if text]


def with_uncertainty(value: object, error: object, trait: Trait, unit: str) -> str:
    """Return "1.234 ± 0.005 m"; a dash where there is no number.

    The trait's unit and decimals count; a cross-section without a scale is not in cm². The unit is
    ``m`` or ``arbitrary``.
    """
    if not is_number(value):
        return "–"
    spread = error if is_number(error) else 0.0
    if trait.power is None:
        told = f" ± {spread:,.{trait.decimals}f}" if round(spread, trait.decimals) > 0 else ""
        return f"{value:,.{trait.decimals}f}{told}"
    name, decimals = unit_word(trait.name, unit), trait.decimals
    if trait.unit == "cm2" and unit != "m":
        value, spread, decimals = value / 1e4, spread / 1e4, 5
    if spread <= 0:
        return f"{value:,.{decimals}f} {name}".rstrip()
    digits = max(decimals, min(decimals + 1, 1 - math.floor(math.log10(spread))))
    return f"{value:,.{digits}f} ± {spread:,.{digits}f} {name}".rstrip()


def told(traits: Mapping[str, Any], name: str, unit: str) -> str:
    """Return a trait of ``traits.json`` with its standard error where it has one."""
    return with_uncertainty(traits.get(name), traits.get(f"{name}_se"), TRAITS[name], unit)


def column_head(column: BranchColumn, unit: str) -> str:
    """The head of a column of a table of axes, with its unit; what is told a cm² has its own."""
    name = column.name.removesuffix("_per_cm2")
    end, word = unit_ending(name), unit_word(name, unit)
    if end == "_cm2" and unit != "m":
        word = f"1e-4 {word}"
    title = column.title or column.name.removesuffix(end).replace("_", " ")
    return f"{title} [{word}]" if end else title


def column_cell(column: BranchColumn, row: dict) -> str:
    """The text of a row's cell; a dash where there is no such number."""
    value = row[column.name]
    if column.kind == "text":
        return ", ".join(value.split()).replace("_", " ")
    if value is None or (column.name == "parent_id" and value < 0):
        return "–"
    if column.kind == "whole":
        return str(value)
    return f"{value:.{column.decimals if column.title else min(column.decimals_in_file, 6)}f}"
