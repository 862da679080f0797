import dataclasses
import re
import sys
from functools import cache
from glob import escape, glob
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
from cherrypicker.batch.run_lock import begin_start, end_start
from cherrypicker.batch.series import compare_rest
from cherrypicker.batch.summary import summarise
from cherrypicker.batch.trees import TREE_PATTERN, series_of
from cherrypicker.batch.watched_modules import digest_of_code
from cherrypicker.batch.work_folder import check_writable
from cherrypicker.errors import StageError
from cherrypicker.intake.kinds import captures_in
from cherrypicker.intake.masks import masks_in
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
        names = [
            name
            for scan in batch.trees
            for name in batch.names(scan)
            if batch.has(name)
        ]
        return batch, series_of(map(batch.row, names))
    except StageError as error:
        raise WorkflowError(error.describe())


BATCH, SERIES = load_batch()
if workflow.is_main_process:
    for note in BATCH.notes:
        logger.warning(note)
# Rows of the table, each a scan; BATCH.row and BATCH.settings_for know the trees of every scan.
SETTINGS, TREES, SETTINGS_OF = BATCH.settings, BATCH.trees, BATCH.settings_of
ROW_SCANS = list(
    BATCH.places
)  # of several trees, which have no results of a tree themselves
SINGLE_TREES = [name for name in TREES if name not in ROW_SCANS]
# Snakemake knows how many trees stand in such a scan when it has looked
OPEN_SCANS = [name for name in ROW_SCANS if BATCH.places[name] == "all"]
LISTED_TREES = [
    name for scan in TREES if scan not in OPEN_SCANS for name in BATCH.names(scan)
]
LATE_TREES = [name for name, row in TREES.items() if not row.is_photo_scan]
LABELLED_TREES = [name for name in LATE_TREES if TREES[name].has_labelled_cloud()]
PHOTO_SIZES = PhotoSizes()
UNLABELLED_TREES = [name for name in LATE_TREES if name not in LABELLED_TREES]


def edits_of(tree):
    """Return the file of a tree's hand corrections, whether it is there or not."""
    return lookup_key(BATCH.settings_for(tree), "graph.edits").replace("{tree}", tree)


def edited_trees():
    """Return the trees that have a file of hand corrections."""
    names = list(LISTED_TREES)
    for scan in OPEN_SCANS:
        pattern = lookup_key(BATCH.settings_for(f"{scan}_1"), "graph.edits")
        before, *after = pattern.split(
            "{tree}"
        )  # the tree's name may stand there twice
        files = glob(f"{scan}_*".join(map(escape, (before, *after))))
        name, again = rf"(?P<tree>{re.escape(scan)}_\d+)", "(?P=tree)"
        pattern = re.escape(before) + name + again.join(map(re.escape, after))
        found = [re.fullmatch(pattern, file) for file in files]
        names += sorted(
            {each["tree"] for each in found if each and BATCH.has(each["tree"])}
        )
    return [name for name in names if edits_of(name) and Path(edits_of(name)).is_file()]


EDITED_TREES = edited_trees()
MEASURED_TREES = list(
    dict.fromkeys(row.tree for row in BATCH.measures if BATCH.has(row.tree))
)


def measures_of(tree):
    """Return a tree's hand measurements as text, so that a change of one of them is seen."""
    own = [row for row in BATCH.measures if row.tree == tree]
    return [
        str(dataclasses.replace(row, line=0)) for row in own
    ]  # wherever it stands in the table


def any_of(names):
    """Return a wildcard constraint that matches these trees only."""
    return "|".join(map(re.escape, names)) or "(?!)"


def none_of(names):
    """Return a wildcard constraint that matches all trees but these."""
    return rf"(?!(?:{any_of(names)})(?:/|$)){TREE_PATTERN}"


# Names of the trees of scans of several
ROW_TREES = rf"(?:{any_of(ROW_SCANS)})_[1-9][0-9]*"


def trees_of_scan(scan):
    """Return the trees of a scan that Snakemake waits for until somebody has looked."""
    checkpoints.find_trees.get(tree=scan)
    return BATCH.names(scan)


