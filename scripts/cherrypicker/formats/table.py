"""The formats that a finished tree is written in."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cherrypicker.classes import wood_mask
from cherrypicker.formats.las import write_las
from cherrypicker.formats.measured import MeasuredTree
from cherrypicker.formats.meshes import write_glb, write_obj
from cherrypicker.formats.mtg import write_mtg
from cherrypicker.formats.qsm import write_qsm
from cherrypicker.formats.treefile import write_treefile
from cherrypicker.formats.treeqsm_csv import write_treeqsm_csv
from cherrypicker.pointcloud import read_cloud
from cherrypicker.traits.support import NO_BRANCH, branch_cloud


@dataclass(frozen=True)
class Format:
    """A format: what it is, its file's suffix, and what writes a tree in it."""

    title: str
    suffix: str
    write: Callable[[Path, MeasuredTree], None]


def _write_cloud(path: Path, tree: MeasuredTree) -> None:
    """Write the whole labelled cloud, with the branch of what is wood."""
    cloud = read_cloud(tree.folder / "segmented.ply", required=("label",))
    branch = np.full(len(cloud), NO_BRANCH, dtype=np.int32)
    if wood_mask(cloud["label"]).any():
        wood = branch_cloud(cloud, tree.skeleton, tree.axis_list)
        branch[wood["source"]] = wood["branch_id"]
    write_las(path, cloud.with_fields(branch_id=branch))


FORMATS = {
    "mtg": Format("multiscale tree graph of OpenAlea", ".mtg", write_mtg),
    "qsm": Format("nodes and cylinders of libqsm", ".qsm", write_qsm),
    "treeqsm-csv": Format("cylinders as TreeQSM's, for rTwig", "_cylinders.csv", write_treeqsm_csv),
    "treefile": Format("tree file of RayCloudTools", "_trees.txt", write_treefile),
    "gltf": Format("closed tubes, a node a branch, glTF 2.0", ".glb", write_glb),
    "obj": Format("closed tubes, an object a branch", ".obj", write_obj),
    "las": Format("labelled cloud with branch_id", ".las", _write_cloud),
}
