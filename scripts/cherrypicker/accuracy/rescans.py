"""Two scans of one tree on one day: every trait, and every branch that both show, in pairs."""

import math
from collections.abc import Mapping
from itertools import chain
from pathlib import Path

from cherrypicker.accuracy.quantities import QUANTITIES, Quantity
from cherrypicker.accuracy.repeatability import Pair
from cherrypicker.errors import StageError
from cherrypicker.files import is_number, read_json
from cherrypicker.series.compare import compare_scans
from cherrypicker.series.scan_files import read_scan
from cherrypicker.traits.table import ends_of

#: What is compared, in the pages' order.
REPEATED = [quantity for quantity in QUANTITIES.values() if not quantity.at_place]


def pairs_of(first: Path, second: Path) -> dict[str, list[Pair]]:
    """Pair what two scans of one tree tell, by the folders ``results/TREE`` of either.

    The pairs go by the names of `REPEATED`; a quantity that either scan lacks is left out. Branches
    are those that `cherrypicker.series.compare` finds in both. A `StageError` where a file is
    missing, a scan has no scale, or the two are not of one tree.
    """
    if first.resolve() == second.resolve():
        raise StageError("a scan agrees with itself; give two scans of the tree", file=first)
    scans = [read_scan(folder, folder.name, date) for folder, date in ((first, "1"), (second, "2"))]
    match = compare_scans(scans).steps[0].match
    traits = [read_json(folder / "traits.json") for folder in (first, second)]
    rows = [scan.branches for scan in scans]
    whole = [(first.name, *traits)]
    found = {}
    for quantity in REPEATED:
        branches = [
            (f"{first.name}, branch {here}", rows[0][here], rows[1][there])
            for here, there in match.axes.items()
            if here or not quantity.column.startswith("insertion")  # the trunk has none
        ]
        pairs = [_pair(quantity, *each) for each in (branches if quantity.column else whole)]
        found[quantity.name] = [pair for pair in pairs if pair is not None]
    return {name: pairs for name, pairs in found.items() if pairs}


def _pair(quantity: Quantity, what: str, first: Mapping, second: Mapping) -> Pair | None:
    name = quantity.column or quantity.name
    if not (is_number(first.get(name)) and is_number(second.get(name))):
        return None
    # The 90 % intervals of a trait or of a branch's column
    ends = [
        scan.get(f"{name}_ci90") or [scan.get(end) for end in ends_of(name)]
        for scan in (first, second)
    ]
    is_known = all(map(is_number, chain(*ends)))
    half = math.hypot(*((high - low) / 2 for low, high in ends)) if is_known else None
    return Pair(what, float(first[name]), float(second[name]), half)
