"""A batch as its files describe it: the trees, the settings of each, and hand measurements."""

import difflib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from cherrypicker.accuracy.measures import Measure, read_measures
from cherrypicker.batch.config import CONFIG_FILE, config_notes, read_config_file, resolve_config
from cherrypicker.batch.resources import asked_for
from cherrypicker.batch.rows import ALL, names_found, scans_of_several, split_name
from cherrypicker.batch.trees import Tree, read_trees
from cherrypicker.files import written_at
from cherrypicker.runner import status_folder


@dataclass(frozen=True)
class Batch:
    """What is to be run."""

    settings: dict  # the batch's config with every key
    trees: dict[str, Tree]  # rows of the table by tree, in its order
    # The config of each tree: the batch's, its own file and the command line merged
    settings_of: dict[str, dict]
    measures: list[Measure]  # taken by hand, of whichever trees
    # Scans of several trees: the places that are asked for, or "all"
    places: dict[str, str | list]
    # What is to be said of the config: old keys, and keys that nothing reads
    notes: list[str]

    def scan_of(self, tree: str) -> str:
        """Return the row of the table that a tree is from; most trees are one themselves."""
        return split_name(tree, self.places)[0]

    def has(self, tree: str) -> bool:
        """Whether a name can be one of a tree with results: a scan of several has none itself."""
        scan, number = split_name(tree, self.places)
        if self.places.get(scan) == ALL:
            return number > 0
        return scan in self.trees and tree in self.names(scan)

    def row(self, tree: str) -> Tree:
        """Return a tree's row: that of its scan, with its own name and series."""
        scan, number = split_name(tree, self.places)
        row = self.trees[scan]
        series = f"{row.series}_{number}" if row.series and number else row.series
        return replace(row, tree=tree, series=series)

    def settings_for(self, tree: str) -> dict:
        """Return a tree's config: that of its scan, less the places of the scan's trees.

        Of what is no tree, that of the batch.
        """
        scan, number = split_name(tree, self.places)
        settings = self.settings_of.get(scan, self.settings)
        place = {"crop": settings["crop"] | {"target_xy": None}} if number else {}
        return settings | place

    def names(self, scan: str) -> list[str]:
        """Return the trees of a row as far as they are known."""
        places = self.places.get(scan)
        if places is None:
            return [scan]
        if places == ALL:
            return names_found(scan)
        return [f"{scan}_{number}" for number in range(1, len(places) + 1)]

    @property
    def open_scans(self) -> list[str]:
        """Scans whose trees are known when somebody has looked."""
        return [scan for scan, places in self.places.items() if places == ALL]

    def ready_clouds(self) -> tuple[list[str], list[str]]:
        """Return the scans that are ready clouds: those with labels, and those without."""
        late = [name for name, row in self.trees.items() if not row.is_photo_scan]
        labelled = [name for name in late if self.trees[name].has_labelled_cloud()]
        return labelled, [name for name in late if name not in labelled]

    def known(self) -> list[str]:
        """Return every tree as far as it is known, in the table's order."""
        return [name for scan in self.trees for name in self.names(scan)]

    def rows(self) -> list[Tree]:
        """Return a row a tree, as far as they are known."""
        return list(map(self.row, self.known()))

    def folders(self) -> list[str]:
        """Return the folders that a run writes."""
        trees = dict.fromkeys([*self.trees, *self.known()])
        return ["results", "logs", "benchmarks", *(f"results/{tree}" for tree in trees)]

    def edits_of(self, tree: str) -> str:
        """Return the file of a tree's hand corrections, whether it is there or not."""
        return self.settings_for(tree)["graph"]["edits"].replace("{tree}", tree)

    def edited(self) -> list[str]:
        """Return the trees that have a file of hand corrections, those not yet found as well."""
        from snakemake.io import glob_wildcards

        found: list[str] = []
        for scan in self.trees:
            names = self.names(scan)
            if scan in self.open_scans:
                path = self.settings_of[scan]["graph"]["edits"]
                there = glob_wildcards(path).tree if "{tree}" in path else []
                names = sorted(name for name in there if self.scan_of(name) == scan != name)
            found += [name for name in names if Path(self.edits_of(name)).is_file()]
        return found

    @cached_property
    def measured(self) -> list[str]:
        """The trees with hand measurements."""
        return list(dict.fromkeys(row.tree for row in self.measures if self.has(row.tree)))

    def parts_of(self, tree: str) -> list[str]:
        """Return what a tree is asked for that not every tree is."""
        return asked_for(self.settings_for(tree)) + ["measures"] * (tree in self.measured)

    def measures_of(self, tree: str) -> list[str]:
        """Return a tree's hand measurements as text, the same wherever they stand in the table."""
        return [str(replace(row, line=0)) for row in self.measures if row.tree == tree]

    def rows_to_tell(self) -> list[Tree]:
        """Return a row a tree, and one a scan of several that failed or was not looked at."""
        rows: list[Tree] = []
        for scan, row in self.trees.items():
            names = self.names(scan)
            if scan in self.places:
                # What failed before its trees were found is of the scan as a single tree
                since = written_at(Path("results", scan, "trees.json"))
                records = status_folder(scan).glob("*.json")
                if not names or any(written_at(record) >= since for record in records):
                    rows.append(row)
            rows += map(self.row, names)
        return rows

    def strangers(self) -> list[str]:
        """Return a line for each hand measurement of a tree that is not in the table of trees."""
        lines = []
        for row in self.measures:
            if not self.has(row.tree):
                near = difflib.get_close_matches(row.tree, self.known(), n=1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                place = f"line {row.line} of {self.settings['measures']}"
                lines.append(f"{place}: no tree {row.tree!r} in {self.settings['trees']}{hint}")
        return lines


def read_batch(
    schema: Mapping,
    config: Mapping,
    command_line: Mapping | None = None,
    files: Iterable[str | os.PathLike] = (),
) -> Batch:
    """Read the tables that the config names, and each tree's own config.

    The command line's keys, which Snakemake has merged into the config, win over the latter, as it
    has those of more config files. A `StageError` where anything is wrong in the config, the tables
    or a tree's config.
    """
    source = ", ".join(dict.fromkeys(map(os.path.relpath, (CONFIG_FILE, *files))))
    settings = resolve_config(schema, config, source=source)
    trees = {row.tree: row for row in read_trees(settings["trees"])}
    notes = config_notes(schema, config)
    settings_of = dict.fromkeys(trees, settings)
    for name, row in trees.items():
        if row.config:
            layers = config, read_config_file(row.config), command_line or {}
            settings_of[name] = resolve_config(schema, *layers, source=row.config)
            more = config_notes(schema, *layers)
            notes += [f"tree {name!r}: {note}" for note in more if note not in notes]
    path = settings["measures"]
    is_default = path == schema["properties"]["measures"]["default"]
    measures = read_measures(path, may_miss=is_default) if path else []
    places = scans_of_several(trees, settings_of, settings["trees"], source)
    return Batch(settings, trees, settings_of, measures, places, notes)
