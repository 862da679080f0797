import dataclasses
import re
import sys
from functools import cache
from importlib.metadata import distributions as find_distributions
from pathlib import Path

from snakemake.exceptions import WorkflowError

PROJECT = Path(workflow.basedir)
LIBRARY = PROJECT / "scripts"
if str(LIBRARY) not in sys.path:
    sys.path.insert(0, str(LIBRARY))

from cherrypicker.code_inputs import imported_modules
from cherrypicker.config import (
    load_schema,
    lookup as lookup_key,
    read_config_file,
    resolve_config,
)
from cherrypicker.errors import StageError
from cherrypicker.photo_sizes import PhotoSizes
from cherrypicker.photos import photos_in
from cherrypicker.resources import (
    mb_to_ask,
    minutes_to_ask,
    size_of_cloud,
    size_of_photos,
    threads_to_ask,
)
from cherrypicker.stale_lock import claim_lock
from cherrypicker.summary import summarise
from cherrypicker.trees import TREE_PATTERN, read_trees


wildcard_constraints:
    tree=TREE_PATTERN,


SCHEMA = load_schema(PROJECT / "workflow/schemas/config.schema.yaml")


def read_batch():
    """Read the config and the table of trees; what is wrong there stops the run at once."""
    command_line = workflow.config_settings.config or {}
    try:
        settings = resolve_config(SCHEMA, config, source="config/config.yaml")
        trees = {row.tree: row for row in read_trees(settings["trees"])}
        settings_of = {}
        for name, row in trees.items():
            own = read_config_file(row.config) if row.config else {}
            settings_of[name] = resolve_config(
                SCHEMA,
                config,
                own,
                command_line,
                source=row.config or "config/config.yaml",
            )
    except StageError as error:
        raise WorkflowError(error.describe())
    return settings, trees, settings_of


SETTINGS, TREES, SETTINGS_OF = read_batch()
LATE_TREES = [name for name, row in TREES.items() if not row.is_photo_scan]
LABELLED_TREES = [name for name in LATE_TREES if TREES[name].has_labelled_cloud()]
PHOTO_SIZES = PhotoSizes()
UNLABELLED_TREES = [name for name in LATE_TREES if name not in LABELLED_TREES]


def any_of(names):
    """Return a wildcard constraint that matches these trees only."""
    return "|".join(map(re.escape, names)) or "(?!)"


def cfg(key):
    """Return a params function: the value of one config key for the tree at hand."""

    def value_for(wildcards):
        return lookup_key(SETTINGS_OF.get(wildcards.get("tree"), SETTINGS), key)

    lookup_key(SETTINGS, key)
    return value_for


def row(column):
    """Return a params function: the tree's cell in ``trees.tsv``, empty where there is none."""
    return lambda wildcards: getattr(TREES[wildcards.tree], column)


def code(script):
    """Return the library modules that a stage script imports, for its rule to watch."""
    return imported_modules(LIBRARY / f"{script}.py", LIBRARY)


def resource(path):
    """Return the path of a file that the project ships below ``resources/``."""
    return str(PROJECT / "resources" / path)


def photos_of(wildcards):
    """Return the tree's photos; none where the folder is missing, which the stage reports."""
    return [str(path) for path in photos_in(TREES[wildcards.tree].photos)]


def cloud_of(wildcards):
    """Return the tree's ready cloud; none where it is missing, which the stage reports."""
    path = TREES[wildcards.tree].cloud
    return [path] if Path(path).is_file() else []


def photo_only(*paths):
    """Return an input function: these files for a tree from photos, none for a ready cloud."""

    def inputs(wildcards):
        if not TREES[wildcards.tree].is_photo_scan:
            return []
        files = [path.format(tree=wildcards.tree) for path in paths]
        return files[0] if len(files) == 1 else files

    return inputs


def stereo_gpus(wildcards):
    """Return how many GPUs the stereo of this tree takes: one where COLMAP's CUDA stereo runs."""
    backend = cfg("mvs.backend")(wildcards)
    has_cuda = find_distributions(name="pycolmap-cuda12")
    return int(backend == "cuda" or (backend == "auto" and any(has_cuda)))


@cache
def scan_of(tree):
    """Return how large a tree's scan is, from the headers of its photos or of its cloud."""
    if not TREES[tree].is_photo_scan:
        return size_of_cloud(TREES[tree].cloud)
    sizes = PHOTO_SIZES.of(photos_in(TREES[tree].photos))
    if workflow.is_main_process:
        PHOTO_SIZES.save()
    with_gpu = stereo_gpus({"tree": tree}) > 0
    return size_of_photos(sizes, SETTINGS_OF[tree], has_gpu_stereo=with_gpu)


def threads_for(stage):
    """Return a threads function: as many as the size of the scan is worth."""
    return lambda wildcards: threads_to_ask(stage, scan_of(wildcards.tree))


def mb_for(stage):
    """Return a resource function: the stage's memory, more at each attempt."""
    return lambda wildcards, threads, attempt: mb_to_ask(
        stage, scan_of(wildcards.tree), threads, attempt
    )


def minutes_for(stage):
    """Return a resource function: the stage's running time, more at each attempt."""
    return lambda wildcards, threads, attempt: minutes_to_ask(
        stage, scan_of(wildcards.tree), threads, attempt
    )


def more_at_each_attempt(mem_mb):
    """Return a resource function: this memory times the attempt."""
    return lambda wildcards, attempt: attempt * mem_mb


def write_summary():
    """Write the batch's table and page, also after failures."""
    summarise(
        [dataclasses.asdict(tree) for tree in TREES.values()],
        "results",
        "logs",
        "results/traits.csv",
        "results/summary.html",
    )


if workflow.is_main_process:
    claim_lock()
