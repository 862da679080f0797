"""The batch's tables for other programs, and the dictionary that says what their columns are.

``traits.csv``, ``accuracy.csv`` and ``measures.csv`` are described in ``datapackage.json`` as a
Tabular Data Package (https://specs.frictionlessdata.io/tabular-data-package/).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import cherrypicker
from cherrypicker.accuracy.agreement import PUBLISHED, agreement, by_trait
from cherrypicker.accuracy.quantities import QUANTITIES
from cherrypicker.files import csv_text, is_number, load_yaml
from cherrypicker.report.summary_page import TreeResult
from cherrypicker.traits.table import TRAITS, Trait

_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")

Field = dict[str, str]  # a field of a Table Schema


def _of_trait(trait: Trait) -> Iterator[Field]:
    """The column of a trait, and those of its error where it has one."""
    kind = "integer" if trait.is_count else "number"
    field = {"name": trait.name, "type": kind, "title": trait.title, "unit": trait.unit}
    yield field | {"description": trait.definition}
    for ending, title in _TABLES["errors"].items() if trait.has_error else ():
        named = {"name": f"{trait.name}_{ending}", "title": f"{trait.title}, {title}"}
        yield field | {"type": "number"} | named


_TABLES = load_yaml(Path(__file__).with_name("tables.yaml"))
MEASURE_COLUMNS, ACCURACY_COLUMNS = _TABLES["measures"], _TABLES["accuracy"]
_FIELDS = [*_TABLES["tree"], *(field for each in TRAITS.values() for field in _of_trait(each))]
_BY_NAME: dict[str, Field] = {field["name"]: field for field in _FIELDS}
#: Of ``traits.csv``. Programs may count on the order: a new column comes last.
TRAIT_COLUMNS = [_BY_NAME[name] for name in dict.fromkeys([*_TABLES["order"], *_BY_NAME])]


def trait_row(result: TreeResult) -> dict:
    """Return a tree's row of ``traits.csv``."""
    row = {name: getattr(result, name) for name in ("tree", "status", "date", "series", "unit")}
    row |= {"failed_stage": result.stage, "cause": result.cause, "change": result.key}
    for trait in TRAITS.values():
        if trait.has_error:
            ends = result.traits.get(f"{trait.name}_ci90") or (None, None)
            row |= {f"{trait.name}_ci90_low": ends[0], f"{trait.name}_ci90_high": ends[1]}
    return result.traits | row | {"flags": "; ".join(result.flags)}


def accuracy_rows(pairs: Sequence[dict]) -> list[dict]:
    """Return how well each measured trait agrees, then the published rows of these traits."""
    found = by_trait(pairs)
    rows = [
        {"trait": name, "source": "this batch", "measured_on": ""} | asdict(agreement(of_trait))
        for name, of_trait in found.items()
    ]
    rows += [asdict(item) for item in PUBLISHED if item.trait in found]
    return [row | {"unit": QUANTITIES[row["trait"]].unit} for row in rows]


def table_csv(columns: Sequence[Field], rows: Iterable[Mapping]) -> str:
    """Return a table as CSV with a header."""
    cells = ({each["name"]: _cell(each, row) for each in columns} for row in rows)
    return csv_text(cells, [each["name"] for each in columns])


def _cell(column: Field, row: Mapping) -> str:
    value = row.get(column["name"])
    if column["type"] in ("integer", "number"):
        if not is_number(value):
            return ""
        return str(value) if isinstance(value, int) else f"{value:.6g}"
    text = "; ".join(value) if isinstance(value, list) else str(value)
    is_inert = column["name"] == "tree" or not text.startswith(_FORMULA_STARTS)
    return text if is_inert else f"'{text}"  # no spreadsheet takes it for a formula


def data_package(tables: Mapping[str, Sequence[Field]]) -> dict:
    """Return the content of ``datapackage.json`` for columns by the CSV file beside it."""
    resources = []
    for name, columns in tables.items():
        schema = {"fields": columns} | ({"primaryKey": "tree"} if columns is TRAIT_COLUMNS else {})
        named = {"name": name.removesuffix(".csv"), "path": name}
        resources.append(named | _TABLES["resource"] | {"schema": schema})
    return _TABLES["package"] | {"version": cherrypicker.__version__, "resources": resources}
