# What the rules share: the batch, and functions that give a rule its files, params and resources.

import sys
from os.path import isfile
from pathlib import Path

from snakemake.exceptions import WorkflowError
from snakemake.logging import logger

# From this file, whichever Snakefile includes it or takes it as a module
PROJECT = Path(str(workflow.current_basedir)).parents[1]
SCRIPTS = PROJECT / "scripts"
# Where the packages lie: in a clone beside the scripts; a wheel installs them as any others
LIBRARY = SCRIPTS if (SCRIPTS / "cherrypicker").is_dir() else PROJECT.parents[1]
sys.path.insert(0, str(LIBRARY))

from cherrypicker.batch import resources as asks
from cherrypicker.batch.batch import read_batch
from cherrypicker.batch.config import lookup as lookup_key
from cherrypicker.batch.finished import is_finished, summarise_finished
from cherrypicker.batch.run_lock import begin_start, end_start
from cherrypicker.batch.scans import Scans
from cherrypicker.batch.summary import failures_told
from cherrypicker.batch.trees import TREE_PATTERN, any_of, none_of, series_of
from cherrypicker.batch.watched_modules import digest_of_code
from cherrypicker.command.work_folder import check_writable
from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml
from cherrypicker.mvs.backends.table import BACKENDS
from cherrypicker.runner import keys_of_stage


wildcard_constraints:
    tree=TREE_PATTERN,
    series=TREE_PATTERN,


def told(function, *arguments):
    """Call a function; its error of a user's input stops the run with one line."""
    try:
        return function(*arguments)
    except StageError as error:
        raise WorkflowError(error.describe())


SCHEMA = load_yaml(PROJECT / "workflow/schemas/config.schema.yaml")
GIVEN = workflow.config_settings
BATCH = told(read_batch, SCHEMA, config, GIVEN.config, GIVEN.configfiles)
ONLY_FINISHED = BATCH.settings["finished_only"]
# By tree, what its page is made without, since it failed
LACKING = ONLY_FINISHED if isinstance(ONLY_FINISHED, dict) else {}
SERIES = ALL_SERIES = told(series_of, BATCH.rows())
if ONLY_FINISHED:
    SERIES = series_of(filter(is_finished, sum(ALL_SERIES.values(), [])))
# A row of every known tree; once some ended, of failed scans of several as well
known_rows = BATCH.rows_to_tell if ONLY_FINISHED else BATCH.rows
# Rows of the table, each a scan; BATCH.row and BATCH.settings_for know the trees of every scan.
SCANS, SETTINGS, TREES = Scans(BATCH), BATCH.settings, BATCH.trees
EDITED_TREES = BATCH.edited()
LABELLED_TREES, UNLABELLED_TREES = BATCH.ready_clouds()

if workflow.is_main_process:
    for note in BATCH.notes:
        logger.warning(note)
    begin_start()
    # A module's `onstart` is not called
    if not workflow.modifier.is_main_snakefile():
        end_start()


def of_each_tree(file):
    """A file of every tree that has it; of a scan with ``all``, when its trees are found."""

    def of_scan(scan):
        if scan in BATCH.open_scans and not ONLY_FINISHED:
            checkpoints.find_trees.get(tree=scan)
        # A page that cannot be made without the parts that failed keeps nothing back
        rows = [BATCH.row(name) for name in BATCH.names(scan) if name not in LACKING]
        files = filter(None, map(file, rows))
        return [path for path in files if isfile(path) or not ONLY_FINISHED]

    return [lambda wildcards, scan=scan: of_scan(scan) for scan in TREES]


def part_of(kind, ending):
    """A file that not every tree is asked for; none of what failed, once some ended."""

    def file(tree):
        path = f"results/{tree}/{kind}.{ending}"
        is_asked = kind in BATCH.parts_of(tree) and kind not in LACKING.get(tree, ())
        return path if is_asked and (isfile(path) or not ONLY_FINISHED) else []

    return of_tree(file)


# Of a file or folder that goes when all who read it have, unless the config asks for it
large = (lambda path: path) if SETTINGS["keep"]["dense"] else temp


def file_of(path):
    """A file of a tree, ``{tree}``, or of the scan that it is from, ``{scan}``."""
    return of_tree(lambda tree: path.format(tree=tree, scan=BATCH.scan_of(tree)))


def photo_only(path):
    """A file as of `file_of` for a tree from photos, none for a ready cloud."""
    return branch(row("is_photo_scan"), then=file_of(path))


def figure(path, what):
    """A figure of a tree, which Snakemake's own report shows with the caption of its name."""
    return report(
        path,
        caption=f"../report/{Path(path).stem}.rst",
        category="Trees",
        labels={"tree": "{tree}", "what": what},
    )


def of_series(file):
    """A file of each tree of a series that has it."""
    return lambda wildcards: list(filter(None, map(file, SERIES[wildcards.series])))


def of_tree(function):
    """What a function tells of the tree at hand."""
    return lambda wildcards: function(wildcards.tree)


photos_of, photo_folder = of_tree(SCANS.photos), of_tree(SCANS.photo_folder)
is_of_several = of_tree(lambda tree: BATCH.scan_of(tree) in BATCH.places)
# One GPU where the tree's stereo needs CUDA
stereo_gpus = of_tree(lambda tree: int(BACKENDS[SCANS.size(tree).stereo].needs_cuda))


def weights_of(key):
    """A network's weights that a user names; none where missing, which the stage reports."""
    return branch(lambda wildcards: isfile(cfg(key)(wildcards) or ""), then=cfg(key))


def cfg(key):
    """The value of one config key for the tree at hand."""
    lookup_key(SETTINGS, key)  # what is no key stops the start
    return lambda wildcards: lookup_key(
        BATCH.settings_for(wildcards.get("tree", "")), key
    )


def row(column):
    """The tree's cell in ``trees.tsv``, empty where there is none."""
    return lambda wildcards: getattr(BATCH.row(wildcards.tree), column)


def code(script, *files):
    """The digest of a stage's code and of the files that it reads with it, wherever they lie."""
    paths = tuple(LIBRARY / "cherrypicker" / file for file in files)
    return lambda wildcards: digest_of_code(SCRIPTS / f"{script}.py", LIBRARY, paths)


def stage_params(script, *files):
    """Every config key that the schema says a stage reads, and its code, one param each."""
    keys = keys_of_stage(SCHEMA, script.rpartition("/")[2])
    params = {key.rpartition(".")[2]: cfg(key) for key in keys}
    return params | {"code": code(script, *files)}


def threads_for(stage):
    """As many as the size of the scan is worth."""
    return lambda wildcards: asks.threads_to_ask(stage, SCANS.size(wildcards.tree))


def resources_for(stage):
    """The memory and the time that a stage asks for, more at each attempt."""

    def of(ask):
        return lambda wildcards, threads, attempt: ask(
            stage, SCANS.size(wildcards.tree), threads, attempt
        )

    return {"mem_mb": of(asks.mb_to_ask), "runtime": of(asks.minutes_to_ask)}
