"""A run with failures: its summary, series and pages, by their own rules, of what is finished.

Snakemake starts no job whose inputs are missing. So its ``onerror`` handler starts it once more for
these rules alone, with ``finished_only``: their inputs are then the files that are there. The page
of a tree that lacks nothing but parts that not every tree has is made without these.
"""

import json
import logging
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cherrypicker.batch.summary import PART_OF, result_of
from cherrypicker.batch.trees import Tree
from cherrypicker.files import write_json

logger = logging.getLogger(__name__)


def summarise_finished(workflow: Any) -> None:
    """Run the rules of summary, series and pages over what a `workflow` that failed finished."""
    given, dag = workflow.config_settings, workflow.dag
    # By tree what its page lacks, where that is nothing but parts of it. A file of a job that is
    # still to be run counts for nothing: it is missing or out of date
    lacking = {}
    for page in dag.jobs:
        if page.rule.name == "report_tree":
            before = [job for job in dag.bfs(dag.dependencies, page) if job is not page]
            missing = {job.rule.name for job in before if not dag.noneedrun_finished(job)}
            if missing and missing <= PART_OF.keys():
                lacking[page.wildcards.tree] = sorted(PART_OF[rule] for rule in missing)
    # Pages take time; on a cluster's head node one at a time
    cores = workflow.resource_settings.cores if lacking and workflow.local_exec else None
    command = [sys.executable, "-m", "snakemake", "--snakefile", workflow.main_snakefile]
    config = [f"{key}={json.dumps(value)}" for key, value in given.config.items()]
    command += ["--config", *config] if config else []
    command += ["--profile", "none", "--workflow-profile", "none", "--nolock"]
    # A comparison that fails keeps no summary back
    command += ["--cores", str(cores or 1), "--keep-going", "--quiet", "all"]
    command += ["--forcerun", "summarise_batch", "--allowed-rules"]
    command += ["all", "summarise_batch", "compare_series", "report_tree"]
    own = {key: value for key, value in os.environ.items() if not key.startswith("SNAKEMAKE")}
    # A file: thousands of trees are longer than a command may be
    with tempfile.TemporaryDirectory() as folder:
        finished = Path(folder) / "finished.json"
        write_json(finished, {"finished_only": lacking or True})
        command += ["--configfile", *map(str, given.configfiles), str(finished)]
        if subprocess.run(command, env=own, check=False).returncode:
            logger.warning("the summary of what is finished could not be made")


def is_finished(row: Tree) -> bool:
    """Whether a scan has traits that hold, by its row."""
    return bool(result_of(asdict(row)).traits)
