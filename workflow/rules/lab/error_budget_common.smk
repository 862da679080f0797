# What the rules of the error budget share.

import dataclasses

TRUTH_FILES = ("poses.npz", "skeleton.csv", "cloud.ply", "traits.json")


def truth_of(wildcards):
    """Return the folder of the truth of a tree's scene, beside its photos."""
    return str(Path(TREES[wildcards["tree"]].photos).parent / "truth")


def truth_files_of(wildcards):
    """Return the files of the truth of a tree's scene."""
    return [f"{truth_of(wildcards)}/{name}" for name in TRUTH_FILES]


def results_of(wildcards):
    """Return the folder of a tree's results."""
    return f"results/{wildcards.tree}"


def whole_row(wildcards):
    """Return a tree's row of ``trees.tsv``."""
    return dataclasses.asdict(TREES[wildcards.tree])


def settings_of_tree(wildcards):
    """Return a tree's config, all keys."""
    return BATCH.settings_of[wildcards.tree]


TREES_WITH_TRUTH = [
    name
    for name, tree in TREES.items()
    if name not in ROW_SCANS
    and tree.is_photo_scan
    and all(Path(path).is_file() for path in truth_files_of({"tree": name}))
]
