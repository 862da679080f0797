"""Units of length: metres, or arbitrary where a scan has no scale."""

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048}
"""Metres per unit of a cloud's coordinates, by the unit's name in ``trees.tsv``."""

#: Of a scan without a scale, in arbitrary units: how far its cameras stand from what they look at,
#: or how high a ready cloud is; as of three scans with a scale (3.0 to 3.2 m), so that lengths in
#: metres make sense
NORMAL_SIZE = 3.0

# Ending of a number's name to its unit in a scan with a scale, as tables spell it and as pages do,
# and the power of the length unit in it; the first that fits counts
_ENDINGS: dict[str, tuple[str, str, int | None]] = {
    "_m3_ha": ("m3/ha", "m³/ha", 1),
    "_mm_per_m": ("mm/m", "1/1000", 0),
    "_per_m": ("1/m", "1/m", -1),
    "_cm2": ("cm2", "cm²", 2),
    "_m2": ("m2", "m²", 2),
    "_m3": ("m3", "m³", 3),
    "_m": ("m", "m", 1),
    "_deg": ("deg", "°", None),
    "_ratio": ("1", "", 0),
}


def unit_ending(name: str) -> str:
    """Return the end of a number's name that tells its unit; empty where none does."""
    return next((end for end in _ENDINGS if name.endswith(end)), "")


def unit_of(name: str) -> tuple[str, int | None]:
    """Return the unit of a number by its name, as tables spell it, and its power of the length.

    "1" without a unit; None where the number is no power of the length, as a count or a share.
    """
    spelling, _, power = _ENDINGS.get(unit_ending(name), ("1", "", None))
    return spelling, power


def unit_word(name: str, unit: str = "m") -> str:
    """Return the unit of a number by its name, as pages spell it: "cm²", or "units²" unscaled."""
    _, word, power = _ENDINGS.get(unit_ending(name), ("1", "", None))
    return unit_name(unit, power) if unit != "m" and power else word


def unit_name(unit: str, power: int = 1) -> str:
    """Return the word for a length unit to a power: "m", "m²", "1/m", ""; "units", "units²"."""
    base = "m" if unit == "m" else "units"
    if power < 1:
        return f"1/{base}" if power else ""
    return base + {1: "", 2: "²", 3: "³"}[power]
