import dataclasses
import re
import sys
from functools import cache
from pathlib import Path

from snakemake.exceptions import WorkflowError
from snakemake.io import contains_wildcard
from snakemake.logging import logger
from snakemake.pathvars import PATHVAR_REGEX

# From this file, whichever Snakefile includes it or takes it as a module
PROJECT = Path(str(workflow.current_basedir)).parents[1]
SCRIPTS = PROJECT / "scripts"
# Where the packages lie: in a clone beside the scripts; a wheel installs them as any others
LIBRARY = SCRIPTS if (SCRIPTS / "cherrypicker").is_dir() else PROJECT.parents[1]
if str(LIBRARY) not in sys.path:
    sys.path.insert(0, str(LIBRARY))

from cherrypicker.batch.batch import read_batch
from cherrypicker.batch.config import load_schema, lookup as lookup_key
from cherrypicker.batch.photo_sizes import PhotoSizes
from cherrypicker.batch.resources import (
    mb_to_ask,
    minutes_to_ask,
    size_of_cloud,
    threads_to_ask,
)
from cherrypicker.batch.scans import size_of_photo_scan
from cherrypicker.batch.stale_lock import begin_start, claim_lock, end_start
from cherrypicker.batch.series import compare_rest
from cherrypicker.batch.summary import summarise
from cherrypicker.batch.trees import TREE_PATTERN, series_of
from cherrypicker.batch.watched_modules import imported_modules
from cherrypicker.batch.work_folder import check_writable
from cherrypicker.errors import StageError
from cherrypicker.intake.kinds import captures_in
from cherrypicker.markers.references import check_scale
from cherrypicker.mvs.backends.table import BACKENDS, first_choice
from cherrypicker.photos import photos_in
from cherrypicker.runner import keys_of_stage


wildcard_constraints:
    tree=TREE_PATTERN,
    series=TREE_PATTERN,


SCHEMA = load_schema(PROJECT / "workflow/schemas/config.schema.yaml")


def load_batch():
    """Read the config and the table of trees; what is wrong there stops the run at once."""
    try:
        batch = read_batch(SCHEMA, config, workflow.config_settings.config)
        return batch, series_of(batch.trees.values())
    except StageError as error:
        raise WorkflowError(error.describe())


BATCH, SERIES = load_batch()
SETTINGS, TREES, SETTINGS_OF = BATCH.settings, BATCH.trees, BATCH.settings_of
LATE_TREES = [name for name, row in TREES.items() if not row.is_photo_scan]
LABELLED_TREES = [name for name in LATE_TREES if TREES[name].has_labelled_cloud()]
PHOTO_SIZES = PhotoSizes()
UNLABELLED_TREES = [name for name in LATE_TREES if name not in LABELLED_TREES]


def edits_of(tree):
    """Return the file of a tree's hand corrections, whether it is there or not."""
    return lookup_key(SETTINGS_OF[tree], "graph.edits").replace("{tree}", tree)


EDITED_TREES = [
    name for name in TREES if edits_of(name) and Path(edits_of(name)).is_file()
]
MEASURED_TREES = [
    name for name in TREES if any(row.tree == name for row in BATCH.measures)
]
UNEDITED_TREES = [name for name in TREES if name not in EDITED_TREES]


def measures_of(tree):
    """Return a tree's hand measurements as text, so that a change of one of them is seen."""
    own = [row for row in BATCH.measures if row.tree == tree]
    return [
        str(dataclasses.replace(row, line=0)) for row in own
    ]  # wherever it stands in the table


def any_of(names):
    """Return a wildcard constraint that matches these trees only."""
    return "|".join(map(re.escape, names)) or "(?!)"


def cfg(key):
    """Return a params function: the value of one config key for the tree at hand."""

    def value_for(wildcards):
        return lookup_key(SETTINGS_OF.get(wildcards.get("tree"), SETTINGS), key)

    lookup_key(SETTINGS, key)
    return value_for


def options(stage):
    """Return the params of a stage: every config key that the schema says it reads, one each."""
    return {key.rpartition(".")[2]: cfg(key) for key in keys_of_stage(SCHEMA, stage)}


def row(column):
    """Return a params function: the tree's cell in ``trees.tsv``, empty where there is none."""
    return lambda wildcards: getattr(TREES[wildcards.tree], column)


def code(script):
    """Return an input function: the library modules that a stage script imports, to be watched.

    They are looked for when a job of the stage is planned, not for the rules that are not needed.
    """
    modules = cache(lambda: imported_modules(SCRIPTS / f"{script}.py", LIBRARY))
    return lambda wildcards: modules()


def viewer_modules():
    """Return the scripts of the report's 3D view."""
    return sorted(map(str, LIBRARY.glob("cherrypicker/report/viewer_js/*.js")))


def resource(path):
    """Return the path of a file that the project ships below ``resources/``."""
    return str(PROJECT / "resources" / path)


def weights_of(key, shipped):
    """Return an input function: a network's weights; none where missing, which the stage reports."""

    def inputs(wildcards):
        path = cfg(key)(wildcards) or resource(shipped)
        return [path] if Path(path).is_file() else []

    return inputs


def is_plain(path):
    """Whether Snakemake takes a path as it is: it fills in {name} and <name>, with no way out."""
    return not (contains_wildcard(path) or PATHVAR_REGEX.search(path))


def captures_of(wildcards):
    """Return what lies in the tree's folder of photos; none where it is missing, which the stage reports."""
    captures = map(str, captures_in(TREES[wildcards.tree].photos))
    return [path for path in captures if is_plain(path)]


