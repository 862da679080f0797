"""Fit the factors of the traits' 90 % intervals to trees whose truth is known.

Reads JSONs of measure_trait_cases.py; writes the factors as scripts/cherrypicker/geometry/
interval_factors.yaml has them, with what each was fitted on, and a table of how many truths the
intervals hold, by source, also with factors that are fitted without that source. Example:

    python scripts/lab/fit_interval_factors.py --cases cases/*.json --checked foreign \\
        --factors scripts/cherrypicker/geometry/interval_factors.yaml --table table.md
"""

import logging
from collections.abc import Sequence
from typing import Annotated

import yaml

import lab_path  # noqa: F401
from cherrypicker.files import read_json, write_text
from cherrypicker.geometry.error_terms import FACTORS_FILE
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.traits.interval_fit import fit_all

logger = logging.getLogger("cherrypicker")


def main(
    cases: Annotated[Sequence[str], "cases of trees, JSON"],
    factors: Annotated[str, "YAML to write"],
    table: Annotated[str, "Markdown to write"],
    checked: Annotated[Sequence[str], "sources that are not fitted to"] = (),
) -> None:
    known = FACTORS_FILE.read_text(encoding="utf-8")
    present = yaml.safe_load(known)
    head = "".join(line for line in known.splitlines(True) if line.startswith("#"))
    # limbs' ratios bring no terms: no factor is fitted to them
    measured = [case for path in cases for case in read_json(path)["cases"] if "terms" in case]
    found, text = fit_all(measured, present, checked)
    for name, entry in found.items():
        logger.info("%s: %g, before %g", name, entry["value"], present[name]["value"])
    write_text(factors, head + yaml.safe_dump(found, sort_keys=False, width=100))
    write_text(table, text)
    logger.info("%s", text, extra={"console": True})


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