def of_each_tree(path):
    """Return inputs: a file of every tree; of a scan with ``all``, when its trees are found."""

    def of_one(scan):
        return lambda wildcards: [
            path.format(tree=tree) for tree in trees_of_scan(scan)
        ]

    known = [path.format(tree=tree) for tree in LISTED_TREES]
    return [*known, *map(of_one, OPEN_SCANS)]


def known_trees():
    """Return every tree of the batch as far as it is known, in the table's order."""
    return [name for scan in TREES for name in BATCH.names(scan)]


def of_known_trees(column):
    """Return a params function: a column of the table for every tree that is known."""
    return lambda wildcards: [
        getattr(BATCH.row(tree), column) for tree in known_trees()
    ]


def measured_trees(wildcards=None):
    """Return the trees with hand measurements, of those that are known."""
    return [name for name in known_trees() if name in MEASURED_TREES]


def cfg(key):
    """Return a params function: the value of one config key for the tree at hand."""

    def value_for(wildcards):
        tree = wildcards.get("tree")
        is_known = BATCH.scan_of(tree or "") in TREES
        return lookup_key(BATCH.settings_for(tree) if is_known else SETTINGS, key)

    lookup_key(SETTINGS, key)
    return value_for


def options(stage):
    """Return the params of a stage: every config key that the schema says it reads, one each."""
    return {key.rpartition(".")[2]: cfg(key) for key in keys_of_stage(SCHEMA, stage)}


def is_of_several(wildcards):
    """Whether a scan is of several trees, whichever they are."""
    return BATCH.scan_of(wildcards.tree) in ROW_SCANS


def row(column):
    """Return a params function: the tree's cell in ``trees.tsv``, empty where there is none."""
    return lambda wildcards: getattr(BATCH.row(wildcards.tree), column)


def code(script, *files):
    """Return a params function: the digest of a stage's code and of the files that it reads with it.

    So an edit of a module reruns its stages, and moving the project nothing.
    """
    digest = cache(
        lambda: digest_of_code(
            SCRIPTS / f"{script}.py",
            LIBRARY,
            [LIBRARY / "cherrypicker" / file for file in files],
        )
    )
    return lambda wildcards: digest()


def resource(path):
    """Return the path of a file that the project ships below ``resources/``."""
    return str(PROJECT / "resources" / path)


def weights_of(key):
    """Return an input function: a network's weights that a user names, if they are there."""

    def inputs(wildcards):
        path = cfg(key)(wildcards)
        return [path] if path and Path(path).is_file() else []

    return inputs


def is_plain(path):
    """Whether Snakemake takes a path as it is: it fills in {name} and <name>, with no way out."""
    return not (contains_wildcard(path) or PATHVAR_REGEX.search(path))


def captures_of(wildcards):
    """Return what lies in the tree's folder of photos; none where it is missing, which the stage reports."""
    captures = map(str, captures_in(BATCH.row(wildcards.tree).photos))
    return [path for path in captures if is_plain(path)]


def photos_of(wildcards):
    """Return the photos that stages read: those in the tree's folder, or the folder of prepared ones."""
    if size_of_scan(wildcards.tree).is_prepared:
        return [f"results/{BATCH.scan_of(wildcards.tree)}/photos"]
    return captures_of(wildcards)


def photo_folder(wildcards):
    """Return the folder that the photos lie in."""
    if size_of_scan(wildcards.tree).is_prepared:
        return f"results/{BATCH.scan_of(wildcards.tree)}/photos"
    return BATCH.row(wildcards.tree).photos


def photo_masks_of(wildcards):
    """Return the folder of prepared masks of a tree whose photos have masks, else nothing."""
    return "results/{tree}/photo_masks" if BATCH.row(wildcards.tree).masks else []


def user_masks_of(wildcards):
    """Return a tree's own masks; none where the folder is missing, which the stage reports."""
    masks = map(str, masks_in(BATCH.row(wildcards.tree).masks or "-"))
    return [path for path in masks if is_plain(path)]