def photos_of(wildcards):
    """Return the photos that stages read: those in the tree's folder, or the folder of prepared ones."""
    if scan_of(wildcards.tree).is_prepared:
        return ["results/{tree}/photos"]
    return captures_of(wildcards)


def photo_folder(wildcards):
    """Return the folder that the photos lie in."""
    if scan_of(wildcards.tree).is_prepared:
        return f"results/{wildcards.tree}/photos"
    return TREES[wildcards.tree].photos


def photo_masks_of(wildcards):
    """Return the folder of prepared masks of a tree whose photos have masks, else nothing."""
    return "results/{tree}/photo_masks" if TREES[wildcards.tree].masks else []


def user_masks_of(wildcards):
    """Return a tree's own masks; none where the folder is missing, which the stage reports."""
    masks = map(str, sorted(Path(TREES[wildcards.tree].masks or "-").glob("*.png")))
    return [path for path in masks if is_plain(path)]


def cloud_of(wildcards):
    """Return the tree's ready cloud; none where it is missing, which the stage reports."""
    path = TREES[wildcards.tree].cloud
    return [path] if Path(path).is_file() and is_plain(path) else []


def photo_only(*paths):
    """Return an input function: these files for a tree from photos, none for a ready cloud."""

    def inputs(wildcards):
        if not TREES[wildcards.tree].is_photo_scan:
            return []
        files = [path.format(tree=wildcards.tree) for path in paths]
        return files[0] if len(files) == 1 else files

    return inputs


def series_column(series, column):
    """Return a column of the table of trees for the scans of a series."""
    return [getattr(row, column) for row in SERIES.get(series, ())]


def files_of_series(name, photo_scans=False):
    """Return an input function: a file of each scan of a series, or of those from photos alone."""
    return lambda wildcards: [
        f"results/{row.tree}/{name}"
        for row in SERIES.get(wildcards.series, ())
        if row.is_photo_scan or not photo_scans
    ]


def problem_of(wildcards, input):
    """Return what is wrong with a scan from photos, for its first stages to refuse it; {} if nothing.

    Taking ``input`` keeps Snakemake from comparing it with the last run: a tree that is finished up
    to its scale keeps all that, and the stage that finds the scale reports the problem.
    """
    for path in captures_in(row("photos")(wildcards)):
        if not is_plain(str(path)):
            cause = "Snakemake cannot take a path with {name} or <name> in it; rename the photo"
            return {"cause": cause, "file": str(path), "key": "photos in trees.tsv"}
    columns = [row(name)(wildcards) for name in ("marker_dictionary", "marker_sides_m")]
    try:
        check_scale(
            row("scale")(wildcards),
            cfg("scale.mode")(wildcards),
            *columns,
            cfg("scale.references")(wildcards),
        )
    except StageError as error:
        is_column = not str(error.key).startswith("scale.")
        file = SETTINGS["trees"] if is_column else None
        return {"cause": error.cause, "file": file, "key": error.key}
    return {}


def cloud_of_taped(wildcards):
    """Return the cloud without a scale of a tree whose trunk was taped, else nothing."""
    kinds = [entry["kind"] for entry in cfg("scale.references")(wildcards)]
    return ["results/{tree}/denoised.ply"] if "trunk" in kinds else []


def sky_masks_for_stereo(wildcards):
    """Return the tree's sky masks where the stereo shall leave out the sky, or what a user hides."""
    is_used = cfg("mvs.use_sky_masks")(wildcards) or TREES[wildcards.tree].masks
    return "results/{tree}/sky" if is_used else []


def stereo_gpus(wildcards):
    """Return how many GPUs the stereo of this tree takes: one where its backend needs CUDA."""
    return int(BACKENDS[first_choice(cfg("mvs.backend")(wildcards))].needs_cuda)


@cache
def scan_of(tree):
    """Return how large a tree's scan is, from the headers of its photos or of its cloud."""
    if not TREES[tree].is_photo_scan:
        return size_of_cloud(TREES[tree].cloud)
    backend = first_choice(cfg("mvs.backend")({"tree": tree}))
    scan = size_of_photo_scan(
        TREES[tree], SETTINGS_OF[tree], PHOTO_SIZES, stereo=backend
    )
    if workflow.is_main_process:
        PHOTO_SIZES.save()
    return scan


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


def prepare_run():
    """Let the next run start, now that Snakemake holds its lock; refuse what cannot be written."""
    end_start()
    for line in BATCH.strangers():
        logger.warning(line)
    try:
        check_writable(
            ["results", "logs", "benchmarks", *(f"results/{tree}" for tree in TREES)]
        )
    except StageError as error:
        raise WorkflowError(error.describe())


def write_summary():
    """Write the batch's table and page, also after failures; not where no tree was asked for."""
    if not any(job.wildcards.get("tree") in TREES for job in workflow.dag.jobs):
        return
    try:
        summarise(
            [
                {**dataclasses.asdict(row), "is_measured": name in MEASURED_TREES}
                for name, row in TREES.items()
            ],
            "results",
            "logs",
            "results/traits.csv",
            "results/summary.html",
        )
    except OSError as error:
        raise WorkflowError(f"the summary of the batch cannot be written: {error}")


def compare_finished():
    """Compare the scans that are finished of each series that waits for one that is not."""
    jobs = [job for job in workflow.dag.jobs if job.rule.name == "compare_series"]
    for series in sorted({job.wildcards.series for job in jobs}):
        compare_rest(series, SERIES[series], SCRIPTS / "compare_series.py")


if workflow.is_main_process:
    begin_start()
    claim_lock()
