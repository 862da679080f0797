"""Count the rates of bearing wood on grown trees of known years.

Writes scripts/cherrypicker/bearing/rates.yaml. Example:

    python scripts/lab/fit_bearing_rates.py --forms leader vase --seeds 1000 1001 \\
        --rates scripts/cherrypicker/bearing/rates.yaml
"""

from collections.abc import Sequence
from typing import Annotated

import yaml

import lab_path  # noqa: F401
from cherrypicker.files import write_text
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.bearing.fit import count_rates
from cherrypicker_lab.bearing.trees import year_tree


def main(
    forms: Annotated[Sequence[str], "of `YEAR_FORMS`"],
    seeds: Annotated[Sequence[int], "trees of each form"],
    rates: Annotated[str, "YAML to write"],
) -> None:
    trees = (year_tree(form, seed)[1] for form in forms for seed in seeds)
    numbers = count_rates(trees)
    text = yaml.safe_dump(numbers, sort_keys=False, default_flow_style=None, width=96)
    head = (
        f"# Counted on {len(seeds)} grown trees of each form ({', '.join(forms)}) by\n"
        "# fit_bearing_rates.py; cherrypicker.bearing.rates.Rates tells what each number is.\n"
    )
    write_text(rates, head + text)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