def cloud_of(wildcards):
    """Return the tree's ready cloud; none where it is missing, which the stage reports."""
    path = BATCH.row(wildcards.tree).cloud
    return [path] if Path(path).is_file() and is_plain(path) else []


def shared_file(path):
    """Return an input function: a file that the trees of a scan share, by ``{scan}``."""
    return lambda wildcards: path.format(
        tree=wildcards.tree, scan=BATCH.scan_of(wildcards.tree)
    )


def photo_only(path):
    """Return an input function: this file for a tree from photos, none for a ready cloud.

    ``{tree}`` is the tree, ``{scan}`` the scan that it is from: the same for most.
    """
    return lambda wildcards: (
        shared_file(path)(wildcards) if BATCH.row(wildcards.tree).is_photo_scan else []
    )


def shared_with_tree(wildcards):
    """Return what readers look for in the folder of a tree and its scan has for all its trees."""
    if not BATCH.row(wildcards.tree).is_photo_scan:
        return []
    names = ("scale.json", "poses.npz", "metric_poses.npz")
    return [shared_file(f"results/{{scan}}/{name}")(wildcards) for name in names]


def frame_of(wildcards):
    """Return what says where a tree stands: its own file where its scan has several trees."""
    if wildcards.tree not in TREES:
        return f"results/{wildcards.tree}/tree.json"
    return photo_only("results/{tree}/metric.json")(wildcards)


def series_column(series, column):
    """Return a column of the table of trees for the scans of a series."""
    return [getattr(row, column) for row in SERIES.get(series, ())]


def files_of_series(name):
    """Return an input function: a file of each tree of a series."""
    return lambda wildcards: [
        f"results/{row.tree}/{name}" for row in SERIES.get(wildcards.series, ())
    ]


def shared_files_of_series(name):
    """Return an input function: a file of each scan from photos of a series."""
    return lambda wildcards: [
        f"results/{BATCH.scan_of(row.tree)}/{name}"
        for row in SERIES.get(wildcards.series, ())
        if row.is_photo_scan
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
def size_of_scan(tree):
    """Return how large a tree's scan is, from the headers of its photos or of its cloud."""
    tree = BATCH.scan_of(tree)
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
    return lambda wildcards: threads_to_ask(stage, size_of_scan(wildcards.tree))


def mb_for(stage):
    """Return a resource function: the stage's memory, more at each attempt."""
    return lambda wildcards, threads, attempt: mb_to_ask(
        stage, size_of_scan(wildcards.tree), threads, attempt
    )


def minutes_for(stage):
    """Return a resource function: the stage's running time, more at each attempt."""
    return lambda wildcards, threads, attempt: minutes_to_ask(
        stage, size_of_scan(wildcards.tree), threads, attempt
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
            [
                *("results", "logs", "benchmarks"),
                *(
                    f"results/{tree}"
                    for tree in dict.fromkeys([*TREES, *known_trees()])
                ),
            ]
        )
    except StageError as error:
        raise WorkflowError(error.describe())


def write_summary():
    """Write the batch's table and page, also after failures; not where no tree was asked for."""
    asked = {job.wildcards.get("tree") or "" for job in workflow.dag.jobs}
    if not any(BATCH.scan_of(tree) in TREES for tree in asked):
        return
    try:
        summarise(
            [
                {**dataclasses.asdict(row), "is_measured": row.tree in MEASURED_TREES}
                for row in BATCH.rows_to_tell("logs")
            ],
            "results",
            "logs",
            "results/traits.csv",
            "results/summary.html",
        )
    except (OSError, StageError) as error:
        raise WorkflowError(f"the summary of the batch cannot be written: {error}")


def compare_finished():
    """Compare the scans that are finished of each series that waits for one that is not."""
    jobs = [job for job in workflow.dag.jobs if job.rule.name == "compare_series"]
    for series in sorted({job.wildcards.series for job in jobs}):
        compare_rest(series, SERIES[series], SCRIPTS / "compare_series.py")


if workflow.is_main_process:
    begin_start()
