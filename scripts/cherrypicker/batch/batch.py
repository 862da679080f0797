"""A batch as its two files describe it: the trees, and the settings of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

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


def read_batch(schema: Mapping, config: Mapping, command_line: Mapping | None = None) -> Batch:
    """Read the table of trees that the config names, and each tree's own config.

    Parameters
    ----------
    config : mapping
        Content of ``config.yaml``, with the command line's keys where Snakemake merged them.
    command_line : mapping, optional
        The command line's keys alone, which win over a tree's own config.

    Raises
    ------
    StageError
        For whatever is wrong in the config, the table or a tree's config.
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
    return Batch(settings, trees, settings_of)
