"""Units of length: metres, or arbitrary where a scan has no scale."""

from __future__ import annotations

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048}
"""Metres per unit of a cloud's coordinates, by the unit's name in ``trees.tsv``."""


def unit_name(unit: str, power: int = 1) -> str:
    """Return the word for a length unit to a power: "m", "m²", "1/m", ""; "units", "units²"."""
    base = "m" if unit == "m" else "units"
    if power < 1:
        return f"1/{base}" if power else ""
    return base + {1: "", 2: "²", 3: "³"}[power]
