"""The fitted factors of the traits' intervals, read once from ``interval_factors.yaml``."""

from __future__ import annotations

from pathlib import Path

import yaml

FACTORS_FILE = Path(__file__).with_suffix(".yaml")
#: Name to value; what each multiplies and was fitted on stands in the file.
FACTORS: dict[str, float] = {
    name: entry["value"]
    for name, entry in yaml.safe_load(FACTORS_FILE.read_text(encoding="utf-8")).items()
}
