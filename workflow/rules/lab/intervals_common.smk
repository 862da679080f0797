# Trees that the factors of the traits' intervals are fitted to.

import csv

INTERVALS = SETTINGS["benchmark"]["intervals"]


def read_interval_scans(path):
    """Rows of the table of scans by their number, none without a table."""
    if not path:
        return {}
    with open(path, newline="", encoding="utf-8") as handle:
        return {
            str(number): row
            for number, row in enumerate(csv.DictReader(handle, delimiter="\t"))
        }


INTERVAL_SCANS = read_interval_scans(INTERVALS["scans"])


def of_scan(column, file=""):
    """A function of a rule's wildcards: the cell of its scan, or a file in the folder it names."""

    def cell(wildcards):
        text = INTERVAL_SCANS.get(wildcards.tree_seed, {}).get(column, "")
        return f"{text}/{file}" if file else text

    return cell


def interval_cases():
    """Files of cases of all grown trees and scans."""
    numbers = {
        "thin": seeds_of(INTERVALS, n="n_thin"),
        "bearing": seeds_of(INTERVALS, "first_bearing_seed", "n_bearing"),
        "conifer": range(INTERVALS["n_conifers"]),
        "scans": INTERVAL_SCANS,
    }
    return [
        f"results/benchmark/traits/{source}/{number}.json"
        for source, own in numbers.items()
        for number in own
    ]
