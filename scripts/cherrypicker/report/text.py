"""Numbers and words of the pages: units, uncertainties, and the style that the pages share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from cherrypicker.traits.table import Trait
from cherrypicker.units import unit_name

if TYPE_CHECKING:
    import jinja2


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


def page_template(name: str) -> jinja2.Template:
    """Return a page's template; all text that goes into it is escaped."""
    import jinja2  # every run of Snakemake imports this module, and few write a page

    loader = jinja2.FileSystemLoader(Path(__file__).resolve().parent)
    pages = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    return pages.get_template(name)


def with_uncertainty(value: object, error: object, trait: Trait, unit: str) -> str:
    """Return "1.234 ± 0.005 m"; a dash where there is no number.

    Parameters
    ----------
    trait : Trait
        Whose unit and decimals count; a cross-section without a scale is not in cm².
    unit : str
        ``m`` or ``arbitrary``.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return "–"
    if trait.power is None:
        return f"{value:,.{trait.decimals}f}"
    spread = error if isinstance(error, int | float) and math.isfinite(error) else 0.0
    name, decimals = unit_name(unit, trait.power), trait.decimals
    if trait.is_cm2 and unit == "m":
        name = "cm²"
    elif trait.is_cm2:
        value, spread, decimals = value / 1e4, spread / 1e4, 5
    if spread <= 0:
        return f"{value:,.{decimals}f} {name}"
    digits = max(decimals, min(decimals + 1, 1 - math.floor(math.log10(spread))))
    return f"{value:,.{digits}f} ± {spread:,.{digits}f} {name}"
