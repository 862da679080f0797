"""A run with failures: its summary and its series, by their own rules, of what is finished.

Snakemake starts no job whose inputs are missing. So its ``onerror`` handler starts it once more for
these rules alone, with ``finished_only``: their inputs are then the files that are there.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from cherrypicker.batch.summary import result_of
from cherrypicker.batch.trees import Tree

logger = logging.getLogger(__name__)


def summarise_finished(workflow: Any) -> None:
    """Run the rules of the summary and the series over what is finished, in the current folder.

    Parameters
    ----------
    workflow : snakemake.workflow.Workflow
        The run that failed; its config holds for this one too.
    """
    given = workflow.config_settings
    keys = {**given.config, "finished_only": True}
    command = [sys.executable, "-m", "snakemake", "--snakefile", workflow.main_snakefile]
    if given.configfiles:
        command += ["--configfile", *map(str, given.configfiles)]
    command += ["--config", *(f"{key}={json.dumps(value)}" for key, value in keys.items())]
    command += ["--profile", "none", "--workflow-profile", "none", "--cores", "1", "--nolock"]
    command += ["--keep-going"]  # a comparison that fails keeps no summary back
    command += ["--quiet", "all", "--forcerun", "summarise_batch"]
    command += ["--allowed-rules", "all", "summarise_batch", "compare_series"]
    own = {key: value for key, value in os.environ.items() if not key.startswith("SNAKEMAKE")}
    if subprocess.run(command, env=own, check=False).returncode:
        logger.warning("the summary of what is finished could not be made")


def finished_series(series: Mapping[str, list[Tree]]) -> dict[str, list[Tree]]:
    """Return the finished scans of each series that has two or more of them."""
    found = {
        name: [row for row in rows if result_of(asdict(row)).traits]
        for name, rows in series.items()
    }
    return {name: rows for name, rows in found.items() if len(rows) > 1}
