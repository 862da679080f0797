# What the rules of the error budget share.

TRUTH_FILES = ("poses.npz", "skeleton.csv", "cloud.ply", "traits.json")


def truth_of(wildcards):
    """Return the folder of the truth of a tree's scene, beside its photos."""
    return str(Path(TREES[wildcards["tree"]].photos).parent / "truth")


def truth_files_of(wildcards):
    """Return the files of the truth of a tree's scene."""
    return [f"{truth_of(wildcards)}/{name}" for name in TRUTH_FILES]


TREES_WITH_TRUTH = [
    name
    for name, tree in TREES.items()
    if name not in BATCH.places
    and tree.is_photo_scan
    and all(Path(path).is_file() for path in truth_files_of({"tree": name}))
]
