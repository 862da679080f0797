"""A batch as its files describe it: the trees, the settings of each, and hand measurements."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass

from cherrypicker.accuracy.measures import Measure, read_measures
from cherrypicker.batch.config import read_config_file, resolve_config
from cherrypicker.batch.trees import Tree, read_trees

CONFIG_FILE = "config/config.yaml"


@dataclass(frozen=True)
class Batch:
    """What is to be run."""

    settings: dict  # the batch's config with every key
    trees: dict[str, Tree]  # rows of the table by tree, in its order
    # The config of each tree: the batch's, its own file and the command line merged
    settings_of: dict[str, dict]
    measures: list[Measure]  # taken by hand, of whichever trees

    def strangers(self) -> list[str]:
        """Return a line for each hand measurement of a tree that is not in the table of trees."""
        lines = []
        for row in self.measures:
            if row.tree not in self.trees:
                near = difflib.get_close_matches(row.tree, self.trees, n=1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                place = f"line {row.line} of {self.settings['measures']}"
                lines.append(f"{place}: no tree {row.tree!r} in {self.settings['trees']}{hint}")
        return lines


def read_batch(schema: Mapping, config: Mapping, command_line: Mapping | None = None) -> Batch:
    """Read the tables that the config names, and each tree's own config.

    Parameters
    ----------
    config : mapping
        Content of ``config.yaml``, with the command line's keys where Snakemake merged them.
    command_line : mapping, optional
        The command line's keys alone, which win over a tree's own config.

    Raises
    ------
    StageError
        For whatever is wrong in the config, the tables or a tree's config.
    """
    settings = resolve_config(schema, config, source=CONFIG_FILE)
    trees = {row.tree: row for row in read_trees(settings["trees"])}
    settings_of = {
        name: resolve_config(
            schema,
            config,
            read_config_file(row.config) if row.config else {},
            command_line or {},
            source=row.config or CONFIG_FILE,
        )
        for name, row in trees.items()
    }
    path = settings["measures"]
    is_default = path == schema["properties"]["measures"]["default"]
    measures = read_measures(path, may_miss=is_default) if path else []
    return Batch(settings, trees, settings_of, measures)
