"""Numbers and words of the pages: units, uncertainties, and the style that the pages share."""

from __future__ import annotations

import math

from cherrypicker.units import unit_name

__all__ = ["STYLE", "TRAIT_ROWS", "with_unit", "with_uncertainty"]

# Trait, its name on the pages, power of the length unit (None: a count), decimals in metric units.
TRAIT_ROWS = (
    ("height_m", "Height", 1, 3),
    ("trunk_diameter_m", "Trunk diameter", 1, 4),
    ("trunk_height_m", "Height of that diameter", 1, 2),
    ("tcsa_cm2", "Trunk cross-section area", 2, 1),
    ("crown_width_m", "Crown width", 1, 3),
    ("crown_volume_m3", "Crown volume", 3, 3),
    ("total_length_m", "Total length of wood", 1, 2),
    ("n_junctions", "Junctions", None, 0),
    ("n_tips", "Tips", None, 0),
)

STYLE = """
:root { --ink: #20242a; --soft: #68707c; --line: #d9dde3; --back: #fbfbf9; --warn: #8a4b00;
  --warn-back: #fff4e0; --bad: #9c1c1c; --bad-back: #fdeaea; --good: #22662e; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1180px; padding: 24px 20px 60px; background: var(--back);
  color: var(--ink); font: 15px/1.5 system-ui, "Segoe UI", Roboto, sans-serif; }
h1 { font-size: 26px; margin: 0 0 2px; } h2 { font-size: 19px; margin: 34px 0 10px; }
h3 { font-size: 15px; margin: 18px 0 6px; }
p.lead, .soft, figcaption { color: var(--soft); }
p.lead { margin: 0 0 18px; }
a { color: #1d5fa8; }
table { border-collapse: collapse; background: #fff; font-variant-numeric: tabular-nums; }
th, td { border: 1px solid var(--line); padding: 4px 10px; text-align: left; vertical-align: top; }
th { background: #f1f2f0; font-weight: 600; } td.n { text-align: right; white-space: nowrap; }
.scroll { overflow-x: auto; max-width: 100%; }
.tall { max-height: 420px; overflow: auto; }
ul.flags { list-style: none; margin: 0 0 18px; padding: 0; }
ul.flags li { background: var(--warn-back); border-left: 4px solid #e09a2b; color: var(--warn);
  margin: 4px 0; padding: 6px 12px; overflow-wrap: anywhere; }
p.fine { color: var(--good); }
.failed, .interrupted { color: var(--bad); font-weight: 600; } .done { color: var(--good); }
tr.bad td { background: var(--bad-back); }
figure { margin: 0 0 18px; }
figure img { max-width: 100%; max-height: 1100px; border: 1px solid var(--line); }
.figures { display: grid; gap: 16px; grid-template-columns: repeat(auto-fit, minmax(340px, 1fr)); }
.figures figure.wide { grid-column: 1 / -1; }
code { background: #f0f1ee; padding: 0 4px; overflow-wrap: anywhere; }
"""


def with_unit(name: str, value: object, unit: str) -> str:
    """Return a trait's value with its unit; a cross-section without a scale is not in cm²."""
    row = next((row for row in TRAIT_ROWS if row[0] == name), (name, name, 1, 3))
    return with_uncertainty(value, None, row[2], row[3], unit, is_cm2=name.endswith("_cm2"))


def with_uncertainty(value, error, power, decimals, unit, *, is_cm2=False) -> str:
    """Return "1.234 ± 0.005 m"; a dash where there is no number.

    Parameters
    ----------
    value, error : float or None
    power : int or None
        Power of the length unit, None for a count.
    decimals : int
        Decimals to show at least; a small error adds some.
    unit : str
        ``m`` or ``arbitrary``.
    is_cm2 : bool, default False
        The value is in square centimetres where there is a scale, else in 1e-4 square units.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return "–"
    if power is None:
        return f"{value:,.0f}"
    name = unit_name(unit, power)
    if is_cm2 and unit == "m":
        name = "cm²"
    elif is_cm2:
        value, error, decimals = value / 1e4, None if error is None else error / 1e4, 5
    text = f"{value:,.{decimals}f}"
    if isinstance(error, int | float) and math.isfinite(error) and error > 0:
        digits = max(decimals, min(decimals + 1, 1 - math.floor(math.log10(error))))
        text = f"{value:,.{digits}f} ± {error:,.{digits}f}"
    return f"{text} {name}"
