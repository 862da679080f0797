"""The configuration: schema, defaults, precedence, and errors that name the key."""

import copy
import difflib
import math
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import date
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator, FormatChecker
from jsonschema.exceptions import ValidationError
from jsonschema.validators import extend

from cherrypicker.batch.old_keys import take_old_keys
from cherrypicker.errors import StageError
from cherrypicker.files import is_number, parse_yaml

CONFIG_FILE = "config/config.yaml"
# A number is finite: infinity would pass each least value, and NaN every bound
_Validator = extend(
    Draft202012Validator,
    type_checker=Draft202012Validator.TYPE_CHECKER.redefine(
        "number", lambda _, value: is_number(value)
    ),
)
_FORMATS = FormatChecker(["date"])


@_FORMATS.checks("positive number", ValueError)
def _is_positive(text: object) -> bool:
    return isinstance(text, str) and 0.0 < float(text) < math.inf


def read_config_file(
    path: str | os.PathLike = CONFIG_FILE, *, may_miss: bool = False, may_be_empty: bool = True
) -> dict:
    """Read a YAML config; an empty file, or a missing one that `may_miss`, is an empty config.

    A `StageError` where the file is missing, no YAML, no mapping, or empty against `may_be_empty`.
    """
    if may_miss and not Path(path).exists():
        return {}
    try:
        content = parse_yaml(Path(path).read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise StageError(f"the config file cannot be read ({error.strerror})", file=path) from error
    except ValueError as error:
        raise StageError(f"the config file is no valid YAML ({error})", file=path) from error
    if content is None and not may_be_empty:
        raise StageError("the config file holds nothing; {} is one without a key", file=path)
    if not isinstance(content, dict | None):
        raise StageError("the config file must hold keys and values", file=path)
    return content or {}


def resolve_config(schema: Mapping, *layers: Mapping, source: str | None = None) -> dict:
    """Merge config layers, later ones winning, fill in the defaults and validate.

    The layers are ``config.yaml``, the tree's own file and the command line; numbers and booleans
    that arrive as strings are read as such. What comes has every key of the schema with a valid
    value. An unknown key, told with the nearest valid one, or a value out of bounds is a
    `StageError` of the file ``source``.
    """
    merged, method, _ = _merged(schema, layers)
    resolved = _fill(schema, merged, method)
    refusal = first_refusal(schema, resolved)
    if refusal:
        key, reason = refusal
        is_unknown = reason.startswith("unknown")
        raise StageError(reason if is_unknown else f"{key}: {reason}", file=source, key=key)
    return resolved


def first_refusal(schema: Mapping, value: object) -> tuple[str, str] | None:
    """Return the dotted key of the first thing that a schema refuses, and why; None if nothing.

    A schema's own words are its ``refusal``, in which ``{value}`` is what was given; ``column``
    names the key of a rule that is of several.
    """
    errors = _Validator(schema, format_checker=_FORMATS).iter_errors(value)
    error = min(errors, key=_place, default=None)
    if error is None:
        return None
    own, place = error.schema, _place(error)
    assert isinstance(own, Mapping)
    if error.validator == "additionalProperties":
        unknown = next(str(name) for name in error.instance if name not in own["properties"])
        near = difflib.get_close_matches(unknown, own["properties"], n=1, cutoff=0.0)
        names = [".".join((*place, name)) for name in (unknown, *near)]
        return names[0], f"unknown config key {names[0]!r}; did you mean {names[-1]!r}?"
    reason = own.get("refusal", "").replace("{value}", repr(error.instance)) or error.message
    key = own.get("column") or ".".join(place)
    return key, reason


def _place(error: ValidationError) -> list[str]:
    return list(map(str, error.absolute_path))


def config_notes(schema: Mapping, *layers: Mapping) -> list[str]:
    """Say which keys of the layers are old, and which are set and read by nothing, a line each.

    A key is read while every key that its schema's ``needs`` names has one of the values there. The
    layers are those of a valid config.
    """
    merged, method, notes = _merged(schema, layers)
    resolved, unset = _fill(schema, merged, method), _fill(schema, {}, method)
    for section, keys in schema["properties"].items():
        for name, each in keys.get("properties", {}).items():
            if resolved[section][name] == unset[section][name]:
                continue
            for other, values in each.get("needs", {}).items():
                if (found := lookup(resolved, other)) not in values:
                    notes.append(
                        f"{section}.{name}: {merged[section][name]} does nothing: it is read under "
                        f"{other}: {' or '.join(map(str, values))}, and that is {found}"
                    )
    return notes


def _merged(schema: Mapping, layers: Sequence[Mapping]) -> tuple[dict, str, list[str]]:
    """The layers as one, with old keys renamed, and what is to be said of those.

    Between them the schema's keyword that holds the method's defaults.
    """
    from snakemake.utils import update_config

    merged: dict = {}
    for layer in layers:
        update_config(merged, layer)
    method = "paper" if merged.get("method") == "paper" else "default"
    new = schema["properties"].get("skeleton", {}).get("properties", ())
    return merged, method, take_old_keys(merged, new)


def lookup(config: Mapping, key: str) -> Any:
    """Return the value of a dotted key, ``denoise.std_ratio`` for instance."""
    return reduce(getitem, key.split("."), config)  # type: ignore[arg-type]


def _fill(schema: Mapping, value: Any, method: str) -> Any:
    """Return ``value`` with a method's defaults and strings read as the type that is asked for."""
    known, others = schema.get("properties", {}), schema.get("additionalProperties") or {}
    if isinstance(value, Mapping) or (value is None and schema.get("type") == "object"):
        given = (schema.get("default") or {}) | dict(value or {})
        missing = {
            key: copy.deepcopy(each.get(method, each["default"]))
            for key, each in known.items()
            if "default" in each and key not in given
        }
        whole = (given | missing).items()
        return {key: _fill(known.get(key, others), item, method) for key, item in whole}
    if isinstance(value, list):
        return [_fill(schema.get("items", {}), item, method) for item in value]
    types = schema.get("type", [])
    types = [types] if isinstance(types, str) else types
    is_text = "string" in types and re.search(schema.get("pattern", ""), str(value))
    if isinstance(value, str) and types and not is_text and types != ["object"]:
        with suppress(ValueError):
            parsed = parse_yaml(value)
            value = float(parsed) if isinstance(parsed, str) else parsed
    if isinstance(value, float) and value.is_integer() and "integer" in types:
        return int(value)
    if isinstance(value, date) and "string" in types:  # which YAML makes of 2026-04-01
        return value.isoformat()
    return value
